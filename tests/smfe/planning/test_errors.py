"""Planning a sweep: forces against the time domain, errors against symmetries and simulated identifications."""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from samples.linear_machine import MACHINE, MATERIAL, SENSORS, SWEEP_RATE, SWEEP_START, TOOL, sweep_passes
from scipy.integrate import quad

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients, force_projection
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_record
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from smfe.identification.spectra.spectra import BlockSpectra
from smfe.identification.sweep.least_squares import condition_number
from smfe.identification.sweep.local_polynomial import BANDS, LocalPolynomial
from smfe.identification.sweep.noise import force_noise
from smfe.identification.sweep.passes import SweepPass, prepare, whole_record
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.identification.sweep.sweep import identify_sweep
from smfe.planning.errors import Instruments, error_interval, expected, relative_error
from smfe.planning.forces import (
    Forces,
    Pass,
    SweepPlan,
    edge_factor,
    energy,
    force_level,
    force_sensor,
    orders_within,
    unit_harmonics,
)
from smfe.planning.recommend import thin_chips
from smfe.planning.search import covers, inverse_diagonal
from smfe.planning.task import Estimate, without_noise

FREQUENCY = np.arange(20.0, 80.25, 0.25)
STIFF = ModalModel([400.0], [0.5], [1e13], [[1.0, 1.0, 1.0]])
ESTIMATE = Estimate("known", MACHINE)
ONE_BAND = LocalPolynomial(half_widths=(0.5,), rational=False)
NOISE = Instruments(SENSORS.acceleration_noise, (0.0, 0.0, 0.0), 2000.0)


def published(width: float = 0.012, duration: float = 65.0, **changes: float) -> SweepPlan:
    """The published sweep: 80 mm, two inserts, 600 rpm at 1.5 rad/s2 for 65 s, a_p 2 mm, f_z 0.1 mm.

    Its spindle accelerates from the start of the record, half a second before the cut.
    """
    passes = tuple(Pass(cut, width) for cut in ("down", "up", "central"))
    start = SWEEP_START + 0.5 * SWEEP_RATE
    plan = SweepPlan(TOOL, passes, 0.002, 1e-4 * SWEEP_START / start, start, start + SWEEP_RATE * 65.0, duration)
    return replace(plan, **changes)


def spectrum(plan: SweepPlan, one: Pass, machine: ModalModel = STIFF) -> BlockSpectra:
    """Transform of the force of one pass, from the time simulation of the cut."""
    cut = MillingCut(plan.tool, one.engagement(plan.tool.diameter), MATERIAL, plan.depth, feed_rate=plan.feed_rate)
    spindle = Spindle(plan.start - plan.lead * plan.acceleration, plan.acceleration)
    record = simulate_milling(machine, cut, spindle, plan.duration, 2000.0, plan.lead, plan.tail)
    return whole_record(record, (5.0, 100.0), ["x", "y", "z"])


def predicted(plan: SweepPlan, one: Pass, frequency: np.ndarray) -> np.ndarray:
    orders = orders_within(plan.tooth_passing, float(frequency.max()))
    parts = unit_harmonics(plan.tool, one.engagement(plan.tool.diameter), MATERIAL, plan.depth, orders)
    return energy(frequency, parts, orders, plan.tooth_passing, plan.duration, plan.feed_rate)


# --- forces ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "one",
    [
        Pass("down", 0.012),
        pytest.param(Pass("up", 0.05), marks=pytest.mark.slow),
        pytest.param(Pass("central", 0.065), marks=pytest.mark.slow),
    ],
)
def test_the_energy_of_a_sweep_is_that_of_the_simulated_force(one: Pass) -> None:
    plan = published(duration=30.0)
    found = spectrum(plan, one)
    for low, high in ((20.0, 24.0), (24.0, 36.0), (36.0, 45.0), (45.0, 60.0), (60.0, 80.0)):
        inside = (found.frequency >= low) & (found.frequency <= high)
        force = found.force[inside, :, 0]
        measured = np.einsum("fi,fj->ij", force, force.conj()) / inside.sum()
        wanted = predicted(plan, one, found.frequency[inside]).mean(axis=0)
        assert np.abs(wanted - measured).max() < 0.03 * np.abs(measured).max()


