"""Forces that a rigid, viscous axis leaves out, each a cause of the diagnosis of a drive record.

Every force is a function of the motion alone and is zero at the null values of its parameters, and every admissible
friction opposes the motion (it is passive). Causes that can act together have ids of their own; the Stribeck boost and
its opposite are variants of one. ``s(v) = tanh(v/v0)`` stands for the sign of the velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smfe.diagnosis.drive_signals import Motion, Real
from smfe.diagnosis.problem import Cause, Parameter, Values

_REST = 2e-4
"""v0 where Coulomb friction is not fitted [m/s]."""
_SPEEDS = ((0.0, 0.005), (0.0, 0.02), (0.0, 0.05))
"""No force, and speeds [m/s] over which it may change."""


@dataclass(frozen=True)
class Term:
    """A cause that adds a force [N] to what the drive has to give.

    Parameters
    ----------
    cause : Cause
        Name and parameters.
    force : callable
        Of the motion and the values.
    """

    cause: Cause
    force: Callable[[Motion, Values], Real]


def direction(velocity: Real) -> Real:
    """Return the smooth sign s(v) [1]."""
    return np.tanh(velocity / _REST)


def presliding(position: Real, velocity: Real, slide: float) -> Real:
    """Return the direction of sliding [1], which follows a reversal over a distance `slide` [m] (Dahl 1968).

    ``dz/dx = (1 - z sign v)/slide``, in closed form between reversals; at the first sample it slides.
    """
    forward = velocity >= 0.0
    turns = [*(np.flatnonzero(forward[1:] != forward[:-1]) + 1), velocity.size]
    out = np.where(forward, 1.0, -1.0)
    before = out[0]
    for a, b in pairwise(turns):
        way = out[a]
        out[a:b] = way - (way - before) * np.exp(-np.abs(position[a:b] - position[a]) / slide)
        before = out[b - 1]
    return out


def coulomb() -> Term:
    """Return Coulomb friction, ``F z`` with z the direction after pre-sliding."""
    force = Parameter("coulomb.force", "N", 0.0, 1.0, low=0.0)
    slide = Parameter("coulomb.slide", "um", 2e-6, 1e-6, 1e-7, 1e-4, shown=1e6)
    cause = Cause("guideway_friction", "Coulomb friction", (force, slide), "coulomb", starts=((0.0, 2e-6),))
    return Term(cause, lambda m, p: p["coulomb.force"] * presliding(m.position, m.velocity, p["coulomb.slide"]))


def stribeck() -> Term:
    """Return the boost of the friction near rest, ``B exp(-|v|/vs) s(v)`` with B >= 0 (Stribeck)."""
    boost = Parameter("stribeck.boost", "N", 0.0, 1.0, low=0.0)
    speed = Parameter("stribeck.speed", "mm/s", 0.02, 0.01, 1e-3, 0.1, shown=1e3)

    def force(m: Motion, p: Values) -> Real:
        fall = np.exp(-np.abs(m.velocity) / p["stribeck.speed"])
        return np.asarray(p["stribeck.boost"] * fall * direction(m.velocity))

    title = "Stribeck friction: higher near rest"
    return Term(Cause("low_speed_friction", title, (boost, speed), "stribeck", starts=_SPEEDS), force)


def shear() -> Term:
    """Return a friction that builds up with speed and saturates, ``A [1 - exp(-|v|/vs)] s(v)`` with A >= 0.

    The opposite of a Stribeck boost: grease that thins under shear, a lubricant film that forms.
    """
    amount = Parameter("shear.force", "N", 0.0, 1.0, low=0.0)
    speed = Parameter("shear.speed", "mm/s", 0.02, 0.01, 1e-3, 0.1, shown=1e3)

    def force(m: Motion, p: Values) -> Real:
        build = -np.expm1(-np.abs(m.velocity) / p["shear.speed"])
        return np.asarray(p["shear.force"] * build * direction(m.velocity))

    title = "lubricant friction: lower near rest"
    return Term(Cause("low_speed_friction", title, (amount, speed), "shear", starts=_SPEEDS), force)


def asymmetry() -> Term:
    """Return viscous friction that depends on the direction, ``d |v|``: ``sigma +- d`` forwards and backwards.

    A Coulomb force that depends on the direction is the same as an offset, which the baseline has.
    """
    difference = Parameter("asymmetry.viscous", "N s/m", 0.0, 5.0)
    cause = Cause("friction_asymmetry", "friction that depends on the direction", (difference,))
    return Term(cause, lambda m, p: p["asymmetry.viscous"] * np.abs(m.velocity))


def position_slope(centre: float) -> Term:
    """Return friction and offset linear in position, ``(a + b s(v)) (x - centre)``."""
    both = Parameter("position.offset", "N/m", 0.0, 1.0)
    friction = Parameter("position.friction", "N/m", 0.0, 1.0)

    def force(m: Motion, p: Values) -> Real:
        slope = p["position.offset"] + p["position.friction"] * direction(m.velocity)
        return np.asarray(slope * (m.position - centre))

    cause = Cause("position_friction", "force that changes along the stroke", (both, friction))
    return Term(cause, force)


def ripple(lead: float, centre: float) -> Term:
    """Return a force periodic in position, ``a cos(2 pi (x - centre)/lead) + b sin(...)``: screw, rack, magnets."""
    wave = Parameter("ripple.lead", "mm", lead, 1e-3 * lead, 0.97 * lead, 1.03 * lead, shown=1e3)
    cosine = Parameter("ripple.cosine", "N", 0.0, 0.1)
    sine = Parameter("ripple.sine", "N", 0.0, 0.1)

    def force(m: Motion, p: Values) -> Real:
        angle = 2.0 * math.pi * (m.position - centre) / p["ripple.lead"]
        return np.asarray(p["ripple.cosine"] * np.cos(angle) + p["ripple.sine"] * np.sin(angle))

    cause = Cause("position_ripple", "ripple of the screw", (cosine, sine, wave), starts=((0.0, 0.0, lead),))
    return Term(cause, force)


def drift() -> Term:
    """Return viscous friction that changes with time, ``r (t - middle) v``."""
    rate = Parameter("drift.viscous", "N s/m/s", 0.0, 0.1)
    cause = Cause("drift", "viscous friction that drifts", (rate,))
    return Term(cause, lambda m, p: p["drift.viscous"] * m.time * m.velocity)


def missing_mode(mass: float) -> Term:
    """Return the force of a flexible mode between drive and encoder, ``K x''''`` with K >= 0 [N s4/m].

    Motor mass a M and load (1 - a) M on a spring of frequency f: ``F = M x'' + M a (1 - a)/(2 pi f)^2 x''''`` below
    the mode, shown as the frequency would be for a = 1/2.
    """
    snap = Parameter("mode.compliance", "N s4/m", 0.0, mass / (8.0 * math.pi * 100.0) ** 2, low=0.0)
    cause = Cause("missing_mode", "flexible mode between drive and encoder", (snap,))
    return Term(cause, lambda m, p: p["mode.compliance"] * m.snap)


def hidden_force(begin: float, end: float) -> Term:
    """Return an unmeasured force, constant from `begin` to `end` [s] on the clock of the record."""
    force = Parameter("hidden.force", "N", 0.0, 1.0)
    cause = Cause("hidden_input", "unmeasured force on the axis", (force,), "force")

    def pulse(m: Motion, p: Values) -> Real:
        return np.where((m.time >= begin) & (m.time < end), p["hidden.force"], 0.0)

    return Term(cause, pulse)
