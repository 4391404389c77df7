"""Campaigns of cutting tests with three forces, against the coefficients of the campaign.

The teeth are those of `truth.cutting`: trochoids that cut what earlier teeth left. Dynamometer and amplifier are drawn
here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import signal

from truth.cutting import Cut, Mill, forces
from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Instruments, Real

EFFECTS = {
    # A gain multiplies a force as its coefficients do; of what they differ by, the edge forces, 3 % and more are free.
    # Free edge forces leave of 13 % a likelihood ratio of 21 to 29 where one of 24 is found in 95 of 100 cases.
    "coefficients": Hiding(0.35, "", ("force_coefficients",), alike=("sensor_gain",)),
    "force_gain": Hiding(-0.13, "", ("sensor_gain",), alike=("force_coefficients", "edge_forces")),
    # Along z it is another axial coefficient, along x or y in one kind of cut nearly another ratio, or what an axis
    # that leans shows of the largest force.
    "gain": Hiding(0.05, "of one axis", ("sensor_gain",), True, alike=("force_coefficients", "sensor_axis")),
    "reversed": Hiding(1.0, "", ("sensor_gain", "sensor_axis"), switch=True),
    "exchanged": Hiding(1.0, "", ("sensor_axis",), switch=True),
    # About the axis of the tool it does what another ratio of the coefficients does.
    "turned": Hiding(math.radians(10.0), "rad", ("sensor_axis", "force_coefficients"), True),
    "runout": Hiding(0.2, "of the feed per tooth", ("runout",)),
    "one_insert": Hiding(0.3, "of the feed per tooth", ("runout",)),
    # Over feeds of one to three h^0.8 is a straight line with an intercept within 2 %, and that line, another slope
    # with an edge force.
    "edge_force": Hiding(0.1, "of the mean force", ("edge_forces",), alike=("force_coefficients", "sensor_gain")),
    "size_effect": Hiding(0.2, "exponent", ("force_coefficients",), alike=("edge_forces", "sensor_gain")),
    "dynamometer": Hiding(0.25, "of its resonance, the tooth passing", ("dynamometer_dynamics",)),
    "unbalance": Hiding(0.05, "of the mean force", ("unbalance", "background_tone"), False),
}
"""What the catalogue of cutting forces knows."""

OUTSIDE = {
    "dull_insert": Hiding(0.15, "of the mean force", ()),
    "warming": Hiding(0.05, "", ()),
}
"""What it does not know: one insert with a worn edge, forces that fall from cut to cut."""

GAIN_TOLD = 2.0
"""Times that which is material that the gain of one axis costs at least.

