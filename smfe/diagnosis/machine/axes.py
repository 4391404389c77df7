"""The feed axes of a machine as their maker describes them: masses, servos and guideways, each with what it may be off.

A nuisance that somebody gave carries the id of the cause under which a value beyond its tolerance is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from scipy.special import i0

from process.friction.laws import FrictionLaw, MemoryLaw
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.modal_dynamics import RAYLEIGH_LOSS
from smfe.diagnosis.inference.problem import Parameter, Values
from smfe.diagnosis.machine.dynamics import Slide
from smfe.diagnosis.machine.rules import RULES

GAINS = ("Kp", "Ti", "Kv")
_GAIN = {"Kp": ("N s/m", 1.0), "Ti": ("ms", 1e3), "Kv": ("1/s", 1.0)}


@dataclass(frozen=True)
class Side:
    """Stribeck curve of one direction: ``s(v) = Fc + (Fs - Fc) exp(-|v|/vs)`` and the slope besides (SI)."""

    coulomb: float
    static: float
    speed: float
    viscous: float


@dataclass(frozen=True)
class Gains:
    """One controller of an axis; None is not known (SI)."""

    Kp: float | None = None
    Ti: float | None = None
    Kv: float | None = None
    delay: float | None = None


@dataclass(frozen=True)
class DeclaredAxis:
    """What a campaign says of one feed axis (SI)."""

    moving_mass: float
    controllers: Mapping[str, Gains] = field(default_factory=dict)
    friction: tuple[Side, Side] | None = None  # forth, back; None: nothing is said of it
    contact: float | None = None  # stiffness of the guideway that sticks; None: not said
    coupling: tuple[float, ...] | None = None  # momentum of each mode along it [kg]; None: not said

    @property
    def sticks(self) -> bool:
        """Whether the guideway holds the slide at rest: there is dry friction."""
        return self.friction is not None and max(s.static for s in self.friction) > 0.0

    @property
    def softness(self) -> float:
        """Compliance of a contact that sticks [m/N]."""
        assert self.friction is not None
        return RULES.presliding / max(s.static for s in self.friction) if self.contact is None else 1.0 / self.contact

    @property
    def aside(self) -> float:
        """Displacement that a blow leaves behind at rest, over the square of its peak, ``1/(k_c Fs)`` [m/N^2]."""
        if self.friction is None or not self.sticks:
            return RULES.aside
        return self.softness / max(s.static for s in self.friction)


def sides_of(law: FrictionLaw | MemoryLaw) -> tuple[Side, Side]:
    """Return the Stribeck curves of a friction law, forth and back."""
    ways: Sequence[object] = (law, getattr(law, "negative", None) or law)
    return (_side(ways[0]), _side(ways[1]))


def _side(law: object) -> Side:
    coulomb = float(getattr(law, "coulomb", 0.0))
    static = max(float(getattr(law, "static", coulomb)), coulomb)
    return Side(coulomb, static, float(getattr(law, "stribeck_speed", 1.0)), float(getattr(law, "sigma", 0.0)))


def contact_of(law: FrictionLaw | MemoryLaw) -> float | None:
    """Return the stiffness of a law's contact that sticks [N/m], where it has one.

    A smooth sign has none: it resists with a slope, at rest ``Fs kt``.
    """
    return law.stiffness if isinstance(law, MemoryLaw) else None


def is_known(law: FrictionLaw | MemoryLaw) -> bool:
    """Return whether the Stribeck curve of a law is that of `Side`: an exponential of first order."""
    sides = (law, getattr(law, "negative", None))
    return all(side is None or getattr(side, "delta", 1.0) == 1.0 for side in sides)


def nuisances(axes: Mapping[str, DeclaredAxis], tolerances: Tolerances) -> list[Parameter]:
    """Return what every hypothesis fits anew of the axes."""
    found: list[Parameter] = []
    for a, axis in axes.items():
        m, spread = axis.moving_mass, tolerances.declared_mass
        mass = Parameter(f"moving_mass_{a}", "kg", m, 0.02 * m, 0.2 * m, 5.0 * m, max(spread, 1e-4) * m)
        found.append(_given(mass, "declared_mass", f"mass that moves with the {a} axis"))
        for name, gains in axis.controllers.items():
            found += _of_control(a, name, gains, m, tolerances)
        found += _of_guideway(a, axis)
    return found


def _given(p: Parameter, cause: str, said: str) -> Parameter:
    """Name the cause under which a parameter beyond its prior is reported."""
    return Parameter(p.name, p.unit, p.start, p.scale, p.low, p.high, p.prior, p.shown, given=cause, said=said)


def _of_control(axis: str, name: str, gains: Gains, mass: float, tolerances: Tolerances) -> list[Parameter]:
    w, found = 2.0 * math.pi * RULES.bandwidth, []
    guess = {"Kp": w * mass, "Ti": 2.0 / w, "Kv": w / 4.0}
    of = f"the {axis} axis" + (f" under {name}" if name else "")
    for gain in GAINS:
        stated, (unit, shown) = getattr(gains, gain), _GAIN[gain]
        start = guess[gain] if stated is None else stated
        share = RULES.unknown if stated is None else max(tolerances.control_gain, 1e-4)
        p = Parameter(
            key(gain, axis, name), unit, start, 0.02 * start, 0.03 * start, 30.0 * start, share * start, shown
        )
        found.append(p if stated is None else _given(p, "servo_gains", f"{gain} of {of}"))
    start = RULES.delay if gains.delay is None else gains.delay
    prior = RULES.delay if gains.delay is None else max(tolerances.dead_time, 1e-6)
    p = Parameter(key("delay", axis, name), "ms", start, 1e-4, 0.0, 0.05, prior, 1e3)
    found.append(p if gains.delay is None else _given(p, "loop_delay", f"dead time of {of}"))
    return found


def _of_guideway(axis: str, declared: DeclaredAxis) -> list[Parameter]:
    sides = declared.friction
    slope = 0.5 * (sides[0].viscous + sides[1].viscous) if sides else 0.0
    known = [g.Kp for g in declared.controllers.values() if g.Kp is not None]
    gain = max(known, default=2.0 * math.pi * RULES.bandwidth * declared.moving_mass)
    prior = math.hypot(0.5 * slope, RULES.viscous_share * gain)
    found = [Parameter(f"viscous_{axis}", "N s/m", slope, 0.01 * gain, 0.0, 10.0 * (slope + gain), prior)]
    pushed = 1.0 / declared.moving_mass
    # Shaking acts by its square: by its speed itself nothing would change about zero, and fits would stick there.
    square = pushed**2
    found += [
        Parameter(f"contact_loss_{axis}", "%", RULES.loss[0], 0.02, 0.0, 2.0, RULES.loss[1], 100.0),
        Parameter(f"contact_slip_{axis}", "%", 0.0, 0.02, 0.0, 0.6, RULES.slip, 100.0),
        Parameter(
            f"stir_{axis}", "(mm/min per N s)^2", 0.25 * square, 0.1 * square, 0.0, 9.0 * square, 0.5 * square, 6e4**2
        ),
        Parameter(f"push_{axis}", "mm/min per N s", 0.0, 0.1 * pushed, -3.0 * pushed, 3.0 * pushed, pushed, 6e4),
    ]
    if sides is None or not declared.sticks:
        # Of friction that nobody declared only what follows from its cause is seen: over which distance bristles bend.
        loose = RULES.presliding
        found.append(Parameter(f"loose_{axis}", "um", 0.5 * loose, 0.1 * loose, 0.05 * loose, 5.0 * loose, loose, 1e6))
        return found
    soft = declared.softness
    more = (1e-3 * soft, 50.0 * soft, RULES.contact_spread * soft, 1e9)
    found.append(Parameter(f"contact_{axis}", "um/kN", soft, 0.1 * soft, *more))
    level = Parameter(f"friction_{axis}", "%", 0.0, 0.05, -1.0, 5.0, RULES.friction, 100.0)
    found.append(_given(level, "guideway_friction", f"friction of the {axis} guideway beyond what is declared"))
    return found


def key(what: str, axis: str, controller: str) -> str:
    """Return the name of a parameter of one controller of an axis."""
    return f"{what}_{axis}_{controller}" if controller else f"{what}_{axis}"


def slide(
    number: int,
    axis: str,
    declared: DeclaredAxis,
    values: Values,
    momentum: tuple[float, ...],
    feed: float,
    name: str,
    level: float = 0.0,
) -> Slide:
    """Return what an axis comes to at a feed [m/s] under a controller, by its name.

    Without any controller the slide is not driven. A guideway that sticks holds at rest only, and the less the harder
    it is hit: its contacts slip one after the other, by Rayleigh's law. A hit of `level` [N s] pushes a slide that
    moves and shakes it: the slope of its friction is that about a speed which differs by so much from the feed, and the
    mean over the speeds of the vibration.
    """
    drive = None
    if name in declared.controllers:
        kp, ti, kv, delay = (values[key(g, axis, name)] for g in (*GAINS, "delay"))
        drive = (kp, ti, kv, delay)
    way = 0 if feed >= 0.0 else 1
    apart = values.get(f"friction_asymmetry_{axis}", 0.0)
    both = (1.0 + apart, 1.0 - apart)
    viscous = values[f"viscous_{axis}"]
    known = declared.friction
    if known is not None and known[0].viscous + known[1].viscous > 0.0:
        mean = 0.5 * (known[0].viscous + known[1].viscous)
        both = (both[0] * known[0].viscous / mean, both[1] * known[1].viscous / mean)
    slope = viscous * (both[way] if feed else 0.5 * (both[0] + both[1]))
    hold, loss, fall, rate = 0.0, 0.0, 0.0, 0.0
    slips = min(values[f"contact_slip_{axis}"] * abs(level), 0.9)
    speed = max(abs(feed) + math.copysign(level, feed) * values[f"push_{axis}"], RULES.slowest * abs(feed))
    stirred = level * math.sqrt(max(values[f"stir_{axis}"], 0.0))
    share = 1.0 + (apart if way == 0 else -apart)
    if declared.sticks and known is not None:
        hold = (1.0 - slips) / values[f"contact_{axis}"]
        side, more = known[way], (1.0 + values[f"friction_{axis}"]) * share
        fall, rate = _falling(more * side.coulomb, more * side.static, side.speed, speed, hold)
        fall *= float(i0(min(stirred / side.speed, 3.0)))
    else:
        stuck = min(values.get(f"hold_{axis}", 0.0), 0.9999)
        held = declared.moving_mass * (2.0 * math.pi * RULES.half_held) ** 2
        hold = (1.0 - slips) * stuck / (1.0 - stuck) * held
        drop = values.get(f"fall_{axis}", 0.0) * share
        if feed and drop > 0.0:
            of = values[f"stribeck_speed_{axis}"]
            fall = -drop / of * math.exp(-speed / of) * float(i0(min(stirred / of, 3.0)))
            rate = speed / values[f"loose_{axis}"]
    if hold > 0.0:
        loss = values[f"contact_loss_{axis}"] + RAYLEIGH_LOSS * slips
    if feed:
        hold = loss = 0.0
    return Slide(number, values[f"moving_mass_{axis}"], momentum, drive, slope, hold, loss, fall, rate)


def _falling(coulomb: float, static: float, speed: float, feed: float, contact: float) -> tuple[float, float]:
    """Slope of the Stribeck curve at a feed [N s/m], and the rate with which bristles follow it [1/s]."""
    if feed == 0.0 or static <= coulomb:
        return 0.0, 0.0
    more = (static - coulomb) * math.exp(-abs(feed) / speed)
    return -more / speed, contact * abs(feed) / (coulomb + more)
