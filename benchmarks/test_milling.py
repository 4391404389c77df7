"""Time simulation of milling: the compiled loop against the same physics written in plain Python, in one run."""

import math
import time

import numpy as np
import pytest
from numba import njit

from process import CuttingCoefficients, MillingCut, ModalModel, Spindle, Tool, engagement, simulate_milling
from process.simulation import _milling_kernels as _kernels

MACHINE = ModalModel([33.37, 57.44, 58.61], [0.061, 0.0822, 0.0287], [45.5e6, 32.1e6, 36.7e6], np.eye(3))
CUT = MillingCut(
    Tool(0.08, 2, math.radians(45.0)),
    engagement("down", 0.04, 0.08),
    CuttingCoefficients(1889e6, 806e6, 291e6),
    2e-3,
    feed_per_tooth=1e-4,
)
ROTATION, RATE, NODES = 100.0, 4000.0, 256


# The loop as one would write it in plain Python: floats, lists and math.sin, no library.


def discretised(frequency, damping, mass, step):
    """First-order hold of one mode: s' = a s + b0 f + b1 f', for a force that is linear over the step."""
    w, zeta, h = 2.0 * math.pi * frequency, damping, step
    wd = w * math.sqrt(1.0 - zeta * zeta)
    e, s, c = math.exp(-zeta * w * h), math.sin(wd * h), math.cos(wd * h)
    a = (
        (e * (c + zeta * w / wd * s), e * s / wd),
        (-e * w * w / wd * s, e * (c - zeta * w / wd * s)),
    )
    k = mass * w * w
    # A force that rises from 0 to 1 over the step moves the mode by x(t) = t/(k h) - c/(k^2 h) + free motion.
    lag = 2.0 * zeta / w
    x0, v0 = lag / (k * h), -1.0 / (k * h)
    b1 = (
        1.0 / k - lag / (k * h) + a[0][0] * x0 + a[0][1] * v0,
        1.0 / (k * h) + a[1][0] * x0 + a[1][1] * v0,
    )
    both = (1.0 / k - a[0][0] / k, -a[1][0] / k)
    return a, (both[0] - b1[0], both[1] - b1[1]), b1


def leave_surface(older, surface, start, end, arc):
    """Write at each node from start to end (angle, reach) the farthest that any tooth has reached."""
    nodes = len(surface)
    spacing = 2.0 * math.pi / nodes
    for node in range(math.floor(start[0] / spacing) + 1, math.floor(end[0] / spacing) + 1):
        phi = (node % nodes) * spacing
        if phi > 1.5 * math.pi:
            phi -= 2.0 * math.pi
        if arc[0] - 2.0 * spacing <= phi <= arc[1] + 2.0 * spacing:
            weight = (node * spacing - start[0]) / (end[0] - start[0])
            surface[node % nodes] = max(older[node % nodes], (1.0 - weight) * start[1] + weight * end[1])


def cutting_force(cut, surfaces, angle, half, tip):
    """Return the force on the tool: the sum over the teeth that are in the work; tip: with the advance, (x, y, z)."""
    teeth, entry, leave, kappa, depth, _, cutting, edge, nodes = cut
    spacing = 2.0 * math.pi / nodes
    sin_k, cos_k = math.sin(kappa), math.cos(kappa)
    fx = fy = fz = 0.0
    for j in range(teeth):
        turned = angle - 2.0 * math.pi * j / teeth
        phi = turned % (2.0 * math.pi)
        if phi > 1.5 * math.pi:
            phi -= 2.0 * math.pi
        share = (min(phi + half, leave) - max(phi - half, entry)) / (2.0 * half)
        if share <= 0.0:
            continue
        s, c = math.sin(phi), math.cos(phi)
        place = turned / spacing
        node = math.floor(place)
        weight = place - node
        surface = surfaces[j - 1]
        left = (1.0 - weight) * surface[node % nodes] + weight * surface[(node + 1) % nodes]
        h = (tip[0] * s + tip[1] * c) * sin_k - tip[2] * cos_k - left
        if h <= 0.0:
            continue
        ft, fr, fa = (share * depth / sin_k * (kc * h + ke) for kc, ke in zip(cutting, edge, strict=True))
        fx += -c * ft - sin_k * s * fr - cos_k * s * fa
        fy += s * ft - sin_k * c * fr - cos_k * c * fa
        fz += cos_k * fr - sin_k * fa
    return fx, fy, fz


