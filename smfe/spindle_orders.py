"""Order tracking as an estimator: each harmonic of the tooth passing is followed through the sweep.

A window that turns back with an order of the spindle, ``w(t) exp(-j k (theta(t) - theta_c))``, sees one harmonic and
nothing else. Plain order tracking takes its ratio of motion to force for the compliance at the momentary frequency,
which is wrong while the frequency moves (9 % at 0.8 Hz/s for a damping of 2 %). For any window w, complex or not,

    X_w(f) = sum_n Phi^(n)(f)/(n! (-2 pi j)^n) F_{w^(n)}(f)

with the force seen through the n-th derivative of the window: with n up to 2 the sweep rate drops out. The derivatives
of the compliance are those of its polynomial about the frequency that is asked for, so they cost no unknowns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from process.compliance import displacement_over_acceleration
from process.errors import InputError
from process.labels import sample_interval
from smfe.force_noise import in_cut
from smfe.least_squares import Columns
from smfe.spectra import motion_axes
from smfe.spindle_angle import spindle_angle
from smfe.sweep_estimators import SweepPass

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


OVERLAPPING = 4
"""Windows that overlap at any time."""


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
        Length of a window [s].
    half_width : float, optional
        Half of the band over which the compliance is a polynomial [Hz].
    order : int, optional
        Order of the polynomial, and of the correction for the sweep rate.
    """

    teeth: int
    harmonics: int = 3
    resolution: float = 0.25
    duration: float = 1.0
    half_width: float = 1.0
    order: int = 2

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> Real:
        """Return the frequency axis [Hz]."""
        low, high = (round(f / self.resolution) for f in frequency_range)
        return np.asarray(np.arange(low, high + 1) * self.resolution)

    def error_lines(self) -> float:
        """Return how many lines of the axis share an error: the effective width of a second-order band."""
        return max(1.0, 8.0 / 9.0 * self.half_width / self.resolution)

    def columns(
        self, passes: Sequence[SweepPass], frequency: Real, response: Sequence[str], axes: Sequence[str] = "xyz"
    ) -> Iterator[Columns]:
        """Yield the columns of each frequency: one a window and harmonic, powers of the distance as nuisance."""
        seen = [_followed(self, p, response, axes) for p in passes]
        centre = np.concatenate([s.centre for s in seen])
        force, motion, alike = (np.concatenate([getattr(s, k) for s in seen]) for k in ("force", "motion", "alike"))
        test = np.concatenate([np.full(s.centre.size, i) for i, s in enumerate(seen)])
        channels = {motion_axes(p.record)[0] for p in passes}
        if len(channels) > 1:
            raise InputError("some passes hold acceleration and others displacement; give the same channel in each")
        scale = displacement_over_acceleration(frequency) if channels == {"acceleration"} else np.ones(frequency.size)
        for f0, factor in zip(frequency, scale, strict=True):
            near = np.flatnonzero(np.abs(centre - f0) <= self.half_width)
            away = centre[near] - f0
            rows = [self._row(force[near], away, p) for p in range(self.order + 1)]
            regressors = np.concatenate(rows, axis=1).T / factor
            yield Columns(regressors, motion[near].T, test[near], self._correlation(near, test[near], alike[near]))

    def _correlation(self, near: NDArray[np.int64], test: NDArray[np.int64], alike: Complex) -> Complex:
        """Correlation of white noise between windows that overlap, ``E[n_a conj(n_b)]``."""
        out = np.eye(near.size, dtype=complex)
        for lag in range(1, alike.shape[1] + 1):
            later = np.searchsorted(near, near + lag * self.harmonics)
            inside = later < near.size
            inside[inside] &= near[later[inside]] == near[inside] + lag * self.harmonics
            inside[inside] &= test[later[inside]] == test[inside]
            a, b = np.flatnonzero(inside), later[inside]
            out[a, b], out[b, a] = alike[a, lag - 1], alike[a, lag - 1].conj()
        return out

    def _row(self, force: Complex, away: Real, power: int) -> Complex:
        """Return what multiplies the coefficient of ``(f - f0)^power``, shape (columns, forces)."""
        out = np.zeros(force.shape[:2], dtype=complex)
        for n in range(power + 1):
            out += (comb(power, n) * away ** (power - n) / (-2j * np.pi) ** n)[:, None] * force[:, :, n]
        return out


