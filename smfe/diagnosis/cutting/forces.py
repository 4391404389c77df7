"""Diagnosis of cutting forces: a mechanistic baseline without run-out, mostly without edge forces, against orders.

The angle at which a record starts is not known: a prediction is turned to the angle that fits best.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.cut.tool import Tool
from process.errors import InputError
from process.types import Complex, Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.checks.suspect import Suspect, warning
from smfe.diagnosis.cutting.orders import CuttingOrders, SteadyCut, beside_mains, cutting_orders, out_of_reach
from smfe.diagnosis.cutting.rigid import rigid_orders
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.cutting.sensor import sensor_causes, sensor_nuisances, through_sensor
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values


@dataclass(frozen=True)
class KnownForce:
    """A constant force that is known, on the force sensor: a weight, a calibrated screw."""

    force: tuple[float, float, float]  # along x, y, z [N], as the sensor should read it
    std: float  # what force and reading are uncertain by [N]


@dataclass(frozen=True)
class CuttingForces(Abilities):
    """A family for `smfe.diagnosis.judgement.diagnose`: steady cuts with one tool; see `cutting_family`."""

    tool: Tool  # diameter, teeth, approach angle, helix, run-out as declared
    coefficients: tuple[float, float, float]  # Ktc, Krc, Kac [N/m2] as given
    conditions: tuple[Condition, ...]  # what was measured
    proposals: tuple[Condition, ...] = ()  # what could be measured next
    tolerances: Tolerances = field(default_factory=Tolerances)
    suspects: tuple[Suspect, ...] = ()  # measurement faults that were found and left out beforehand
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Kte, Kre, Kae [N/m] as given
    missing: tuple[str, ...] = ()  # coefficients that nobody gave
    stated: bool = False  # whether the coefficients were given with their uncertainty

    @property
    def one_scale(self) -> bool:
        """Depth and width of a cut are as they were declared."""
        return True

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """What is known within tolerances: coefficients, edge forces, the force sensor; and the helix that smooths."""
        start = min(self.tool.helix_angle, 1.2)
        helix = Parameter("helix", "deg", start, 0.1, 0.0, 1.2, 0.35, 180.0 / math.pi)
        return (*self._coefficients(), *self._edges(), *sensor_nuisances(self.tolerances), helix, *self._seats())

    def _seats(self) -> Iterator[Parameter]:
        """Radii of the teeth after the first beside a run-out that was declared, which somebody measured."""
        if self.tool.equal_radius:
            return
        sd = RULES.seat * float(np.ptp(self.tool.tooth_offsets()))
        for j in range(2, self.tool.teeth + 1):
            said = f"radius of tooth {j} over that of the first"
            yield Parameter(f"seat_{j}", "um", 0.0, 1e-6, -5e-4, 5e-4, sd, 1e6, said=said)

    def _coefficients(self) -> Iterator[Parameter]:
        largest = max(abs(c) for c in self.coefficients)
        share = max(self.tolerances.coefficients, RULES.exact)
        for n, value, low in zip("tra", self.coefficients, RULES.least_coefficients, strict=True):
            given = f"K{n}c" not in self.missing
            sd = share * max(abs(value), RULES.least_coefficient * largest) if given else RULES.undeclared * largest
            yield Parameter(
                f"K{n}c",
                "N/mm^2",
                value,
                0.1 * largest,
                min(low * largest, value),
                10.0 * largest,
                sd,
                1e-6,
                given="force_coefficients" if given else "",
                stated=self.stated,
                said=f"cutting coefficient K{n}c",
            )

    def _edges(self) -> Iterator[Parameter]:
        """Edge forces that are given, as well known as their material says; where none is they are a cause."""
        largest = max(abs(e) for e in self.edge)
        share = max(self.tolerances.coefficients, RULES.exact) if self.stated else RULES.edge_scatter
        if largest == 0.0:
            return
        for n, value in zip("tra", self.edge, strict=True):
            sd = share * max(abs(value), RULES.least_coefficient * largest)
            low = -_MOST_EDGE if n == "a" else min(0.0, value)
            yield Parameter(
                f"K{n}e",
                "N/mm",
                value,
                5e3,
                low,
                _MOST_EDGE + largest,
                sd,
                1e-3,
                given="edge_forces",
                said=f"edge force K{n}e",
            )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What such forces lack, and what may be wrong with their sensor."""
        fastest = max((c.cut.rotation for c in self._cuts()), default=100.0)
        own = sensor_causes(self._highest(), fastest, self._resonances())
        return (*_process_causes(self.tool, any(self.edge)), *own)

    def _resonances(self) -> tuple[float, ...]:
        """Return where the dynamics of the dynamometer begin: of each axis what fits best over what was given.

        A resonance with little damping between two orders is found from nowhere but near it: all are tried.
        """
        given = {p.name: p.start for p in self.nuisances}
        cuts = [c for c in self._cuts() if c.cut.depth > 0.0]
        pairs = [(turned(rigid_orders(self.tool, c.cut, c.value.shape[0], given), c), c) for c in cuts]
        ratios, lags = np.geomspace(0.5, 5.0, RULES.resonances), np.array([0.05, 0.2])
        found: list[float] = []
        for axis in range(3):
            left = np.zeros((ratios.size, lags.size))
            for orders, c in pairs:
                r = np.outer(ratios, np.arange(orders.shape[0]) * c.cut.rotation / (2.0 * math.pi * self._highest()))
                flexible = 1.0 - r[:, None] ** 2 + 1j * lags[:, None] * r[:, None]
                error = (orders[:, axis] / flexible - c.value[:, axis]) / c.std[:, axis]
                left += np.sum(np.abs(error) ** 2, axis=2)
            i, k = np.unravel_index(int(left.argmin()), left.shape)
            period = ratios[i] / self._highest()
            found += [float(period**2), float(lags[k] * period)]
        return tuple(found)

    def measured_noise(self, condition: Condition) -> Real | None:
        """Return what records scatter by, and hum, without what real cuts were off by: most cuts are nearer."""
        return condition.data.measured if isinstance(condition.data, CuttingOrders) else None

    def kinds(self, condition: Condition) -> NDArray[np.int64] | None:
        """Return the order of each value: unbalance is in the first alone, unequal teeth in those of no tooth."""
        return condition.data.order_of_values if isinstance(condition.data, CuttingOrders) else None

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the error of a force over the force, rms over rms of all axes, for a whitened misfit.

        In air it is over the largest force of a cut.
        """
        if isinstance(condition.data, KnownForce):
            known = condition.data
            return float(np.sum((known.std * misfit) ** 2)) / float(np.sum(np.square(known.force)))
        found = condition.data
        assert isinstance(found, CuttingOrders)
        cuts = [found] if found.cut.depth > 0.0 else [c for c in self._cuts() if c.cut.depth > 0.0]
        return found.squared_force(misfit) / max(float(np.sum(c.rms**2)) for c in cuts)

    def _cuts(self) -> list[CuttingOrders]:
        return [c.data for c in self.conditions if isinstance(c.data, CuttingOrders)]

    def _highest(self) -> float:
        """Highest frequency of an order [Hz]."""
        return max((c.cut.rotation / (2.0 * math.pi) * (c.value.shape[0] - 1) for c in self._cuts()), default=1000.0)

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return what a set of values predicts, whitened like the data."""
        if isinstance(condition.data, KnownForce):
            known = np.array([condition.data.force], dtype=complex)
            return np.asarray(through_sensor(known, 0.0, values)[0].real / condition.data.std)
        found = condition.data
        assert isinstance(found, CuttingOrders)
        orders = self.orders(found, values)
        return found.whitened(orders if condition.observed is None else turned(orders, found))

    def orders(self, found: CuttingOrders, values: Values) -> Complex:
        """Return the orders of a cut that a set of values predicts [N], shape (orders, 3), at any spindle angle."""
        orders = rigid_orders(self.tool, found.cut, found.value.shape[0], values)
        return through_sensor(orders, found.cut.rotation, values)