def mill(modes, cut, rotation, step, count):
    """Return force, displacement and acceleration of each step, each as (x, y, z).

    modes: (frequency, damping, mass, (x, y, z)) of each. cut: teeth, entry, leave, approach angle, depth, feed per
    tooth, (K_tc, K_rc, K_ac), (K_te, K_re, K_ae), nodes a turn.
    """
    teeth, entry, leave, kappa, _, feed, _, _, nodes = cut
    laws = [discretised(f, zeta, m, step) for f, zeta, m, _ in modes]
    shapes = [shape for *_, shape in modes]
    omegas = [2.0 * math.pi * f for f, *_ in modes]
    state = [(0.0, 0.0) for _ in modes]
    modal = [0.0 for _ in modes]
    surfaces = [[0.0] * nodes for _ in range(teeth)]
    sin_k, cos_k = math.sin(kappa), math.cos(kappa)
    half = 0.5 * rotation * step
    reached = [(0.0, 0.0)] * teeth
    force, displacement, acceleration = [], [], []
    for k in range(count):
        angle = rotation * k * step
        advance = feed * teeth * angle / (2.0 * math.pi)
        # Predict the motion with the force held.
        predicted = [
            (
                a[0][0] * q + a[0][1] * v + (b0[0] + b1[0]) * f,
                a[1][0] * q + a[1][1] * v + (b0[1] + b1[1]) * f,
            )
            for (a, b0, b1), (q, v), f in zip(laws, state, modal, strict=True)
        ]
        x, y, z = (sum(shape[i] * q for shape, (q, _) in zip(shapes, predicted, strict=True)) for i in range(3))
        fx, fy, fz = cutting_force(cut, surfaces, angle, half, (advance + x, y, z))
        # Correct the motion with that force.
        new = [shape[0] * fx + shape[1] * fy + shape[2] * fz for shape in shapes]
        state = [
            (q + b1[0] * (f - old), v + b1[1] * (f - old))
            for (q, v), (_, _, b1), f, old in zip(predicted, laws, new, modal, strict=True)
        ]
        modal = new
        x, y, z = (sum(shape[i] * q for shape, (q, _) in zip(shapes, state, strict=True)) for i in range(3))
        second = [
            f / mass - 2.0 * zeta * omega * v - omega * omega * q
            for (q, v), f, (_, zeta, mass, _), omega in zip(state, modal, modes, omegas, strict=True)
        ]
        for j in range(teeth):
            turned = angle - 2.0 * math.pi * j / teeth
            reach = ((advance + x) * math.sin(turned) + y * math.cos(turned)) * sin_k - z * cos_k
            if k > 0:
                leave_surface(surfaces[j - 1], surfaces[j], reached[j], (turned, reach), (entry - half, leave + half))
            reached[j] = (turned, reach)
        force.append((fx, fy, fz))
        displacement.append((x, y, z))
        acceleration.append(tuple(sum(shape[i] * a for shape, a in zip(shapes, second, strict=True)) for i in range(3)))
    return force, displacement, acceleration


def plain(count: int) -> list[list[tuple[float, float, float]]]:
    m, k = MACHINE, CUT.coefficients
    rows = zip(m.frequency.tolist(), m.damping.tolist(), m.mass.tolist(), map(tuple, m.direction.tolist()), strict=True)
    tool, arc = CUT.tool, CUT.arc
    material = (k.Ktc, k.Krc, k.Kac), (k.Kte, k.Kre, k.Kae)
    cut = (tool.teeth, arc.entry, arc.exit, tool.approach_angle, CUT.depth, CUT.feed_per_tooth, *material, NODES)
    return mill(list(rows), cut, ROTATION, 1.0 / RATE, count)


def cut_for(duration: float, tool: Tool = CUT.tool):  # type: ignore[no-untyped-def]
    cut = MillingCut(tool, CUT.arc, CUT.coefficients, CUT.depth, feed_per_tooth=CUT.feed_per_tooth)
    return simulate_milling(MACHINE, cut, Spindle(ROTATION), duration, RATE, step=1.0 / RATE)


