"""What a modal fit leaves: peaks that no reported mode describes, and modes that may be two.

A peak stands out when the response, as mobility and with every curve over its own size, is ten times
(`FitRules.stands_out`) its median around. It is explained by a reported mode within its half-power width, or within a
line.

Two modes at the frequencies ``f +- d/2`` with the residues of one look like one pole but for the third order of their
distance from it, ``R (pi d)^2/(j w - s)^3``. With sigma the noise of the lines, the distance at which what one
pole with a shift of its own cannot describe of it is as large as what decides on a second pole,

    d = 1/pi sqrt(sqrt(T)/|P R/(j w - s)^3|),    |.|^2 = 2 sum |.|^2/sigma^2,

is the resolution of the record at that mode: two modes nearer than that, and of one shape, look like one.
"""

from __future__ import annotations

import numpy as np
from scipy import signal

from process.types import Real
from smfe.modes.likelihood_ratio import threshold, window
from smfe.modes.pole_fit import PoleFit
from smfe.modes.response_matrix import running_mean
from smfe.modes.rules import RULES


def unexplained(fit: PoleFit, modes: Real) -> tuple[float, ...]:
    """Return the frequencies [Hz] of peaks of the response that no mode describes, rising.

    Parameters
    ----------
    fit : PoleFit
        A fit.
    modes : ndarray, shape (m, 2)
        Natural frequency [Hz] and damping ratio of the modes that are reported.
    """
    curves = fit.curves
    f, known = curves.frequency, np.isfinite(curves.std)
    power = np.where(known, np.abs(curves.values) ** 2, np.nan) * f**2
    size = np.nanmedian(power, axis=1)
    weight = 1.0 / np.where(size > 0.0, size, np.inf)
    whole = np.nansum(power * weight[:, None], axis=0)
    left = np.sum(np.where(known, np.abs(fit.left) ** 2, 0.0) * f**2 * weight[:, None], axis=0)
    noise = curves.std if curves.rough is None else curves.rough
    scatter = np.sum(np.where(known, noise, 0.0) ** 2 * f**2 * weight[:, None], axis=0)
    out: list[float] = []
    for power, share in ((whole, 0.0), (left, RULES.unexplained_share)):
        smooth = running_mean(power, 3)
        lines, _ = signal.find_peaks(np.log(np.maximum(smooth, 1e-300)), prominence=np.log(RULES.stands_out))
        for k in map(int, lines):
            top = max(k - 1, 0) + int(np.argmax(power[max(k - 1, 0) : k + 2]))
            if power[top] < (RULES.stands_out + np.log(f.size)) * scatter[top] or power[top] < share * whole[top]:
                continue
            spacing = float(f[min(top + 1, f.size - 1)] - f[max(top - 1, 0)])
            reach = np.maximum(1.5 * modes[:, 0] * modes[:, 1], spacing)
            if share == 0.0 and (np.abs(modes[:, 0] - f[top]) < reach).any():
                continue
            if all(abs(f[top] - other) > spacing for other in out):
                out.append(float(f[top]))
    return tuple(sorted(out))


def resolution(fit: PoleFit, number: int) -> float:
    """Return the distance [Hz] below which two modes of one shape would look like this one; NaN where not known."""
    natural, damping = fit.poles[number]
    where = window(fit, natural, RULES.reach * natural * damping)
    if where is None or number not in where.near:
        return float("nan")
    curves = where.curves
    f = curves.frequency
    s = 2.0 * np.pi * natural * (-damping + 1j * np.sqrt(1.0 - damping**2))
    pole = curves.over_lines(lambda x: 1.0 / (2j * np.pi * x - s))
    columns = np.stack([pole, pole**2, np.ones(f.size), (f - natural) / where.half], axis=1)
    spread = fit.inflation * fit.shared_lines
    total = 0.0
    pick = [fit.curves.pairs.index(pair) for pair in curves.pairs]
    for weight, residue in zip(curves.weight, fit.residue[number][pick], strict=True):
        q, _ = np.linalg.qr(columns * weight[:, None])
        third = residue * pole**3 * weight
        total += float(np.sum(np.abs(third - q @ (q.conj().T @ third)) ** 2)) / spread
    # What noise takes away of the evidence on average: the threshold is to be met by the signal alone.
    asked = np.sqrt(threshold(where))
    return float(np.sqrt(asked / np.sqrt(max(total, 1e-300))) / np.pi)
