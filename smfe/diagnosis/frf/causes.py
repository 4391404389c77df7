"""The catalogue of causes that compliances can have: of a feed axis, of a modal model, and of their measurement.

Each row is a hypothesis with its parameters (name, unit, null value, scale, range) and where its fit starts; what a
parameter does is said where the prediction is made (`smfe.diagnosis.frf.axis_baseline`, `smfe.diagnosis.frf.modes`).
Springs of a modal model that change along the pass, over the session or with the spindle's speed change the matrix of
modal stiffnesses: its diagonal moves the frequencies, the rest turns the shapes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from itertools import combinations, combinations_with_replacement, product

import numpy as np

from process.drive.servo import Servo
from smfe.diagnosis.inference.problem import Cause, Parameter

AXES = "xyz"
PLANES = (("x", "y"), ("y", "z"), ("z", "x"))
RESIDUAL = tuple(f"residual_{e}" for e in ("xx", "yy", "zz", "xy", "yz", "zx"))
"""Parameters of the flexibility of modes above the band."""

TWICE = ("", "also_")
"""Prefixes of parameters that are in two variants of a cause."""

_RIGHT = 0.5 * np.pi
_MISSING = "a mode that the model does not have"
_SKEW = "time skew between force and motion"


def _percent(name: str, scale: float = 0.01, low: float = -0.9, high: float = 0.9, unit: str = "%") -> Parameter:
    return Parameter(name, unit, 0.0, scale, low, high, shown=100.0)


def _angle(name: str, scale: float, most: float) -> Parameter:
    return Parameter(name, "deg", 0.0, scale, -most, most, shown=180.0 / np.pi)


def _skew(scale: float) -> Cause:
    shift = Parameter("skew", "us", 0.0, scale, -2e-3, 2e-3, shown=1e6)
    return Cause("time_skew", _SKEW, (shift,), kind="measurement")


def _mode(band: tuple[float, float], scale: float, most: float, low: float, high: float) -> tuple[Parameter, ...]:
    """Compliance, frequency and damping of a further mode, searched for all over a band [Hz]."""
    middle = float(np.sqrt(band[0] * band[1]))
    return (
        Parameter("mode_compliance", "um/N", 0.0, scale, 0.0, most, shown=1e6),
        Parameter("mode_frequency", "Hz", middle, 0.02 * band[1], low * band[0], high * band[1]),
        Parameter("mode_damping", "%", 0.03, 0.01, 0.002, 0.3, shown=100.0),
    )


def _over(band: tuple[float, float], count: int) -> list[float]:
    return [float(f) for f in np.geomspace(band[0] * 1.05, band[1] * 0.95, count)]


# --- A feed axis: two masses, servo, friction.


def axis_causes(
    known: Collection[str], stiffness: float, tip_mass: float, servos: Sequence[Servo]
) -> tuple[Cause, ...]:
    """Return what the model of a feed axis may lack.

    Its stiffness [N/m], its tip mass [kg], the servos of all controllers, and what is `known` of its friction already:
    ``coulomb``, ``static``.
    """
    k, newton = stiffness, (0.0, 10.0, 0.0, 1e4)
    coulomb, under, rise = (Parameter(n, "N", *newton) for n in ("coulomb", "stribeck_coulomb", "static_rise"))
    speed = Parameter("stribeck_speed", "mm/min", 6e-3, 2e-3, 5e-4, 0.1, shown=6e4)
    travel = Parameter("micro_slip_travel", "um", 1e-4, 2e-5, 1e-6, 2e-3, shown=1e6)
    cubic = Parameter("cubic_stiffness", "N/um^3", 0.0, 1e7 * k, -1e11 * k, 1e11 * k, shown=1e-18)
    gap = Parameter("gap", "um", 2e-6, 1e-6, 0.0, 1e-3, shown=1e6)
    delay = Parameter("extra_delay", "ms", 0.0, 1e-4, -min((s.delay for s in servos), default=0.0), 5e-3, shown=1e3)
    loading = Parameter("sensor_mass", "kg", 0.0, 0.01 * tip_mass, 0.0, 0.5 * tip_mass)
    gains = tuple(_percent(name, 0.05, -0.8, 4.0) for name in ("Kp_error", "Ti_error", "Kv_error"))
    product_of_servos = float(np.exp(np.mean([np.log(s.Kv * s.Ti) for s in servos if s.Kv > 0.0] or [0.0])))
    friction = []
    if "coulomb" not in known:
        title = "Coulomb friction of the guideway"
        friction.append(Cause("guideway_friction", title, (coulomb,), "coulomb", starts=((40.0,),)))
    if "static" not in known:
        both: tuple[tuple[Parameter, ...], tuple[tuple[float, ...], ...]] = (
            ((rise, speed), ((30.0, 6e-3), (30.0, 2e-2)))
            if "coulomb" in known
            else ((under, rise, speed), ((40.0, 30.0, 6e-3), (20.0, 20.0, 2e-2)))
        )
        title = "Stribeck friction of the guideway"
        friction.append(Cause("guideway_friction", title, both[0], "stribeck", starts=both[1]))
    if "coulomb" in known:
        level = (_percent("friction_level", 0.05, -0.9, 4.0),)
        friction.append(Cause("guideway_friction", "level of the guideway's friction", level, "level"))
    slip = (_percent("micro_slip_share", 0.02, 0.0), travel)
    return (
        *friction,
        Cause(
            "friction_asymmetry",
            "friction that differs between the directions",
            (_percent("friction_asymmetry", 0.05),),
        ),
        Cause("joint_micro_slip", "micro-slip in a joint", slip, starts=((0.02, 1e-4), (0.02, 4e-4))),
        Cause("joint_hardening", "a joint that hardens or softens with displacement", (cubic,)),
        Cause(
            "backlash",
            "play in a joint",
            (_percent("gap_share", 0.1, 0.0, 0.95), gap),
            starts=((0.3, 2e-6), (0.3, 2e-5)),
        ),
        Cause(
            "servo_gains", "servo gains other than recorded", gains, equivalent=partial(_exchanged, product_of_servos)
        ),
        Cause("loop_delay", "a dead time in the control loop", (delay,)),
        Cause(
            "posture", "stiffness that depends on the position", (_percent("stiffness_per_metre", 0.02, unit="%/m"),)
        ),
        Cause("drift", "stiffness that drifts over the session", (_percent("stiffness_over_session"),)),
        Cause("accelerometer_mass", "mass of the sensor", (loading,), kind="measurement"),
    )


def _exchanged(product_of_servos: float, values: Mapping[str, float]) -> tuple[float, ...]:
    """Return the gains whose 1/Ti is the Kv and whose Kv the 1/Ti of others: P and PI in cascade know no order.

    ``Kp (s + Kv) (1 + 1/(Ti s))``; exact where all controllers have the same Kv Ti.
    """
    later, faster = 1.0 + values["Ti_error"], 1.0 + values["Kv_error"]
    return values["Kp_error"], 1.0 / (product_of_servos * faster) - 1.0, 1.0 / (product_of_servos * later) - 1.0


def sensor_causes(band: tuple[float, float]) -> tuple[Cause, ...]:
    """Return what the sensors along an axis may do, and a mode beyond those of the axis in a band [Hz]."""
    starts = tuple((2e-8, f, 0.03) for f in _over(band, 6))
    return (
        Cause("sensor_gain", "gain of a sensor", (_percent("gain_error", 0.02, -0.9, 9.0),), kind="measurement"),
        _skew(2e-5),
        Cause("missing_mode", _MISSING, _mode(band, 1e-8, 1e-4, 0.7, 1.5), starts=starts),
    )


# --- A machine that is modelled by modes.


def modal_causes(modes: int, band: tuple[float, float], size: float, reach: float, places: int) -> tuple[Cause, ...]:
    """Return what a model of some modes may lack, and in what its measurement may be wrong.

    It was compared over a band [Hz], in which its largest compliance is `size` [m/N], at a number of places, the
    farthest `reach` [m] from that of the baseline (1 where all are alike).
    """
    small, far = 0.003 * size, 0.9 / reach
    whole, across = pairs(modes), tuple(combinations(range(1, modes + 1), 2))

    def matrix(
        what: str, entries: Sequence[tuple[int, int]], most: float = 0.9, unit: str = "%"
    ) -> tuple[Parameter, ...]:
        return tuple(_percent(f"{what}_{r}{s}", 0.01, -most, most, unit) for r, s in entries)

    def joint(id_: str, title: str) -> Cause:
        angles = tuple(_angle(f"{id_}_angle_{r}", 0.2, 4.0) for r in range(1, modes))
        # Along each axis of mode space, a little off where the angles count.
        starts = tuple((0.01, *(_RIGHT if s < r else 0.1 for s in range(modes - 1))) for r in range(modes))
        return Cause(id_, title, (_percent(id_, 0.01, 0.0, 3.0), *angles), starts=starts)

    spinning = "modes that change with the speed of the spindle"
    bearings, with_bearings = (matrix(f"{b}bearings", whole) for b in TWICE)
    turning, with_turning = (matrix(f"{b}gyroscopic", across) for b in TWICE)
    position = "stiffness that depends on the position"
    bend = Parameter("posture_bend", "1/m", 0.0, 0.3 / reach, -10.0 * far, 10.0 * far)
    mode = (
        *_mode(band, small, 10.0 * size, 0.5, 2.0),
        *(_angle(f"mode_{n}", 0.3, 2.0 * np.pi) for n in ("azimuth", "elevation")),
    )
    along = ((0.01, 0.01), (_RIGHT, 0.01), (0.01, _RIGHT))
    starts = tuple((small, f, 0.03, *a) for f, a in product(_over(band, 10), along))
    residual = tuple(
        Parameter(n, "um/N", 0.0, small, 0.0 if n[-1] == n[-2] else -size, size, shown=1e6) for n in RESIDUAL
    )
    turns = tuple(_angle(f"turn_{side}_{r}", 0.02, _RIGHT) for r, side in product(range(1, modes + 1), "ab"))
    measured: list[Cause] = []
    gains = [("force", "gain of the force sensor"), *((a, f"gain of the accelerometer along {a}") for a in AXES)]
    for a, title in gains:  # a wrong sign is a gain of -200 %
        gain = (_percent(f"gain_{a}", 0.01, -12.0, 12.0),)
        measured.append(Cause("sensor_gain", title, gain, a, "measurement", ((-2.0,),)))
    for a, b in PLANES:  # there or not: above one half it is; nothing lies between
        name = f"exchanged_{a}{b}"
        switch = (Parameter(name, "0/1", 0.0, 1.0, 0.0, 1.5),)
        measured.append(
            Cause("sensor_axis", f"{a} and {b} of the accelerometer are exchanged", switch, name, "measurement")
        )
    turned = tuple(_angle(f"turned_{a}", 0.02, 1.0) for a in AXES)
    loading = (Parameter("sensor_mass", "kg", 0.0, 0.05, 0.0, 100.0),)
    return (
        Cause("posture", position, matrix("posture", whole, far, "%/m")),
        *([Cause("posture", position, (*matrix("curved", whole, far, "%/m"), bend), "curved")] if places > 3 else []),
        Cause("drift", "stiffness that drifts over the session", matrix("drift", whole)),
        Cause("spindle_speed_dynamics", spinning, bearings, "bearings"),
        *([Cause("spindle_speed_dynamics", spinning, turning, "gyroscopic")] if across else []),
        *([Cause("spindle_speed_dynamics", spinning, (*with_bearings, *with_turning), "both")] if across else []),
        joint("joint_micro_slip", "micro-slip in a joint"),
        joint("joint_hardening", "a joint that hardens with displacement"),
        Cause("cross_axis_coupling", "directions of the modes: axes that are coupled", turns, "directions"),
        Cause("cross_axis_coupling", "springs between the axes", matrix("coupling", whole), "springs"),
        Cause("missing_mode", _MISSING, mode, "in band", starts=starts),
        Cause("missing_mode", "flexibility of modes above the band", residual, "above"),
        Cause(
            "modal_scale",
            "scale of all modes: stiffness and mass together",
            (_percent("scale_error", 0.01, -0.9, 9.0),),
        ),
        Cause("modal_mass", "mass of all modes, the stiffness as it is", (_percent("mass_error", 0.01, -0.9, 9.0),)),
        *measured,
        Cause("sensor_axis", "the accelerometer is turned", turned, "turned", "measurement"),
        _skew(1e-5),
        Cause("accelerometer_mass", "mass of the sensor", loading, kind="measurement"),
    )


def pairs(modes: int) -> tuple[tuple[int, int], ...]:
    """Return the places of a symmetric matrix, from 1."""
    return tuple(combinations_with_replacement(range(1, modes + 1), 2))


def vector(angles: Sequence[float]) -> tuple[float, ...]:
    """Unit vector of spherical angles: ``cos a1, sin a1 cos a2, sin a1 sin a2 cos a3 ...``."""
    out, rest = [], 1.0
    for a in angles:
        out.append(rest * math.cos(a))
        rest *= math.sin(a)
    return (*out, rest)