def test_the_edge_of_a_chirp_is_that_of_its_fresnel_integral() -> None:
    first, last, duration = 20.0, 40.0, 30.0
    rate = (last - first) / duration
    for f in (19.5, 20.0, 20.7, 30.0, 40.1):
        parts = [
            quad(lambda t, g=g, f=f: g(2 * math.pi * (first * t + rate * t**2 / 2 - f * t)), 0, duration, limit=2000)[0]
            for g in (math.cos, math.sin)
        ]
        assert float(edge_factor(f, first, last, duration)) == pytest.approx(
            rate * (parts[0] ** 2 + parts[1] ** 2), abs=1e-4
        )
    # Half the amplitude at either end, as Fresnel's integral has it.
    assert float(edge_factor(first, first, last, 1e6)) == pytest.approx(0.25, rel=1e-2)


def test_force_level_is_that_of_the_simulated_cut() -> None:
    tool, arc = Tool(0.08, 4, math.radians(45.0)), engagement("down", 0.03, 0.08)
    level = force_level(tool, arc, MATERIAL, 0.002, 1e-4)
    cut = MillingCut(tool, arc, MATERIAL, 0.002, feed_per_tooth=1e-4)
    record = simulate_milling(STIFF, cut, Spindle(60.0), 2.0, 25000.0)
    force = record["force"].values[:, 25000:]
    np.testing.assert_allclose(level.mean, force.mean(axis=1), rtol=5e-3, atol=1.0)
    assert level.peak == pytest.approx(np.linalg.norm(force, axis=0).max(), rel=0.01)


def test_torque_is_the_work_of_the_chips() -> None:
    """``M = N/(2 pi) D/2 a_p (K_tc f_z (cos phi_st - cos phi_ex) + K_te/sin k (phi_ex - phi_st))``."""
    tool, arc = Tool(0.08, 4, math.radians(45.0)), engagement("up", 0.03, 0.08)
    level = force_level(tool, arc, MATERIAL, 0.002, 1e-4)
    chip = MATERIAL.Ktc * 1e-4 * (math.cos(arc.entry) - math.cos(arc.exit))
    edge = MATERIAL.Kte / math.sin(tool.approach_angle) * arc.arc
    assert level.torque == pytest.approx(4 / (2 * math.pi) * 0.04 * 0.002 * (chip + edge), rel=5e-3)


def test_forces_are_proportional_to_the_depth_and_mirror_between_up_and_down() -> None:
    tool, arc = Tool(0.08, 4, math.radians(45.0)), engagement("up", 0.03, 0.08)
    one, two = (force_level(tool, arc, MATERIAL, a, 1e-4) for a in (0.001, 0.002))
    np.testing.assert_allclose(two.mean, 2.0 * one.mean)
    # The arc phi -> pi - phi turns the signs of the tangential part in x and of the radial part in y.
    radial = CuttingCoefficients(1e-3, 806.1e6, 291.0e6)
    up, down = (force_level(tool, engagement(c, 0.03, 0.08), radial, 0.001, 1e-4) for c in ("up", "down"))
    np.testing.assert_allclose(down.mean, up.mean * [1.0, -1.0, 1.0], atol=1e-6 * np.abs(up.mean).max() + 0.5)
    assert force_projection(radial.cutting, tool.approach_angle)[2, 2] != 0.0


def test_a_band_is_covered_when_each_harmonic_begins_before_the_one_below_it_ends() -> None:
    assert covers((20.0, 80.0), (20.0, 80.0))
    assert covers((20.0, 40.0), (20.0, 80.0))
    assert not covers((20.0, 39.0), (20.0, 80.0))
    assert covers((10.0, 27.0), (20.0, 80.0))
    assert not covers((21.0, 80.0), (20.0, 80.0))


# --- errors ---------------------------------------------------------------------------------------------------------


