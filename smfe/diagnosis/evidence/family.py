"""A feed axis that one set of parameters must explain everywhere: under the hammer, in its drive record, in cuts.

Masses, stiffness, servo and friction are those of `smfe.diagnosis.frf.axis`; every condition is predicted from them by
what it is: a compliance, the drive force of a move, a limit depth. So a cause is named once, from all evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.evidence.cuts import CutAtAxis, Cuts
from smfe.diagnosis.evidence.moves import Moves, Record
from smfe.diagnosis.frf.axis import GIVES_WAY, MachineFrfs
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.problem import Cause, Condition, Parameter, Values

_AT_THE_TIP = ("gain_error", "skew")
"""Parameters of the accelerometer."""


@dataclass(frozen=True)
class AxisEvidence(MachineFrfs):
    """A family for `smfe.diagnosis.judgement.diagnose`: compliances of an axis with its drive records and its cuts."""

    moves: Moves | None = None
    cuts: Cuts | None = None

    @property
    def frfs(self) -> MachineFrfs:
        """The compliances alone."""
        own = tuple(c for c in self.conditions if isinstance(c.data, Excited))
        return MachineFrfs(self.baseline, own, self.proposals, self.without, self.measured, self.discrepancy)

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Parameters of the axis, of its records and of its cuts."""
        of_records = () if self.moves is None else self.moves.nuisances
        of_cuts = () if self.cuts is None else self.cuts.nuisances
        return (*self.baseline.nuisances(), *self.frfs.presliding, *of_records, *of_cuts)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Causes of the axis, and what a record may show besides."""
        of_records = () if self.moves is None else self.moves.causes
        more = (c for c in of_records if c.key not in self.without and c.id not in self.without)
        return (*(self._begun(c) for c in self.frfs.causes), *more)

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return what a set of values predicts of a condition, whitened like its data."""
        if isinstance(condition.data, Excited):
            return super().predict(condition, values)
        if isinstance(condition.data, CutAtAxis):
            assert self.cuts is not None
            return self.cuts.predict(condition.data, values)
        assert self.moves is not None
        assert isinstance(condition.data, Record)
        return self.moves.predict(condition.data, values)

    def closed_form(self, condition: Condition, values: Values, predicted: Real, name: str) -> Real | None:
        """Slopes with what only compliances have: gain and skew of the accelerometer, how hits find a dry guideway."""
        if isinstance(condition.data, Excited):
            return super().closed_form(condition, values, predicted, name)
        return np.zeros_like(predicted) if name in _AT_THE_TIP or name.startswith(GIVES_WAY) else None

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the relative size of a whitened misfit: of what limits the depth, of force, of depth."""
        if isinstance(condition.data, Excited):
            return super().squared_size(condition, misfit)
        if isinstance(condition.data, CutAtAxis):
            return float((misfit[0] * condition.data.known.std()[0]) ** 2)
        assert self.moves is not None
        assert isinstance(condition.data, Record)
        return self.moves.squared_size(condition.data, misfit)

    def condition_degrees_of_freedom(self, condition: Condition) -> float:
        """Degrees of freedom with which the noise of a condition is known."""
        if isinstance(condition.data, Excited):
            return super().condition_degrees_of_freedom(condition)
        if isinstance(condition.data, Record):
            assert self.moves is not None
            return self.moves.degrees_of_freedom
        return float("inf")

    def noises(self, columns: Sequence[tuple[Condition, Real]]) -> Sequence[Real]:
        """Return products of columns for each noise that the drive records could have come from; all else is white."""
        return () if self.moves is None else self.moves.noises(columns)

    def relative(self, condition: Condition, predicted: Real, slopes: Real) -> Complex:
        """Return slopes of a prediction over itself: of a move over the rms of its force, of a limit over its depth."""
        if isinstance(condition.data, Excited):
            return super().relative(condition, predicted, slopes)
        if isinstance(condition.data, CutAtAxis):
            return np.asarray(slopes[:1] * condition.data.known.std()[0], dtype=np.complex128)
        return np.asarray(slopes / max(float(np.sqrt(np.mean(predicted**2))), 1e-300), dtype=np.complex128)

    def alike(self, conditions: Sequence[Condition]) -> list[int]:
        """Return a number for each condition; records and cuts have errors of their own."""
        own = [c for c in conditions if isinstance(c.data, Excited)]
        same = dict(zip([c.name for c in own], super().alike(own), strict=True))
        return [same.get(c.name, len(own) + i) for i, c in enumerate(conditions)]

    def as_found(self, values: Values) -> tuple[Condition, ...]:
        """Return the conditions, compliances as the mean hits on a machine of these values would have found them."""
        others = (c for c in self.conditions if not isinstance(c.data, Excited))
        return (*self.frfs.as_found(values), *others)


def with_evidence(
    family: MachineFrfs, moves: Moves | None, cuts: Cuts | None, further: Sequence[Condition]
) -> AxisEvidence:
    """Return the compliances of an axis with further conditions: its drive records, the limits of its cuts.

    Where the records show that the guideway slides with dry friction, the mean hits are those of such an axis.
    """
    conditions = (*family.conditions, *further)
    parts = family.baseline, conditions, family.proposals, family.without, family.measured, family.discrepancy
    sliding = {} if moves is None else moves.sliding()
    whole = AxisEvidence(*parts, moves=moves, cuts=cuts, sliding=sliding or family.sliding)
    if "stribeck_coulomb" not in {p.name for c in whole.causes for p in c.parameters} or not sliding:
        return whole
    start = {p.name: p.start for p in (*whole.nuisances, *(p for c in whole.causes for p in c.parameters))}
    return replace(whole, conditions=whole.as_found(start | sliding))
