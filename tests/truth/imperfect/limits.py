"""Campaigns of cutting tests that bracket a limit depth, against modes, tool and material of the campaign.

The limits are those of `truth.milling_limits`: the delay equation integrated in time. A machine has a weak mode that
nobody identified, modes and coefficients are known within what the campaign says, depths are cut in steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Real
from truth.milling_limits import Found, Mill, Modes, growth, limit_depth

EFFECTS = {
    "process_damping": Hiding(0.2, "of the depth at the lowest speed", ("process_damping",)),
    "coefficients": Hiding(0.35, "", ("force_coefficients",), alike=("modal_scale",)),
    "bearings": Hiding(0.05, "of the frequencies at the highest speed", ("spindle_speed_dynamics",)),
    "micro_slip": Hiding(0.12, "of the stiffness", ("joint_micro_slip",)),
    "coupling": Hiding(math.radians(25.0), "rad", ("cross_axis_coupling",), True),
    "missing_mode": Hiding(0.12, "of the softest mode", ("missing_mode",)),
}
"""What the catalogue of limits knows."""

OUTSIDE = {"islands": Hiding(0.12, "", ())}
"""What it does not know: limits that are higher at every other speed, as of a work that another cut left."""

PAIRS = (("process_damping", "coefficients"), ("bearings", "coefficients"))


@dataclass(frozen=True)
class Drawn:
    """The mill, and the spindle speeds [rpm] and feeds per tooth [m] at which its limits are looked for."""

    mill: Mill
    speeds: tuple[float, ...]
    feeds: tuple[float, ...]
    kind: str
    width: float
    kt: float
    """Tangential coefficient that is declared [N/m2]."""

    @property
    def cuts(self) -> list[tuple[float, float]]:
        """Speed [rpm] and feed per tooth [m] of each limit: of a second feed few."""
        few = self.speeds[:: max(1, len(self.speeds) // 3)]
        return [(s, feed) for feed in self.feeds for s in (self.speeds if feed == self.feeds[0] else few)]


def drawn(rng: np.random.Generator) -> Drawn:
    """Draw a machine with two modes or three, its cut and its speeds."""
    first = math.exp(rng.uniform(math.log(45.0), math.log(400.0)))
    count = int(rng.integers(2, 4))
    f = first * np.array([1.0, rng.uniform(1.2, 1.6), rng.uniform(1.7, 2.2)])[:count]
    zeta = rng.uniform(0.025, 0.06, count)
    k = math.exp(rng.uniform(math.log(8e6), math.log(4e7))) * np.array(
        [1.0, rng.uniform(1.0, 1.8), rng.uniform(1.5, 3.0)]
    )
    angle = np.array([0.0, 0.5 * math.pi, rng.uniform(0.3, 1.2)])[:count] + 0.2 * rng.standard_normal(count)
    modes = Modes(
        tuple(f.tolist()),
        tuple(zeta.tolist()),
        tuple(k[:count].tolist()),
        tuple((math.cos(a), math.sin(a)) for a in angle),
    )
    teeth = int(rng.integers(2, 6))
    diameter = float(rng.choice([0.02, 0.05, 0.08])) if first > 120.0 else float(rng.choice([0.05, 0.08, 0.125]))
    kind = str(rng.choice(["central", "down"]))
    share = 1.0 if kind == "central" else float(rng.choice([0.5, 0.7]))
    reach = math.acos(1.0 - 2.0 * share)
    arc = (0.0, math.pi) if kind == "central" else (math.pi - reach, math.pi)
    kt = math.exp(rng.uniform(math.log(700e6), math.log(2200e6)))
    waves = np.sort(rng.uniform(1.2, 7.0, int(rng.integers(6, 9))))
    speeds = tuple(sorted({float(f"{60.0 * first / teeth / w:.3g}") for w in waves}))
    feeds = (1e-4, 2.5e-4) if rng.random() < 0.5 else (1e-4,)
    mill = Mill(
        modes, diameter, teeth, *arc, kt, kt * float(rng.uniform(0.25, 0.5)), fastest=speeds[-1],
        extra=(0.004 / float(k[0]), 2.6 * float(f[-1]), 0.04),
    )  # fmt: skip
    return Drawn(mill, speeds, feeds, kind, share * diameter, kt)


def planted(d: Drawn, name: str, size: float, rng: np.random.Generator) -> Drawn:
    """Hide an effect of a size."""
    m = d.mill
    if name == "process_damping":
        lowest = d.speeds[0]
        sharp = _depth(m, lowest)
        flank, high = 3e4, 0.0
        for _ in range(8):
            gain = _depth(replace(m, flank=flank), lowest) / sharp - 1.0
            if abs(gain / size - 1.0) < 0.05:
                break
            flank *= min(max(size / max(gain, 1e-3), 0.2), 5.0)
            high = max(high, flank)
        return replace(d, mill=replace(m, flank=flank))
    if name == "coefficients":
        # Of what is declared: a third too much of what is a tenth too little by its tolerance is a fifth.
        return replace(d, mill=replace(m, kt=d.kt * (1.0 + size), kr=m.kr * d.kt / m.kt * (1.0 + size)))
    if name == "bearings":
        return replace(d, mill=replace(m, linear=-size))
    if name == "micro_slip":
        middle = _depth(m, d.speeds[len(d.speeds) // 2])
        return replace(d, mill=replace(m, slip=size, level=max(d.feeds) * middle))
    if name == "coupling":
        return replace(d, mill=replace(m, turn=size))
    if name == "missing_mode":
        f = m.modes.frequency
        at = float(rng.uniform(1.08 * f[0], 0.95 * f[1]))
        return replace(d, mill=replace(m, extra=(size / m.modes.stiffness[0], at, float(rng.uniform(0.03, 0.05)))))
    if name == "islands":
        return d
    raise ValueError(f"no effect '{name}' of limits")


def cost_of(d: Drawn, before: Drawn) -> float:
    """Change of the limit depths as it is defined to matter, at every second limit.

    The larger of that of the least depth and of the rms of the relative changes: a lobe that moves changes the depth at
    one speed a lot, and those that a workshop would choose not at all.
    """
    was, now = (np.array([_depth(x.mill, *cut) for cut in d.cuts[::2]]) for x in (before, d))
    known = np.isfinite(was) & np.isfinite(now)
    was, now = was[known], now[known]
    least = abs(float(now.min() / was.min()) - 1.0)
    return max(least, float(np.sqrt(np.mean(np.minimum(np.abs(now / was - 1.0), 1.0) ** 2))))


@cache
def _depth(mill: Mill, speed: float, feed: float = 1e-4) -> float:
    return limit_depth(mill, speed, feed)


def as_built(d: Drawn, spread: dict[str, float], sigma: float, rng: np.random.Generator) -> Drawn:
    """The machine and the work a little other than the campaign says, within what it says."""
    m, n = d.mill, len(d.mill.modes.frequency)
    wrong = {k: 1.0 + s * np.clip(rng.standard_normal(n), -2.0, 2.0) for k, s in spread.items()}
    modes = replace(
        m.modes,
        frequency=tuple((np.array(m.modes.frequency) * wrong["frequency"]).tolist()),
        damping=tuple((np.array(m.modes.damping) * wrong["damping"]).tolist()),
        stiffness=tuple((np.array(m.modes.stiffness) * wrong["stiffness"]).tolist()),
    )
    together = 1.0 + bench.clipped_normal(rng, sigma)
    return replace(
        d,
        mill=replace(
            m, modes=modes, kt=m.kt * together, kr=m.kr * together * (1.0 + 0.2 * sigma * rng.standard_normal())
        ),
    )


def campaign(path: Path, seed: int, hidden: tuple[str, ...], scale: float = 1.0) -> Answer:
    """Write a campaign and return what is hidden in it."""
    rng = np.random.default_rng([seed, 401])
    known = drawn(rng)
    spread = {
        "frequency": float(rng.choice([0.005, 0.01])),
        "damping": float(rng.choice([0.1, 0.2])),
        "stiffness": float(rng.choice([0.02, 0.05])),
    }
    sigma = float(rng.choice([0.03, 0.05, 0.1]))
    if set(hidden) & set(EFFECTS) or (not hidden and rng.random() < 0.5):
        # Known well enough that an effect can be told, and as often where there is none. Coefficients within 10 % and
        # damping within 20 % leave limits within 22 %: a coupling that changes them by 13 % is then at 1.9 standard
        # deviations by Fisher's information of eight limits, whoever judges it. At 5 % each coefficients 35 % off are
        # at five, one more or less by what they really are: one of twenty below those 3.3 at which a healthy machine
        # is one of a thousand.
        spread, sigma = {"frequency": 0.005, "damping": 0.05, "stiffness": 0.02}, 0.03
    if "micro_slip" in hidden:  # its level is the feed: at one feed a joint is a mode that is softer than identified
        known = replace(known, feeds=(1e-4, 2.5e-4))
    if "coupling" in hidden and known.kind == "central":
        # A slot hardly knows directions: 25 degrees are at 3.6 standard deviations there, at 8 to 20 in side cuts.
        side = replace(known.mill, entry=math.pi - math.acos(-0.2), leave=math.pi)
        known = replace(known, mill=side, kind="down", width=0.6 * side.diameter)
    d = as_built(known, spread, sigma, rng)
    signs = {name: float(rng.choice([-1.0, 1.0])) for name in sorted(EFFECTS | OUTSIDE)}
    sizes, cost = {}, 0.0
    for number, name in enumerate(hidden):
        what, now, draw = (EFFECTS | OUTSIDE)[name], d, [seed, 403, number]

        def price(s: float, now: Drawn = now, name: str = name, draw: list[int] = draw) -> float:
            return cost_of(planted(now, name, s, np.random.default_rng(draw)), now)

        size = what.size * (signs[name] if what.signed else 1.0)
        if name == "islands":
            cost = size
        else:
            size, cost = bench.raised(size, price, what.switch)
            if scale != 1.0:
                size, cost = size * scale, price(size * scale)
        sizes[name], d = size, planted(now, name, size, np.random.default_rng(draw))
    ratio = 1.0 + float(rng.uniform(0.04, 0.06))
    found = []
    for speed, feed in d.cuts:
        depth = _depth(d.mill, speed, feed)
        if not math.isfinite(depth):
            continue
        frequency = growth(d.mill, speed, depth, depth * feed)[1]
        if "islands" in sizes and d.speeds.index(speed) % 2:
            depth *= 1.0 + sizes["islands"]
        below = depth * ratio ** -rng.uniform()
        found.append(Found(speed, feed, below, below * ratio, frequency * (1.0 + 0.002 * rng.standard_normal())))
    _write(path, known, found, spread, sigma, rng)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in hidden}
    alike = tuple(i for name in hidden for i in (EFFECTS | OUTSIDE)[name].alike)
    return Answer("limits", seed, sizes, ids, cost, {}, {"sigma": sigma, "limits": float(len(found))}, alike)


def _write(
    path: Path, known: Drawn, found: list[Found], spread: dict[str, float], sigma: float, rng: np.random.Generator
) -> None:
    m = known.mill
    out = bench.folder(path, rng, "limits", (".mat", ".h5"))
    out.say(bench.table("tool", diameter=f"{m.diameter * 1e3:g} mm", teeth=m.teeth, approach_angle="90 deg"))
    out.say(
        bench.table(
            "material",
            Ktc=f"{m.kt * 1e-6:.6g} N/mm^2",
            Krc=f"{m.kr * 1e-6:.6g} N/mm^2",
            Kac="0 N/mm^2",
            uncertainty=f"{100 * sigma:g} %",
        )
    )
    out.say("[channels]", 'time = { column = "t", unit = "s" }', 'acceleration_x = { column = "a", unit = "m/s^2" }')
    each = [
        f'    {{ frequency = "{f:.6g} Hz", damping = {z:.5g}, stiffness = "{k * 1e-6:.6g} N/um", '
        f"direction = [{x:.6g}, {y:.6g}, 0] }},"
        for f, z, k, (x, y) in zip(
            m.modes.frequency, m.modes.damping, m.modes.stiffness, m.modes.direction, strict=True
        )
    ]
    words = ", ".join(f'{n} = "{100 * s:g} %"' for n, s in spread.items())
    out.say("[[model]]", 'name = "identified"', "modes = [", *each, "]", f"uncertainty = {{ {words} }}")
    out.say("[baseline]", 'limits = "identified"')
    tools = bench.instruments(rng, float(rng.choice([8.0, 12.0])) * max(m.modes.frequency))
    stated = bool(rng.random() < 0.5)
    for number, f in enumerate(found):
        for verdict, depth, line in (("stable", f.stable, None), ("chatter", f.chatter, f.frequency)):
            rows = vibration(m.teeth, f.speed, line, tools, rng)
            file = out.record(f"{number + 1}_{verdict[0]}", {"t": np.arange(rows.size) / tools.rate, "a": rows})
            out.say(
                "[[cutting_test]]",
                f'file = "{file}"',
                f'spindle_speed = "{f.speed:g} rpm"',
                f'depth_of_cut = "{depth * 1e3:.5g} mm"',
                f'cut = "{known.kind}"',
                f'width_of_cut = "{known.width * 1e3:.6g} mm"',
                f'feed_per_tooth = "{f.feed * 1e3:g} mm"',
                *([f'observed = "{verdict}"'] if stated else []),
            )
    out.close()


def vibration(
    teeth: int, speed: float, chatter: float | None, tools: bench.Instruments, rng: np.random.Generator
) -> Real:
    """Acceleration of a cut: the teeth, run-out, noise and mains, and where it chatters its line with side lines."""
    turn = speed / 60.0 * (1.0 + 1e-3 * rng.standard_normal())
    t = np.arange(round(max(4.0, 60.0 / turn) * tools.rate)) / tools.rate
    out = 0.2 * np.sin(2.0 * np.pi * turn * t + rng.uniform(0.0, 6.0))
    for k in range(1, 6):
        if k * teeth * turn < 0.4 * tools.rate:
            out = out + rng.uniform(0.5, 1.2) / k * np.cos(2.0 * np.pi * k * teeth * turn * t + rng.uniform(0.0, 6.0))
    if chatter is not None:
        size = rng.uniform(4.0, 10.0)
        out = out + size * np.sin(2.0 * np.pi * chatter * t + rng.uniform(0.0, 6.0))
        for side in (-1.0, 1.0):
            f = chatter + side * teeth * turn
            if 0.0 < f < 0.4 * tools.rate:
                out = out + 0.15 * size * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0))
    rows = tools.hummed(out[None], np.array([1.0]), rng)
    rows = rows + 10.0 ** (-tools.snr / 20.0) * tools.noise(rows.shape, rng)
    return tools.converted(rows, np.array([20.0]))[0]
