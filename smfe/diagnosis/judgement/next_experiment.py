"""Which experiment would settle what remains open: T-optimal discrimination (Atkinson, Fedorov, Biometrika 62, 1975).

``D(e) = min over pairs of min |y_i - y_j|^2`` over the parameters and nuisances of j, on what was measured and the
proposal e together, with the data that hypothesis i predicts. The likelihood ratio between the two is then about normal
with mean D and variance 4 D, which gives the probability that the experiment settles the pair. An experiment that takes
t minutes and settles it with the probability p, repeated until it does, takes t/p: the least of these comes first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from scipy import stats

from smfe.diagnosis.inference.fit import Fit, Target, approach, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Signature, Tangent, widened
from smfe.diagnosis.inference.thresholds import Detectable, detectable


@dataclass(frozen=True)
class Revealed:
    """What an experiment would show that the data so far hide."""

    title: str  # of the cause
    parameter: str
    size: float  # that would be seen with 95 %, in the unit shown
    so_far: float  # that is seen so far; infinite: nothing is
    unit: str


@dataclass(frozen=True)
class Proposal:
    """An experiment that could be done next."""

    name: str  # of the condition
    discrimination: float
    """D of the pair that it separates worst [chi-square], what was measured included; NaN where nothing has to be
    separated and it is to reveal what could be hidden."""
    probability: float  # probability that it settles that pair, or reveals what it is said to reveal
    expected: str  # what to look for
    minutes: float | None = None  # what it takes; None where nothing is said about it
    between: str = ""  # hypotheses that it separates, in words; empty where it is to reveal what could be hidden
    apart: float = math.nan  # by how many times the noise (rms) their predictions differ at least
    reveals: tuple[Revealed, ...] = ()  # what it would show, the greatest progress first
    do: str = ""  # what to do, a sentence (`smfe.diagnosis.story.experiments`)
    block: str = ""  # the same as tables of a campaign file (`smfe.diagnosis.story.blocks`)


def discrimination(
    model: Model, target: Target, truth: Fit, rival: Fit, rows: Sequence[int], declared: Sequence[int] = ()
) -> Fit | None:
    """Fit a rival to what another hypothesis predicts for the measured conditions and `rows`; its chi2 is D.

    `model` is that of the rival. Of the parameters `declared` what was declared stays what it is, whatever is true.

    A fit that has not converged gives what D is at the least: its misfit less what steps may still take off it. That is
    enough where it is large, and what any fit leaves is enough where that is below the margin: nothing is decided then.
    The slopes of the rival bring both. What lies between takes a fit with its own slopes, and so does a small D of a
    rival with more parameters: only so is one that imitates the truth seen to do so.
    """
    every = [*target.observed, *rows]
    predicted = {r: y for r in every if (y := model.predict(r, truth.u)) is not None}
    slope = model.slopes(rows, rival.u, rival.free)
    if len(predicted) < len(every) or slope is None:
        return None
    numbers = np.arange(truth.u.size)
    moves = np.isin(numbers, truth.free) & ~np.isin(numbers, declared)
    centre = np.where(moves, truth.u, target.centre)
    aim = Target(predicted, centre)
    near = replace(rival, slope={**rival.slope, **slope})
    known = all(r in near.slope for r in every)  # a fit that stopped where nothing is predicted has no slopes
    found = approach(model, aim, near.causes, near.u, near.slope, RULES.margin) if known else None
    undecided = found is None or found.chi2 - RULES.optimism * found.promised <= RULES.margin < found.chi2
    if found is None or undecided or (found.chi2 <= RULES.margin and rival.free.size > truth.free.size):
        found = fit(model, aim, near.causes, near.u if found is None else found.u, most=RULES.margin)
    least = found.chi2 - RULES.optimism * found.promised
    if not least > RULES.margin:
        return replace(found, converged=found.converged or found.chi2 <= RULES.margin)
    smaller = math.sqrt(least / found.chi2)
    return replace(found, chi2=least, residual={r: smaller * x for r, x in found.residual.items()}, converged=True)


def probability_to_settle(found: float) -> float:
    """Probability that a likelihood ratio of mean D and variance 4 D exceeds the margin."""
    return float(stats.norm.cdf((found - RULES.margin) / (2.0 * math.sqrt(found)))) if found > 0.0 else 0.0


def rank(
    model: Model,
    target: Target,
    open_: Sequence[Fit],
    rows: Sequence[int],
    title: str = "",
    models: Sequence[Model] = (),
    declared: Sequence[int] = (),
) -> list[Proposal]:
    """Rank proposals (rows) by how soon they are expected to decide between hypotheses, `title`, the soonest first.

    Only the proposals that separate most, if no parameter gave way, are examined. Hypotheses that differ in what they
    take as declared have `models` of their own, one each; `declared` are the parameters that one of them frees.
    """
    found = []
    own = models or [model] * len(open_)
    for row in _promising(model, open_, rows):
        fits: list[Fit | None] = []
        for a, b in permutations(range(len(open_)), 2):
            rival = discrimination(own[b], target, open_[a], open_[b], [row], declared)
            if rival is None or not _imitates(model, rival, open_[a]):
                fits.append(rival)
                if rival is None or rival.chi2 <= RULES.margin:
                    break  # a pair that it leaves open is enough: the others are not fitted
        if not fits or any(f is None or not f.converged for f in fits):
            continue
        worst = min((f for f in fits if f is not None), key=lambda f: f.chi2)
        apart = math.sqrt(float(np.mean(worst.residual[row] ** 2)))
        probability = probability_to_settle(worst.chi2)
        words = (
            f"there the predictions of {title or 'the hypotheses'} differ by {apart:.2g} times the noise (rms) at "
            f"least; the probability that it settles the question is {100.0 * probability:.0f} %"
        )
        name, minutes = model.conditions[row].name, _stated_minutes(model, row)
        found.append(Proposal(name, worst.chi2, probability, words, minutes, title or "the hypotheses", apart))
    return sorted(found, key=lambda p: ((p.minutes or RULES.minutes) / max(p.probability, 1e-9), -p.discrimination))


def _imitates(model: Model, rival: Fit, truth: Fit) -> bool:
    """Return whether a rival with more parameters contains the truth: parsimony decides then, no experiment."""
    nothing = RULES.rough if model.roughness > 0.0 else RULES.imitated
    return rival.converged and rival.chi2 < nothing and rival.free.size > truth.free.size


def _promising(model: Model, open_: Sequence[Fit], rows: Sequence[int]) -> list[int]:
    """Return the rows whose predictions differ most for each minute: a rival that is not fitted anew bounds D."""
    worth: dict[int, float] = {}
    for row in rows:
        predicted = [model.predict(row, f.u) for f in open_]
        known = [y for y in predicted if y is not None]
        if len(known) == len(predicted):
            apart = min((float(np.sum((a - b) ** 2)) for a, b in combinations(known, 2)), default=0.0)
            worth[row] = apart / (_stated_minutes(model, row) or RULES.minutes)
    return sorted(worth, key=lambda row: -worth[row])[: RULES.proposals_tried]


def _stated_minutes(model: Model, row: int) -> float | None:
    said = model.conditions[row].settings.get("minutes")
    return None if said is None else float(said)


# --- What the measured conditions hide, and which experiment would: the next step where nothing was found.


def revealing(model: Model, target: Target, here: Tangent, limit: float, rows: Sequence[int]) -> Proposal | None:
    """Return the proposal (row) that reveals most of what the measured conditions hide; None where none does.

    They are known by the linearisation of a fit to them; what is not seen at a `limit` of the likelihood ratio is
    hidden. Of many proposals those are examined that show most of the shapes of causes that are hidden best.
    """
    before = _sizes(model, detectable(model, here, limit))
    # Another form of what was found is not hidden.
    known = {model.causes[k].id for k in here.fit.causes}
    hidden = {key: size for key, size in before.items() if size > 1.0 and key[0].partition("/")[0] not in known}
    if not hidden:
        return None

    def examined(at: Tangent, row: int) -> tuple[float, dict[tuple[str, str], float]]:
        """What an experiment is worth a minute, and the sizes that are seen with it."""
        after = _with(model, target, at, limit, row, {key for key, _ in hidden})
        if after is None:
            return 0.0, {}
        worth = [math.log(size / max(after.get(key, size), 1.0)) for key, size in hidden.items()]
        # A little of each of many is nothing that can be said.
        return (sum(worth) / _minutes(model, row) if max(worth) > math.log(RULES.worth_saying) else 0.0), after

    if len(rows) > RULES.proposals_tried:
        few = _least_seen(here)
        rows = sorted(rows, key=lambda row: -examined(few, row)[0])[: RULES.proposals_tried]
    best = max(((*examined(here, row), row) for row in rows), key=lambda one: one[0], default=(0.0, {}, -1))
    return _proposal(model, best[2], hidden, best[1]) if best[0] > 0.0 else None


def _least_seen(here: Tangent) -> Tangent:
    """Keep the shape of each cause that does least beyond what the fit imitates."""
    least: dict[int, Signature] = {}
    for s in here.signatures:
        if s.cause not in least or np.linalg.norm(s.columns) < np.linalg.norm(least[s.cause].columns):
            least[s.cause] = s
    return replace(here, signatures=tuple(least.values()))


def _minutes(model: Model, row: int) -> float:
    return float(model.conditions[row].settings.get("minutes", RULES.minutes))


def _sizes(model: Model, seen: Sequence[Detectable]) -> dict[tuple[str, str], float]:
    """Cause and parameter -> size that is seen [scales]."""
    unit = {p.name: p.scale * p.shown for c in model.causes for p in c.parameters}
    return {(d.cause, d.parameter): min(d.size / unit[d.parameter], RULES.blind) for d in seen}


def _with(
    model: Model, target: Target, here: Tangent, limit: float, row: int, causes: set[str]
) -> dict[tuple[str, str], float] | None:
    """Sizes that would be seen if a condition were measured as well and showed what the baseline predicts."""
    null = here.fit
    wanted = [k for k, c in enumerate(model.causes) if c.key in causes]
    # In closed form all slopes together cost little more than one; they are kept.
    model.slopes([row], null.u, np.concatenate([null.free, *(model.of_cause[k] for k in wanted)]))
    predicted, slope = model.predict(row, null.u), model.slopes([row], null.u, null.free)
    if predicted is None or slope is None:
        return None
    more = Target({**target.observed, row: predicted}, target.centre)
    fit = replace(null, residual={**null.residual, row: np.zeros_like(predicted)}, slope={**null.slope, **slope})
    return _sizes(model, detectable(model, widened(model, more, fit, here, row, wanted), limit))


def _proposal(
    model: Model, row: int, before: Mapping[tuple[str, str], float], after: Mapping[tuple[str, str], float]
) -> Proposal:
    gains = {key: size / max(after.get(key, size), 1.0) for key, size in before.items()}
    listed = [key for key in sorted(gains, key=lambda key: -gains[key]) if gains[key] > RULES.worth_saying][
        : RULES.most_said
    ]
    words = "; ".join(_words(model, key, before[key], after[key]) for key in listed)
    minutes = model.conditions[row].settings.get("minutes")
    return Proposal(
        model.conditions[row].name,
        math.nan,
        RULES.seen,
        f"there would be seen with {100 * RULES.seen:.0f} % what the data so far hide: {words}",
        None if minutes is None else float(minutes),
        reveals=tuple(_revealed(model, key, before[key], after[key]) for key in listed),
    )


def _revealed(model: Model, key: tuple[str, str], before: float, after: float) -> Revealed:
    cause, p = next((c, p) for c in model.causes for p in c.parameters if (c.key, p.name) == key)
    unit = p.scale * p.shown
    return Revealed(cause.title, p.name, after * unit, before * unit if before < RULES.blind else math.inf, p.unit)


def _words(model: Model, key: tuple[str, str], before: float, after: float) -> str:
    cause, p = next((c, p) for c in model.causes for p in c.parameters if (c.key, p.name) == key)
    unit = "" if p.unit == "1" else f" {p.unit}"
    now, then = (f"{size * p.scale * p.shown:.2g}{unit}" for size in (before, after))
    return f"{cause.title} ({p.name}) of {then}" + (f", so far {now}" if before < RULES.blind else "")
