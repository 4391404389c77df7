"""Whether independent sources give a cause the same parameters.

One step of each source by itself from the joint optimum, its own nuisances free, gives its estimate and information;
the weighted squares of the differences have a chi-square law where the noise is known, and a wider one where the data
could have come from other noises as well (`smfe.diagnosis.calibration.products_of_noise`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from smfe.diagnosis.calibration import DRAWS, products_of_noise
from smfe.diagnosis.evidence import Bench
from smfe.diagnosis.fit import Fit, stacked
from smfe.diagnosis.signature import orthonormal

Real = NDArray[np.float64]

AGREED = 0.99
"""Joint region within which sources agree: one of 95 % would take the name from one right cause in twenty."""


def agrees(bench: Bench, at: Fit, k: int) -> bool:
    """Whether a cause has the same parameters in all sources, within their joint 99 % region."""
    sources = sorted({bench.model.conditions[r].source for r in bench.target.observed} - {""})
    if len(sources) < 2:
        return True
    slopes = [_own_slopes(bench, at, k, source) for source in sources]
    informations = [x.T @ x for x in slopes]
    residual = stacked(bench.model, bench.target, at.free, at.u, at.residual, at.slope)[1]
    square = _disagreement(informations, np.stack([-(x.T @ residual) for x in slopes])[:, None, :])[0]
    freedom = sum(_rank(x) for x in informations) - _rank(np.sum(informations, axis=0))
    if freedom < 1 or square <= float(stats.chi2.ppf(AGREED, freedom)):
        return True
    return bool(square <= np.quantile(_by_chance(bench, at, slopes, informations), AGREED))


def _own_slopes(bench: Bench, at: Fit, k: int, source: str) -> Real:
    """Return what the parameters of a cause do in one source and no other fitted parameter there, (N, m).

    The rows are those of all conditions, zero in those of other sources, and of the priors.
    """
    model, target = bench.model, bench.target
    rows = [r for r in target.observed if model.conditions[r].source == source]
    own = np.isin(at.free, model.of_cause[k])
    slope, _ = stacked(model, target.only(rows), at.free, at.u, at.residual, at.slope)
    basis = orthonormal(slope[:, ~own])
    mine = slope[:, own] - basis @ (basis.T @ slope[:, own])
    mine[:, np.linalg.norm(mine, axis=0) < 1e-4 * np.linalg.norm(slope[:, own], axis=0)] = 0.0
    found, begin = [], 0
    for r, residual in at.residual.items():
        end = begin + (residual.size if r in rows else 0)
        found.append(mine[begin:end] if r in rows else np.zeros((residual.size, mine.shape[1])))
        begin = end
    return np.concatenate([*found, mine[begin:]])


def _disagreement(informations: Sequence[Real], vectors: Real) -> Real:
    """Weighted squares of what the sources differ by, shape (d,), for score vectors (sources, d, m)."""
    pooled = np.sum(vectors, axis=0) @ _inverse(np.sum(informations, axis=0))
    square = np.zeros(vectors.shape[1])
    for information, vector in zip(informations, vectors, strict=True):
        away = vector - pooled @ information
        square += np.einsum("dm,mn,dn->d", away, _inverse(information), away)
    return square


def _by_chance(bench: Bench, at: Fit, slopes: Sequence[Real], informations: Sequence[Real]) -> Real:
    """Draw the same of noise that the data could have come from."""
    drawn = products_of_noise(bench.model, bench.tangent(at), slopes, bench.rng(8, *at.causes), DRAWS)
    return _disagreement(informations, np.stack(drawn))


def _inverse(information: Real) -> Real:
    return np.asarray(np.linalg.pinv(information, rcond=1e-8, hermitian=True))


def _rank(information: Real) -> int:
    return int(np.linalg.matrix_rank(information, rtol=1e-8, hermitian=True))
