"""What to do about each cause, as an engineer at the machine would be told: a sentence without a full stop.

A row is a template over the parameters of the cause (`smfe.diagnosis.story.causes.Number`) and over facts that the
campaign knows besides: ``{Kp}`` is "8.3 kN s/m in place of 6.4", ``{channel}`` the channel that is meant. Where one of
them is not known the second sentence is taken, which needs none.
"""

from __future__ import annotations

from collections.abc import Mapping

from smfe.diagnosis.judgement.finding import Estimate, FoundCause
from smfe.diagnosis.story.causes import Number

_MOTION = (
    "Take lobes and compliances from measurements in motion, at the feed of the cut: at rest the guideway holds the "
    "slide. If it brakes more than it should, look at lubrication, wipers and preload"
)
_REGREASE = "Look at lubrication and wipers; lobes are valid at the feed at which they were measured"
_JOINT = (
    "Identify the levels apart (split_levels = true) and take the lobes at the level of the cut; tighten the joint: "
    "clamping, screws of the guideway blocks, bearing of the screw"
)
_SPINDLE = (
    "Measure compliances with the spindle turning at the speeds of the shop, and take the lobes of each range of "
    "speeds from those"
)
_POSITION = "Measure at three positions along the stroke, declare them ([machine.posture]), and cut where it is stiff"
_SESSION = "Warm the machine up, and return to the first condition at the end: what drifts is then seen, and left out"
_COEFFICIENTS = "Measure the coefficients again (four feeds per tooth in one slot, smfe coefficients)"
_MODES = "Measure the modes again and write them into the [[model]], as the extended campaign has them"
_CALIBRATE = (
    "Load the force sensor with a known weight, or compare the acceleration of a free mass under a known force "
    "(|a/F| = 1/m), and declare the scale"
)

