"""Where a mode that nobody declared is seen in measured compliances, before anything is fitted with it.

Each entry of a compliance is, to first order in the errors of the poles that are known,

    Phi_ij(f) = sum_r [R_ij + F_ij d/d ln f_r + Z_ij d/d zeta_r] h_r(f) + C_ij + X_ij h_x(f),
    h_r(f) = 1/(1 - rho^2 + 2 j zeta_r rho),    rho = f/f_r,

with real factors, free in each entry: no error of a gain, of a direction or of a stiffness is taken for a mode.
Poles of h_x are tried over the band. Of the best the factors X are about ``c v v^T`` (one mode, compliance c along v).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from process.labels import AXES
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Values


def further_mode(model: ModalModel, measured: Sequence[tuple[Excited, Complex]]) -> Values:
    """Return the values of a further mode (SI) that explains most of what declared poles leave; none: nothing does.

    `measured`: compliances as they were measured, (f, entries), those of the same machine.
    """
    seen = [_thinned(excited, phi) for excited, phi in measured]
    first = min(f[0] for f, _, _ in seen)
    last = max(f[-1] for f, _, _ in seen)
    grid = np.geomspace(first, last, max(2, round(math.log(last / first) / RULES.further_step)))
    best: tuple[float, float, float, Real] = (0.0, 0.0, 0.0, np.zeros((3, 3)))
    left, count = 0.0, 0
    parts = []
    for (f, phi, std), (excited, _) in zip(seen, measured, strict=True):
        known = _known(model, f)
        for n, entry in enumerate(excited.entries):
            weight = math.sqrt(2.0) / np.tile(std[:, n], 2)  # `std` is that of real and imaginary part together
            base = np.linalg.qr(known * weight[:, None])[0]
            rest = np.concatenate([phi[:, n].real, phi[:, n].imag]) * weight
            rest = rest - base @ (base.T @ rest)
            left, count = left + float(rest @ rest), count + rest.size - base.shape[1]
            parts.append((f, weight, base, rest, tuple(AXES.index(a) for a in entry)))
    for zeta in RULES.further_damping:
        for at in grid:
            gain, residues, times = 0.0, np.zeros((3, 3)), np.zeros((3, 3))
            for f, weight, base, rest, (i, k) in parts:
                column = _stacked(_mode(f / at, zeta)) * weight
                column = column - base @ (base.T @ column)
                square = float(column @ column)
                factor = float(column @ rest) / max(square, 1e-300)
                if i == k and factor < 0.0:
                    continue  # the driving point of a mode is soft, never stiffer than nothing
                gain += factor**2 * square
                for a, b in {(i, k), (k, i)}:
                    residues[a, b] += factor * square
                    times[a, b] += square
            if gain > best[0]:
                best = gain, float(at), zeta, residues / np.where(times > 0.0, times, 1.0)
    gain, frequency, damping, residues = best
    if left < RULES.further_left * count or gain < RULES.further_share * left:
        return {}
    size, vectors = np.linalg.eigh(_completed(residues))
    x, y, z = vectors[:, -1]
    return {
        "mode_compliance": float(max(size[-1], 0.0)),
        "mode_frequency": frequency,
        "mode_damping": damping,
        "mode_azimuth": math.atan2(y, x),
        "mode_elevation": math.asin(max(-1.0, min(1.0, float(z)))),
    }


def _thinned(excited: Excited, phi: Complex) -> tuple[Real, Complex, Real]:
    """Return some of the lines of a compliance, evenly over the band."""
    every = max(1, excited.frequency.size // RULES.further_lines)
    return excited.frequency[::every], phi[::every], excited.std[::every]


def _mode(rho: Real, zeta: float) -> Complex:
    return np.asarray(1.0 / (1.0 - rho**2 + 2j * zeta * rho))


def _known(model: ModalModel, f: Real) -> Real:
    """Return what the poles that are known, each a little off, make of an entry, (2 f, columns)."""
    columns = [np.ones(f.size, dtype=complex)]
    for at, zeta in zip(model.frequency, model.damping, strict=True):
        rho = f / at
        h = _mode(rho, float(zeta))
        columns += [h, -(h**2) * (2.0 * rho**2 - 2j * zeta * rho), -2j * rho * h**2]
    return np.stack([_stacked(c) for c in columns], axis=1)


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _completed(residues: Real) -> Real:
    """Return factors of all entries: one that was not measured follows from the others of a single mode."""
    out = residues.copy()
    for k in range(3):
        others = [i for i in range(3) if i != k and residues[i, i] > 0.0]
        if residues[k, k] == 0.0 and others:
            i = max(others, key=lambda i: residues[i, i])
            out[k, k] = residues[i, k] ** 2 / residues[i, i]
    return out
