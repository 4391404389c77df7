"""Words for what the code names: parameters, conditions, numbers with their intervals."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

_MODE = {
    "frequency": "frequency of mode {}",
    "damping": "damping of mode {}",
    "stiffness": "stiffness of mode {}",
    "linear": "change of the frequency of mode {} with the speed",
    "square": "change of the frequency of mode {} with the square of the speed",
    "micro_slip": "slip of mode {}",
    "radius": "radius of tooth {}",
    "coupling": "turn of mode {}",
    "turn_a": "turn of mode {} one way",
    "turn_b": "turn of mode {} across",
    "damping_place": "change of the damping of mode {} along the stroke",
}

_MATRIX = {
    "posture": "stiffness along the stroke",
    "curved": "stiffness along the stroke",
    "drift": "stiffness at the end of the session",
    "bearings": "stiffness with the spindle's speed",
    "also_bearings": "stiffness with the spindle's speed",
    "gyroscopic": "coupling by the turning spindle",
    "also_gyroscopic": "coupling by the turning spindle",
    "coupling": "spring between the axes",
}

_SENSOR = {
    "gain": "gain along {}",
    "turned": "turn about {}",
    "reversed": "sign along {}",
    "talk": "cross-talk of {}",
    "reach": "hits along {} beside their point",
    "aside": "accelerometer beside its place, along {}",
    "exchanged": "exchange of {}",
    "quarter": "right angle from {}",
    "offset": "offset along {}",
    "sign": "reversal of channel {}",
    "residual": "flexibility {} of modes above the band",
    "dynamometer": "flexibility of the dynamometer along {}",
    "dynamometer_lag": "lag of the dynamometer along {}",
    "size_effect": "exponent of K{}c over the chip thickness",
    "loose": "distance over which the {} guideway comes loose",
    "hold": "hold of the {} guideway at rest",
    "fall": "friction of the {} guideway that falls with speed",
    "friction_asymmetry": "difference of the friction of {} between the directions",
    "moving_mass": "mass that moves with {}",
    "viscous": "viscous friction of {}",
    "contact": "softness of the contact of the {} guideway",
    "contact_loss": "loss factor of the contact of the {} guideway",
    "push": "speed that a hit gives the {} slide",
    "friction": "friction of the {} guideway beyond what is declared",
    "stribeck_speed": "Stribeck speed of the {} guideway",
}

PARAMETERS = {
    "moving_mass": "moving mass",
    "contact": "softness of the contact of the guideway",
    "presliding_0": "giving way before sliding, as of elements that slip at once",
    "presliding_1": "giving way before sliding, as of elements of one stiffness",
    "presliding_2": "giving way before sliding, as of elements of one force",
    "presliding_3": "giving way before sliding, as of elements whose friction lags",
    "tip_mass": "mass of the tip",
    "stiffness": "stiffness",
    "damping": "damping",
    "viscous": "viscous friction",
    "coulomb": "sliding friction",
    "stribeck_coulomb": "sliding friction",
    "static_rise": "friction at rest beyond sliding",
    "stribeck_speed": "Stribeck speed",
    "friction_level": "level of the friction",
    "friction_asymmetry": "difference of the friction between the directions",
    "asymmetry_coulomb": "difference of the sliding friction between the directions",
    "asymmetry_rise": "difference of the rise at rest between the directions",
    "asymmetry_speed": "difference of the Stribeck speed between the directions",
    "asymmetry_viscous": "difference of the viscous friction between the directions",
    "micro_slip_share": "share of the stiffness that slips",
    "micro_slip_travel": "travel until it slips",
    "cubic_stiffness": "cubic stiffness",
    "gap_share": "share of the stiffness that has play",
    "gap": "play",
    "coulomb_error": "declared sliding friction",
    "static_error": "declared static friction",
    "Kp_error": "velocity gain Kp",
    "Ti_error": "integral time Ti",
    "Kv_error": "position gain Kv",
    "extra_delay": "further dead time",
    "period": "period of the control's samples",
    "stiffness_per_metre": "stiffness",
    "stiffness_over_session": "stiffness at the end of the session",
    "sensor_mass": "mass of the sensor",
    "gain_error": "gain of the sensor",
    "skew": "time between force and motion",
    "mode_compliance": "compliance of the further mode",
    "mode_frequency": "frequency of the further mode",
    "mode_damping": "damping of the further mode",
    "mode_azimuth": "direction of the further mode in the plane",
    "mode_elevation": "direction of the further mode out of the plane",
    "posture_bend": "bend over the stroke",
    "joint_iwan": "share of the stiffness that is lost at the middle level while none slips wholly",
    "joint_iwan_travel": "amplitude at which all of it slips, over the middle level",
    "joint_micro_slip": "slip of the joint",
    "joint_hardening": "hardening of the joint",
    "scale_error": "scale of all modes",
    "mass_error": "mass of all modes",
    "reversed_force": "sign of the force",
    **{f"lean_{a}{b}": f"hits along {a} that lean towards {b}" for a in "xyz" for b in "xyz" if a != b},
    "gain_force": "gain of the force sensor",
    "mass": "moving mass",
    "offset": "constant force",
    "coulomb.force": "friction force",
    "coulomb.slide": "travel before it slides",
    "coulomb.damping": "damping of the contact",
    "stribeck.boost": "further friction near rest",
    "stribeck.speed": "speed over which it vanishes",
    "stribeck.exponent": "exponent with which it vanishes",
    "shear.force": "friction that builds up with the speed",
    "shear.speed": "speed over which it builds up",
    "position.offset": "change of the force along the stroke",
    "position.friction": "change of the friction along the stroke",
    "bend.offset_slope": "change of the force from the middle of the stroke to its end",
    "bend.offset_bend": "bend of the force over the stroke",
    "bend.friction_slope": "change of the friction from the middle of the stroke to its end",
    "bend.friction_bend": "bend of the friction over the stroke",
    "asymmetry.viscous": "difference of the viscous friction between the directions",
    "drift.viscous": "drift of the viscous friction",
    "drift.offset": "drift of the constant force",
    "mode.compliance": "flexibility of the mode",
    "ripple.cosine": "ripple, cosine",
    "ripple.sine": "ripple, sine",
    "ripple.lead": "length of the ripple",
    "tone.cosine": "tone, cosine",
    "tone.sine": "tone, sine",
    "tone.frequency": "frequency of the tone",
    "hidden.force": "unmeasured force",
    "hidden.command": "command that was not logged",
    "loop_delay.delay": "dead time",
    "saturation.cut": "force that is cut off",
    "force_gain.error": "gain of the force channel",
    "servo_gains.position": "position gain",
    "servo_gains.velocity": "velocity gain",
    "helix": "helix angle",
    "Ktc": "cutting coefficient Ktc",
    "Krc": "cutting coefficient Krc",
    "Kac": "cutting coefficient Kac",
    "Kte": "edge force Kte",
    "Kre": "edge force Kre",
    "Kae": "edge force Kae",
    "runout": "run-out",
    "runout_angle": "direction of the run-out",
    "exchange": "exchange of x and y",
    "turned_over": "exchange of x and y with z turned round",
    "mounting": "mounting about z",
    "gain_common": "gain of all channels",
    "sign": "reversal of all channels",
    "insert": "height of the insert",
    "unbalance": "unbalance",
    "unbalance_angle": "direction of the unbalance",
    "turned": "turn about z",
    "turning_force": "force that turns with the spindle",
    "turning_force_angle": "direction of the turning force",
    "process_damping": "process damping",
    "coefficients": "cutting coefficients",
    "radial": "radial force",
}
"""Name of a parameter -> what it is, without what a mode, an axis or a place in a matrix adds to it."""

_SETTINGS = {
    "added_mass": "added mass",
    "spindle_speed": "spindle speed",
    "spindle_rpm": "spindle speed",
    "feed_per_tooth": "feed per tooth",
}
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def parameter_words(name: str) -> str:
    """Return what a parameter of a model is called."""
    return _known(name) or name.replace("_", " ").replace(".", ", ")


def _known(name: str) -> str:
    if name in PARAMETERS:
        return PARAMETERS[name]
    if found := re.fullmatch(r"joint_(micro_slip|hardening|iwan)_angle_(\d)", name):
        return f"place of the joint, angle {found[2]}"
    if (found := re.fullmatch(r"(\w+?)_(\d)(\d)", name)) and found[1] in _MATRIX:
        return f"{_MATRIX[found[1]]}, mode {found[2]}" + (f" with {found[3]}" if found[2] != found[3] else "")
    if found := re.fullmatch(r"(Kp|Ti|Kv)_of_(\w+)", name):
        return f"{PARAMETERS[f'{found[1]}_error']} of {found[2]} beside the other controls"
    if found := re.fullmatch(r"damping_(\d+)_at_(\d+)", name):
        return f"change of the damping of mode {found[1]} at place {found[2]} by itself"
    if (found := re.fullmatch(r"(\w+?)_(\d+)", name)) and found[1] in _MODE:
        return _MODE[found[1]].format(found[2])
    if (found := re.fullmatch(r"(\w+)_([xyztra]{1,2})", name)) and found[1] in _SENSOR:
        return _SENSOR[found[1]].format(found[2] if found[1] in ("residual", "size_effect") else " and ".join(found[2]))
    return ""


def in_words(text: str) -> str:
    """Return a sentence without names of parameters and settings; what it does not know stays as it is."""

    def worded(found: re.Match[str]) -> str:
        name = found[0]
        plain = "_" not in name and "." not in name
        return _SETTINGS.get(name) or (name if plain else _known(name) or name)

    text = re.sub(r"\bwith order\b", "with the order of the measurements", text)
    return re.sub(r"[A-Za-z]\w*(?:\.[a-z]\w*)*", worded, text)


def count_words(count: int, one: str, many: str = "") -> str:
    """Return "the two measurements" and its like without the article: words up to twelve, digits beyond."""
    number = _NUMBERS[count] if count < len(_NUMBERS) else str(count)
    return f"{number} {one if count == 1 else many or one + 's'}"


def listed(items: Sequence[str], last: str = "and") -> str:
    """Return "a, b and c"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}" if items else ""


