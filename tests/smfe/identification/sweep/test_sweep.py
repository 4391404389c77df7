"""Sweep milling force excitation on the published set-up: accuracy, calibration, conditioning, refusals."""

import numpy as np
import pytest
import xarray as xr
from scipy.signal import butter, sosfilt

from process.cut.engagement import engagement
from process.errors import InputError
from process.instruments.trials import Sensors, milling_trial
from process.labels import make_record
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle, simulate_forced
from smfe.commands.demo import MACHINE, MATERIAL, SENSORS, SWEEP_DEPTH, SWEEP_RATE, SWEEP_START, TOOL, sweep_passes
from smfe.identification.errors.result import bands
from smfe.identification.sweep.local_polynomial import LocalPolynomial
from smfe.identification.sweep.passes import SweepPass
from smfe.identification.sweep.segments import Segments, SingleReference
from smfe.identification.sweep.sweep import identify_sweep

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
    assert ours.mean() < 0.5 * theirs.mean()
    assert (ours / theirs).max() < 1.05


def test_the_local_polynomial_also_beats_a_single_reference_with_more_overlap(good: list[SweepPass]) -> None:
    ours = entry_errors(identify_sweep("all", good, BAND).compliance)
    theirs = entry_errors(identify_sweep("x", good, BAND, SingleReference(overlap=0.75)).compliance)
    assert ours.mean() < 0.75 * theirs.mean()


@pytest.mark.parametrize("estimator", [LocalPolynomial(rational=False), Segments()])
def test_the_stated_std_is_the_error(estimator: LocalPolynomial | Segments, good: list[SweepPass]) -> None:
    compliance = identify_sweep("s", good, BAND, estimator).compliance
    error = np.abs(compliance["compliance"].values - MACHINE.matrix(compliance["frequency"].values))
    ratio = np.sqrt(np.mean((error / compliance["compliance_std"].values) ** 2, axis=0))
    assert ratio.max() < 1.35
    assert ratio.min() > 0.65


@pytest.mark.parametrize("estimator", [LocalPolynomial(rational=False), Segments()])
def test_errors_are_shared_by_the_stated_number_of_lines(
    estimator: LocalPolynomial | Segments, good: list[SweepPass]
) -> None:
    compliance = identify_sweep("s", good, BAND, estimator).compliance
    error = compliance["compliance"].values - MACHINE.matrix(compliance["frequency"].values)
    z = (error / compliance["compliance_std"].values)[20:-20]
    lags = [np.mean(z[k:] * z[: len(z) - k].conj()).real for k in range(8)]
    shared = 1.0 + 2.0 * np.sum(lags[1:]) / lags[0]
    assert shared == pytest.approx(compliance.attrs["error_lines"], rel=0.35)


def test_without_noise_the_local_polynomial_is_exact_to_its_order() -> None:
    quiet = sweep_passes(seed=1, sensors=Sensors())
    data = passes(quiet, dict.fromkeys(quiet, 0.012))
    assert entry_errors(identify_sweep("s", data, BAND).compliance).max() < 0.005
    narrow = LocalPolynomial(half_widths=(0.5,))
    assert entry_errors(identify_sweep("s", data, BAND, narrow).compliance).max() < 0.005


@pytest.mark.slow
def test_a_record_that_ends_in_the_cut_is_solved_with_its_transient(monkeypatch: pytest.MonkeyPatch) -> None:
    records = sweep_passes(seed=1, sensors=Sensors())
    cut_short = {k: r.isel(time=slice(1500, -8000)) for k, r in records.items()}
    data = passes(cut_short, dict.fromkeys(records, 0.012))
    result = identify_sweep("s", data, (25.0, 75.0))
    assert not result.tables["passes"]["from_rest_to_rest"].any()
    with_transient = entry_errors(result.compliance)
    assert with_transient.max() < 0.08
    monkeypatch.setattr("smfe.identification.sweep.passes.at_rest", lambda record: True)
    without = entry_errors(identify_sweep("s", data, (25.0, 75.0)).compliance)
    assert without.mean() > 2.0 * with_transient.mean()