def cutting_family(
    records: Mapping[str, tuple[xr.Dataset, SteadyCut]],
    tool: Tool,
    coefficients: tuple[float, float, float],
    proposals: Mapping[str, SteadyCut | KnownForce] | None = None,
    known_forces: Mapping[str, tuple[Sequence[float], KnownForce]] | None = None,
    floor: float = RULES.force_floor,
    leak: float = RULES.leak,
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tolerances: Tolerances | None = None,
    missing: Sequence[str] = (),
    stated: bool = False,
) -> CuttingForces:
    """Build the family of a campaign of steady cuts; `InputError` without a cut, or for a record that holds none.

    Parameters
    ----------
    records : mapping
        Name -> forces along x, y, z and the setting of the cut.
    tool : Tool
        Its run-out is that of the baseline.
    coefficients, edge : tuple of float
        Ktc, Krc, Kac [N/m2] and Kte, Kre, Kae [N/m] as given. Edge forces that are all zero are not given.
    proposals : mapping, optional
        Name -> cut or known force that could be measured next.
    known_forces : mapping, optional
        Name -> readings [N] and the force that caused them.
    floor : float, optional
        Share of each order that a model is not expected to reach.
    leak : float, optional
        Share of the alternating force along all axes that it may miss along each.
    tolerances : Tolerances, optional
        How well coefficients and sensor are known; default those of a workshop.
    missing : sequence of str, optional
        Which of the coefficients nobody gave.
    stated : bool, optional
        Whether the coefficients were given with their uncertainty; else less than it may matter too.
    """
    known = tolerances or Tolerances()
    found, refused = dict[str, CuttingOrders](), list[Suspect]()
    for name, (record, cut) in records.items():
        try:
            found[name] = cutting_orders(record, tool, cut, floor, leak)
        except InputError as why:
            refused.append(warning("no_orders", name, str(why), "left out of the comparison"))
    if not any(c.cut.depth > 0.0 for c in found.values()):
        raise InputError(
            "; ".join(f"{s.where}: {s.evidence}" for s in refused)
            or "no record of a cut was given; a model of cutting forces needs at least one"
        )
    found, suspects = beside_mains(found, known.hum, known.material)
    suspects = (*refused, *suspects)
    conditions = [_condition(name, c, measured=True) for name, c in found.items()]
    # Records are given in the order in which they were made: what changes with it warms up or wears.
    conditions = [replace(c, settings={**c.settings, "order": float(k)}) for k, c in enumerate(conditions)]
    for name, (reading, force) in (known_forces or {}).items():
        observed = np.asarray(reading, dtype=float) / force.std
        conditions.append(Condition(name, {"experiment": "known force"}, observed, "", force))
    first = CuttingForces(
        tool, coefficients, tuple(conditions), (), known, suspects, edge, missing=tuple(missing), stated=stated
    )
    proposed = []
    for name, p in (proposals or {}).items():
        if isinstance(p, KnownForce):
            proposed.append(Condition(name, {"experiment": "known force"}, None, "", p))
        else:
            proposed.append(_condition(name, _expected(first, p, floor, leak), measured=False))
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