ROWS: Mapping[str, tuple[str, str]] = {
    # a feed axis, drive records
    "guideway_friction": ("", _MOTION),
    "guideway_friction/level": (
        "Correct the friction of the campaign: it has to be {friction_level:higher|lower}",
        "Correct the friction of the campaign",
    ),
    "low_speed_friction/stribeck": ("", "Keep the feed well above the speed at which the friction falls. " + _REGREASE),
    "low_speed_friction/shear": ("", "Warm the axis up before it is measured or cuts. " + _REGREASE),
    "friction_asymmetry": (
        "",
        "Take both directions apart: lobes of one hold for it alone. Look at wipers, at the counterweight and at the "
        "alignment of screw and guideway",
    ),
    "position_friction": ("", "Look at wipers, cover and alignment of the guideway over the stroke; lubricate"),
    "position_ripple": (
        "Look at what turns once in {ripple_lead} of travel: screw, bearing, rack, motor; compensate it in the control",
        "Look at what turns with the screw or the motor; compensate it in the control",
    ),
    "joint_micro_slip": ("", _JOINT),
    "joint_hardening": ("", _JOINT),
    "backlash": (
        "Take {gap} of play out: preload of nut, pinion or coupling; until then cut with a force that keeps one side",
        "Take the play out: preload of nut, pinion or coupling",
    ),
    "servo_gains": (
        "Read the gains in the control: the records say {gains}. Write them into the campaign, or set the control to "
        "what was meant",
        "Read the gains in the control; write them into the campaign, or set the control to what was meant",
    ),
    "loop_delay": (
        "Set delay to {dead_time} in the campaign; if the loop is to be faster, look for filters of the velocity, "
        "the cycle of the control and its bus",
        "Write the delay into the campaign; look for filters of the velocity, the cycle of the control and its bus",
    ),
    "drive_saturation": ("", "Accelerate more gently, or raise the current limit of the drive if the motor bears it"),
    "hidden_input/force": (
        "",
        "Find what pushes on the axis in the parts that the finding names: chips, cover, cable, another axis, a hand",
    ),
    "hidden_input/command": ("", "Find out who adds to the command (feed-forward, a generator, a test), and log it"),
    "posture": ("", _POSITION),
    "drift": ("", _SESSION),
    # modes
    "missing_mode": (
        "Add the mode at {mode_frequency} to the [[model]], as the extended campaign has it; hit in all directions to "
        "learn where it moves",
        "Add the mode to the [[model]]; hit in all directions to learn where it moves",
    ),
    "missing_mode/above": ("", "Add a stiff mode above the band to the [[model]], or measure a wider band"),
    "spindle_speed_dynamics": ("", _SPINDLE),
    "cross_axis_coupling": (
        "",
        "Measure compliances in all directions, cross terms too, and give lobes the whole matrix: modes lie across "
        "the axes",
    ),
    "modal_scale": (
        "Check the calibration of hammer and accelerometer with a free mass; if they are right, correct the [[model]]: "
        "stiffness and mass have to be {scale_error:higher|lower}",
        "Check the calibration of hammer and accelerometer with a free mass; if they are right, correct the [[model]]",
    ),
    "modal_mass": (
        "Correct the masses of the [[model]]: they have to be {mass_error:higher|lower} at the same stiffness",
        "Correct the masses of the [[model]]",
    ),
    "modal_frequency": (_MODES, _MODES),
    "modal_damping": (_MODES, _MODES),
    "modal_stiffness": (_MODES, _MODES),
    "declared_mass": ("Correct the mass in the campaign: {given}", "Weigh the part, and correct the campaign"),
    "declared_stiffness": (
        "Correct the stiffness in the campaign: {given}",
        "Correct the stiffness in the campaign, as the extended campaign has it",
    ),
    # the cut
    "process_damping": (
        "",
        "Expect more depth at low speed than the lobes give, as long as the edge is like this one; a sharp edge takes "
        "it away",
    ),
    "force_coefficients": (_COEFFICIENTS + ": {coefficients_found}", _COEFFICIENTS),
    "force_coefficients/size_effect": (
        "",
        "Measure the coefficients at the chip thickness of the cut: they rise as the chip gets thinner",
    ),
    "force_coefficients/radial": (
        "Measure the coefficients again: the radial force is {radial:higher|lower} than declared",
        _COEFFICIENTS,
    ),
    "edge_forces": (
        "Write the edge forces into [material]: {edge_found}; a worn edge has more of them",
        "Write the edge forces into [material], as the extended campaign has them; a worn edge has more of them",
    ),
    "runout": (
        "True the tool in its holder: clean the taper, check with a dial gauge; until then [tool] runout holds what "
        "was found, {runout}",
        "True the tool in its holder, and give each insert its runout in [tool]",
    ),
    "background_tone/unbalance": (
        "",
        "Balance tool and holder: the force grows with the square of the speed and turns in air, too",
    ),
    # sensors
    "accelerometer_mass": (
        "Declare accelerometer_mass = {sensor_mass} with the measurement, or take a lighter sensor or a laser",
        "Declare accelerometer_mass with the measurement, or take a lighter sensor or a laser",
    ),
    "sensor_gain": (
        _CALIBRATE + ": {factor_found}",
        _CALIBRATE,
    ),
    "time_skew": (
        "Put one signal on both channels; until then declare the delay: {delay_found}",
        "Put one signal on both channels, and declare the delay of the channel that is late",
    ),
    "sensor_axis": (
        "Exchange the columns of {exchanged} in [channels]",
        "Check which channel is which axis: knock on the tool along x, y and z, one at a time",
    ),
    "sensor_axis/quarter": (
        "Exchange the columns of {exchanged} in [channels], and then set sign = -1 on {round}; or turn the sensor back",
        "Mount the sensor along the axes of the machine",
    ),
    "sensor_axis/turned": (
        "Turn the sensor back by {angle_found}, or declare its axes as it is mounted",
        "Mount the sensor along the axes of the machine",
    ),
    "sensor_axis/turned_over": (
        "",
        "Exchange the columns of force_x and force_y in [channels], and set sign = -1 on force_z",
    ),
    "sensor_offset": ("", "Zero the force sensor in air before each cut; look for drift of its charge amplifier"),
    "dynamometer_dynamics": (
        "",
        "Declare the dynamometer with its mass and frequency, or take orders well below its resonance",
    ),
    "background_tone": (
        "",
        "Find the source (mains, pump, fan, drive), and earth and shield the channel; lines beside it are not touched",
    ),
    "background_tone/spindle": ("", "Balance tool and holder, and record the spindle in air at the same speed"),
}
"""Key of a cause (or its id, for all variants) -> what to do with what was found, and what to do anyhow."""

_WRONG_SIGN = (-2.2, -1.8)
"""Change of a gain that is another sign [1]."""


