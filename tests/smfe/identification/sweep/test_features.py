"""What the sweep estimate takes out or finds: noise of the forces, spindle lines, posture, asymmetry, dynamometers."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from samples.linear_machine import MATERIAL
from scipy import stats
from scipy.signal import resample

from process.cut.engagement import engagement
from process.cut.tool import Tool
from process.errors import InputError
from process.instruments.sensors import Inertia, Resonance
from process.labels import make_record
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle, simulate_forced, simulate_milling
from smfe import LocalPolynomial, Segments, SweepPass, identify_sweep
from smfe.identification.errors.difference import reciprocity, symmetric
from smfe.identification.spectra.spindle_angle import force_angle, spindle_angle, tacho_angle
from smfe.identification.sweep.order_tracking import Orders
from smfe.records.dynamometer import Dynamometer, compensate

BAND = (20.0, 80.0)
RATE = 400.0
SPINDLE = Spindle(20.0 * math.pi, 3.2)
MACHINE = ModalModel(
    np.array([29.0, 50.6, 72.0]),
    np.array([0.05, 0.04, 0.03]),
    np.array([40e6, 32e6, 50e6]),
    np.array([[0.3, 0.8, 0.52], [0.1, -0.7, 0.71], [0.95, 0.1, 0.3]]),
)
COARSE = LocalPolynomial(resolution=1.0)
QUICK = LocalPolynomial(2.0, (0.5, 1.0, 2.0), rational=False)
QUICK_MOVING = LocalPolynomial(2.0, (0.5, 1.0, 2.0), rational=False, position_dependent=True)


@functools.cache
def cut_record(cut: str, depth: float = 0.8e-3) -> xr.Dataset:
    """Twenty-seven seconds of one pass, 600 to 1425 rpm, two inserts with 8 um of run-out, without noise.

    The step is an eighth of the default, whose error of 4e-4 of the compliance is a third of the standard deviation of
    the direct entries: intervals would be judged by a truth that is wrong.
    """
    tool = Tool(0.08, 2, math.pi / 4.0, runout=(8e-6, -8e-6))
    mill = MillingCut(tool, engagement(cut, 0.012, 0.08), MATERIAL, depth, feed_rate=2e-3)
    return simulate_milling(MACHINE, mill, SPINDLE, 27.0, RATE, 0.5, 2.0, step=2e-5).drop_vars("displacement")


def noisy(record: xr.Dataset, rng: np.random.Generator, force: float = 0.42, motion: float = 3.4e-3) -> xr.Dataset:
    """Densities of 1.5 N and 0.012 m/s2 rms at 5 kHz."""
    out = record.copy()
    out["force"] = out["force"] + force * rng.standard_normal(out["force"].shape)
    out["acceleration"] = out["acceleration"] + motion * rng.standard_normal(out["acceleration"].shape)
    return out


def passes(seed: int, **noise: float) -> list[SweepPass]:
    rng = np.random.default_rng(seed)
    cuts = ("down", "up", "central")
    return [SweepPass(noisy(cut_record(c), rng, **noise), c, engagement(c, 0.012, 0.08)) for c in cuts]


def truth(compliance: xr.Dataset) -> np.ndarray:
    return MACHINE.matrix(compliance["frequency"].values)


def error(compliance: xr.Dataset) -> float:
    """Rms error over the rms compliance, median of the entries."""
    e = np.abs(compliance["compliance"].values - truth(compliance)) ** 2
    assert np.isfinite(e).mean() > 0.9
    return float(np.median(np.sqrt(np.nanmean(e, axis=0) / np.mean(np.abs(truth(compliance)) ** 2))))


# --- intervals --------------------------------------------------------------------------------------------------------


def inside(compliance: xr.Dataset) -> np.ndarray:
    """Whether 95 % intervals of real and imaginary parts hold the truth, shape (2, f, r, e)."""
    d = compliance["compliance"].values - truth(compliance)
    factor = stats.t.ppf(0.975, compliance["degrees_of_freedom"].values) / math.sqrt(2.0)
    width = factor * compliance["compliance_std"].values
    return np.array([np.abs(d.real) <= width, np.abs(d.imag) <= width])


@pytest.mark.slow
def test_intervals_of_95_percent_hold_the_truth_in_92_to_98_percent_of_50_seeds() -> None:
    coarser = LocalPolynomial(resolution=2.0)
    hits = np.mean([inside(identify_sweep("s", passes(k), BAND, coarser).compliance) for k in range(50)], axis=0)
    assert 0.92 < hits.mean() < 0.98
    frequency = np.arange(20.0, 80.5, 2.0)
    near = np.min(np.abs(frequency[:, None] - MACHINE.frequency) / (MACHINE.damping * MACHINE.frequency), axis=1) < 1.0
    for where in (near, ~near):
        assert 0.92 < hits[:, where].mean() < 0.98
    # Each part of each entry for itself.
    assert hits.mean(axis=1).min() > 0.92
    assert hits.mean(axis=1).max() < 0.98


@pytest.mark.slow
def test_wide_bands_and_the_model_beat_the_narrow_band_and_stay_calibrated() -> None:
    data = passes(3)
    both = identify_sweep("s", data, BAND, COARSE).compliance
    narrow = identify_sweep("s", data, BAND, LocalPolynomial(1.0, (0.125, 0.25, 0.5, 1.0), rational=False)).compliance
    assert error(both) < 0.5 * error(narrow)
    assert 0.88 < inside(both).mean() <= 1.0


# --- noise on the forces ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_noise_of_the_forces_is_taken_out_not_only_charged() -> None:
    quiet, noisier = (
        _gain(identify_sweep("s", passes(1, force=n), (25.0, 60.0), QUICK).compliance) for n in (0.0, 5.0)
    )
    # Least squares would lose N (F F^H)^-1 of it, several per cent.
    lost = _gain(identify_sweep("s", passes(1, force=5.0), (25.0, 60.0), Segments(1.0)).compliance)
    assert quiet == pytest.approx(1.0, abs=2e-3)
    assert lost < 0.98
    assert abs(noisier - 1.0) < 0.35 * abs(lost - 1.0)


def _gain(compliance: xr.Dataset) -> float:
    """Projection of the estimate on the truth."""
    t = truth(compliance)
    return float(np.vdot(t, compliance["compliance"].values).real / np.vdot(t, t).real)


def test_noise_does_not_make_dependent_passes_independent() -> None:
    # Three times the same cut: without the noise taken out, it would fill the missing directions.
    rng = np.random.default_rng(1)
    data = [SweepPass(noisy(cut_record("down"), rng, force=4.0), f"down {k}") for k in range(3)]
    with pytest.raises(InputError, match="not independent"):
        identify_sweep("s", data, BAND, LocalPolynomial(1.0, rational=False))
    found = identify_sweep("s", data, (40.0, 45.0), Segments(1.0)).compliance
    assert found["force_condition"].median() < 200.0


# --- what turns with the spindle --------------------------------------------------------------------------------------


@functools.cache
def unbalance(seconds: float = 29.5) -> xr.Dataset:
    """Response to unmeasured forces at orders 1 to 4 of the spindle, growing with its square."""
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    angle, speed = SPINDLE.angle(t), SPINDLE.speed(t) / 900.0
    force = np.zeros((3, n))
    for order, size in enumerate((8.0, 5.0, 4.0, 6.0), 1):
        force[0] += size * speed**2 * np.cos(order * angle + order)
        force[1] += size * speed**2 * np.sin(order * angle + order)
    record = simulate_forced(MACHINE, force, RATE).drop_vars("displacement")
    record["force"] = 0.0 * record["force"]
    record["spindle_angle"] = ("time", angle)
    return record


def test_an_air_cut_takes_out_what_the_spindle_shakes() -> None:
    shaken = []
    for p in passes(2):
        record = p.record.copy()
        record["acceleration"] = record["acceleration"] + unbalance()["acceleration"].values
        shaken.append(SweepPass(record, p.label, p.arc))
    air = SweepPass(noisy(unbalance(), np.random.default_rng(9)), "air")
    narrow = LocalPolynomial(2.0, (0.25, 0.5, 1.0), rational=False)
    ignored = identify_sweep("s", shaken, (25.0, 60.0), narrow).compliance
    found = identify_sweep("s", shaken, (25.0, 60.0), narrow, background=[air]).compliance
    undisturbed = identify_sweep("s", passes(2), (25.0, 60.0), narrow).compliance
    assert error(ignored) > 0.1
    assert error(found) < 2.5 * error(undisturbed)
    assert inside(found).mean() > 0.88


def test_an_air_cut_needs_the_local_polynomial() -> None:
    air = SweepPass(unbalance(), "air")
    with pytest.raises(InputError, match="local polynomial only"):
        identify_sweep("s", passes(1), BAND, Segments(1.0), background=[air])


def test_the_instrument_changes_nothing_where_there_is_no_bias() -> None:
    data = passes(4)
    plain = identify_sweep("s", data, BAND, QUICK).compliance
    teeth = identify_sweep("s", data, BAND, replace(QUICK, instrument_teeth=2)).compliance
    spread = np.hypot(plain["compliance_std"], teeth["compliance_std"]).values
    ratio = np.abs(plain["compliance"].values - teeth["compliance"].values) / spread
    assert np.sqrt(np.mean(ratio**2)) < 1.3
    assert error(teeth) < 0.02


# --- the angle of the spindle and order tracking ----------------------------------------------------------------------


def test_tacho_pulses_and_the_force_give_the_angle() -> None:
    record = noisy(cut_record("down"), np.random.default_rng(1))
    true = record["spindle_angle"].values
    pulses = 5.0 * (np.mod(2.0 * true, 2.0 * math.pi) < math.pi) + 0.05 * np.random.default_rng(2).normal(
        size=true.size
    )
    record["tacho"] = ("time", pulses, {"pulses_per_revolution": 2.0})
    bare = record.drop_vars(["spindle_angle", "spindle_speed"])
    angle, source = spindle_angle(bare)
    assert source == "tacho"
    inner = slice(400, -1200)
    # An edge is seen to a sample: 2 pi 24 Hz/400 Hz.
    assert np.ptp((angle - true)[inner]) < 0.6
    by_force, source = spindle_angle(bare.drop_vars("tacho"), teeth=2)
    assert source == "force"
    cutting = slice(round(1.0 * RATE), round(26.5 * RATE))
    assert np.ptp((by_force - true)[cutting]) < 0.1
    assert spindle_angle(record)[1] == "spindle_angle"
    np.testing.assert_allclose(
        np.diff(spindle_angle(record.drop_vars(["spindle_angle", "tacho"]))[0]), np.diff(true), atol=1e-3
    )


def turning_force(run_out: float) -> xr.Dataset:
    """Two teeth at 6 to 12 turns a second: 100 N at their passing, each multiple 0.6 of the one before, run-out."""
    t = np.arange(20_000) * 1e-3
    turn = 2.0 * math.pi * (6.0 * t + 0.15 * t**2)
    passing = sum(100.0 * 0.6**k * np.cos(2.0 * (k + 1) * (turn + 0.3)) for k in range(4))
    force = passing + 100.0 * run_out * (np.cos(turn + 0.5) + np.cos(3.0 * turn) / 3.0)
    noise = np.random.default_rng(0).normal(scale=1.5, size=(2, t.size))
    return make_record(t, {"force": {"x": force + noise[0], "y": 0.7 * force + noise[1]}})


def test_a_little_run_out_distinguishes_a_tooth_from_a_turn() -> None:
    inside = slice(1000, -1000)
    t = np.arange(20_000)[inside] * 1e-3
    angle = force_angle(turning_force(0.05), 2)[inside]
    assert np.ptp(angle) == pytest.approx(np.ptp(2.0 * math.pi * (6.0 * t + 0.15 * t**2)), rel=1e-5)


@pytest.mark.parametrize("run_out", [0.0, 0.5, 1.0, 2.0])
def test_a_period_that_may_be_of_a_tooth_or_of_a_turn_is_refused(run_out: float) -> None:
    """Without run-out, and with so much that one tooth does most: half of the speed would fit as well."""
    with pytest.raises(InputError, match="whether one of 2 teeth passes then or the whole tool turns"):
        force_angle(turning_force(run_out), 2)


def test_a_tacho_that_loses_a_pulse_or_stands_still_is_refused() -> None:
    t = np.arange(4000) / 1000.0
    level = (np.mod(10.0 * t, 1.0) < 0.5).astype(float)
    level[1000:1100] = 0.0
    with pytest.raises(InputError, match="a pulse is lost or false"):
        tacho_angle(t, level)
    with pytest.raises(InputError, match="rising edges"):
        tacho_angle(t, np.zeros(t.size))
    bare = make_record(t, {"displacement": {"x": t}})
    with pytest.raises(InputError, match="holds no spindle angle"):
        spindle_angle(bare)
    with pytest.raises(InputError, match="too short to find the tooth passing"):
        force_angle(make_record(t[:2000], {"force": {"x": np.sin(t[:2000])}}), 2)


@pytest.mark.parametrize("known", [pytest.param(True, marks=pytest.mark.slow), False])
def test_order_tracking_finds_the_compliance_at_any_sweep_rate_also_by_the_angle_of_the_force(known: bool) -> None:
    data = passes(5)
    if not known:
        data = [SweepPass(p.record.drop_vars(["spindle_angle", "spindle_speed"]), p.label, p.arc) for p in data]
    found = identify_sweep("s", data, (22.0, 78.0), Orders(2, resolution=1.0)).compliance
    assert error(found) < 0.02
    assert 0.9 < inside(found).mean() <= 1.0


@pytest.mark.slow
def test_order_tracking_follows_a_sweep_that_crosses_a_resonance_while_it_rings() -> None:
    """2 Hz/s: in the 0.3 s that a mode rings the order moves by a third of its width. Plain ratios are 9 % wrong."""
    tool, spindle = Tool(0.08, 2, math.pi / 4.0, runout=(8e-6, -8e-6)), Spindle(20.0 * math.pi, 6.4)
    rng, data = np.random.default_rng(1), []
    for cut in ("down", "up", "central"):
        mill = MillingCut(tool, engagement(cut, 0.012, 0.08), MATERIAL, 0.8e-3, feed_rate=2e-3)
        record = simulate_milling(MACHINE, mill, spindle, 13.5, RATE, 0.5, 2.0).drop_vars("displacement")
        data.append(SweepPass(noisy(record, rng), cut))
    found = identify_sweep("s", data, (22.0, 78.0), Orders(2, resolution=1.0)).compliance
    assert error(found) < 0.03
    assert np.isfinite(found["compliance"].values).all()


def test_orders_that_miss_the_band_are_refused_with_what_to_do() -> None:
    with pytest.raises(InputError, match="sweep more slowly through this band, or follow more harmonics"):
        identify_sweep("s", passes(5), (60.0, 78.0), Orders(2, harmonics=1))


def shaken(machine: ModalModel, force: np.ndarray) -> xr.Dataset:
    """Response to a force that is smooth between its samples."""
    fine = resample(force, 10 * force.shape[1], axis=1)
    return simulate_forced(machine, fine, 10 * RATE, keep=10).drop_vars("displacement")


# --- fewer axes, posture, reciprocity ---------------------------------------------------------------------------------


def test_two_axes_and_one_axis_are_enough_for_a_machine_that_moves_along_them() -> None:
    flat = ModalModel(
        MACHINE.frequency, MACHINE.damping, MACHINE.stiffness, np.array([[1.0, 0.3, 0], [0.2, 1, 0], [1, -0.5, 0]])
    )
    rng = np.random.default_rng(3)
    data = []
    for name in ("a", "b"):
        force = np.zeros((3, 8000))
        force[:, 400:6000] = 100.0 * rng.standard_normal((3, 5600))
        record = shaken(flat, force)
        record["force"] = record["force"].where(record["axis"] != "z")
        data.append(SweepPass(record, name))
    found = identify_sweep("s", data, (25.0, 70.0), COARSE, axes=("x", "y"))
    exact = flat.matrix(found.compliance["frequency"].values)[:, :, :2]
    assert list(found.compliance["excitation"].values) == ["x", "y"]
    assert np.abs(found.compliance["compliance"].values - exact).max() < 0.01 * np.abs(exact).max()
    assert any("forces along z are no references" in w for w in found.warnings)
    for p in data:
        p.record["force"] = p.record["force"].where(p.record["axis"] == "x", 0.0)
    single = identify_sweep("s", data[:1], (25.0, 70.0), COARSE, axes=("x",)).compliance
    assert single.sizes["excitation"] == 1
    with pytest.raises(InputError, match=r"2 passes .*need three"):
        identify_sweep("s", data, BAND)
    with pytest.raises(InputError, match="four compliances need two passes"):
        identify_sweep("s", data[:1], BAND, axes=("x", "y"))


def test_a_compliance_that_changes_along_the_pass_is_found_with_its_change() -> None:
    # Forces in all directions at all times, so that place and frequency are not tied to each other.
    rng = np.random.default_rng(6)
    stiff, soft = (
        ModalModel(MACHINE.frequency, MACHINE.damping, MACHINE.stiffness * k, MACHINE.direction) for k in (1.05, 0.95)
    )
    data, n = [], 16000
    for name in "abc":
        force = np.zeros((3, n))
        force[:, 200:15200] = 100.0 * rng.standard_normal((3, 15000))
        ends = [shaken(m, force) for m in (stiff, soft)]
        share = np.clip((np.arange(n) - 200) / 15000, 0.0, 1.0)
        record = ends[0].copy()
        record["acceleration"] = (1.0 - share) * ends[0]["acceleration"] + share * ends[1]["acceleration"]
        data.append(SweepPass(record, name))
    found = identify_sweep("s", data, (25.0, 70.0), QUICK_MOVING).compliance
    f = found["frequency"].values
    middle, change = 0.5 * (stiff.matrix(f) + soft.matrix(f)), 0.5 * (soft.matrix(f) - stiff.matrix(f))
    assert np.abs(found["compliance"].values - middle).max() < 0.02 * np.abs(middle).max()
    assert np.sqrt(np.mean(np.abs(found["compliance_gradient"].values - change) ** 2)) < 0.2 * np.sqrt(
        np.mean(np.abs(change) ** 2)
    )


def test_reciprocity_is_tested_and_as_a_constraint_lowers_error_and_std() -> None:
    free, tied = (
        identify_sweep("s", passes(7), BAND, LocalPolynomial(1.0, rational=False), reciprocal=r).compliance
        for r in (False, True)
    )
    assert reciprocity(free).p_value > 1e-4
    value = tied["compliance"].values
    np.testing.assert_allclose(value, value.swapaxes(1, 2), rtol=1e-9)
    assert error(tied) < error(free)
    assert (tied["compliance_std"] <= free["compliance_std"] * (1.0 + 1e-9)).all()
    z = np.abs(value - truth(tied)) / tied["compliance_std"].values
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.4
    skew = free.copy(deep=True)
    skew["compliance"].loc[{"response": "x", "excitation": "y"}] *= 1.5
    assert reciprocity(skew).p_value < 1e-6
    np.testing.assert_allclose(symmetric(tied)["compliance"].values, value, rtol=1e-6)


def test_a_compliance_that_is_not_reciprocal_is_not_made_so_silently() -> None:
    data = passes(7)
    for p in data:
        p.record["acceleration"] = p.record["acceleration"] * xr.DataArray(
            [1.0, 1.3, 1.0], {"axis": ["x", "y", "z"]}, ("axis",)
        )
    found = identify_sweep("s", data, BAND, QUICK, reciprocal=True)
    assert any("not reciprocal" in w for w in found.warnings)


# --- symmetries -------------------------------------------------------------------------------------------------------


def test_order_of_passes_signs_and_units_change_what_they_should_and_nothing_else() -> None:
    data = passes(8)
    plain = identify_sweep("s", data, (30.0, 60.0), QUICK).compliance
    turned = identify_sweep("s", data[::-1], (30.0, 60.0), QUICK).compliance
    np.testing.assert_allclose(turned["compliance"].values, plain["compliance"].values, rtol=1e-5, atol=1e-13)
    sign = np.array([1.0, -1.0, 1.0])
    axis = xr.DataArray(sign, {"axis": ["x", "y", "z"]}, ("axis",))
    flipped = [SweepPass(p.record.assign(force=p.record["force"] * axis), p.label, p.arc) for p in data]
    found = identify_sweep("s", flipped, (30.0, 60.0), QUICK).compliance
    np.testing.assert_allclose(found["compliance"].values * sign, plain["compliance"].values, rtol=1e-5, atol=1e-13)
    scaled = [SweepPass(p.record.assign(force=p.record["force"] * 1e-3), p.label, p.arc) for p in data]
    found = identify_sweep("s", scaled, (30.0, 60.0), QUICK).compliance
    for name in ("compliance", "compliance_std"):
        np.testing.assert_allclose(found[name].values * 1e-3, plain[name].values, rtol=1e-5, atol=1e-13)


# --- dynamometers -----------------------------------------------------------------------------------------------------


def test_resonance_and_inertia_of_a_dynamometer_are_undone() -> None:
    rng = np.random.default_rng(0)
    clean = cut_record("down")
    shown = Resonance("force", 150.0, 0.03).apply(Inertia(40.0).apply(clean, rng), rng)
    back = compensate(shown, Dynamometer(40.0, 150.0, 0.03))
    spectra = [np.fft.rfft(r["force"].values)[:, 300:2300] for r in (clean, shown, back)]
    size = np.abs(spectra[0]).max(axis=1, keepdims=True)
    assert (np.abs(spectra[1] - spectra[0]) / size).max() > 0.05
    assert (np.abs(spectra[2] - spectra[0]) / size).max() < 2e-3


def test_the_closed_form_of_a_dynamometer_is_that_of_a_mass_on_a_spring() -> None:
    d = Dynamometer(frequency=(400.0, 300.0, 200.0), damping=0.02)
    assert abs(1.0 / d.inverse_response(40.0, "x")) == pytest.approx(1.0 / (1.0 - 0.01), rel=1e-4)
    assert d.inverse_response(100.0, "z") == pytest.approx(0.75 + 0.02j)
    assert d.inverse_response(500.0, "z") == d.inverse_response(140.0, "z")
    still = make_record(np.arange(100) / 1e3, {"force": {"x": np.ones(100)}})
    np.testing.assert_allclose(compensate(still, Dynamometer())["force"].values, 1.0, rtol=1e-12)
    with pytest.raises(InputError, match="needs its acceleration"):
        compensate(still, Dynamometer(mass=1.0))
    with pytest.raises(InputError, match="natural frequency is positive"):
        Dynamometer(frequency=0.0)
