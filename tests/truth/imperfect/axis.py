"""Campaigns of hammer hits on one feed axis, at rest and in motion, against two masses, a servo and a friction law.

The axis is that of `truth.axis`: bristles of LuGre or slipping elements of GMS, a sampled servo with a quantised
encoder, integrated by events. Heavier and lighter ones are it in other units of force: all of them times a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import fft

from truth.axis import MM_MIN, RATE, Appendage, Control, Friction, Joint, Servo, Setting, Truth, simulate
from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Instruments, Real

EFFECTS = {
    "friction": Hiding(1.0, "of 44 N a 23 kg", ("guideway_friction",), switch=True),
    "friction_level": Hiding(0.10, "", ("guideway_friction",), True),
    "asymmetry": Hiding(0.10, "", ("friction_asymmetry",), True),
    "velocity_gain": Hiding(0.10, "", ("servo_gains",), True),
    "integral_time": Hiding(0.10, "", ("servo_gains",), True),
    "position_gain": Hiding(0.10, "", ("servo_gains",), True),
    # The campaign's is off by up to 0.1 ms, evenly: what is hidden is beyond twice that whichever way, and more where
    # noise and viscous friction, which a delay acts like, hide it.
    "delay": Hiding(0.3e-3, "s", ("loop_delay",)),
    "posture": Hiding(0.05, "1/m", ("posture",), True),
    "micro_slip": Hiding(0.05, "of the peak", ("joint_micro_slip",)),
    "cubic": Hiding(0.03, "of the peak's frequency", ("joint_hardening",)),
    "gap": Hiding(2e-6, "m", ("backlash",)),
    "gain": Hiding(0.05, "", ("sensor_gain",), True),
    "force_gain": Hiding(-0.13, "", ("sensor_gain",)),
    "skew": Hiding(50e-6, "s", ("time_skew",), True),
    "drift": Hiding(0.03, "", ("drift",), True),
}
"""What the catalogue of a feed axis knows."""

OUTSIDE = {
    "cable": Hiding(0.04, "of the compliance at 48 Hz", ()),
    "temperature_walk": Hiding(0.03, "", ()),
}
"""What it does not know."""

TIMED = 0.5
"""Share of the campaigns that say when each measurement was made; of the others the list says it."""

PAIRS = (("friction", "velocity_gain"), ("friction", "delay"), ("friction", "micro_slip"), ("posture", "gain"))

GAINS = ("velocity_gain", "integral_time", "position_gain")
"""Effects of a gain of the control, which nobody sets to none."""

DRY = ("friction_level", "asymmetry")
"""Effects of a friction that the campaign declares."""

BY_LEVEL = ("micro_slip", "cubic")
"""Effects that hits of one level show as another stiffness and damping, which the campaign knows within 5 and 15 %."""

SHARE_PER_DROP, CUBIC_PER_SHIFT = 0.31, 2.07e15
"""Micro-slip for a peak 100 % lower at 200 N than at 50 N, cubic stiffness for one 100 % higher in frequency."""

FEEDS = (250.0, 500.0, 1000.0, 2000.0)


@dataclass(frozen=True)
class Visit:
    """One measurement: feed [mm/min], level [N] of the nominal axis, controller, place [m], order, name."""

    name: str
    feed: float
    level: float
    controller: str
    place: float = 0.0
    order: float = 0.0
    walk: float = 0.0


@dataclass(frozen=True)
class Bench:
    """The axis of nominal size, how many times as heavy it is, and what its sensors show."""

    truth: Truth
    times: float
    gain: float
    force: float
    skew: float = 0.0
    walk: float = 0.0


def planted(b: Bench, name: str, size: float) -> Bench:
    """Hide an effect of a size."""
    t = b.truth
    f = t.friction

    def servos(kp: float = 1.0, ti: float = 1.0, kv: float = 1.0) -> Truth:
        return replace(t, servos={n: Servo(s.kp * kp, s.ti * ti, s.kv * kv) for n, s in t.servos.items()})

    def friction(forth: float, back: float, viscous: bool = False) -> Truth:
        pair = (forth, back)
        changed = {n: tuple(x * p for x, p in zip(getattr(f, n), pair, strict=True)) for n in ("coulomb", "static")}
        if viscous:
            changed["viscous"] = tuple(x * p for x, p in zip(f.viscous, pair, strict=True))
        return replace(t, friction=replace(f, **changed))

    if name == "friction":
        rubbing = replace(f, kind="lugre", coulomb=(44.0 * size,) * 2, static=(86.0 * size,) * 2)
        return replace(b, truth=replace(t, friction=rubbing))
    if name == "friction_level":
        return replace(b, truth=friction(1.0 + size, 1.0 + size))
    if name == "asymmetry":
        return replace(b, truth=friction(1.0 + 0.5 * size, 1.0 - 0.5 * size, True))
    if name in GAINS:
        key = {"velocity_gain": "kp", "integral_time": "ti", "position_gain": "kv"}[name]
        return replace(b, truth=servos(**{key: 1.0 + size}))
    if name == "delay":
        return replace(b, truth=replace(t, control=replace(t.control, extra=t.control.extra + size)))
    joint = {
        "posture": {"per_metre": size},
        "micro_slip": {"slip_share": min(SHARE_PER_DROP * size, 0.8)},
        "cubic": {"cubic": CUBIC_PER_SHIFT * size},
        "gap": {"play": size, "gap_share": 0.3},
    }
    if name in joint:
        return replace(b, truth=replace(t, joint=replace(t.joint, **joint[name])))
    if name == "drift":
        return replace(b, truth=replace(t, drift=size))
    if name == "gain":
        return replace(b, gain=b.gain * (1.0 + size))
    if name == "force_gain":
        return replace(b, force=b.force * (1.0 + size))
    if name == "skew":
        return replace(b, skew=size)
    if name == "cable":
        return replace(b, truth=replace(t, cable=Appendage(0.35 * size, 48.0)))
    if name == "temperature_walk":
        return replace(b, walk=size)
    raise ValueError(f"no effect '{name}' of a feed axis")


def linear(b: Bench, visit: Visit, frequency: Real) -> np.ndarray:
    """Compliance at the tip for small vibration: sliding in motion, held at rest, as the sensors show it."""
    t, servo = b.truth, b.truth.servos[visit.controller]
    s = 2j * np.pi * frequency
    stiff = (
        t.joint.stiffness
        * (1.0 + t.joint.per_metre * visit.place)
        * (1.0 + t.drift * visit.order + b.walk * visit.walk)
    )
    amplitude = visit.level / 200.0 * 1.5e-4
    loss = 0.0
    if t.joint.slip_share:
        r = np.clip(t.joint.slip_travel * (np.arange(12) + 0.5) / 12 / amplitude, 0.0, 1.0)
        angle = np.arccos(1.0 - 2.0 * r)
        kept = float(np.mean(angle - 0.5 * np.sin(2.0 * angle))) / math.pi
        loss = float(np.mean(4.0 / math.pi * r * (1.0 - r))) * t.joint.slip_share * stiff
        stiff *= 1.0 - t.joint.slip_share * (1.0 - kept)
    stiff += 0.75 * t.joint.cubic * amplitude**2
    if t.joint.gap_share:
        ratio = min(t.joint.play / amplitude, 1.0)
        stiff *= 1.0 - t.joint.gap_share * 2.0 / math.pi * (math.asin(ratio) + ratio * math.sqrt(1.0 - ratio**2))
    joint = stiff + 1j * loss + t.joint.damping * s
    carriage = t.moving_mass * s**2
    speed = abs(visit.feed) * MM_MIN
    side = 0 if visit.feed >= 0.0 else 1
    f = t.friction
    if speed > 0.0 or f.kind == "none":
        slope = f.viscous[side]
        if f.kind != "none":
            slope += -(f.static[side] - f.coulomb[side]) / f.stribeck[side] * math.exp(-speed / f.stribeck[side])
        late = (t.control.lag + 1.0) * t.control.period + t.control.extra
        control = servo.kp * (s + servo.kv) * (1.0 + 1.0 / (servo.ti * s)) * np.exp(-s * late)
        carriage = carriage + slope * s + control
        below = joint * carriage / (joint + carriage)
    else:
        # A level that breaks away partly: the dry friction holds, and lets go of what is beyond.
        held = 3e8 * np.tanh(f.static[0] / 86.0)
        below = joint * held / (joint + held)
    phi = 1.0 / (t.tip_mass * s**2 + below)
    return phi * b.gain / b.force * np.exp(-s * b.skew)


def cost_of(b: Bench, before: Bench, plan: list[Visit]) -> float:
    """Largest relative change of the most negative real part, which is one over the limit depth along the axis."""
    f = np.arange(12.0, 130.0, 0.25)
    worst = 0.0
    for visit in plan:
        low = [float(linear(x, visit, f).real.min()) for x in (before, b)]
        worst = max(worst, abs(low[0] / low[1] - 1.0))
    return worst


TOLERANCES = {
    "sensors": math.sqrt(2.0) * 0.01,
    "gains": 0.02,
    "delay": 1e-4 / math.sqrt(3.0),
    "masses": 0.1,
    "stiffness": 0.1,
    "damping": 0.4,
}
"""Standard deviations of what a campaign says, as who reads it must take it: those of a workshop."""

HIDDEN_BY_TOLERANCES = ("gain", "force_gain", "velocity_gain", "integral_time", "position_gain", "delay")
"""Effects that are something a campaign gives, which is off within its tolerance in every campaign."""

LEAST_GAIN = -0.5
"""Least that a gain of the control is off: where that is not told, or no matter, it is larger than it should be."""

MOST = {"asymmetry": 0.8, "friction_level": 1.0, "micro_slip": 0.5, "cubic": 0.3}
"""Difference of the directions over their mean, when one has two and a half times the friction of the other; a friction
of twice what is declared; a peak half as high at 200 N as at 50 N, or at a frequency 30 % higher."""


def noise_of(b: Bench, plan: list[Visit], tools: Instruments, f: Real) -> Real:
    """Relative standard deviation of each line of each visit's compliance, shape (visits, f), by noise of the sensors.

    That of few hits every two seconds: noise is as much below the first visit in all of them, and a pulse shakes a
    machine little where its acceleration is small, below all at low frequency.
    """
    count, apart, rise, exponent = 3, 2.0, 1.7e-3, 3.0

    def shaken(visit: Visit, f: Real) -> np.ndarray:
        pulse = rise * math.exp(exponent) * math.gamma(exponent + 1.0) / (exponent + 2j * np.pi * f * rise) ** 4
        force = visit.level * pulse
        return np.array([force, (2.0 * np.pi * f) ** 2 * linear(b, visit, f) * force])

    wide = np.linspace(1.0, tools.corner * tools.rate, 2000)
    mean_square = 2.0 * np.trapezoid(np.abs(shaken(plan[0], wide)) ** 2, wide, axis=1) / apart
    # Of noise that is stronger at low frequency (`Instruments.noise`), three times that of white one.
    density = 3.0 * 10.0 ** (-tools.snr / 10.0) * np.array([0.04, 1.0]) * mean_square / tools.rate
    each = [np.sqrt(density[:, None] * apart / count) / np.abs(shaken(v, f)) for v in plan]
    return np.array([np.hypot(*x) for x in each])


def told(b: Bench, plan: list[Visit], name: str, tools: Instruments, sign: float) -> float:
    """Return the size of an effect that data tell from all that the tolerances leave open, in 95 of 100 campaigns.

    Fisher's information of the linear compliances under errors of 0.4 % that are smooth, of as much line by line, and
    under the noise of the sensors: what they say of the effect beyond what masses, stiffness, damping, friction, gains,
    dead time and period of the control, calibration and clock do within their tolerances, and its own tolerance. At a
    threshold of one in a thousand (3.3 standard deviations) 95 % are found at 4.95. The period of the samples, which
    nobody declares, makes Kp and Ti act larger than they are and Kv smaller: what goes against that is hidden larger.
    """
    f = np.linspace(6.0, 170.0, 90)
    shapes = np.cos(np.pi * np.arange(4)[:, None] * np.linspace(0.0, 1.0, f.size))

    def seen(c: Bench) -> np.ndarray:
        logs = [np.log(linear(c, v, f)) for v in plan]
        return np.concatenate([np.concatenate([x.real, np.unwrap(x.imag)]) for x in logs])

    # Half of the square of a complex error is in its real part, half in its imaginary part.
    noise = np.repeat(np.hypot(0.004, noise_of(b, plan, tools, f) / math.sqrt(2.0)), 2, axis=0).ravel()

    def by(change: Callable[[float], Bench], sigma: float, step: float = 1e-3) -> Real:
        return sigma * (seen(change(step)) - seen(change(-step))) / (2.0 * step) / noise

    t, late = b.truth, (b.truth.control.lag + 1.0) * b.truth.control.period + b.truth.control.extra

    def of_truth(**changes: object) -> Bench:
        return replace(b, truth=replace(t, **changes))

    def of_servo(which: str, key: str, x: float) -> Bench:
        servos = {n: replace(s, **{key: getattr(s, key) * (1.0 + x)}) if n == which else s for n, s in t.servos.items()}
        return of_truth(servos=servos)

    def of_friction(key: str, x: float) -> Bench:
        pair = tuple(v * (1.0 + x) for v in getattr(t.friction, key))
        return of_truth(friction=replace(t.friction, **{key: pair}))

    def sampled(x: float) -> Bench:
        grown = {
            n: Servo(
                s.kp * (1.0 + 0.5 * x * late * (1.0 / s.ti + s.kv)),
                s.ti + 0.5 * x * late,
                s.kv * (1.0 - 0.5 * x * late * s.kv),
            )
            for n, s in t.servos.items()
        }
        return of_truth(servos=grown)

    friction = t.friction
    columns = [
        by(lambda x: of_truth(moving_mass=t.moving_mass * (1.0 + x)), TOLERANCES["masses"]),
        by(lambda x: of_truth(tip_mass=t.tip_mass * (1.0 + x)), TOLERANCES["masses"]),
        by(
            lambda x: of_truth(joint=replace(t.joint, stiffness=t.joint.stiffness * (1.0 + x))), TOLERANCES["stiffness"]
        ),
        by(lambda x: of_truth(joint=replace(t.joint, damping=t.joint.damping * (1.0 + x))), TOLERANCES["damping"]),
        by(
            lambda x: of_truth(friction=replace(friction, viscous=tuple(v * (1.0 + x) for v in friction.viscous))),
            0.5,
        ),
        by(
            lambda x: of_truth(control=replace(t.control, extra=t.control.extra + x * late)), TOLERANCES["delay"] / late
        ),
        by(sampled, math.sqrt(1.0 / 3.0)),
        by(lambda x: replace(b, skew=b.skew + 1e-2 * x), 2e-3),
    ]
    for which in {v.controller for v in plan}:
        columns += [by(partial(of_servo, which, key), TOLERANCES["gains"]) for key in ("kp", "ti", "kv")]
    blank = np.zeros((len(plan), 2, f.size))
    for n in range(len(plan)):
        for part in range(2):
            for shape in shapes:
                one = blank.copy()
                one[n, part] = 0.004 / math.sqrt(8.0) * shape
                columns.append(one.ravel() / noise)
    # Forces of a friction curve that is declared are known within 2 %: its slope is their difference.
    for key in ("coulomb", "static") if friction.kind != "none" else ():
        columns.append(by(partial(of_friction, key), 0.02))
    own = by(lambda x: planted(b, name, x), 1.0, 1e-5 if name == "delay" else 1e-3)
    calibration = by(lambda x: replace(b, gain=b.gain * (1.0 + x)), TOLERANCES["sensors"])
    nuisances = np.stack([*columns, calibration], axis=1)
    covariance = np.eye(nuisances.shape[1]) + nuisances.T @ nuisances

    def beyond(x: Real) -> float:
        """What the data say of the effect in a change of theirs."""
        return float(own @ x) - float((nuisances.T @ own) @ np.linalg.solve(covariance, nuisances.T @ x))

    information = beyond(own)
    against = -sign * beyond(by(sampled, t.control.period / late)) / information
    return 4.95 / math.sqrt(information) + max(against, 0.0)


def drawn(rng: np.random.Generator, dry: bool) -> Bench:
    """Draw an axis: dry guideways, or oil."""
    period = float(rng.choice([0.25e-3, 0.5e-3]))
    control = Control(period, int(rng.integers(0, 2)), float(rng.uniform(0.0, 0.2e-3)), float(rng.choice([1e-8, 5e-8])))
    kind = str(rng.choice(["lugre", "gms"])) if dry else "none"
    level = float(rng.uniform(0.5, 1.5))
    friction = Friction(
        kind,
        (41.0 * level,) * 2,
        (41.0 * level * rng.uniform(1.4, 2.1),) * 2,
        (float(rng.uniform(300.0, 600.0)) * MM_MIN,) * 2,
        (float(rng.uniform(120.0, 400.0)),) * 2,
    )
    stiff = float(math.exp(rng.uniform(math.log(0.6), math.log(2.0))))
    joint = Joint(1.68e6 * stiff, 104.0 * float(rng.uniform(0.7, 2.0)) * math.sqrt(stiff))
    truth = Truth(
        23.1 * float(rng.uniform(0.8, 1.3)), 11.3 * float(rng.uniform(0.8, 1.3)), joint, friction, control=control
    )
    times = math.exp(rng.uniform(math.log(0.7), math.log(15.0)))
    return Bench(truth, times, 1.0 + 0.01 * rng.standard_normal(), 1.0 + 0.01 * rng.standard_normal())


def visits(rng: np.random.Generator) -> list[Visit]:
    """What is measured: at rest at two levels, feeds both ways, two controllers, places, the first again at the end."""
    two = [str(n) for n in rng.choice(["K1", "K2", "K3"], 2, replace=False)]
    feeds = sorted(float(f) for f in rng.choice(FEEDS, 2, replace=False))
    plan = [Visit("idle", 0.0, 100.0, two[0])]
    middle = [Visit("idle_hard", 0.0, 400.0, two[0])]
    middle += [Visit(f"at_{f:g}", f, 100.0, two[0]) for f in feeds]
    middle += [Visit(f"back_{feeds[1]:g}", -feeds[1], 100.0, two[0]), Visit("hard", feeds[1], 200.0, two[0])]
    middle += [Visit("other", feeds[1], 100.0, two[1])]
    middle += [Visit("place", 0.0, 100.0, two[0], float(rng.uniform(0.4, 1.0)))]
    plan += [middle[i] for i in rng.permutation(len(middle))] + [Visit("again", 0.0, 100.0, two[0])]
    walk = np.cumsum(rng.standard_normal(len(plan))) / math.sqrt(len(plan))
    last = len(plan) - 1
    return [replace(v, order=i / last, walk=float(walk[i] - walk[0])) for i, v in enumerate(plan)]


def slowly(plan: list[Visit]) -> list[Visit]:
    """Return a plan that measures both ways at its slower feed, which is 500 mm/min at most.

    At a constant feed friction acts by its slope alone, which the sides share where they have left the Stribeck range.
    """
    slower = min(v.feed for v in plan if v.feed > 0.0)
    feed = min(slower, FEEDS[1])

    def there(v: Visit) -> Visit:
        if v.feed < 0.0:
            return replace(v, feed=-feed, name=f"back_{feed:g}")
        return replace(v, feed=feed, name=f"at_{feed:g}") if v.feed == slower else v

    return [there(v) for v in plan]


def campaign(path: Path, seed: int, hidden: tuple[str, ...], scale: float = 1.0) -> Answer:
    """Write a campaign and return what is hidden in it."""
    rng = np.random.default_rng([seed, 501])
    dry = bool(rng.random() < 0.5)
    dry = (dry or bool(set(hidden) & set(DRY))) and "friction" not in hidden
    base = drawn(rng, dry)
    plan = visits(rng)
    if set(hidden) & set(DRY):
        plan = slowly(plan)
    if dry and "posture" in hidden:  # at rest what its drive pulls does to a dry guideway what a joint does
        fastest = max(v.feed for v in plan)
        plan = [replace(v, feed=fastest) if v.name == "place" else v for v in plan]
    signs = {name: float(rng.choice([-1.0, 1.0])) for name in sorted(EFFECTS | OUTSIDE)}
    if "asymmetry" in hidden:  # what hits at rest show of it is little
        most = signs["asymmetry"] * MOST["asymmetry"]
        while cost_of(planted(base, "asymmetry", most), base, plan) < bench.CLEARLY * bench.MATERIAL:
            base, plan = drawn(rng, dry), slowly(visits(rng))
    tools = bench.instruments(rng, RATE / int(rng.choice([2, 3, 4])))
    b, sizes, cost = base, {}, 0.0
    for name in hidden:
        what, now = (EFFECTS | OUTSIDE)[name], b

        def price(s: float, now: Bench = now, name: str = name) -> float:
            return cost_of(planted(now, name, s), now, plan)

        size = what.size * (signs[name] if what.signed else 1.0)
        if name in ("cable", "temperature_walk"):
            cost = price(size)
        elif name in DRY:  # what a hit at rest breaks away is not in the cost, which is linear
            size, cost = bench.raised(size, price, largest=MOST[name] / what.size)
        else:
            size, cost = bench.raised(size, price, what.switch)
            if name in GAINS and size < LEAST_GAIN:
                size, cost = bench.raised(what.size, price)
        if name in (*HIDDEN_BY_TOLERANCES, *DRY, *BY_LEVEL):
            # Hits that break a dry guideway away at rest show that, and little of a joint.
            rubs = now.truth.friction.kind != "none"
            clear = [v for v in plan if name not in BY_LEVEL or v.feed != 0.0 or not rubs]
            least = told(now, clear, name, tools, math.copysign(1.0, size))
            if name in GAINS and size < 0.0 and -least < LEAST_GAIN:
                size = -size
                least = told(now, clear, name, tools, 1.0)
            least = min(least, MOST.get(name, math.inf))
            size = math.copysign(max(abs(size), least), size)
            cost = price(size)
        if scale != 1.0:
            size, cost = size * scale, price(size * scale)
        sizes[name], b = size, planted(now, name, size)
    slowest = min(abs(v.feed) for v in plan if v.feed != 0.0)
    spared = [v.name for v in plan if set(hidden) & set(DRY) and abs(v.feed) == slowest]
    spared += [v.name for v in plan if set(hidden) & set(BY_LEVEL) and v.feed != 0.0 and v.level > plan[0].level]
    spared += [v.name for v in plan if "posture" in hidden and v.place != 0.0]
    _write(path, b, base, plan, sizes, tools, rng, spared)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in hidden}
    drawn_: dict[str, float | str] = {"snr": tools.snr, "friction": b.truth.friction.kind, "times": b.times}
    return Answer("axis", seed, sizes, ids, cost, {}, drawn_)


def _write(
    path: Path,
    b: Bench,
    base: Bench,
    plan: list[Visit],
    sizes: dict[str, float],
    tools: Instruments,
    rng: np.random.Generator,
    spared: Sequence[str],
) -> None:
    timed = bool(rng.spawn(1)[0].random() < TIMED)
    out = bench.folder(path, rng, "axis", (".mat", ".h5"))
    unit = str(rng.choice(["m/s^2", "g"]))
    out.say("[channels]", 'time = { column = "t", unit = "s" }', 'force_x = { column = "F", unit = "N" }')
    out.say(f'acceleration_x = {{ column = "a", unit = "{unit}" }}')
    t, m = base.truth, base.times
    near = lambda value, sigma: value * (1.0 + bench.clipped_normal(rng, sigma))  # noqa: E731
    out.say("[baseline]", 'axis = "x"', f'moving_mass = "{near(t.moving_mass * m, 0.05):.5g} kg"')
    out.say(
        f'tip_mass = "{near(t.tip_mass * m, 0.05):.5g} kg"',
        f'stiffness = "{near(t.joint.stiffness * m, 0.05) * 1e-6:.5g} N/um"',
    )
    out.say(f'damping = "{near(t.joint.damping * m, 0.15):.5g} N s/m"')
    late = (t.control.lag + 1.0) * t.control.period + t.control.extra + float(rng.uniform(-1e-4, 1e-4))
    each = []
    for name in sorted({v.controller for v in plan}):
        s = t.servos[name]
        kp, ti, kv = (x * (1.0 + 0.02 * rng.uniform(-1.0, 1.0)) for x in (s.kp * m, s.ti, s.kv))
        words = f'Kp = "{kp:.6g} N s/m", Ti = "{1e3 * ti:.5g} ms", Kv = "{kv:.5g} 1/s", delay = "{1e3 * late:.4g} ms"'
        each.append(f"{name} = {{ {words} }}")
    out.say(f"controllers = {{ {', '.join(each)} }}")
    f = t.friction
    sigma = f'sigma = "{near(f.viscous[0] * m, 0.1):.5g} N s/m"'
    if f.kind == "none":
        out.say(f'friction = {{ law = "viscous", {sigma} }}')
    else:
        words = f'coulomb = "{near(f.coulomb[0] * m, 0.02):.5g} N", static = "{near(f.static[0] * m, 0.02):.5g} N"'
        speed = f'stribeck_speed = "{f.stribeck[0] * 1e3:.5g} mm/s"'
        out.say(f'friction = {{ law = "andersson", {words}, {speed}, {sigma}, kt = "1e4 s/m" }}')
    count = int(rng.integers(3, 6))
    held = plan[int(rng.integers(1, len(plan) - 1))].name if rng.random() < 0.4 else ""
    held = "" if held in spared else held  # nothing else shows what is hidden
    side = float(rng.uniform(1.3, 1.8)), 0.03, t.joint.stiffness * float(rng.uniform(1.5, 3.0))
    usual = None
    for number, visit in enumerate(plan):
        rows = record(b, visit, count, side, tools, rng)
        if usual is None:
            usual = np.sqrt(np.mean(rows**2, axis=1))
        below = 10.0 ** (-tools.snr / 20.0) * usual * np.array([0.2, 1.0])
        rows = tools.hummed(rows, usual, rng) + below[:, None] * tools.noise(rows.shape, rng)
        rows = tools.converted(rows, 2.0 * np.abs(rows).max(axis=1))
        scale = 9.80665 if unit == "g" else 1.0
        file = out.record(
            visit.name, {"t": np.arange(rows.shape[1]) / tools.rate, "F": rows[0] * b.times, "a": rows[1] / scale}
        )
        out.say("[[measurement]]", f'name = "{visit.name}"', 'method = "hammer"', f'controller = "{visit.controller}"')
        out.say(f'feed = {{ x = "{visit.feed:g} mm/min" }}', f'position = "{1e3 * visit.place:.4g} mm"')
        if timed:
            out.say(f"started = 2024-05-14T{8 + number // 2:02d}:{30 * (number % 2):02d}:00")
        out.say(
            *(["held_out = true"] if visit.name == held else []), f'records = [{{ file = "{file}", excitation = "x" }}]'
        )
    out.close()


def record(
    b: Bench, visit: Visit, count: int, side: tuple[float, float, float], tools: Instruments, rng: np.random.Generator
) -> Real:
    """Force [N, nominal axis] and acceleration of hits one after the other, without noise, as recorded."""
    t = b.truth
    apart, run_in = float(rng.uniform(1.6, 2.4)), 0.3
    length = run_in + count * apart + 0.1
    rise, exponent = rng.uniform(1.5e-3, 1.9e-3), rng.uniform(2.5, 3.5)
    lean = math.radians(1.5) * rng.standard_normal() + math.radians(1.0) * rng.standard_normal(count)
    pulses = np.zeros((count, 4))
    for k in range(count):
        start = run_in + 0.12 + k * apart + rng.uniform(0.0, 0.05)
        pulses[k] = start, visit.level * rng.uniform(0.9, 1.1), rise * rng.uniform(0.95, 1.05), exponent
    pushed = pulses.copy()
    pushed[:, 1] *= np.cos(lean)
    stiffness = (1.0 + t.drift * visit.order) * (1.0 + b.walk * visit.walk)
    setting = Setting(
        visit.feed * MM_MIN,
        visit.controller,
        visit.place,
        0.0,
        stiffness,
        float(rng.uniform(-0.3, 0.3)),
        float(rng.uniform()),
    )
    raw = simulate(t, setting, pushed, np.zeros((0, 5)), length)
    # What leans shakes the axis beside it, which the accelerometer sees a little.
    n = raw.shape[1]
    whole = fft.next_fast_len(2 * n, real=True)
    f = fft.rfftfreq(whole, 1.0 / RATE)
    r = f / (62.0 * side[0])
    beside = -((2.0 * np.pi * f) ** 2) / side[2] / (1.0 - r**2 + 2j * side[1] * r) * np.exp(-((f / 600.0) ** 4))
    cross = fft.irfft(fft.rfft(raw[3], whole) * beside, whole)[:n] * float(np.mean(np.sin(lean)))
    seen = b.gain * (raw[0] + (0.01 + math.radians(1.0)) * rng.standard_normal() * cross)
    late = b.skew + float(rng.uniform(-20e-6, 20e-6))
    seen = fft.irfft(fft.rfft(seen, whole) * np.exp(-2j * np.pi * f * late), whole)[:n]
    times = round(RATE / tools.rate)
    rows = tools.filtered(np.array([b.force * raw[3], seen]), times)
    return rows[:, round(run_in * tools.rate) :]
