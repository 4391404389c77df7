"""What can be hidden in the data: effects in a catalogue of causes, and effects outside it.

An effect takes truth, chain and size, and returns truth and chain; at size zero nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from truth.axis import Appendage, Friction, Servo, Truth
from truth.chain import Chain

Plant = Callable[[Truth, Chain, float], tuple[Truth, Chain]]

SHARE_PER_DROP = 0.31
"""Share of micro-slip for a peak that is 100 % lower at 200 N than at 50 N (axis locked, nominal); small sizes."""

CUBIC_PER_SHIFT = 2.07e15
"""Cubic stiffness [N/m3] for a peak 100 % higher in frequency at 200 N than at 50 N (axis locked, nominal)."""


@dataclass(frozen=True)
class Effect:
    """An effect with the size that must be found, `unit` of the size, and whether both signs make sense."""

    plant: Plant
    size: float
    unit: str
    signed: bool = True


def _friction(truth: Truth, **changes: object) -> Truth:
    return replace(truth, friction=replace(truth.friction, **changes))


def _scaled(f: Friction, forth: float, back: float) -> dict[str, tuple[float, float]]:
    return {
        "coulomb": (f.coulomb[0] * forth, f.coulomb[1] * back),
        "static": (f.static[0] * forth, f.static[1] * back),
    }


def friction_level(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """Coulomb and static friction are larger by `size` (relative)."""
    return _friction(truth, **_scaled(truth.friction, 1.0 + size, 1.0 + size)), chain


def asymmetry(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """All friction is larger by size/2 forth and smaller by size/2 back, on top of Table 1."""
    forth, back = 1.0 + size / 2.0, 1.0 - size / 2.0
    viscous = truth.friction.viscous[0] * forth, truth.friction.viscous[1] * back
    return _friction(truth, viscous=viscous, **_scaled(truth.friction, forth, back)), chain


def _servos(truth: Truth, kp: float = 1.0, ti: float = 1.0) -> Truth:
    return replace(truth, servos={n: Servo(s.kp * kp, s.ti * ti, s.kv) for n, s in truth.servos.items()})


def velocity_gain(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """K_p of every controller is larger than recorded by `size` (relative)."""
    return _servos(truth, kp=1.0 + size), chain


def integral_time(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """T_i of every controller is longer than recorded by `size` (relative)."""
    return _servos(truth, ti=1.0 + size), chain


def delay(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The loop is later by `size` seconds."""
    return replace(truth, control=replace(truth.control, extra=truth.control.extra + size)), chain


def _joint(truth: Truth, **changes: float) -> Truth:
    return replace(truth, joint=replace(truth.joint, **changes))


def posture(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The joint grows stiffer by `size` (relative) per metre of travel."""
    return _joint(truth, per_metre=size), chain


def micro_slip(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The joint slips: the peak of the locked axis is lower by `size` (relative) at 200 N than at 50 N."""
    return _joint(truth, slip_share=SHARE_PER_DROP * size), chain


def cubic(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The joint hardens: the peak of the locked axis is higher in frequency by `size` at 200 N than at 50 N."""
    return _joint(truth, cubic=CUBIC_PER_SHIFT * size), chain


def gap(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """30 % of the joint act beyond a deformation of `size` metres only."""
    return _joint(truth, play=size, gap_share=0.3 if size else 0.0), chain


def gain(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The accelerometer reads `size` (relative) too much."""
    return truth, replace(chain, gain=1.0 + size)


def skew(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The accelerometer is late by `size` seconds."""
    return truth, replace(chain, skew=size)


def mass_loading(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The accelerometer weighs `size` of the tip; the laser weighs nothing."""
    return replace(truth, sensor_mass=size * truth.tip_mass), chain


def drift(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The joint is stiffer by `size` (relative) at the end of the session."""
    return replace(truth, drift=size), chain


def tone(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """A line at 50 Hz stands `size` dB over the noise floor of a silent record."""
    return truth, replace(chain, tone=size if size else None)


EFFECTS = {
    "friction_level": Effect(friction_level, 0.10, ""),
    "asymmetry": Effect(asymmetry, 0.10, ""),
    "velocity_gain": Effect(velocity_gain, 0.10, ""),
    "integral_time": Effect(integral_time, 0.10, ""),
    "delay": Effect(delay, 0.25e-3, "s", signed=False),
    "posture": Effect(posture, 0.05, "1/m"),
    "micro_slip": Effect(micro_slip, 0.05, "", signed=False),
    "cubic": Effect(cubic, 0.03, "", signed=False),
    "gap": Effect(gap, 2e-6, "m", signed=False),
    "gain": Effect(gain, 0.05, ""),
    "skew": Effect(skew, 50e-6, "s"),
    "mass_loading": Effect(mass_loading, 0.02, "", signed=False),
    "drift": Effect(drift, 0.03, ""),
    "tone": Effect(tone, 10.0, "dB", signed=False),
}
"""Effects of the catalogue with the sizes that must be found."""


def cable(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """A cable swings on the tip at 48 Hz and dents the compliance there by about `size` (relative)."""
    return replace(truth, cable=Appendage(0.35 * size, 48.0)), chain


def host(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """What the guideway stands on vibrates at 45 Hz and adds about `size` (relative) to the compliance in motion."""
    return (replace(truth, host=Appendage(750.0 / size, 45.0)) if size else truth), chain


def temperature_walk(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The stiffness walks at random; standard deviation `size` at the end of the session."""
    return replace(truth, walk=size), chain


def _soft(truth: Truth, size: float, kind: str) -> Truth:
    """Bristle damping goes with the stiffness, so that the loss at a given frequency stays as small as it was."""
    if size == 0.0:
        return truth
    stiffness = truth.joint.stiffness / size
    damping = truth.friction.bristle_damping * stiffness / truth.friction.bristle_stiffness
    return _friction(truth, kind=kind, bristle_stiffness=stiffness, bristle_damping=damping)


def soft_bristles(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """Before it slides, the guideway gives way by `size` of what the joint does (LuGre)."""
    return _soft(truth, size, "lugre"), chain


def slipping_asperities(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """As `soft_bristles`, but the contact slips bit by bit (GMS)."""
    return _soft(truth, size, "gms"), chain


def saturation(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The drive gives no more than 40 N over `size`."""
    limit = 40.0 / size if size else truth.control.limit
    return replace(truth, control=replace(truth.control, limit=limit)), chain


def screw_ripple(truth: Truth, chain: Chain, size: float) -> tuple[Truth, Chain]:
    """The screw pushes with `size` newtons, once per 0.25 mm of travel (33 Hz at 500 mm/min)."""
    return (replace(truth, ripple=size, pitch=0.25e-3) if size else truth), chain


OUTSIDE = {
    "cable": Effect(cable, 0.04, "", signed=False),
    "host": Effect(host, 0.04, "", signed=False),
    "temperature_walk": Effect(temperature_walk, 0.03, "", signed=False),
    "soft_bristles": Effect(soft_bristles, 0.05, "", signed=False),
    "slipping_asperities": Effect(slipping_asperities, 0.05, "", signed=False),
    "saturation": Effect(saturation, 0.5, "", signed=False),
    "screw_ripple": Effect(screw_ripple, 2.0, "N", signed=False),
}
"""Effects outside every catalogue."""


def apply(sizes: dict[str, float], truth: Truth, chain: Chain) -> tuple[Truth, Chain]:
    """Plant several effects, by name and size."""
    for name, size in sizes.items():
        truth, chain = (EFFECTS | OUTSIDE)[name].plant(truth, chain, size)
    return truth, chain