def test_inverse_and_condition_are_those_of_linear_algebra() -> None:
    rng = np.random.default_rng(5)
    force = rng.standard_normal((4, 7, 3, 5)) + 1j * rng.standard_normal((4, 7, 3, 5))
    gram = force @ force.conj().swapaxes(-1, -2)
    spread, condition = inverse_diagonal(gram)
    np.testing.assert_allclose(spread, np.diagonal(np.linalg.inv(gram), axis1=2, axis2=3).real, rtol=1e-9)
    for p in range(4):
        assert condition[p] == pytest.approx(max(condition_number(force[p, f]) for f in (0, 3, 6)), rel=1e-6)


def test_half_immersion_up_and_down_with_a_slot_have_no_finite_condition() -> None:
    plan = replace(published(), passes=(Pass("down", 0.04), Pass("up", 0.04), Pass("central", 0.08)))
    found = expected(plan, MATERIAL, ESTIMATE, NOISE, FREQUENCY, BANDS)
    # Where the first two harmonics meet, above 41 Hz, there is a third direction; not below.
    assert float(found["force_condition"].sel(frequency=slice(20.0, 36.0)).min()) > 200.0
    good = expected(published(), MATERIAL, ESTIMATE, NOISE, FREQUENCY, BANDS)
    assert float(good["force_condition"].max()) < 30.0
    below = [e["compliance_std"].sel(frequency=slice(22.0, 36.0)).mean() for e in (found, good)]
    assert below[0] > 10.0 * below[1]


def test_noise_falls_with_the_root_of_the_duration_and_with_the_depth() -> None:
    """``G ~ 1/rate ~ T``; the depth is linear in the force."""
    slow, fast = published(duration=120.0), published(duration=30.0)
    narrow = ONE_BAND
    noise = [
        expected(p, MATERIAL, ESTIMATE, NOISE, FREQUENCY[20:-20], narrow)["noise_std"].values
        for p in (slow, fast, replace(fast, depth=0.004), replace(fast, repeats=4))
    ]
    assert np.median(noise[1] / noise[0]) == pytest.approx(2.0, rel=0.03)
    np.testing.assert_allclose(noise[1] / noise[2], 2.0, rtol=1e-6)
    np.testing.assert_allclose(noise[1] / noise[3], 2.0, rtol=1e-6)


def test_exchanging_axes_of_machine_and_sensors_exchanges_rows() -> None:
    """A machine turned about its axes answers alike: the rows of the error follow the response axis."""
    order = [1, 2, 0]
    turned = ModalModel(MACHINE.frequency, MACHINE.damping, MACHINE.stiffness, MACHINE.direction[:, order])
    noise = tuple(np.asarray(NOISE.acceleration_noise)[order])
    plan, narrow = published(), ONE_BAND
    a = expected(plan, MATERIAL, ESTIMATE, NOISE, FREQUENCY, narrow)["noise_std"].values
    b = expected(
        plan, MATERIAL, Estimate("t", turned), Instruments(noise, NOISE.force_noise, 2000.0), FREQUENCY, narrow
    )
    np.testing.assert_allclose(b["noise_std"].values, a[:, order], rtol=1e-9)


def test_noise_of_sensors_is_white_and_its_units_are_those_of_a_compliance() -> None:
    """Twice the rate of the same rms halves the density; an rms k times as large gives k times the error."""
    plan, narrow = published(), ONE_BAND
    base = expected(plan, MATERIAL, ESTIMATE, NOISE, FREQUENCY, narrow)["noise_std"]
    double = Instruments(tuple(2.0 * n for n in NOISE.acceleration_noise), NOISE.force_noise, 8000.0)
    same = expected(plan, MATERIAL, ESTIMATE, double, FREQUENCY, narrow)["noise_std"]
    np.testing.assert_allclose(same, base, rtol=1e-9)
    assert base.attrs["units"] == "m/N"


