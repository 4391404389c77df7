"""The catalogue of causes that compliances can have: of a feed axis, of a modal model, and of their measurement.

Each row is a hypothesis with its parameters (name, unit, null value, scale, range) and where its fit starts; what a
parameter does is said where the prediction is made (`smfe.diagnosis.frf.axis_baseline`, `smfe.diagnosis.frf.modes`).
Springs of a modal model that change along the pass, over the session or with the spindle's speed change the matrix of
modal stiffnesses: its diagonal moves the frequencies, the rest turns the shapes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, combinations_with_replacement, product

import numpy as np

from process.drive.axis import Drive
from smfe.diagnosis.inference.problem import Cause, Parameter

AXES = "xyz"
PLANES = (("x", "y"), ("y", "z"), ("z", "x"))
RESIDUAL = tuple(f"residual_{e}" for e in ("xx", "yy", "zz", "xy", "yz", "zx"))
"""Parameters of the flexibility of modes above the band."""

TWICE = ("", "also_")
"""Prefixes of parameters that are in two variants of a cause."""

OF_DECLARED = ("modal_scale", "modal_mass", "cross_axis_coupling")
"""Causes of modes that somebody declared: of fitted ones size and directions are fitted again, as far as they may be
off."""

WEIGHT = 1.73
"""Friction that a fit starts at, over the moving mass [N/kg]: a coefficient of 0.18."""

_RIGHT = 0.5 * np.pi
_MEASUREMENT = ("sensor_gain", "sensor_axis", "time_skew", "accelerometer_mass")  # the other causes are physics

Starts = tuple[tuple[float, ...], ...]


def _cause(id_: str, title: str, *parameters: Parameter, variant: str = "", starts: Starts = ()) -> Cause:
    kind = "measurement" if id_ in _MEASUREMENT else "physics"
    return Cause(id_, title, parameters, variant, kind, starts)


def _there(id_: str, title: str, name: str, variant: str) -> Cause:
    """Return what is there or not: above one half it is; nothing lies between."""
    return _cause(id_, title, Parameter(name, "0/1", 0.0, 1.0, 0.0, 1.5), variant=variant, starts=((1.0,),))


def _quarter(a: str, b: str) -> Cause:
    """Return an accelerometer that is turned by a right angle, one way (beyond one half) or the other (below)."""
    name, (about,) = f"quarter_{a}{b}", set(AXES) - {a, b}
    title = f"the accelerometer is turned by a right angle about {about}"
    return _cause(
        "sensor_axis", title, Parameter(name, "0/1", 0.0, 1.0, -1.5, 1.5), variant=name, starts=((1.0,), (-1.0,))
    )


def _percent(name: str, scale: float = 0.01, low: float = -0.9, high: float = 0.9, unit: str = "%") -> Parameter:
    return Parameter(name, unit, 0.0, scale, low, high, shown=100.0)


def _angle(name: str, scale: float, most: float) -> Parameter:
    """An angle that gives a direction, which alone does nothing."""
    return Parameter(name, "deg", 0.0, scale, -most, most, shown=180.0 / np.pi, secondary=True)


def _missing_mode(
    band: tuple[float, float],
    limits: tuple[float, float, float, float],
    start: float,
    count: int,
    *more: Parameter,
    along: Starts = ((),),
    variant: str = "",
) -> Cause:
    """A further mode, searched for all over a band [Hz], along some directions.

    Limits are scale and largest value of its compliance [m/N], and lowest and highest frequency over those of the band.
    """
    scale, most, low, high = limits
    mode = (
        Parameter("mode_compliance", "um/N", 0.0, scale, 0.0, most, shown=1e6),
        Parameter(
            "mode_frequency",
            "Hz",
            math.sqrt(band[0] * band[1]),
            0.02 * band[1],
            low * band[0],
            high * band[1],
            secondary=True,
        ),
        Parameter("mode_damping", "%", 0.03, 0.01, 0.002, 0.3, shown=100.0, secondary=True),
    )
    middle = np.geomspace(band[0] * 1.05, band[1] * 0.95, count).tolist()
    starts = tuple((start, f, 0.03, *a) for f, a in product(middle, along))
    title = "a mode that the model does not have"
    return _cause("missing_mode", title, *mode, *more, variant=variant, starts=starts)


# --- A feed axis: two masses, servo, friction.


def axis_causes(known: Collection[str], drive: Drive, timeless: bool = False) -> tuple[Cause, ...]:
    """Return what the model of a feed axis may lack: its drive, and what is `known` of its friction already.

    That is ``coulomb``, ``static``. A control that is declared `timeless` may have a dead time; otherwise that which it
    has is a nuisance. Fits start at forces that go with the weight of the carriage, and at compliances
    that go with that of the axis.
    """
    k, load = drive.stiffness, WEIGHT * drive.moving_mass
    newton = (0.0, 0.25 * load, 0.0, 250.0 * load)
    coulomb, under, rise = (Parameter(n, "N", *newton) for n in ("coulomb", "stribeck_coulomb", "static_rise"))
    speed = Parameter("stribeck_speed", "mm/min", 6e-3, 2e-3, 5e-4, 0.1, shown=6e4, secondary=True)
    travel = Parameter("micro_slip_travel", "um", 1e-4, 2e-5, 1e-6, 2e-3, shown=1e6, secondary=True)
    cubic = Parameter("cubic_stiffness", "N/um^3", 0.0, 1e7 * k, -1e11 * k, 1e11 * k, shown=1e-18)
    gap = Parameter("gap", "um", 2e-6, 1e-6, 0.0, 1e-3, shown=1e6)
    loading = Parameter("sensor_mass", "kg", 0.0, 0.01 * drive.tip_mass, 0.0, 0.5 * drive.tip_mass)
    slides = partial(_cause, "guideway_friction")
    friction = []
    if "coulomb" not in known:
        friction.append(slides("Coulomb friction of the guideway", coulomb, variant="coulomb", starts=((load,),)))
    if "static" not in known:
        stribeck = (rise, speed) if "coulomb" in known else (under, rise, speed)
        starts: Starts = ((load, 0.75 * load, 6e-3), (0.5 * load, 0.5 * load, 2e-2))
        if "coulomb" in known:
            starts = ((0.75 * load, 6e-3), (0.75 * load, 2e-2))
        friction.append(slides("Stribeck friction of the guideway", *stribeck, variant="stribeck", starts=starts))
    if "coulomb" in known:
        level = _percent("friction_level", 0.05, -0.9, 4.0)
        friction.append(slides("level of the guideway's friction", level, variant="level"))
    differs = partial(_cause, "friction_asymmetry")
    curve = [_percent(f"asymmetry_{n}", 0.05) for n in ("coulomb", "rise", "viscous")]
    curve.append(replace(_percent("asymmetry_speed", 0.1), secondary=True))
    share, part = _percent("micro_slip_share", 0.02, 0.0), _percent("gap_share", 0.1, 0.0, 0.95)
    delay = Parameter("extra_delay", "ms", 0.0, 1e-4, 0.0, 5e-3, shown=1e3)
    late = _cause("loop_delay", "a dead time in the control loop", delay, starts=((7.5e-4,), (1.5e-3,)))
    return (
        *friction,
        *([late] if timeless else []),
        # Hits that break the guideway away or turn the carriage round lead a fit from the null into other minima.
        differs(
            "friction that differs between the directions",
            _percent("friction_asymmetry", 0.05),
            starts=((0.2,), (-0.2,)),
        ),
        differs("a friction curve that differs between the directions", *curve, variant="curve"),
        _cause("joint_micro_slip", "micro-slip in a joint", share, travel, starts=((0.02, 1e-4), (0.02, 4e-4))),
        _cause("joint_hardening", "a joint that hardens or softens with displacement", cubic),
        _cause("backlash", "play in a joint", part, gap, starts=((0.3, 2e-6), (0.3, 2e-5))),
        _cause("posture", "stiffness that depends on the position", _percent("stiffness_per_metre", 0.02, unit="%/m")),
        _cause("drift", "stiffness that drifts over the session", _percent("stiffness_over_session")),
        _cause("accelerometer_mass", "mass of the sensor", loading),
    )


def sensor_causes(band: tuple[float, float], stiffness: float = 1.68e6) -> tuple[Cause, ...]:
    """Return the sign of the sensors along an axis, and a mode beyond those of the axis in a band [Hz].

    The mode is about as stiff as the axis [N/m], times thirty. Gain and skew are nuisances.
    """
    sign = _there("sensor_gain", "the sign of force or acceleration", "reversed_force", "sign")
    give = 1.0 / stiffness
    return sign, _missing_mode(band, (0.017 * give, 170.0 * give, 0.7, 1.5), 0.034 * give, 6)


# --- A machine that is modelled by modes.


def modal_causes(
    modes: Sequence[int],
    band: tuple[float, float],
    size: float,
    reach: float,
    places: int,
    aside: Mapping[int, float] | None = None,
) -> tuple[Cause, ...]:
    """Return what a model of some modes may lack, by their numbers, and in what its measurement may be wrong.

    It was compared over a band [Hz], in which its largest compliance is `size` [m/N], at a number of places, the
    farthest `reach` [m] from that of the baseline (1 where all are alike). The direction of each mode is known to
    `aside` [rad].
    """
    small, far = 0.003 * size, 0.9 / reach
    whole, across, count = pairs(modes), tuple(combinations(modes, 2)), len(modes)

    def matrix(what: str, at: Sequence[tuple[int, int]] = whole, most: float = 0.9, unit: str = "%") -> list[Parameter]:
        return [_percent(f"{what}_{r}{s}", 0.01, -most, most, unit) for r, s in at]

    def joint(id_: str, title: str) -> Cause:
        angles = (_angle(f"{id_}_angle_{r}", 0.2, 4.0) for r in modes[:-1])
        # Along each axis of mode space, a little off where the angles count.
        return _cause(id_, title, _percent(id_, 0.01, 0.0, 3.0), *angles, starts=along_modes(0.01))

    def along_modes(*size: float) -> Starts:
        return tuple((*size, *(_RIGHT if s < r else 0.1 for s in range(count - 1))) for r in range(count))

    def spent() -> Cause:
        """Micro-slip of elements that all slip within the levels measured."""
        angles = (_angle(f"joint_iwan_angle_{r}", 0.2, 4.0) for r in modes[:-1])
        travel = Parameter("joint_iwan_travel", "1", 1.0, 0.3, 0.05, 30.0, secondary=True)
        # What is lost at one amplitude: of elements that never all slip their share over their travel alone is seen.
        lost = _percent("joint_iwan", 0.01, 0.0, 1.0)
        starts = along_modes(0.02, 1.0)
        title = "micro-slip in a joint"
        return _cause("joint_micro_slip", title, lost, travel, *angles, variant="iwan", starts=starts)

    depends = partial(_cause, "posture", "stiffness that depends on the position")
    bend = Parameter("posture_bend", "1/m", 0.0, 0.3 / reach, -10.0 * far, 10.0 * far, secondary=True)
    spindle = partial(_cause, "spindle_speed_dynamics", "modes that change with the speed of the spindle")
    both = [p for what, at in (("bearings", whole), ("gyroscopic", across)) for p in matrix(TWICE[1] + what, at)]
    turns = (replace(_angle(f"turn_{side}_{r}", 0.02, _RIGHT), secondary=False) for r, side in product(modes, "ab"))
    directions = (_angle(f"mode_{n}", 0.3, 2.0 * np.pi) for n in ("azimuth", "elevation"))
    along = ((0.01, 0.01), (_RIGHT, 0.01), (0.01, _RIGHT))
    lowest = {n: 0.0 if n[-1] == n[-2] else -size for n in RESIDUAL}
    residual = (Parameter(n, "um/N", 0.0, small, low, size, shown=1e6) for n, low in lowest.items())
    signs = {"force": "the force sensor", **{a: f"the accelerometer along {a}" for a in AXES}}
    exchanged = {f"exchanged_{a}{b}": f"{a} and {b} of the accelerometer are exchanged" for a, b in PLANES}
    # A block of three sensors that is mounted wrong is turned by a right angle: two axes exchanged, one turned round.
    quarters = [_quarter(a, b) for a, b in PLANES]
    return (
        depends(*matrix("posture", whole, far, "%/m")),
        *([depends(*matrix("curved", whole, far, "%/m"), bend, variant="curved")] if places > 3 else []),
        _cause("drift", "stiffness that drifts over the session", *matrix("drift")),
        spindle(*matrix("bearings"), variant="bearings"),
        *([spindle(*matrix("gyroscopic", across), variant="gyroscopic")] if across else []),
        *([spindle(*both, variant="both")] if across else []),
        joint("joint_micro_slip", "micro-slip in a joint"),
        spent(),
        joint("joint_hardening", "a joint that hardens with displacement"),
        replace(
            _cause(
                "cross_axis_coupling", "directions of the modes: axes that are coupled", *turns, variant="directions"
            ),
            known={f"turn_{side}_{r}": off for r, off in (aside or {}).items() for side in "ab"},
        ),
        _cause("cross_axis_coupling", "springs between the axes", *matrix("coupling"), variant="springs"),
        _missing_mode(band, (small, 10.0 * size, 0.5, 2.0), small, 10, *directions, along=along, variant="in band"),
        _cause("missing_mode", "flexibility of modes above the band", *residual, variant="above"),
        _cause("modal_mass", "mass of all modes, the stiffness as it is", _percent("mass_error", high=9.0)),
        # Gains, turned axes, a skew and the scale of all modes are nuisances; a fit from them reaches none of these.
        *(_there("sensor_gain", f"the sign of {said}", f"reversed_{a}", f"sign_{a}") for a, said in signs.items()),
        *(_there("sensor_axis", said, n, n) for n, said in exchanged.items()),
        *quarters,
        _cause("accelerometer_mass", "mass of the sensor", Parameter("sensor_mass", "kg", 0.0, 0.05, 0.0, 100.0)),
    )


def pairs(modes: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return the places of a symmetric matrix whose rows have some numbers."""
    return tuple(combinations_with_replacement(modes, 2))


def vector(angles: Sequence[float]) -> tuple[float, ...]:
    """Unit vector of spherical angles: ``cos a1, sin a1 cos a2, sin a1 sin a2 cos a3 ...``."""
    out, rest = [], 1.0
    for a in angles:
        out.append(rest * math.cos(a))
        rest *= math.sin(a)
    return (*out, rest)
