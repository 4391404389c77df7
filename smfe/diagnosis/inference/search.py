"""Which causes the data ask for: likelihood ratios with everything re-fitted, forward, in pairs and backward.

``LR = chi2(without) - chi2(with)``, the nuisances re-fitted non-linearly under every hypothesis. The best cause above
the calibrated threshold that also gains on held-out conditions is taken in, then all are fitted anew and those that
have become idle are dropped. Where no single cause passes, the pairs that do most to first order are tried: effects
mask each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

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
    residuals,
    roughly,
    tolerance,
)
from smfe.diagnosis.inference.misfit import Misfit, assess
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Signature, Tangent, inside, tangent
from smfe.diagnosis.inference.thresholds import (
    combined_gain,
    pair_threshold,
    parameters_of,
    products_of_noise,
    threshold,
    upper,
)
from smfe.progress import Progress


@dataclass(frozen=True)
class Step:
    """One step of the search."""

    causes: tuple[int, ...]  # causes in the model after it
    change: str  # what was added or dropped, by key
    ratio: float  # likelihood ratio of the change
    threshold: float  # what noise reaches
    gain: Gain | None  # on held-out conditions; None where nothing could be held out
    chi2: float  # misfit after it
    accepted: bool  # whether it was kept
    reason: str = ""  # why not


@dataclass
class Bench:
    """Fits, linearisations and held-out predictions of all hypotheses, each made once."""

    model: Model  # what predicts
    target: Target  # the data
    seed: int  # of all draws
    progress: Progress  # called with what is being fitted
    unconverged: dict[str, str] = field(default_factory=dict)  # hypothesis -> why its fit is not used
    known: Mapping[tuple[int, ...], Fit] = field(default_factory=dict)
    """Hypothesis -> its fit to nearly the same data, to start from."""
    _fits: dict[tuple[int, ...], Fit] = field(default_factory=dict)
    _tangents: dict[tuple[int, ...], Tangent] = field(default_factory=dict)
    _thresholds: dict[tuple[int, ...], float] = field(default_factory=dict)
    _held_out: dict[tuple[tuple[int, ...], tuple[Scheme, ...]], HeldOut] = field(default_factory=dict)

    def rng(self, *purpose: int) -> np.random.Generator:
        """Return a generator that depends on the seed and the purpose only."""
        return np.random.default_rng([self.seed, *purpose])

    def null(self) -> Fit:
        """Fit the baseline: from its most likely nuisances and, where that does not converge, from others."""
        if () not in self._fits:
            near = self.known.get(())
            start, slope = (roughly(self.model, self.target), None) if near is None else (near.u, near.slope)
            found = fit(self.model, self.target, (), start, slope)
            rng, mine = self.rng(0), self.model.nuisance
            width = np.minimum(1.0 / np.maximum(self.model.weight, 1.0), 1.0)
            for _ in range(4):
                if found.converged:
                    break
                start = self.model.null()
                start[mine] += width[mine] * rng.standard_normal(mine.size)
                again = fit(self.model, self.target, (), start)
                found = again if again.converged or again.chi2 < found.chi2 else found
            self._keep(found)
        return self._fits[()]

    def _keep(self, found: Fit) -> Fit:
        """Keep the best fit of a hypothesis; what has converged goes before what has not."""
        old = self._fits.get(found.causes)
        if old is None or old.provisional or _better(self.target, found, old):
            self._fits[found.causes] = found
            self._tangents.pop(found.causes, None)
            self._thresholds.pop(found.causes, None)
            self._held_out = {key: value for key, value in self._held_out.items() if key[0] != found.causes}
            name = self.title(found.causes)
            if found.converged:
                self.unconverged.pop(name, None)
            else:
                self.unconverged[name] = found.reason
        return self._fits[found.causes]

    @property
    def fits(self) -> Mapping[tuple[int, ...], Fit]:
        """Every hypothesis fitted so far, and its best fit."""
        return self._fits

    def fitted(self, causes: tuple[int, ...]) -> Fit:
        """Return the best fit so far of a hypothesis."""
        return self._fits[causes]

    def title(self, causes: Sequence[int]) -> str:
        """Return the keys of a hypothesis."""
        return " + ".join(self.model.causes[k].key for k in causes) or "baseline"

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

    def changing(self, at: Fit) -> Change | None:
        """Return the parameter of a fit that differs most between its conditions."""
        return most_changing(self.model, self.tangent(at), self.rng(7, len(at.causes)))

    def extend(self, at: Fit, added: Sequence[int], most: float = np.inf) -> Fit:
        """Fit a hypothesis that has causes more, from all its starts; the best that converged.

        One that will not come below `most`, the largest misfit that would matter, is not followed to its optimum.
        """
        causes = tuple(sorted({*at.causes, *added}))
        if causes in self._fits:
            return self._fits[causes]
        self.progress(f"fitting {self.title(causes)}", len(self._fits), len(self._fits) + 1)
        if causes in self.known:
            again = self._follow(causes, self.known[causes].u, self.known[causes].slope, most)
            if again.converged:
                return self._keep(again)
        return self._keep(nearest(self.model, self.target, self._extended(at, causes, added, most), added))

    def _extended(self, at: Fit, causes: tuple[int, ...], added: Sequence[int], most: float) -> Fit:
        """Fit a hypothesis that has causes more, from all its starts."""
        at_ = self.tangent(at)
        combinations_ = _products([[s for s in at_.signatures if s.cause == k] for k in added])
        gains = [combined_gain(self.model, at_, c) for c in combinations_]
        order = sorted(range(len(gains)), key=lambda n: -gains[n])[: RULES.shapes]
        thorough = self.far(added) and self.bad(at) and most > self.explained(at)
        found: list[Fit] = []
        for n in order:
            near = self._near(at, causes, combinations_[n], most)
            linear = near.converged and abs(at.chi2 - near.chi2 - gains[n]) < RULES.nonlinear * gains[n] + 1.0
            if linear and not thorough:
                return min([*found, near], key=lambda f: (not f.converged, f.chi2))
            found.append(near)
            if self._explains(at, near):
                break
        first = min(found, key=lambda f: (not f.converged, f.chi2), default=None)
        if first is not None and first.converged and not self.far(added):
            return first
        known = {} if first is None else first.slope
        if first is not None and self._explains(at, first):
            # It has explained what there was: others must do better still.
            thorough, most = False, min(most, first.chi2)
        # Slopes from elsewhere lead a far start astray: an exchange of axes is worse than none before all else is
        # fitted anew. What a cause names is followed with its own slopes where something is wrong or it explains much
        # as it stands, the most hopeful of the others where it may matter.
        trials = self._from_starts(at, causes, added, known, thorough)
        trials += [self._tried(causes, u, known) for u in self._either_way(at, added, first)]
        best = min(trials, key=lambda f: f.chi2, default=None)
        if best is not None and best.provisional and self._worth_following(at, best, most):
            trials.append(fit(self.model, self.target, causes, best.u))
        return min([*found, *trials], key=lambda f: (not f.converged, f.chi2))

    def _worth_following(self, at: Fit, found: Fit, most: float) -> bool:
        """Whether a fit that has not come below `most` has gone a part of the way, or may get there."""
        gained, needed = at.chi2 - found.chi2, at.chi2 - most
        hopeful = not found.converged and gained + RULES.optimism * found.promised > needed
        return gained > 0.0 and (hopeful or (most > self.explained(at) and RULES.part * needed < gained < needed))

    def _explains(self, at: Fit, found: Fit) -> bool:
        """Whether a fit explains what another leaves."""
        return found.converged and found.chi2 <= self.explained(at) < at.chi2

    def far(self, added: Sequence[int]) -> bool:
        """Whether some causes may act far from their null only."""
        return any(self.model.causes[k].starts for k in added)

    def bad(self, at: Fit) -> bool:
        """Whether a fit leaves more than noise: then a cause is looked for far from its null too."""
        return fitted_misfit(self, at).p_value < RULES.band

    def explained(self, at: Fit) -> float:
        """Misfit from which on what a fit leaves counts as explained: what noise hardly exceeds, and a little of it."""
        values = float(sum(y.size for y in self.target.observed.values()))
        return values + 4.0 * float(np.sqrt(2.0 * values)) + RULES.little * max(at.chi2 - values, 0.0)

    def first_order(self, at: Fit, k: int) -> float:
        """Likelihood ratio of one more cause as the linearisation has it."""
        here = self.tangent(at)
        return max((combined_gain(self.model, here, [s]) for s in here.signatures if s.cause == k), default=0.0)

    def confirmed(self, found: Fit) -> Fit:
        """Fit a hypothesis with its own slopes."""
        if not found.provisional:
            return found
        return self._keep(fit(self.model, self.target, found.causes, found.u))

    def _near(self, at: Fit, causes: tuple[int, ...], signatures: Sequence[Signature], most: float) -> Fit:
        """Fit from a linearisation: its first step is the one of the linearised score."""
        start = at.u.copy()
        known = dict(zip(at.free.tolist(), range(at.free.size), strict=True))
        for s in signatures:
            start[self.model.of_cause[s.cause]] = s.u[self.model.of_cause[s.cause]]
        slope: dict[int, Real] = {}
        for r in self.target.observed:
            columns = []
            for j in self.model.free(causes):
                if int(j) in known:
                    columns.append(at.slope[r][:, known[int(j)]])
                else:
                    s = next(x for x in signatures if j in self.model.of_cause[x.cause])
                    columns.append(s.slope[r][:, int(j) - int(self.model.of_cause[s.cause][0])])
            slope[r] = np.stack(columns, axis=1) if columns else np.zeros((self.target.observed[r].size, 0))
        return self._follow(causes, start, slope, most)

    def _follow(self, causes: tuple[int, ...], start: Real, slope: Mapping[int, Real], most: float) -> Fit:
        """Fit with given slopes, and with its own where these do not lead to the end and it may come below `most`."""
        near = approach(self.model, self.target, causes, start, slope, most)
        if near is None:
            return fit(self.model, self.target, causes, start)
        return near if near.converged else fit(self.model, self.target, causes, near.u, near.slope)

    def _from_starts(
        self, at: Fit, causes: tuple[int, ...], added: Sequence[int], known: Mapping[int, Real], thorough: bool
    ) -> list[Fit]:
        """Fit from the starts that causes name; where it takes long, from the best that a part of the data makes."""
        starts = self._starts(at, added, thorough)
        if thorough and len(self.target.observed) >= RULES.several:
            starts = self._sketched(causes, starts)[:1]
        found = []
        for u in starts:
            own = thorough or self._misfit(u) < RULES.halfway * at.chi2
            found.append(self._tried(causes, u, {} if own else known))
        return found

    def _sketched(self, causes: tuple[int, ...], starts: Sequence[Real]) -> list[Real]:
        """Return what fits to a part of the conditions make of some starts, and the starts: the best for all first."""
        part = self.target.only(list(self.target.observed)[:: RULES.several // 2])
        near = [fit(self.model, part, causes, u).u for u in starts]
        return sorted([*near, *starts], key=self._misfit)

    def _tried(self, causes: tuple[int, ...], start: Real, slope: Mapping[int, Real]) -> Fit:
        """Fit from a start with slopes from elsewhere, where there are any."""
        found = approach(self.model, self.target, causes, start, slope) if slope else None
        return fit(self.model, self.target, causes, start) if found is None else found

    def _starts(self, at: Fit, added: Sequence[int], thorough: bool) -> list[Real]:
        """Return the starts that causes name because they act far from their null: the best, or those not astray."""
        found: list[Real] = []
        for k in added:
            mine = self.model.of_cause[k]
            for given in self.model.causes[k].starts:
                # Where the baseline is far off its nuisances have gone astray with it.
                both = [at.u.copy(), np.where(np.isin(np.arange(at.u.size), self.model.nuisance), 0.0, at.u)]
                for start in both:
                    start[mine] = (np.array(given, dtype=float) - self.model.start[mine]) / self.model.scale[mine]
                found.append(min(both, key=self._misfit))
        if thorough:
            return sorted(found, key=self._misfit)[: RULES.named_starts]
        return [u for u in found if self._misfit(u) < RULES.astray * at.chi2]

    def _either_way(self, at: Fit, added: Sequence[int], best: Fit | None) -> list[Real]:
        """Return starts one scale either way, or on the other side."""
        found: list[Real] = []
        for k in added:
            mine = self.model.of_cause[k]
            for sign in (1.0, -1.0):
                start = (at.u if best is None else best.u).copy()
                start[mine] = np.clip(
                    sign if best is None else -sign * best.u[mine], self.model.low[mine], self.model.high[mine]
                )
                found.append(start)
        near = [u for u in found if self._misfit(u) < RULES.astray * at.chi2]
        return near if best is None else [u for u in near if not np.array_equal(u, best.u)]

    def _misfit(self, u: Real) -> float:
        """Misfit of some values."""
        return misfit(self.model, self.target, self.model.nuisance, u, residuals(self.model, self.target, u))

    def reduce(self, at: Fit, dropped: int) -> Fit:
        """Fit a hypothesis that has a cause less, from the nuisances of the larger one as well."""
        causes = tuple(k for k in at.causes if k != dropped)
        start = at.u.copy()
        start[self.model.of_cause[dropped]] = 0.0
        kept = np.isin(at.free, self.model.free(causes))
        slope = {r: x[:, kept] for r, x in at.slope.items()}
        return self._keep(fit(self.model, self.target, causes, start, slope))

    def usable(self, at: Fit, causes: Sequence[int]) -> tuple[Scheme, ...]:
        """Return the ways to hold conditions out that test some causes of a fit."""
        return tuple(usable(self.model, self.target, at, causes))

    def held_out(self, at: Fit, chosen: tuple[Scheme, ...]) -> HeldOut:
        """Predict held-out conditions."""
        key = (at.causes, chosen)
        if key not in self._held_out:
            self.progress(f"holding conditions out of {self.title(at.causes)}", len(self._held_out), 0)
            self._held_out[key] = held_out(self.model, self.target, at, chosen)
        return self._held_out[key]

    def gain(self, smaller: Fit, larger: Fit) -> Gain | None:
        """Gain of a larger hypothesis on conditions held out; None where none can be, or it did not converge."""
        chosen = self.usable(larger, [k for k in larger.causes if k not in smaller.causes])
        before, after = self._apart(smaller, chosen), self._apart(larger, chosen)
        if before is None or after is None or not after.trusted:
            return None
        found = compare(before, after, self.rng(2, len(larger.causes)))
        return found if chosen else replace(found, held_out="blocks of values")

    def _apart(self, at: Fit, chosen: tuple[Scheme, ...]) -> HeldOut | None:
        """Predict held-out conditions, or blocks of values where there are none."""
        return self.held_out(at, chosen) if chosen else within(self.model, self.target, at)


def _better(target: Target, found: Fit, old: Fit) -> bool:
    """Whether a fit is better than another by more than either is known."""
    if found.converged != old.converged:
        return found.converged
    return found.chi2 < old.chi2 - (tolerance(target, old.chi2) if found.converged else 0.0)


def fitted_misfit(bench: Bench, at: Fit) -> Misfit:
    """Test the residuals of a fit on the data it was fitted to."""
    basis, ends = bench.tangent(at).basis, np.cumsum([r.size for r in at.residual.values()])
    parts = np.split(basis[: ends[-1]], ends[:-1])
    return assess([(at.residual, dict(zip(at.residual, parts, strict=True)))], True, bench.model.noise_knowledge)


def _products(options: Sequence[Sequence[Signature]]) -> list[tuple[Signature, ...]]:
    """Return one signature of every cause, in all combinations."""
    found: list[tuple[Signature, ...]] = [()]
    for several in options:
        found = [(*f, s) for f in found for s in several]
    return found


def search(bench: Bench, most: int = RULES.most_causes) -> tuple[Fit, list[Step]]:
    """Add causes as long as they pass, and drop what has become idle.

    Return the fit that remains and the steps that led there, refused ones included.
    """
    at = bench.null()
    seen: set[tuple[int, ...]] = {()}
    steps: list[Step] = []
    while len(at.causes) < most:
        step = _best_step(bench, at, steps)
        if step is None:
            return bench.fitted(at.causes), steps
        refused, taken = {s.causes for s in steps if not s.accepted}, len(steps) - 1
        smaller = _drop_idle(bench, step, steps)
        if smaller.causes in refused:
            # A pair must not carry in what was refused alone.
            steps[taken:] = [replace(steps[taken], accepted=False, reason="what is not idle of it was refused")]
            return bench.fitted(at.causes), steps
        at = smaller
        if at.causes in seen:
            break
        seen.add(at.causes)
    return at, steps


def _best_step(bench: Bench, at: Fit, steps: list[Step]) -> Fit | None:
    """Take the best single cause that passes, else the best pair; None where nothing does."""
    others = [k for k in range(len(bench.model.causes)) if k not in at.causes and _fresh(bench, at, k)]
    found: list[tuple[Fit, tuple[int, ...]]] = []
    for k in _promising(bench, at, others, bench.threshold(at)):
        most = min((f.chi2 + RULES.far for f, _ in found if f.converged), default=np.inf)
        found.append((bench.extend(at, (k,), min(most, _passing(bench, at, (k,), bench.threshold(at)))), (k,)))
    at = _settled(bench, at, [f for f, _ in found if f.converged])
    limit = bench.threshold(at)
    for candidate, added in _ordered(bench, at, found):
        if _passes(bench, at, candidate, added, limit, steps):
            return bench.fitted(candidate.causes)
    return _best_pair(bench, at, others, [added[0] for _, added in _ordered(bench, at, found)][:2], steps)


def _promising(bench: Bench, at: Fit, others: Sequence[int], limit: float) -> list[int]:
    """Causes that come near a limit to first order, and the best few: those that are worth a fit."""
    gains = {k: bench.first_order(at, k) - RULES.penalty * parameters_of(bench.model, [k]) for k in others}
    ordered = sorted((k for k in others if gains[k] > 1.0 or bench.far([k])), key=lambda k: -gains[k])
    bad = bench.bad(at)
    return [
        k
        for n, k in enumerate(ordered)
        if n < RULES.least_tried or gains[k] > RULES.promising * limit or (bad and bench.far([k]))
    ]


def _passing(bench: Bench, at: Fit, added: Sequence[int], limit: float) -> float:
    """Misfit that more causes must come below to be looked at."""
    return at.chi2 - limit + RULES.close - RULES.penalty * parameters_of(bench.model, added)


def _fresh(bench: Bench, at: Fit, k: int) -> bool:
    """Whether a cause is not another variant of one that is in."""
    return bench.model.causes[k].id not in {bench.model.causes[j].id for j in at.causes}


def _settled(bench: Bench, at: Fit, found: Sequence[Fit]) -> Fit:
    """Fit the smaller model once more from the nuisances of the best larger one: no ratio against a bad optimum."""
    if not found:
        return at
    best = min(found, key=lambda f: f.chi2)
    (added,) = set(best.causes) - set(at.causes)
    again = bench.reduce(best, added)
    return again if again.converged else at


def _merit(bench: Bench, at: Fit, candidate: Fit) -> float:
    """Likelihood ratio less the charge for its parameters."""
    more = parameters_of(bench.model, candidate.causes) - parameters_of(bench.model, at.causes)
    return at.chi2 - candidate.chi2 - RULES.penalty * more


def _ordered(bench: Bench, at: Fit, found: Sequence[tuple[Fit, tuple[int, ...]]]) -> list[tuple[Fit, tuple[int, ...]]]:
    """Those that may be used, the best first."""
    used = [(f, added) for f, added in found if f.converged]
    return sorted(used, key=lambda item: -_merit(bench, at, item[0]))


def _passes(bench: Bench, at: Fit, candidate: Fit, added: tuple[int, ...], limit: float, steps: list[Step]) -> bool:
    """Hold a candidate against threshold, admissibility and held-out gain; note what comes near."""
    if not at.converged or _merit(bench, at, candidate) <= limit - RULES.close:
        return False
    candidate = bench.confirmed(candidate)
    if not candidate.converged or _merit(bench, at, candidate) <= limit:
        return False
    gain = bench.gain(at, candidate)
    bound = on_bound(bench.model, candidate, added)
    reason = ""
    if bound:
        reason = f"{bound} ends on the limit of what is physical"
    elif gain is None:
        reason = "no condition can be held out that would test it"
    elif not gain.proven:
        reason = (
            f"gain on held-out conditions {gain.db:.1f} dB, {gain.low:.1f} dB at the least; needed are "
            f"{gain.needed:g} dB, and more than 0 dB at the least"
        )
    passed = limit + RULES.penalty * parameters_of(bench.model, added)
    steps.append(
        Step(
            candidate.causes,
            "+ " + bench.title(added),
            at.chi2 - candidate.chi2,
            passed,
            gain,
            candidate.chi2,
            not reason,
            reason,
        )
    )
    return not reason


def on_bound(model: Model, found: Fit, causes: Sequence[int]) -> str:
    """Return the parameter of a cause that has run into a bound other than its null; "" for none."""
    for k in causes:
        for j in model.of_cause[k]:
            u = found.u[j]
            near = min(abs(u - model.low[j]), abs(model.high[j] - u))
            if near < 1e-6 and abs(u) > 1e-6:
                return str(model.names[j])
    return ""


def _best_pair(bench: Bench, at: Fit, others: Sequence[int], first: Sequence[int], steps: list[Step]) -> Fit | None:
    """Try the pairs that the linearised family suggests, and the best two causes where they may act far from it."""
    pairs = [p for p in combinations(others, 2) if bench.model.causes[p[0]].id != bench.model.causes[p[1]].id]
    if not pairs:
        return None
    limit = pair_threshold(bench.model, bench.tangent(at), bench.rng(3, len(at.causes)))
    worth = RULES.worth_a_pair * (limit + 2.0 * RULES.penalty)
    gains = {p: _pair_gain(bench, at, p) for p in pairs}
    promising = sorted((p for p in pairs if gains[p] > worth), key=lambda p: -gains[p])[: RULES.most_pairs]
    best = (min(first), max(first)) if len(first) == 2 else ()
    if best in gains and best not in promising and bench.far(best) and fitted_misfit(bench, at).p_value < RULES.band:
        promising.append((best[0], best[1]))
    found = [(bench.extend(at, p, _passing(bench, at, p, limit)), p) for p in promising]
    for candidate, added in _ordered(bench, at, found):
        if _passes(bench, at, candidate, added, limit, steps):
            return bench.fitted(candidate.causes)
    return None


def _pair_gain(bench: Bench, at: Fit, pair: tuple[int, ...]) -> float:
    """First-order likelihood ratio of a pair: the best over the shapes of both."""
    here = bench.tangent(at)
    both = _products([[s for s in here.signatures if s.cause == k] for k in pair])
    return max((combined_gain(bench.model, here, b) for b in both), default=0.0)


def _drop_idle(bench: Bench, at: Fit, steps: list[Step]) -> Fit:
    """Drop causes that a later one has made idle, the idlest first."""
    while len(at.causes) > 1:
        less = {k: f for k in at.causes if (f := bench.reduce(at, k)).converged}
        if not less:
            return at
        idle = min(less, key=lambda k: _merit(bench, less[k], at))
        smaller = less[idle]
        limit = bench.threshold(smaller)
        if _merit(bench, smaller, at) > limit:
            return at
        steps.append(
            Step(
                smaller.causes,
                "- " + bench.title((idle,)),
                smaller.chi2 - at.chi2,
                limit + RULES.penalty * parameters_of(bench.model, (idle,)),
                None,
                smaller.chi2,
                True,
            )
        )
        at = smaller
    return at


def rivals(bench: Bench, at: Fit, k: int) -> list[Fit]:
    """Fits of the hypotheses that have another cause in place of one."""
    smaller = bench.reduce(at, k)
    ids = {bench.model.causes[j].id for j in at.causes}
    others = [j for j in range(len(bench.model.causes)) if bench.model.causes[j].id not in ids]
    near = _promising(bench, smaller, others, smaller.chi2 - at.chi2)
    found = [bench.extend(smaller, (j,), at.chi2 + RULES.far) for j in near]
    return [bench.confirmed(f) if f.chi2 < at.chi2 + RULES.far else f for f in found]


# --- Whether the parameters of a fit are the same in all conditions: what changes when a cause is not in the catalogue.


@dataclass(frozen=True)
class Change:
    """The parameter that changes most."""

    parameter: str  # what changes
    setting: str  # with what
    ratio: float  # likelihood ratio of letting it change
    threshold: float  # what noise reaches

    @property
    def certain(self) -> bool:
        """Whether it is more than noise."""
        return self.ratio > self.threshold


def most_changing(
    model: Model, at: Tangent, rng: np.random.Generator, p_value: float = RULES.changing
) -> Change | None:
    """Return the parameter that differs most between the conditions; None where no setting contrasts them."""
    found = list(_patterns(model, at))
    if not found:
        return None
    columns = [c for _, _, c in found]
    inverses = [np.linalg.pinv(c.T @ c, rcond=1e-10, hermitian=True) for c in columns]
    charges = [RULES.penalty * c.shape[1] for c in columns]
    drawn = products_of_noise(model, at, columns, rng, RULES.draws)
    scores = [np.einsum("di,ij,dj->d", p, inv, p) - q for p, inv, q in zip(drawn, inverses, charges, strict=True)]
    limit = upper(scores, p_value)
    gains = [float(at.residual @ c @ inv @ c.T @ at.residual) for c, inv in zip(columns, inverses, strict=True)]
    k = int(np.argmax(np.array(gains) - charges))
    return Change(found[k][0], found[k][1], gains[k], limit + charges[k])


def _patterns(model: Model, at: Tangent) -> Iterator[tuple[str, str, Real]]:
    """Yield parameter, setting and columns (N, m) of every change that a fit does not imitate."""
    fit = at.fit
    rows = list(fit.residual)
    moving = inside(model, fit)
    lost = at.basis.shape[0] - sum(fit.residual[r].size for r in rows)
    for key in sorted({key for r in rows for key in model.conditions[r].settings}):
        contrast = _contrast([model.conditions[r].settings.get(key) for r in rows])
        for place, j in enumerate(fit.free):
            if contrast is None or not moving[place]:
                continue
            data = np.concatenate([np.outer(fit.slope[r][:, place], s) for r, s in zip(rows, contrast, strict=True)])
            columns = np.concatenate([data, np.zeros((lost, data.shape[1]))])
            before = np.linalg.norm(columns, axis=0)
            columns -= at.basis @ (at.basis.T @ columns)
            seen = np.linalg.norm(columns, axis=0) > np.maximum(RULES.confounded * before, 1e-12)
            if seen.any():
                yield model.names[int(j)], key, columns[:, seen] / before[seen]


def _contrast(settings: Sequence[float | str | None]) -> Real | None:
    """Return numbers for the settings of the conditions, (conditions, m): a slope, or one column for each word."""
    if any(s is None for s in settings) or len(set(settings)) < 2:
        return None
    if all(isinstance(s, (int, float)) for s in settings):
        x = np.array(settings, dtype=float)
        return ((x - x.mean()) / x.std())[:, None] if math.isfinite(float(x.std())) else None
    words = sorted({str(s) for s in settings})[: RULES.most_words + 1]
    return np.array([[float(str(s) == w) for w in words[1:]] for s in settings])
