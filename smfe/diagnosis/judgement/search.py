"""Which causes the data ask for: likelihood ratios with everything re-fitted, forward, in pairs and backward.

``LR = chi2(without) - chi2(with)``, the nuisances re-fitted non-linearly under every hypothesis. The best cause above
the calibrated threshold that also gains on held-out conditions is taken in, then all are fitted anew and those that
have become idle are dropped. Where no single cause passes, the pairs that do most to first order are tried: effects
mask each other. Where what is left is far from material nothing more is looked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.fit import Fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.thresholds import charge, pair_threshold
from smfe.diagnosis.judgement.hypotheses import Bench


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


def search(
    bench: Bench,
    most: int = RULES.most_causes,
    begin: tuple[int, ...] = (),
    released: Callable[[Fit], float] | None = None,
) -> tuple[Fit, list[Step]]:
    """Add causes as long as they pass, and drop what has become idle; `begin` with some that are known.

    Return the fit that remains and the steps that led there, refused ones included. Where a fit leaves no more than
    noise, nothing is added that explains less than what was declared does once it is `released`: its likelihood ratio,
    less the charge for its parameters.
    """
    steps: list[Step] = []
    return _within_limits(bench, _searched(bench, most, begin, released, steps), steps), steps


def _searched(
    bench: Bench,
    most: int,
    begin: tuple[int, ...],
    released: Callable[[Fit], float] | None,
    steps: list[Step],
) -> Fit:
    """Add and drop causes until nothing more passes."""
    at = bench.null()
    if begin and (known := bench.extend(at, begin)).converged:
        at = _drop_idle(bench, known, steps, least=0)
    seen: set[tuple[int, ...]] = {(), at.causes}

    def unfinished() -> bool:
        """Whether causes are left that matter, or what was declared is moved for want of a small one."""
        # What is known within its tolerance is no answer: it makes up for nothing else that may be wrong.
        if all(bench.as_known(at, k) for k in at.causes) or bench.matters(at, RULES.worth_a_search):
            return True
        if _hides(bench, at):
            return True
        return released is not None and released(at) > 0.0

    while len(at.causes) < most and unfinished():
        step = _best_step(bench, at, steps)
        if step is None:
            return bench.fits[at.causes]
        if released is not None and not bench.bad(at) and released(at) > _merit(bench, at, step):
            reason = "what was declared explains more of it where it is otherwise"
            steps[-1] = replace(steps[-1], accepted=False, reason=reason)
            return bench.fits[at.causes]
        at, refused, taken = bench.fits[at.causes], {s.causes: s.chi2 for s in steps if not s.accepted}, len(steps) - 1
        smaller = _drop_idle(bench, step, steps)
        if smaller.causes in refused:
            # A pair must not carry in what was refused alone, unless alone it was fitted to another minimum.
            pair = replace(steps[taken], accepted=False, reason="what is not idle of it was refused")
            better = refused[smaller.causes] - smaller.chi2 > bench.threshold(at)
            steps[taken:] = [pair]
            if not (better and _stands(bench, at, smaller, steps)):
                return at
        at = smaller
        if at.causes in seen:
            break
        seen.add(at.causes)
    return at


def _hides(bench: Bench, at: Fit) -> bool:
    """Whether a fit that leaves next to nothing may have taken up what another cause does, and that would matter.

    Friction that nobody declared has parameters enough to look nearly like one that differs between the directions:
    what it leaves is small, what it says is not. Faults of the measurement are not looked for there: on a joint that
    slips a sensor of 100 kg takes up what one stiffness a hit leaves.
    """
    if not bench.model.family.supple:
        return False
    physics = [k for k in _others(bench, at) if bench.model.causes[k].kind != "measurement"]
    gains = {k: bench.first_order(at, (k,)) - charge(bench.model, (k,)) for k in physics}
    return any(
        gain > RULES.proven and gain > bench.threshold(at) and bench.first_order_size(at, k) >= bench.worth.material
        for k, gain in gains.items()
    )


def _within_limits(bench: Bench, at: Fit, steps: list[Step]) -> Fit:
    """Replace a cause that later ones have driven to the limit of what is physical by one that does as much within.

    On its limit it would have been refused; it is another one by its name.
    """
    for k in at.causes:
        bound = on_bound(bench.model, at, (k,))
        if not bound or not (smaller := bench.reduce(at, k)).converged:
            continue
        ratio, needed = smaller.chi2 - at.chi2, bench.threshold(smaller) + charge(bench.model, (k,))
        reason = f"{bound} ends on the limit of what is physical"
        dropped = Step(smaller.causes, "- " + bench.title((k,)), ratio, needed, None, smaller.chi2, True, reason)
        for rival in sorted(rivals(bench, at, k), key=lambda f: f.chi2):
            added, taken = tuple(j for j in rival.causes if j not in at.causes), [dropped]
            as_good = rival.converged and rival.chi2 < at.chi2 + RULES.margin
            if as_good and _passes(bench, smaller, rival, added, bench.threshold(smaller), taken):
                steps += taken
                return bench.fits[rival.causes]
    return at


def _best_step(bench: Bench, at: Fit, steps: list[Step]) -> Fit | None:
    """Take the best single cause that passes, else the best pair; None where nothing does."""
    others = _others(bench, at)
    found: list[tuple[Fit, tuple[int, ...]]] = []
    promising = _promising(bench, at, others, bench.threshold(at))
    bench.planned = len(bench.fits) + len(promising) + RULES.most_pairs
    for k in promising:
        led = max((at.chi2 - f.chi2 for f, _ in found if bench.leads(at, f)), default=0.0)
        if led > 0.0 and bench.first_order(at, (k,)) < RULES.outdone * led:
            continue
        # What fits better has won, though it has not ended: nothing may be named in its place.
        least, passing = min((f.chi2 for f, _ in found), default=np.inf), _passing(bench, at, (k,), bench.threshold(at))
        tried = bench.extend(at, (k,), min(least + RULES.far, passing))
        found.append((bench.pursued(tried) if tried.chi2 < min(least, passing) else tried, (k,)))
    at = _settled(bench, at, [f for f, _ in found if f.converged])
    limit, found = bench.threshold(at), _with_shapes(bench, at, found)
    ordered = _ordered(bench, at, found)
    # What is known to be so within its tolerance goes before what fits hardly better and is known of nothing.
    least = max((_merit(bench, at, f) for f, _ in ordered), default=0.0) - RULES.margin

    def unknown(one: tuple[Fit, tuple[int, ...]]) -> bool:
        return _merit(bench, at, one[0]) <= least or not bench.as_known(one[0], one[1][0])

    for candidate, added in sorted(ordered, key=unknown):
        if _passes(bench, at, candidate, added, limit, steps):
            return bench.fits[candidate.causes]
    return _best_pair(bench, at, others, [added[0] for _, added in _ordered(bench, at, found)][:2], steps)


def _with_shapes(
    bench: Bench, at: Fit, found: Sequence[tuple[Fit, tuple[int, ...]]]
) -> list[tuple[Fit, tuple[int, ...]]]:
    """Fit variants of the best cause that have fewer parameters with slopes of their own, where one had no slope yet.

    At the null of a size its shape does nothing (the angle of a run-out): with slopes from there the shape stays where
    it was, and a cause with more parameters and no shape wins what this one does as well.
    """
    ordered = _ordered(bench, at, found)
    if not ordered:
        return list(found)
    model, (best, (first, *_)) = bench.model, ordered[0]

    def shapeless(f: Fit, k: int) -> bool:
        fewer = model.causes[k].id == model.causes[first].id and len(model.of_cause[k]) < len(model.of_cause[first])
        mine = np.isin(f.free, model.of_cause[k])
        still = sum(np.sum(np.square(x[:, mine]), axis=0) for x in f.slope.values())
        return f.provisional and f.converged and f is not best and fewer and not np.all(still)

    return [(bench.confirmed(f) if shapeless(f, added[0]) else f, added) for f, added in found]


def _others(bench: Bench, at: Fit, replaced: int | None = None) -> list[int]:
    """Causes that are no variant of one that is in, and no other law of what one is a law of, but for one replaced."""
    causes = bench.model.causes
    ids = {causes[k].id for k in at.causes}
    laws = {causes[k].law_of for k in at.causes if k != replaced} - {""}
    return [k for k, cause in enumerate(causes) if cause.id not in ids and cause.law_of not in laws]


def _promising(bench: Bench, at: Fit, others: Sequence[int], limit: float) -> list[int]:
    """Causes that come near a limit to first order, and the best few: those that are worth a fit."""
    gains = {k: bench.first_order(at, (k,)) - charge(bench.model, [k]) for k in others}
    seen = {k for k in others if bench.model.causes[k].begin}
    ordered = sorted((k for k in others if gains[k] > 1.0 or bench.far([k]) or k in seen), key=lambda k: -gains[k])
    bad = bench.bad(at)
    tried = [
        k
        for n, k in enumerate(ordered)
        if n < RULES.least_tried or gains[k] > RULES.promising * limit or k in seen or (bad and bench.far([k]))
    ]
    # What fitted nearly the same data best goes first, then what explains a part of them with slopes of the smaller
    # fit: what does worse is not followed to its optimum. What acts far from its null only comes in the order of the
    # catalogue, the richest of its variants first.
    ids = list(dict.fromkeys(cause.id for cause in bench.model.causes))
    least = RULES.part * max(at.chi2 - bench.values, 0.0)

    def rank(k: int) -> tuple[float, bool, float, int, int]:
        cause, near = bench.model.causes[k], bench.glimpsed(at, k) if bad else at.chi2
        far = (1 + ids.index(cause.id), -len(cause.parameters)) if bad and bench.far([k]) else (0, 0)
        return (bench.known_misfit(at, k), not cause.begin, near if at.chi2 - near > least else at.chi2, *far)

    return sorted(tried, key=rank)


def _passing(bench: Bench, at: Fit, added: Sequence[int], limit: float) -> float:
    """Misfit that more causes must come below to be looked at."""
    return at.chi2 - limit + RULES.close - charge(bench.model, added)


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
    more = charge(bench.model, candidate.causes) - charge(bench.model, at.causes)
    return at.chi2 - candidate.chi2 - more


def _ordered(bench: Bench, at: Fit, found: Sequence[tuple[Fit, tuple[int, ...]]]) -> list[tuple[Fit, tuple[int, ...]]]:
    """Those that may be used, the best first."""
    used = [(f, added) for f, added in found if f.converged]
    return sorted(used, key=lambda item: -_merit(bench, at, item[0]))


def _passes(bench: Bench, at: Fit, candidate: Fit, added: tuple[int, ...], limit: float, steps: list[Step]) -> bool:
    """Hold a candidate against threshold, admissibility and held-out gain; note what comes near."""
    if not (at.converged or bench.hopeless(at)) or _merit(bench, at, candidate) <= limit - RULES.close:
        return False
    candidate = bench.confirmed(candidate)
    if not candidate.converged or _merit(bench, at, candidate) <= limit:
        return False
    gain = bench.gain(at, candidate)
    # What everybody knows to be a little off (directions of modes) is no fault that would have to be proven.
    usual = all(bench.as_known(candidate, k) for k in added)
    reason = ""
    if bound := on_bound(bench.model, candidate, added):
        reason = f"{bound} ends on the limit of what is physical"
    elif gain is None and not usual:
        reason = "no condition can be held out that would test it"
    elif gain is not None and not bench.proves(gain) and not usual:
        least = max(gain.needed, bench.least_gain)
        reason = (
            f"gain on held-out conditions {gain.db:.1f} dB, {gain.low:.1f} dB at the least; needed are {least:g} dB, "
            "and more than 0 dB at the least"
        )
    change, ratio, passed = "+ " + bench.title(added), at.chi2 - candidate.chi2, limit + charge(bench.model, added)
    steps.append(Step(candidate.causes, change, ratio, passed, gain, candidate.chi2, not reason, reason))
    return not reason


def _stands(bench: Bench, at: Fit, smaller: Fit, steps: list[Step]) -> bool:
    """Whether what is left of a pair passes by itself, in the minimum that the pair has led to."""
    added = tuple(k for k in smaller.causes if k not in at.causes)
    return _passes(bench, at, smaller, added, bench.threshold(at), steps)


def on_bound(model: Model, found: Fit, causes: Sequence[int]) -> str:
    """Return the parameter of a cause that has run into a bound other than its null; "" for none.

    Parameters that only shape what a cause does may: a strange shape is no objection to what unseen conditions
    bear out.
    """
    for k in causes:
        for j in model.of_cause[k]:
            if model.parameters[j].secondary:
                continue
            u = found.u[j]
            near = min(abs(u - model.low[j]), abs(model.high[j] - u))
            if near < 1e-6 and abs(u) > 1e-6:
                return str(model.names[j])
        beyond = model.causes[k].beyond
        if beyond is not None and (name := beyond(model.values(found.u))):
            return name
    return ""


def _best_pair(bench: Bench, at: Fit, others: Sequence[int], first: Sequence[int], steps: list[Step]) -> Fit | None:
    """Try the pairs that the linearised family suggests, and the best two causes where they may act far from it.

    A pair is suggested if each of the two adds more to the other than its charge, and not beside causes that are named
    with the remainder that they leave: that is what a model leaves of its own effect.

    Pairs with a cause that nearly every machine has (`Abilities.common`) are tried wherever something is wrong.
    """
    if not bench.matters(at, RULES.worth_pairs):
        return None
    acting = {s.cause for s in bench.tangent(at).acting}
    able = [k for k in others if k in acting or bench.far([k])]
    pairs = [p for p in combinations(able, 2) if _compatible(bench, p)]
    gains = {p: bench.first_order(at, p) for p in pairs}
    alone = {k: bench.first_order(at, (k,)) for k in able}
    # Of a pair each must do more than a parameter of noise beside the other: else one of them alone has been tried.
    both = [p for p in pairs if all(gains[p] - alone[p[1 - n]] > charge(bench.model, [p[n]]) for n in (0, 1))]
    usual = [p for p in pairs if {bench.model.causes[k].id for k in p} & set(bench.model.family.common)]
    best = (min(first), max(first)) if len(first) == 2 else ()
    far = [(best[0], best[1])] if best in gains and bench.far(best) else []
    if not bench.bad(at):
        usual = far = []
    elif (both or far) and bench.named(at):
        both = far = []
    if not (both or usual or far):
        return None
    limit = pair_threshold(bench.model, bench.tangent(at), bench.rng(3, len(at.causes)))
    worth = RULES.worth_a_pair * (limit + 2.0 * RULES.penalty)
    promising = sorted((p for p in both if gains[p] > worth), key=lambda p: -gains[p])[: RULES.most_pairs]
    promising += sorted((p for p in usual if p not in promising), key=lambda p: -gains[p])[: RULES.most_pairs]
    promising += [p for p in far if p not in promising]
    found = [(bench.extend(at, p, _passing(bench, at, p, limit)), p) for p in promising]
    for candidate, added in _ordered(bench, at, found):
        if _passes(bench, at, candidate, added, limit, steps):
            return bench.fits[candidate.causes]
    return None


def _compatible(bench: Bench, pair: tuple[int, int]) -> bool:
    """Whether two causes may be in one model: no variants of one, and no two laws of one thing."""
    one, other = (bench.model.causes[k] for k in pair)
    return one.id != other.id and not (one.law_of and one.law_of == other.law_of)


def _drop_idle(bench: Bench, at: Fit, steps: list[Step], least: int = 1) -> Fit:
    """Drop causes that a later one, or a release, has made idle, the idlest first, down to the `least` of them."""
    while len(at.causes) > least:
        less = {k: f for k in at.causes if (f := bench.reduce(at, k)).converged}
        if not less:
            return at
        idle = min(less, key=lambda k: _merit(bench, less[k], at))
        smaller = less[idle]
        limit = bench.threshold(smaller)
        if _merit(bench, smaller, at) > limit:
            return at
        change, kept = "- " + bench.title((idle,)), limit + charge(bench.model, (idle,))
        steps.append(Step(smaller.causes, change, smaller.chi2 - at.chi2, kept, None, smaller.chi2, True))
        at = smaller
    return at


def rivals(bench: Bench, at: Fit, k: int) -> list[Fit]:
    """Fits of the hypotheses that have another cause in place of one."""
    smaller = bench.reduce(at, k)
    near = _promising(bench, smaller, _others(bench, at, k), smaller.chi2 - at.chi2)
    found = [bench.extend(smaller, (j,), at.chi2 + RULES.far) for j in near]
    return [bench.confirmed(f) if f.chi2 < at.chi2 + RULES.far else f for f in found]
