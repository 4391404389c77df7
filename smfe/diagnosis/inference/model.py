"""A family with all its parameters in one scaled vector, its predictions kept.

``u = (value - start)/scale``: zero is the most likely baseline without any cause. Predictions and their slopes are
asked for condition by condition, because a fit that leaves a condition out needs the others only.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Real
from smfe.diagnosis.inference.misfit import Kinds, NoiseKnowledge
from smfe.diagnosis.inference.problem import Cause, Condition, Family, Parameter
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.workers import Answer, Helpers

Index = NDArray[np.int64]
Blocks = Mapping[int, Real]
"""Number of a condition -> an array with one row a value of it."""

Stencil = Sequence[tuple[float, float]]
"""Steps of a difference and what they are multiplied with."""


class Model:
    """Predictions of a family, as functions of one vector of scaled parameters.

    `conditions` are all that may be asked for: measured, held out and proposed. `helpers` predict where it takes long.
    Of declared parameters (`Parameter.given`) the priors of some are `released` (names), made too wide to matter, and
    some are `fixed` (ids) at what was declared.
    """

    def __init__(
        self,
        family: Family,
        conditions: Sequence[Condition],
        helpers: Helpers | None = None,
        released: Collection[str] = (),
        fixed: Collection[str] = (),
    ) -> None:
        self.family = family
        self.helpers = Helpers(1) if helpers is None else helpers
        self.conditions = tuple(conditions)
        self.causes: tuple[Cause, ...] = tuple(family.causes)
        parameters = [*family.nuisances, *(p for cause in self.causes for p in cause.parameters)]
        self.parameters: tuple[Parameter, ...] = tuple(parameters)
        self.names = tuple(p.name for p in parameters)
        _refuse_duplicates("parameter", self.names)
        _refuse_duplicates("cause", [c.key for c in self.causes])
        _refuse_duplicates("condition", [c.name for c in self.conditions if c.observed is not None])
        self.start = np.array([p.start for p in parameters], dtype=float)
        self.scale = np.array([p.scale for p in parameters], dtype=float)
        self.low = (np.array([p.low for p in parameters], dtype=float) - self.start) / self.scale
        self.high = (np.array([p.high for p in parameters], dtype=float) - self.start) / self.scale
        self.weight = self.scale / np.array([p.prior for p in parameters], dtype=float)
        self.weight[[p.name in released for p in parameters]] *= RULES.released
        kept = [j for j, p in enumerate(family.nuisances) if not (p.given and p.given in fixed)]
        self.nuisance: Index = np.array(kept, dtype=np.int64)
        ends = np.cumsum([len(family.nuisances), *(len(c.parameters) for c in self.causes)])
        self.of_cause = tuple(np.arange(a, b) for a, b in pairwise(ends.tolist()))
        self.trouble = ""
        self._roughness = family.roughness
        self._step = np.full(len(parameters), RULES.slope_step)
        self._exact: set[int] = set()  # parameters whose slopes have a closed form
        self._kept: OrderedDict[tuple[int, bytes], Answer] = OrderedDict()
        self._stored = 0
        self._slopes_kept: dict[tuple[int, bytes], dict[int, Real]] = {}  # in closed form, by parameter
        self._slopes_stored = 0
        self._spent, self._asked = 0.0, 0

    @property
    def roughness(self) -> float:
        """Distance of predictions from a smooth function of the parameters (`Abilities.roughness`)."""
        return self._roughness

    def slope_steps(self, free: Index) -> Real:
        """Return half of the steps of slopes with some parameters, in scales; of closed forms infinite."""
        return np.array([math.inf if int(j) in self._exact else self._step[j] for j in free])

    def free(self, causes: Sequence[int]) -> Index:
        """Indices of the parameters that a hypothesis fits: the nuisances first, then its causes in their order."""
        return np.concatenate([self.nuisance, *(self.of_cause[k] for k in sorted(causes))]).astype(np.int64)

    @property
    def noise_knowledge(self) -> NoiseKnowledge:
        """How well the noise of the data is known: by the family, and by what it was measured with."""
        own = {row: self.family.condition_degrees_of_freedom(c) for row, c in enumerate(self.conditions)}
        return NoiseKnowledge(self.family.noise_degrees_of_freedom, own)

    @cached_property
    def kinds(self) -> Kinds:
        """Kinds of the values of those conditions that have several."""
        each = ((row, self.family.kinds(c)) for row, c in enumerate(self.conditions) if c.observed is not None)
        return {row: k for row, k in each if k is not None}

    def null(self) -> Real:
        """Return the baseline at its most likely nuisances."""
        return np.zeros(len(self.parameters))

    def values(self, u: Real) -> dict[str, float]:
        """Parameter name -> value (SI)."""
        return dict(zip(self.names, (self.start + self.scale * u).tolist(), strict=True))

    def scaled(self, values: Mapping[str, float]) -> Real:
        """Return scaled parameters of some values (SI), all others at their start."""
        u = self.null()
        for j, name in enumerate(self.names):
            if name in values:
                u[j] = np.clip((values[name] - self.start[j]) / self.scale[j], self.low[j], self.high[j])
        return u

    def predict(self, row: int, u: Real) -> Real | None:
        """Return the prediction of a condition, shape (n,); None where the family cannot give one (see `trouble`)."""
        key = (row, u.tobytes())
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._keep(key, self._ask(row, u))
        found, why = self._kept[key]
        self.trouble = why or self.trouble
        return found

    def prepare(self, wanted: Sequence[tuple[int, Real]]) -> None:
        """Predict several conditions side by side, to have them at hand, where a prediction takes long."""
        if self.helpers.count == 1 or self._spent < max(RULES.worth_a_start, RULES.worth_help * self._asked):
            return
        new = {(row, u.tobytes()): (row, u) for row, u in wanted if (row, u.tobytes()) not in self._kept}
        if len(new) > 1:
            for key, answer in zip(new, self.helpers.answers(self._ask, list(new.values())), strict=True):
                self._keep(key, answer)

    def _keep(self, key: tuple[int, bytes], answer: Answer) -> None:
        self._kept[key] = answer
        self._stored += _numbers(answer)
        while self._stored > RULES.kept_values and len(self._kept) > 1:
            self._stored -= _numbers(self._kept.popitem(last=False)[1])

    def _ask(self, row: int, u: Real) -> Answer:
        condition = self.conditions[row]
        begin = perf_counter()
        try:
            given = self.family.predict(condition, self.values(u))
        except InputError as problem:
            return None, f"{condition.name}: {problem}"
        self._spent, self._asked = self._spent + perf_counter() - begin, self._asked + 1
        found = np.asarray(given, dtype=float)
        wanted = found.shape if condition.observed is None else condition.observed.shape
        if found.ndim != 1 or found.shape != wanted:
            raise InputError(
                f"{condition.name}: predicted {found.shape} values for {wanted} observed; "
                "a family must predict a condition in the form of its data"
            )
        if not np.all(np.isfinite(found)):
            return None, f"{condition.name}: a predicted value is not finite"
        return found, ""

    def slopes(self, rows: Sequence[int], u: Real, free: Index, rough: bool = False) -> dict[int, Real] | None:
        """Return the derivatives of each condition with the scaled parameters `free`: central differences, (n, p).

        On a bound the difference is one-sided and of second order; rough ones are one-sided and of first order
        everywhere, for half of the predictions. None where the family predicts neither way.

        Where the family says that its predictions are rough, the steps of parameters that do little are longer: hits
        that break a guideway away depend on them as on a fine saw besides. A family that knows its derivatives in
        closed form gives those.
        """
        closed = self._closed_slopes(rows, u, free)
        if closed is not None:
            return closed
        exact = {int(j): self._closed_form(rows, u, int(j)) for j in free}
        self._exact |= {j for j, c in exact.items() if c is not None}
        by_steps = [int(j) for j in free if exact[int(j)] is None]
        self.prepare([(row, at) for j in by_steps for at in self._beside(u, j, rough) for row in rows])
        columns = [self._slope(rows, u, j, rough) if (c := exact[j]) is None else c for j in map(int, free)]
        again = [n for n, c in enumerate(columns) if int(free[n]) in by_steps and c and self._unfit(int(free[n]), c)]
        if again:
            self.prepare([(row, at) for n in again for at in self._beside(u, int(free[n]), rough) for row in rows])
            for n in again:
                columns[n] = self._slope(rows, u, int(free[n]), rough)
        if any(c is None for c in columns):
            return None
        return {
            row: np.stack([c[row] for c in columns if c is not None], axis=1)
            if columns
            else np.zeros((self.size(row, u), 0))
            for row in rows
        }

    def _closed_slopes(self, rows: Sequence[int], u: Real, free: Index) -> dict[int, Real] | None:
        """Return the slopes that the family knows in closed form, those that were asked for before not once more."""
        at, parameters = u.tobytes(), [int(j) for j in free]
        lacking: dict[tuple[int, ...], list[int]] = {}
        for r in rows:
            known = self._slopes_kept.get((r, at), {})
            lacking.setdefault(tuple(j for j in parameters if j not in known), []).append(r)
        for wanted, of in lacking.items():
            if not wanted and parameters:
                continue
            given = [self.parameters[j] for j in wanted]
            closed = self.family.slopes([self.conditions[r] for r in of], self.values(u), given)
            if closed is None:
                return None
            for r, slope in zip(of, closed, strict=True):
                self._slopes_kept.setdefault((r, at), {}).update(zip(wanted, slope.T, strict=True))
                self._slopes_stored += slope.size
        found = {
            r: np.stack([self._slopes_kept[r, at][j] for j in parameters], axis=1)
            if parameters
            else np.zeros((self.size(r, u), 0))
            for r in rows
        }
        while self._slopes_stored > RULES.kept_slopes and len(self._slopes_kept) > 1:
            oldest = self._slopes_kept.pop(next(iter(self._slopes_kept)))
            self._slopes_stored -= sum(x.size for x in oldest.values())
        return found

    def _closed_form(self, rows: Sequence[int], u: Real, j: int) -> dict[int, Real] | None:
        """Return the slopes with a parameter that follow from the predictions themselves."""
        found: dict[int, Real] = {}
        for row in rows:
            known = self._kept.get((row, u.tobytes()), (None, ""))[0]
            if known is None:
                return None
            slope = self.family.closed_form(self.conditions[row], self.values(u), known, self.names[j])
            if slope is None:
                return None
            found[row] = slope * self.scale[j]
        return found

    def _unfit(self, j: int, column: Mapping[int, Real]) -> bool:
        """Set the step of a parameter by what it does; say whether it was taken much too short or too long."""
        does, before = math.sqrt(sum(float(x @ x) for x in column.values())), self._step[j]
        if self._roughness == 0.0 or does == 0.0:
            return False
        self._step[j] = np.clip(
            RULES.above_roughness * self._roughness / does, RULES.slope_step, RULES.largest_slope_step
        )
        return bool(max(self._step[j] / before, before / self._step[j]) > 3.0)

    def size(self, row: int, u: Real) -> int:
        """Return how many values a condition has."""
        found = self.predict(row, u)
        return 0 if found is None else int(found.size)

    def _beside(self, u: Real, j: int, rough: bool) -> list[Real]:
        """Return the values at which the difference that is tried first is taken."""
        unit = np.eye(u.size)[j]
        return [u + step * unit for stencil in self._stencils(u, j, rough)[:1] for step, _ in stencil]

    def _slope(self, rows: Sequence[int], u: Real, j: int, rough: bool) -> dict[int, Real] | None:
        for stencil in self._stencils(u, j, rough):
            found = self._difference(rows, u, j, stencil)
            if found is not None:
                return found
        return None

    def _stencils(self, u: Real, j: int, rough: bool) -> list[Stencil]:
        """Return the differences that the bounds leave room for, the best first."""
        room, h = (self.low[j] - u[j], self.high[j] - u[j]), float(self._step[j])
        central = ((-h, -0.5 / h), (h, 0.5 / h))
        forward, backward = (
            tuple((s * step, s * c / h) for step, c in ((0.0, -1.5), (h, 2.0), (2.0 * h, -0.5))) for s in (1.0, -1.0)
        )
        onward, back = (((0.0, -s / h), (s * h, s / h)) for s in (1.0, -1.0))
        wanted: tuple[Stencil, ...] = (onward, back) if rough else (central, forward, backward)
        return [stencil for stencil in wanted if all(room[0] <= step <= room[1] for step, _ in stencil)]

    def _difference(self, rows: Sequence[int], u: Real, j: int, stencil: Stencil) -> dict[int, Real] | None:
        total: dict[int, Real] = {}
        for step, coefficient in stencil:
            at = u.copy()
            at[j] += step
            for row in rows:
                found = self.predict(row, at)
                if found is None:
                    return None
                total[row] = total[row] + coefficient * found if row in total else coefficient * found
        return total


def _numbers(answer: Answer) -> int:
    return 1 if answer[0] is None else answer[0].size


def _refuse_duplicates(what: str, names: Sequence[str]) -> None:
    twice = sorted({n for n in names if list(names).count(n) > 1})
    if twice:
        raise InputError(f"two of the family have the same {what} name {twice[0]!r}; give each its own")