@pytest.mark.parametrize("damping", [0.02, 0.01])
def test_a_lightly_damped_machine_keeps_its_peaks_and_its_error_is_stated(
    damping: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = ModalModel([30.0, 52.0, 60.0], [damping] * 3, 2 * MACHINE.stiffness, MACHINE.direction)
    monkeypatch.setattr("smfe.commands.demo.MACHINE", machine)
    records = sweep_passes(seed=1, sensors=Sensors(acceleration_noise=(2e-3, 2e-3, 2e-3)))
    found = identify_sweep("s", passes(records, dict.fromkeys(records, 0.012)), BAND).compliance
    value, truth = found["compliance"].values, machine.matrix(found["frequency"].values)
    for i in range(3):
        assert np.abs(value[:, i, i]).max() == pytest.approx(np.abs(truth[:, i, i]).max(), rel=0.005)
    # The time simulation itself is good to some 2e-4 of the compliance.
    stated = found["compliance_std"].values ** 2 + (3e-4 * np.abs(truth)) ** 2
    ratio = np.sqrt(np.mean(np.abs(value - truth) ** 2 / stated, axis=0))
    assert ratio.max() < 1.35
    # A single band of 2 Hz would have flattened them.
    wide = identify_sweep(
        "s", passes(records, dict.fromkeys(records, 0.012)), BAND, LocalPolynomial(half_widths=(1.0,))
    )
    assert np.abs(wide.compliance["compliance"].values[:, 2, 2]).max() < 0.9 * np.abs(truth[:, 2, 2]).max()


@pytest.mark.parametrize("noise", [5.0, 20.0])
def test_noise_on_the_forces_is_in_the_stated_std_and_in_the_warnings(noise: float) -> None:
    records = sweep_passes(seed=1, sensors=Sensors((noise,) * 3, SENSORS.acceleration_noise))
    found = identify_sweep("s", passes(records, dict.fromkeys(records, 0.012)), BAND)
    compliance = found.compliance
    error = np.abs(compliance["compliance"].values - MACHINE.matrix(compliance["frequency"].values))
    assert np.sqrt(np.mean((error / compliance["compliance_std"].values) ** 2, axis=0)).max() < 1.5
    assert any("noise on the forces" in w for w in found.warnings) == (noise > 10.0)
    # Charged only in part: least squares with the same noise would be too small by more than this.
    assert (
        np.abs(
            np.mean(
                (compliance["compliance"].values / MACHINE.matrix(compliance["frequency"].values)).real[
                    :, range(3), range(3)
                ]
            )
            - 1.0
        )
        < 0.01
    )


def test_a_repeat_does_not_make_dependent_passes_independent() -> None:
    records = sweep_passes(seed=1, width=0.040, duration=5.0)
    data = passes(records, {"down": 0.040, "up": 0.040, "central": 0.080})
    with pytest.raises(InputError, match="add up to the slot"):
        identify_sweep("s", [*data, data[0]], BAND)


def test_the_order_of_axes_in_a_record_does_not_matter(good: list[SweepPass]) -> None:
    turned = [SweepPass(p.record.isel(axis=[2, 0, 1]), p.label, p.arc) for p in good]
    plain, other = (identify_sweep("s", data, (30.0, 40.0)).compliance for data in (good, turned))
    np.testing.assert_allclose(other["compliance"].values, plain["compliance"].values, rtol=1e-10)


def test_a_pass_with_fewer_motion_axes_limits_the_rows_of_all(good: list[SweepPass]) -> None:
    record = good[0].record.copy()
    record["acceleration"] = record["acceleration"].where(record["axis"] != "z")
    # The rational model has the same poles in all rows; bands are solved row by row.
    rows = LocalPolynomial(rational=False)
    found = identify_sweep("s", [SweepPass(record, "down", good[0].arc), *good[1:]], (30.0, 40.0), rows).compliance
    assert list(found["response"].values) == ["x", "y"]
    whole = identify_sweep("s", good, (30.0, 40.0), rows).compliance
    np.testing.assert_allclose(found["compliance"].values, whole["compliance"].values[:, :2], rtol=1e-6)


def test_passes_need_no_common_sampling_rate_but_segments_do(good: list[SweepPass]) -> None:
    cut = MillingCut(TOOL, good[0].arc, MATERIAL, SWEEP_DEPTH, feed_rate=2e-3)
    rng = np.random.default_rng(1)
    coarse = milling_trial(MACHINE, cut, Spindle(SWEEP_START, SWEEP_RATE), 65.0, SENSORS, rng, sample_rate=1333.0)
    data = [SweepPass(coarse, "down", good[0].arc), *good[1:]]
    assert entry_errors(identify_sweep("s", data, BAND).compliance).mean() < 0.05
    with pytest.raises(InputError, match="sampled at another rate"):
        identify_sweep("s", data, BAND, Segments(resolution=0.3))


@pytest.mark.parametrize("band", [(1100.0, 1200.0), (80.0, 20.0), (0.0, 50.0)])
def test_a_band_that_the_records_do_not_hold_is_refused(band: tuple[float, float], good: list[SweepPass]) -> None:
    with pytest.raises(InputError, match="Nyquist"):
        identify_sweep("s", good, band)


def test_passes_that_are_too_short_are_refused_with_the_time_they_need(good: list[SweepPass]) -> None:
    short = [SweepPass(p.record.isel(time=slice(40000, 42000)), p.label, p.arc) for p in good]
    with pytest.raises(InputError, match=r"at least [\d.]+ s are needed"):
        identify_sweep("s", short, BAND)


def test_frequencies_above_the_largest_condition_number_stay_empty(good: list[SweepPass]) -> None:
    # Forces along one line at the lower frequencies, in all directions above 65 Hz.
    rng = np.random.default_rng(3)
    high = butter(16, 65.0, "high", fs=1000.0, output="sos")
    data = []
    for number in range(3):
        force = np.zeros((3, 40000))
        force[:, 1000:30000] = np.array([[1.0], [2.0], [3.0]]) * rng.standard_normal(29000)
        force[:, 1000:30000] += 3.0 * sosfilt(high, rng.standard_normal((3, 29000)))
        force[:, 1000:30000] += 1e-3 * rng.standard_normal((3, 29000))
        data.append(SweepPass(simulate_forced(MACHINE, 100 * force, 1000.0).drop_vars("displacement"), str(number)))
    found = identify_sweep("s", data, (30.0, 80.0))
    empty = np.isnan(found.compliance["compliance"].values).all(axis=(1, 2))
    np.testing.assert_array_equal(empty, ~(found.compliance["force_condition"].values <= 200.0))
    assert empty[:20].all()
    assert not empty[-40:].any()
    assert any(w.startswith("not solved") for w in found.warnings)


def test_a_noisy_pass_counts_less(good: list[SweepPass]) -> None:
    rng = np.random.default_rng(4)
    noisy = good[0].record.copy()
    noisy["acceleration"] = noisy["acceleration"] + 0.5 * rng.standard_normal(noisy["acceleration"].shape)
    data = [*good, SweepPass(noisy, "down again", good[0].arc)]
    # The noisy repeat must not spoil what the quiet passes give.
    clean = entry_errors(identify_sweep("s", good, BAND).compliance).mean()
    assert entry_errors(identify_sweep("s", data, BAND).compliance).mean() < 1.3 * clean


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
    # Without noise the rational model is ill-determined, and rounding moves its path a little.
    for estimator, same in ((LocalPolynomial(rational=False), 1e-6), (LocalPolynomial(), 5e-3)):
        plain = identify_sweep("s", base, BAND, estimator).compliance["compliance"].values
        other = identify_sweep("s", swapped, BAND, estimator).compliance["compliance"].values
        turned = other[:, [1, 0, 2]][:, :, [1, 0, 2]]
        np.testing.assert_allclose(turned, plain, rtol=same, atol=same * 1e-8)


def test_bands_are_the_runs_of_a_mask() -> None:
    f = np.arange(10.0)
    assert bands(f, np.isin(f, [0, 1, 2, 5, 9])) == [(0.0, 2.0), (5.0, 5.0), (9.0, 9.0)]
    assert bands(f, np.zeros(10, bool)) == []


def test_noise_of_the_published_set_up_is_what_the_tests_use() -> None:
    assert SENSORS.acceleration_noise == (0.01597, 0.01175, 0.00139)
