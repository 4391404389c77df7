"""A whole machine in time: closed forms of its linear part, reciprocity, energy, cuts, sampled servos, joints.

Numbers marked as reference come from an independent program (the same equations, another implementation).
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.sampled_servo import SampledServo
from process.drive.servo import Servo, tune
from process.errors import InputError
from process.friction.laws import Andersson, CoulombViscous, GeneralisedMaxwellSlip, LuGre, Viscous
from process.machine.joints import CubicSpring, DoublePinion, Gap, Iwan, Jenkins, Joint
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.modes import ModalModel
from process.machine.structure import Posture, Structure, free_modes, released_modes, two_mass_axes
from process.simulation import _element_kernels as kernels
from process.simulation.excitation import Chirp, HalfSine, SteppedSine
from process.simulation.machine import count_unstable, simulate_machine, step_error
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from process.simulation.problem import SampledControl

MM_MIN = 1.0 / 6e4
BENCH = Drive(23.1, 11.3, 1.68e6, 104.0)
SERVOS = {
    "K1": Servo(3242.0, 21.2e-3, 23.5),
    "K2": Servo(6268.0, 10.9e-3, 45.5),
    "K3": Servo(10590.0, 6.5e-3, 76.9),
}
ANDERSSON = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
SLOT = engagement("up", 0.0508, 0.0508)
CUTTER, ALUMINIUM = Tool(0.0508, 4), CuttingCoefficients(780e6, 351e6, 0.0)
# Three coupled modes in space, of the size of a ram.
RAM = ModalModel(
    [24.0, 29.0, 33.5], [0.022, 0.026, 0.03], [4e7, 6e7, 5e7], [[0.1, 0.7, 0.6], [0.6, -0.5, 0.2], [0.9, 0.1, -0.3]]
)
MASS = {"x": 9000.0, "y": 6000.0}


def bench(servo: str | None = "K2", friction: Andersson | CoulombViscous | LuGre | Viscous = ANDERSSON) -> Machine:
    return Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(SERVOS[servo] if servo else None, friction)})


def ram(friction: float = 2e3, delay: float = 1e-3) -> Machine:
    axes = {a: FeedAxis(tune(20.0, m, delay), Viscous(friction)) for a, m in MASS.items()}
    return Machine(released_modes(RAM, MASS), axes)


def half_sine_spectrum(f: np.ndarray, hit: HalfSine) -> np.ndarray:
    w, a = 2 * np.pi * f, np.pi / hit.duration
    shift = np.exp(-1j * w * hit.start)
    return hit.impulse * a / 2 * a / (a**2 - w**2) * (1 + np.exp(-1j * w * hit.duration)) * shift


@pytest.mark.parametrize("delay", [*(pytest.param(d, marks=pytest.mark.slow) for d in (0.0, 1e-3)), 0.7531e-3])
def test_without_nonlinearity_hits_measure_the_whole_matrix_of_the_machine(delay: float) -> None:
    # Compliance in three directions, coupled modes, two servos: time against closed form, to a millionth.
    machine, hit, f = ram(delay=delay), HalfSine(5.0, 4.5e-3, 0.0), np.arange(4.25, 60.0, 0.5)
    expected, found = machine.at(0.0).matrix(f), np.empty((f.size, 3, 3), dtype=complex)
    kernel = np.exp(-2j * np.pi * np.outer(f, np.arange(80_000) / 10e3)) / 10e3
    for column, axis in enumerate("xyz"):
        record = simulate_machine(machine, duration=8.0, forces={axis: hit}, sample_rate=10e3)
        found[:, :, column] = kernel @ record["displacement"].values.T / half_sine_spectrum(f, hit)[:, None]
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_the_response_at_i_to_a_force_at_j_is_that_at_j_to_i() -> None:
    # Maxwell and Betti, sample by sample, with servos and dead times.
    machine, shake = ram(), Chirp(5.0, 80.0, 300.0, 1.0)
    runs = {a: simulate_machine(machine, duration=1.5, forces={a: shake})["displacement"] for a in "xyz"}
    for i, j in (("x", "y"), ("x", "z"), ("y", "z")):
        one, other = runs[j].sel(axis=i).values, runs[i].sel(axis=j).values
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(one).max())


def test_a_drive_force_moves_the_tool_as_a_tool_force_moves_the_slide() -> None:
    machine, shake = ram(), Chirp(5.0, 80.0, 300.0, 1.0)
    pushed = simulate_machine(machine, duration=1.5, drive_forces={"x": shake})["displacement"].sel(axis="z").values
    hit = simulate_machine(machine, duration=1.5, forces={"z": shake})["encoder_position"].sel(axis="x").values
    np.testing.assert_allclose(pushed, hit, atol=1e-8 * np.abs(hit).max())


def test_two_axes_with_friction_are_two_machines_of_one_axis() -> None:
    drives = {"x": BENCH, "y": replace(BENCH, moving_mass=40.0)}
    feed = {"x": 30.0 * MM_MIN, "y": 0.0}
    hits = {"x": HalfSine.from_peak(300.0), "y": HalfSine.from_peak(700.0, 3e-3)}
    axes = {a: FeedAxis(SERVOS[k], ANDERSSON) for a, k in (("x", "K2"), ("y", "K3"))}
    both = simulate_machine(Machine(two_mass_axes(drives), axes), duration=0.6, feed=feed, forces=hits, step=50e-6)
    for a in "xy":
        machine = Machine(two_mass_axes({a: drives[a]}), {a: axes[a]})
        one = simulate_machine(machine, duration=0.6, feed=feed[a], forces={a: hits[a]}, step=50e-6)
        for name in ("displacement", "encoder_position", "drive_force", "acceleration"):
            alone = one[name].sel(axis=a).values
            np.testing.assert_allclose(both[name].sel(axis=a).values, alone, atol=3e-6 * np.ptp(alone))


def test_coupled_slides_with_friction_keep_their_energy_and_converge() -> None:
    law = CoulombViscous(300.0, 2e3, 15000.0)
    structure = released_modes(RAM, MASS)
    machine = Machine(structure, {a: FeedAxis(tune(20.0, m), law) for a, m in MASS.items()})
    hits = {"x": HalfSine.from_peak(8000.0), "y": HalfSine.from_peak(6000.0)}
    for feed in (0.0, {"x": 20.0 * MM_MIN, "y": -5.0 * MM_MIN}):
        record = simulate_machine(machine, duration=0.5, feed=feed, forces=hits)
        assert record.attrs["energy_error"] < 1e-4
        assert step_error(machine, duration=0.3, feed=feed, forces=hits) < 1e-4


JOINTS: dict[str, Joint] = {
    "cubic": CubicSpring(1e6, 3e14),
    "gap": Gap(4e6, 20e-6),
    "Jenkins": Jenkins(3e6, 60.0),
    "Iwan": Iwan(3e6, 120.0, 20),
    "double pinion": DoublePinion(2e6, 1e6, 15e-6, 20.0),
}


def one_mass(joint: Joint | None) -> Machine:
    structure = Structure([[11.3]], [[104.0]], [[1.68e6]], [[1.0], [0.0], [0.0]])
    return Machine(structure, {}, [MountedJoint(joint, [1.0])] if joint else [])


@pytest.mark.parametrize("name", JOINTS)
def test_a_joint_satisfies_the_equation_of_motion(name: str) -> None:
    # From the record alone: m a + c v + k x + joint(history of x) = F, at every sample.
    rate = 40e3
    hit = HalfSine.from_peak(300.0, 5e-3, 0.0)
    record = simulate_machine(one_mass(JOINTS[name]), duration=0.2, forces={"x": hit}, sample_rate=rate, step=25e-6)
    x, a, force = (record[v].sel(axis="x").values for v in ("displacement", "acceleration", "force"))
    rest = 11.3 * a + 104.0 * np.gradient(x, 1 / rate, edge_order=2) + 1.68e6 * x + JOINTS[name].force(x) - force
    assert np.abs(rest[2:-2]).max() < 1e-3 * 300.0
    assert record.attrs["energy_error"] < 1e-4


def test_a_joint_that_is_linear_is_a_spring() -> None:
    hit = HalfSine.from_peak(300.0)
    stiff = Machine(Structure([[11.3]], [[104.0]], [[2.68e6]], [[1.0], [0.0], [0.0]]))
    runs = [
        simulate_machine(m, duration=0.3, forces={"x": hit}, sample_rate=8e3)["displacement"].values[0]
        for m in (one_mass(CubicSpring(1e6, 0.0)), stiff)
    ]
    np.testing.assert_allclose(runs[0], runs[1], atol=2e-6 * np.abs(runs[1]).max())


def runge_kutta(joint: Joint, hit: HalfSine, step: float, steps: int) -> np.ndarray:
    """Displacement of `one_mass` after each step, by the classical method of order 4 and nothing else."""

    def rate(t: float, x: float, v: float) -> tuple[float, float]:
        inside = hit.start < t < hit.start + hit.duration
        push = 300.0 * math.sin(math.pi * (t - hit.start) / hit.duration) if inside else 0.0
        return v, (push - 104.0 * v - 1.68e6 * x - float(joint.force(x))) / 11.3

    x = v = 0.0
    out = [x]
    for i in range(steps):
        t = i * step
        a, b = rate(t, x, v)
        c, d = rate(t + step / 2, x + step / 2 * a, v + step / 2 * b)
        e, f = rate(t + step / 2, x + step / 2 * c, v + step / 2 * d)
        g, h = rate(t + step, x + step * e, v + step * f)
        x, v = x + step / 6 * (a + 2 * c + 2 * e + g), v + step / 6 * (b + 2 * d + 2 * f + h)
        out.append(x)
    return np.array(out)


@pytest.mark.parametrize("preload", [0.0, pytest.param(20.0, marks=pytest.mark.slow), 80.0])
def test_a_double_pinion_moves_as_integrated_by_runge_kutta(preload: float) -> None:
    # Both pinions lift off, and the free tooth of the master meets its other flank.
    joint, hit = DoublePinion(2e6, 1e6, 15e-6, preload), HalfSine.from_peak(300.0, 5e-3, 0.0)
    x = simulate_machine(one_mass(joint), duration=0.05, forces={"x": hit}, sample_rate=40e3)["displacement"].values[0]
    low, high = joint.lift_off_displacements
    assert x.min() < low
    assert x.max() > high + 15e-6
    reference = runge_kutta(joint, hit, 5e-6, 10000)[:: round(1.0 / 40e3 / 5e-6)]
    assert np.abs(x - reference[: x.size]).max() < 2e-4 * np.abs(x).max()


def test_a_double_pinion_that_does_not_lift_off_is_two_springs() -> None:
    joint, hit = DoublePinion(2e6, 1e6, 15e-6, 100.0), HalfSine.from_peak(50.0, 5e-3)
    stiff = Machine(Structure([[11.3]], [[104.0]], [[1.68e6 + 3e6]], [[1.0], [0.0], [0.0]]))
    records = (simulate_machine(m, duration=0.2, forces={"x": hit}) for m in (one_mass(joint), stiff))
    x, y = (record["displacement"].values[0] for record in records)
    assert np.abs(y).max() < min(np.abs(joint.lift_off_displacements))
    # The hit loads the master away from its flank and the slave onto it; together they stay linear.
    np.testing.assert_allclose(x, y, atol=1e-4 * np.abs(y).max())


LUGRE = LuGre(1e7, 300.0, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
MAXWELL = GeneralisedMaxwellSlip((4e6, 3e6, 3e6), (0.3, 0.3, 0.4), 44.2, 84.0, 387.4 * MM_MIN, 168.0, 2000.0)


@pytest.mark.parametrize("law", [LUGRE, MAXWELL], ids=["LuGre", "Maxwell slip"])
@pytest.mark.parametrize("feed", [0.0, 500.0])
def test_friction_with_memory_is_that_of_its_history(law: LuGre | GeneralisedMaxwellSlip, feed: float) -> None:
    # Take the law's own history along the carriage's motion; carriage without servo: m a = joint - friction.
    machine, rate = bench("K2", law), 50e3  # type: ignore[arg-type]
    hit = HalfSine.from_peak(200.0, start=0.0)
    record = simulate_machine(machine, duration=0.1, feed=feed * MM_MIN, forces={"x": hit}, sample_rate=rate)
    x, place, push = (record[v].values[0] for v in ("displacement", "encoder_position", "drive_force"))
    v = np.diff(place) * rate
    lead = np.full(20000, feed * MM_MIN)
    friction = law.history(np.concatenate([lead, v]), 1 / rate)[lead.size :]
    away = place - record["reference_position"].values[0]
    joint = 1.68e6 * (x - away) + 104.0 * (np.gradient(x, 1 / rate) - np.gradient(away, 1 / rate))
    carriage = np.gradient(np.gradient(away, 1 / rate), 1 / rate)
    rest = 23.1 * carriage[1:] - (joint + push)[1:] + friction
    assert np.sqrt(np.mean(rest[5:-5] ** 2)) < 0.02 * np.abs(friction).max()
    assert step_error(machine, duration=0.1, feed=feed * MM_MIN, forces={"x": hit}) < 2e-3


def orders(run: Callable[[float], xr.Dataset], step: float, halvings: int = 4) -> np.ndarray:
    """Order of convergence of the tool's displacement from one halving of the step to the next."""
    x = [run(step / 2**i)["displacement"].values[0, :: 2**i] for i in range(halvings + 1)]
    n = min(part.size for part in x)
    change = [np.abs(one[:n] - two[:n]).max() for one, two in itertools.pairwise(x)]
    return np.log2(np.divide(change[:-1], change[1:]))


