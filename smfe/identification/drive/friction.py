"""Identification of friction laws: from mean forces at constant feeds, or from records of an axis that moves.

A record holds ``encoder_position`` and ``drive_force`` (see `process.labels`). Its stretches of steady velocity are
found first (`friction_runs`), each gives one point of the curve; the curve is then fitted, each direction by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import signal, stats
from scipy.optimize import least_squares, nnls

from process.errors import InputError
from process.friction.laws import Andersson
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.identification.drive.rules import RULES

PARAMETERS = ("coulomb", "static", "stribeck_speed", "sigma")
"""What steady runs identify, for each direction."""


@dataclass(frozen=True)
class FrictionFit:
    """A friction law identified from steady runs.

    Attributes
    ----------
    law : Andersson
        The law, with its own parameters for negative velocity where both directions were run.
    estimates : xarray.Dataset
        ``value``, ``std`` (direction, parameter), SI; NaN where a parameter is not part of the law;
        ``residual_std(direction)`` [N]; ``runs(direction)``. Direction is 1 or -1.
    status : str
        "ok", or what the runs could not resolve.
    """

    law: Andersson
    estimates: xr.Dataset
    status: str


@dataclass(frozen=True)
class _Side:
    """Fit of one direction: value and std (4,), in the order of `PARAMETERS`; p-value of no Stribeck curve."""

    value: Real
    std: Real
    residual: float
    runs: int
    p_value: float = 0.0


def fit_friction_curve(
    velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None = None, *, kt: float, delta: float = 1.0
) -> FrictionFit:
    """Identify the Stribeck curve from runs at constant feeds, each direction by itself.

    Weighted least squares of ``[Fc + (Fs - Fc) exp(-(|v|/vs)^delta)] tanh(kt |v|) + sigma |v|``: the law is linear in
    Fc, Fs - Fc and sigma, so that vs is scanned first; then all four are refined with none negative.

    Parameters
    ----------
    velocity : array_like, shape (n,)
        Feed of each run [m/s]; the sign is the direction.
    force : array_like, shape (n,)
        Mean drive force of each run [N], of the sign of the velocity.
    force_std : array_like, shape (n,), optional
        Standard deviation of each force [N]; without it, the scatter about the curve is taken.
    kt : float
        Steepness at rest [s/m]; steady sliding does not show it.
    delta : float, optional
        Shape of the Stribeck curve.

    Returns
    -------
    FrictionFit
        Law, values and standard deviations.

    Raises
    ------
    InputError
        For a run at rest, or fewer than four different feeds in a direction.
    """
    return _fit(velocity, force, force_std, Andersson(0.0, 0.0, 1.0, 0.0, kt, delta), _fit_stribeck, least=4)


def fit_coulomb_curve(
    velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None = None, *, kt: float
) -> FrictionFit:
    """Identify Coulomb and viscous friction from runs at constant feeds: the limit without a Stribeck curve.

    Parameters
    ----------
    velocity, force, force_std, kt
        As in `fit_friction_curve`; two different feeds in a direction are enough.

    Returns
    -------
    FrictionFit
        The law has ``static = coulomb``.
    """
    return _fit(velocity, force, force_std, Andersson(0.0, 0.0, 1.0, 0.0, kt), _fit_coulomb, least=2)


def _fit(
    velocity: ArrayLike,
    force: ArrayLike,
    force_std: ArrayLike | None,
    shape: Andersson,
    fit_side: Callable[[Real, Real, Real | None, Andersson], _Side],
    least: int,
) -> FrictionFit:
    """Fit each direction that was run; `shape` carries kt and delta."""
    v, f = np.asarray(velocity, dtype=float), np.asarray(force, dtype=float)
    std = None if force_std is None else np.asarray(force_std, dtype=float)
    _check_runs(v, f, std, least)
    sides: dict[int, _Side] = {}
    for direction in (1, -1):
        here = v * direction > 0.0
        if here.any():
            weight = None if std is None else 1.0 / std[here]
            sides[direction] = fit_side(np.abs(v[here]), direction * f[here], weight, shape)
    first, *rest = (_law(shape, side.value) for side in sides.values())
    law = first if not rest else replace(first, negative=rest[0])
    return FrictionFit(law, _estimates(sides), _fit_status(sides))


def _law(shape: Andersson, value: Real) -> Andersson:
    coulomb, static, speed, sigma = (float(x) for x in value)
    if math.isnan(static):
        static, speed = coulomb, 1.0
    return replace(shape, coulomb=coulomb, static=static, stribeck_speed=speed, sigma=sigma)


def _check_runs(v: Real, f: Real, std: Real | None, least: int) -> None:
    if v.ndim != 1 or v.shape != f.shape or (std is not None and std.shape != v.shape):
        raise InputError(f"velocity of shape {v.shape} and force of shape {f.shape}; give one value a run to each")
    if v.size == 0 or not (np.all(np.isfinite(v)) and np.all(np.isfinite(f))) or np.any(v == 0.0):
        raise InputError("a run has no feed, or a value that is not finite; leave such runs out")
    if std is not None and not np.all(std > 0.0):
        raise InputError("a standard deviation of the force is not positive; give positive ones or none")
    for direction, name in ((1.0, "positive"), (-1.0, "negative")):
        feeds = np.unique(v[v * direction > 0.0]).size
        if 0 < feeds < least:
            raise InputError(f"{feeds} different feeds in {name} direction; {least} are needed, run more feeds")


def _covariance(jacobian: Real, residual: Real, known: bool) -> Real:
    """``(J^T J)^-1``, times the scatter where the noise is not known; NaN without degrees of freedom."""
    degrees_of_freedom = residual.size - jacobian.shape[1]
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    if known:
        return np.asarray(inverse)
    variance = float(residual @ residual) / degrees_of_freedom if degrees_of_freedom > 0 else math.nan
    return np.asarray(inverse * variance)


def _scatter(residual: Real, unknowns: int) -> float:
    return math.sqrt(float(residual @ residual) / max(residual.size - unknowns, 1))


def _basis(v: Real, shape: Andersson) -> Real:
    """Columns that Fc, Fs - Fc and sigma multiply, at speeds v (n,), for the vs, kt and delta of `shape`."""
    columns = ((1.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    laws = [replace(shape, coulomb=c, static=s, sigma=sigma) for c, s, sigma in columns]
    return np.stack([law.force(v) for law in laws], axis=1)


def _fit_coulomb(v: Real, f: Real, weight: Real | None, shape: Andersson) -> _Side:
    w = np.ones(v.size) if weight is None else weight
    basis = _basis(v, shape)[:, [0, 2]]
    unknowns, _ = nnls(basis * w[:, None], f * w)
    residual = f - basis @ unknowns
    std = np.sqrt(np.diag(_covariance(basis * w[:, None], residual * w, weight is not None)))
    value, spread = (np.array([x[0], math.nan, math.nan, x[1]]) for x in (unknowns, std))
    return _Side(value, spread, _scatter(residual, 2), v.size)


def _fit_stribeck(v: Real, f: Real, weight: Real | None, shape: Andersson) -> _Side:
    w = np.ones(v.size) if weight is None else weight

    def basis(speed: float) -> Real:
        return _basis(v, replace(shape, stribeck_speed=speed)) * w[:, None]

    speeds = np.geomspace(0.2 * v.min(), 2.0 * v.max(), 200)
    speed = float(speeds[np.argmin([nnls(basis(float(s)), f * w)[1] for s in speeds])])
    coulomb, boost, sigma = nnls(basis(speed), f * w)[0]
    scale = np.array([np.abs(f).max(), np.abs(f).max(), speed, np.abs(f).max() / v.max()])
    start = np.array([coulomb, boost, speed, sigma]) / scale
    # A Stribeck speed far below the slowest run cannot be seen; it would only send the static force to infinity.
    low = np.array([0.0, 0.0, speeds[0] / speed, 0.0])

    # Fs - Fc in place of Fs: a static force below the sliding one would be no Stribeck curve.
    turn = np.eye(4)
    turn[1, 0] = 1.0

    def misfit(q: Real) -> Real:
        return np.asarray((f - _law(shape, turn @ (q * scale)).force(v)) * w)

    found = least_squares(misfit, np.maximum(start, low + 1e-9), bounds=(low, np.inf), xtol=1e-14, ftol=1e-14)
    value = turn @ (found.x * scale)
    covariance = _covariance(np.asarray(found.jac, dtype=float), found.fun, weight is not None)
    to_law = turn * scale
    std = np.sqrt(np.diag(to_law @ covariance @ to_law.T))
    p_value = _p_value(basis(1.0)[:, [0, 2]], f * w, float(found.fun @ found.fun), weight is not None)
    return _Side(value, std, _scatter(f - _law(shape, value).force(v), 4), v.size, p_value)


def _p_value(line: Real, f: Real, remaining: float, known: bool) -> float:
    """Probability that runs without a Stribeck curve gain as much by fitting one (chi-square, or F test)."""
    gained = nnls(line, f)[1] ** 2 - remaining
    if known:
        return float(stats.chi2.sf(gained, 2))
    degrees_of_freedom = f.size - 4
    if degrees_of_freedom < 1:
        return 1.0
    return float(stats.f.sf(gained / 2.0 * degrees_of_freedom / max(remaining, 1e-300), 2, degrees_of_freedom))


def _estimates(sides: dict[int, _Side]) -> xr.Dataset:
    units = ["N", "N", "m/s", "N s/m"]
    both = ("direction", "parameter")
    return xr.Dataset(
        {
            "value": (both, np.array([s.value for s in sides.values()]), {"units": ", ".join(units)}),
            "std": (both, np.array([s.std for s in sides.values()]), {"units": ", ".join(units)}),
            "residual_std": ("direction", [s.residual for s in sides.values()], {"units": "N"}),
            "runs": ("direction", [s.runs for s in sides.values()], {"units": "1"}),
        },
        coords={"direction": list(sides), "parameter": list(PARAMETERS), "unit": ("parameter", units)},
    )


def _fit_status(sides: dict[int, _Side]) -> str:
    """Say where the Stribeck curve is not resolved by the runs."""
    for direction, side in sides.items():
        if side.p_value > 0.05:
            name = "positive" if direction > 0 else "negative"
            return (
                f"the Stribeck curve in {name} direction is not resolved: a straight line fits the runs as well "
                f"(p = {side.p_value:.2g}); run more and slower feeds, or use fit_coulomb_curve"
            )
    return "ok"


class _Motion(NamedTuple):
    """Velocity [m/s] and acceleration [m/s^2], shape (n,), by local regression, and their standard deviations."""

    velocity: Real
    acceleration: Real
    velocity_std: float
    acceleration_std: float


def _motion(position: Real, dt: float, width: int) -> _Motion:
    """Regress a parabola on `width` samples about each sample.

    The noise of the encoder, its quantisation included, is the scatter about the parabolas:
    median absolute residual/0.6745, over ``sqrt(1 - h)`` with h the weight of a sample in its own value.
    """
    # The offset of the record is taken away first: a filter multiplies it by rounding errors.
    x = position - position[0]
    smooth, velocity, acceleration = (
        signal.savgol_filter(x, width, 2, deriv=d, delta=dt, mode="interp") for d in (0, 1, 2)
    )
    weights = [signal.savgol_coeffs(width, 2, deriv=d, delta=dt) for d in (0, 1, 2)]
    own = float(weights[0][width // 2])
    noise = float(np.median(np.abs(x - smooth))) / 0.6745 / math.sqrt(1.0 - own)
    return _Motion(velocity, acceleration, *(noise * float(np.linalg.norm(w)) for w in weights[1:]))


def _stretches(steady: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First sample and the one after the last of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def mean_and_error(samples: ArrayLike) -> tuple[float, float]:
    """Return the mean of a stationary series and its standard error, correlation accounted for.

    ``s^2 = (c_0 + 2 sum c_k)/n`` over the autocovariances c_k, summed in pairs while these are positive and do not rise
    (initial monotone sequence, Geyer 1992); never below the value without correlation. A series that is shorter than
    a hundred correlation times gives an error that is too small.
    """
    x = np.asarray(samples, dtype=float)
    n, mean = x.size, float(np.mean(x))
    spectrum = np.abs(np.fft.rfft(x - mean, 2 * n)) ** 2
    covariance = np.fft.irfft(spectrum)[: n // 2 * 2] / n
    pairs = covariance[::2] + covariance[1::2]
    ends = np.flatnonzero(pairs <= 0.0)
    pairs = np.minimum.accumulate(pairs[: ends[0] if ends.size else pairs.size])
    variance = max(2.0 * float(pairs.sum()) - float(covariance[0]), float(covariance[0]))
    return mean, math.sqrt(max(variance, 0.0) / n)


def friction_runs(
    record: xr.Dataset, axis: str, *, window: float = 0.05, shortest: float = 0.2, tolerance: float = 0.02
) -> xr.Dataset:
    """Return the stretches of steady velocity in a record, with the mean drive force of each.

    A sample is steady where the acceleration changes the velocity by less than `tolerance` within the window, as far as
    the encoder resolves (4 standard deviations), and where the velocity is 10 standard deviations from zero. A run is
    a stretch of such samples, half a window cut from each end, less as much of its beginning (the servo settles) as it
    takes for the velocity to change by less than `tolerance` in all.

    Parameters
    ----------
    record : xarray.Dataset
        With ``encoder_position`` and ``drive_force``.
    axis : {"x", "y", "z"}
        Axis that moves.
    window : float, optional
        Length of the local regression [s].
    shortest : float, optional
        Shortest run [s].
    tolerance : float, optional
        Largest change of velocity over velocity [1].

    Returns
    -------
    xarray.Dataset
        Over ``run``: ``velocity`` [m/s], ``acceleration`` [m/s^2], mean ``force`` [N] and its ``force_std`` [N]
        (`mean_and_error`), ``position`` [m] of the middle, ``start`` and ``duration`` [s].

    Raises
    ------
    InputError
        When a channel is missing, the window holds fewer than 5 samples, or no stretch is steady.
    """
    for channel in ("encoder_position", "drive_force"):
        if axis not in axis_present(record, channel):
            raise InputError(f"the record has no {channel} on axis {axis!r}; friction is read from both channels")
    dt = sample_interval(record)
    width = 2 * round(0.5 * window / dt) + 1
    if width < 5 or not shortest >= RULES.least_samples * dt or not 0.0 < tolerance < 1.0:
        raise InputError(
            f"window {window:g} s, shortest run {shortest:g} s, tolerance {tolerance:g} at {dt:g} s a sample; the "
            f"window needs 5 samples, a run {RULES.least_samples}, the tolerance a value between 0 and 1"
        )
    x, force = (record[name].sel(axis=axis).values for name in ("encoder_position", "drive_force"))
    if x.size < width:
        raise InputError(f"the record has {x.size} samples and the window {width}; give a longer record")
    m = _motion(x, dt, width)
    speed = np.abs(m.velocity)
    limit = tolerance * speed / (width * dt) + RULES.acceleration_sigmas * m.acceleration_std
    steady = (np.abs(m.acceleration) <= limit) & (speed > RULES.resolved_velocity * m.velocity_std) & (speed > 0.0)
    cut = width // 2
    spans = [(a + cut, b - cut) for a, b in _stretches(steady)]
    rows = [_settled(x, force, dt, span, shortest, tolerance) for span in spans]
    kept = [row for row in rows if row is not None]
    if not kept:
        raise InputError(
            f"no run of {shortest:g} s at steady velocity among {len(spans)} stretches (velocity is distinguished from "
            f"zero above {RULES.resolved_velocity * m.velocity_std:.2g} m/s); run constant feeds for longer, or "
            "widen the window"
        )
    start = float(record["time"].values[0])
    return _table(kept, start, axis)


def _settled(
    x: Real, force: Real, dt: float, span: tuple[int, int], shortest: float, tolerance: float
) -> dict[str, float] | None:
    """The run of a stretch, less what its beginning still changes in velocity; None when too little is left."""
    first, last = span
    while (last - first) * dt >= shortest:
        run = _run(x, force, dt, first, last)
        if abs(run["acceleration"]) * run["duration"] <= tolerance * abs(run["velocity"]):
            return run
        first += max(1, (last - first) // 10)
    return None


def _run(x: Real, force: Real, dt: float, first: int, last: int) -> dict[str, float]:
    """One run, samples first to last - 1: a parabola through its positions, and its mean force."""
    n = last - first
    t = (np.arange(n) - 0.5 * (n - 1)) * dt
    curve = np.polynomial.Polynomial.fit(t, x[first:last], 2).convert().coef
    _, velocity, half = np.pad(curve, (0, 3 - curve.size))
    mean, error = mean_and_error(force[first:last])
    return {
        "velocity": float(velocity),
        "acceleration": 2.0 * float(half),
        "force": mean,
        # A force without scatter is known to its rounding.
        "force_std": max(error, 1e-12 * float(np.abs(force).max()), 1e-300),
        "position": float(np.mean(x[first:last])),
        "start": first * dt,
        "duration": n * dt,
    }


def _table(rows: list[dict[str, float]], start: float, axis: str) -> xr.Dataset:
    units = ("m/s", "m/s^2", "N", "N", "m", "s", "s")
    data = {
        name: ("run", np.array([row[name] for row in rows]) + (start if name == "start" else 0.0), {"units": unit})
        for name, unit in zip(rows[0], units, strict=True)
    }
    return xr.Dataset(data, attrs={"axis": axis})


def constant_force(runs: xr.Dataset, tolerance: float = 0.02) -> tuple[float, float]:
    """Return the constant part [N] of the drive force and its standard deviation [N], for symmetric friction.

    Weight, an unbalanced counterweight or an offset of the amplifier: half the sum of the forces at the same speed in
    both directions, averaged with weights over all such pairs. Friction that differs between the directions cannot be
    distinguished from a constant force by steady runs. The scatter between the pairs counts where it exceeds the stated
    standard errors of the runs.

    Parameters
    ----------
    runs : xarray.Dataset
        From `friction_runs`.
    tolerance : float, optional
        Largest difference of speed over speed in a pair [1].

    Raises
    ------
    InputError
        When no speed was run in both directions.
    """
    v, f, std = (runs[name].values for name in ("velocity", "force", "force_std"))
    up, down = np.flatnonzero(v > 0.0), np.flatnonzero(v < 0.0)
    values, weights = [], []
    while up.size:
        group = np.abs(v[up] - v[up[0]]) <= tolerance * v[up[0]]
        mates = down[np.abs(v[down] + v[up[0]]) <= tolerance * v[up[0]]]
        if mates.size:
            sides = [_weighted(f[i], std[i]) for i in (up[group], mates)]
            values.append(0.5 * (sides[0][0] + sides[1][0]))
            weights.append(0.5 * math.hypot(sides[0][1], sides[1][1]))
        up = up[~group]
    if not values:
        raise InputError("no speed was run in both directions; the constant force shows only in such pairs")
    return _weighted(np.array(values), np.array(weights))


def _weighted(values: Real, std: Real) -> tuple[float, float]:
    """Weighted mean and its standard deviation, raised to the scatter (Birge ratio)."""
    w = 1.0 / std**2
    mean = float(w @ values / w.sum())
    return mean, _birge((values - mean) / std, 1) / math.sqrt(float(w.sum()))


def _birge(score: Real, unknowns: int) -> float:
    """Return ``sqrt(chi^2/nu)`` of scores (n,), at least 1: the factor by which stated deviations are too small."""
    degrees_of_freedom = score.size - unknowns
    return max(1.0, math.sqrt(float(score @ score) / degrees_of_freedom)) if degrees_of_freedom > 0 else 1.0


class CurveFit(Protocol):
    """`fit_friction_curve`, `fit_coulomb_curve`, or one of them with its delta set."""

    def __call__(
        self, velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None = None, *, kt: float
    ) -> FrictionFit:
        """Return the fit to runs."""


class RecordFit(NamedTuple):
    """A friction law from records, the runs that it was fitted to, and the constant force [N] taken away."""

    fit: FrictionFit
    runs: xr.Dataset
    offset: float


def fit_friction_record(
    record: xr.Dataset | Sequence[xr.Dataset],
    axis: str,
    *,
    kt: float,
    curve: CurveFit = fit_friction_curve,
    offset: float = 0.0,
    mass: float = 0.0,
    runs: Callable[[xr.Dataset, str], xr.Dataset] = friction_runs,
) -> RecordFit:
    """Identify a friction law from one record or several of an axis that runs at constant feeds.

    Each run gives ``force - offset - mass acceleration`` at its velocity. Where the runs scatter about the law by more
    than their standard errors (friction that depends on position, temperature), the standard deviations are raised by
    ``sqrt(chi^2/degrees_of_freedom)`` and the status says so.

    Parameters
    ----------
    record : xarray.Dataset or sequence of them
        With ``encoder_position`` and ``drive_force``.
    axis : {"x", "y", "z"}
        Axis that moves.
    kt : float
        Steepness at rest [s/m]; steady sliding does not show it.
    curve : callable, optional
        `fit_friction_curve`, or `fit_coulomb_curve` for few feeds.
    offset : float, optional
        Constant force [N], known or from `constant_force`.
    mass : float, optional
        Moving mass [kg], for what remains of the acceleration in a run.
    runs : callable, optional
        Record and axis to runs; ``functools.partial(friction_runs, window=...)`` for other settings.

    Returns
    -------
    RecordFit
        Fit, runs and offset.

    Raises
    ------
    InputError
        When the records hold no steady runs, or too few feeds for the curve.
    """
    records = [record] if isinstance(record, xr.Dataset) else list(record)
    if not records or not math.isfinite(offset) or not 0.0 <= mass < math.inf:
        raise InputError(
            f"{len(records)} records, offset {offset:g} N, mass {mass:g} kg; give a record, a finite offset and "
            "a mass >= 0"
        )
    table = xr.concat([runs(r, axis) for r in records], "run")
    v, std = table["velocity"].values, table["force_std"].values
    force = table["force"].values - offset - mass * table["acceleration"].values
    return RecordFit(_with_scatter(curve(v, force, std, kt=kt), v, force, std), table, offset)


def _with_scatter(fit: FrictionFit, v: Real, force: Real, std: Real) -> FrictionFit:
    """Raise the standard deviations of each direction to the scatter of its runs."""
    score = (force - fit.law.force(v)) / std
    unknowns = int(np.isfinite(fit.estimates["value"].values[0]).sum())
    factor = {int(d): _birge(score[v * d > 0.0], unknowns) for d in fit.estimates["direction"].values}
    scaled = fit.estimates.copy()
    scaled["std"] = scaled["std"] * xr.DataArray(list(factor.values()), {"direction": list(factor)})
    scaled["std"].attrs = fit.estimates["std"].attrs
    worst = max(factor.values())
    if worst < 2.0:
        return replace(fit, estimates=scaled)
    scatter = f"the runs scatter {worst:.3g} times more about the law than within themselves"
    return replace(fit, estimates=scaled, status=scatter if fit.status == "ok" else f"{fit.status}; {scatter}")
