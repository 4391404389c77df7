"""The force sensor of a cut: gains, mounting and cross-talk within tolerances, and what may be wrong with it.

A workshop's imperfections are nuisances with priors that all records of the sensor share. Causes are what no tolerance
reaches: a sign, exchanged axes, a dynamometer that vibrates itself, a force that comes from the spindle and not from
the cut.
"""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np

from process.labels import AXES
from process.types import Complex, Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.inference.problem import Cause, Parameter, Values

_DEGREES = 180.0 / math.pi


def sensor_nuisances(t: Tolerances) -> tuple[Parameter, ...]:
    """Return gains (one common, one an axis), mounting about z and what each channel shows of the other axes.

    Turns about x and y are small like cross-talk, and counted with it.
    """
    each = [("gain_common", "gain of the force sensor", t.sensor_gain)]
    each += [(f"gain_{a}", f"gain of the force sensor along {a}", t.sensor_gain) for a in AXES]
    found = [
        Parameter(n, "%", 0.0, 0.01, -0.8, 4.0, sd, 100.0, given="sensor_gain", said=said) for n, said, sd in each if sd
    ]
    if t.mounting_angle:
        said = "mounting of the force sensor about z"
        found.append(
            Parameter(
                "mounting", "deg", 0.0, 0.02, -0.7, 0.7, t.mounting_angle, _DEGREES, given="sensor_axis", said=said
            )
        )
    for seen, source in permutations(AXES, 2):
        sd = math.hypot(t.cross_talk, t.mounting_angle if "z" in (seen, source) else 0.0)
        if sd:
            said = f"share of the force along {source} that channel {seen} shows"
            # A matrix that is free otherwise is any gain: a mounting and cross-talk that undo each other.
            most = max(RULES.most_cross_talk, 10.0 * sd)
            name = f"talk_{seen}{source}"
            found.append(Parameter(name, "%", 0.0, 0.01, -most, most, sd, 100.0, given="sensor_axis", said=said))
    return tuple(found)


def sensor_causes(highest: float, fastest: float, resonances: tuple[float, ...]) -> list[Cause]:
    """Return causes in the force sensor, for orders up to a frequency [Hz] and spindles up to a rotation [rad/s].

    `resonances` are values of the dynamics of the dynamometer from which a fit begins, besides usual ones.
    """
    # Switches, like signs: beyond its threshold nothing holds one, and where it ends says nothing.
    exchange, over = (Parameter(n, "1", 0.0, 1.0, 0.0, 1.5, secondary=True) for n in ("exchange", "turned_over"))
    turn = Parameter("turned", "deg", 0.0, 0.2, -3.5, 3.5, shown=_DEGREES)
    offsets = tuple(Parameter(f"offset_{a}", "N", 0.0, 5.0, -1e3, 1e3) for a in AXES)
    dynamics = tuple(p for a in AXES for p in _resonance(a, highest))
    ratios = [r / highest for r in (0.65, 0.9, 1.5)]
    resonant = (resonances, *((p**2, 0.1 * p, p**2, 0.1 * p, 0.5 * p**2, 0.05 * p) for p in ratios))
    signs = [
        ("sign", "the signs of all channels of the force sensor", AXES),
        *((f"sign_{a}", f"the sign of channel {a} of the force sensor", (a,)) for a in AXES),
    ]
    causes = [
        Cause("sensor_axis", "x and y of the force sensor are exchanged", (exchange,), "exchange", starts=((1.0,),)),
        Cause(
            "sensor_axis",
            "x and y of the force sensor are exchanged and z is turned round, as where it lies on its face",
            (over,),
            "turned_over",
            starts=((1.0,),),
        ),
        Cause(
            "sensor_axis",
            "the force sensor is turned about z",
            (turn,),
            "turned",
            starts=((0.5 * math.pi,), (-0.5 * math.pi,), (3.0,)),
        ),
        *(
            Cause(
                "sensor_gain",
                title,
                (Parameter(name, "1", 0.0, 1.0, 0.0, 1.5, secondary=True),),
                name,
                starts=((1.0,),),
            )
            for name, title, _ in signs
        ),
        Cause("sensor_offset", "offsets of the force sensor", offsets),
        Cause("dynamometer_dynamics", "dynamics of the dynamometer", dynamics, starts=resonant),
        _turning("turning_force", "N", 2.0, 1e3, 1.0, "a force that turns with the spindle without cutting", "spindle"),
        _turning(
            "unbalance",
            "g mm",
            2.0 / fastest**2,
            1e3 / fastest**2,
            1e6,
            "unbalance: a force that turns with the spindle and grows with the square of its speed",
            "unbalance",
        ),
    ]
    return [Cause(c.id, c.title, c.parameters, c.variant, "measurement", c.starts) for c in causes]