def _expected(family: CuttingForces, cut: SteadyCut, floor: float, leak: float) -> CuttingOrders:
    """Orders of a cut that has not been made, as given, with the noise of those that have."""
    noise = np.median([c.std for c in family._cuts()], axis=(0, 1)) if cut.depth == 0.0 else np.zeros(3)
    count = family._cuts()[0].value.shape[0]
    known = dict(zip(("Kte", "Kre", "Kae"), family.edge, strict=True))
    value = rigid_orders(family.tool, cut, count, {**{p.name: p.start for p in family.nuisances}, **known})
    std = np.sqrt(noise**2 + out_of_reach(value, family.tool.teeth, floor, leak) + 1e-12)
    depth_std = RULES.depth / cut.depth if cut.depth > 0.0 else 0.0
    return CuttingOrders(cut, value, std, {}, depth_std)


_MOST_EDGE = 2e5  # N/m


def _process_causes(tool: Tool, edges_given: bool) -> list[Cause]:
    """Causes in tool and work."""
    edge = tuple(
        Parameter(f"K{n}e", "N/mm", 0.0, 5e3, low, _MOST_EDGE, shown=1e-3)
        for n, low in zip("tra", (0.0, 0.0, -_MOST_EDGE), strict=True)
    )
    size = tuple(Parameter(f"size_effect_{n}", "1", 0.0, 0.1, -0.9, 0.9) for n in "tra")
    causes = [
        Cause("force_coefficients", "coefficients that depend on the chip thickness", size, "size_effect"),
        *_runout(tool),
    ]
    if edges_given:
        return causes
    return [Cause("edge_forces", "edge forces", edge, starts=((2e4, 2e4, 0.0),)), *causes]


