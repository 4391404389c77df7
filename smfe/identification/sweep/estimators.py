"""How the records of sweep passes become the columns of a least squares problem at each frequency.

`LocalPolynomial`
    transform of the whole record, neighbouring lines, the compliance a polynomial over them (Pintelon and Schoukens
    2012, ch. 7). Free of leakage at any sweep rate for a record that runs from rest to rest; otherwise a polynomial
    takes up the transient.
`Segments`
    overlapping Hann segments, with the leakage terms of the window up to second order.
`SingleReference`
    cross-spectra with one force as the only reference and a 3x3 solve: kept to compare with.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from process.cut.engagement import Engagement
from process.errors import InputError
from process.labels import axis_present, sample_interval
from process.types import Complex, Real
from smfe.identification.spectra.spectra import BlockSpectra, block_spectra, hann, motion_axes
from smfe.identification.sweep.delay import Delay
from smfe.identification.sweep.least_squares import Columns

Frequencies = Real


@dataclass(frozen=True)
class SweepPass:
    """One pass of a sweep.

    Parameters
    ----------
    record : xarray.Dataset
        Forces on x, y, z and motion.
    label : str
        What the pass is called in messages, e.g. "down, 12 mm".
    arc : Engagement, optional
        Its arc of engagement, for the check of independence before anything is solved.
    speeds : (float, float), optional
        Stated spindle rotation where the cut begins and ends [rad/s], to compare the clock of the record with.
    """

    record: xr.Dataset = field(repr=False)
    label: str
    arc: Engagement | None = None
    speeds: tuple[float, float] | None = None


@dataclass(frozen=True)
class LocalPolynomial:
    """Whole-record transform; over a band around each frequency the compliance is a polynomial.

    A wide band averages more noise, a narrow one bends with a lightly damped mode. Each band of `half_widths` is tried
    and, row by row, the widest one is taken that agrees with all narrower ones within `agreement` standard deviations
    of these (Lepski's rule).

    Parameters
    ----------
    resolution : float, optional
        Step of the resulting frequency axis [Hz].
    half_widths : tuple of float, optional
        Half widths of the bands to choose from [Hz], rising.
    order : int, optional
        Order of the polynomial.
    agreement : float, optional
        Largest accepted difference, in standard deviations.
    rational : bool, optional
        Fit a rational model to the whole band, too, and take it but where a band contradicts it (`sweep.rational`).
    instrument_teeth : int, optional
        Teeth of the tool, to use the passing of the teeth as instrument: only the part of the forces that goes with
        harmonics of the spindle angle counts. Against bias by regeneration.
    position_dependent : bool, optional
        Let the compliance change along the pass, in proportion to the way from its middle; twice as many unknowns.
    """

    resolution: float = 0.25
    half_widths: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    order: int = 2
    agreement: float = 2.0
    rational: bool = True
    instrument_teeth: int | None = None
    position_dependent: bool = False

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> Frequencies:
        """Return the frequency axis [Hz]."""
        low, high = (round(f / self.resolution) for f in frequency_range)
        return np.asarray(np.arange(low, high + 1) * self.resolution)

    def reach(self, frequency: Frequencies) -> tuple[float, float]:
        """Return the band [Hz] whose lines are needed."""
        widest = max(self.half_widths)
        return max(float(frequency[0]) - widest, 0.1), float(frequency[-1]) + widest

    def unknowns(self, restless: Sequence[bool]) -> int:
        """Return the number of unknowns a row, with three forces and no air cut."""
        return (self.order + 1) * (3 + sum(restless))

    def error_lines(self, half_width: float) -> float:
        """Return how many lines of the axis share an error.

        The estimate at the centre is a weighted mean over the band; ``1/sum(weight^2)`` is its effective width, 8/9 of
        the half width for order 2.
        """
        shift = np.linspace(-1.0, 1.0, 401)
        weight = np.linalg.pinv(shift[:, None] ** np.arange(self.order + 1))[0]
        return max(1.0, 2.0 * half_width / (self.resolution * shift.size * float(weight @ weight)))


BANDS = LocalPolynomial(half_widths=(0.125, 0.25, 0.5, 1.0), agreement=2.5, rational=False)
"""Narrow bands alone. The default errs less."""

HANN_ERROR_LINES = 1.5
"""How many lines of a Hann window share an error: its noise bandwidth."""


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

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> Frequencies:
        """Return the frequency axis [Hz]: the lines of a segment."""
        dt = sample_interval(passes[0].record)
        lines = fft.rfftfreq(round(1.0 / (self.resolution * dt)), dt)
        inside = (lines >= frequency_range[0] - 1e-9) & (lines <= frequency_range[1] + 1e-9)
        return np.asarray(lines[inside])

    def columns(
        self,
        passes: Sequence[SweepPass],
        frequency: Frequencies,
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
        self, sweep: SweepPass, reach: tuple[float, float], response: Sequence[str], derivative: int = 0
    ) -> BlockSpectra:
        """Return the spectra of all segments of a pass, through the window or one of its derivatives."""
        dt = sample_interval(sweep.record)
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

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> Frequencies:
        """Return the frequency axis [Hz]."""
        return self.segments.axis(frequency_range, passes)

    def cross_spectra(
        self, passes: Sequence[SweepPass], reach: tuple[float, float], response: Sequence[str]
    ) -> tuple[Complex, Complex]:
        """Return S_XF and S_FF with the reference, each of shape (frequencies, rows, passes)."""
        sxf, sff = [], []
        for p in passes:
            x, f, _ = self.products(p, reach, response)
            sxf.append(x.mean(axis=2))
            sff.append(f.mean(axis=2))
        return np.stack(sxf, axis=2), np.stack(sff, axis=2)

    def products(
        self, sweep: SweepPass, reach: tuple[float, float], response: Sequence[str], derivative: int = 0
    ) -> tuple[Complex, Complex, BlockSpectra]:
        """Return the products of motion and force with the reference, segment by segment, and the segments.

        With a `derivative` the force is seen through that of the window, the reference through the window itself.
        """
        plain = self.segments.blocks(sweep, reach, response)
        reference = plain.force[:, [plain.excitation.index(self.reference)], :].conj()
        seen = plain if derivative == 0 else self.segments.blocks(sweep, reach, response, derivative)
        return plain.displacement * reference, seen.force * reference, plain


Estimator = LocalPolynomial | Segments | SingleReference


def whole_record(record: xr.Dataset, reach: tuple[float, float], response: Sequence[str]) -> BlockSpectra:
    """Transform the whole record, padded with rest to a length that transforms fast."""
    n = record.sizes["time"]
    length = int(fft.next_fast_len(n, real=True))
    return block_spectra(record, [0], n, None, reach, detrend=False, response=response, padded=length)


def end_pieces(record: xr.Dataset, channel: str, duration: float = 0.1) -> Real:
    """Return the rms of consecutive pieces of a channel, shape (axes, pieces)."""
    n = record.sizes["time"]
    piece = min(max(8, round(duration / sample_interval(record))), n)
    # One axis at a time: the squares of a long record need as much room as the record.
    rows = (record[channel].sel(axis=a).values[: n // piece * piece] for a in axis_present(record, channel))
    return np.array([np.sqrt(np.mean(row.reshape(-1, piece) ** 2, axis=1)) for row in rows])


def at_rest(record: xr.Dataset) -> bool:
    """Whether the record begins and ends in the air, with the motion decayed.

    The tool enters and leaves the work for all axes at once, so the axis whose force stands out most from its own
    quietest 0.1 s tells the air; an axis with little force and much noise has no say. The motion of every axis has
    decayed where its first and last 0.1 s are below 0.05 of its largest, or no more than three times what is usual in
    the air at the quieter end. Nothing depends on the unit or gain of a channel.
    """
    force, motion = end_pieces(record, "force"), end_pieces(record, motion_axes(record)[0])
    loud = np.quantile(force, 0.75, axis=1)
    told = force[int(np.argmax(loud / np.maximum(force.min(axis=1), max(1e-9 * loud.max(), 1e-300))))]
    air = told <= 0.3 * told.max()
    if not (air[0] and air[-1]) or air.all():
        return False
    cutting = np.flatnonzero(~air)
    before, after = motion[:, : cutting[0]], motion[:, cutting[-1] + 1 :]
    usual = np.minimum(np.median(before, axis=1), np.median(after, axis=1))
    quiet = np.maximum(0.05 * motion.max(axis=1), 3.0 * usual)
    return bool(np.all(np.maximum(motion[:, 0], motion[:, -1]) <= quiet))


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


# --- What every estimator of a sweep returns, and the words for bands of frequency.


@dataclass(frozen=True)
class Estimate:
    """A compliance before it is labelled.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, r, e)
        [m/N].
    covariance : ndarray of complex, shape (f, r, e, e)
        ``E[d_j conj(d_k)]`` within a row [m2/N2].
    coherence : ndarray, shape (f, r)
        Adjusted multiple coherence.
    condition : ndarray, shape (f,)
        Of the forces.
    error_lines : float
        Lines that share an error.
    half_width : ndarray, shape (f, r), optional
        Half of the band each row comes from [Hz].
    freedom : ndarray, shape (f, r), optional
        Degrees of freedom of Student's t for each part: real ones of the variance, whose errors are circular.
    warnings : tuple of str
        What the user should know.
    between : ndarray of complex, shape (f, r, e, r, e), optional
        Covariance of the errors of two rows, zero within a row [m2/N2].
    delay : Delay, optional
        Of the motion against the force, where the estimator sees it.
    """

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: Real
    error_lines: float
    half_width: Real | None = None
    freedom: Real | None = None
    warnings: tuple[str, ...] = ()
    between: Complex | None = None
    delay: Delay | None = None

    @property
    def std(self) -> Real:
        """Root mean square of the complex error [m/N], shape (f, r, e)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=2, axis2=3).real, 0.0))


def bands(frequency: Real, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] where a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def in_words(frequency: Real, mask: NDArray[np.bool_]) -> str:
    """Return the bands of a mask as text."""
    return ", ".join(f"{a:g}-{b:g} Hz" if b > a else f"{a:g} Hz" for a, b in bands(frequency, mask))