@pytest.mark.parametrize(("law", "least"), [(LUGRE, 2.5), (MAXWELL, 2.0)], ids=["LuGre", "Maxwell slip"])
@pytest.mark.parametrize("feed", [0.0, 50.0, 500.0])
def test_friction_with_memory_converges(law: LuGre | GeneralisedMaxwellSlip, least: float, feed: float) -> None:
    # With slip that begins within a step a single halving may gain nothing, three together do.
    for peak in (25.0, 300.0):
        hit = {"x": HalfSine.from_peak(peak)}
        found = orders(
            lambda h, hit=hit: simulate_machine(  # type: ignore[misc]
                bench("K2", law),  # type: ignore[arg-type]
                duration=0.1,
                feed=feed * MM_MIN,
                forces=hit,
                sample_rate=1.0 / h,
                step=h,
            ),
            200e-6,
        )
        assert found.mean() > least


@pytest.mark.parametrize("friction", [Viscous(168.0), ANDERSSON, LUGRE], ids=["viscous", "Andersson", "LuGre"])
@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_what_has_come_to_rest_stays_there(friction: Viscous | Andersson | LuGre, delay: float) -> None:
    # A force too small to matter that does not end keeps the simulation going.
    machine = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(replace(SERVOS["K2"], delay=delay), friction)})
    arguments = {"duration": 2.0, "feed": 500.0 * MM_MIN, "forces": {"x": HalfSine.from_peak(50.0)}}
    on = {"x": SteppedSine((1.0,), 1e-300, 2.0, 0.0)}
    records = (simulate_machine(machine, drive_forces=d, **arguments) for d in (on, None))  # type: ignore[arg-type]
    whole, short = (record["displacement"].values[0] for record in records)
    assert np.all(short[-100:] == 0.0)
    assert np.any(whole[-100:] != 0.0)
    np.testing.assert_allclose(short, whole, rtol=0.0, atol=1e-10 * np.abs(whole).max())


