"""Forces that a rigid, viscous axis leaves out, each a cause of the diagnosis of a drive record.

Every force is a function of the motion alone and is zero at the null values of its parameters, and every admissible
friction opposes the motion (it is passive). Causes that can act together have ids of their own; the Stribeck boost and
its opposite are variants of one. ``s`` stands for the direction of sliding, which the bristles of the guideway follow
within micrometres (`direction`): all friction goes through the same bristles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from process.types import Real
from smfe.diagnosis.drive.filters import Motion
from smfe.diagnosis.drive.rules import RULES
from smfe.diagnosis.inference.problem import Cause, Parameter, Values

EXPONENT = Parameter("stribeck.exponent", "1", 1.0, 0.25, 0.5, 3.0, prior=0.5, secondary=True)
"""Exponent of a Stribeck curve that is known: one (Tustin), two where it is taken as Gaussian, 0.5 to 1 of dry steel
(Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30, 1994). Which it is hardly anybody knows."""


@dataclass(frozen=True)
class Term:
    """A cause that adds a force [N] to what the drive has to give."""

    cause: Cause  # name and parameters
    force: Callable[[Motion, Values], Real]  # of the motion and the values


def direction(m: Motion, p: Values) -> Real:
    """Return the direction of sliding [1], that of the bristles: ``z + tau dz/dt`` (`bristles.Path`, `coulomb`).

    Without Coulomb friction their length is not known: the smooth sign ``tanh(v/v0)``. A friction that builds up
    within the slowest speeds would be Coulomb friction by another name, and cheaper.
    """
    if p.get("coulomb.force", 0.0) == 0.0:
        return np.tanh(m.rate / RULES.smooth_sign)
    return m.sliding(p["coulomb.slide"], p["coulomb.damping"])


def built(m: Motion, p: Values, speed: float, exponent: float = 1.0) -> Real:
    """Return the direction of a friction that builds up over a speed [m/s], ``1 - exp(-(|v|/speed)^exponent)`` [1]."""
    if p.get("coulomb.force", 0.0) == 0.0:
        return np.asarray(-np.expm1(-((np.abs(m.rate) / speed) ** exponent)) * direction(m, p))
    return m.built(speed, p["coulomb.slide"], p["coulomb.damping"], exponent)


def always(centre: float, stroke: float, mass: float, fastest: float) -> tuple[Term, ...]:
    """Return the forces that are in every catalogue.

    Parameters
    ----------
    centre, stroke : float
        Middle and length of the way [m].
    mass : float
        Moving mass [kg].
    fastest : float
        Greatest speed [m/s]: what changes over a good part of it is not near rest.
    """
    near = min(max(RULES.near_rest * fastest, 0.01), 0.1)
    speeds = tuple((0.0, x * near) for x in (0.25, 0.5, 1.0))
    bends = ("offset_slope", "offset_bend", "friction_slope", "friction_bend")
    bend = tuple(Parameter(f"bend.{n}", "N", 0.0, 0.1) for n in bends)

    def bent(m: Motion, p: Values) -> Real:
        x = 2.0 * (m.position - centre) / stroke
        a, b, c, d = (p[q.name] for q in bend)
        return np.asarray(a * x + b * x * x + direction(m, p) * (c * x + d * x * x))

    coulomb = (
        Parameter("coulomb.force", "N", 0.0, 1.0, low=0.0, said="Coulomb friction of the guideway"),
        # Little friction, or one that gives way at once, determines little of them: priors are those of bristles of
        # steel on steel or plastic. Canudas de Wit et al. (1995) take 3.2 ms of damping.
        Parameter("coulomb.slide", "um", 2e-6, 1e-6, RULES.finest_slide, 1e-4, prior=1e-5, shown=1e6, secondary=True),
        Parameter("coulomb.damping", "ms", 0.0, 1e-4, 0.0, 2e-2, prior=2e-3, shown=1e3, secondary=True),
    )
    boost = (
        Parameter("stribeck.boost", "N", 0.0, 1.0, low=0.0),
        # What falls over more is Coulomb friction with less viscous friction: a bound is another's name, and refused.
        Parameter("stribeck.speed", "mm/s", 0.5 * near, 0.25 * near, 1e-3, near, shown=1e3),
    )
    shear = (
        Parameter("shear.force", "N", 0.0, 1.0, low=0.0),
        # What builds up within less is Coulomb friction, over more viscous friction with Coulomb friction: likewise.
        Parameter("shear.speed", "mm/s", max(0.5 * near, 5e-3), 0.25 * near, 5e-3, max(near, 6e-3), shown=1e3),
    )
    slope = (Parameter("position.offset", "N/m", 0.0, 1.0), Parameter("position.friction", "N/m", 0.0, 1.0))
    difference = (Parameter("asymmetry.viscous", "N s/m", 0.0, 5.0),)
    compliance = (Parameter("mode.compliance", "N s4/m", 0.0, mass / (8.0 * math.pi * 100.0) ** 2, low=0.0),)
    return (
        # F (z + tau dz/dt) with z the direction after pre-sliding. The damping of the bristles, tau = sigma_1/sigma_0
        # of LuGre (Canudas de Wit et al., IEEE Transactions on Automatic Control 40, 1995), acts within the
        # pre-sliding only; without it a reversal comes late by tau.
        Term(
            Cause("guideway_friction", "Coulomb friction", coulomb, "coulomb", starts=((0.0, 2e-6, 0.0),)),
            lambda m, p: p["coulomb.force"] * m.sliding(p["coulomb.slide"], p["coulomb.damping"]),
        ),
        # B exp(-(|v|/vs)^n) s(v) with B >= 0; where nobody declares it n is one: beside a Coulomb force that is free,
        # too, moves hardly tell an exponent.
        Term(
            Cause("low_speed_friction", "Stribeck friction: higher near rest", boost, "stribeck", starts=speeds),
            lambda m, p: (
                p["stribeck.boost"]
                * (direction(m, p) - built(m, p, p["stribeck.speed"], p.get(EXPONENT.name, EXPONENT.start)))
            ),
        ),
        # A [1 - exp(-|v|/vs)] s(v) with A >= 0, the opposite: grease that thins under shear, a film that forms.
        Term(
            Cause("low_speed_friction", "lubricant friction: lower near rest", shear, "shear", starts=speeds),
            lambda m, p: p["shear.force"] * built(m, p, p["shear.speed"]),
        ),
        # d |v|: sigma +- d forwards and backwards. A Coulomb force that depends on the direction is an offset, which
        # the baseline has.
        Term(
            Cause("friction_asymmetry", "friction that depends on the direction", difference),
            lambda m, p: p["asymmetry.viscous"] * np.abs(m.velocity),
        ),
        # (a + b s(v)) (x - centre), and the same with a slope and a bend over the stroke.
        Term(
            Cause("position_friction", "force that changes along the stroke", slope),
            lambda m, p: (p["position.offset"] + p["position.friction"] * direction(m, p)) * (m.position - centre),
        ),
        Term(Cause("position_friction", "force that changes and bends along the stroke", bend, "bent"), bent),
        # r (t - middle) v, and r (t - middle): a counterweight, a sensor that warms up.
        Term(
            Cause("drift", "viscous friction that drifts", (Parameter("drift.viscous", "N s/m/s", 0.0, 0.1),)),
            lambda m, p: p["drift.viscous"] * m.time * m.velocity,
        ),
        Term(
            Cause("drift", "offset that drifts", (Parameter("drift.offset", "N/s", 0.0, 0.01),), "offset"),
            lambda m, p: p["drift.offset"] * m.time,
        ),
        # K x'''' with K >= 0: motor mass a M and load (1 - a) M on a spring of frequency f below the mode,
        # F = M x'' + M a (1 - a)/(2 pi f)^2 x''''.
        Term(
            Cause("missing_mode", "flexible mode between drive and encoder", compliance),
            lambda m, p: p["mode.compliance"] * m.snap,
        ),
    )


def ripple(lead: float, centre: float, known: bool) -> Term:
    """Return a force periodic in position, ``a cos(2 pi (x - centre)/lead) + b sin(...)``: screw, rack, magnets.

    A lead that is known is free by 0.1 %, one that was found in the record by 3 %.
    """
    free = 1e-3 if known else 0.03
    wave = Parameter(
        "ripple.lead", "mm", lead, 1e-3 * lead, (1.0 - free) * lead, (1.0 + free) * lead, shown=1e3, secondary=True
    )
    cause = Cause("position_ripple", "ripple of the screw", (*_wave("ripple"), wave), starts=((0.0, 0.0, lead),))
    return Term(cause, lambda m, p: _periodic("ripple", 2.0 * math.pi * (m.position - centre) / p["ripple.lead"], p))


def tone(frequency: float, duration: float) -> Term:
    """Return a line in the force channel, ``a cos(2 pi f t) + b sin(2 pi f t)``; f is free by one over the duration."""
    free = 1.0 / duration
    line = Parameter(
        "tone.frequency", "Hz", frequency, 0.1 / duration, frequency - free, frequency + free, secondary=True
    )
    starts = ((0.0, 0.0, frequency),)
    cause = Cause("background_tone", "tone in the drive force", (*_wave("tone"), line), "", "measurement", starts)
    return Term(cause, lambda m, p: _periodic("tone", 2.0 * math.pi * p["tone.frequency"] * m.time, p))


def _wave(name: str) -> tuple[Parameter, Parameter]:
    return Parameter(f"{name}.cosine", "N", 0.0, 0.1), Parameter(f"{name}.sine", "N", 0.0, 0.1)


def _periodic(name: str, angle: Real, p: Values) -> Real:
    return np.asarray(p[f"{name}.cosine"] * np.cos(angle) + p[f"{name}.sine"] * np.sin(angle))


def hidden_force(windows: Sequence[tuple[float, float, float]]) -> Term:
    """Return an unmeasured force, the same in all windows: begin, end [s on the time base of the record] and sign."""

    def pulses(m: Motion, p: Values) -> Real:
        total = np.zeros_like(m.time)
        for begin, end, sign in windows:
            total[(m.time >= begin) & (m.time < end)] = sign * p["hidden.force"]
        return total

    force = Parameter("hidden.force", "N", 0.0, 1.0)
    return Term(Cause("hidden_input", "unmeasured force on the axis", (force,), "force"), pulses)


# --- Causes that a drive record can name besides friction: cut-off force, a command that was not logged.


def excess(drive: Real, limit: float) -> Real:
    """Return what a drive force [N] has beyond a limit."""
    return drive - np.clip(drive, -limit, limit)


def saturation(peak: float, limit: float) -> Cause:
    """Return the cause that drive force beyond a limit never acts: what the limit is below the largest force [N].

    A force that is cut off far below the limit that was found leaves nothing that a model could get wrong.
    """
    cut = Parameter("saturation.cut", "N", 0.0, peak - limit, low=0.0, high=peak - RULES.lowest_limit * limit)
    return Cause("drive_saturation", "drive force that is cut off", (cut,), starts=((peak - limit,),))


HIDDEN_COMMAND = Cause(
    "hidden_input", "command that was not logged", (Parameter("hidden.command", "N", 0.0, 1.0),), "command"
)