def _resonance(axis: str, highest: float) -> tuple[Parameter, Parameter]:
    square, lag = 0.1 / highest**2, 0.05 / highest
    return (
        Parameter(f"dynamometer_{axis}", "1/kHz^2", 0.0, square, 0.0, 1000.0 * square, shown=1e6),
        # In turns, as all here counts frequency; shown is the time that it lags.
        Parameter(
            f"dynamometer_lag_{axis}", "ms", 0.0, lag, 0.0, 200.0 * lag, shown=1e3 / (2.0 * math.pi), secondary=True
        ),
    )


def _turning(name: str, unit: str, scale: float, most: float, shown: float, title: str, variant: str) -> Cause:
    """A vector that turns with the spindle; its direction is one from the first tooth."""
    angle = Parameter(f"{name}_angle", "deg", 0.5, 0.3, -2.0 * math.pi, 2.0 * math.pi, shown=_DEGREES, secondary=True)
    around = tuple((2.5 * scale, float(a)) for a in np.linspace(-math.pi, math.pi, 6, endpoint=False))
    size = Parameter(name, unit, 0.0, scale, 0.0, most, shown=shown)
    return Cause("background_tone", title, (size, angle), variant, starts=around)


def through_sensor(orders: Complex, rotation: float, values: Values) -> Complex:
    """Return what the sensor shows of orders (n, 3) of a force on the tool at a spindle rotation [rad/s].

    Force that turns with the spindle, dynamometer, axes, mounting and cross-talk, gains and signs, offsets: in this
    order.
    """
    out = orders.copy()
    if orders.shape[0] > 1:
        for name, grown in (("turning_force", 1.0), ("unbalance", rotation**2)):
            if force := values.get(name, 0.0) * grown:
                phase = force * np.exp(-1j * values.get(f"{name}_angle", 0.0))
                out[1, :2] += np.array([-1j * phase, phase])
    out = out @ _mounted(values).T
    frequency = np.arange(orders.shape[0]) * rotation / (2.0 * math.pi)
    for i, axis in enumerate(AXES):
        square, lag = values.get(f"dynamometer_{axis}", 0.0), values.get(f"dynamometer_lag_{axis}", 0.0)
        if square or lag:
            flexible = 1.0 - frequency**2 * square + 1j * frequency * lag
            # A resonance right on an order is large, and not infinite.
            out[:, i] /= np.where(np.abs(flexible) < 1e-3, 1e-3, flexible)
    # A sum: what the channels have in common and what is their own trade with each other, however large they are.
    gains = [1.0 + values.get("gain_common", 0.0) + values.get(f"gain_{a}", 0.0) for a in AXES]
    signs = [_sign(values, "sign") * _sign(values, f"sign_{a}") for a in AXES]
    out *= np.multiply(gains, signs)
    out[0] += [values.get(f"offset_{a}", 0.0) for a in AXES]
    return out


def _on(values: Values, switch: str) -> bool:
    """Whether a switch is on: between right and wrong there is nothing, where it would be a gain of one axis."""
    return values.get(switch, 0.0) > 0.5


def _sign(values: Values, switch: str) -> float:
    return -1.0 if _on(values, switch) else 1.0


def _mounted(values: Values) -> Real:
    """What each channel shows of each axis, (3, 3): exchanged and turned axes, then what it shows of the others."""
    turn = values.get("turned", 0.0) + values.get("mounting", 0.0)
    c, s = math.cos(turn), math.sin(turn)
    exchanged = np.eye(3)
    if _on(values, "exchange") != _on(values, "turned_over"):
        exchanged[:2] = exchanged[1::-1]
    exchanged[2, 2] = _sign(values, "turned_over")
    turned = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    shown = [[1.0 if a == b else values.get(f"talk_{a}{b}", 0.0) for b in AXES] for a in AXES]
    return np.asarray(np.array(shown) @ turned @ exchanged)