def test_a_verdict_that_is_kept_is_that_of_its_own_machine() -> None:
    def run(servo: Servo, sigma: float, stiffness: float = 1.68e6, joint: float = 0.0) -> None:
        drive = replace(BENCH, stiffness=stiffness)
        mounted = [MountedJoint(CubicSpring(joint, 0.0), np.array([1.0, -1.0]))] if joint else []
        axes = {"x": FeedAxis(servo, Viscous(sigma))}
        simulate_machine(Machine(two_mass_axes({"x": drive}), axes, mounted), duration=0.01, forces=HIT)

    shaky = replace(SERVOS["K2"], delay=3.2e-3)
    for _ in range(2):
        run(SERVOS["K2"], 168.0)
        with pytest.raises(InputError, match="unstable with its servos"):
            run(shaky, 168.0)
        # Damped, or with a tip that hardly loads the drive, it holds; a joint in place of the stiffness does not.
        run(shaky, 5e4)
        run(shaky, 168.0, 1.0)
        with pytest.raises(InputError, match="unstable with its servos"):
            run(shaky, 168.0, 1.0, 1.68e6)


def cut(depth: float, feed_per_tooth: float = 2e-4) -> MillingCut:
    return MillingCut(CUTTER, SLOT, ALUMINIUM, depth, feed_per_tooth=feed_per_tooth)


