"""What each cause of the catalogues means: what the simulation leaves out, and the numbers of it in a sentence.

A row says how the simulation is wrong, what about, and a template over the parameters of the cause: ``{gap}`` is the
number with its unit (and its interval where the sentence has room), ``{Kp_error:higher|lower}`` its size and the word
of its sign. A dot in a name of a parameter is an underscore here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from smfe.diagnosis.judgement.finding import Estimate, FoundCause
from smfe.diagnosis.story.words import listed, parameter_words, percent, rounded, unit_text, with_interval

LEFT_OUT, WRONG, MEASURED, BESIDE = "leaves out", "is wrong about", "measurement", "beside"


@dataclass(frozen=True)
class Friction:
    """What brakes an axis, by the extended model [N]."""

    axis: str  # name of the axis
    rest: float  # force that it holds at rest
    feed: float  # feed [mm/min]
    moving: float  # force that brakes it at this feed
    rest_interval: tuple[float, float] = (math.nan, math.nan)  # what the 95 % intervals of its parameters allow
    moving_interval: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True)
class Row:
    """How a cause is told."""

    how: str  # one of `LEFT_OUT`, `WRONG`, `MEASURED`, and `BESIDE` for what the measurement holds besides
    name: str  # what is left out or wrong
    numbers: str = ""  # template; empty: the parameters one by one


_MODE_FOUND = "{mode_frequency} with {mode_compliance} and a damping of {mode_damping}"

ROWS: Mapping[str, Row] = {
    # a feed axis, drive records
    "guideway_friction/coulomb": Row(LEFT_OUT, "guideway friction", "it brakes with {force} in motion"),
    "guideway_friction/stribeck": Row(LEFT_OUT, "guideway friction"),
    "guideway_friction/sticks": Row(LEFT_OUT, "guideways that hold the slides at rest"),
    "guideway_friction": Row(WRONG, "the friction of the guideways"),
    "guideway_friction/level": Row(WRONG, "the level of the guideway friction", "it is {friction_level:higher|lower}"),
    "low_speed_friction/stribeck": Row(
        LEFT_OUT,
        "friction that rises near rest",
        "{stribeck_boost} more near rest, gone well above {stribeck_speed}",
    ),
    "low_speed_friction/shear": Row(
        LEFT_OUT,
        "friction that builds up with the speed",
        "{shear_force} more in motion than near rest, built up over {shear_speed}",
    ),
    "friction_asymmetry": Row(
        LEFT_OUT,
        "friction that depends on the direction",
        "it brakes {direction:more|less} forwards than backwards",
    ),
    "position_friction": Row(LEFT_OUT, "a force that changes along the stroke"),
    "position_friction/bent": Row(LEFT_OUT, "a force that changes along the stroke"),
    "position_ripple": Row(LEFT_OUT, "the ripple of the screw", "{ripple} to either side each {ripple_lead} of travel"),
    "joint_micro_slip": Row(LEFT_OUT, "micro-slip in a joint"),
    "joint_hardening": Row(LEFT_OUT, "a joint that hardens or softens with displacement"),
    "backlash": Row(LEFT_OUT, "play in a joint", "{gap} of play, in which {gap_share} of the stiffness is missing"),
    "servo_gains": Row(WRONG, "the gains of the servo"),
    "loop_delay": Row(LEFT_OUT, "a dead time in the control loop", "{delay}"),
    "loop_delay/declared": Row(WRONG, "the dead time of the control loop"),
    "drive_saturation": Row(LEFT_OUT, "the limit of the drive force", "the last {saturation_cut} never act"),
    "hidden_input/force": Row(LEFT_OUT, "a force on the axis that was not measured", "{hidden_force}"),
    "hidden_input/command": Row(LEFT_OUT, "a command that was not logged", "{hidden_command}"),
    "declared_mass": Row(WRONG, "the masses of the simulation"),
    "declared_stiffness": Row(WRONG, "the stiffness of the simulation"),
    "posture": Row(LEFT_OUT, "stiffness that depends on the position"),
    "posture/curved": Row(LEFT_OUT, "stiffness that depends on the position"),
    "drift": Row(LEFT_OUT, "drift over the session"),
    "drift/offset": Row(LEFT_OUT, "a force that drifts over the session"),
    # modes
    "missing_mode": Row(LEFT_OUT, "a mode of the machine", _MODE_FOUND),
    "missing_mode/in band": Row(LEFT_OUT, "a mode of the machine", _MODE_FOUND),
    "missing_mode/above": Row(LEFT_OUT, "the flexibility of modes above the band"),
    "spindle_speed_dynamics": Row(LEFT_OUT, "modes that change with the spindle's speed"),
    "cross_axis_coupling": Row(WRONG, "the directions of the modes, which couple the axes"),
    "modal_scale": Row(WRONG, "the scale of all modes", "stiffness and mass are {scale_error:higher|lower}"),
    "modal_mass": Row(WRONG, "the mass of all modes", "it is {mass_error:higher|lower}"),
    "modal_frequency": Row(WRONG, "the natural frequencies of the modes"),
    "modal_damping": Row(WRONG, "the damping of the modes"),
    "modal_stiffness": Row(WRONG, "the stiffness of the modes"),
    # the cut
    "process_damping": Row(LEFT_OUT, "damping by the flank of the tool", "{process_damping}"),
    "force_coefficients/size": Row(
        WRONG, "the cutting coefficients", "the material cuts {coefficients:harder|softer} than declared"
    ),
    "force_coefficients/radial": Row(WRONG, "the radial force", "it is {radial:higher|lower} than declared"),
    "force_coefficients/size_effect": Row(LEFT_OUT, "coefficients that depend on the chip thickness"),
    "force_coefficients/material": Row(WRONG, "the cutting coefficients"),
    "force_coefficients": Row(WRONG, "the cutting coefficients"),
    "edge_forces": Row(LEFT_OUT, "edge forces"),
    "edge_forces/declared": Row(WRONG, "the edge forces"),
    "runout": Row(LEFT_OUT, "run-out of the tool", "{runout}"),
    "runout/insert": Row(LEFT_OUT, "an insert that stands out", "{insert}"),
    "runout/inserts": Row(LEFT_OUT, "inserts that do not sit alike"),
    # sensors
    "accelerometer_mass": Row(LEFT_OUT, "the mass of the sensor", "{sensor_mass}"),
    "sensor_gain": Row(MEASURED, "the gain of a sensor is off"),
    **{f"sensor_gain/sign_{a}": Row(MEASURED, "the sign of a sensor is wrong") for a in ("force", "x", "y", "z")},
    "time_skew": Row(MEASURED, "force and motion are not recorded at the same time", "{skew} apart"),
    "sensor_gain/sign": Row(MEASURED, "all channels of the force sensor have the wrong sign"),
    "sensor_gain/sign_x": Row(MEASURED, "channel x of the force sensor has the wrong sign"),
    "sensor_gain/sign_y": Row(MEASURED, "channel y of the force sensor has the wrong sign"),
    "sensor_gain/sign_z": Row(MEASURED, "channel z of the force sensor has the wrong sign"),
    "sensor_axis/turned_over": Row(MEASURED, "x and y of the force sensor are exchanged and z is turned round"),
    "sensor_axis/exchange": Row(MEASURED, "x and y of the force sensor are exchanged"),
    "sensor_axis/turned": Row(MEASURED, "a sensor is turned"),
    "sensor_axis": Row(MEASURED, "axes of the accelerometer are exchanged"),
    **{
        f"sensor_axis/quarter_{plane}": Row(MEASURED, f"the accelerometer is turned by a right angle about {about}")
        for plane, about in (("xy", "z"), ("yz", "x"), ("zx", "y"))
    },
    "sensor_axis/declared": Row(MEASURED, "a sensor is turned, or shows a share of what lies across it"),
    "sensor_offset": Row(MEASURED, "the force sensor has an offset"),
    "dynamometer_dynamics": Row(MEASURED, "the dynamometer vibrates itself"),
    "background_tone": Row(BESIDE, "a tone lies on the force", "{tone} at {tone_frequency}"),
    "background_tone/unbalance": Row(BESIDE, "the spindle or tool is out of balance", "{unbalance}"),
    "background_tone/spindle": Row(BESIDE, "a force turns with the spindle without cutting", "{turning_force}"),
}
"""Key of a cause (or its id, for all variants) -> how it is told."""

YES_OR_NO = (
    "sensor_axis/exchange",
    "sensor_axis/turned_over",
    "sensor_gain/sign",
    "sensor_gain/sign_x",
    "sensor_gain/sign_y",
    "sensor_gain/sign_z",
    "sensor_axis/exchanged_xy",
    "sensor_axis/exchanged_yz",
    "sensor_axis/exchanged_zx",
    *(f"sensor_axis/quarter_{plane}" for plane in ("xy", "yz", "zx")),
    *(f"sensor_gain/sign_{a}" for a in ("force", "x", "y", "z")),
)
"""Causes whose number says only that they are there."""

_SIGNED = {"%": ("higher", "lower"), "%/m": ("higher a metre further", "lower a metre further")}
_SHARES = ("micro_slip", "gap_share", "joint_iwan", "joint_micro_slip", "joint_hardening", "hold_")
"""Beginnings of the names of parameters in percent that are a share of something and no change."""

_REVERSED = {
    "reversed_force": "the sign of force or acceleration is wrong",
    **{f"reversed_{a}": f"the sign of the accelerometer along {a} is wrong" for a in "xyz"},
}
"""Parameter of a compliance whose sensor has the wrong sign -> what is at fault."""

_MOST_NUMBERS = 4
_OPEN = 3.0
"""Ratio of the ends of an interval from which a force is not told as a number."""


def row_of(cause: FoundCause) -> Row:
    """Return how a cause is told; one that has no row by its title and its parameters."""
    key = f"{cause.id}/{cause.variant}" if cause.variant else cause.id
    how = MEASURED if cause.kind == "measurement" else LEFT_OUT
    if cause.parameters and (said := _REVERSED.get(cause.parameters[0].name)):
        return Row(MEASURED, said)
    return ROWS.get(key) or ROWS.get(cause.id) or Row(how, _lower(cause.title))


def numbers_of(cause: FoundCause, intervals: bool, friction: Friction | None = None) -> str:
    """Return the numbers of a cause as part of a sentence, "" where they say no more than its name."""
    key = f"{cause.id}/{cause.variant}" if cause.variant else cause.id
    if key in YES_OR_NO:
        return ""
    given = {e.name.replace(".", "_"): e for e in cause.parameters}
    if cause.id == "guideway_friction" and friction is not None and key != "guideway_friction/level":
        return _braked(friction) + (f" ({_one_by_one(cause.parameters, True)})" if intervals else "")
    template = row_of(cause).numbers
    numbers = {name: Number(e, intervals) for name, e in {**given, **_made(given)}.items()}
    try:
        return template.format_map(numbers) if template else _one_by_one(cause.parameters, intervals)
    except KeyError:  # the same cause of another family, with other parameters
        return _one_by_one(cause.parameters, intervals)


def _made(given: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Return what is made of several parameters, or of one with another name in another family."""
    found = {}
    for wave in ("ripple", "tone"):
        parts = [given.get(f"{wave}_{part}") for part in ("cosine", "sine")]
        if parts[0] is not None and parts[1] is not None:
            size = math.hypot(parts[0].value, parts[1].value)
            found[wave] = Estimate(wave, size, math.nan, math.nan, parts[0].unit)
    for name, others in (
        ("force", ("coulomb", "coulomb_force")),
        ("delay", ("extra_delay", "loop_delay_delay")),
        ("direction", ("asymmetry_viscous", "friction_asymmetry")),
    ):
        for other in others:
            if other in given:
                found[name] = given[other]
    if "direction" in found:  # what the sides differ by is twice what either is away from their mean
        e = found["direction"]
        found["direction"] = Estimate(e.name, 2.0 * e.value, 2.0 * e.low, 2.0 * e.high, e.unit)
    return found


