"""Fits, linearisations and held-out predictions of hypotheses (sets of causes), each made once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from process.types import Real
from smfe.diagnosis.inference.cross_validation import Gain, HeldOut, Scheme, compare, held_out, usable, within
from smfe.diagnosis.inference.fit import (
    Fit,
    Target,
    approach,
    fit,
    misfit,
    nearest,
    part,
    residuals,
    roughly,
    tolerance,
)
from smfe.diagnosis.inference.misfit import Misfit, assess
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Signature, Tangent, tangent
from smfe.diagnosis.inference.thresholds import combined_gain, threshold
from smfe.diagnosis.judgement.declared import as_known
from smfe.diagnosis.judgement.materiality import EVERYTHING, Worth
from smfe.progress import Progress


@dataclass
class Bench:
    """All hypotheses about one set of data."""

    model: Model  # what predicts
    target: Target  # the data
    seed: int  # of all draws
    progress: Progress  # called with what is being fitted
    unconverged: dict[str, str] = field(default_factory=dict)  # hypothesis -> why its fit is not used
    known: Mapping[tuple[int, ...], Fit] = field(default_factory=dict)
    """Hypothesis -> its fit to nearly the same data, to start from."""
    fits: dict[tuple[int, ...], Fit] = field(default_factory=dict)  # hypothesis -> its best fit so far
    worth: Worth = EVERYTHING  # what is large enough to matter
    planned: int = 0  # hypotheses that will be fitted, as far as that is known
    _tangents: dict[tuple[int, ...], Tangent] = field(default_factory=dict)
    _thresholds: dict[tuple[int, ...], float] = field(default_factory=dict)
    _left: dict[tuple[int, ...], float] = field(default_factory=dict)
    _held_out: dict[tuple[tuple[int, ...], tuple[Scheme, ...]], HeldOut] = field(default_factory=dict)
    _reduced: set[tuple[int, tuple[int, ...], bytes]] = field(default_factory=set)
    """What was dropped, and from which fit: a smaller fit from the same start finds the same."""

    @property
    def values(self) -> float:
        """Number of the values that are fitted: the misfit of noise."""
        return float(sum(y.size for y in self.target.observed.values()))

    def rng(self, *purpose: int) -> np.random.Generator:
        """Return a generator that depends on the seed and the purpose only."""
        return np.random.default_rng([self.seed, *purpose])

    def title(self, causes: Sequence[int]) -> str:
        """Return the keys of a hypothesis."""
        return " + ".join(self.model.causes[k].key for k in causes) or "baseline"

    def words(self, causes: Sequence[int]) -> str:
        """Return a hypothesis in words."""
        return " and ".join(self.model.causes[k].title for k in causes) or "the simulation as it is"

    # --- Fits of a hypothesis.

    def null(self, most: float = np.inf) -> Fit:
        """Fit the baseline: from its most likely nuisances and, where that does not converge, from others.

        One that will not come below `most`, the largest misfit that would matter, is not followed to its optimum.
        """
        if () not in self.fits:
            near = self.known.get(())
            start, slope = (self._first(), None) if near is None else (near.u, near.slope)
            found = fit(self.model, self.target, (), start, slope, most)
            rng, mine = self.rng(0), self.model.nuisance
            width = np.minimum(1.0 / np.maximum(self.model.weight, 1.0), 1.0)
            for _ in range(4):
                if found.converged:
                    break
                start = self.model.null()
                start[mine] += width[mine] * rng.standard_normal(mine.size)
                again = fit(self.model, self.target, (), start)
                found = again if again.converged or again.chi2 < found.chi2 else found
            self.keep(found)
        return self.fits[()]

    def _first(self) -> Real:
        """Return where the first fit of the baseline begins."""
        family = self.model.family
        return self.model.scaled(family.begin) if family.begun else roughly(self.model, self.target)

    def extend(self, at: Fit, added: Sequence[int], most: float = np.inf) -> Fit:
        """Fit a hypothesis that has causes more, from all its starts; the best that converged.

        One that will not come below `most`, the largest misfit that would matter, is not followed to its optimum.
        """
        causes = tuple(sorted({*at.causes, *added}))
        if causes in self.fits:
            return self.fits[causes]
        self.progress(f"diagnosis: trying {self.words(added)}", len(self.fits), max(self.planned, len(self.fits) + 1))
        if causes in self.known:
            again = self._follow(causes, self.known[causes].u, self.known[causes].slope, most)
            if again.converged:
                return self.keep(again)
        found = nearest(self.model, self.target, self._extended(at, causes, added, most), added)
        # What creeps along a curved valley, as of a joint's elements, has explained what it will: the rest of the way
        # widens its intervals.
        if not found.converged and 0.0 < found.promised < RULES.crept * (at.chi2 - found.chi2):
            found = replace(found, converged=True, reason="")
        return self.keep(found)

    def known_misfit(self, at: Fit, k: int) -> float:
        """Return what a fit with a cause more left of nearly the same data; infinite where there was none."""
        known = self.known.get(tuple(sorted({*at.causes, k})))
        return known.chi2 if known is not None and known.converged else float("inf")

    def glimpsed(self, at: Fit, k: int) -> float:
        """Return the misfit that a fit with a cause more comes to with slopes of the smaller one."""
        causes = tuple(sorted({*at.causes, k}))
        near = [self._approached(at, causes, shapes) for shapes in self._shapes(at, (k,))]
        return min((f.chi2 for f in near if f is not None), default=at.chi2)

    def reduce(self, at: Fit, dropped: int) -> Fit:
        """Fit a hypothesis that has a cause less, from the nuisances of the larger one as well."""
        causes = tuple(k for k in at.causes if k != dropped)
        if (done := (dropped, at.causes, at.u.tobytes())) in self._reduced and causes in self.fits:
            return self.fits[causes]
        self._reduced.add(done)
        start = at.u.copy()
        start[self.model.of_cause[dropped]] = 0.0
        kept = np.isin(at.free, self.model.free(causes))
        slope = {r: x[:, kept] for r, x in at.slope.items()}
        old = self.fits.get(causes)
        most = old.chi2 if old is not None and old.converged and not old.provisional else np.inf
        return self.keep(fit(self.model, self.target, causes, start, slope, most))

    def pursued(self, found: Fit) -> Fit:
        """Follow a fit that did not end from where it stopped."""
        for _ in range(RULES.pursued):
            if found.converged:
                break
            found = self.keep(fit(self.model, self.target, found.causes, found.u))
        return found

    def refitted(self, near: Fit) -> Fit:
        """Fit a hypothesis once more from where it was fitted with other priors."""
        return self.keep(fit(self.model, self.target, near.causes, near.u))

    def confirmed(self, found: Fit) -> Fit:
        """Fit a hypothesis with its own slopes."""
        return self.keep(fit(self.model, self.target, found.causes, found.u)) if found.provisional else found

    def keep(self, found: Fit) -> Fit:
        """Keep the best fit of a hypothesis: what has converged goes first, then what is better than is known."""
        old = self.fits.get(found.causes)
        better = old is None or old.provisional or (found.converged and not old.converged)
        if old is not None and not better and found.converged == old.converged:
            better = found.chi2 < old.chi2 - (tolerance(self.target, old.chi2) if found.converged else 0.0)
        if better:
            self.fits[found.causes] = found
            self._tangents.pop(found.causes, None)
            self._thresholds.pop(found.causes, None)
            self._left.pop(found.causes, None)
            self._held_out = {key: value for key, value in self._held_out.items() if key[0] != found.causes}
            if found.converged:
                self.unconverged.pop(self.title(found.causes), None)
            else:
                self.unconverged[self.title(found.causes)] = found.reason
        return self.fits[found.causes]

    def _extended(self, at: Fit, causes: tuple[int, ...], added: Sequence[int], most: float) -> Fit:
        """Fit a hypothesis that has causes more, from all its starts."""
        begun = self._begun(at, causes, added, most)
        if begun is not None and (begun.chi2 <= self.explained(at) < at.chi2 or self.leads(at, begun)):
            return begun
        explained = self.explained(at)
        thorough = self.far(added) and self.bad(at) and most > explained
        found = [] if begun is None else [begun]
        for shapes in self._shapes(at, added):
            near = self._near(at, causes, shapes, most)
            found.append(near)
            gain = combined_gain(self.model, self.tangent(at), shapes)
            linear = near.converged and abs(at.chi2 - near.chi2 - gain) < RULES.nonlinear * gain + 1.0
            if linear and not thorough:
                return min(found, key=_order)
            if thorough and at.chi2 - near.chi2 > RULES.enough * (at.chi2 - self.values):
                thorough, most = False, min(most, near.chi2)
                break
            if near.converged and near.chi2 <= explained < at.chi2:
                break
        first = min(found, key=_order, default=None)
        if first is not None and first.converged:
            if not self.far(added):
                return first
            if first.chi2 <= explained < at.chi2:
                # It has explained what there was: others must do better still.
                thorough, most = False, min(most, first.chi2)
        # Slopes from elsewhere lead a far start astray: an exchange of axes is worse than none before all else is
        # fitted anew. What a cause names is followed with its own slopes where something is wrong or it explains much
        # as it stands, the most hopeful of the others where it may matter.
        known = {} if first is None else first.slope
        trials = []
        for u in self._starts(at, causes, added, thorough, most):
            own = thorough or self._misfit(u) < RULES.halfway * at.chi2
            trials.append(self._tried(causes, u, {} if own else known, most))
        trials += [self._tried(causes, u, known, most) for u in self._either_way(at, added, first)]
        best = min(trials, key=lambda f: f.chi2, default=None)
        if best is not None and best.provisional:
            gained, needed = at.chi2 - best.chi2, at.chi2 - most
            hopeful = not best.converged and gained + RULES.optimism * best.promised > needed
            if gained > 0.0 and (hopeful or (most > explained and RULES.part * needed < gained < needed)):
                trials.append(fit(self.model, self.target, causes, best.u, most=most))
        return min([*found, *trials], key=_order)

    def leads(self, at: Fit, found: Fit) -> bool:
        """Whether a fit with a cause that the data were seen to fit with explains most of what is more than noise."""
        seen = any(self.model.causes[k].begin for k in found.causes if k not in at.causes)
        values = self.values
        return seen and at.chi2 - found.chi2 >= RULES.named_share * max(at.chi2 - values, 1.0)

    def _begun(self, at: Fit, causes: tuple[int, ...], added: Sequence[int], most: float) -> Fit | None:
        """Fit from where a cause brings all that competes with it; None where none of them does."""
        known = [self.model.causes[k].begin for k in added if self.model.causes[k].begin]
        if not known:
            return None
        u = self.model.scaled(known[0])
        for k in at.causes:
            u[self.model.of_cause[k]] = at.u[self.model.of_cause[k]]
        return fit(self.model, self.target, causes, u, most=most)

    def _shapes(self, at: Fit, added: Sequence[int]) -> list[tuple[Signature, ...]]:
        """Return the shapes of some causes that do most to first order."""
        here = self.tangent(at)
        shapes = list(product(*([s for s in here.signatures if s.cause == k] for k in added)))
        return sorted(shapes, key=lambda s: -combined_gain(self.model, here, s))[: RULES.shapes]

    def _near(self, at: Fit, causes: tuple[int, ...], signatures: Sequence[Signature], most: float) -> Fit:
        """Fit from a linearisation: its first step is the one of the linearised score."""
        return self._follow(causes, *self._linearised(at, causes, signatures), most)

    def _approached(self, at: Fit, causes: tuple[int, ...], signatures: Sequence[Signature]) -> Fit | None:
        """Fit from a linearisation with its slopes alone."""
        return approach(self.model, self.target, causes, *self._linearised(at, causes, signatures))

    def _linearised(
        self, at: Fit, causes: tuple[int, ...], signatures: Sequence[Signature]
    ) -> tuple[Real, dict[int, Real]]:
        """Return where a linearisation was made, and its slopes."""
        start = at.u.copy()
        for s in signatures:
            start[self.model.of_cause[s.cause]] = s.u[self.model.of_cause[s.cause]]
        slope: dict[int, Real] = {}
        for r, y in self.target.observed.items():
            columns = dict(zip(at.free.tolist(), at.slope[r].T, strict=True))
            for s in signatures:
                columns.update(zip(self.model.of_cause[s.cause].tolist(), s.slope[r].T, strict=True))
            free = self.model.free(causes).tolist()
            slope[r] = np.stack([columns[j] for j in free], axis=1) if free else np.zeros((y.size, 0))
        return start, slope

    def _follow(self, causes: tuple[int, ...], start: Real, slope: Mapping[int, Real], most: float) -> Fit:
        """Fit with given slopes, and with its own where these do not lead to the end and it may come below `most`."""
        near = approach(self.model, self.target, causes, start, slope, most)
        if near is None:
            return fit(self.model, self.target, causes, start, most=most)
        return near if near.converged else fit(self.model, self.target, causes, near.u, near.slope, most)

    def _tried(self, causes: tuple[int, ...], start: Real, slope: Mapping[int, Real], most: float) -> Fit:
        """Fit from a start with slopes from elsewhere, where there are any, as far as it may come below `most`."""
        found = approach(self.model, self.target, causes, start, slope) if slope else None
        return fit(self.model, self.target, causes, start, most=most) if found is None else found

    def _starts(
        self, at: Fit, causes: tuple[int, ...], added: Sequence[int], thorough: bool, most: float = np.inf
    ) -> list[Real]:
        """Return the starts that causes name because they act far from their null, without those that lead astray.

        Of a thorough search the best: with the nuisances of the fit, with those that were declared, and with those that
        another variant of the cause was fitted with. Where the baseline is far off its nuisances have gone astray with
        it, and a fit from there finds another minimum. The parameters of the causes are fitted by themselves first, and
        all to a part of many conditions: what does not come below `most` there comes below it nowhere.
        """
        nuisance = np.isin(np.arange(at.u.size), self.model.nuisance)
        kinds = [at.u, np.where(nuisance, 0.0, at.u)]
        variant = self._variant(at, added) if thorough else None
        if variant is not None:
            kinds.append(np.where(nuisance, variant.u, at.u))
        found: list[tuple[Real, ...]] = []
        for k in added:
            mine = self.model.of_cause[k]
            for given in self.model.causes[k].starts:
                both = tuple(u.copy() for u in kinds)
                for start in both:
                    start[mine] = (np.array(given, dtype=float) - self.model.start[mine]) / self.model.scale[mine]
                found.append(both)
        if not thorough:
            nearer = [min(both, key=self._misfit) for both in found]
            return [u for u in nearer if self._misfit(u) < RULES.astray * at.chi2]
        few = part(self.model, self.target)
        own = np.concatenate([self.model.of_cause[k] for k in added])
        near: list[Real] = []
        for kind in zip(*found, strict=True):
            best = sorted(kind, key=self._misfit)[: RULES.named_starts]
            near.append(min((fit(self.model, few, causes, u, only=own).u for u in best), key=self._misfit))
        # Beside declared nuisances the whole fit is no measure: what is hidden has moved them by what they must first
        # move back. What explains most of what the same nuisances leave without it is no start that is lost.
        most_left = [max(RULES.lost * at.chi2, RULES.halfway * self._misfit(u)) for u in kinds]
        near = [u for u, left in zip(near, most_left, strict=True) if self._misfit(u) < left]
        if few is self.target:
            return near
        warm = [fit(self.model, few, causes, u, most=most, loose=RULES.warm) for u in near]
        hopeful = [u for f, start in zip(warm, near, strict=True) if not f.provisional for u in (f.u, start)]
        return sorted(hopeful, key=self._misfit)[:1]

    def _variant(self, at: Fit, added: Sequence[int]) -> Fit | None:
        """Return the best fit with another variant of a single cause; None where there is none."""
        ids = {self.model.causes[k].id for k in added}
        of = [
            f
            for causes, f in self.fits.items()
            if len(more := set(causes) - set(at.causes)) == len(added) == 1
            and set(at.causes) < set(causes)
            and self.model.causes[next(iter(more))].id in ids
        ]
        return min(of, key=lambda f: f.chi2, default=None)

    def _either_way(self, at: Fit, added: Sequence[int], best: Fit | None) -> list[Real]:
        """Return starts one scale either way, or on the other side of the best."""
        found: list[Real] = []
        for k, sign in product(added, (1.0, -1.0)):
            mine = self.model.of_cause[k]
            start = (at.u if best is None else best.u).copy()
            moved = sign if best is None else -sign * best.u[mine]
            start[mine] = np.clip(moved, self.model.low[mine], self.model.high[mine])
            found.append(start)
        near = [u for u in found if self._misfit(u) < RULES.astray * at.chi2]
        return near if best is None else [u for u in near if not np.array_equal(u, best.u)]

    def _misfit(self, u: Real) -> float:
        return misfit(self.model, self.target, self.model.nuisance, u, residuals(self.model, self.target, u))

    # --- What a fit leaves, and what could be added to it.

    def tangent(self, at: Fit) -> Tangent:
        """Return the linearisation of a fit."""
        if at.causes not in self._tangents:
            self._tangents[at.causes] = tangent(self.model, self.target, at)
            for k in self._tangents[at.causes].silent:
                self.unconverged.setdefault(self.model.causes[k].key, f"no prediction ({self.model.trouble})")
        return self._tangents[at.causes]

    def threshold(self, at: Fit) -> float:
        """Return what noise alone reaches with the best further cause."""
        if at.causes not in self._thresholds:
            self._thresholds[at.causes] = threshold(self.model, self.tangent(at), self.rng(1, len(at.causes)))
        return self._thresholds[at.causes]

    def misfit(self, at: Fit) -> Misfit:
        """Test the residuals of a fit on the data it was fitted to."""
        basis, ends = self.tangent(at).basis, np.cumsum([r.size for r in at.residual.values()])
        parts = np.split(basis[: ends[-1]], ends[:-1])
        groups = [(at.residual, dict(zip(at.residual, parts, strict=True)))]
        return assess(groups, True, self.model.noise_knowledge, self.model.kinds)

    def bad(self, at: Fit) -> bool:
        """Whether a fit leaves more than noise: then a cause is looked for far from its null too."""
        return self.misfit(at).p_value < RULES.band

    def decided(self, at: Fit, ratio: float) -> bool:
        """Whether a likelihood ratio against a fit counts that no condition left out bears out (`Abilities.decisive`).

        Beside what a fit leaves beyond noise a ratio is counted over that; where it leaves much, all counts.
        """
        return self._above(self.model.family.decisive, at, ratio)

    def convicts(self, at: Fit, ratio: float) -> bool:
        """Whether a refused cause convicts a fit by its likelihood ratio alone (`Abilities.convicting`)."""
        return self._above(self.model.family.convicting, at, ratio)

    def _above(self, least: float, at: Fit, ratio: float) -> bool:
        over = max(self.misfit(at).ratio, 1.0)
        return least == 0.0 or over > RULES.much or ratio > least * over

    @property
    def least_gain(self) -> float:
        """Gain [dB] on what was held out that is asked for where a model is known to miss something."""
        return RULES.least_within if self.model.family.decisive > 0.0 else 0.0

    def proves(self, gain: Gain | None) -> bool:
        """Whether a gain on what was held out proves a cause."""
        return gain is not None and gain.proven and gain.db >= self.least_gain

    def matters(self, at: Fit, share: float) -> bool:
        """Whether what a fit leaves may matter: a share of what is material is left of it besides noise."""
        if self.worth.material == 0.0:
            return True
        if at.causes not in self._left:
            self._left[at.causes] = self.worth.left(self.model, at.residual, self.rng(11, len(at.causes)))
        return self._left[at.causes] >= share * self.worth.material

    def named(self, at: Fit) -> bool:
        """Whether the causes of a fit explain so much that they are named beside what they leave."""
        gain = self.gain(self.null(), at) if at.causes else None
        return gain is not None and gain.share >= RULES.named_share

    def as_known(self, at: Fit, k: int) -> bool:
        """Whether a fit has a cause no further from nothing than is known of it."""
        return as_known(self.model, self.target, at, k)

    def far(self, added: Sequence[int]) -> bool:
        """Whether some causes may act far from their null only."""
        return any(self.model.causes[k].starts for k in added)

    def explained(self, at: Fit) -> float:
        """Misfit from which on what a fit leaves counts as explained: what noise hardly exceeds, and a little of it."""
        values = self.values
        return values + 4.0 * float(np.sqrt(2.0 * values)) + RULES.little * max(at.chi2 - values, 0.0)

    def hopeless(self, at: Fit) -> bool:
        """Whether a fit that did not end leaves more than noise even with all that its steps may still bring.

        Where a prediction jumps, as a limit depth does that an island of instability comes below, a fit may stop before
        a jump that it would have to take: how bad the best one is need not be known. One that has no slopes where it
        stopped promises nothing that could be counted. What it promises where it stopped, after damped steps, counts
        three times (`RULES.optimism`), as of a rival, and not ten times, as what first slopes promise.
        """
        return 0.0 < RULES.optimism * at.promised < at.chi2 - self.explained(at)

    def first_order(self, at: Fit, causes: Sequence[int]) -> float:
        """Likelihood ratio of more causes as the linearisation has it: the best over their shapes."""
        here = self.tangent(at)
        shapes = product(*([s for s in here.acting if s.cause == k] for k in causes))
        return max((combined_gain(self.model, here, s) for s in shapes), default=0.0)

    def first_order_size(self, at: Fit, k: int) -> float:
        """Return what one more cause changes by itself [1], as the linearisation has it."""
        model, here = self.model, self.tangent(at)
        best = max((s for s in here.acting if s.cause == k), key=lambda s: combined_gain(model, here, (s,)))
        moved = best.u.copy()
        moved[best.free] += np.linalg.lstsq(best.columns, -here.residual, rcond=RULES.determined)[0]
        measurement = model.causes[k].kind == "measurement"
        return self.worth.of_causes(model, list(at.residual), at.u, np.clip(moved, model.low, model.high), measurement)

    # --- What a fit predicts of conditions that it was not fitted to.

    def usable(self, at: Fit, causes: Sequence[int]) -> tuple[Scheme, ...]:
        """Return the ways to hold conditions out that test some causes of a fit."""
        return tuple(usable(self.model, self.target, at, causes))

    def held_out(self, at: Fit, chosen: tuple[Scheme, ...]) -> HeldOut:
        """Predict held-out conditions."""
        key = (at.causes, chosen)
        if key not in self._held_out:
            done = len(self.fits)
            self.progress("diagnosis: leaving conditions out in turn", done, max(self.planned, done + 1))
            self._held_out[key] = held_out(self.model, self.target, at, chosen)
        return self._held_out[key]

    def gain(self, smaller: Fit, larger: Fit) -> Gain | None:
        """Gain of a larger hypothesis on conditions held out, or on blocks of values where none can be.

        None where there are too few values, or the larger did not converge.
        """
        chosen = self.usable(larger, [k for k in larger.causes if k not in smaller.causes])
        before, after = (
            self.held_out(f, chosen) if chosen else within(self.model, self.target, f) for f in (smaller, larger)
        )
        if before is None or after is None or not after.trusted:
            return None
        found = compare(before, after, self.rng(2, len(larger.causes)))
        return found if chosen else replace(found, held_out="blocks of values")


def _order(found: Fit) -> tuple[bool, float]:
    """What has converged first, then the least misfit."""
    return not found.converged, found.chi2