@pytest.mark.parametrize(
    ("estimator", "seeds"),
    [
        pytest.param(LocalPolynomial(), (1,), id="default"),
        pytest.param(LocalPolynomial(), (1, 2), id="default, two sweeps", marks=pytest.mark.slow),
        pytest.param(BANDS, (1, 2), id="bands, two sweeps", marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_expected_error_and_condition_number_are_those_that_the_identification_has(
    estimator: LocalPolynomial, seeds: tuple[int, ...]
) -> None:
    """The published sweep, simulated with its noise."""
    records = [
        [SweepPass(r, cut, engagement(cut, 0.012, TOOL.diameter)) for cut, r in sweep_passes(seed=seed).items()]
        for seed in seeds
    ]
    found = [identify_sweep("s", passes, (20.0, 80.0), estimator).compliance for passes in records]
    wanted = expected(published(), MATERIAL, ESTIMATE, NOISE, FREQUENCY, estimator)
    condition = found[0]["force_condition"].values / wanted["force_condition"].values
    assert np.median(condition) == pytest.approx(1.0, abs=0.03)
    assert np.quantile(np.abs(condition - 1.0)[6:-6], 0.9) < 0.10
    difference = np.array([f["compliance"].values - MACHINE.matrix(FREQUENCY) for f in found])
    scale = ESTIMATE.scale(FREQUENCY)
    ratio = np.sqrt(np.mean(np.abs(difference) ** 2, axis=(0, 1))) / scale / relative_error(wanted, scale)
    if not estimator.rational:
        assert ratio.min() > 0.45
        assert ratio.max() < 2.0
        assert 0.8 < np.median(ratio) < 1.25
        return
    # Errors of a model are those of a few poles, and scatter from sweep to sweep: as the degrees of freedom say.
    low, high = error_interval(wanted["error_freedom"].values, 1.0 - 0.05 / 9.0, len(records))
    assert (ratio > low).all()
    assert (ratio < high).all()
    # A model that is right is hardly ever given up for a band, which has several times its variance.
    assert np.mean([f["half_width"].values > 2.01 for f in found]) > 0.97


MUCH_NOISE = Instruments((0.2, 0.2, 0.2), (5.0, 5.0, 5.0), 2000.0)


def test_the_model_has_the_poles_of_the_machine_and_errs_half_as_much_as_bands() -> None:
    """Three modes over 60 Hz are known better from all lines than a polynomial knows them from 2 Hz."""
    prediction = expected(published(), MATERIAL, ESTIMATE, MUCH_NOISE, FREQUENCY)
    assert prediction.attrs["poles"] == 3
    scale = ESTIMATE.scale(FREQUENCY)
    ratio = relative_error(prediction, scale, "bands_std") / relative_error(prediction, scale)
    assert ratio.min() > 2.0
    bands = expected(published(), MATERIAL, ESTIMATE, MUCH_NOISE, FREQUENCY, BANDS)
    np.testing.assert_allclose(prediction["bands_std"], bands["compliance_std"], rtol=1e-9)


@pytest.mark.slow
def test_noise_of_the_model_falls_with_the_root_of_the_repeats_and_not_below_what_all_its_lines_allow() -> None:
    """With n functions of frequency an entry has ``sum of G_jj var/s^2 >= n`` over lines, or more: forces are alike."""
    plan = published(duration=30.0)
    once, four = (expected(replace(plan, repeats=n), MATERIAL, ESTIMATE, MUCH_NOISE, FREQUENCY) for n in (1, 4))
    np.testing.assert_allclose(once["noise_std"] / four["noise_std"], 2.0, rtol=0.02)
    density = np.diagonal(np.sum(Forces(plan, MATERIAL, 84.0).energy(FREQUENCY), axis=0), axis1=1, axis2=2).real
    noise = MUCH_NOISE.response_noise(FREQUENCY, MACHINE.matrix(FREQUENCY))
    variance = once["noise_std"].transpose("frequency", "response", "excitation").values ** 2
    trace = 0.25 * np.sum(density[:, None, :] * variance / noise[:, :, None], axis=0)
    functions = once.attrs["poles"] + 3
    assert (trace > 0.9 * functions).all()


def quiet_ends(plan: SweepPlan, rms: float, rng: np.random.Generator) -> list[xr.Dataset]:
    """One record a pass at 1 kHz: a force of 500 N at the rising tooth passing, and noise, in the air, too."""
    time = np.arange(round(plan.record * 1000.0)) / 1000.0
    inside = time - plan.lead
    low, high = plan.tooth_passing
    turn = 2.0 * math.pi * (low * inside + 0.5 * (high - low) / plan.duration * inside**2)
    force = np.where((inside >= 0.0) & (inside <= plan.duration), 500.0 * np.sin(turn), 0.0)
    noise = rms * rng.standard_normal((plan.records, 3, time.size))
    return [make_record(time, {"force": dict(zip("xyz", force + n, strict=True))}) for n in noise]


def test_the_noise_of_the_forces_that_the_air_holds_is_predicted() -> None:
    plan, band = published(duration=8.0), (25.0, 65.0)
    foreseen = force_sensor(plan, MATERIAL, (20.0, 20.0, 20.0), 1000.0, band)
    rng = np.random.default_rng(4)
    seen = [
        force_noise([prepare(SweepPass(r, "quiet")) for r in quiet_ends(plan, 20.0, rng)], ["x", "y", "z"], band)
        for _ in range(12)
    ]
    assert all(s is not None and s.air for s in seen)
    assert foreseen.subtracted
    stated = np.median([s.spread for s in seen if s is not None])
    assert foreseen.known == pytest.approx(stated, rel=0.1)
    assert foreseen.known > SWEEP_RULES.noise_scatter
    scatter = np.array([s.density for s in seen if s is not None]) / foreseen.density
    assert np.mean(scatter) == pytest.approx(1.0, abs=3.0 * foreseen.known / 6.0)
    assert np.std(scatter) < 1.3 * foreseen.known


def test_without_air_nothing_is_taken_out_and_frequencies_that_noise_leaves_open_are_not_solved() -> None:
    """Known to a bound only, noise costs up to its whole share: a third of the compliance and more is refused."""
    plan = published(duration=10.0, lead=0.0, tail=0.0)
    sensor = force_sensor(plan, MATERIAL, (100.0, 100.0, 100.0), 2000.0, (20.0, 80.0))
    assert not sensor.subtracted
    assert sensor.known == SWEEP_RULES.bounded_scatter
    few, much = (
        expected(plan, MATERIAL, ESTIMATE, Instruments(SENSORS.acceleration_noise, (n, n, n), 2000.0), FREQUENCY, BANDS)
        for n in (5.0, 150.0)
    )
    lost = [float(np.isinf(found["force_condition"]).mean()) for found in (few, much)]
    assert lost[0] == 0.0
    assert lost[1] > 0.5
    assert much.attrs["force_noise_ratio"] > 1.0


@pytest.mark.slow
def test_no_sweep_is_expected_to_err_less_than_the_estimator_with_perfect_sensors() -> None:
    perfect = expected(published(), MATERIAL, ESTIMATE, Instruments((0.0,) * 3, (0.0,) * 3, 2000.0), FREQUENCY)
    row = np.sqrt(np.mean(np.abs(MACHINE.matrix(FREQUENCY)) ** 2, axis=2, keepdims=True))
    assert (perfect["compliance_std"].values >= 0.999 * SWEEP_RULES.model_error * row).all()
    # Which is an order of magnitude: a sweep may err by half of it.
    low, high = error_interval(perfect["error_freedom"].values, 0.95)
    assert low.max() < 0.5
    assert high.min() > 1.5


def test_records_too_short_for_the_estimator_are_refused() -> None:
    with pytest.raises(InputError, match="sweep more slowly or repeat"):
        expected(published(duration=0.1, lead=0.0, tail=0.0), MATERIAL, ESTIMATE, NOISE, FREQUENCY)


def test_harmonics_beat_where_several_pass_and_only_there() -> None:
    """Harmonic 1 runs from 20 to 51 Hz, harmonic 2 from 41 to 102 Hz, harmonic 3 from 61 Hz."""
    share = Forces(published(), MATERIAL, 80.0).beat_share(FREQUENCY)
    assert share[(FREQUENCY > 22.0) & (FREQUENCY < 38.0)].max() < 0.03
    assert share[(FREQUENCY > 43.0) & (FREQUENCY < 49.0)].min() > 0.2
    assert share.max() < 1.0


def test_an_estimate_that_ends_within_the_band_is_refused() -> None:
    short = Estimate("hammer", MACHINE.compliance(np.arange(20.0, 80.5, 0.5)))
    with pytest.raises(InputError, match=r"holds 20 to 80 Hz; .* are needed"):
        expected(published(), MATERIAL, short, NOISE, FREQUENCY)


def test_a_measured_estimate_predicts_what_its_modes_predict() -> None:
    fine = Estimate("hammer", MACHINE.compliance(np.arange(15.0, 90.0, 0.1)))
    narrow = ONE_BAND
    a = expected(published(), MATERIAL, fine, NOISE, FREQUENCY, narrow)
    b = expected(published(), MATERIAL, ESTIMATE, NOISE, FREQUENCY, narrow)
    np.testing.assert_allclose(a["noise_std"], b["noise_std"], rtol=1e-3)


@pytest.mark.slow
def test_a_measured_estimate_without_its_noise_predicts_what_its_modes_predict() -> None:
    fine = Estimate("hammer", MACHINE.compliance(np.arange(15.0, 90.0, 0.1)))
    scale = ESTIMATE.scale(FREQUENCY)
    smooth = replace(fine, smooth=without_noise(fine.source, (20.0, 80.0)))
    both = [
        relative_error(expected(published(), MATERIAL, e, MUCH_NOISE, FREQUENCY), scale) for e in (smooth, ESTIMATE)
    ]
    np.testing.assert_allclose(both[0], both[1], rtol=0.1)


def noisy_estimate(stated: bool) -> xr.Dataset:
    """Compliance of the machine with 2 % noise, its standard deviation stated or not."""
    f = np.arange(15.0, 90.0, 0.25)
    truth = MACHINE.compliance(f)
    rng = np.random.default_rng(3)
    std = 0.02 * ESTIMATE.scale(FREQUENCY) * np.ones((f.size, 1, 1))
    noise = (rng.standard_normal(std.shape) + 1j * rng.standard_normal(std.shape)) * std / math.sqrt(2.0)
    noisy = truth.assign(compliance=truth["compliance"] + noise, compliance_std=(truth["compliance"].dims, std))
    noisy["compliance"].attrs = truth["compliance"].attrs
    noisy["compliance_std"].attrs["units"] = "m/N"
    return noisy if stated else noisy.drop_vars("compliance_std")


@pytest.mark.parametrize("stated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_noise_of_a_measured_estimate_is_not_taken_for_modes(stated: bool) -> None:
    """The estimate of a hammer test has the poles of its machine: noise that were fitted would cost twelve."""
    source = noisy_estimate(stated)
    measured = Estimate("hammer", source, smooth=without_noise(source, (20.0, 80.0)))
    assert measured.smooth is not None
    assert measured.smooth.attrs["poles"] <= 4
    left = np.abs(measured.matrix(FREQUENCY) - MACHINE.matrix(FREQUENCY)) / ESTIMATE.scale(FREQUENCY)
    assert np.sqrt(np.mean(left**2)) < 0.01


@pytest.mark.slow
def test_a_noisy_estimate_predicts_what_its_modes_predict() -> None:
    source = noisy_estimate(stated=False)
    measured = Estimate("hammer", source, smooth=without_noise(source, (20.0, 80.0)))
    scale = ESTIMATE.scale(FREQUENCY)
    found, wanted = (expected(published(), MATERIAL, e, MUCH_NOISE, FREQUENCY) for e in (measured, ESTIMATE))
    ratio = relative_error(found, scale) / relative_error(wanted, scale)
    assert ratio.min() > 0.75
    assert ratio.max() < 1.33


def test_chips_thinner_than_an_edge_are_named() -> None:
    """``f_z sin(phi) sin(kappa)`` with ``cos(phi) = 1 - 2 a_e/D``: 0.4 mm of 80 mm leave 5 um of 0.05 mm a tooth."""
    assert "chips are thinner than 10 um in down 0.4 mm (3.9 um)" in thin_chips(published(0.0004))[0]
    assert not thin_chips(published())