def spindle(rpm: float) -> Spindle:
    return Spindle(rpm * math.pi / 30.0)


def test_with_a_slide_that_cannot_move_the_cut_is_that_of_the_idle_modes() -> None:
    heavy = Machine(two_mass_axes({"x": replace(BENCH, moving_mass=1e15)}))
    idle = ModalModel([BENCH.locked_frequency], [BENCH.locked_damping], [BENCH.stiffness], [(1.0, 0.0, 0.0)])
    arguments = {"lead": 0.05, "tail": 0.1, "impulse": (0.01, 0.0, 0.0), "step": 5e-5}
    ours = simulate_machine(heavy, duration=1.0, cut=cut(1e-4), spindle=spindle(1500), sample_rate=20e3, **arguments)  # type: ignore[arg-type]
    theirs = simulate_milling(idle, cut(1e-4), spindle(1500), 1.0, 20e3, **arguments)  # type: ignore[arg-type]
    for name in ("force", "displacement"):
        np.testing.assert_allclose(ours[name], theirs[name], atol=1e-8 * np.abs(theirs[name].values).max())
    # The impulse at entry is in the acceleration of that very sample here.
    later = ours["time"].values > 0.0501
    scale = np.abs(theirs["acceleration"].values).max()
    np.testing.assert_allclose(
        ours["acceleration"].values[:, later], theirs["acceleration"].values[:, later], atol=1e-7 * scale
    )
    assert ours.attrs["lost_contact"] == theirs.attrs["lost_contact"]
    assert ours.attrs["energy_error"] < 1e-6


