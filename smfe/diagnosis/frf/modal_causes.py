"""What a modal model of a machine may lack, and in what its measurement may be wrong.

Springs that change along the pass, over the session or with the spindle's speed change the matrix of modal
stiffnesses: its diagonal moves the frequencies, the rest turns the shapes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, combinations_with_replacement, product

import numpy as np

from smfe.diagnosis.inference.problem import Cause, Parameter

AXES = "xyz"
PLANES = (("x", "y"), ("y", "z"), ("z", "x"))
RESIDUAL = tuple(f"residual_{e}" for e in ("xx", "yy", "zz", "xy", "yz", "zx"))
"""Parameters of the flexibility of modes above the band."""

TWICE = ("", "also_")
"""Prefixes of parameters that are in two variants of a cause."""

_GRID = 10
_OFF = 0.1
_RIGHT = 0.5 * np.pi


def modal_causes(modes: int, band: tuple[float, float], size: float, reach: dict[str, float]) -> tuple[Cause, ...]:
    """Return the catalogue.

    Parameters
    ----------
    modes : int
        How many the baseline has.
    band : (float, float)
        Compared from, to [Hz].
    size : float
        Largest compliance of the baseline in the band [m/N].
    reach : dict
        Largest ``position`` from that of the baseline [m], of all conditions, 1 where all are alike; number of
        ``places``.
    """
    travel = 0.9 / reach["position"]
    posture = _trend("posture", "stiffness that depends on the position", "%/m", modes, travel)
    bend = Parameter("posture_bend", "1/m", 0.0, 0.3 / reach["position"], -10.0 * travel, 10.0 * travel)
    curved = _trend("curved", posture.title, "%/m", modes, travel)
    return (
        posture,
        *([Cause("posture", posture.title, (*curved.parameters, bend), "curved")] if reach["places"] > 3 else []),
        _trend("drift", "stiffness that drifts over the session", "%", modes, 0.9),
        *_spindle(modes),
        *_joints(modes),
        *_coupling(modes),
        *_beyond(band, size),
        *_baseline(),
        *_sensors(),
    )


def pairs(modes: int) -> tuple[tuple[int, int], ...]:
    """Return the places of a symmetric matrix, from 1."""
    return tuple(combinations_with_replacement(range(1, modes + 1), 2))


def _percent(name: str, low: float = -0.9, high: float = 0.9, scale: float = 0.01, unit: str = "%") -> Parameter:
    return Parameter(name, unit, 0.0, scale, low, high, shown=100.0)


def _trend(what: str, title: str, unit: str, modes: int, most: float) -> Cause:
    return Cause(what, title, tuple(_percent(f"{what}_{r}{s}", -most, most, unit=unit) for r, s in pairs(modes)))


def _spindle(modes: int) -> tuple[Cause, ...]:
    title = "modes that change with the speed of the spindle"
    bearings, with_bearings = (tuple(_percent(f"{b}bearings_{r}{s}") for r, s in pairs(modes)) for b in TWICE)
    turning, with_turning = (
        tuple(_percent(f"{b}gyroscopic_{r}{s}") for r, s in combinations(range(1, modes + 1), 2)) for b in TWICE
    )
    found = [Cause("spindle_speed_dynamics", title, bearings, "bearings")]
    if modes > 1:
        found.append(Cause("spindle_speed_dynamics", title, turning, "gyroscopic"))
        found.append(Cause("spindle_speed_dynamics", title, (*with_bearings, *with_turning), "both"))
    return tuple(found)


def _joints(modes: int) -> tuple[Cause, ...]:
    found = []
    for id_, title, least in (
        ("joint_micro_slip", "micro-slip in a joint", 0.0),
        ("joint_hardening", "a joint that hardens with displacement", 0.0),
    ):
        size = _percent(id_, least, 3.0)
        turns = tuple(
            Parameter(f"{id_}_angle_{r}", "deg", 0.0, 0.2, -4.0, 4.0, shown=180.0 / np.pi) for r in range(1, modes)
        )
        starts = tuple((0.01, *angles) for angles in _unit_vectors(modes))
        found.append(Cause(id_, title, (size, *turns), starts=starts))
    return tuple(found)


def _unit_vectors(modes: int) -> list[tuple[float, ...]]:
    """Spherical angles of the axes of mode space, a little off, where the angles count."""
    found = []
    for r in range(modes):
        angles = [_RIGHT if s < r else _OFF for s in range(modes - 1)]
        found.append(tuple(angles))
    return found


def vector(angles: Sequence[float]) -> tuple[float, ...]:
    """Unit vector of spherical angles: ``cos a1, sin a1 cos a2, sin a1 sin a2 cos a3 ...``."""
    out, rest = [], 1.0
    for a in angles:
        out.append(rest * math.cos(a))
        rest *= math.sin(a)
    return (*out, rest)


def _coupling(modes: int) -> tuple[Cause, Cause]:
    """Return modes that point elsewhere, and springs between modes that the model keeps apart."""
    turns = tuple(
        Parameter(f"turn_{side}_{r}", "deg", 0.0, 0.02, -_RIGHT, _RIGHT, shown=180.0 / np.pi)
        for r, side in product(range(1, modes + 1), "ab")
    )
    springs = tuple(_percent(f"coupling_{r}{s}") for r, s in pairs(modes))
    return (
        Cause("cross_axis_coupling", "directions of the modes: axes that are coupled", turns, "directions"),
        Cause("cross_axis_coupling", "springs between the axes", springs, "springs"),
    )


def _beyond(band: tuple[float, float], size: float) -> tuple[Cause, Cause]:
    low, high = band
    small = 0.003 * size
    turn = 180.0 / np.pi
    mode = (
        Parameter("mode_compliance", "um/N", 0.0, small, 0.0, 10.0 * size, shown=1e6),
        Parameter("mode_frequency", "Hz", float(np.sqrt(low * high)), 0.02 * high, 0.5 * low, 2.0 * high),
        Parameter("mode_damping", "%", 0.03, 0.01, 0.002, 0.3, shown=100.0),
        Parameter("mode_azimuth", "deg", 0.0, 0.3, -2.0 * np.pi, 2.0 * np.pi, shown=turn),
        Parameter("mode_elevation", "deg", 0.0, 0.3, -2.0 * np.pi, 2.0 * np.pi, shown=turn),
    )
    middle = [float(f) for f in np.geomspace(low * 1.05, high * 0.95, _GRID)]
    along = ((0.01, 0.01), (_RIGHT, 0.01), (0.01, _RIGHT))
    starts = tuple((small, f, 0.03, *a) for f, a in product(middle, along))
    residual = tuple(
        Parameter(name, "um/N", 0.0, small, 0.0 if name[-1] == name[-2] else -size, size, shown=1e6)
        for name in RESIDUAL
    )
    title = "a mode that the model does not have"
    return (
        Cause("missing_mode", title, mode, "in band", starts=starts),
        Cause("missing_mode", "flexibility of modes above the band", residual, "above"),
    )


def _baseline() -> tuple[Cause, Cause]:
    return (
        Cause("modal_scale", "scale of all modes: stiffness and mass together", (_percent("scale_error", -0.9, 9.0),)),
        Cause("modal_mass", "mass of all modes, the stiffness as it is", (_percent("mass_error", -0.9, 9.0),)),
    )


def _sensors() -> tuple[Cause, ...]:
    gains = [("force", "gain of the force sensor"), *((a, f"gain of the accelerometer along {a}") for a in AXES)]
    turned = tuple(Parameter(f"turned_{a}", "deg", 0.0, 0.02, -1.0, 1.0, shown=180.0 / np.pi) for a in AXES)
    return (
        *(_gain(a, title) for a, title in gains),
        *(_switch(f"{a} and {b} of the accelerometer are exchanged", f"exchanged_{a}{b}") for a, b in PLANES),
        _measured("sensor_axis", "the accelerometer is turned", turned, "turned"),
        _measured(
            "time_skew",
            "time skew between force and motion",
            (Parameter("skew", "us", 0.0, 1e-5, -2e-3, 2e-3, shown=1e6),),
        ),
        _measured("accelerometer_mass", "mass of the sensor", (Parameter("sensor_mass", "kg", 0.0, 0.05, 0.0, 100.0),)),
    )


def _measured(id_: str, title: str, parameters: Sequence[Parameter], variant: str = "") -> Cause:
    return Cause(id_, title, tuple(parameters), variant, "measurement")


def _gain(axis: str, title: str) -> Cause:
    """Return a gain; a wrong sign is one of -200 %."""
    return Cause("sensor_gain", title, (_percent(f"gain_{axis}", -12.0, 12.0),), axis, "measurement", ((-2.0,),))


def _switch(title: str, name: str) -> Cause:
    """Return a cause that is there or not: above one half it is; nothing lies between."""
    return _measured("sensor_axis", title, (Parameter(name, "0/1", 0.0, 1.0, 0.0, 1.5),), name)
