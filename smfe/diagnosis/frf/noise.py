"""How a compliance was measured, what its error is like, and residuals of unit variance.

The error of a line is that of its noise, smooth over frequency and independent from line to line, and what the hits
have in common over all lines: levels and states at rest that differ from hit to hit. The first is read off second
differences over neighbouring lines, the second off what remains between the hits when their level is taken off. Beyond
noise two simulations of one machine differ a little, smoothly over frequency: that is an error all lines share as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Complex, Real
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Condition

Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)


def kept(results: MutableMapping[Key, Result], key: Key, make: Callable[[], Result], most: int) -> Result:
    """Return a result that was made before, or make it; all are dropped when there are too many."""
    if key not in results:
        if len(results) >= most:
            results.clear()
        results[key] = make()
    return results[key]


@dataclass(frozen=True)
class Hits:
    """The hits that a mean compliance was taken from."""

    force: Real  # force from the first contact on [N], shape (r, n)
    rate: float  # its samples a second [Hz]
    compliance: Complex  # from each hit [m/N], shape (r, f, entries)

    @property
    def impulse(self) -> Real:
        """Of each hit [N s], shape (r,)."""
        return np.asarray(self.force.sum(axis=1) / self.rate)


@dataclass(frozen=True, eq=False)
class Excited:
    """How a compliance was measured, and where."""

    frequency: Real  # lines that are compared [Hz], shape (f,)
    entries: tuple[tuple[str, str], ...]  # (response, excitation) of each entry
    std: Real  # root mean square of the complex error of each line by itself [m/N], shape (f, entries)
    method: str  # how the force was applied: "hammer" or "actuator"
    level: float  # impulse [N s] of a hammer, amplitude [N] of an actuator: of a multisine that of a sine of its rms
    duration: float = 4e-3  # contact time of the hammer [s]
    feed: Mapping[str, float] = field(default_factory=dict)  # axis -> feed [m/s]
    controller: str | None = None  # name of the controller
    shared: Complex | None = None
    """Errors that all lines have in common, each with a random factor of unit variance [m/N], shape (m, f, entries)."""
    presliding: Complex | None = None
    """What hits find otherwise where the guideway gives way otherwise before it slides [m/N], shape (n, f, entries)."""
    window: float = 2.0  # time after a hit that was transformed [s]
    hits: Hits | None = field(default=None, repr=False)  # the hits one by one, where they are known
    degrees_of_freedom: float = math.inf
    """With which `std` is known over all lines (`degrees_of_freedom_of`); infinite: it is known."""
    repeats: int = 1  # hits, or records, that the compliance is the mean of
    impulses: Mapping[str, float] = field(default_factory=dict)  # axis -> impulse of its hits [N s]; else `level`
    band: float = 0.0  # over which an actuator shakes at all frequencies at once [Hz]; 0: one sine after another
    _rows: Real = field(init=False, repr=False)
    _less: Real = field(init=False, repr=False)

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
        how = (self.method, self.level, self.duration, self.controller, self.window, self.entries, self.band)
        return (*how, tuple(self.feed.items()), self.frequency.tobytes())

    def whitened(self, values: Complex) -> Real:
        """Return complex values (f, entries) as real ones of unit variance, shape (2 f entries,).

        Real and imaginary parts in turn, over the standard deviation, then less where errors are shared:
        ``(I + L L^T)^(-1/2)``.
        """
        flat = _scaled(values, self.std)
        return np.asarray(flat - self._rows.T @ (self._less * (self._rows @ flat)))

    def whitened_each(self, values: Complex) -> Real:
        """Return several complex values (p, f, entries) as rows of `whitened`, shape (p, 2 f entries)."""
        scaled = (np.sqrt(2.0) * values / self.std).transpose(0, 2, 1)
        flat = np.ascontiguousarray(scaled).view(np.float64).reshape(len(values), -1)
        return np.asarray(flat - (flat @ self._rows.T * self._less) @ self._rows)

    def unwhitened(self, values: Real) -> Complex:
        """Return complex values, columns of shape (entries f, n), from real ones, (2 f entries, n), of `whitened`."""
        more = (self._less / (1.0 - self._less))[:, None]
        flat = values + self._rows.T @ (more * (self._rows @ values))
        return np.asarray((flat[0::2] + 1j * flat[1::2]) * self.std.T.reshape(-1, 1) / np.sqrt(2.0))

    def compliance_of(self, values: Real) -> Complex:
        """Return the complex values (f, entries) that `whitened` makes these of."""
        return np.asarray(self.unwhitened(values[:, None]).reshape(len(self.entries), -1).T)

    def squared_size(self, observed: Real, misfit: Real) -> float:
        """Return the square of a misfit relative to the compliance where that limits the depth of cut [1].

        The zero-order limit depth goes with one over the most negative real part. Of every direct entry the real part
        counts, over its most negative value, as a mean square over the lines near it (those within half of it, most
        the deepest). An entry much stiffer than another counts over a share of that (`RULES.stiff_axis`).
        """
        seen, wrong = self.compliance_of(observed), self.compliance_of(misfit)
        direct = [n for n, (response, excitation) in enumerate(self.entries) if response == excitation]
        if not direct:
            return float(np.sum(np.abs(wrong) ** 2) / np.sum(np.abs(seen) ** 2))
        least = RULES.stiff_axis * max(_depth(seen[:, n])[0] for n in direct)
        width, total = np.gradient(self.frequency) if self.frequency.size > 1 else np.ones(1), 0.0
        for n in direct:
            depth, weight = _depth(seen[:, n])
            weight = weight * width
            total += float(weight @ wrong[:, n].real ** 2 / weight.sum()) / max(depth, least) ** 2
        return total


def _depth(compliance: Complex) -> tuple[float, Real]:
    """Most negative real part of a compliance, without its sign, and a weight of the lines near it."""
    down = -compliance.real
    if down.max() <= 0.0:
        return float(np.abs(compliance).max()), np.abs(compliance) ** 2
    deepest = int(np.argmax(down))
    inside = np.maximum(down / down[deepest] - 0.5, 0.0)
    gone = np.flatnonzero(inside == 0.0)
    inside[: max(gone[gone < deepest], default=-1) + 1] = 0.0
    inside[min(gone[gone > deepest], default=inside.size) :] = 0.0
    return float(down[deepest]), inside


def excited_of(condition: Condition) -> Excited:
    """Return how a condition was excited."""
    assert isinstance(condition.data, Excited)
    return condition.data


def _scaled(values: Complex, std: Real) -> Real:
    scaled = (np.sqrt(2.0) * values / std).T
    return np.stack([scaled.real, scaled.imag], axis=-1).ravel()


# --- From a measured compliance to a condition.


def excitation_of(
    compliance: xr.Dataset, method: str, level: float, band: tuple[float, float], **more: object
) -> Excited:
    """Return how a measured compliance was excited, with the lines of a band [Hz] that are compared.

    Neighbouring lines share their error over ``error_lines``; they are thinned to independent ones. `more` are other
    fields of `Excited`.

    Raises InputError without an entry that is known with its standard deviation.
    """
    f = compliance["frequency"].values
    lines = chosen_lines(f, band, float(compliance.attrs.get("error_lines", 1.0)))
    entries, std = [], []
    for r in map(str, compliance["response"].values):
        for e in map(str, compliance["excitation"].values):
            at = {"response": r, "excitation": e}
            phi, error = (compliance[n].sel(at).values[lines] for n in ("compliance", "compliance_std"))
            if np.all(np.isfinite(phi) & np.isfinite(error)):
                entries.append((r, e))
                std.append(np.hypot(error, RULES.floor * np.abs(phi)))
    if not entries:
        raise InputError(
            f"no entry of the compliance is known with its standard deviation from {band[0]:g} to {band[1]:g} Hz; "
            "give repeats (three hits or more) or another band"
        )
    return Excited(f[lines], tuple(entries), np.stack(std, axis=1), method, level, **more)  # type: ignore[arg-type]


def chosen_lines(frequency: Real, band: tuple[float, float], apart: float = 1.0) -> NDArray[np.int64]:
    """Return the lines of a band [Hz] that are compared, `apart` lines or more between them."""
    inside = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0.0))
    return inside[:: max(1, round(apart), -(-inside.size // RULES.most_lines))]


def compared(excited: Excited, compliance: xr.Dataset, hits: xr.Dataset | None, hum: float = 0.0) -> Excited:
    """Return how a compliance along one axis was excited, as a simulation in time is compared with it.

    `compliance` is the mean of `hits` (`smfe.identification.hammer.impacts.single_hits`), where they are known; the
    level gets the sign of the force. Hits scatter together but for the lines near the mains' harmonics, which are
    averaged with their neighbours: these have `hum` (of the rms of all lines) besides.
    """
    ((response, excitation),) = excited.entries
    mean = compliance["compliance"].sel(response=response, excitation=excitation).values
    mean = mean[_places(compliance, excited)]
    smooth = smooth_errors(excited.frequency, mean[:, None], RULES.discrepancy)
    if hits is None:
        return replace(excited, shared=smooth)
    pick = _places(hits, excited)
    # A sensor that roves is not along this axis in every hit.
    hits = hits.isel(hit=np.isfinite(hits["compliance"].sel(response=response).values[:, pick]).all(axis=1))
    if hits.sizes["hit"] < RULES.fewest_hits:
        return replace(excited, shared=smooth)
    each = hits["compliance"].sel(response=response).values
    force, rate = hits["force"].values, 1.0 / float(np.diff(hits["contact_time"].values[:2])[0])
    impulse = force.sum(axis=1) / rate
    known = np.isfinite(each).all(axis=0)
    std, shared = np.full(known.size, np.nan), np.full(each.shape, np.nan, dtype=complex)
    std[known], shared[:, known] = scatter_of(each[:, known], impulse)
    # Whatever was done to the mean (another estimator, the mass of a sensor taken off) is done to the hits.
    humming = hum * float(np.sqrt(np.mean(np.abs(mean) ** 2))) * near_mains(excited.frequency)
    each = each[:, pick] * (mean / ((impulse**2 @ each[:, pick]) / np.sum(impulse**2)))
    return replace(
        excited,
        std=np.sqrt(std[pick] ** 2 + (RULES.floor * np.abs(mean)) ** 2 + humming**2)[:, None],
        shared=np.concatenate([shared[:, pick, None], smooth]),
        level=math.copysign(excited.level, impulse.sum()),
        window=float(hits.attrs["window_s"]),
        hits=Hits(force, rate, each[:, :, None]),
        degrees_of_freedom=degrees_of_freedom_of(len(each), pick.size),
    )


def condition_of(
    name: str, compliance: xr.Dataset, excited: Excited, settings: Mapping[str, float | str], source: str = ""
) -> Condition:
    """Return a condition from a measured compliance, excited as `excitation_of` says."""
    pick = _places(compliance, excited)
    phi = compliance["compliance"]
    values = np.stack([phi.sel(response=r, excitation=e).values[pick] for r, e in excited.entries], axis=1)
    return Condition(name, dict(settings), excited.whitened(values), source, excited)


def _places(compliance: xr.Dataset, excited: Excited) -> NDArray[np.int64]:
    """Numbers of the compared lines among those of a compliance."""
    return np.searchsorted(compliance["frequency"].values, excited.frequency - 1e-9)


# --- Errors.


def scatter_of(hits: Complex, impulse: Real) -> tuple[Real, Complex]:
    """Return the errors of the mean of hits, from the compliance [m/N], (r, f), and impulse [N s], (r,), of each.

    There are r >= 3 hits. The root mean square of the complex error of each line, smooth over frequency [m/N], shape
    (f,); errors shared by all lines, shape (r, f), as of `Excited`.
    """
    count, lines = hits.shape[0], RULES.smooth_lines
    if count < RULES.fewest_hits:
        raise InputError(f"the scatter of {count} hits is not known; give three or more")
    away = hits - hits.mean(axis=0)
    bend = away[:, :-2] - 2.0 * away[:, 1:-1] + away[:, 2:]
    square = np.sum(np.abs(bend) ** 2, axis=0) / (6.0 * (count - 1))
    # At the lowest lines this is the noise of those below, which have more: at 5 Hz four to ten times what is there. A
    # mean over the trend is right (1/f^2), but of the two axes on which both were tried a healthy one then contradicted
    # its declared friction, and gains were named beside the friction of another. Why is not known.
    sums, size = (np.convolve(x, np.ones(lines), "same") for x in (square, np.ones(square.size)))
    smooth = np.pad(sums / size, 1, mode="edge")
    degrees_of_freedom = count - 1
    if count > 3:
        level = impulse - impulse.mean()
        away = away - np.outer(level, level @ away) / max(float(level @ level), 1e-300)
        degrees_of_freedom -= 1
    # A complex row stands for two real factors: real and imaginary parts of the error go together. The scatter is known
    # from a few lines only: a mean square of n complex values divides by n/(n - 1) of itself on average.
    known = (count - 1) * lines / RULES.correlated
    return np.sqrt(smooth / count * known / (known - 1.0)), away * np.sqrt(RULES.shared / (degrees_of_freedom * count))


def degrees_of_freedom_of(repeats: int, values: int) -> float:
    """Return the degrees of freedom with which a scatter over some hits or records is known over many lines.

    Independent complex values that are compared count, not all that the scatter was smoothed over: what those between
    them add is lost again where noise is taken for that of a few neighbours.
    """
    return 2.0 * (repeats - 1) * values


def near_mains(frequency: Real) -> NDArray[np.bool_]:
    """Return which lines are near the mains' 50 or 60 Hz, or near harmonics of it."""
    away = [np.abs(frequency - mains * np.maximum(np.round(frequency / mains), 1.0)) for mains in (50.0, 60.0)]
    return np.asarray(np.minimum(*away) <= RULES.mains_width)


def smooth_errors(frequency: Real, compliance: Complex, share: float) -> Complex:
    """Return smooth relative errors of a compliance (f, entries), shape (2 shapes, f, entries), as of `Excited.shared`.

    All shapes together have the root mean square `share` of the complex relative error of a line.
    """
    u = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
    order = np.arange(RULES.smooth_shapes)
    shapes = np.cos(np.pi * order[:, None] * u) * np.where(order == 0, 1.0, np.sqrt(2.0))[:, None]
    each = share / np.sqrt(2.0 * RULES.smooth_shapes) * shapes[:, :, None] * compliance
    return np.concatenate([each, 1j * each])