@pytest.mark.parametrize("rpm", [1500.0, 1237.0])
def test_with_a_cut_the_step_is_of_second_order(rpm: float) -> None:
    found = orders(
        lambda h: simulate_machine(
            bench(),
            duration=0.3,
            feed=500 * MM_MIN,
            cut=cut(1e-3),
            spindle=spindle(rpm),
            lead=0.01,
            sample_rate=1.0 / h,
            step=h,
        ),
        80e-6,
    )
    assert 1.8 < found.min() <= found.max() < 2.4


def test_an_impulse_before_any_force_is_followed() -> None:
    # Down milling a quarter: at entry no tooth cuts yet, and the impulse is all there is.
    quarter = replace(cut(1e-3), arc=engagement("down", 0.0127, 0.0508))
    arguments = {"duration": 0.2, "feed": 500 * MM_MIN, "cut": quarter, "spindle": spindle(1500), "lead": 0.01}
    record = simulate_machine(bench(), impulse=(1e-3, 0.0, 0.0), **arguments)  # type: ignore[arg-type]
    assert record.attrs["energy_error"] < 1e-4
    assert step_error(bench(), impulse=(1e-3, 0.0, 0.0), **arguments) < 1e-3


def regeneration(record: xr.Dataset, rpm: float) -> tuple[float, float]:
    """Deviation from turn to turn [m] in the third and in the last quarter of a record."""
    x = record["displacement"].sel(axis="x").values
    turn = round(60.0 / rpm / (record["time"].values[1]))
    change = x[turn:] - x[:-turn]
    quarter = change.size // 4
    return float(np.std(change[-2 * quarter : -quarter])), float(np.std(change[-quarter:]))


# Reference limits [mm] with friction, servo K2 and loss of contact; the feed of the axis is that of the cut.
LIMITS = {800: 1.8444, 1200: 3.6234, 1500: 1.6448, 2000: 1.7632}


@pytest.mark.parametrize("rpm", LIMITS)
def test_a_cut_on_the_moving_bench_has_the_reference_limit(rpm: int) -> None:
    feed = 2e-4 * 4 * rpm / 60.0
    for factor in (0.997, 1.003):
        record = simulate_machine(
            bench(),
            duration=8.0,
            feed=feed,
            cut=cut(LIMITS[rpm] * 1e-3 * factor),
            spindle=spindle(rpm),
            impulse=(1e-3, 0.0, 0.0),
        )
        before, after = regeneration(record, rpm)
        assert (after > before) == (factor > 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("feed", "limit"), [(25.0, 0.36), (100.0, 0.67), (250.0, 1.04)])
