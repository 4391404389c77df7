"""Sweep milling force excitation on the published set-up: accuracy, calibration, conditioning, refusals."""

import numpy as np
import pytest
import xarray as xr

from process.compliance import ModalModel
from process.engagement import engagement
from process.errors import InputError
from process.labels import make_record
from process.simulate import simulate_forced
from process.trials import Sensors
from smfe.demo_campaign import MACHINE, SENSORS, TOOL, sweep_passes
from smfe.sweep import LocalPolynomial, Segments, SingleReference, SweepPass, bands, identify_sweep

BAND = (20.0, 80.0)


def passes(records: dict[str, xr.Dataset], widths: dict[str, float]) -> list[SweepPass]:
    return [SweepPass(r, cut, engagement(cut, widths[cut], TOOL.diameter)) for cut, r in records.items()]


@pytest.fixture(scope="module")
def good() -> list[SweepPass]:
    """The published set-up with its noise, a_e 12 mm, seed 1."""
    return passes(sweep_passes(seed=1), dict.fromkeys(("down", "up", "central"), 0.012))


@pytest.fixture(scope="module")
def poor() -> list[SweepPass]:
    """The published set-up with its noise, a_e 72 mm, seed 1."""
    return passes(sweep_passes(seed=1, width=0.072), dict.fromkeys(("down", "up", "central"), 0.072))


def entry_errors(compliance: xr.Dataset) -> np.ndarray:
    """Relative rms error of each entry against the machine that was simulated."""
    truth = MACHINE.matrix(compliance["frequency"].values)
    error = compliance["compliance"].values - truth
    return np.sqrt(np.mean(np.abs(error) ** 2, axis=0) / np.mean(np.abs(truth) ** 2, axis=0))


@pytest.mark.parametrize("campaign", ["good", "poor"])
def test_all_references_beat_force_x_alone_in_every_entry(campaign: str, request: pytest.FixtureRequest) -> None:
    data = request.getfixturevalue(campaign)
    ours = entry_errors(identify_sweep("all", data, BAND).compliance)
    theirs = entry_errors(identify_sweep("x", data, BAND, SingleReference()).compliance)
    assert ours.mean() < 0.75 * theirs.mean()
    assert (ours / theirs).max() < 1.05


def test_the_local_polynomial_also_beats_a_single_reference_with_more_overlap(good: list[SweepPass]) -> None:
    ours = entry_errors(identify_sweep("all", good, BAND).compliance)
    theirs = entry_errors(identify_sweep("x", good, BAND, SingleReference(overlap=0.75)).compliance)
    assert ours.mean() < 0.75 * theirs.mean()


@pytest.mark.parametrize("estimator", [LocalPolynomial(), Segments()])
def test_the_stated_std_is_the_error(estimator: LocalPolynomial | Segments, good: list[SweepPass]) -> None:
    compliance = identify_sweep("s", good, BAND, estimator).compliance
    error = np.abs(compliance["compliance"].values - MACHINE.matrix(compliance["frequency"].values))
    ratio = np.sqrt(np.mean((error / compliance["compliance_std"].values) ** 2, axis=0))
    assert ratio.max() < 1.35
    assert ratio.min() > 0.65


def test_without_noise_the_local_polynomial_is_exact_to_its_order() -> None:
    quiet = sweep_passes(seed=1, sensors=Sensors())
    data = passes(quiet, dict.fromkeys(quiet, 0.012))
    assert entry_errors(identify_sweep("s", data, BAND).compliance).max() < 0.03
    narrow = LocalPolynomial(half_width=0.5)
    assert entry_errors(identify_sweep("s", data, BAND, narrow).compliance).max() < 0.005


def test_a_record_that_ends_in_the_cut_is_solved_with_its_transient(monkeypatch: pytest.MonkeyPatch) -> None:
    records = sweep_passes(seed=1, sensors=Sensors())
    cut_short = {k: r.isel(time=slice(1500, -8000)) for k, r in records.items()}
    data = passes(cut_short, dict.fromkeys(records, 0.012))
    result = identify_sweep("s", data, (25.0, 75.0))
    assert not result.tables["passes"]["from_rest_to_rest"].any()
    with_transient = entry_errors(result.compliance)
    assert with_transient.max() < 0.08
    monkeypatch.setattr("smfe.sweep._at_rest", lambda record: True)
    without = entry_errors(identify_sweep("s", data, (25.0, 75.0)).compliance)
    assert without.mean() > 2.0 * with_transient.mean()


def test_half_immersion_down_and_up_with_a_slot_is_refused_with_the_reason() -> None:
    records = sweep_passes(seed=1, width=0.040, duration=5.0)
    data = passes(records, {"down": 0.040, "up": 0.040, "central": 0.080})
    with pytest.raises(InputError, match="add up to the slot"):
        identify_sweep("s", data, BAND)


def test_forces_that_are_dependent_as_measured_are_refused(good: list[SweepPass]) -> None:
    same = [SweepPass(good[0].record, f"down {i}") for i in range(3)]
    short = SingleReference()
    with pytest.raises(InputError, match="not independent: their condition number exceeds 200"):
        identify_sweep("s", same, BAND, short)


def test_two_passes_are_refused(good: list[SweepPass]) -> None:
    with pytest.raises(InputError, match=r"2 passes .*need three"):
        identify_sweep("s", good[:2], BAND)


def test_a_pass_without_a_force_is_refused(good: list[SweepPass]) -> None:
    record = good[0].record.copy()
    record["force"] = record["force"].where(record["axis"] != "z")
    with pytest.raises(InputError, match="has no force_z"):
        identify_sweep("s", [SweepPass(record, "down"), *good[1:]], BAND)


def test_badly_conditioned_frequencies_are_named(poor: list[SweepPass]) -> None:
    result = identify_sweep("s", poor, BAND, SingleReference())
    assert any("badly conditioned (above 30) in 5" in w for w in result.warnings)
    condition = result.compliance["force_condition"]
    assert float(condition.max()) > 30.0


def test_relabelling_axes_relabels_the_compliance() -> None:
    rng = np.random.default_rng(7)
    machine = ModalModel([33.0, 58.0], [0.05, 0.04], [4e7, 3e7], [(0.1, 0.6, 0.8), (1.0, 0.2, 0.1)])
    base, swapped = [], []
    for label in "abc":
        force = np.zeros((3, 16000))
        force[:, 1000:9000] = 100.0 * rng.standard_normal((3, 8000))
        record = simulate_forced(machine, force, 1000.0).drop_vars("displacement")
        base.append(SweepPass(record, label))
        channels = {
            name: {a: record[name].sel(axis=b).values for a, b in zip("xyz", "yxz", strict=True)}
            for name in ("force", "acceleration")
        }
        swapped.append(SweepPass(make_record(record["time"].values, channels), label))
    plain = identify_sweep("s", base, BAND).compliance["compliance"].values
    other = identify_sweep("s", swapped, BAND).compliance["compliance"].values
    np.testing.assert_allclose(other[:, [1, 0, 2]][:, :, [1, 0, 2]], plain, rtol=1e-6, atol=1e-14)


def test_bands_are_the_runs_of_a_mask() -> None:
    f = np.arange(10.0)
    assert bands(f, np.isin(f, [0, 1, 2, 5, 9])) == [(0.0, 2.0), (5.0, 5.0), (9.0, 9.0)]
    assert bands(f, np.zeros(10, bool)) == []


def test_noise_of_the_published_set_up_is_what_the_tests_use() -> None:
    assert SENSORS.acceleration_noise == (0.01597, 0.01175, 0.00139)