Axes that lean by a degree and show each other by 1 % leave of a gain that costs 1.4 times as much a likelihood ratio of
19 to 31 along the axis of the largest force; 24 are found in 95 of 100 cases.
"""

PUSHED = 0.15
"""Share of the force, rms, along an axis whose gain is wrong: of less a sensor is all but dead before that matters."""

LIKE_MATERIAL = ("coefficients", "force_gain", "gain", "turned", "size_effect", "edge_force")
"""Effects that other coefficients or edge forces within what is stated could stand for."""

PAIRS = (("coefficients", "runout"), ("runout", "edge_force"), ("exchanged", "edge_force"), ("gain", "runout"))


@dataclass(frozen=True)
class Test:
    """One cut: speed [rpm], feed per tooth and depth [m], its arc [rad], name and width [mm] of the kind of cut."""

    cut: Cut
    entry: float
    leave: float
    kind: str
    width: float


@dataclass(frozen=True)
class Rig:
    """Tool and work, and what stands between them and the file.

    sensor: matrix of the dynamometer; unbalance [N s2] times speed squared; warm: change of all forces by the last
    cut; resonance [Hz] of the dynamometer along x and y.
    """

    mill: Mill
    sensor: Real
    unbalance: float = 0.0
    warm: float = 0.0
    resonance: float = 4000.0


def planted(rig: Rig, name: str, size: float, tests: list[Test], rng: np.random.Generator) -> Rig:
    """Hide an effect of a size."""
    m, sensor = rig.mill, rig.sensor.copy()
    feed = float(np.median([t.cut.feed_per_tooth for t in tests]))
    if name == "coefficients":
        return replace(rig, mill=replace(m, cutting=tuple(k * (1.0 + size) for k in m.cutting)))
    if name == "size_effect":
        return replace(rig, mill=replace(m, size_effect=size))
    if name == "runout":
        return replace(rig, mill=replace(m, runout=m.runout + size * feed))
    if name == "one_insert":
        return replace(rig, mill=replace(m, set_back=size * feed))
    if name in ("edge_force", "dull_insert"):
        mean = m.cutting[0] * feed * 2.0 / math.pi
        if name == "dull_insert":
            return replace(rig, mill=replace(m, dull=size * mean * m.teeth))
        return replace(rig, mill=replace(m, edge=(m.edge[0] + size * mean, m.edge[1] + size * mean, m.edge[2])))
    if name == "unbalance":
        mean = m.cutting[0] * feed * float(np.mean([t.cut.depth for t in tests])) * 2.0 / math.pi
        top = max(t.cut.speed for t in tests)
        return replace(rig, unbalance=size * mean / (2.0 * math.pi * top / 60.0) ** 2)
    if name == "dynamometer":
        top = max(t.cut.speed for t in tests) / 60.0 * m.teeth
        return replace(rig, resonance=top / size)
    if name == "warming":
        return replace(rig, warm=-size)
    if name == "force_gain":
        sensor *= 1.0 + size
    elif name == "gain":
        sensor[_pushed(rig, tests, rng)] *= 1.0 + size
    elif name == "reversed":
        sensor[int(rng.integers(2))] *= -1.0
    elif name == "exchanged":
        sensor = sensor[[1, 0, 2]]
    elif name == "turned":
        c, s = math.cos(size), math.sin(size)
        sensor = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ sensor
    else:
        raise ValueError(f"no effect '{name}' of cutting forces")
    return replace(rig, sensor=sensor)


def _pushed(rig: Rig, tests: list[Test], rng: np.random.Generator) -> int:
    """Draw an axis along which the cuts push."""
    angle = np.arange(720) * 2.0 * math.pi / 720
    square = np.mean([np.mean(turn_forces(rig, t, 0.0, angle) ** 2, axis=1) for t in tests], axis=0)
    return int(rng.choice(np.flatnonzero(square > PUSHED**2 * square.sum())))


def turn_forces(rig: Rig, test: Test, order: float, angle: Real) -> Real:
    """What the sensors would show over a turn at angles [rad], shape (3, n)."""
    m = replace(rig.mill, entry=test.entry, exit=test.leave)
    out = (1.0 + rig.warm * order) * forces(m, test.cut, angle)
    w = 2.0 * math.pi * test.cut.speed / 60.0
    out[0] += rig.unbalance * w * w * np.sin(angle)
    out[1] += rig.unbalance * w * w * np.cos(angle)
    # The dynamometer as its orders pass it.
    k = np.fft.rfftfreq(angle.size, 1.0 / angle.size) * test.cut.speed / 60.0
    spectrum = np.fft.rfft(out, axis=1)
    for i, high in enumerate((1.0, 1.0, 1.5)):
        r = k / (rig.resonance * high)
        spectrum[i] /= 1.0 - r**2 + 0.06j * r
    return np.asarray(rig.sensor @ np.fft.irfft(spectrum, angle.size, axis=1))


def cost_of(rig: Rig, before: Rig, tests: list[Test]) -> float:
    """Change of the forces that are shown, rms over rms, over all cuts."""
    angle = np.arange(720) * 2.0 * math.pi / 720
    square = np.zeros(2)
    for k, test in enumerate(tests):
        order = k / max(len(tests) - 1, 1)
        a, b = turn_forces(before, test, order, angle), turn_forces(rig, test, order, angle)
        square += np.sum((b - a) ** 2), np.sum(a**2)
    return float(math.sqrt(square[0] / square[1]))


def drawn_tests(rng: np.random.Generator, teeth: int, diameter: float) -> list[Test]:
    """Draw four to eight cuts of one or two kinds: feeds, depths, speeds."""
    cutting_speed = rng.uniform(60.0, 400.0)
    speed = float(f"{min(cutting_speed / (math.pi * diameter), 12000.0 / 1.0):.2g}")
    base, depth = rng.uniform(0.05e-3, 0.12e-3), diameter * rng.uniform(0.02, 0.08)
    kinds = []
    for _ in range(int(rng.integers(1, 3))):
        kind = str(rng.choice(["down", "up", "central"]))
        share = 1.0 if kind == "central" else float(rng.uniform(0.25, 0.75))
        reach = math.acos(1.0 - 2.0 * share)
        arc = {"up": (0.0, reach), "down": (math.pi - reach, math.pi), "central": (0.0, math.pi)}[kind]
        kinds.append((kind, share * diameter * 1e3, arc))
    out = []
    for times in (0.6, 1.0, 1.4, 1.8)[: int(rng.integers(3, 5))]:
        kind, width, arc = kinds[0]
        feed = float(f"{base * times:.3g}")
        out.append(Test(Cut(speed, feed, float(f"{depth:.2g}")), *arc, kind, width))
    kind, width, arc = kinds[-1]
    feed = float(f"{base:.3g}")
    out.append(Test(Cut(speed, feed, float(f"{0.5 * depth:.2g}")), *arc, kind, width))
    out.append(Test(Cut(float(f"{0.6 * speed:.2g}"), feed, float(f"{depth:.2g}")), *arc, kind, width))
    if rng.random() < 0.6:
        out.append(Test(Cut(float(f"{1.5 * speed:.2g}"), feed, float(f"{depth:.2g}")), *arc, kind, width))
    return [out[i] for i in rng.permutation(len(out))]


def campaign(path: Path, seed: int, hidden: tuple[str, ...], scale: float = 1.0) -> Answer:
    """Write a campaign and return what is hidden in it."""
    rng = np.random.default_rng([seed, 201])
    teeth, diameter = int(rng.integers(1, 7)), float(rng.choice([10e-3, 16e-3, 25e-3, 50e-3, 80e-3]))
    # Of one insert alone a worn edge is an edge force, which the catalogue knows.
    if {"runout", "one_insert", "dull_insert"} & set(hidden):
        teeth = max(teeth, 2)
    tests = drawn_tests(rng, teeth, diameter)
    kt = math.exp(rng.uniform(math.log(600e6), math.log(2600e6)))
    given = np.array([kt, kt * rng.uniform(0.25, 0.6), kt * rng.uniform(0.05, 0.25)])
    edge = np.array([1.0, rng.uniform(0.6, 1.4), rng.uniform(0.0, 0.2)]) * rng.uniform(8e3, 40e3)
    sigma = float(rng.choice([0.03, 0.05, 0.10]))
    feed = float(np.median([t.cut.feed_per_tooth for t in tests]))
    if set(hidden) & set(LIKE_MATERIAL):  # known well enough that what is hidden is beyond what is stated
        sigma = 0.03
    together = bench.clipped_normal(rng, sigma, 1.0 if set(hidden) & set(LIKE_MATERIAL) else 2.0)
    true = given * (1.0 + together) * (1.0 + 0.2 * sigma * rng.standard_normal(3))
    blunt = edge * (1.0 + bench.clipped_normal(rng, sigma))
    declared = bool(rng.random() < 0.5) and teeth > 1 and "runout" not in hidden
    runout = (rng.uniform(0.05, 0.3) if declared else rng.uniform(0.0, 0.008)) * feed
    angle, helix = float(rng.uniform(0.0, 2.0 * math.pi)), math.radians(float(rng.choice([0.0, 10.0, 30.0])))
    if diameter > 30e-3:
        helix = math.radians(float(rng.choice([0.0, 5.0])))
    real = runout * (1.0 + (0.05 * rng.standard_normal() if declared else 0.0))
    # Of two teeth only the difference of their radii is declared, and right within 5 %: that goes with the cosine.
    turned = 0.05 * min(1.0, 1.0 / abs(math.tan(angle))) if teeth == 2 else 0.05
    mill = Mill(
        diameter=diameter, teeth=teeth, helix=helix, cutting=tuple(true.tolist()), edge=tuple(blunt.tolist()),
        runout=float(real), runout_angle=angle + (turned * float(rng.standard_normal()) if declared else 0.0),
    )  # fmt: skip
    top = max(t.cut.speed for t in tests) / 60.0 * teeth
    rate = float(rng.choice([30.0, 40.0, 60.0])) * top
    rate = float(
        max(1000.0, 2.0 ** math.ceil(math.log2(rate)) if rng.random() < 0.5 else 500.0 * math.ceil(rate / 500.0))
    )
    tools = bench.instruments(rng, rate)
    healthy = Rig(mill, bench.sensitivities(rng), resonance=float(max(1200.0, rng.uniform(12.0, 25.0) * top)))
    signs = {name: float(rng.choice([-1.0, 1.0])) for name in sorted(EFFECTS | OUTSIDE)}
    rig, sizes, cost = healthy, {}, 0.0
    for number, name in enumerate(hidden):
        what, now, draw = (EFFECTS | OUTSIDE)[name], rig, [seed, 203, number]

        def price(s: float, now: Rig = now, name: str = name, draw: list[int] = draw) -> float:
            return cost_of(planted(now, name, s, tests, np.random.default_rng(draw)), now, tests)

        first = what.size * (signs[name] if what.signed else 1.0)
        clearly = GAIN_TOLD if name == "gain" else bench.CLEARLY
        size, cost = bench.raised(first, price, what.switch, clearly=clearly)
        if scale != 1.0:
            size, cost = size * scale, price(size * scale)
        sizes[name], rig = size, planted(now, name, size, tests, np.random.default_rng(draw))
    truths = {f"K{n}c": 1e-6 * k for n, k in zip("tra", rig.mill.cutting, strict=True)}
    if "runout" in hidden:
        # Of two teeth only the difference of their radii is seen.
        seen = abs(math.cos(rig.mill.runout_angle)) if teeth == 2 else 1.0
        truths["runout"] = 1e6 * rig.mill.runout * seen
    _write(path, rig, tests, given, edge, sigma, (runout, angle) if declared else None, tools, rng)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in hidden}
    drawn = {"snr": tools.snr, "teeth": float(teeth), "coefficients": together / sigma, "sigma": sigma}
    alike = tuple(sorted({i for name in hidden for i in (EFFECTS | OUTSIDE)[name].alike}))
    return Answer("cutting", seed, sizes, ids, cost, truths, drawn, alike)


def _write(
    path: Path,
    rig: Rig,
    tests: list[Test],
    given: Real,
    edge: Real,
    sigma: float,
    declared: tuple[float, float] | None,
    tools: Instruments,
    rng: np.random.Generator,
) -> None:
    m = rig.mill
    out = bench.folder(path, rng, "forces")
    radii = None
    if declared is not None:
        pitch = 2.0 * math.pi / m.teeth
        each = declared[0] * np.cos(pitch * np.arange(m.teeth) + declared[1]) * 1e6
        radii = [f"{r:.3f} um" for r in each]
    out.say(
        bench.table(
            "tool",
            diameter=f"{m.diameter * 1e3:g} mm",
            teeth=m.teeth,
            approach_angle="90 deg",
            helix_angle=f"{math.degrees(m.helix):g} deg",
            runout=radii,
        )
    )
    keys = {f"K{n}c": f"{1e-6 * k:.6g} N/mm^2" for n, k in zip("tra", given, strict=True)}
    keys |= {f"K{n}e": f"{1e-3 * k:.5g} N/mm" for n, k in zip("tra", edge, strict=True)}
    out.say(bench.table("material", **keys, uncertainty=f"{100 * sigma:g} %"))
    # A dynamometer under the work measures the reaction.
    under = bool(rng.random() < 0.5)
    sign = ", sign = -1" if under else ""
    out.say("[channels]", 'time = { column = "t", unit = "s" }')
    out.say(*(f'force_{a} = {{ column = "F{a}", unit = "N"{sign} }}' for a in "xyz"))
    out.say("[baseline]", 'forces = "mechanistic"')
    rms = [np.sqrt(np.mean(turn_forces(rig, t, 0.0, np.arange(720) * math.pi / 360.0) ** 2, axis=1)) for t in tests]
    usual = np.median(np.array(rms), axis=0)
    level = np.maximum(usual, 0.1 * usual.max())
    held = int(rng.integers(len(tests))) if rng.random() < 0.5 else -1
    for k, test in enumerate(tests):
        order = k / max(len(tests) - 1, 1)
        rows = _record(rig, test, order, tools, level, rng)
        rows = -rows if under else rows
        columns = {"t": np.arange(rows.shape[1]) / tools.rate} | {f"F{a}": rows[i] for i, a in enumerate("xyz")}
        file = out.record(f"cut_{k + 1}", columns)
        lines = [
            "[[cutting_test]]",
            f'file = "{file}"',
            f'spindle_speed = "{test.cut.speed:g} rpm"',
            f'depth_of_cut = "{test.cut.depth * 1e3:g} mm"',
            f'cut = "{test.kind}"',
            f'width_of_cut = "{test.width:g} mm"',
            f'feed_per_tooth = "{test.cut.feed_per_tooth * 1e3:g} mm"',
        ]
        out.say(*lines, *(["held_out = true"] if k == held else []))
    out.close()


def _record(rig: Rig, test: Test, order: float, tools: Instruments, level: Real, rng: np.random.Generator) -> Real:
    """Forces (3, n) of one cut as they are recorded."""
    times, run_in = 4, 0.2
    inner = times * tools.rate
    speed = test.cut.speed * (1.0 + rng.uniform(-2e-3, 2e-3))
    turns = float(rng.uniform(50.0, 120.0))
    t = np.arange(round((run_in + turns * 60.0 / speed) * inner)) / inner
    w, slow = 2.0 * math.pi * speed / 60.0, 2.0 * math.pi * rng.uniform(0.3, 0.8)
    angle = w * (t - 1e-3 / slow * np.cos(slow * t + rng.uniform(0.0, 6.0))) + rng.uniform(0.0, 6.0)
    grid = np.arange(7200) * 2.0 * math.pi / 7200
    shown = turn_forces(rig, test, order, grid)
    force = np.array([np.interp(angle, grid, row, period=2.0 * math.pi) for row in shown])
    sections = signal.butter(tools.order, 2.0 * tools.corner / times, output="sos")
    rows = signal.sosfilt(sections, force, axis=1)[:, round(run_in * inner) :: times]
    rows = tools.hummed(rows, level, rng)
    rows = rows + (10.0 ** (-tools.snr / 20.0) * level)[:, None] * tools.noise(rows.shape, rng)
    rows = rows + (0.01 * level * rng.standard_normal(3))[:, None]  # the amplifier's offset after its reset
    return tools.converted(rows, np.full(3, 4.0 * np.abs(rows).max()))