def test_a_kick_makes_a_stable_cut_chatter_at_low_feed(feed: float, limit: float) -> None:
    # Reference, K3 at 1500 rpm, chips of 0.2 mm, after 0.5 N s; the linear limits are 2.63, 2.53 and 2.28 mm.
    for depth, kick, chatters in ((0.9 * limit, 0.5, False), (1.1 * limit, 0.5, True), (0.9 * limit, 1e-6, False)):
        record = simulate_machine(
            bench("K3"),
            duration=16.0,
            feed=feed * MM_MIN,
            cut=cut(depth * 1e-3),
            spindle=spindle(1500),
            impulse=(kick, 0.0, 0.0),
        )
        assert (regeneration(record, 1500)[1] > 1e-5) == chatters


def test_a_sampled_servo_damps_at_the_rate_of_its_poles() -> None:
    # A light hit of the free-running axis: the slowest oscillation decays as the pole in the unit circle.
    for period, lag in ((1e-3, 1), (0.5e-3, 2), (2e-3, 0)):
        control = SampledControl(period, lag)
        machine = bench("K3", Viscous(168.0))
        record = simulate_machine(
            machine,
            duration=0.4,
            forces={"x": HalfSine(0.064, 4e-3, 0.0)},
            control=control,
            sample_rate=4e3,
            step=25e-5,
        )
        drive = replace(BENCH, servo=SERVOS["K3"], sigma=168.0)
        poles = SampledServo(drive.servo, period, lag).poles(drive)
        # Prony: at the samples of the servo the free motion is a sum of the powers of the poles.
        x = record["displacement"].values[0][:: round(period * 4e3)]
        start = round(0.008 / period)
        z = np.exp(poles[np.abs(poles.imag) < np.pi / period * (1 + 1e-9)] * period)
        recurrence = np.poly(z).real
        rest = np.convolve(x[start:], recurrence, "valid")
        assert np.abs(rest).max() < 1e-8 * np.abs(x).max()


def test_a_short_period_is_a_dead_time() -> None:
    hit, period = HalfSine.from_peak(25.0), 1e-4
    law = CoulombViscous(44.2, 168.0, 15000.0)
    sampled = simulate_machine(
        bench("K3", law), duration=0.5, feed=500 * MM_MIN, forces={"x": hit}, control=SampledControl(period)
    )
    axis = FeedAxis(replace(SERVOS["K3"], delay=1.5 * period), law)
    late = simulate_machine(
        Machine(two_mass_axes({"x": BENCH}), {"x": axis}), duration=0.5, feed=500 * MM_MIN, forces={"x": hit}
    )
    x, y = sampled["displacement"].values[0], late["displacement"].values[0]
    # The rectangular integral leaves a difference of first order: period over 2 Ti.
    assert np.abs(x - y).max() < 0.02 * np.abs(y).max()


def test_a_coarse_encoder_shakes_the_axis_by_its_resolution() -> None:
    quiet = SteppedSine((30.0,), 1e-9, 0.1)
    control = SampledControl(1e-3, 1, 1e-6)
    record = simulate_machine(
        bench("K2", Viscous(168.0)), duration=4.0, feed=500.3 * MM_MIN, forces={"x": quiet}, control=control
    )
    away = (record["encoder_position"] - record["reference_position"]).values[0][4000:]
    assert 0.05e-6 < np.std(away) < 1e-6
    exact = simulate_machine(
        bench("K2", Viscous(168.0)),
        duration=1.0,
        feed=500.3 * MM_MIN,
        forces={"x": quiet},
        control=SampledControl(1e-3),
    )
    assert np.abs(exact["encoder_position"] - exact["reference_position"]).max() < 1e-12


@pytest.mark.parametrize("delay", [0.2e-3, 1e-3, 2e-3, 4e-3, 8e-3])
def test_poles_are_counted_alike_through_those_without_dead_time(delay: float) -> None:
    # Of two servos with one or two dead times, stable and unstable: against the determinant of the whole.
    for other in (0.0, delay, 0.7 * delay):
        axes = {"x": FeedAxis(tune(20.0, 9000.0), Viscous(2e3)), "y": FeedAxis(tune(20.0, 6000.0), Viscous(2e3))}
        for name, late in (("x", delay), ("y", other)):
            axes[name] = replace(axes[name], servo=replace(axes[name].servo, delay=late))  # type: ignore[type-var]
        point = Machine(released_modes(RAM, MASS), axes).at(0.0)
        assert count_unstable(point, None) == point.unstable_poles()