def _braked(friction: Friction) -> str:
    rest, moving = (rounded(x, 2) for x in (friction.rest, friction.moving))
    axis, feed = f"the {friction.axis} axis", f"at {friction.feed:g} mm/min"
    # Hits that do not push the slide off show that it is held, and not how hard.
    open_rest, open_moving = _open(friction.rest_interval), _open(friction.moving_interval)
    if open_rest:
        held = f"it holds {axis} at rest, how hard these measurements do not tell ({open_rest} would fit)"
        return held if open_moving or friction.feed == 0.0 else f"{held}, and brakes it with {moving} N {feed}"
    if friction.feed == 0.0:
        return f"it holds {axis} at rest up to {rest} N"
    if open_moving:
        return f"it holds {axis} at rest up to {rest} N; what brakes it {feed} is open ({open_moving} would fit)"
    ratio = friction.rest / max(friction.moving, 1e-9)
    if ratio < 1.1:
        return f"it holds {axis} at rest up to {rest} N and brakes it with {moving} N {feed}"
    return f"it brakes {axis} {rounded(ratio, 2)} times more at rest ({rest} N) than {feed} ({moving} N)"


def _open(interval: tuple[float, float]) -> str:
    """Return an interval in words whose ends differ by more than a factor of `_OPEN`; "" for one that is narrower."""
    low, high = interval
    return f"{rounded(low, 2)} to {rounded(high, 2)} N" if high > _OPEN * max(low, 0.0) else ""


