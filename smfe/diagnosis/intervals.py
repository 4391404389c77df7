"""Intervals of the fitted parameters: from noise, and from what the best model leaves unexplained."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smfe.diagnosis.calibration import covariances_of_noise
from smfe.diagnosis.cross_validation import BAND
from smfe.diagnosis.evidence import Bench
from smfe.diagnosis.finding import Estimate
from smfe.diagnosis.fit import Fit, stacked
from smfe.diagnosis.misfit import Misfit
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
    clusters; Liang and Zeger, Biometrika 73, 1986).
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
    # What is seen of several only together says nothing of each: its variance would come out as zero.
    sd[moving] = np.where(1.0 - np.sum(np.square(right[told]), axis=0) > _SHARED**2, np.inf, sd[moving])
    return sd
