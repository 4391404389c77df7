"""Thresholds by parametric bootstrap on the linearised family, and the effects that they let be detected.

Every draw is noise on the data and on the priors, projected off the nuisances; what it scores for a cause depends on it
only through the products with the signatures, so that tens of thousands of draws of a few numbers each do. A cause that
starts on a bound can only go one way: its score is that of a least squares problem in a cone (chi-bar-square; Shapiro,
Biometrika 72, 1985), solved for all draws at once over its few active sets. The statistic of a cause is its likelihood
ratio less two a parameter; the largest over the whole catalogue is calibrated, so that looking everywhere is paid for.

With the tests of pairs and of the remaining misfit three p-values of `RULES.false_alarm` add up to 0.12 %: of 300
healthy machines not more than one then raises an alarm in 95 of 100 campaigns, which is what proves a rate below 2 %
(Clopper-Pearson).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from process.types import Real
from smfe.diagnosis.inference.model import Index, Model
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import Signature, Tangent


@dataclass(frozen=True)
class Score:
    """First-order likelihood ratio of one signature, ready for any products with the residual."""

    gram: Real  # shape (m, m): products of the signature's columns, the priors of the cause on the diagonal
    up: NDArray[np.bool_]  # shape (m,): which parameters can rise
    down: NDArray[np.bool_]  # which can fall

    def gain(self, product: Real) -> Real:
        """Return the decrease of the misfit, shape (d,), for products ``-columns . residual``, shape (d, m)."""
        one_sided = np.flatnonzero(~(self.up & self.down))[: RULES.most_one_sided]
        best = np.zeros(product.shape[0])
        for count in range(one_sided.size + 1):
            for held in combinations(one_sided, count):
                free = np.setdiff1d(np.arange(self.gram.shape[0]), held)
                inverse = np.linalg.pinv(self.gram[np.ix_(free, free)], rcond=1e-10, hermitian=True)
                step = product[:, free] @ inverse
                allowed = np.all(((step >= 0.0) | self.down[free]) & ((step <= 0.0) | self.up[free]), axis=1)
                gain = np.einsum("dm,dm->d", step, product[:, free])
                np.maximum(best, np.where(allowed, gain, 0.0), out=best)
        return best


def score(model: Model, signatures: Sequence[Signature]) -> Score:
    """Score of one signature, or of several causes together; a scaled parameter of zero is the null."""
    columns = np.concatenate([s.columns for s in signatures], axis=1)
    free = np.concatenate([s.free for s in signatures])
    return Score(columns.T @ columns + np.diag(model.weight[free] ** 2), *_ways(model, free))


def _ways(model: Model, free: Index) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which parameters can rise from their null, and which can fall."""
    return model.high[free] > 1e-9, model.low[free] < -1e-9


def combined_gain(model: Model, at: Tangent, signatures: Sequence[Signature]) -> float:
    """First-order likelihood ratio of some signatures together, for the residual of the fit."""
    products = np.concatenate([-(s.columns.T @ at.residual) for s in signatures])
    return float(score(model, signatures).gain(products[None, :])[0])


def parameters_of(model: Model, causes: Sequence[int]) -> int:
    """Return how many parameters some causes have."""
    return sum(len(model.causes[k].parameters) for k in causes)


def charge(model: Model, causes: Sequence[int]) -> float:
    """Return what causes are charged for their parameters [chi-square]."""
    return RULES.penalty * parameters_of(model, causes)


def threshold(model: Model, at: Tangent, rng: np.random.Generator, p_value: float = RULES.false_alarm) -> float:
    """Return what the best ``gain - 2 parameters`` of any cause exceeds by noise alone with a probability."""
    best: dict[int, Real] = {}
    products = products_of_noise(model, at, [s.columns for s in at.signatures], rng, RULES.draws)
    for s, product in zip(at.signatures, products, strict=True):
        gain = score(model, [s]).gain(product) - charge(model, [s.cause])
        best[s.cause] = np.maximum(best[s.cause], gain) if s.cause in best else gain
    return upper(list(best.values()), p_value)


