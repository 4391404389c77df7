"""Where a mode that nobody declared is seen in measured compliances, before anything is fitted with it.

Each entry of a compliance is, to first order in the errors of the poles that are known,

    Phi_ij(f) = sum_r [R_ij + F_ij d/d ln f_r + Z_ij d/d zeta_r] h_r(f) + C_ij + X_ij h_x(f),
    h_r(f) = 1/(1 - rho^2 + 2 j zeta_r rho),    rho = f/f_r,

with real factors, free in each entry: no error of a gain, of a direction or of a stiffness is taken for a mode. Over
all entries ``sum F_ij R_ij / sum R_ij^2`` is by how much ln f_r is off, and likewise the damping: poles that are a good
part of their width off are brought there so. Poles of h_x are tried over the band. Of the best the factors X are about
``c v v^T`` (one mode, compliance c along v).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from process.labels import AXES
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Values


def further_mode(model: ModalModel, measured: Sequence[tuple[Excited, Complex]]) -> Values:
    """Return the values of a further mode (SI) that explains most of what declared poles leave; none: nothing does.

    `measured`: compliances as they were measured [m/N], (f, entries), those of the same machine.
    """
    every = [_Seen.of(excited, phi) for excited, phi in measured]
    said = np.array([model.frequency, model.damping], dtype=float)

    def brought(poles: Real) -> tuple[float, list[Real]]:
        """Return what poles leave of all measurements where each has them, and where that is."""
        there = [seen.brought(poles) for seen in every]
        return sum(float(e.rest @ e.rest) for seen, at in zip(every, there, strict=True) for e in seen.left(at)), there

    without, alone = brought(said)
    # Poles that are brought to where the data have them may take up a mode beside them, and where they are not they may
    # leave more than it is: both are tried, and that stands which leaves less with all poles brought there together.
    tried = (_best_pole(every, known) for known in ([said] * len(every), alone))
    left, together = min((brought(np.column_stack([said, pole])) for pole in tried), key=lambda one: one[0])
    if without - left < RULES.further_share * without:
        return {}
    factors, squares = np.zeros((2, 3, 3))
    for seen, at in zip(every, together, strict=True):
        for e in seen.left(at[:, :-1], at[:, -1:]):
            for a, b in {e.entry, e.entry[::-1]}:
                factors[a, b] += e.columns[:, 0] @ e.rest
                squares[a, b] += e.columns[:, 0] @ e.columns[:, 0]
    compliance, vectors = np.linalg.eigh(_completed(factors / np.maximum(squares, 1e-300)))
    x, y, z = vectors[:, -1]
    frequency, damping = np.mean([at[:, -1] for at in together], axis=0)
    return {
        "mode_compliance": float(max(compliance[-1], 0.0)),
        "mode_frequency": float(frequency),
        "mode_damping": float(damping),
        "mode_azimuth": math.atan2(y, x),
        "mode_elevation": math.asin(max(-1.0, min(1.0, float(z)))),
    }


@dataclass(frozen=True)
class _Left:
    """What known poles leave of an entry (response, excitation), and of further poles, both over the noise."""

    entry: tuple[int, int]
    rest: Real  # (2 f,)
    columns: Real  # (2 f, poles)
    own: Real  # share of the square of a further pole that known ones leave, (poles,)


@dataclass(frozen=True)
class _Seen:
    """Some lines of a measurement [Hz], (f,), and its entries over the noise of a part, (2 f, entries)."""

    frequency: Real
    entries: tuple[tuple[int, int], ...]
    weight: Real  # one over the standard deviation of real and imaginary part
    phi: Real

    @classmethod
    def of(cls, excited: Excited, phi: Complex) -> _Seen:
        """Return some of the lines of a compliance, evenly over the band."""
        above = np.flatnonzero(excited.frequency > 0.0)
        kept = above[:: max(1, above.size // RULES.further_lines)]
        weight = math.sqrt(2.0) / np.tile(excited.std[kept], (2, 1))  # `std` is that of both parts together
        entries = tuple((AXES.index(r), AXES.index(e)) for r, e in excited.entries)
        return cls(excited.frequency[kept], entries, weight, _stacked(phi[kept]) * weight)

    def left(self, known: Real, further: Real | None = None) -> Iterator[_Left]:
        """Yield what known poles, (2, n), leave of each entry and of further ones, (2, m)."""
        columns = self._of(known)
        at = np.zeros((2, 0)) if further is None else further
        more = _stacked(_mode(self.frequency[:, None] / at[0], at[1]))
        for n, entry in enumerate(self.entries):
            weight = self.weight[:, n, None]
            base = np.linalg.qr(columns * weight)[0]
            rest = self.phi[:, n] - base @ (base.T @ self.phi[:, n])
            own = more * weight
            whole = np.sum(own**2, axis=0)
            own -= base @ (base.T @ own)
            share = np.sum(own**2, axis=0) / np.maximum(whole, 1e-300)
            yield _Left(entry, rest, own, share)

    def brought(self, said: Real) -> Real:
        """Return frequencies [Hz] and damping ratios of poles, (2, n), about where the measurement has them."""
        at, zeta = said
        for _ in range(RULES.further_rounds):
            columns = self._of(np.array([at, zeta]))
            size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            own, frequency, damping = np.zeros((3, at.size))
            for n in range(len(self.entries)):
                weight = self.weight[:, n, None]
                fitted = np.linalg.lstsq(columns / size * weight, self.phi[:, n], rcond=1e-9)[0] / size
                r, df, dz = fitted[:-1].reshape(-1, 3).T * np.median(weight)
                own, frequency, damping = own + r**2, frequency + r * df, damping + r * dz
            own = np.maximum(own, 1e-300)
            # A step is no longer than a slope holds, and no pole goes where another mode would be.
            step = np.clip(frequency / own, -0.5 * zeta, 0.5 * zeta)
            at = np.clip(at * (1.0 + step), said[0] * (1.0 - RULES.further_off), said[0] * (1.0 + RULES.further_off))
            zeta = np.clip(zeta + np.clip(damping / own, -0.3 * zeta, 0.3 * zeta), 0.5 * said[1], 2.0 * said[1])
        return np.array([at, zeta])

    def _of(self, poles: Real) -> Real:
        """Return what poles, each a little off, make of an entry, (2 f, 3 a pole and one)."""
        rho = self.frequency[:, None] / poles[0]
        h = _mode(rho, poles[1])
        parts = h, -(h**2) * (2.0 * rho**2 - 2j * poles[1] * rho), -2j * rho * h**2
        columns = np.stack(parts, axis=2).reshape(rho.shape[0], -1)
        return _stacked(np.column_stack([columns, np.ones(rho.shape[0], dtype=complex)]))


def _best_pole(every: Sequence[_Seen], known: Sequence[Real]) -> Real:
    """Return frequency [Hz] and damping ratio of the pole that explains most of what known ones leave."""
    first, last = (pick(float(x) for s in every for x in s.frequency[[0, -1]]) for pick in (min, max))
    poles = np.concatenate([_grid(first, last, zeta) for zeta in RULES.further_damping], axis=1)
    gain = np.zeros(poles.shape[1])
    for seen, at in zip(every, known, strict=True):
        for e in seen.left(at, poles):
            along, size = e.columns.T @ e.rest, np.sum(e.columns**2, axis=0)
            # What known poles do as well says nothing. A driving point is soft, never stiffer than nothing.
            telling = (e.own > RULES.further_own) & ((e.entry[0] != e.entry[1]) | (along > 0.0))
            gain += np.divide(along**2, size, out=np.zeros(size.size), where=telling)
    return np.asarray(poles[:, int(np.argmax(gain))])


def _grid(first: float, last: float, zeta: float) -> Real:
    """Return poles of a damping ratio over a band, a width of each apart, (2, n)."""
    at = np.geomspace(first, last, max(2, round(math.log(last / first) / zeta) + 1))
    return np.array([at, np.full(at.size, zeta)])


def _mode(rho: Real, zeta: Real) -> Complex:
    return np.asarray(1.0 / (1.0 - rho**2 + 2j * zeta * rho))


def _stacked(values: Complex) -> Real:
    return np.concatenate([values.real, values.imag])


def _completed(factors: Real) -> Real:
    """Return factors of all entries: one that was not measured follows from the others of a single mode."""
    out = factors.copy()
    for k in range(3):
        others = [i for i in range(3) if i != k and factors[i, i] > 0.0]
        if factors[k, k] == 0.0 and others:
            i = max(others, key=lambda i: factors[i, i])
            out[k, k] = factors[i, k] ** 2 / factors[i, i]
    return out
