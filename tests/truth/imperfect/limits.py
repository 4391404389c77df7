"""Campaigns of cutting tests that bracket a limit depth, against modes, tool and material of the campaign.

The limits are those of `truth.milling_limits`: the delay equation integrated in time. A machine has a weak mode that
nobody identified, modes and coefficients are known within what the campaign says, depths are cut in steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Real
from truth.milling_limits import Found, Mill, Modes, growth, limit_depth, motion, rate_of

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

TOLD = 50.0
"""Noncentrality to which an effect is raised, beyond noise and whatever the campaign leaves open: the squares of 16 to
22 values are then beyond those of noise alone, at one healthy machine of 2500, in 19 of 20 campaigns."""

MOST = {
    "process_damping": 2.0,
    "coefficients": 1.0,
    "bearings": 0.3,
    "micro_slip": 0.5,
    "coupling": math.radians(40.0),
    "missing_mode": 0.6,
}
"""Sizes that machines have; where an effect cannot be told at these another machine is drawn, at most so often:"""

TRIES = 6

REPEATED, READ, SET = 0.01, 0.003, 2e-5
"""Relative standard deviations of a limit beside its bracket and of a chatter frequency that are trusted, and that to
which a depth is set [m]."""

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
        # Between the peaks of the others: inside one it would have been taken for a part of that.
        f, z = m.modes.frequency, m.modes.damping
        at = float(rng.uniform((1.0 + 1.5 * z[0]) * f[0], (1.0 - 1.5 * z[1]) * f[1]))
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


@dataclass(frozen=True)
class Known:
    """What limits say of a machine: slopes of (log depths, log frequencies), (2n, p), times what each may be off by."""

    frequency: tuple[float, ...]
    depth: tuple[float, ...]
    open: Real

    def change(self, now: Drawn, planted: Drawn) -> Real:
        """Return what an effect changes, (2n,); not known where another lobe governs and the frequency jumps."""
        was, found = [], []
        for (speed, feed), f in zip(now.cuts, self.frequency, strict=True):
            depth, grown = _depth(now.mill, speed, feed), _depth(planted.mill, speed, feed)
            at = _seen(planted.mill, speed, feed, grown, f)[1] if math.isfinite(grown) else math.nan
            was.append((depth, f))
            found.append((grown, at if abs(at / f - 1.0) < 0.03 else math.nan))
        return np.log(np.array(found) / np.array(was)).T.ravel()

    def told(self, change: Real, beside: Sequence[Real] = ()) -> float:
        """Return the noncentrality of an effect by Fisher's information, all that is open fitted anew.

        Open are others `beside` it, too, of any size.
        """
        step = math.hypot(math.log(1.05) / math.sqrt(12.0), REPEATED)
        sd = np.concatenate([np.hypot(step, SET / np.array(self.depth)), np.full(change.size // 2, READ)])
        open_ = np.column_stack([self.open, *(30.0 * np.nan_to_num(b) for b in beside)])
        kept = np.isfinite(change) & np.isfinite(open_).all(axis=1)
        noise = np.diag(sd[kept] ** 2) + open_[kept] @ open_[kept].T
        return float(change[kept] @ np.linalg.solve(noise, change[kept]))


def known_of(d: Drawn, spread: dict[str, float], sigma: float) -> Known:
    """Return what is open of a machine that is known so well; by implicit functions: at a limit nothing grows."""
    columns, frequency = [], []
    m, n = d.mill, len(d.mill.modes.frequency)
    for speed, feed in d.cuts:
        depth = _depth(m, speed, feed)
        if not math.isfinite(depth):
            frequency.append(math.nan)
            columns.append(np.full((2, 3 * n + 2), math.nan))
            continue
        f = growth(m, speed, depth, depth * feed)[1]
        frequency.append(f)
        here, deeper = (np.array(_seen(m, speed, feed, depth * (1.0 + s), f)) for s in (0.0, 0.02))
        over = (deeper - here) / math.log(1.02)
        moved = [replace(m, modes=_moved(m.modes, k, r, s)) for k, s in spread.items() for r in range(n)]
        moved += [replace(m, kt=m.kt * 1.03, kr=m.kr * 1.03), replace(m, kr=m.kr * (1.0 + 0.2 * sigma))]
        change = np.array([np.array(_seen(x, speed, feed, depth, f)) - here for x in moved])
        change[-2] *= sigma / 0.03
        deep = -change[:, 0] / over[0]
        columns.append(np.array([deep, (change[:, 1] + over[1] * deep) / f]))
    return Known(
        tuple(frequency),
        tuple(_depth(m, *cut) for cut in d.cuts),
        np.swapaxes(np.array(columns), 0, 1).reshape(-1, 3 * n + 2),
    )


def _told(
    open_: Known, now: Drawn, there: Drawn, beside: Sequence[Real], spread: dict[str, float], sigma: float
) -> tuple[float, Real]:
    """Return the noncentrality of an effect, the least of both ends, and what it changes.

    Beyond a kink of the lobes what is open does another thing to the machine with the effect: a mode 1.7 % higher did
    there what a coupling of 25 degrees does, which the slopes of the machine without it do not tell.
    """
    change = open_.change(now, there)
    least = open_.told(change, beside)
    if least >= TOLD:
        least = min(least, known_of(there, spread, sigma).told(change, beside))
    return least, change


def _moved(modes: Modes, name: str, r: int, share: float) -> Modes:
    """Change one value of one mode."""
    return replace(modes, **{name: tuple(v * (1.0 + share * (i == r)) for i, v in enumerate(getattr(modes, name)))})


def _seen(mill: Mill, speed: float, feed: float, depth: float, near: float) -> tuple[float, float]:
    """Return growth [1/s] and frequency [Hz] of a motion whose line is near a frequency, by the turn of its phase."""
    late, step, _ = motion(mill, speed, depth, depth * feed, 60.0)
    rate = rate_of(late, step)
    t = step * np.arange(late.shape[0])
    turned = (late * np.exp(-rate * t)[:, None]) @ np.array([1.0, 0.3]) * np.exp(-2j * math.pi * near * t)
    pieces = np.array([p @ np.hanning(p.size) for p in np.array_split(turned, 8)])
    turns = np.polyfit(np.arange(8) * t[-1] / 8.0, np.unwrap(np.angle(pieces)), 1)[0]
    return rate, near + float(turns) / (2.0 * math.pi)


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
    """Write a campaign and return what is hidden in it.

    Another machine is drawn where what is hidden cannot be told at any size that machines have.
    """
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, 401, attempt] if attempt else [seed, 401])
        planned = _planned(rng, seed, hidden, scale)
        if planned.told:
            break
    return _written(path, seed, planned, rng)


@dataclass(frozen=True)
class Planned:
    """A machine as it is known and as it is, effects with their sizes, what they cost, and whether they can be told."""

    known: Drawn
    real: Drawn
    spread: dict[str, float]
    sigma: float
    sizes: dict[str, float]
    cost: float
    told: bool


def _planned(rng: np.random.Generator, seed: int, hidden: tuple[str, ...], scale: float) -> Planned:
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
    sizes, cost, told, others = dict[str, float](), 0.0, True, list[Real]()
    open_ = known_of(d, spread, sigma) if set(hidden) & set(EFFECTS) else None
    if "coefficients" in hidden[1:]:
        others.append(np.repeat([1.0, 0.0], len(d.cuts)))
    for number, name in enumerate(hidden):
        what, now, draw = (EFFECTS | OUTSIDE)[name], d, [seed, 403, number]

        def turned_to(s: float, now: Drawn = now, name: str = name, draw: list[int] = draw) -> Drawn:
            return planted(now, name, s, np.random.default_rng(draw))

        def price(s: float, now: Drawn = now, name: str = name, draw: list[int] = draw) -> float:
            return cost_of(turned_to(s), now)

        size = what.size * (signs[name] if what.signed else 1.0)
        if name == "islands":
            cost = size
        else:
            size, _ = bench.raised(size, price, what.switch, MOST[name] / what.size)
            while (seen := _told(open_, now, turned_to(size), others, spread, sigma))[0] < TOLD:
                if abs(size) * 1.12 > MOST[name]:
                    told = False
                    break
                # The noncentrality goes with the square of a size.
                size *= min(max(math.sqrt(TOLD / max(seen[0], 1e-9)), 1.12), 1.5, MOST[name] / abs(size))
            others, cost = [seen[1]], price(size)
            told = told and cost > bench.MATERIAL
            if scale != 1.0:
                size, cost = size * scale, price(size * scale)
        sizes[name], d = size, planted(now, name, size, np.random.default_rng(draw))
    return Planned(known, d, spread, sigma, sizes, cost, told)


def _written(path: Path, seed: int, planned: Planned, rng: np.random.Generator) -> Answer:
    """Look for the limits of a machine in steps, and write what was found."""
    known, d, sizes, sigma = planned.known, planned.real, planned.sizes, planned.sigma
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
    _write(path, known, found, planned.spread, sigma, rng)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in sizes}
    alike = tuple(i for name in sizes for i in (EFFECTS | OUTSIDE)[name].alike)
    return Answer("limits", seed, sizes, ids, planned.cost, {}, {"sigma": sigma, "limits": float(len(found))}, alike)


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
