"""How a compliance was measured, what its error is like, and residuals of unit variance.

The error of a line is that of its noise, smooth over frequency and independent from line to line, and what the hits
have in common over all lines: levels and states at rest that differ from hit to hit. The first is read off second
differences over neighbouring lines, the second off what remains between the hits when their level is taken off. Beyond
noise two simulations of one machine differ a little, smoothly over frequency: that is an error all lines share as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Complex, Real
from smfe.diagnosis.inference.problem import Condition

MOST_LINES = 120
"""Lines of a condition that are compared, at most."""

SHARED = 2.0
"""Factor on the variance that hits share: it comes from three or four of them only."""

SMOOTH_SHAPES = 4
"""Cosines over the logarithm of frequency that the difference between model and machine is made of."""

_SMOOTH = 15
_CORRELATED = 1.88  # how much less second differences tell than independent ones: 1 + 2 (4/9 14/15 + 1/36 13/15)


@dataclass(frozen=True)
class Hits:
    """The hits that a mean compliance was taken from.

    Attributes
    ----------
    force : ndarray, shape (r, n)
        Force from the first contact on [N].
    rate : float
        Its samples a second [Hz].
    compliance : ndarray, shape (r, f, entries)
        From each hit [m/N].
    """

    force: Real
    rate: float
    compliance: Complex

    @property
    def impulse(self) -> Real:
        """Of each hit [N s], shape (r,)."""
        return np.asarray(self.force.sum(axis=1) / self.rate)


@dataclass(frozen=True)
class Excited:
    """How a compliance was measured, and where.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        Lines that are compared [Hz].
    entries : tuple of (str, str)
        (response, excitation) of each entry.
    std : ndarray, shape (f, entries)
        Root mean square of the complex error of each line by itself [m/N].
    method : {"hammer", "actuator"}
        How the force was applied.
    level : float
        Impulse [N s] of a hammer, amplitude [N] of an actuator.
    duration : float, optional
        Contact time of the hammer [s].
    feed : mapping, optional
        Axis -> feed [m/s].
    controller : str, optional
        Name of the controller.
    shared : ndarray, shape (m, f, entries), optional
        Errors that all lines have in common, each with a random factor of unit variance [m/N].
    window : float, optional
        Time after a hit that was transformed [s].
    hits : Hits, optional
        The hits one by one, where they are known.
    noise_freedom : float, optional
        Degrees of freedom with which `std` is known over all lines (`freedom_of`); infinite: it is known.
    """

    frequency: Real
    entries: tuple[tuple[str, str], ...]
    std: Real
    method: str
    level: float
    duration: float = 4e-3
    feed: Mapping[str, float] = field(default_factory=dict)
    controller: str | None = None
    shared: Complex | None = None
    window: float = 2.0
    hits: Hits | None = field(default=None, repr=False, compare=False)
    noise_freedom: float = math.inf

    def __post_init__(self) -> None:
        """Keep the directions in which the errors are shared, and how much less counts there."""
        base = np.zeros((0, 2 * self.std.size))
        if self.shared is not None and len(self.shared):
            base = np.stack([_scaled(s, self.std) for s in self.shared])
        _, size, rows = np.linalg.svd(base, full_matrices=False)
        object.__setattr__(self, "_rows", rows)
        object.__setattr__(self, "_less", 1.0 - 1.0 / np.sqrt(1.0 + size**2))

    @property
    def way(self) -> tuple[object, ...]:
        """All that a prediction depends on, without the noise."""
        how = (self.method, self.level, self.duration, self.controller, self.window, self.entries)
        return (*how, tuple(self.feed.items()), self.frequency.tobytes())

    def whitened(self, values: Complex) -> Real:
        """Return complex values (f, entries) as real ones of unit variance, shape (2 f entries,).

        Real and imaginary parts in turn, over the standard deviation, then less where errors are shared:
        ``(I + L L^T)^(-1/2)``.
        """
        flat = _scaled(values, self.std)
        rows: Real = self._rows  # type: ignore[attr-defined]
        less: Real = self._less  # type: ignore[attr-defined]
        return np.asarray(flat - rows.T @ (less * (rows @ flat)))

    def unwhitened(self, values: Real) -> Complex:
        """Return complex values, columns of shape (entries f, n), from real ones, (2 f entries, n), of `whitened`."""
        rows: Real = self._rows  # type: ignore[attr-defined]
        less: Real = self._less  # type: ignore[attr-defined]
        flat = values + rows.T @ ((less / (1.0 - less))[:, None] * (rows @ values))
        return np.asarray((flat[0::2] + 1j * flat[1::2]) * self.std.T.reshape(-1, 1) / np.sqrt(2.0))


def _scaled(values: Complex, std: Real) -> Real:
    scaled = (np.sqrt(2.0) * values / std).T
    return np.stack([scaled.real, scaled.imag], axis=-1).ravel()


def condition_of(
    name: str,
    compliance: xr.Dataset,
    excited: Excited,
    settings: Mapping[str, float | str],
    source: str = "",
) -> Condition:
    """Return a condition from a measured compliance.

    Parameters
    ----------
    name : str
        For people.
    compliance : xarray.Dataset
        Measured, with its standard deviation.
    excited : Excited
        From `excitation_of`.
    settings : mapping
        What tells this condition from others.
    source : str, optional
        Independent experiment.
    """
    f = compliance["frequency"].values
    pick = np.searchsorted(f, excited.frequency - 1e-9)
    values = np.stack(
        [compliance["compliance"].sel(response=r, excitation=e).values[pick] for r, e in excited.entries], axis=1
    )
    return Condition(name, dict(settings), excited.whitened(values), source, excited)


def excitation_of(
    compliance: xr.Dataset,
    method: str,
    level: float,
    band: tuple[float, float],
    floor: float = 0.002,
    **more: object,
) -> Excited:
    """Return how a measured compliance was excited, with the lines that are compared.

    Neighbouring lines share their error over ``error_lines``; they are thinned to independent ones, and to at most
    `MOST_LINES`.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std``.
    method, level
        See `Excited`.
    band : (float, float)
        Compared from, to [Hz].
    floor : float, optional
        Least standard deviation relative to the compliance: what no model is expected to do better.
    **more : object
        ``duration``, ``feed``, ``controller``, ``window``, ``noise_freedom`` of `Excited`.
    """
    f = compliance["frequency"].values
    lines = chosen_lines(f, band, float(compliance.attrs.get("error_lines", 1.0)))
    rows = [str(a) for a in compliance["response"].values]
    columns = [str(a) for a in compliance["excitation"].values]
    entries, std = [], []
    for r in rows:
        for e in columns:
            entry = {"response": r, "excitation": e}
            phi = compliance["compliance"].sel(entry).values[lines]
            error = compliance["compliance_std"].sel(entry).values[lines]
            if np.all(np.isfinite(phi) & np.isfinite(error)):
                entries.append((r, e))
                std.append(np.hypot(error, floor * np.abs(phi)))
    if not entries:
        raise InputError(
            f"no entry of the compliance is known with its standard deviation from {band[0]:g} to {band[1]:g} Hz; "
            "give repeats (three hits or more) or another band"
        )
    return Excited(f[lines], tuple(entries), np.stack(std, axis=1), method, level, **more)  # type: ignore[arg-type]


def chosen_lines(frequency: Real, band: tuple[float, float], apart: float = 1.0) -> NDArray[np.int64]:
    """Return the lines of a band [Hz] that are compared: `apart` lines or more between them, at most `MOST_LINES`."""
    inside = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0.0))
    return inside[:: max(1, round(apart), -(-inside.size // MOST_LINES))]


def scatter_of(hits: Complex, impulse: Real) -> tuple[Real, Complex]:
    """Return what the mean of some hits is worth: standard deviation of each line, and errors shared by all lines.

    Parameters
    ----------
    hits : ndarray, shape (r, f)
        Compliance from each hit [m/N], r >= 3.
    impulse : ndarray, shape (r,)
        Of each hit [N s].

    Returns
    -------
    std : ndarray, shape (f,)
        Root mean square of the complex error of each line, smooth over frequency [m/N].
    shared : ndarray, shape (r, f)
        See `Excited`.
    """
    count = hits.shape[0]
    if count < 3:
        raise InputError(f"{count} hits tell nothing about their scatter; give three or more")
    away = hits - hits.mean(axis=0)
    bend = away[:, :-2] - 2.0 * away[:, 1:-1] + away[:, 2:]
    square = np.sum(np.abs(bend) ** 2, axis=0) / (6.0 * (count - 1))
    kernel = np.ones(_SMOOTH)
    size = np.convolve(np.ones(square.size), kernel, "same")
    smooth = np.pad(np.convolve(square, kernel, "same") / size, 1, mode="edge")
    freedom = count - 1
    if count > 3:
        level = impulse - impulse.mean()
        away = away - np.outer(level, level @ away) / max(float(level @ level), 1e-300)
        freedom -= 1
    # A complex row stands for two real factors: real and imaginary parts of the error go together. The scatter is known
    # from a few lines only: a mean square of n complex values divides by n/(n - 1) of itself on average.
    known = (count - 1) * _SMOOTH / _CORRELATED
    return np.sqrt(smooth / count * known / (known - 1.0)), away * np.sqrt(SHARED / (freedom * count))


def freedom_of(repeats: int, values: int) -> float:
    """Return the degrees of freedom with which a scatter over some repeats is known over many lines.

    Values that are compared, not all that the scatter was smoothed over: what those between them add is lost again
    where noise is taken for that of a few neighbours.

    Parameters
    ----------
    repeats : int
        Hits or records that were averaged.
    values : int
        Independent complex values that are compared.
    """
    return 2.0 * (repeats - 1) * values


def smooth_errors(frequency: Real, compliance: Complex, share: float) -> Complex:
    """Return smooth relative errors of a compliance, shape (2 `SMOOTH_SHAPES`, f, entries); for `Excited.shared`.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        [Hz].
    compliance : ndarray, shape (f, entries)
        [m/N].
    share : float
        Root mean square of the complex relative error of a line, all shapes together.
    """
    u = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
    order = np.arange(SMOOTH_SHAPES)
    shapes = np.cos(np.pi * order[:, None] * u) * np.where(order == 0, 1.0, np.sqrt(2.0))[:, None]
    each = share / np.sqrt(2.0 * SMOOTH_SHAPES) * shapes[:, :, None] * compliance
    return np.concatenate([each, 1j * each])


# --- What the single hits of a measurement tell a diagnosis: their scatter, their forces, and how long they were
# followed.

DISCREPANCY = 0.004
"""Root mean square of the smooth relative error by which two simulations of one machine may differ."""

FEWEST = 3
"""Hits whose scatter tells anything."""


def compared(
    excited: Excited, compliance: xr.Dataset, hits: xr.Dataset | None, discrepancy: float, floor: float = 0.002
) -> Excited:
    """Return how a compliance along one axis was excited, as a simulation in time is compared with it.

    Parameters
    ----------
    excited : Excited
        From `excitation_of`, one entry; its level gets the sign of the force.
    compliance : xarray.Dataset
        The mean.
    hits : xarray.Dataset, optional
        What it is the mean of (`smfe.identification.hammer.impacts.single_hits`).
    discrepancy : float
        Root mean square of the smooth relative error of the simulation.
    floor : float, optional
        As of `excitation_of`.
    """
    ((response, excitation),) = excited.entries
    mean = compliance["compliance"].sel(response=response, excitation=excitation).values
    mean = mean[np.searchsorted(compliance["frequency"].values, excited.frequency - 1e-9)]
    smooth = smooth_errors(excited.frequency, mean[:, None], discrepancy)
    if hits is None:
        return replace(excited, shared=smooth)
    f = hits["frequency"].values
    pick = np.searchsorted(f, excited.frequency - 1e-9)
    # A sensor that roves is not along this axis in every hit.
    hits = hits.isel(hit=np.isfinite(hits["compliance"].sel(response=response).values[:, pick]).all(axis=1))
    if hits.sizes["hit"] < FEWEST:
        return replace(excited, shared=smooth)
    each = hits["compliance"].sel(response=response).values
    force, rate = hits["force"].values, 1.0 / float(np.diff(hits["contact_time"].values[:2])[0])
    impulse = force.sum(axis=1) / rate
    known = np.isfinite(each).all(axis=0)
    std, shared = np.full(f.size, np.nan), np.full((len(each), f.size), np.nan, dtype=complex)
    std[known], shared[:, known] = scatter_of(each[:, known], impulse)
    # Whatever was done to the mean (another estimator, the mass of a sensor taken off) is done to the hits.
    plain = (impulse**2 @ each[:, pick]) / np.sum(impulse**2)
    each = each[:, pick] * (mean / plain)
    return replace(
        excited,
        std=np.hypot(std[pick], floor * np.abs(mean))[:, None],
        shared=np.concatenate([shared[:, pick, None], smooth]),
        level=math.copysign(excited.level, impulse.sum()),
        window=float(hits.attrs["window_s"]),
        hits=Hits(force, rate, each[:, :, None]),
        noise_freedom=freedom_of(len(each), pick.size),
    )