def pair_threshold(model: Model, at: Tangent, rng: np.random.Generator, p_value: float = RULES.false_alarm) -> float:
    """Return the same for the best pair of causes, over all pairs of those that act."""
    products = products_of_noise(model, at, [s.columns for s in at.acting], rng, RULES.draws // 5)
    best: dict[int, Real] = {}
    for (i, a), (j, b) in combinations(enumerate(at.acting), 2):
        if a.cause != b.cause:
            both = np.concatenate([products[i], products[j]], axis=1)
            gain = score(model, [a, b]).gain(both) - charge(model, [a.cause, b.cause])
            best[0] = np.maximum(best[0], gain) if best else gain
    return upper(list(best.values()), p_value)


def products_of_noise(
    model: Model, at: Tangent, columns: Sequence[Real], rng: np.random.Generator, draws: int
) -> list[Real]:
    """Draw products of noise with columns X of residuals, (draws, m): Gaussian with the covariance ``X^T X``.

    The same noise is multiplied with all columns. Of a family that knows several noises that its data could have come
    from as many draws come from each.
    """
    if not columns:
        return []
    every = np.concatenate(columns, axis=1)
    size = np.linalg.norm(every, axis=0)  # an exchange of axes is a million times as large as others
    some = size > 0.0
    covariances = covariances_of_noise(model, at.fit.residual, every[:, some] / size[some])
    share = math.ceil(draws / len(covariances))
    noise = np.zeros((share * len(covariances), size.size))
    for n, covariance in enumerate(covariances):
        root = size[some, None] * _root(covariance)
        noise[n * share : (n + 1) * share, some] = rng.standard_normal((share, len(root))) @ root.T
    return np.split(noise, np.cumsum([c.shape[1] for c in columns])[:-1], axis=1)


def covariances_of_noise(model: Model, residual: Mapping[int, Real], columns: Real) -> Sequence[Real]:
    """Return the covariance of products of noise with columns X, (m, m): ``X^T X``, or one for each noise it may be.

    The rows of X are those of the residuals, then of the priors, whose noise is known.
    """
    parts = np.split(columns, np.cumsum([r.size for r in residual.values()]))
    found = model.family.noises([(model.conditions[r], x) for r, x in zip(residual, parts[:-1], strict=True)])
    return [c + parts[-1].T @ parts[-1] for c in found] or [columns.T @ columns]


def _root(covariance: Real) -> Real:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def upper(best: Sequence[Real], p_value: float) -> float:
    """Return the upper quantile of the largest statistic; beyond the draws, its tail is continued as an exponential."""
    if not best:
        return math.inf
    largest = np.max(np.stack(best), axis=0)
    edge = float(np.quantile(largest, 1.0 - RULES.tail))
    beyond = largest[largest > edge] - edge
    if p_value >= RULES.tail or beyond.size == 0:
        return float(np.quantile(largest, 1.0 - p_value))
    return edge + float(np.mean(beyond)) * math.log(RULES.tail / p_value)


# --- What size of each cause would have been seen: the other half of "nothing was found".
# A cause of size s has the noncentrality s^2 g with g the square of its signature; seen with 95 % is the size at which
# the noncentral distribution of the likelihood ratio lies above the threshold with that probability. Where the effect
# has a shape (the speed of a Stribeck effect, the frequency of a mode), the least visible one counts.


@dataclass(frozen=True)
class Detectable:
    """Smallest size of one parameter of a cause that is seen with 95 %."""

    cause: str
    title: str
    parameter: str
    size: float  # change from the null, as shown; infinite where it has no effect in these conditions
    proven_size: float
    """The size that is named with 95 %: its gain on held-out conditions is three standard deviations as well."""
    unit: str  # of the sizes
    admissible: bool  # whether the parameter can get that large


def detectable(model: Model, at: Tangent, limit: float) -> tuple[Detectable, ...]:
    """Return the detectable size of each parameter of each cause that is not in the fit, at a limit of ``LR - 2 p``."""
    found = []
    for k, cause in enumerate(model.causes):
        own = [s for s in at.signatures if s.cause == k]
        if k in at.fit.causes:
            continue
        for j, parameter in zip(model.of_cause[k], cause.parameters, strict=True):
            acting = [s for s in own if j in s.free]
            if own and not acting:
                continue
            level = limit + charge(model, [k])
            seen, proven = (
                max((_size(model, s, int(j), x) for s in acting), default=math.inf)
                for x in (level, max(level, RULES.proven))
            )
            unit = parameter.scale * parameter.shown
            possible = bool(seen <= max(model.high[j], -model.low[j]))
            found.append(
                Detectable(cause.key, cause.title, parameter.name, seen * unit, proven * unit, parameter.unit, possible)
            )
    return tuple(found)


def _size(model: Model, signature: Signature, j: int, level: float) -> float:
    """Size of a scaled parameter whose likelihood ratio exceeds a level with 95 %."""
    place = int(np.flatnonzero(signature.free == j)[0])
    square = float(signature.columns[:, place] @ signature.columns[:, place])
    if square <= 0.0:
        return math.inf
    up, down = _ways(model, signature.free)
    one_sided = bool(up.size == 1 and not (up[0] and down[0]))
    return math.sqrt(noncentrality(max(level, 1e-6), up.size, one_sided) / square)


def noncentrality(level: float, degrees_of_freedom: int, one_sided: bool = False) -> float:
    """Return the noncentrality with which a chi-square statistic exceeds a level with 95 %."""
    if one_sided:
        return (math.sqrt(level) + float(stats.norm.ppf(RULES.seen))) ** 2
    return float(special.chndtrinc(level, degrees_of_freedom, 1.0 - RULES.seen))
