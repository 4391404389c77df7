"""Intervals of the fitted parameters: from noise, from what the best model leaves, and from what it may do wrong.

Two simulations of one machine differ a little, and not at random from line to line: a servo that is simulated as a
continuous one is off like a gain of the servo. Let R be the slopes of all N lines over their predictions, and P the
mean over conditions that are the same to a simulation (other places, other times): it is wrong alike there. The error
``P R a`` with ``a ~ N(0, delta^2 N/p B^-1)``, ``B = (P R)^T P R``, has the root mean square delta. Least squares take
it for ``A^-1 B a`` with ``A = R^T R``: the covariance of the p parameters grows by ``delta^2 N/p A^-1 B A^-1``, however
many lines and conditions there are; ``delta^2 N/p A^-1`` where no two conditions are alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from smfe.diagnosis.calibration import covariances_of_noise
from smfe.diagnosis.cross_validation import BAND
from smfe.diagnosis.evidence import Bench
from smfe.diagnosis.finding import Estimate
from smfe.diagnosis.fit import Fit, stacked
from smfe.diagnosis.misfit import Misfit
from smfe.diagnosis.model import Model
from smfe.diagnosis.signature import inside
from smfe.diagnosis.verdict import Judgement

_INTERVAL = 1.959964

_TOLD, _SHARED = 1e-9, 1e-3
"""Singular value, relative, below which the data say nothing of a direction; its share in a parameter that counts."""


def estimates(bench: Bench, at: Fit, k: int, judged: Judgement) -> tuple[Estimate, ...]:
    """Return parameters of a cause with 95 % intervals, infinite where the data do not tell a parameter from others."""
    model = bench.model
    sd = deviations(bench, at, judged.misfit)
    found = []
    for j in model.of_cause[k]:
        place, p = int(np.flatnonzero(at.free == j)[0]), model.parameters[j]
        value, half = p.start + p.scale * float(at.u[j]), _INTERVAL * p.scale * float(sd[place])
        low, high = (max(value - half, p.low), min(value + half, p.high)) if half < math.inf else (-half, half)
        found.append(Estimate(p.name, value * p.shown, low * p.shown, high * p.shown, p.unit))
    return tuple(found)


def deviations(bench: Bench, at: Fit, left: Misfit | None) -> NDArray[np.float64]:
    """Return the standard deviations of the scaled fitted parameters.

    They are those of white noise, or the mean over the noises that the data could have come from. Where more than that
    is left, the remainder is not white and not the same in all conditions: the larger counts of the noise scaled to its
    size and of the scatter of what each condition by itself does to the estimate (sandwich with the conditions as
    clusters; Liang and Zeger, Biometrika 73, 1986). What the family says that its predictions may be off comes on top.
    """
    slope, _ = stacked(bench.model, bench.target, at.free, at.u, at.residual, at.slope)
    size = np.linalg.norm(slope, axis=0)
    moving = inside(bench.model, at) & (size > 0.0)
    rotated, singular, right = np.linalg.svd((slope / np.where(size > 0.0, size, 1.0))[:, moving], full_matrices=False)
    told = singular > _TOLD * singular.max(initial=0.0)
    inverse = (right[told].T / singular[told]) @ rotated[:, told].T / size[moving, None]
    sd = np.where(size > 0.0, 0.0, np.inf)
    covariances = covariances_of_noise(bench.model, at.residual, inverse.T)
    sd[moving] = np.sqrt(np.mean([np.diag(c) for c in covariances], axis=0))
    if left is not None and left.chance < BAND:
        ends = np.cumsum([r.size for r in at.residual.values()])
        data, prior = inverse[:, : ends[-1]], inverse[:, ends[-1] :]
        pulls = [a @ r for a, r in zip(np.split(data, ends[:-1], axis=1), at.residual.values(), strict=True)]
        scatter = np.sum(np.square(pulls), axis=0) * len(pulls) / max(len(pulls) - 1, 1)
        robust = np.sqrt(scatter + np.sum(np.square(prior), axis=1))
        sd[moving] = np.maximum(sd[moving] * math.sqrt(max(left.ratio, 1.0)), robust)
    sd[moving] = np.hypot(sd[moving], _off(bench.model, at, moving))
    # What is seen of several only together says nothing of each: its variance would come out as zero.
    sd[moving] = np.where(1.0 - np.sum(np.square(right[told]), axis=0) > _SHARED**2, np.inf, sd[moving])
    return sd


def _off(model: Model, at: Fit, moving: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the standard deviations that errors of the predictions add to some scaled fitted parameters."""
    family, count = model.family, int(moving.sum())
    share = float(getattr(family, "model_error", 0.0))
    if share == 0.0 or count == 0:
        return np.zeros(count)
    rows = list(at.slope)
    each = [
        family.relative(model.conditions[r], model.predict(r, at.u), at.slope[r][:, moving])  # type: ignore[attr-defined]
        for r in rows
    ]
    labels = family.alike([model.conditions[r] for r in rows])  # type: ignore[attr-defined]
    shared = {k: np.mean([x for x, label in zip(each, labels, strict=True) if label == k], axis=0) for k in set(labels)}
    slope, wrong = (_real(x) for x in (each, [shared[k] for k in labels]))
    size = np.linalg.norm(slope, axis=0)
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv(slope / size, rcond=_TOLD) / size[:, None]
    taken = inverse @ inverse.T @ wrong.T
    return np.asarray(share * np.sqrt(len(slope) / 2.0 / count * np.sum(np.square(taken), axis=1)))


def _real(each: Sequence[NDArray[np.complex128]]) -> NDArray[np.float64]:
    """Complex rows of several conditions as real ones: real parts, then imaginary ones."""
    whole = np.concatenate(list(each))
    return np.concatenate([whole.real, whole.imag])
