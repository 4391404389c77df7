"""Sweeps by overlapping Hann segments: one least squares a frequency, with the segments as its columns.

`Segments`
    all three forces are references, with the leakage terms of the window up to second order.
`SingleReference`
    cross-spectra with one force as the only reference and a 3x3 solve: kept to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy import fft

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.errors.result import in_words
from smfe.identification.spectra.spectra import BlockSpectra, block_spectra, hann
from smfe.identification.sweep.least_squares import Columns, Estimate, condition_number, solve
from smfe.identification.sweep.passes import PreparedPass

Step = Callable[[int, int], None]
"""Called with (done, of)."""


HANN_ERROR_LINES = 1.5
"""How many lines of a Hann window share an error: its noise bandwidth."""


# --- all references ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Segments:
    """Overlapping Hann segments of all passes.

    A windowed record obeys ``X_w = sum_n Phi^(n)/(n! (2 pi j)^n) F_n`` where F_n is the force seen through the n-th
    derivative of the window; terms up to `leakage_order` are kept as nuisance regressors.

    Parameters
    ----------
    resolution : float, optional
        Line spacing [Hz]; a segment lasts 1/resolution.
    overlap : float, optional
        Share of a segment that the next one repeats.
    leakage_order : {0, 1, 2}, optional
        Terms kept beyond the plain one. With fewer than 2 the bias of the window is not in ``compliance_std``.
    """

    resolution: float = 0.5
    overlap: float = 0.75
    leakage_order: int = 2

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[PreparedPass]) -> Real:
        """Return the frequency axis [Hz]: the lines of a segment."""
        dt = passes[0].interval
        lines = fft.rfftfreq(round(1.0 / (self.resolution * dt)), dt)
        inside = (lines >= frequency_range[0] - 1e-9) & (lines <= frequency_range[1] + 1e-9)
        return np.asarray(lines[inside])

    def solve(
        self,
        passes: Sequence[PreparedPass],
        frequency: Real,
        axes: Sequence[str],
        response: Sequence[str],
        progress: Step | None = None,
    ) -> Estimate:
        """Solve with the segments as columns, weighted with the inverse noise of their pass."""
        columns, excitations = list(self.columns(passes, frequency, response, axes)), len(axes)
        short = [
            (c, f) for c, f in zip(columns, frequency, strict=True) if c.response.shape[1] <= c.regressors.shape[0]
        ]
        if len(short) > len(columns) // 2:
            least, at = short[0]
            raise InputError(
                f"the passes give {least.response.shape[1]} columns for {least.regressors.shape[0]} unknowns at "
                f"{at:g} Hz and elsewhere; record longer passes, or choose a coarser resolution or a wider band"
            )
        noise = _noise(columns, excitations)
        solutions = []
        for i, c in enumerate(columns):
            solutions.append(solve(c, excitations, noise[i]))
            if progress is not None:
                progress(i + 1, len(columns))
        found = Estimate(
            np.array([s.compliance for s in solutions]),
            np.array([s.covariance for s in solutions]),
            np.array([s.coherence for s in solutions]),
            np.array([s.condition for s in solutions]),
            HANN_ERROR_LINES,
            degrees_of_freedom=np.array([s.degrees_of_freedom for s in solutions]),
        )
        if not short:
            return found
        where = in_words(frequency, np.isin(frequency, [f for _, f in short]))
        text = f"not solved: too few columns for the unknowns in {where}; sweep more slowly, or choose a wider band"
        return replace(found, warnings=(text,))

    def columns(
        self,
        passes: Sequence[PreparedPass],
        frequency: Real,
        response: Sequence[str],
        axes: Sequence[str] = ("x", "y", "z"),
    ) -> Iterator[Columns]:
        """Yield the columns of each frequency."""
        reach = (float(frequency[0]), float(frequency[-1]))
        orders = range(self.leakage_order + 1)
        seen = [[self.blocks(p, reach, response, order) for p in passes] for order in orders]
        plain = seen[0]
        for p, b in zip(passes, plain, strict=True):
            if b.frequency.shape != frequency.shape or not np.allclose(b.frequency, frequency, rtol=1e-9):
                raise InputError(
                    f"pass '{p.label}' is sampled at another rate than the first, so its segments have other lines; "
                    "use the local polynomial, which needs no common rate, or resample"
                )
        test = np.concatenate([np.full(b.force.shape[2], i) for i, b in enumerate(plain)])
        motion = np.concatenate([b.displacement for b in plain], axis=2)
        rows = [[b.excitation.index(a) for a in axes] for b in plain]
        force = np.concatenate(
            [np.concatenate([b.force[:, r] for b, r in zip(blocks, rows, strict=True)], axis=2) for blocks in seen],
            axis=1,
        )
        for line, f0 in enumerate(frequency):
            yield Columns(force[line], motion[line], test, _overlap_matrix(plain, f0))

    def blocks(
        self, sweep: PreparedPass, reach: tuple[float, float], response: Sequence[str], derivative: int = 0
    ) -> BlockSpectra:
        """Return the spectra of all segments of a pass, through the window or one of its derivatives."""
        dt = sweep.interval
        length = round(1.0 / (self.resolution * dt))
        hop = max(1, round(length * (1.0 - self.overlap)))
        starts = range(0, sweep.record.sizes["time"] - length + 1, hop)
        if not len(starts):
            raise InputError(
                f"pass '{sweep.label}' lasts {sweep.record.sizes['time'] * dt:.3g} s, less than one segment of "
                f"{length * dt:.3g} s; choose a coarser resolution than {self.resolution:g} Hz"
            )
        turn = 2.0 * np.pi * np.arange(length) / length
        # The Hann window and its derivatives with respect to time over the segment; scale does not matter.
        window = (hann(length), np.sin(turn), np.cos(turn))[derivative]
        return block_spectra(sweep.record, starts, length, window, reach, detrend=derivative == 0, response=response)


def _overlap_matrix(blocks: Sequence[BlockSpectra], frequency: float) -> Complex:
    """Correlation of white noise between all segments of all tests at one frequency, ``E[n_a conj(n_b)]``."""
    sizes = [b.force.shape[2] for b in blocks]
    out = np.zeros((sum(sizes), sum(sizes)), dtype=complex)
    start = 0
    for b, size in zip(blocks, sizes, strict=True):
        lag = np.arange(size)[:, None] - np.arange(size)[None, :]
        rho = np.zeros(size)
        used = min(size, b.neighbour_correlation.size)
        rho[:used] = b.neighbour_correlation[:used]
        phase = np.exp(2j * np.pi * frequency * b.hop * lag)
        out[start : start + size, start : start + size] = rho[np.abs(lag)] * phase
        start += size
    return out


def _noise(columns: Sequence[Columns], excitations: int, rounds: int = 4) -> Real:
    """Learn the noise power of each response in each pass, shape (f, r, tests).

    The first round weights all passes alike, so that a noisy one leaves its mark on the residual of the quiet ones;
    solving again with what was learnt takes it away.
    """
    noise: Real | None = None
    for _ in range(rounds):
        residual = [solve(c, excitations, None if noise is None else noise[i]).residual for i, c in enumerate(columns)]
        noise = _smooth_noise(np.array(residual))
    assert noise is not None
    return noise


def _smooth_noise(residual: Real, reach: int = 8) -> Real:
    """Take the median residual power over neighbouring frequencies; keep weights within 1:1000."""
    filled = pd.DataFrame(residual.reshape(residual.shape[0], -1))
    smooth = filled.rolling(2 * reach + 1, center=True, min_periods=1).median().bfill().ffill().to_numpy()
    noise = smooth.reshape(residual.shape)
    largest = np.max(np.nan_to_num(noise), axis=2, keepdims=True)
    floor = np.where(largest > 0.0, 1e-6 * largest, 1.0)
    return np.where(np.isfinite(noise), np.maximum(noise, floor), 1.0)


# --- a single reference -----------------------------------------------------------------------------------------------


_LEAKS = {1: 0.5j, 2: -0.25}
"""Terms of a Hann window, ``Phi^(n)/(n! (-2 pi j)^n)`` times the force through its nth derivative, where this is taken
without its factor ``(2 pi df)^n/2``."""


@dataclass(frozen=True)
class SingleReference:
    """Cross-spectra of every channel with one force, then a 3x3 solve: one column a pass.

    Parameters
    ----------
    reference : {"x", "y", "z"}, optional
        The force that everything is correlated with.
    resolution : float, optional
        Line spacing [Hz].
    overlap : float, optional
        Share of a Hann segment that the next one repeats.
    """

    reference: str = "x"
    resolution: float = 0.25
    overlap: float = 0.5

    @property
    def segments(self) -> Segments:
        """The segments it averages over."""
        return Segments(self.resolution, self.overlap, 0)

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[PreparedPass]) -> Real:
        """Return the frequency axis [Hz]."""
        return self.segments.axis(frequency_range, passes)

    def solve(
        self,
        passes: Sequence[PreparedPass],
        frequency: Real,
        axes: Sequence[str],
        response: Sequence[str],
        progress: Step | None = None,
    ) -> Estimate:
        """Solve the 3x3 system of cross-spectra at each frequency."""
        if len(axes) < 3:
            raise InputError("a single reference needs the forces on x, y and z; take estimator or axes out")
        reach = float(frequency[0]), float(frequency[-1])
        sxf, sff = self.cross_spectra(passes, reach, response)
        gains, conditions = [], []
        for x, f in zip(sxf, sff, strict=True):
            conditions.append(condition_number(f))
            singular = not np.isfinite(conditions[-1])
            gains.append(np.full((*x.shape[:1], 3), np.nan) if singular else np.linalg.lstsq(f.T, x.T, rcond=None)[0].T)
        phi = np.array(gains, dtype=complex)
        inverse = np.linalg.pinv(sff)
        # Errors of the cross-spectra of a pass, (f, r, passes): scatter of its segments, and leakage of the window.
        variance, leaked, degrees_of_freedom = [], [], []
        slopes = [np.gradient(phi, frequency, axis=0)]
        slopes.append(np.gradient(slopes[0], frequency, axis=0))
        for p in passes:
            x, f, blocks = self.products(p, reach, response)
            scatter, independent = _scatter_of_mean(x - np.einsum("fre,fes->frs", phi, f), blocks)
            variance.append(scatter)
            degrees_of_freedom.append(independent)
            bias = np.zeros_like(x[..., 0])
            for order, slope in enumerate(slopes, start=1):
                through = self.products(p, reach, response, order)[1].mean(axis=2)
                bias += np.einsum("fre,fe->fr", slope, through) * _LEAKS[order] * (self.resolution) ** order
            leaked.append(bias)
        bias = np.einsum("frp,fpe->fre", np.stack(leaked, axis=2), inverse)
        covariance = np.einsum("frp,fpe,fpg->freg", np.stack(variance, axis=2), inverse, inverse.conj(), optimize=True)
        covariance = covariance + bias[..., :, None] * bias[..., None, :].conj()
        return Estimate(
            phi,
            covariance,
            np.full(phi.shape[:2], np.nan),
            np.array(conditions),
            HANN_ERROR_LINES,
            degrees_of_freedom=np.full(phi.shape[:2], 2.0 * min(degrees_of_freedom)),
        )

    def cross_spectra(
        self, passes: Sequence[PreparedPass], reach: tuple[float, float], response: Sequence[str]
    ) -> tuple[Complex, Complex]:
        """Return S_XF and S_FF with the reference, each of shape (frequencies, rows, passes)."""
        sxf, sff = [], []
        for p in passes:
            x, f, _ = self.products(p, reach, response)
            sxf.append(x.mean(axis=2))
            sff.append(f.mean(axis=2))
        return np.stack(sxf, axis=2), np.stack(sff, axis=2)

    def products(
        self, sweep: PreparedPass, reach: tuple[float, float], response: Sequence[str], derivative: int = 0
    ) -> tuple[Complex, Complex, BlockSpectra]:
        """Return the products of motion and force with the reference, segment by segment, and the segments.

        With a `derivative` the force is seen through that of the window, the reference through the window itself.
        """
        plain = self.segments.blocks(sweep, reach, response)
        reference = plain.force[:, [plain.excitation.index(self.reference)], :].conj()
        seen = plain if derivative == 0 else self.segments.blocks(sweep, reach, response, derivative)
        return plain.displacement * reference, seen.force * reference, plain


def _scatter_of_mean(residual: Complex, blocks: BlockSpectra) -> tuple[Real, float]:
    """Return the variance of the mean over segments, (f, r), and how many segments it rests on.

    Segments in which the sweep is far from a line say nothing of it: each counts with its own residual (White 1980),
    and as much more as neighbours share noise.
    """
    power = np.abs(residual) ** 2
    rho = blocks.neighbour_correlation
    shared = 1.0 + 2.0 * float(np.sum(rho[1:] ** 2))
    effective = np.median(power.sum(axis=2) ** 2 / np.maximum((power**2).sum(axis=2), 1e-300)) / shared
    used = max(float(effective) - 1.0, 1.0)
    # The mean of the residual is zero by construction, which takes one segment.
    variance = shared * power.sum(axis=2) / power.shape[2] ** 2 * (used + 1.0) / used
    return np.asarray(variance), used