def loop_alone(monkeypatch: pytest.MonkeyPatch, run, repeats: int = 30) -> float:  # type: ignore[no-untyped-def]
    """Least processor time of the compiled loop itself [s a step] while something runs it."""
    loop, least = _kernels.milling, [math.inf]

    def timed(*arguments):  # type: ignore[no-untyped-def]
        for out in arguments[-3:]:
            out[:] = 0.0  # the first touch of fresh memory is the operating system's time, not the loop's
        start = time.thread_time()
        found = loop(*arguments)
        least.append((time.thread_time() - start) / arguments[-1].shape[1])
        return found

    with monkeypatch.context() as patch:
        patch.setattr(_kernels, "milling", timed)
        for _ in range(repeats):
            run()
    return min(least)


def plain_step(repeats: int = 8, count: int = 4000) -> float:
    """Least processor time of plain Python [s a step]."""
    least = math.inf
    for _ in range(repeats):
        start = time.thread_time()
        plain(count)
        least = min(least, (time.thread_time() - start) / count)
    return least


@pytest.mark.benchmark(group="milling")
def test_compiled_loop_against_plain_python(benchmark, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    record, count = cut_for(2.0), round(2.0 * RATE)
    for name, values in zip(("force", "displacement", "acceleration"), plain(count), strict=True):
        expected = np.transpose(values)
        np.testing.assert_allclose(record[name].values, expected, atol=1e-9 * np.abs(expected).max(), err_msg=name)
    benchmark(cut_for, 5.0)
    whole = benchmark.stats.stats.min / (5.0 * RATE)
    step = loop_alone(monkeypatch, lambda: cut_for(5.0))
    # Six teeth more, a fourth of them in the work: what a tooth costs on top of modes and record.
    tooth = (loop_alone(monkeypatch, lambda: cut_for(5.0, Tool(0.08, 8, CUT.tool.approach_angle))) - step) / 6
    reference = plain_step()
    benchmark.extra_info.update(
        times_faster_than_plain_python=round(reference / step),
        ns_a_step=round(step * 1e9, 1),
        ns_a_tooth_step=round(tooth * 1e9, 1),
        ns_a_step_with_record=round(whole * 1e9, 1),
        us_a_step_in_plain_python=round(reference * 1e6, 2),
    )
    print(
        f"\n{reference / step:.0f} times faster than plain Python ({reference * 1e6:.1f} us a step); "
        f"{step * 1e9:.1f} ns a step, of which {tooth * 1e9:.1f} ns a tooth; {whole * 1e9:.0f} ns with the record"
    )


# The bound: no step can begin before the force of the last one is known.


CHAIN = {
    "feed and vibration along the chip normal: ((advance + x) sin phi + y cos phi) sin k - z cos k + run-out": 6,
    "chip: less the surface that was left": 1,
    "force of the edge, its share of the step": 2,
    "force in x: tangential and normal part, added to those of the other teeth": 3,
    "force of a mode: three products and sums, less the old one": 4,
    "the mode a step ahead": 1,
    "where the tool will be: the sum over three modes": 3,
}
"""Operations of a step that wait for one another, of the shortest way round from the tool's place to the next one."""


@njit(nogil=True)
def dependent(x, a, b, count):
    """Multiply and add `count` times, each on what the last gave."""
    for _ in range(count):
        x = x * a + b
    return x


def latency(count: int = 4_000_000) -> float:
    """Least time of one multiplication and addition that waits for another [s]; with one rounding, if compiled so."""
    dependent(1.0, 0.5, 0.5, 10)
    least = math.inf
    for _ in range(10):
        start = time.thread_time()
        dependent(1.0, 0.999, 0.001, count)
        least = min(least, (time.thread_time() - start) / count)
    # A product and a sum, each of which takes half of it where they are not fused.
    return least / 2.0


@pytest.mark.benchmark(group="milling")
def test_compiled_loop_against_the_bound_of_floating_point(benchmark, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """A loop whose steps follow one another cannot take less than the operations that wait for one another."""
    operation, chain = latency(), sum(CHAIN.values())
    step = loop_alone(monkeypatch, lambda: cut_for(5.0))
    benchmark(cut_for, 1.0)
    benchmark.extra_info.update(ns_an_operation=round(operation * 1e9, 2), operations=chain)
    print(
        f"\n{step * 1e9:.1f} ns a step; {chain} operations wait for one another, {operation * 1e9:.2f} ns each: "
        f"{chain * operation * 1e9:.1f} ns, of which the loop takes {step / (chain * operation):.1f} times"
    )


# The loop that an interactive tool publishes (Urbikain Pelayo and Olvera Trejo, Mill+, 2024), rebuilt from what it
# does: slices that trail by a step of the angle each, a surface of each over the angle, Euler's method, two modes.


END_MILL = Tool(0.012, 4, math.radians(90.0), helix_angle=math.radians(30.0))
TWO = ModalModel([820.0, 760.0], [0.03, 0.035], [6.0e6, 5.0e6], np.eye(3)[:2])
DOWN = MillingCut(END_MILL, engagement("down", 0.003, 0.012), CuttingCoefficients(700e6, 250e6, 0.0), 2e-3, None, 8e-5)
TURNS, PER_TURN = 20, 360


def published(revolutions: int, per_turn: int, rotation: float) -> tuple[np.ndarray, np.ndarray]:
    """Return force and displacement in the plane, each (2, steps), by the loop that is published."""
    tool, k, teeth = DOWN.tool, DOWN.coefficients, DOWN.tool.teeth
    turn = 2.0 * math.pi / per_turn
    trail = 2.0 * DOWN.depth * math.tan(tool.helix_angle) / tool.diameter
    slices = max(1, round(trail / turn))
    height, dt, count = DOWN.depth / slices, turn / rotation, revolutions * per_turn
    mass, law = TWO.mass, 2.0 * np.pi * TWO.frequency
    left, force = np.zeros((slices, per_turn)), np.zeros((2, count))
    place, speed = np.zeros((2, count)), np.zeros((2, count))
    for i in range(count - 1):
        for j in range(teeth):
            for a in range(slices):
                phi = (turn * (i - a) - 2.0 * math.pi * j / teeth) % (2.0 * math.pi)
                node = round(phi / turn) % per_turn
                if not DOWN.arc.entry < phi < DOWN.arc.exit:
                    continue
                s, c = math.sin(phi), math.cos(phi)
                reach = place[0, i] * s + place[1, i] * c
                chip = DOWN.feed_per_tooth * s + reach - left[a, node]
                if chip > 0.0:
                    left[a, node] = reach
                else:
                    chip, left[a, node] = 0.0, left[a, node] - DOWN.feed_per_tooth * s
                ft, fn = k.Ktc * height * chip, k.Krc * height * chip
                force[0, i] -= c * ft + s * fn
                force[1, i] += s * ft - c * fn
        acceleration = force[:, i] / mass - 2.0 * TWO.damping * law * speed[:, i] - law**2 * place[:, i]
        speed[:, i + 1] = speed[:, i] + acceleration * dt
        place[:, i + 1] = place[:, i] + speed[:, i + 1] * dt
    return force, place


def ours(revolutions: int, per_turn: int, rotation: float):  # type: ignore[no-untyped-def]
    dt = 2.0 * math.pi / per_turn / rotation
    return simulate_milling(TWO, DOWN, Spindle(rotation), revolutions * per_turn * dt, 1.0 / dt, step=dt)


@pytest.mark.benchmark(group="milling")
def test_a_helical_cut_against_the_loop_of_a_published_tool(benchmark, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """The same cut in as many steps, and how far either is off in the vibration left at the end."""
    rotation = 2.0 * math.pi * 4000.0 / 60.0
    ours(TURNS, PER_TURN, rotation)
    start = time.thread_time()
    _, theirs = published(TURNS, PER_TURN, rotation)
    interpreted = time.thread_time() - start
    benchmark(ours, TURNS, PER_TURN, rotation)
    whole, steps = benchmark.stats.stats.min, TURNS * PER_TURN
    step = loop_alone(monkeypatch, lambda: ours(TURNS, PER_TURN, rotation))
    exact = ours(TURNS, 16 * PER_TURN, rotation)["displacement"].values[:2]
    mine = ours(TURNS, PER_TURN, rotation)["displacement"].values[:2]

    def swing(x):  # type: ignore[no-untyped-def]
        return np.ptp(x[:, -x.shape[1] // 4 :], axis=1)

    errors = [float(np.max(np.abs(swing(x) / swing(exact) - 1.0))) for x in (theirs, mine)]
    benchmark.extra_info.update(times_faster=round(interpreted / steps / step), errors=errors)
    print(
        f"\n{interpreted / steps / step:.0f} times faster than the published loop, interpreted "
        f"({interpreted / steps * 1e6:.0f} us a step, {step * 1e9:.0f} ns, {whole / steps * 1e9:.0f} ns with the "
        f"record); the swing of the vibration is off by {100 * errors[0]:.2g} and {100 * errors[1]:.2g} %"
    )
