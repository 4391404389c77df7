"""Sweep milling force excitation: passes in which the cutting force itself shakes the machine -> 3x3 compliance.

Down, up and central milling push the tool in different directions; together they separate the nine compliances. All
passes and lines go into one weighted least squares a frequency (`smfe.least_squares`), with all three measured forces
as references. How records become columns is the choice of an estimator object:

`LocalPolynomial`
    transform of the whole record, neighbouring lines, Phi a polynomial over them. Exact at any sweep rate for a record
    that runs from rest to rest; otherwise a polynomial takes up the transient (Pintelon and Schoukens 2012, ch. 7).
`Segments`
    overlapping Hann segments, with the leakage terms of the window up to second order.
`SingleReference`
    cross-spectra with one force as the only reference and a 3x3 solve: kept to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft

from process.cutting import CuttingCoefficients, force_harmonics
from process.engagement import Engagement
from process.errors import InputError
from process.labels import axis_present, make_compliance, sample_interval
from process.tool import Tool
from smfe.identification import Identification
from smfe.least_squares import Columns, Solution, condition_number, solve
from smfe.spectra import BlockSpectra, block_spectra, hann, motion_axes

WARN_CONDITION = 30.0
"""Above this condition number of the forces a frequency is reported as badly conditioned."""

REFUSE_CONDITION = 200.0
"""Above this condition number a frequency is not solved."""

Progress = Callable[[int, int], None]


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
    """

    record: xr.Dataset = field(repr=False)
    label: str
    arc: Engagement | None = None


@dataclass(frozen=True)
class LocalPolynomial:
    """Whole-record transform; over +- `half_width` the compliance is a polynomial of the given order.

    Parameters
    ----------
    resolution : float, optional
        Step of the resulting frequency axis [Hz].
    half_width : float, optional
        Half width of the band that shares a polynomial [Hz].
    order : int, optional
        Order of the polynomial.
    """

    resolution: float = 0.25
    half_width: float = 1.0
    order: int = 2

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> NDArray[np.float64]:
        """Return the frequency axis [Hz]."""
        return _axis(self.resolution, frequency_range)

    def columns(self, passes: Sequence[SweepPass], frequency: NDArray[np.float64]) -> Iterator[Columns]:
        """Yield the columns of each frequency."""
        reach = (frequency[0] - self.half_width, frequency[-1] + self.half_width)
        spectra = [_whole_record(p.record, (max(reach[0], 0.1), reach[1])) for p in passes]
        restless = [not _at_rest(p.record) for p in passes]
        for f0 in frequency:
            yield self._at(f0, spectra, restless)

    def _at(self, f0: float, spectra: Sequence[BlockSpectra], restless: Sequence[bool]) -> Columns:
        powers = np.arange(self.order + 1)
        blocks, responses, tests = [], [], []
        for test, s in enumerate(spectra):
            low, high = np.searchsorted(s.frequency, [f0 - self.half_width, f0 + self.half_width])
            shift = (s.frequency[low:high] - f0) / self.half_width
            terms = shift[None, :] ** powers[:, None]
            force = s.force[low:high, :, 0].T
            # Order of rows: the three forces, then forces times shift, then times shift squared.
            rows = (terms[:, None, :] * force[None, :, :]).reshape(-1, shift.size)
            transient = np.zeros((len(spectra) * powers.size, shift.size))
            if restless[test]:
                transient[test * powers.size : (test + 1) * powers.size] = terms
            blocks.append(np.concatenate([rows, transient]))
            responses.append(s.displacement[low:high, :, 0].T)
            tests.append(np.full(shift.size, test))
        regressors = np.concatenate(blocks, axis=1)
        used = np.any(regressors != 0.0, axis=1) | (np.arange(regressors.shape[0]) < 3)
        return Columns(regressors[used], np.concatenate(responses, axis=1), np.concatenate(tests))


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

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> NDArray[np.float64]:
        """Return the frequency axis [Hz]: the lines of a segment."""
        dt = sample_interval(passes[0].record)
        lines = fft.rfftfreq(round(1.0 / (self.resolution * dt)), dt)
        inside = (lines >= frequency_range[0] - 1e-9) & (lines <= frequency_range[1] + 1e-9)
        return np.asarray(lines[inside])

    def columns(self, passes: Sequence[SweepPass], frequency: NDArray[np.float64]) -> Iterator[Columns]:
        """Yield the columns of each frequency."""
        reach = (float(frequency[0]), float(frequency[-1]))
        plain = [self._blocks(p.record, reach) for p in passes]
        slopes = [
            [self._blocks(p.record, reach, derivative=order) for p in passes]
            for order in range(1, self.leakage_order + 1)
        ]
        test = np.concatenate([np.full(b.force.shape[2], i) for i, b in enumerate(plain)])
        response = np.concatenate([b.displacement for b in plain], axis=2)
        force = np.concatenate([b.force for b in plain], axis=2)
        for slope in slopes:
            force = np.concatenate([force, np.concatenate([b.force for b in slope], axis=2)], axis=1)
        for line, f0 in enumerate(frequency):
            yield Columns(force[line], response[line], test, _overlap_matrix(plain, f0))

    def _blocks(self, record: xr.Dataset, reach: tuple[float, float], derivative: int = 0) -> BlockSpectra:
        dt = sample_interval(record)
        length = round(1.0 / (self.resolution * dt))
        hop = max(1, round(length * (1.0 - self.overlap)))
        starts = range(0, record.sizes["time"] - length + 1, hop)
        if not len(starts):
            raise InputError(
                f"a pass of {record.sizes['time'] * dt:.3g} s is shorter than one segment of "
                f"{length * dt:.3g} s; choose a coarser resolution than {self.resolution:g} Hz"
            )
        turn = 2.0 * np.pi * np.arange(length) / length
        # The Hann window and its derivatives with respect to time over the segment; scale does not matter.
        window = (hann(length), np.sin(turn), np.cos(turn))[derivative]
        return block_spectra(record, starts, length, window, reach, detrend=derivative == 0)


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

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> NDArray[np.float64]:
        """Return the frequency axis [Hz]."""
        return Segments(self.resolution, self.overlap, 0).axis(frequency_range, passes)

    def cross_spectra(
        self, passes: Sequence[SweepPass], reach: tuple[float, float]
    ) -> tuple[NDArray[np.complex128], ...]:
        """Return S_XF and S_FF with the reference, each of shape (frequencies, 3, passes)."""
        segments = Segments(self.resolution, self.overlap, 0)
        sxf, sff = [], []
        for p in passes:
            b = segments._blocks(p.record, reach)
            reference = b.force[:, [b.excitation.index(self.reference)], :].conj()
            sxf.append((b.displacement * reference).mean(axis=2))
            sff.append((b.force * reference).mean(axis=2))
        return np.stack(sxf, axis=2), np.stack(sff, axis=2)


