"""What a feed axis says of the limits that cutting tests bracket: its compliance at the feed of each cut.

The axis is linearised for small vibration about the feed of the cut, ``feed_per_tooth teeth n``, under its controller;
all other directions are rigid. What is compared is that of `smfe.diagnosis.cutting.limits`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from process.cut.engagement import AnyEngagement
from process.cut.force import NO_DAMPING, CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.operating_point import OperatingPoint
from process.types import Real
from smfe.diagnosis.cutting.limits import KnownLimit, Limit, corrected, material_nuisances, material_of
from smfe.diagnosis.frf.axis_baseline import AxisBaseline, Effective
from smfe.diagnosis.frf.noise import kept
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Condition, Parameter, Values
from stability.methods.semi_discretization import limit_depth
from stability.methods.zero_order_scan import crossings, loop_of

_LOWEST, _REACH = 2.0, 4.0
"""Band in which chatter is looked for: from [Hz], and to, over the frequency of the held axis."""

_STEP = 0.5
"""Step of its scan [Hz]."""


@dataclass(frozen=True)
class CutAtAxis:
    """A limit, where it was cut."""

    known: KnownLimit
    arc: AnyEngagement
    controller: str

    @property
    def limit(self) -> Limit:
        """The limit as it was found."""
        return self.known.limit


@dataclass(frozen=True)
class Cuts:
    """Limits of one tool in one material, cut along a feed axis."""

    baseline: AxisBaseline  # of the axis
    tool: Tool
    coefficients: CuttingCoefficients  # as given
    stated: bool  # whether their uncertainty was
    _kept: dict[tuple[str, Effective, CuttingCoefficients], tuple[Real, Real]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """What may be wrong with the coefficients."""
        return material_nuisances(self.baseline.tolerances, self.stated)

    def conditions(self, limits: Sequence[tuple[Limit, str]], values: Values) -> tuple[Condition, ...]:
        """Return limits with the controllers they were cut under as conditions; `values` are those of the baseline."""
        found = []
        for limit, controller in limits:
            assert limit.arc is not None
            plain = CutAtAxis(KnownLimit(limit, 1.0, 1.0), limit.arc, controller)
            point = self._point(limit, controller, self._effective(limit, values))
            known = plain.known
            if point.unstable_poles() == 0:
                cut = self.tool, limit.arc, material_of(self.coefficients, values), limit.spindle_speed
                known = corrected(limit, self.crossings(plain, values), partial(limit_depth, point, *cut))
            data = replace(plain, known=known)
            found.append(Condition(limit.words, {"evidence": "limits"}, known.measured(), "", data))
        return tuple(found)

    def _feed(self, limit: Limit) -> float:
        return limit.feed_per_tooth * self.tool.teeth * limit.spindle_speed / 60.0

    def _effective(self, limit: Limit, values: Values) -> Effective:
        return self.baseline.effective(values, {}, self._feed(limit))

    def _point(self, limit: Limit, controller: str, found: Effective) -> OperatingPoint:
        return self.baseline.machine(found).at({self.baseline.axis: self._feed(limit)}, controller)

    def crossings(self, cut: CutAtAxis, values: Values) -> tuple[Real, Real]:
        """Return zero-order depths [m], the shallowest first, and chatter frequencies [Hz].

        Raises InputError where the axis vibrates without any cut, or at no depth.
        """
        found, material = self._effective(cut.limit, values), material_of(self.coefficients, values)

        def made() -> tuple[Real, Real]:
            point = self._point(cut.limit, cut.controller, found)
            if point.unstable_poles() > 0:
                return np.zeros(1), np.zeros(1)
            loop = loop_of(self.tool, cut.arc, material, cut.limit.spindle_speed, NO_DAMPING)
            scan = np.arange(_LOWEST, _REACH * self.baseline.drive.locked_frequency, _STEP)
            return crossings(point.matrix, scan, loop)

        depth, frequency = kept(self._kept, (cut.limit.words, found, material), made, RULES.predictions_kept)
        if not depth.size or depth[0] == 0.0:
            how = "vibrates without any cut" if depth.size else "does not chatter at any depth"
            raise InputError(
                f"{cut.limit.words}: the axis of these values {how}; check gains, friction and coefficients"
            )
        return depth, frequency

    def depth(self, cut: CutAtAxis, values: Values) -> float:
        """Return the limit depth [m]; not a number where the axis vibrates without any cut, or at no depth."""
        try:
            return float(self.crossings(cut, values)[0][0]) * cut.known.depth_ratio
        except InputError:
            return math.nan

    def predict(self, cut: CutAtAxis, values: Values) -> Real:
        """Return log depth and chatter frequency, whitened like the data."""
        return cut.known.predicted(*self.crossings(cut, values))
