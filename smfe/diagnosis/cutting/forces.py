"""Diagnosis of cutting forces: a mechanistic baseline without run-out, mostly without edge forces, against orders.

The angle at which a record starts is not known: a prediction is turned to the angle that fits best.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES
from process.types import Complex, Real
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.cutting.orders import CuttingOrders, SteadyCut, cutting_orders, hidden_orders, rigid_orders
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values


@dataclass(frozen=True)
class KnownForce:
    """A constant force that is known, on the force sensor: a weight, a calibrated screw."""

    force: tuple[float, float, float]  # along x, y, z [N], as the sensor should read it
    std: float  # what force and reading are uncertain by [N]


@dataclass(frozen=True)
class CuttingForces(Abilities):
    """A family for `smfe.diagnosis.inference.diagnose`: steady cuts with one tool; see `cutting_family`."""

    tool: Tool  # diameter, teeth, approach angle, helix
    coefficients: tuple[float, float, float]  # handbook Ktc, Krc, Kac [N/m2]; fitted anew under every hypothesis
    conditions: tuple[Condition, ...]  # what was measured
    proposals: tuple[Condition, ...] = ()  # what could be measured next
    spread: float = RULES.lot_scatter  # prior standard deviation of the coefficients over the largest of them
    suspects: tuple[Suspect, ...] = ()  # measurement faults that were found and left out beforehand
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Kte, Kre, Kae [N/m] that the baseline has

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Cutting coefficients, and the helix angle that smooths the orders."""
        largest = max(abs(c) for c in self.coefficients)
        out = [
            Parameter(name, "N/mm^2", value, 0.1 * largest, low * largest, 10.0 * largest, self.spread * largest, 1e-6)
            for name, value, low in zip(("Ktc", "Krc", "Kac"), self.coefficients, (0.0, -3.0, -3.0), strict=True)
        ]
        start = min(self.tool.helix_angle, 1.2)
        return (*out, Parameter("helix", "deg", start, 0.1, 0.0, 1.2, 0.35, 180.0 / math.pi))

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What a mechanistic model without run-out and edge forces lacks."""
        largest = max(abs(c) for c in self.coefficients)
        return (*_process_causes(self.tool, largest, self.edge), *_sensor_causes(self._highest()))

    def _cuts(self) -> list[CuttingOrders]:
        return [c.data for c in self.conditions if isinstance(c.data, CuttingOrders)]

    def _highest(self) -> float:
        """Highest frequency of an order [Hz]."""
        return max((c.cut.rotation / (2.0 * math.pi) * (c.value.shape[0] - 1) for c in self._cuts()), default=1000.0)

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return what a set of values predicts, whitened like the data."""
        if isinstance(condition.data, KnownForce):
            known = np.array([condition.data.force], dtype=complex)
            return np.asarray(_through_sensor(known, 0.0, values)[0].real / condition.data.std)
        found = condition.data
        assert isinstance(found, CuttingOrders)
        orders = self.orders(found, values)
        return found.whitened(orders if condition.observed is None else turned(orders, found))

    def orders(self, found: CuttingOrders, values: Values) -> Complex:
        """Return the orders of a cut that a set of values predicts [N], shape (orders, 3), at any spindle angle."""
        orders = rigid_orders(self.tool, found.cut, found.value.shape[0], values)
        return _through_sensor(orders, found.cut.rotation, values)