Estimator = LocalPolynomial | Segments | SingleReference


def identify_sweep(
    name: str,
    passes: Sequence[SweepPass],
    frequency_range: tuple[float, float],
    estimator: Estimator | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Identify the compliance from sweep passes.

    Parameters
    ----------
    name : str
        Name of the measurement.
    passes : sequence of SweepPass
        At least three that push in independent directions.
    frequency_range : (float, float)
        Band to identify [Hz].
    estimator : LocalPolynomial, Segments or SingleReference, optional
        Default: `LocalPolynomial()`.
    progress : callable, optional
        Called with (done, of).

    Returns
    -------
    Identification
        ``compliance``, ``compliance_std``, ``coherence`` (adjusted multiple coherence; NaN for `SingleReference`,
        where three columns for three unknowns leave nothing to judge by) and ``force_condition``. Frequencies whose
        condition number exceeds `REFUSE_CONDITION` are NaN.

    Raises
    ------
    InputError
        Fewer than three passes; a record without three forces or without motion; passes that are not independent, by
        their arcs or by the measured forces in more than half of the band.
    """
    chosen = LocalPolynomial() if estimator is None else estimator
    response = _check_passes(passes)
    check_independent(passes)
    frequency = chosen.axis(frequency_range, passes)
    if isinstance(chosen, SingleReference):
        solutions = _solve_single(chosen, passes, frequency)
    else:
        solutions = _solve_all(chosen, passes, frequency, progress)
    condition = np.array([s.condition for s in solutions])
    compliance = np.array([s.compliance for s in solutions])
    std = np.array([s.std for s in solutions])
    refused = ~(condition <= REFUSE_CONDITION)
    if refused.mean() > 0.5:
        raise InputError(
            f"sweep '{name}': the measured forces of the passes ({', '.join(p.label for p in passes)}) are not "
            f"independent: their condition number exceeds {REFUSE_CONDITION:g} at {refused.sum()} of {refused.size} "
            "frequencies, so nine compliances cannot be told apart; add a pass with another width or kind of cut"
        )
    compliance[refused], std[refused] = np.nan, np.nan
    dataset = make_compliance(
        frequency,
        compliance,
        response,
        extra={
            "compliance_std": (("frequency", "response", "excitation"), std),
            "coherence": (("frequency", "response"), np.array([s.coherence for s in solutions])),
            "force_condition": (("frequency",), condition),
        },
        attrs={"method": "sweep", "estimator": repr(chosen)},
    )
    return Identification(
        name, "sweep", dataset, {"passes": _pass_table(passes)}, _condition_warnings(frequency, condition)
    )


def _axis(resolution: float, frequency_range: tuple[float, float]) -> NDArray[np.float64]:
    low, high = (round(f / resolution) for f in frequency_range)
    return np.asarray(np.arange(low, high + 1) * resolution)


def _check_passes(passes: Sequence[SweepPass]) -> list[str]:
    """Return the response axes that all passes share."""
    if len(passes) < 3:
        raise InputError(
            f"a sweep measurement with {len(passes)} passes ({', '.join(p.label for p in passes)}); nine compliances "
            "need three passes that push in different directions: add a down, an up or a central pass"
        )
    shared: list[str] = ["x", "y", "z"]
    for p in passes:
        missing = [a for a in "xyz" if a not in axis_present(p.record, "force")]
        if missing:
            raise InputError(
                f"pass '{p.label}' has no force_{missing[0]}; all three forces are needed as references: "
                "declare it in [channels]"
            )
        shared = [a for a in shared if a in motion_axes(p.record)[1]]
    return shared


def check_independent(passes: Sequence[SweepPass]) -> None:
    """Refuse passes whose forces are dependent by geometry.

    Forces add up over the arc: a pass whose arc is the sum of two others brings nothing new at any harmonic, for any
    tool and material. Every triple of distinct arcs is tested with unit coefficients.

    Raises
    ------
    InputError
        When all triples are dependent.
    """
    arcs = {p.label: p.arc for p in passes if p.arc is not None}
    if len(arcs) < len(passes) or not arcs:
        return
    worst = _best_condition(list(arcs.values()))
    if worst > 1e6:
        raise InputError(
            f"the passes {', '.join(arcs)} are not independent: cutting forces add up over the arc of engagement, so "
            "a pass whose arc is the sum of the others repeats them (half-immersion down and up milling add up to "
            "the slot) and the nine compliances cannot be separated; change one width, e.g. widths of 30, 50 and "
            "85 % of the diameter for down, up and central milling"
        )


def _best_condition(arcs: Sequence[Engagement | None]) -> float:
    """Smallest condition number of the force directions over the first harmonics, equal teeth."""
    coefficients = CuttingCoefficients(1.0, 0.4, 0.15, 1e-4, 1.5e-4, 1e-5)
    probe = Tool(1.0, 2, np.pi / 4)
    conditions = []
    for harmonic in (1, 2, 3):
        force = [force_harmonics(probe, arc, coefficients, 1.0, 1e-4, [harmonic])[0] for arc in arcs if arc is not None]
        unit = [f / max(float(np.linalg.norm(f)), 1e-300) for f in force]
        conditions.append(condition_number(np.array(unit, dtype=np.complex128).T))
    return min(conditions)


def _whole_record(record: xr.Dataset, reach: tuple[float, float]) -> BlockSpectra:
    """Transform the whole record, padded with rest to a length that transforms fast."""
    n = record.sizes["time"]
    length = fft.next_fast_len(n, real=True)
    if length > n:
        record = _padded(record, length)
    return block_spectra(record, [0], length, None, reach, detrend=False)


def _padded(record: xr.Dataset, length: int) -> xr.Dataset:
    dt = sample_interval(record)
    channels = record[["force", motion_axes(record)[0]]]
    padded = channels.pad(time=(0, length - record.sizes["time"]), constant_values=0.0)
    start = float(record["time"][0])
    return padded.assign_coords(time=start + dt * np.arange(length))


def _at_rest(record: xr.Dataset, duration: float = 0.1, level: float = 0.05) -> bool:
    """Whether force and motion in the first and last 0.1 s are small beside the largest level of such a piece."""
    n = record.sizes["time"]
    edge = min(max(8, round(duration / sample_interval(record))), n)
    for name in ("force", motion_axes(record)[0]):
        values = record[name].sel(axis=axis_present(record, name)).values
        blocks = values[:, : n // edge * edge].reshape(values.shape[0], -1, edge)
        rms = np.sqrt(np.mean(blocks**2, axis=2))
        if np.any(np.maximum(rms[:, 0], rms[:, -1]) > level * rms.max(axis=1)):
            return False
    return True


def _overlap_matrix(blocks: Sequence[BlockSpectra], frequency: float) -> NDArray[np.complex128]:
    """Correlation of white noise between all segments of all tests at one frequency."""
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


def _solve_all(
    estimator: LocalPolynomial | Segments,
    passes: Sequence[SweepPass],
    frequency: NDArray[np.float64],
    progress: Progress | None,
) -> list[Solution]:
    """Solve with equal weights to learn the noise of each test, then with its inverse as weight."""
    columns = list(estimator.columns(passes, frequency))
    first = [solve(c, 3) for c in columns]
    noise = _smooth_noise(np.array([s.residual for s in first]))
    out = []
    for i, c in enumerate(columns):
        out.append(solve(c, 3, noise[i]))
        if progress is not None:
            progress(i + 1, len(columns))
    return out


def _smooth_noise(residual: NDArray[np.float64], reach: int = 8) -> NDArray[np.float64]:
    """Average residual power over neighbouring frequencies, shape (f, r, tests), and keep weights within 1:100."""
    filled = pd.DataFrame(residual.reshape(residual.shape[0], -1))
    smooth = filled.rolling(2 * reach + 1, center=True, min_periods=1).median().bfill().ffill().to_numpy()
    noise = smooth.reshape(residual.shape)
    largest = np.nanmax(noise, axis=2, keepdims=True)
    floor = np.where(largest > 0.0, 1e-4 * largest, 1.0)
    return np.where(np.isfinite(noise), np.maximum(noise, floor), 1.0)


def _solve_single(
    estimator: SingleReference, passes: Sequence[SweepPass], frequency: NDArray[np.float64]
) -> list[Solution]:
    sxf, sff = estimator.cross_spectra(passes, (float(frequency[0]), float(frequency[-1])))
    out = []
    for x, f in zip(sxf, sff, strict=True):
        condition = condition_number(f)
        gain = np.linalg.lstsq(f.T, x.T, rcond=None)[0].T if np.isfinite(condition) else np.full(x.shape, np.nan)
        shape = (x.shape[0], f.shape[0])
        unknown = np.full(shape[0], np.nan)
        out.append(Solution(gain, np.full(shape, np.nan), unknown, condition, np.full((shape[0], len(passes)), np.nan)))
    return out


def _pass_table(passes: Sequence[SweepPass]) -> pd.DataFrame:
    rows = []
    for p in passes:
        force = p.record["force"].sel(axis=["x", "y", "z"]).values
        rms = np.sqrt(np.mean(force**2, axis=1))
        rows.append(
            {
                "pass": p.label,
                "duration_s": p.record.sizes["time"] * sample_interval(p.record),
                "force_x_rms_N": rms[0],
                "force_y_rms_N": rms[1],
                "force_z_rms_N": rms[2],
                "from_rest_to_rest": _at_rest(p.record),
            }
        )
    return pd.DataFrame(rows)


def bands(frequency: NDArray[np.float64], mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] where a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _condition_warnings(frequency: NDArray[np.float64], condition: NDArray[np.float64]) -> tuple[str, ...]:
    out = []
    refused = ~(condition <= REFUSE_CONDITION)
    for mask, text in (
        (refused, f"not solved: condition number of the forces above {REFUSE_CONDITION:g}"),
        (~refused & (condition > WARN_CONDITION), f"badly conditioned (above {WARN_CONDITION:g})"),
    ):
        if mask.any():
            where = ", ".join(f"{a:g}-{b:g} Hz" for a, b in bands(frequency, mask))
            out.append(f"{text} in {where}")
    return tuple(out)