@pytest.mark.parametrize("law", [ANDERSSON, replace(ANDERSSON, delta=1.7), CoulombViscous(44.2, 168.0, 15000.0)])
def test_the_loop_has_the_force_and_the_slope_of_the_law(law: Andersson | CoulombViscous) -> None:
    v = np.concatenate([-np.geomspace(1e-8, 1.0, 50), [0.0], np.geomspace(1e-8, 1.0, 50)])
    found = np.array([kernels._without_memory(*law.packed(), speed) for speed in v])
    np.testing.assert_allclose(found, np.stack([law.force(v), law.slope(v)], axis=1), rtol=1e-12)


def moving_mode(frequency: float) -> Structure:
    return free_modes([0.0, frequency], [0.0, 0.02], [100.0, 50.0], [[1.0, 0, 0], [0.0, 1.0, 0]], {"x": [1.0, 0.0]})


def test_a_posture_changes_on_the_way() -> None:
    posture = Posture("x", [0.0, 0.5], (moving_mode(30.0), moving_mode(45.0)))
    machine = Machine(posture, {"x": FeedAxis(tune(20.0, 100.0), Viscous(100.0))})
    hit = HalfSine.from_peak(100.0, start=0.0)
    held = simulate_machine(machine, duration=1.0, position=0.25, forces={"y": hit})
    middle = posture.at(0.25)
    alone = simulate_machine(Machine(middle, machine.axes), duration=1.0, forces={"y": hit})
    np.testing.assert_array_equal(held["displacement"], alone["displacement"])
    # A slow path is a series of postures: the frequency of the free decay follows sqrt(k(position)/m).
    record = simulate_machine(machine, duration=1.0, feed=0.5, position=0.0, forces={"y": hit}, sample_rate=4e3)
    y, t = record["displacement"].sel(axis="y").values, record["time"].values
    rising = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0) & (t[:-1] > 0.01))
    crossing = t[rising] - y[rising] / (y[rising + 1] - y[rising]) / 4e3
    found, at = 1.0 / np.diff(crossing), 0.5 * (crossing[1:] + crossing[:-1])
    expected = np.sqrt(30.0**2 + at * (45.0**2 - 30.0**2))
    np.testing.assert_allclose(found, expected, rtol=3e-3)
    with pytest.raises(InputError, match="outside"):
        simulate_machine(machine, duration=2.0, feed=0.5, position=0.0)
    with pytest.raises(InputError, match="depends on the position"):
        simulate_machine(machine, duration=1.0)


def test_a_posture_that_does_not_change_is_a_structure() -> None:
    posture = Posture("x", [0.0, 0.5], (moving_mode(30.0), moving_mode(30.0)))
    law = CoulombViscous(44.2, 168.0, 15000.0)
    axes = {"x": FeedAxis(tune(20.0, 100.0, 1e-3), law)}
    hits = {"x": HalfSine.from_peak(100.0, start=0.0), "y": HalfSine.from_peak(50.0)}
    runs = [
        simulate_machine(Machine(s, axes), duration=0.5, feed=0.1, position=0.1, forces=hits)
        for s in (posture, moving_mode(30.0))
    ]
    for name in ("displacement", "acceleration", "drive_force"):
        one, two = (run[name].values for run in runs)
        np.testing.assert_allclose(one, two, atol=1e-9 * np.nanmax(np.abs(two)), equal_nan=True)
    assert math.isnan(runs[0].attrs["energy_error"])


def test_a_free_slide_drifts_with_its_momentum() -> None:
    record = simulate_machine(bench(None, Viscous(0.0)), duration=1.0, forces={"x": HalfSine(1.0, 4e-3, 0.0)})
    x = record["encoder_position"].values[0]
    speed = np.polyfit(record["time"].values[200:], x[200:], 1)[0]
    assert speed == pytest.approx(1.0 / 34.4, rel=2e-3)