def cutting_family(
    records: Mapping[str, tuple[xr.Dataset, SteadyCut]],
    tool: Tool,
    coefficients: tuple[float, float, float],
    proposals: Mapping[str, SteadyCut | KnownForce] | None = None,
    known_forces: Mapping[str, tuple[Sequence[float], KnownForce]] | None = None,
    floor: float = RULES.force_floor,
    crosstalk: float = RULES.crosstalk,
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> CuttingForces:
    """Build the family of a campaign of steady cuts; `InputError` without a cut, or for a record that holds none.

    `records` are forces along x, y, z and the setting of the cut by name, `coefficients` and `edge` the handbook's Ktc,
    Krc, Kac [N/m2] and the Kte, Kre, Kae [N/m] of the baseline, `proposals` cuts or known forces that could be measured
    next, `known_forces` readings [N] and the forces that caused them. `floor` and `crosstalk` are what a model is not
    expected to reach (`smfe.diagnosis.cutting.orders`).
    """
    found = {name: cutting_orders(record, tool, cut, floor, crosstalk) for name, (record, cut) in records.items()}
    if not any(c.cut.depth > 0.0 for c in found.values()):
        raise InputError("no record of a cut was given; a model of cutting forces needs at least one")
    found, suspects = hidden_orders(found)
    conditions = [_condition(name, c, measured=True) for name, c in found.items()]
    for name, (reading, known) in (known_forces or {}).items():
        observed = np.asarray(reading, dtype=float) / known.std
        conditions.append(Condition(name, {"experiment": "known force"}, observed, "", known))
    first = CuttingForces(tool, coefficients, tuple(conditions), suspects=suspects, edge=edge)
    proposed = []
    for name, p in (proposals or {}).items():
        if isinstance(p, KnownForce):
            proposed.append(Condition(name, {"experiment": "known force"}, None, "", p))
        else:
            proposed.append(_condition(name, _expected(first, p, floor, crosstalk), measured=False))
    return replace(first, proposals=tuple(proposed))


def _condition(name: str, found: CuttingOrders, measured: bool) -> Condition:
    cut = found.cut
    settings = {
        "spindle_rpm": float(round(cut.rotation * 30.0 / math.pi, -1)),
        "feed_per_tooth": cut.feed_per_tooth,
        "depth": cut.depth,
        "immersion": cut.arc.exit - cut.arc.entry,
    }
    return Condition(name, settings, found.whitened(found.value) if measured else None, "", found)


def _expected(family: CuttingForces, cut: SteadyCut, floor: float, crosstalk: float) -> CuttingOrders:
    """Orders of a cut that has not been made, from the handbook, with the noise of those that have."""
    noise = np.median([c.std for c in family._cuts()], axis=(0, 1)) if cut.depth == 0.0 else np.zeros(3)
    count = family._cuts()[0].value.shape[0]
    known = dict(zip(("Kte", "Kre", "Kae"), family.edge, strict=True))
    value = rigid_orders(family.tool, cut, count, {**{p.name: p.start for p in family.nuisances}, **known})
    power = 0.5 * np.sum(np.abs(value[1:]) ** 2, axis=0)
    std = np.sqrt(noise**2 + floor**2 * power + crosstalk**2 * power.sum() + 1e-12)
    return CuttingOrders(cut, value, np.tile(std, (count, 1)), {})


def _process_causes(tool: Tool, largest: float, known: tuple[float, float, float]) -> list[Cause]:
    """Causes in tool and work."""
    bounds = zip("tra", known, (0.0, 0.0, -2e5), strict=True)
    edge = tuple(
        Parameter(f"K{n}e", "N/mm", start, 5e3, min(low, start), 2e5 + start, shown=1e-3) for n, start, low in bounds
    )
    size = tuple(Parameter(f"size_effect_{n}", "1", 0.0, 0.1, -0.9, 0.9) for n in "tra")
    other = tuple(
        Parameter(f"other_K{n}c", "N/mm^2", 0.0, 0.1 * largest, -10.0 * largest, 10.0 * largest, shown=1e-6)
        for n in "tra"
    )
    runout = [Parameter("runout", "um", 0.0, 5e-6, 0.0, 5e-4, shown=1e6)]
    starts: list[tuple[float, ...]] = [(5e-6,), (2e-5,)]
    if tool.teeth > 2:  # with two teeth only their difference counts
        runout.append(Parameter("runout_angle", "deg", 0.5, 0.3, -2.0 * math.pi, 2.0 * math.pi, shown=180.0 / math.pi))
        starts = [(2e-5, a) for a in np.linspace(-math.pi, math.pi, 8, endpoint=False)]
    causes = [
        Cause("edge_forces", "other edge forces" if any(known) else "edge forces", edge, starts=((2e4, 2e4, 0.0),)),
        Cause("force_coefficients", "coefficients that depend on the chip thickness", size, "size_effect"),
        Cause("force_coefficients", "a material that cuts unlike the handbook's", other, "material"),
        Cause("runout", "run-out of the tool", tuple(runout), starts=tuple(starts)),
    ]
    return causes[: 4 if tool.teeth > 1 else 3]


def _sensor_causes(highest: float) -> list[Cause]:
    """Causes in the force sensor, for orders up to a frequency [Hz]."""
    exchange = Parameter("exchange", "1", 0.0, 0.2, -0.5, 1.5)
    turn = Parameter("turned", "deg", 0.0, 0.2, -3.5, 3.5, shown=180.0 / math.pi)
    gains = tuple(Parameter(f"gain_{a}", "%", 0.0, 0.05, -12.0, 12.0, shown=100.0) for a in AXES)
    offsets = tuple(Parameter(f"offset_{a}", "N", 0.0, 5.0, -1e3, 1e3) for a in AXES)
    resonances = tuple(
        p
        for a in AXES
        for p in (
            Parameter(f"dynamometer_{a}", "1/kHz^2", 0.0, 0.1 / highest**2, 0.0, 100.0 / highest**2, shown=1e6),
            Parameter(f"dynamometer_lag_{a}", "ms", 0.0, 0.05 / highest, 0.0, 10.0 / highest, shown=1e3),
        )
    )
    ratios = [r / highest for r in (0.65, 0.9, 1.5)]
    rotating = (
        Parameter("turning_force", "N", 0.0, 2.0, 0.0, 1e3),
        Parameter("turning_force_angle", "deg", 0.5, 0.3, -2.0 * math.pi, 2.0 * math.pi, shown=180.0 / math.pi),
    )
    around = tuple((5.0, a) for a in np.linspace(-math.pi, math.pi, 6, endpoint=False))
    causes = [
        Cause("sensor_axis", "x and y of the force sensor are exchanged", (exchange,), "exchange", starts=((1.0,),)),
        Cause(
            "sensor_axis",
            "the force sensor is turned about z",
            (turn,),
            "turned",
            starts=((0.5 * math.pi,), (-0.5 * math.pi,), (3.0,)),
        ),
        Cause("sensor_gain", "gains of the force sensor", gains, starts=((-2.0, -2.0, -2.0), (4.0, 4.0, 4.0))),
        Cause("sensor_offset", "offsets of the force sensor", offsets),
        Cause(
            "dynamometer_dynamics",
            "dynamics of the dynamometer",
            resonances,
            starts=tuple((p**2, 0.1 * p, p**2, 0.1 * p, 0.5 * p**2, 0.05 * p) for p in ratios),
        ),
        Cause(
            "background_tone", "a force that turns with the spindle without cutting", rotating, "spindle", starts=around
        ),
    ]
    return [Cause(c.id, c.title, c.parameters, c.variant, "measurement", c.starts) for c in causes]


def _through_sensor(orders: Complex, rotation: float, values: Values) -> Complex:
    """Force that turns, dynamometer, mounting, gains and offsets, in this order."""
    out = orders.copy()
    force = values.get("turning_force", 0.0)
    if orders.shape[0] > 1 and force:
        phase = force * np.exp(-1j * values.get("turning_force_angle", 0.0))
        out[1, :2] += np.array([-1j * phase, phase])
    mix, turn = values.get("exchange", 0.0), values.get("turned", 0.0)
    x, y = out[:, 0].copy(), out[:, 1].copy()
    x, y = (1.0 - mix) * x + mix * y, (1.0 - mix) * y + mix * x
    out[:, 0], out[:, 1] = math.cos(turn) * x + math.sin(turn) * y, math.cos(turn) * y - math.sin(turn) * x
    frequency = np.arange(orders.shape[0]) * rotation / (2.0 * math.pi)
    for i, axis in enumerate(AXES):
        square, lag = values.get(f"dynamometer_{axis}", 0.0), values.get(f"dynamometer_lag_{axis}", 0.0)
        out[:, i] /= 1.0 - frequency**2 * square + 1j * frequency * lag
        out[:, i] *= 1.0 + values.get(f"gain_{axis}", 0.0)
        out[0, i] += values.get(f"offset_{axis}", 0.0)
    return out


def turned(orders: Complex, found: CuttingOrders) -> Complex:
    """Turn a prediction by the spindle angle at the start of the record, which is what fits it best.

    The correlation over all angles is one inverse transform of its orders; Newton's steps refine its maximum.
    """
    product = np.sum(orders.conj() * found.value / found.std**2, axis=1)
    product[0] = 0.0
    n = np.arange(orders.shape[0])
    grid = 2.0 * math.pi / RULES.angles
    angle = grid * int(np.argmax(np.fft.irfft(product, RULES.angles)))
    for _ in range(2):
        each = product * np.exp(1j * n * angle)
        bend = float(np.sum(n**2 * each.real))
        if bend <= 0.0:
            break
        angle += float(np.clip(-np.sum(n * each.imag) / bend, -grid, grid))
    return np.asarray(orders * np.exp(-1j * n * angle)[:, None])
