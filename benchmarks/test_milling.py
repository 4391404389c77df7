"""Time simulation of milling: the compiled loop against the same physics written in plain Python, in one run."""

import math
import time

import numpy as np
import pytest

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


def loop_alone(monkeypatch: pytest.MonkeyPatch, tool: Tool = CUT.tool, repeats: int = 30) -> float:
    """Least processor time of the compiled loop itself [s a step]."""
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
            cut_for(5.0, tool)
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
    step = loop_alone(monkeypatch)
    # Six teeth more, a fourth of them in the work: what a tooth costs on top of modes and record.
    tooth = (loop_alone(monkeypatch, Tool(0.08, 8, CUT.tool.approach_angle)) - step) / 6
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
