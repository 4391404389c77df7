"""What every identified measurement is checked for."""

from pathlib import Path

import numpy as np
import pytest
from samples.linear_machine import MACHINE, TOOL, sweep_passes

from process.cut.engagement import engagement
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.campaign import load_campaign
from smfe.identification import measurement as measurements
from smfe.identification.measurement import sign_warnings, tooth_passing_band
from smfe.identification.sweep.local_polynomial import BANDS
from smfe.identification.sweep.passes import SweepPass
from smfe.identification.sweep.sweep import identify_sweep
from smfe.records import read_records, write_record_netcdf

FREQUENCY = np.arange(20.0, 80.0, 0.25)


def test_a_passive_machine_raises_no_warning_and_a_turned_force_does() -> None:
    compliance = MACHINE.compliance(FREQUENCY)
    assert sign_warnings(compliance) == ()
    turned = compliance.assign(compliance=-compliance["compliance"])
    found = sign_warnings(turned)
    assert [w.split()[3] for w in found] == ["xx", "yy", "zz"]
    assert all("sign = -1" in w for w in found)


def test_noise_alone_is_no_reason_to_suspect_a_sign() -> None:
    rng = np.random.default_rng(1)
    machine = ModalModel([500.0], [0.01], [1e8], [(1.0, 0.0, 0.0)])
    compliance = machine.compliance(FREQUENCY, "x", "x")
    noise = 1e-9 * (rng.standard_normal((FREQUENCY.size, 1, 1)) + 1j * rng.standard_normal((FREQUENCY.size, 1, 1)))
    noisy = compliance.assign(
        compliance=compliance["compliance"] + noise,
        compliance_std=(("frequency", "response", "excitation"), np.full(noise.shape, 1.4e-9)),
    )
    assert sign_warnings(noisy) == ()


def test_a_sweep_on_a_dynamometer_with_the_reaction_is_found_out() -> None:
    passes = []
    for cut, record in sweep_passes(seed=1, duration=20.0).items():
        turned = record.assign(force=-record["force"])
        passes.append(SweepPass(turned, cut, engagement(cut, 0.012, TOOL.diameter)))
    assert len(sign_warnings(identify_sweep("s", passes, (20.0, 80.0), BANDS).compliance)) == 3


def test_the_band_of_a_sweep_is_its_tooth_passing_frequency_and_twice_that() -> None:
    passes = [SweepPass(r, c) for c, r in sweep_passes(seed=1, duration=20.0).items()]
    low, high = tooth_passing_band(passes, 2)
    # From 600 rpm at 1.5 rad/s2, after half a second in the air, 20 s in the cut, two teeth.
    assert low == pytest.approx(21.0, abs=1.0)
    assert high == pytest.approx(2 * (20.0 + 2 * 1.5 * 20.5 / (2 * np.pi)), abs=2.0)


CAMPAIGN = """
[campaign]
name = "sweeps"
[tool]
diameter = "{diameter} m"
teeth = 2
[[measurement]]
name = "sweep"
method = "sweep"
frequency_range = ["20 Hz", "80 Hz"]
{key}
records = [
    {{ file = "down.nc", cut = "down", width_of_cut = "12 mm" }},
    {{ file = "up.nc", cut = "up", width_of_cut = "12 mm" }},
    {{ file = "central.nc", cut = "central", width_of_cut = "12 mm" }},
]
"""


@pytest.mark.parametrize(
    ("key", "share"),
    [
        ('references = "x"', 1e-5),
        pytest.param('estimator = "bands"', 1e-3, marks=pytest.mark.slow),
        pytest.param('estimator = "local_polynomial"', 0.02, marks=pytest.mark.slow),
    ],
)
def test_reading_sweeps_at_a_lower_rate_changes_no_compliance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, share: float
) -> None:
    """The default chooses between bands and models: where two are equally good, the last digit decides.

    Then the results differ, by less than the error that they state.
    """
    for cut, record in sweep_passes(seed=1, duration=20.0).items():
        write_record_netcdf(record, tmp_path / f"{cut}.nc")
    text = CAMPAIGN.format(diameter=TOOL.diameter, key=key)
    (tmp_path / "c.toml").write_text(text)
    campaign = load_campaign(tmp_path / "c.toml")
    passes, _ = measurements.passes_and_band(campaign, campaign.measurements[0])
    assert all(p.record.attrs["reduced_from_Hz"] >= 2.5 * 2.5 * 80.0 for p in passes)
    reduced = measurements.identify_measurement(campaign, campaign.measurements[0]).compliance
    monkeypatch.setattr(measurements, "read_reduced", lambda file, channels, highest: read_records(file, channels))
    full = measurements.identify_measurement(campaign, campaign.measurements[0]).compliance
    np.testing.assert_allclose(reduced["frequency"], full["frequency"], rtol=1e-12)
    a, b = (c["compliance"].values for c in (reduced, full))
    assert np.array_equal(np.isnan(a), np.isnan(b))
    left = np.sqrt(np.nanmean(np.abs(a - b) ** 2) / np.nanmean(np.abs(b) ** 2))
    assert left < share
    std = full["compliance_std"].values
    known = np.isfinite(std)  # a single reference leaves nothing to judge by
    assert np.all(np.abs(a - b)[known] ** 2 @ (1.0 / std[known] ** 2) <= known.sum())


def test_passes_over_different_speeds_have_no_band() -> None:
    passes = [SweepPass(r, c) for c, r in sweep_passes(seed=1, duration=5.0).items()]
    slow = passes[0].record.assign(spindle_speed=passes[0].record["spindle_speed"] / 10.0)
    with pytest.raises(InputError, match="no band in common"):
        tooth_passing_band([SweepPass(slow, "slow"), *passes[1:]], 2)
