"""Forces of a drive that repeat along the stroke: cogging of a motor, ripple of a screw or of a guideway.

``sum over k of (a cos kx + b sin kx) + s (c cos kx + d sin kx)``, s the way of motion: the first pair is a force of the
place alone, the second is friction. They belong into the balance, because slow motion stays within one wave, where
their mean is not zero.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize, special, stats

from process.types import Real
from smfe.identification.drive.correlated_residual import independent_values
from smfe.identification.drive.motion import Balance
from smfe.identification.drive.rules import RULES


def ripple_columns(b: Balance, wave: float, band: float) -> Real:
    """Return the columns of one wave number [1/m or 1/rad], low-passed as the force is, shape (n, 2 or 4)."""
    rate = np.abs(wave * b.velocity.sum(axis=0)) / (2.0 * math.pi)
    width = band / RULES.roll
    passed = 0.5 * (special.erf((rate + band) / width) - special.erf((rate - band) / width))
    pair = passed[:, None] * np.column_stack([np.cos(wave * b.place), np.sin(wave * b.place)])
    way = b.share[0] - b.share[1]
    both = bool((way > 0.5).any() and (way < -0.5).any())
    return np.hstack([pair, way[:, None] * pair]) if both else pair


def waves_of(b: Balance, columns: Real, force: Real, band: float) -> list[float]:
    """Find wave numbers that the balance of `columns` (n, p) and `force` (n,) misses beyond noise, largest first."""
    stride = max(1, math.ceil(force.size / RULES.most_values))
    thin = b.thinned(stride)
    length = float(np.ptp(thin.place))
    slow = float(np.quantile(np.abs(thin.velocity.sum(axis=0)), 0.3))
    highest = min(RULES.most_tried, int(2.0 * length * band / max(slow, 1e-300)), force.size // stride // 4)
    if length <= 0.0 or highest < 2:
        return []
    tried = math.pi / length * np.arange(2.0, highest + 1.0)
    found: list[float] = []
    used, target = columns[::stride], force[::stride]
    for _ in range(RULES.most_waves):
        q = np.linalg.qr(used / np.maximum(np.sqrt(np.mean(used**2, axis=0)), 1e-300))[0]
        left = target - q @ (q.T @ target)
        power = float(left @ left)

        def remaining(wave: float, q: Real = q, left: Real = left) -> float:
            c = ripple_columns(thin, float(wave), band)
            return float(left @ left - np.square(np.linalg.qr(c - q @ (q.T @ c))[0].T @ left).sum())

        at = float(tried[np.argmin([remaining(wave) for wave in tried])])
        near = optimize.minimize_scalar(remaining, bounds=(at - tried[0] / 2, at + tried[0] / 2), method="bounded")
        independent = independent_values(left, thin.run)
        gained = independent * math.log(power / max(float(near.fun), 1e-12 * power))
        added = ripple_columns(thin, float(near.x), band)
        if stats.chi2.sf(gained, added.shape[1] + 1) > RULES.false_wave / tried.size:
            break
        found.append(float(near.x))
        used = np.hstack([used, added])
    return found