@dataclass(frozen=True)
class _Followed:
    """One pass, one row a window and harmonic, harmonics side by side.

    Frequencies [Hz]; forces (windows, e, derivatives); motions (windows, r); correlation of white noise with the
    windows one, two and three later (windows, 3).
    """

    centre: Real
    force: Complex
    motion: Complex
    alike: Complex


def _followed(estimator: Orders, sweep: SweepPass, response: Sequence[str], axes: Sequence[str]) -> _Followed:
    record, dt = sweep.record, sample_interval(sweep.record)
    size = round(estimator.duration / dt)
    cutting = np.flatnonzero(in_cut(record))
    # Half windows outside: the force begins and the decay ends inside of one.
    first, last = max(int(cutting[0]) - size // 2, 0), min(int(cutting[-1]) + size // 2, record.sizes["time"])
    hop = max(1, size // OVERLAPPING)
    starts = range(first, last - size + 1, hop)
    if not len(starts):
        raise InputError(
            f"pass '{sweep.label}' cuts for {(last - first) * dt:.3g} s, less than one window of "
            f"{estimator.duration:g} s; choose a shorter duration"
        )
    force = record["force"].sel(axis=list(axes)).values
    motion = record[motion_axes(record)[0]].sel(axis=list(response)).values
    angle = spindle_angle(record, estimator.teeth)[0]
    clock: Real = np.asarray((np.arange(size) - 0.5 * (size - 1)) * dt, dtype=np.float64)
    frequencies, forces, motions = [], [], []
    alike = np.zeros((len(starts) * estimator.harmonics, OVERLAPPING - 1), dtype=complex)
    recent: list[Complex] = []
    for start in starts:
        piece = slice(start, start + size)
        # A cubic follows any sweep over a window; the noise of an angle would spoil its derivatives.
        shape = np.polynomial.Polynomial.fit(clock, angle[piece] - angle[start], 3).convert()
        f, x = (v[:, piece] - v[:, piece].mean(axis=1, keepdims=True) for v in (force, motion))
        for h in range(1, estimator.harmonics + 1):
            centre, windows = _windows(shape, h * estimator.teeth, clock, dt)
            frequencies.append(centre)
            forces.append(dt * f @ windows.T)
            motions.append(dt * x @ windows[0])
            recent.append(windows[0])
            energy = np.vdot(windows[0], windows[0])
            for lag in range(1, OVERLAPPING):
                before = len(frequencies) - 1 - lag * estimator.harmonics
                if before >= 0:
                    old = recent[-1 - lag * estimator.harmonics][lag * hop :]
                    alike[before, lag - 1] = np.vdot(windows[0][: size - lag * hop], old) / energy
            del recent[: -OVERLAPPING * estimator.harmonics]
    return _Followed(np.array(frequencies), np.array(forces), np.array(motions), alike)


def _windows(angle: np.polynomial.Polynomial, order: float, clock: Real, dt: float) -> tuple[float, Complex]:
    """Return the frequency of an order [Hz] and its window with two derivatives, times ``exp(-j w_c t)``."""
    size = clock.size
    turn = 2.0 * np.pi * (np.arange(size) + 0.5) / size
    span = size * dt
    w0 = 0.5 * (1.0 - np.cos(turn))
    w1, w2 = np.pi / span * np.sin(turn), 2.0 * (np.pi / span) ** 2 * np.cos(turn)
    rate, bend = order * angle.deriv(1)(clock), order * angle.deriv(2)(clock)
    energy = w0**2
    centre = float(np.sum(energy * rate) / np.sum(energy))
    slip = rate - centre
    phase = np.exp(-1j * order * angle(clock))
    # With u = w exp(-j psi), psi' = slip: u' = (w' - j psi' w) e, u'' = (w'' - 2 j psi' w' - j psi'' w - psi'^2 w) e.
    first = w1 - 1j * slip * w0
    second = w2 - 2j * slip * w1 - 1j * bend * w0 - slip**2 * w0
    return centre / (2.0 * np.pi), np.stack([w0, first, second]) * phase
