"""Order tracking as an estimator: each harmonic of the tooth passing is followed through the sweep.

A window that turns back with an order of the spindle, ``w(t) exp(-j k theta(t))``, sees one harmonic and nothing else.
Plain order tracking takes its ratio of motion to force for the compliance at the momentary frequency, which is wrong
while the frequency moves (9 % at 0.8 Hz/s for a damping of 2 %), and so is a series in the rate as soon as the sweep
crosses a resonance within the time that it rings. A compliance written in functions of frequency has neither limit:

    Phi(f) = sum_k c_k b_k(f):   sum_t x(t) w(t) = sum_k c_k sum_f b_k(f) F(f) W(f),

with F the transform of the whole record and W that of the window: force filtered by b_k and seen through the same
window, exactly, at any rate. The b_k are cubic B-splines (de Boor 1978) over the whole band.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse
from scipy.interpolate import BSpline

from process.errors import InputError
from process.types import Complex, Real
from process.units import displacement_over_acceleration
from smfe.identification.spectra.spectra import hann
from smfe.identification.sweep.least_squares import Estimate, condition_number
from smfe.identification.sweep.passes import PreparedPass
from smfe.identification.sweep.rules import RULES

Step = Callable[[int, int], None]


@dataclass(frozen=True)
class Orders:
    """Order tracking of the harmonics of the tooth passing.

    Parameters
    ----------
    teeth : int
        Of the tool.
    harmonics : int, optional
        Harmonics that are followed.
    resolution : float, optional
        Step of the resulting frequency axis [Hz].
    duration : float, optional
        Length of a window [s]. It must hold a few periods of the tooth passing to separate harmonics; a long one
        averages the sweep.
    knots : float, optional
        Distance of the knots of the splines [Hz]; about the half-power half width of the narrowest mode. Moved apart
        where there are fewer than `SweepRules.columns_each` windows for each unknown.
    """

    teeth: int
    harmonics: int = 3
    resolution: float = 0.25
    duration: float = 0.25
    knots: float = 0.6

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[PreparedPass]) -> Real:
        """Return the frequency axis [Hz]."""
        low, high = (round(f / self.resolution) for f in frequency_range)
        return np.asarray(np.arange(low, high + 1) * self.resolution)

    def solve(
        self,
        passes: Sequence[PreparedPass],
        frequency: Real,
        axes: Sequence[str],
        response: Sequence[str],
        progress: Step | None = None,
    ) -> Estimate:
        """Solve for the splines of all entries at once.

        Parameters
        ----------
        passes : sequence of PreparedPass
            From rest to rest.
        frequency : ndarray, shape (f,)
            [Hz].
        axes, response : sequence of str
            Axes of the forces and of the motion.
        progress : callable, optional
            Called with (done, of).

        Raises
        ------
        InputError
            For passes that are shorter than a window, that hold different motions, or whose orders miss the band.
        """
        channels = {p.motion[0] for p in passes}
        if len(channels) > 1:
            raise InputError("some passes hold acceleration and others displacement; give the same channel in each")
        reach = (
            max(float(frequency[0]) - RULES.spline_margin, 0.5 * float(frequency[0])),
            float(frequency[-1]) + RULES.spline_margin,
        )
        angles = [p.angle(self.teeth) for p in passes]
        places = [w for k, p in enumerate(passes) for w in _places(self, p, angles[k], k, reach)]
        knots, spacing = _knots(self, len(places), len(axes), reach)
        parts = []
        for k, p in enumerate(passes):
            own = [w for w in places if w.test == k]
            parts.append(_columns(self, p, angles[k], own, knots, axes, response))
            if progress is not None:
                progress(k + 1, len(passes) + len(response))
        whole = _Columns(
            np.concatenate([c.splines for c in parts]),
            np.concatenate([c.force for c in parts]),
            np.concatenate([c.motion for c in parts]),
            sparse.csr_array(sparse.block_diag([c.correlation for c in parts])),
        )
        rows, basis = [], _splines(frequency, knots)
        for i in range(len(response)):
            rows.append(_row(whole, places, i, basis, frequency))
            if progress is not None:
                progress(len(passes) + i + 1, len(passes) + len(response))
        return _together(rows, whole, places, frequency, spacing / self.resolution)


@dataclass(frozen=True)
class _Window:
    """One window on one harmonic of one pass: first sample, harmonic, frequency in its middle [Hz]."""

    test: int
    start: int
    harmonic: int
    centre: float


@dataclass(frozen=True)
class _Columns:
    """What the windows give.

    Splines times forces (M, e K); forces (M, e) and motions (M, r) through the window; correlation of white noise.
    """

    splines: Complex
    force: Complex
    motion: Complex
    correlation: sparse.csr_array


def _together(
    rows: Sequence[_Row], columns: _Columns, places: Sequence[_Window], frequency: Real, shared: float
) -> Estimate:
    centre = np.array([w.centre for w in places])
    condition = np.array(
        [condition_number(columns.force[np.abs(centre - f) <= RULES.judged_reach].T) for f in frequency]
    )
    degrees_of_freedom = np.repeat([[row.degrees_of_freedom for row in rows]], frequency.size, axis=0)
    return Estimate(
        np.stack([row.value for row in rows], axis=1),
        np.stack([row.covariance for row in rows], axis=1),
        np.stack([row.coherence for row in rows], axis=1),
        condition,
        max(1.0, shared),
        degrees_of_freedom=degrees_of_freedom,
    )


# --- windows and splines ----------------------------------------------------------------------------------------------


def _places(
    estimator: Orders, sweep: PreparedPass, angle: Real, test: int, reach: tuple[float, float]
) -> list[_Window]:
    """Return the windows whose order lies in the band, half of each repeated by the next."""
    record, dt = sweep.record, sweep.interval
    size = round(estimator.duration / dt)
    cutting = np.flatnonzero(sweep.cutting)
    # Half windows outside: the force begins and the decay ends inside of one.
    first, last = max(int(cutting[0]) - size // 2, 0), min(int(cutting[-1]) + size // 2, record.sizes["time"])
    if last - first < size:
        raise InputError(
            f"pass '{sweep.label}' cuts for {(last - first) * dt:.3g} s, less than one window of "
            f"{estimator.duration:g} s; choose a shorter duration"
        )
    out = []
    for start in range(first, last - size + 1, max(1, size // 2)):
        rate = (angle[start + size - 1] - angle[start]) / (2.0 * np.pi * (size - 1) * dt)
        for h in range(1, estimator.harmonics + 1):
            centre = float(h * estimator.teeth * rate)
            if reach[0] + 0.25 * RULES.spline_margin < centre < reach[1] - 0.25 * RULES.spline_margin:
                out.append(_Window(test, start, h, centre))
    return out


def _knots(estimator: Orders, windows: int, forces: int, reach: tuple[float, float]) -> tuple[Real, float]:
    """Return the knots of cubic splines over the band, the outer ones fourfold, and their distance [Hz]."""
    most = int(windows / (RULES.columns_each * forces)) - 3
    if most < 2:
        raise InputError(
            f"the orders of the passes give {windows} windows of {estimator.duration:g} s between {reach[0]:g} and "
            f"{reach[1]:g} Hz, too few for the unknowns of {forces} forces; sweep more slowly through this band, or "
            "follow more harmonics"
        )
    intervals = min(int(np.ceil((reach[1] - reach[0]) / estimator.knots)), most)
    inner = np.linspace(*reach, intervals + 1)
    return np.concatenate([[reach[0]] * 3, inner, [reach[1]] * 3]), float(inner[1] - inner[0])


def _splines(frequency: Real, knots: Real) -> Real:
    """Return the cubic splines at some frequencies, shape (f, K)."""
    return np.asarray(BSpline.design_matrix(frequency, knots, 3).toarray(), dtype=np.float64)


def _columns(
    estimator: Orders,
    sweep: PreparedPass,
    angle: Real,
    places: Sequence[_Window],
    knots: Real,
    axes: Sequence[str],
    response: Sequence[str],
) -> _Columns:
    record, dt = sweep.record, sweep.interval
    channel, _ = sweep.motion
    size = round(estimator.duration / dt)
    length = int(fft.next_fast_len(record.sizes["time"] + round(RULES.added_decay / dt), real=True))
    lines = fft.rfftfreq(length, dt)
    low, high = np.searchsorted(lines, [knots[0], knots[-1]])
    lines = lines[low:high]
    force = record["force"].sel(axis=list(axes)).values
    spectrum = dt * fft.rfft(force, length, axis=1)[:, low:high] / (length * dt)
    if channel == "acceleration":
        spectrum = spectrum / displacement_over_acceleration(lines)
    motion = record[channel].sel(axis=list(response)).values
    splines = _splines(lines, knots)
    # What a window sees changes slowly: few samples of it give its transform near its order.
    few = slice(None, None, max(1, int(1.0 / (dt * RULES.window_rate))))
    turn = np.exp(2j * np.pi * np.outer(np.arange(size)[few] * dt, lines)) * (few.step or 1)
    wide = RULES.window_lines / estimator.duration
    shape, windows = hann(size), []
    out = np.empty((len(places), len(axes), splines.shape[1]), dtype=complex)
    for n, w in enumerate(places):
        piece = slice(w.start, w.start + size)
        window = shape * np.exp(-1j * w.harmonic * estimator.teeth * (angle[piece] - angle[w.start]))
        at = slice(*np.searchsorted(lines, [w.centre - wide, w.centre + wide]))
        seen = (window[few] @ turn[:, at]) * np.exp(2j * np.pi * lines[at] * (w.start * dt))
        out[n] = (spectrum[:, at] * seen) @ splines[at]
        windows.append(window)
    through = [
        (v[:, w.start : w.start + size] @ window)
        for v in (force, motion)
        for w, window in zip(places, windows, strict=True)
    ]
    return _Columns(
        out.reshape(len(places), -1),
        np.array(through[: len(places)]).reshape(len(places), -1),
        np.array(through[len(places) :]).reshape(len(places), -1),
        _correlation(places, windows, size),
    )


def _correlation(places: Sequence[_Window], windows: Sequence[Complex], size: int) -> sparse.csr_array:
    """Correlation of white noise between windows of one harmonic that overlap, ``E[n_a conj(n_b)]``."""
    row, column, value = list(range(len(places))), list(range(len(places))), [1.0 + 0.0j] * len(places)
    recent: dict[int, int] = {}
    energy = float(np.sum(hann(size) ** 2))
    for n, w in enumerate(places):
        before = recent.get(w.harmonic)
        recent[w.harmonic] = n
        if before is None or w.start - places[before].start >= size:
            continue
        lag = w.start - places[before].start
        # The older window turns from its own beginning.
        alike = complex(np.sum(windows[n][: size - lag] * windows[before][lag:].conj())) / energy
        row, column, value = [*row, n, before], [*column, before, n], [*value, alike, alike.conjugate()]
    return sparse.csr_array((value, (row, column)), shape=(len(places), len(places)))


# --- least squares ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Row:
    """One row of the compliance: (f, e), (f, e, e), (f,), and degrees of freedom."""

    value: Complex
    covariance: Complex
    coherence: Real
    degrees_of_freedom: float


def _row(columns: _Columns, places: Sequence[_Window], row: int, basis: Real, frequency: Real) -> _Row:
    """Solve one row, weighting the windows with the inverse noise of their pass near their frequency."""
    centre, test = np.array([w.centre for w in places]), np.array([w.test for w in places])
    x, noise = columns.motion[:, row], np.ones(centre.size)
    for _ in range(RULES.noise_rounds):
        weighted, right = columns.splines / noise[:, None], x / noise
        inverse = _inverse(weighted.conj().T @ weighted)
        c = inverse @ (weighted.conj().T @ right)
        left = x - columns.splines @ c
        last, noise = noise, _level(centre, test, np.abs(left) ** 2)
    # sigma^2 (A^H A)^-1 A^H R A (A^H A)^-1, with what the residual of correlated columns loses to p unknowns.
    correlated: Complex = np.asarray(columns.correlation @ weighted, dtype=np.complex128)
    middle = inverse @ (weighted.conj().T @ correlated)
    mean = max(float(centre.size - np.trace(middle).real), 1.0)
    square = float(np.sum(np.abs(columns.correlation.data) ** 2)) + float(np.sum(middle * middle.T).real)
    square -= 2.0 * float(np.sum(inverse * (correlated.conj().T @ correlated).T).real)
    power = float(np.sum(np.abs(left / last) ** 2)) / mean
    spread = power * (middle @ inverse)
    k = basis.shape[1]
    value = basis @ c.reshape(-1, k).T
    covariance = np.einsum("fk,jklm,fm->fjl", basis, spread.reshape(-1, k, value.shape[1], k), basis, optimize=True)
    loss = centre.size / mean
    near = [np.abs(centre - f) <= RULES.judged_reach for f in frequency]
    share = np.array([np.sum(np.abs(left[n]) ** 2) / max(float(np.sum(np.abs(x[n]) ** 2)), 1e-300) for n in near])
    return _Row(value, covariance, np.clip(1.0 - loss * share, 0.0, 1.0), 2.0 * mean**2 / max(square, 1e-300))


def _inverse(gram: Complex) -> Complex:
    """Return the inverse of a gram matrix; what nothing excites comes out as zero."""
    size = np.sqrt(np.maximum(np.diagonal(gram).real, 0.0))
    scale = np.where(size > 1e-9 * size.max(), 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    both = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(gram * both, rcond=1e-12, hermitian=True) * both)


def _level(centre: Real, test: NDArray[np.int64], power: Real) -> Real:
    """Return the noise of each window: rms residual of its pass within 2 Hz, of sixteen windows or the whole pass."""
    out = np.empty(centre.size)
    for k in np.unique(test):
        own = np.flatnonzero(test == k)
        order = own[np.argsort(centre[own])]
        total = np.concatenate([[0.0], np.cumsum(power[order])])
        low, high = (np.searchsorted(centre[order], centre[order] + side) for side in (-2.0, 2.0))
        count = high - low
        local = (total[high] - total[low]) / np.maximum(count, 1)
        out[order] = np.sqrt(np.where(count >= 16, local, total[-1] / own.size))
    return np.maximum(out, 1e-6 * max(float(out.max()), 1e-300))
