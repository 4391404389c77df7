"""Campaigns of one axis that moves: encoder and drive force, against a rigid axis with viscous friction.

A sampled cascade with feed-forward and an integral part, its force held for a cycle and late; friction by LuGre's
bristles or by Maxwell's slipping elements, of an axis on rails; none but viscous of one on oil or air. Of some the
campaign gives the friction, off by a few per cent, as somebody has it from an earlier test; nobody gives the exponent
of the Stribeck curve, which is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numba import njit
from scipy import signal

from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Real

EFFECTS = {
    "friction": Hiding(0.05, "of the largest force", ("guideway_friction",)),
    "stribeck": Hiding(0.03, "of the largest force", ("low_speed_friction",)),
    # Of a size that guideways have: it holds the axis at rest, and in motion it is little beside the sliding friction.
    "sticking": Hiding(0.4, "over sliding", ("low_speed_friction", "guideway_friction"), switch=True),
    "asymmetry": Hiding(0.1, "of the viscous friction", ("friction_asymmetry",), True),
    "delay": Hiding(0.25e-3, "s", ("loop_delay",)),
    "ripple": Hiding(0.02, "of the largest force", ("position_ripple",)),
    "drift": Hiding(0.03, "", ("drift",), True),
    "slope": Hiding(0.05, "of the largest force over the stroke", ("position_friction",), True),
    "command": Hiding(0.1, "of the largest force", ("hidden_input",), True),
    "saturation": Hiding(0.1, "", ("drive_saturation",)),
    "tone": Hiding(0.03, "of the largest force", ("background_tone",)),
    "force_gain": Hiding(-0.13, "", ("sensor_gain", "declared_mass"), switch=True),
}
"""What the catalogue of drive records knows."""

OUTSIDE = {
    "pushes": Hiding(0.05, "of the largest force", (), True),
    "viscous_walk": Hiding(0.1, "", ()),
}
"""What it does not know: a force that comes and goes, friction that wanders with the temperature."""

ON_RAILS = 0.6
"""Share of the axes with an effect that have Coulomb friction besides."""

TOLD = 0.7
"""Share of the healthy axes, and of those with an effect in spite of friction, whose friction the campaign gives."""

OFF = 0.04
"""Standard deviation of what is given of it, relative."""

COSTED = 10.0
"""Seconds of moves by which the cost of an effect is reckoned."""

LASTING = ("drift", "viscous_walk", "slope")

NEED_FRICTION = ("sticking", "stribeck")

PAIRS = (("friction", "delay"), ("friction", "asymmetry"), ("friction", "stribeck"), ("friction", "ripple"))


@dataclass(frozen=True)
class Axis:
    """The axis (SI). kind 0: LuGre, 1: Maxwell slip; `bend`: how far the bristles give way before they slide.

    oil: Stribeck part over Coulomb, gone over `slow` with the exponent `curve`. cycle: of the control; lag: whole
    cycles until the force acts; late: beyond. walk: relative wander of the viscous friction. added: pulses on the
    command; pushed: on the axis, at random.
    """

    mass: float
    viscous: float
    constant: float
    coulomb: float = 0.0
    oil: float = 0.0
    slow: float = 0.01
    curve: float = 1.0
    bend: float = 5e-6
    kind: int = 0
    forth: float = 0.0
    ripple: float = 0.0
    lead: float = 5e-3
    slope: float = 0.0
    drift: float = 0.0
    walk: float = 0.0
    limit: float = math.inf
    added: float = 0.0
    pushed: float = 0.0
    kp: float = 0.0
    ti: float = math.inf
    kv: float = 0.0
    ahead: float = 1.0
    cycle: float = 0.5e-3
    lag: int = 1
    late: float = 0.0
    quantum: float = 1e-7
    noise: float = 0.0
    shiver: float = 0.0


@njit(cache=True, nogil=True)
def _run(target, added, pushed, warm, steps, p, kind, lag, late, noise, shiver, quantum, middle):
    """Encoder and what it reads before it is rounded, commanded force, at the beginning of each cycle of some steps.

    `late` is counted in steps.
    """
    (
        mass,
        viscous,
        constant,
        coulomb,
        oil,
        slow,
        curve,
        bend,
        forth,
        ripple,
        lead,
        slope,
        drift,
        limit,
        kp,
        ti,
        kv,
        ahead,
        cycle,
    ) = p
    n = target.size
    h = cycle / steps
    seen, place, told = np.zeros(n), np.zeros(n), np.zeros(n)
    x, v, z = target[0], 0.0, 0.0
    element = np.zeros(4)
    share = np.array([0.1, 0.2, 0.3, 0.4])
    reach = np.array([0.4, 0.8, 1.2, 2.0])
    integral = constant
    for k in range(n):
        place[k] = x + shiver[k]
        seen[k] = np.round(place[k] / quantum) * quantum
        before = seen[k - 1] if k > 0 else seen[k]
        wanted = (target[min(k + 1, n - 1)] - target[k]) / cycle
        speed = (seen[k] - before) / cycle
        error = kv * (target[k] - seen[k]) + ahead * wanted - speed
        if math.isfinite(ti) and abs(kp * error + integral) < limit:  # it does not wind up
            integral += kp * error * cycle / ti
        command = kp * error + integral
        told[k] = command + added[k]
        for j in range(steps):
            back = lag + (0 if j >= late else 1)
            force = told[k - back] if k >= back else constant
            force = min(max(force, -limit), limit)
            dry = 0.0
            top = coulomb + oil * math.exp(-((abs(v) / slow) ** curve))
            if top > 0.0:
                if kind == 0:
                    edge = top / max(coulomb, 1e-9) * bend if coulomb > 0.0 else bend
                    if abs(v) > 0.0:
                        goal = math.copysign(edge, v)
                        z = goal + (z - goal) * math.exp(-abs(v) * h / edge)
                    dry = top * z / edge
                else:
                    for i in range(4):
                        most = bend * reach[i]
                        element[i] = min(max(element[i] + v * h, -most), most)
                        dry += top * share[i] * element[i] / most
            slick = viscous * (1.0 + warm[k] + drift * (k / n - 0.5))
            other = constant + ripple * math.sin(2.0 * math.pi * x / lead) + slope * (x - middle) + forth * abs(v)
            rest = force - dry - other + pushed[k] + noise[k]
            v = (v + h / mass * rest) / (1.0 + h / mass * slick)
            x += h * v
    return seen, place, told


FEEDS = (0.25, 0.5, 0.75, 1.0)
"""Speeds of the moves of a record, over the greatest."""

SLOW_FEEDS = (0.04, 0.12, 0.3, 1.0)
"""The same where friction falls with speed near rest: at usual feeds it lasts for moments, and what does not exceed the
sliding friction costs 2 % of the force."""

SLIDING = 2.0
"""Times the usual sliding friction of an axis whose friction falls with speed: a guideway without rolling elements."""

LONGEST = 3.0
"""Seconds of a move at least that may be too slow to reach the end of the stroke."""


def moves(
    rng: np.random.Generator, cycle: float, speed: float, push: float, seconds: float, feeds: Sequence[float] = FEEDS
) -> Real:
    """Reference at every cycle: moves to and fro over a stroke from rest to rest, with pauses, edges rounded."""
    rest = float(rng.choice([0.05, 0.3, 0.8]))
    parts: list[Real] = [np.zeros(round(0.3 / cycle))]
    place, total, k = 0.0, 0.0, 0
    stroke = speed * rng.uniform(0.8, 1.5)
    cycle_of = rng.permutation(feeds)
    while total < seconds:
        fast = speed * float(cycle_of[k % 4])
        goal = (stroke if k % 2 == 0 else 0.0) + 0.08 * stroke * rng.uniform(-1.0, 1.0)
        way = goal - place
        if min(feeds) < min(FEEDS) and abs(way) > LONGEST * fast < LONGEST * min(FEEDS) * speed:
            way = math.copysign(LONGEST * fast, way)
            goal = place + way
        up = fast / push
        if fast * up > abs(way):
            up = math.sqrt(abs(way) / push)
            fast = up * push
        length = abs(way) / fast + up
        t = np.arange(round(length / cycle)) * cycle
        v = math.copysign(1.0, way) * np.clip(push * np.minimum(t, length - t), 0.0, fast)
        parts += [v, np.zeros(round(rest * rng.uniform(0.8, 1.2) / cycle) + 1)]
        total += length
        place, k = goal, k + 1
    window = max(3, round(rng.uniform(0.01, 0.03) / cycle))
    smooth = np.convolve(np.concatenate(parts), np.ones(window) / window, mode="same")
    return np.cumsum(smooth) * cycle


@dataclass(frozen=True)
class Drawn:
    """The axis, its moves, and how it is logged: every so many cycles."""

    axis: Axis
    target: Real
    every: int
    seed: int

    @property
    def force(self) -> float:
        """Largest force that the moves ask for [N]."""
        v = np.gradient(self.target, self.axis.cycle)
        a = np.gradient(np.convolve(v, np.ones(20) / 20, mode="same"), self.axis.cycle)
        return float(np.quantile(np.abs(self.axis.mass * a + self.axis.viscous * v), 0.98))


def simulated(d: Drawn, quiet: bool = False) -> tuple[Real, Real, Real]:
    """Encoder, what it reads before it is rounded [m] and command [N] at every cycle.

    `quiet`: without noise, and with an encoder so fine that two runs differ by nothing but the axis.
    """
    a, n = d.axis, d.target.size
    rng = np.random.default_rng(d.seed)
    t = np.arange(n) * a.cycle
    pole = math.exp(-2.0 * math.pi * rng.uniform(20.0, 80.0) * a.cycle)
    noise = signal.lfilter([math.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(n))
    wander = np.cumsum(rng.standard_normal(n)) / math.sqrt(n)
    pushed, added = np.zeros(n), np.zeros(n)
    for begin in rng.uniform(1.0, t[-1] - 1.0, round(t[-1] / 2.0)):
        pushed[(t >= begin) & (t < begin + 0.25)] += a.pushed * rng.uniform(0.6, 1.4)
    for begin in np.arange(rng.uniform(0.5, 1.0), t[-1], rng.uniform(1.0, 2.0)):
        added[(t >= begin) & (t < begin + 0.06)] = a.added
    steps = max(8, round(a.cycle / 2e-5))
    whole, part = divmod(a.late, a.cycle)
    p = (
        a.mass, a.viscous, a.constant, a.coulomb, a.oil, a.slow, a.curve, a.bend, a.forth, a.ripple, a.lead, a.slope,
        a.drift, a.limit, a.kp, a.ti, a.kv, a.ahead, a.cycle,
    )  # fmt: skip
    shake = 0.0 if quiet else 1.0
    return _run(
        d.target, added, pushed, a.walk * wander, steps, p, a.kind, a.lag + int(whole), round(part / a.cycle * steps),
        shake * a.noise * noise, shake * a.shiver * rng.standard_normal(n), 1e-13 if quiet else a.quantum,
        float(np.mean(d.target)),
    )  # fmt: skip


def drawn(rng: np.random.Generator, feeds: Sequence[float] = FEEDS) -> Drawn:
    """Draw an axis without dry friction, its control and its moves."""
    cycle = float(rng.choice([0.25e-3, 0.5e-3, 1e-3]))
    mass = math.exp(rng.uniform(math.log(20.0), math.log(1500.0)))
    speed, push = rng.uniform(0.1, 0.7), rng.uniform(1.2, 6.0)
    wide = rng.uniform(12.0, 30.0) if cycle > 0.6e-3 else rng.uniform(15.0, 45.0)
    kp = mass * 2.0 * math.pi * wide
    viscous = mass * push / speed * rng.uniform(0.1, 0.4)
    axis = Axis(
        mass=mass,
        viscous=viscous,
        constant=mass * push * float(rng.uniform(-0.05, 0.05)),
        kp=kp,
        ti=float(rng.choice([math.inf, 1.0])) * float(rng.uniform(5.0, 12.0)) / (2.0 * math.pi * wide),
        kv=2.0 * math.pi * wide * float(rng.uniform(0.12, 0.22)),
        ahead=float(rng.choice([1.0, 1.0, 0.0])),
        cycle=cycle,
        lag=int(rng.integers(0, 2)),
        late=float(rng.uniform(0.0, 0.6)) * cycle,
        quantum=float(rng.choice([1e-8, 5e-8, 1e-7])),
        shiver=float(rng.uniform(0.3, 1.0)) * 2e-8,
        lead=float(rng.choice([5e-3, 10e-3, 20e-3])),
        slow=speed * float(rng.uniform(0.03, 0.1)),
        bend=float(rng.uniform(2e-6, 10e-6)),
        kind=int(rng.integers(2)),
    )
    target = moves(rng, cycle, speed, push, float(rng.uniform(60.0, 110.0)), feeds)
    every = max(1, round(1e-3 / cycle)) if rng.random() < 0.7 else 1
    return Drawn(axis, target, every, int(rng.integers(2**31)))


def planted(d: Drawn, name: str, size: float) -> Drawn:
    """Hide an effect of a size in the axis."""
    a, most = d.axis, d.force
    reach = float(np.ptp(d.target))
    changes = {
        "friction": {"coulomb": a.coulomb + size * most},
        "stribeck": {"oil": a.oil + size * most},
        "sticking": {"oil": a.oil + size * a.coulomb},
        "asymmetry": {"forth": size * a.viscous},
        "delay": {"late": a.late + size},
        "ripple": {"ripple": size * most},
        "drift": {"drift": size},
        "slope": {"slope": size * most / reach},
        "command": {"added": size * most},
        "saturation": {"limit": (1.0 - size) * (most + a.coulomb)},
        "pushes": {"pushed": size * most},
        "viscous_walk": {"walk": size},
        "tone": {},
        "force_gain": {},
    }
    if name not in changes:
        raise ValueError(f"no effect '{name}' of a drive record")
    return replace(d, axis=replace(a, **changes[name]))


@dataclass(frozen=True)
class Logged:
    """What happens to the force on its way to the file: its gain, and a tone [N] at a frequency [Hz]."""

    gain: float
    tone: float = 0.0
    frequency: float = 21.3

    def shown(self, force: Real, t: Real) -> Real:
        """The force as it is logged."""
        return force * self.gain + self.tone * np.sin(2.0 * math.pi * self.frequency * t)


def logged(log: Logged, name: str, size: float, d: Drawn) -> Logged:
    """Hide an effect in the log."""
    if name == "tone":
        return replace(log, tone=size * d.force)
    return replace(log, gain=log.gain * (1.0 + size)) if name == "force_gain" else log


def campaign(path: Path, seed: int, hidden: tuple[str, ...], scale: float = 1.0) -> Answer:
    """Write a campaign and return what is hidden in it."""
    rng = np.random.default_rng([seed, 301])
    d = drawn(rng, SLOW_FEEDS if "stribeck" in hidden else FEEDS)
    log = Logged(1.0 + 0.01 * rng.standard_normal(), frequency=float(rng.uniform(11.0, 30.0)))
    rails, level = bool(rng.random() < ON_RAILS), float(rng.uniform(0.08, 0.25))
    more = np.random.default_rng([seed, 302])
    d = replace(d, axis=replace(d.axis, curve=float(more.choice([1.0, 2.0, more.uniform(0.6, 2.0)]))))
    if "stribeck" in hidden:
        level *= SLIDING
    signs = {name: float(rng.choice([-1.0, 1.0])) for name in sorted(EFFECTS | OUTSIDE)}
    known, law = set(hidden), ""
    if (rails or not hidden) and not known & {"friction", "force_gain", *NEED_FRICTION} and more.random() < TOLD:
        rails, d, law = False, *_told(more, d, level)
    if hidden and "friction" not in hidden and ((rails and known <= set(EFFECTS)) or known & set(NEED_FRICTION)):
        hidden = ("friction", *hidden)
    sizes, cost = {}, 0.0
    for name in hidden:
        what, now, was = (EFFECTS | OUTSIDE)[name], d, log
        # Its first moves say what an effect costs; what changes over the record needs all of it.
        cut = now.target.size if name in LASTING else min(now.target.size, round(COSTED / now.axis.cycle))
        t = np.arange(cut) * now.axis.cycle
        before = was.shown(simulated(replace(now, target=now.target[:cut]), quiet=True)[2], t)

        def price(
            s: float, now: Drawn = now, was: Logged = was, name: str = name, t: Real = t, before: Real = before
        ) -> float:
            changed = planted(now, name, s)
            told = simulated(replace(changed, target=changed.target[: t.size]), quiet=True)[2]
            after = logged(was, name, s, now).shown(told, t)
            if name == "force_gain":  # the stated mass gives it away
                return abs(s)
            return _unexplained(after - before, now, t) / float(np.std(before[_moving(now, t)]))

        first = what.size * (signs[name] if what.signed else 1.0)
        if name == "friction" and len(hidden) > 1:
            size, cost = level, price(level)
        else:
            # Friction at rest is at most twice that of sliding.
            largest = d.axis.coulomb / (first * d.force) if name == "stribeck" else bench.LARGEST
            size, cost = bench.raised(first, price, what.switch, largest)
            if scale != 1.0:
                size, cost = size * scale, price(size * scale)
        sizes[name] = size
        d, log = planted(d, name, size), logged(log, name, size, d)
    truths = _truths(hidden, d)
    drawn_ = _write(path, d, log, hidden, sizes.get("delay", 0.0), law, rng)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in hidden}
    return Answer("drive", seed, sizes, ids, cost, truths, drawn_)


def _told(rng: np.random.Generator, d: Drawn, level: float) -> tuple[Drawn, str]:
    """Return an axis with friction that is known, over the largest force, and as a campaign gives it."""
    a = d.axis
    falls = bool(rng.random() < 0.5)
    coulomb = level * d.force
    a = replace(a, coulomb=coulomb, oil=coulomb * float(rng.uniform(0.1, 0.6)) * falls)

    def said(value: float) -> str:
        return f"{value * (1.0 + bench.clipped_normal(rng, OFF)):.4g}"

    sliding = said(coulomb)
    law = f'law = "{"andersson" if falls else "coulomb_viscous"}", coulomb = "{sliding} N"'
    if falls:
        # Nobody gives a curve that rises.
        static = max(said(coulomb + a.oil), sliding, key=float)
        law += f', static = "{static} N", stribeck_speed = "{said(1e3 * a.slow)} mm/s"'
    return replace(d, axis=a), f'friction = {{ {law}, sigma = "{said(a.viscous)} N s/m" }}'


def _unexplained(change: Real, d: Drawn, t: Real) -> float:
    """Root mean square of what a change of the force leaves when mass, viscous and sliding friction are fitted anew.

    While the axis moves: at rest the force is whatever the control holds, and no property of the axis.
    """
    v = np.gradient(d.target[: t.size], d.axis.cycle)
    push = np.gradient(np.convolve(v, np.ones(20) / 20, mode="same"), d.axis.cycle)
    columns = [push, v, np.ones(t.size)] + ([np.tanh(v / 1e-3)] if d.axis.coulomb > 0.0 else [])
    moving = _moving(d, t)
    base, change = np.column_stack(columns)[moving], change[moving]
    return float(np.std(change - base @ np.linalg.lstsq(base, change, rcond=None)[0]))


def _moving(d: Drawn, t: Real) -> Real:
    """Return which samples are those of a move."""
    v = np.abs(np.gradient(d.target[: t.size], d.axis.cycle))
    return np.asarray(v > 1e-2 * v.max())


def _truths(hidden: tuple[str, ...], d: Drawn) -> dict[str, float]:
    a = d.axis
    every = {
        # Where the force is logged wrong, sliding friction is known no better than what is to be found.
        "friction": {} if "force_gain" in hidden else {"coulomb.force": a.coulomb},
        "stribeck": {"stribeck.boost": a.oil},
        "asymmetry": {"asymmetry.viscous": a.forth},
    }
    return {k: v for name in hidden for k, v in every.get(name, {}).items()}


def _write(
    path: Path, d: Drawn, log: Logged, hidden: tuple[str, ...], unstated: float, law: str, rng: np.random.Generator
) -> dict[str, float | str]:
    a = d.axis
    # Signal over noise: the force that shakes the axis.
    snr = float(rng.uniform(20.0, 40.0))
    d = replace(d, axis=replace(a, noise=0.3 * d.force * 10.0 ** (-snr / 20.0)))
    records = [d]
    if rng.random() < 0.4:
        speed, push = rng.uniform(0.1, 0.5), rng.uniform(1.2, 5.0)
        records.append(replace(d, target=moves(rng, a.cycle, speed, push, 45.0), seed=d.seed + 1))
    out = bench.folder(path, rng, "drive", (".mat", ".h5"))
    out.say("[channels]", 'time = { column = "t", unit = "s" }')
    out.say(
        'encoder_position_x = { column = "q", unit = "mm" }', 'reference_position_x = { column = "r", unit = "mm" }'
    )
    out.say('drive_force_x = { column = "F", unit = "N" }')
    hum = float(rng.choice([0.0, 0.005, 0.01]))
    mains = float(rng.choice([50.0, 60.0]))
    apart = float(rng.uniform(-20e-6, 20e-6))
    for k, each in enumerate(records):
        seen, place, told = simulated(each)
        t = np.arange(seen.size) * a.cycle
        force = log.shown(told, t) + hum * np.std(told) * math.sqrt(2.0) * (
            np.sin(2 * np.pi * mains * t + rng.uniform(0.0, 6.0)) + 0.3 * np.sin(6 * np.pi * mains * t)
        )
        # Both channels are latched within some microseconds of each other; what is latched is rounded once.
        latched = np.round((place + np.gradient(each.target, a.cycle) * apart) / a.quantum) * a.quantum
        rows = latched[:: d.every], force[:: d.every]
        step = 2.0 * np.abs(force).max() / 2**15
        columns = {
            "t": t[:: d.every],
            "q": 1e3 * rows[0],
            "r": 1e3 * each.target[:: d.every],
            "F": np.round(rows[1] / step) * step,
        }
        file = out.record(f"moves_{k + 1}", columns)
        out.say("[[measurement]]", f'name = "moves_{k + 1}"', 'method = "drive"')
        out.say(*(["held_out = true"] if k else []), f'records = [{{ file = "{file}" }}]')
    true = (a.lag + 0.5) * a.cycle + a.late
    stated = max(0.0, true - unstated + rng.uniform(-1e-4, 1e-4))
    out.say("[baseline]", 'drive = "rigid"', 'axis = "x"', f'delay = "{1e3 * stated:.4g} ms"')
    out.say(*[law] * bool(law))
    if "force_gain" in hidden or rng.random() < 0.7:
        out.say(f'moving_mass = "{a.mass * (1.0 + bench.clipped_normal(rng, 0.05)):.5g} kg"')
    # A mass that is known within 10 % does not tell a gain that is 13 % off (1.3 standard deviations): the gains do.
    if {"command", "force_gain"} & set(hidden) or rng.random() < 0.6:
        kp, kv = (g * (1.0 + 0.02 * rng.uniform(-1.0, 1.0)) for g in (a.kp, a.kv))
        out.say(f'Kp = "{kp:.6g} N s/m"', f'Kv = "{kv:.5g} 1/s"')
    out.close()
    return {
        "snr": snr,
        "cycle": a.cycle,
        "mass": a.mass,
        "kind": float(a.kind),
        "integral": float(math.isfinite(a.ti)),
        "law": law,
    }