def _one_by_one(parameters: Sequence[Estimate], intervals: bool) -> str:
    shown = sorted((e for e in parameters if e.value != 0.0), key=_importance, reverse=True)[:_MOST_NUMBERS]
    said = [_one(e, intervals) for e in shown]
    more = len([e for e in parameters if e.value != 0.0]) - len(shown)
    return listed([*said, *([f"{more} more"] if more > 0 else [])])


def _one(e: Estimate, intervals: bool) -> str:
    """Return a parameter with its number: "stiffness 6.0 % higher a metre further", "radius of tooth 2: 15 µm"."""
    signs = () if e.name.startswith(_SHARES) else _SIGNED.get(e.unit, ())
    words = parameter_words(e.name)
    if e.unit == "1/kHz^2":
        return f"{words.replace('flexibility', 'resonance')} at {_resonance(e, intervals)}"
    return f"{words}{':' if words[-1:].isdigit() else ''} {Number(e, intervals):{'|'.join(signs)}}"


def _resonance(e: Estimate, intervals: bool) -> str:
    """Return the frequency of what is known by the inverse of its square, and nothing above one."""
    lowest, found, highest = (1e3 / math.sqrt(x) if x > 0.0 else math.inf for x in (e.high, e.value, e.low))
    if not intervals or lowest == 0.0:
        return f"{rounded(found, 2)} Hz"
    if math.isinf(highest):
        return f"{rounded(lowest)} Hz or above"
    return with_interval(found, lowest, highest, "Hz")