def unit_text(unit: str) -> str:
    """Return a unit as it stands behind a number; a pure number has none."""
    shown = {
        "1": "",
        "um": "µm",
        "um/N": "µm/N",
        "N/um": "N/µm",
        "us": "µs",
        "deg": "°",
        "0/1": "",
        "N/um^3": "N/µm³",
        "N/mm^2": "N/mm²",
        "1/kHz^2": "1/kHz²",
        "N s4/m": "N s⁴/m",
    }.get(unit, unit)
    return "" if not shown else shown if shown == "°" else f" {shown}"


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, never as a power of ten between 0.001 and ten million."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    if -7 < places - digits < 4:
        return f"{round(value, places):.{max(places, 0)}f}"
    return f"{value:.{digits}g}"


def with_interval(value: float, low: float, high: float, unit: str) -> str:
    """Return "0.82 ms (0.80 to 0.85)": two digits of the uncertainty, or that none is known."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        lost = " (not separable from others in these data)" if math.isinf(high) else ""
        return f"{rounded(value)}{unit_text(unit)}{lost}"
    half = 0.5 * (high - low)
    places = min(max(1 - math.floor(math.log10(half)), -6), 6)
    if abs(value) > 0.0:  # a value that is known very well is not written with ten digits
        places = min(places, 4 - math.floor(math.log10(max(abs(low), abs(high)))))
    shown = [f"{round(x, places) + 0.0:.{max(places, 0)}f}" for x in (value, low, high)]
    return f"{shown[0]}{unit_text(unit)} ({shown[1]} to {shown[2]})"


def percent(share: float) -> str:
    """Return a share as percent with two digits."""
    return rounded(100.0 * share, 2)