def action(cause: FoundCause, facts: Mapping[str, str] | None = None) -> str:
    """Return what to do about a cause, a sentence without a full stop; "" for one that no catalogue has.

    Parameters
    ----------
    cause : FoundCause
        As it was found.
    facts : mapping of str to str, optional
        What the campaign says beside it: ``gains``, ``coefficients_found``, ``edge_found``, ``given`` ...
    """
    key = f"{cause.id}/{cause.variant}" if cause.variant else cause.id
    known, anyhow = ROWS.get(key) or ROWS.get(cause.id) or ("", "")
    values: dict[str, object] = {e.name.replace(".", "_"): Number(e, False) for e in cause.parameters}
    values |= _made(cause) | dict(facts or {})
    if cause.id == "sensor_gain" and (turned := _turned_round(cause)):
        return turned
    if cause.id == "sensor_axis" and "exchanged" in values and cause.variant != "turned_over":
        known, anyhow = ROWS["sensor_axis/quarter" if "round" in values else "sensor_axis"]
    try:
        return known.format_map(values) if known else anyhow
    except KeyError:
        return anyhow


def _made(cause: FoundCause) -> dict[str, object]:
    """Return what a sentence says of several parameters of a cause."""
    found: dict[str, object] = {}
    for e in cause.parameters:
        name = e.name.replace(".", "_")
        if name in ("extra_delay", "loop_delay_delay"):
            found["dead_time"] = f"{Number(e, False)} more"
        if name.startswith("exchanged_") and e.value > 0.5:
            found["exchanged"] = " and ".join(f"acceleration_{a}" for a in name[-2:])
        if name.startswith("quarter_") and abs(e.value) > 0.5:
            found["exchanged"] = " and ".join(f"acceleration_{a}" for a in name[-2:])
            found["round"] = f"acceleration_{name[-2] if e.value > 0.0 else name[-1]}"
        if name == "exchange" and e.value > 0.5:
            found["exchanged"] = "force_x and force_y"
        if name == "skew":
            late = "motion" if e.value > 0.0 else "force"
            found["delay_found"] = f"the {late} comes {Number(_size(e), False)} late"
    gains = [e for e in cause.parameters if e.name.startswith(("gain_", "force_gain"))]
    if gains:
        found["factor_found"] = ", ".join(
            f"scale = {1.0 / (1.0 + e.value / 100.0):.4g} on {channel_of(e.name)}" for e in gains if e.value != -100.0
        )
    angles = [e for e in cause.parameters if e.name.startswith("turned") and e.value != 0.0]
    if angles:
        about = {"turned": "z"}
        found["angle_found"] = ", ".join(f"{Number(e, False)} about {about.get(e.name, e.name[-1])}" for e in angles)
    return found


def _size(e: Estimate) -> Estimate:
    return Estimate(e.name, abs(e.value), e.low, e.high, e.unit)


def channel_of(parameter: str) -> str:
    """Return the channel whose gain a parameter is: ``gain_x`` of an accelerometer, ``gain_force``, ``gain_error``."""
    known = dict.fromkeys(("gain_force", "reversed_force"), "the force")
    known |= {"gain_error": "force or acceleration", "force_gain.error": "the drive force"}
    known |= {"gain_common": "all channels of the force sensor", "sign": "force_x, force_y and force_z"}
    known |= {f"sign_{a}": f"force_{a}" for a in "xyz"}
    return known.get(parameter) or f"the sensor along {parameter[-1]}"


def _turned_round(cause: FoundCause) -> str:
    """Return what to do about a sensor of another sign, or of a unit that was not declared; "" where it is neither."""
    wrong = [
        e
        for e in cause.parameters
        if (
            e.value > 0.5
            if e.name.startswith(("reversed_", "sign"))
            else _WRONG_SIGN[0] < e.value / 100.0 < _WRONG_SIGN[1]
        )
    ]
    if wrong:
        return f"Turn the sensor's sign: sign = -1 on {' and '.join(channel_of(e.name) for e in wrong)} in [channels]"
    for e in cause.parameters:
        size = abs(1.0 + e.value / 100.0)
        for unit, factor in (('"g" (of gravity)', 9.80665), ('"lbf"', 4.4482216152605)):
            if min(abs(size / factor - 1.0), abs(size * factor - 1.0)) < 0.03:
                return f"Check the unit of {channel_of(e.name)} in [channels]: the factor is that of {unit}"
    return ""