def _runout(tool: Tool) -> Iterator[Cause]:
    """Teeth that do not run true: the axis of the tool is off, one insert stands out, or each sits as it likes.

    Up to three teeth a tool axis that is off gives every difference of radii. Of equal teeth any may be the first.
    """
    if tool.teeth == 1:
        return
    size = Parameter("runout", "um", 0.0, 5e-6, 0.0, 5e-4, shown=1e6)
    if tool.teeth == 2:  # only their difference counts, and its sign where something else tells them apart
        alike = tool.equal_pitch and tool.equal_radius
        either = size if alike else replace(size, low=-size.high)
        signs = (1.0,) if alike else (1.0, -1.0)
        starts = tuple((s * x,) for s in signs for x in (5e-6, 2e-5))
        yield Cause("runout", "run-out of the tool", (either,), starts=starts)
        return
    turn = 2.0 * math.pi
    angle = Parameter("runout_angle", "deg", 0.5, 0.3, -turn, turn, shown=180.0 / math.pi, secondary=True)
    around = np.linspace(-math.pi, math.pi, 8, endpoint=False)
    yield Cause("runout", "run-out of the tool", (size, angle), starts=tuple((2e-5, float(a)) for a in around))
    if tool.teeth == 3:
        return
    out = Parameter("insert", "um", 0.0, 5e-6, -5e-4, 5e-4, shown=1e6)
    if tool.equal_pitch and tool.equal_radius:
        yield Cause("runout", "one insert that stands out", (out,), "insert", starts=((2e-5,), (-2e-5,)))
    names = [f"radius_{j}" for j in range(2, tool.teeth + 1)]
    each = tuple(Parameter(n, "um", 0.0, 5e-6, -5e-4, 5e-4, shown=1e6) for n in names)
    places = tool.tooth_angles()
    axes = [2e-5 * (np.cos(places + a) - math.cos(a))[1:] for a in around[::2]]
    single = [x * np.eye(tool.teeth - 1)[0] for x in (2e-5, -2e-5)]
    starts = tuple(tuple(s.tolist()) for s in (*axes, *single))
    if tool.teeth <= RULES.most_free_teeth:
        yield Cause("runout", "inserts that do not sit alike", each, "inserts", starts=starts)


def turned(orders: Complex, found: CuttingOrders) -> Complex:
    """Turn a prediction by the spindle angle at the start of the record, which is what fits it best.

    The correlation over all angles is one inverse transform of its orders; Newton's steps refine its maximum.
    """
    product = np.sum(orders.conj() * found.weighted, axis=1)
    product[0] = 0.0
    n = np.arange(orders.shape[0])
    grid = 2.0 * math.pi / RULES.angles
    angle = grid * int(np.fft.irfft(product, RULES.angles).argmax())
    for _ in range(2):
        each = product * np.exp(1j * angle * n)
        bend = float((n * n) @ each.real)
        if bend <= 0.0:
            break
        angle += min(max(-float(n @ each.imag) / bend, -grid), grid)
    return np.asarray(orders * np.exp(-1j * angle * n)[:, None])