def _importance(e: Estimate) -> float:
    """How far a parameter is from zero over its interval; where that is not known, as it stands."""
    half = 0.5 * (e.high - e.low)
    return abs(e.value) / half if math.isfinite(half) and half > 0.0 else 0.0


class Number:
    """A parameter with its unit that formats itself; "higher|lower" gives its size and the word of its sign."""

    def __init__(self, estimate: Estimate, intervals: bool) -> None:
        self.estimate, self.intervals = estimate, intervals

    def __format__(self, signs: str) -> str:
        """Return the number, its unit, its interval if wanted, and the word of its sign."""
        e = self.estimate
        value, low, high = e.value, e.low, e.high
        words = signs.split("|") if signs.strip("|") else []
        if words and value < 0.0:
            value, low, high = -value, -high, -low
        word = f" {words[e.value < 0.0]}" if words else ""
        unit = "%" if words and e.unit == "%/m" else e.unit  # the words say that it is over a metre
        if self.intervals:
            return with_interval(value, low, high, unit) + word
        shown = percent(value / 100.0) if unit == "%" else rounded(value, 2)
        return f"{shown}{unit_text(unit)}{word}"


def _lower(title: str) -> str:
    """Return a title as it stands inside a sentence."""
    return title if title[:2].isupper() else title[:1].lower() + title[1:]