def test_several_controllers_go_by_name() -> None:
    axis = FeedAxis({"soft": SERVOS["K1"], "hard": SERVOS["K3"]}, Viscous(168.0))
    machine, hit = Machine(two_mass_axes({"x": BENCH}), {"x": axis}), {"x": HalfSine(0.1)}
    named = simulate_machine(machine, duration=0.2, controller="hard", forces=hit)
    alone = simulate_machine(bench("K3", Viscous(168.0)), duration=0.2, forces=hit)
    xr.testing.assert_identical(named, alone)
    with pytest.raises(InputError, match="none of soft, hard"):
        simulate_machine(machine, duration=0.2, forces=hit)


HIT = {"x": HalfSine(0.1)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": 2e-3, "forces": HIT}, r"at most \d+\.?\d* us follow the fastest pole"),
        ({"cut": cut(1e-3)}, "a cut needs a spindle"),
        ({"cut": cut(1e-3), "spindle": Spindle(100.0, -200.0)}, "must turn forward"),
        ({"impulse": (1.0, 0.0, 0.0)}, "no cut"),
        ({"forces": {"u": HalfSine(0.1)}}, "axis 'u' is none of"),
        ({"drive_forces": {"y": HalfSine(0.1)}}, "drive force on axis y"),
        ({"forces": HIT, "control": SampledControl(math.sqrt(2.0) * 1e-4)}, "no step divides"),
        ({"forces": HIT, "control": SampledControl(20e-3)}, "unstable with its servos"),
        ({"feed": math.inf}, "give finite ones"),
        ({"forces": {"x": HalfSine(1e9)}}, "left the range of 1 m"),
    ],
)
def test_requests_without_meaning_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate_machine(bench(), duration=0.5, **arguments)  # type: ignore[arg-type]


def test_friction_that_jumps_and_double_dead_times_are_refused() -> None:
    with pytest.raises(InputError, match="finite kt"):
        simulate_machine(bench("K2", CoulombViscous(44.2, 168.0)), duration=0.1, forces=HIT)
    late = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(replace(SERVOS["K2"], delay=1e-3), ANDERSSON)})
    with pytest.raises(InputError, match="delay of its own"):
        simulate_machine(late, duration=0.1, forces=HIT, control=SampledControl(1e-3))
    with pytest.raises(InputError, match="positive period"):
        SampledControl(0.0)


class TestPathOfAPosture:
    """Stiffness 1e7 to 4e7 N/m and modal mass 100 to 200 kg along 100 mm."""

    @staticmethod
    def machine() -> Machine:
        def at(stiffness: float, mass: float) -> Structure:
            frequency = np.sqrt(stiffness / mass) / (2 * np.pi)
            return free_modes([0.0, frequency], [0.0, 0.05], [1000.0, mass], [[0, 0, 0], [1, 0, 0]], {"x": [1, 0]})

        return Machine(Posture("x", [0.0, 0.1], (at(1e7, 100.0), at(4e7, 200.0))), {"x": FeedAxis(tune(10.0, 1000.0))})

    @pytest.mark.parametrize("sample_rate", [200.0, 1000.0])
    def test_the_stiffness_belongs_to_the_place_at_every_sample_rate(self, sample_rate: float) -> None:
        slow = Chirp(0.5, 0.5001, 100.0, 20.0, 0.0, 0.0)
        record = simulate_machine(
            self.machine(), duration=20.0, feed=0.005, position=0.0, forces={"x": slow}, sample_rate=sample_rate
        )
        share = record["time"].values / 20.0
        force, motion = (record[n].sel(axis="x").values for n in ("force", "displacement"))
        clear = (np.abs(force) > 50.0) & (share > 0.1) & (share < 0.9)
        expected = 1e7 + 3e7 * share
        np.testing.assert_allclose((force / motion)[clear], expected[clear], rtol=0.01)

    def test_the_acceleration_is_that_of_the_motion_everywhere_on_the_path(self) -> None:
        late = HalfSine(0.5, 0.02, 1.5)
        record = simulate_machine(
            self.machine(), duration=2.0, feed=0.05, position=0.0, forces={"x": late}, sample_rate=4000.0
        )
        motion, acceleration = (record[n].sel(axis="x").values for n in ("displacement", "acceleration"))
        numeric = np.gradient(np.gradient(motion, 1 / 4000.0), 1 / 4000.0)
        assert np.abs(numeric - acceleration)[20:-20].max() < 0.05 * np.abs(acceleration).max()
