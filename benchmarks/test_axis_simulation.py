"""Time simulation of a feed axis: the compiled fixed step against SciPy's LSODA at equal error, in one run; one hit."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction._kernels import friction_force
from process.friction.laws import Andersson, LuGre, Viscous
from process.machine.joints import Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Excitation, HalfSine, SteppedSine
from process.simulation.machine import RepeatedImpact, integrate_problem, simulate_machine
from process.simulation.problem import MachineRun, resolve
from process.simulation.record import displacement_of

MM_MIN = 1.0 / 6e4
FRICTION = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
BENCH = Drive(23.1, 11.3, 1.68e6, 104.0, Servo(6268.0, 10.9e-3, 45.5))
MACHINE = Machine.of_axis(BENCH, FRICTION)
DURATION, RATE = 2.0, 2500.0
ALLOWED = (1e-4, 1e-6)
STEPS = (400e-6, 200e-6, 100e-6, 50e-6)
# Excitation, its frequency for LSODA, its end, feed [mm/min]. The sine breaks the idle carriage away twice a period.
CASES = {
    "hammer, 500 mm/min": (HalfSine.from_peak(100.0, start=0.0), 125.0, 4e-3, 500.0),
    "hammer, idle": (HalfSine.from_peak(100.0, start=0.0), 125.0, 4e-3, 0.0),
    "actuator, 500 mm/min": (SteppedSine((40.0,), 100.0, DURATION, 0.0), 40.0, DURATION, 500.0),
    "actuator, idle": (SteppedSine((40.0,), 100.0, DURATION, 0.0), 40.0, DURATION, 0.0),
}


def ours(excitation: Excitation, feed: float, step: float) -> np.ndarray:
    forces = {"x": excitation}
    record = simulate_machine(MACHINE, duration=DURATION, feed=feed, forces=forces, sample_rate=1.0 / step, step=step)
    return np.asarray(record["displacement"].values[0][:: round(1.0 / RATE / step)])


def motion(machine: Machine, run: MachineRun, rate: float, accuracy: float | None = None) -> np.ndarray:
    """Displacement of the tool (3, n), without record: a sample is a step."""
    problem = resolve(machine, run)
    return displacement_of(problem, integrate_problem(problem, rate, 1.0 / rate, accuracy)[1])


def plain(excitation: Excitation, feed: float, step: float) -> None:
    """Run the same without labels and verdict, as LSODA gives it."""
    motion(MACHINE, MachineRun(DURATION, feed, forces={"x": excitation}), 1.0 / step)


def fastest(run: Callable[[], object], count: int) -> float:
    """Shortest time [s] of several runs."""
    spent = []
    for _ in range(count):
        start = time.perf_counter()
        run()
        spent.append(time.perf_counter() - start)
    return min(spent)


def _equations(t, q, law, parameters, feed, steady, frequency, end):  # type: ignore[no-untyped-def]
    xt, vt, xm, vm, j = q
    force = 100.0 * np.sin(2.0 * np.pi * frequency * t) if t < end else 0.0
    joint = 1.68e6 * (xt - xm) + 104.0 * (vt - vm)
    drive = -6268.0 * (vm + 45.5 * xm + (xm + 45.5 * j) / 10.9e-3)
    friction = friction_force(law, parameters, feed + vm) - steady
    return np.array([vt, (force - joint) / 11.3, vm, (joint + drive - friction) / 23.1, xm])


COMPILED = njit(_equations)


def lsoda(equations: Callable[..., np.ndarray], case: str, tolerance: float) -> np.ndarray:
    """The same with SciPy, with the end of the pulse, the sizes to expect and the sample times given."""
    _, frequency, end, feed_mm_min = CASES[case]
    feed = feed_mm_min * MM_MIN
    args = (*FRICTION.packed(), feed, float(FRICTION.force(feed)), frequency, end)
    grid = np.arange(round(DURATION * RATE)) / RATE
    out, q = [], np.zeros(5)
    # Absolute tolerance in proportion to the size of each state: m, m/s, m, m/s, m s.
    atol = tolerance * np.array([1e-5, 5e-3, 1e-6, 1e-3, 1e-8])
    for part in (grid[:11], grid[10:]):
        span = (part[0], part[-1])
        run = solve_ivp(equations, span, q, "LSODA", part, args=args, rtol=tolerance, atol=atol, max_step=1e-3)
        out.append(run.y[0])
        q = run.y[:, -1]
    return np.concatenate([out[0], out[1][1:]])


@pytest.mark.benchmark(group="axis")
@pytest.mark.parametrize("allowed", ALLOWED)
@pytest.mark.parametrize("case", CASES)
def test_compiled_steps_against_lsoda_at_equal_error(benchmark, case, allowed) -> None:  # type: ignore[no-untyped-def]
    excitation, feed = CASES[case][0], CASES[case][3] * MM_MIN
    truth = ours(excitation, feed, 6.25e-6)

    def error(x: np.ndarray) -> float:
        n = min(x.size, truth.size)
        return float(np.abs(x[:n] - truth[:n]).max() / np.abs(truth).max())

    # Each as coarse as the same error allows, the record at the same 2500 samples a second.
    errors = {h: error(ours(excitation, feed, h)) for h in STEPS}
    step = max((h for h in errors if errors[h] <= allowed), default=min(errors))
    allowed = max(allowed, errors[step])
    for tolerance in 10.0 ** -np.arange(3.0, 13.0, 0.25):
        if error(lsoda(COMPILED, case, float(tolerance))) <= allowed:
            break
    benchmark(ours, excitation, feed, step)
    own = {"record": benchmark.stats.stats.min, "arrays": fastest(lambda: plain(excitation, feed, step), 50)}
    theirs = {
        name: fastest(lambda e=equations: lsoda(e, case, float(tolerance)), 2)  # type: ignore[misc]
        for name, equations in (("python", _equations), ("compiled", COMPILED))
    }
    ratio = {(a, b): round(spent / own[b], 1) for a, spent in theirs.items() for b in own}
    benchmark.extra_info.update(
        times_faster_than_lsoda=ratio["python", "record"],
        times_faster_than_lsoda_with_compiled_equations=ratio["compiled", "record"],
        as_arrays_times_faster_than_lsoda=ratio["python", "arrays"],
        as_arrays_times_faster_than_lsoda_with_compiled_equations=ratio["compiled", "arrays"],
        step_s=step,
        error=errors[step],
        lsoda_rtol=float(tolerance),
    )
    print(
        f"\n{case}, step {step * 1e6:g} us, error {errors[step]:.1e} (LSODA {allowed:.0e} at rtol {tolerance:.0e}): "
        f"{ratio['python', 'record']} times faster than LSODA, {ratio['compiled', 'record']} times with its equations "
        f"compiled; as plain arrays {ratio['python', 'arrays']} and {ratio['compiled', 'arrays']} times; "
        f"{DURATION / own['record']:.0f} times real time"
    )


LUGRE = LuGre(5e8, 6e4, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
LAWS: dict[str, LuGre | Viscous] = {"viscous": Viscous(168.0), "LuGre": LUGRE}


@pytest.mark.benchmark(group="hit")
@pytest.mark.parametrize("joint", [False, True], ids=["stiff", "micro-slip"])
@pytest.mark.parametrize("feed", [500.0, 0.0])
@pytest.mark.parametrize("law", LAWS)
def test_one_hit_of_two_seconds_at_half_a_millisecond(benchmark, law, feed, joint) -> None:  # type: ignore[no-untyped-def]
    share, k = 0.2 * joint, BENCH.stiffness
    across = [MountedJoint(Iwan(share * k, 0.5 * share * k * 1e-4, 20), np.array([1.0, -1.0]))] if joint else []
    structure = two_mass_axes({"x": replace(BENCH, stiffness=(1.0 - share) * k)})
    assert BENCH.servo is not None
    machine = Machine(structure, {"x": FeedAxis(replace(BENCH.servo, delay=1e-3), LAWS[law])}, across)

    def hit(rate: float) -> np.ndarray:
        pulse = {"x": HalfSine.from_peak(50.0)}
        out = np.zeros(round(2.0 * rate))
        moved = motion(machine, MachineRun(2.0, feed * MM_MIN, forces=pulse), rate)[0]
        out[: moved.size] = moved
        return out

    truth = hit(64e3)[::32]
    found = benchmark(hit, 2000.0)
    error = float(np.abs(found - truth).max() / np.abs(truth).max())
    benchmark.extra_info.update(error=error)
    print(f"\n{law}, {feed:g} mm/min: {1e3 * benchmark.stats.stats.min:.2f} ms, error {error:.1e}")
    assert error < 1e-3


@pytest.mark.benchmark(group="hit")
@pytest.mark.parametrize("feed", [500.0, 0.0])
def test_two_hits_on_a_machine_prepared_once_against_two_simulations(benchmark, feed) -> None:  # type: ignore[no-untyped-def]
    assert BENCH.servo is not None
    machine = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(replace(BENCH.servo, delay=1e-3), LUGRE)})
    run = MachineRun(2.0, feed * MM_MIN)
    impacts = [HalfSine.from_peak(peak, start=0.0) for peak in (50.0, 100.0)]

    def once() -> list[np.ndarray]:
        prepared = RepeatedImpact(machine, "x", run, accuracy=1e-4)
        return [prepared.displacement(impact, rest=1e-7)[0] for impact in impacts]

    def each() -> list[np.ndarray]:
        return [motion(machine, replace(run, forces={"x": impact}), 2000.0, 1e-4)[0] for impact in impacts]

    found, whole = benchmark(once), each()
    error = max(float(np.abs(a - b[: a.size]).max() / np.abs(b).max()) for a, b in zip(found, whole, strict=True))
    ratio = fastest(each, 20) / benchmark.stats.stats.min
    benchmark.extra_info.update(times_faster=round(ratio, 2), error=error)
    print(f"\n{feed:g} mm/min: {ratio:.1f} times faster")
    assert error < 1e-9
