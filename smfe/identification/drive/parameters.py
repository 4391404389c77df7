"""Inertia and friction of a drive from records of its motion and of the force or torque that it asks for.

Inverse dynamics (Gautier and Khalil; Janot, Gautier and Brunot 2019 for the public axis EMPS), linear or rotary alike:

``F(t - tau) = M x'' + [Fc+ + (Fs+ - Fc+) exp(-(x'/vs+)^d) + b+ x'] (x' > 0) - [Fc- + ...] (x' < 0) + ripple(x)``

with M the moved mass [kg] or inertia [kg m^2], F the drive force [N] or torque [N m]. Both sides pass one zero-phase
low-pass, which differentiates the encoder analytically, so that the equation stays exact in the band. Standstill,
where friction has any value up to its limit, is left out. A constant force (weight, an offset of the amplifier) is part
of the two Coulomb forces, raising one and lowering the other; their mean is free of it. tau is the time from the logged
force to the one that acts. Ripple is added where the record shows it (`smfe.identification.drive.ripple`).

The errors are those of correlated residuals (Newey and West 1987), enlarged by what least squares takes out of them and
by what the noise of the encoder takes off the mass (errors in variables), and averaged over the Stribeck curves that
the record allows (`drive.stribeck`). A parameter whose interval does not stay on its side of zero is not
determined by the record, and no value of it is stated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import optimize, stats

from process.errors import InputError
from process.labels import make_record
from process.types import Real
from smfe.identification.drive.correlated_residual import covariance_of, independent_values, underestimate
from smfe.identification.drive.friction import friction_runs
from smfe.identification.drive.motion import (
    KINDS,
    WAYS,
    Balance,
    Forces,
    Kept,
    Trace,
    balance_of,
    band_of,
    encoder_noise,
    trace_of,
    which_drive,
)
from smfe.identification.drive.results import DriveFit, DriveParameter, Estimate, positive
from smfe.identification.drive.ripple import ripple_columns, waves_of
from smfe.identification.drive.rules import RULES
from smfe.identification.drive.steady import SteadyFit, fit_steady, steady_runs
from smfe.identification.drive.stribeck import Allowed, Curve, Grid, allowed, drawn, grid_of, refined, speed_interval

Name = tuple[str, str]
Weights = dict[Name, float]

_POSSIBLE = {"kg": (1e-2, 1e6), "kg m^2": (1e-8, 1e6)}


def identify_drive(
    name: str,
    records: Sequence[xr.Dataset],
    axis: str | None = None,
    *,
    known: tuple[float, str] | None = None,
    highest: float | None = None,
) -> DriveFit:
    """Identify inertia, friction and delay of a drive from one record or several.

    Parameters
    ----------
    name : str
        Of the measurement, for messages.
    records : sequence of xarray.Dataset
        With ``encoder_position`` or ``encoder_speed`` and ``drive_force`` of an axis, or ``encoder_angle`` or
        ``encoder_rotation`` and ``drive_torque``: a stroke, a step of the drive, runs at constant feeds, any motion.
    axis : {"x", "y", "z"}, optional
        Which axis, where the records have several.
    known : tuple of (float, str), optional
        Moved "mass" [kg] or "inertia" [kg m^2], where it is known: it is then not fitted.
    highest : float, optional
        Highest frequency of the balance [Hz]; default `rules.DriveRules.widest_band`, or where the encoder's noise is
        2 % of the acceleration.

    Returns
    -------
    DriveFit
        Parameters with their 95 % intervals, and the friction over velocity.

    Raises
    ------
    InputError
        When channels are missing, nothing moves, the drive would give out energy, or no parameter is determined.
    """
    rotary, axis = which_drive(records, axis)
    traces = [trace_of(record, rotary, axis, steady=True) for record in records]
    units = KINDS[rotary][3]
    if known is not None and known[1] != ("inertia" if rotary else "mass"):
        raise InputError(
            f"moving_mass is a{'n' * (not rotary)} {known[1]}, but the records are those of a "
            f"{'rotary' if rotary else 'linear'} drive: give it in {units['inertia']}"
        )
    runs = steady_runs(traces, None if known is None else known[0])
    if runs is not None and runs.alone:
        return _of_steady(fit_steady(runs, units), axis, rotary, known)
    traces = [trace_of(record, rotary, axis) for record in records]
    band = band_of(traces, highest)
    balance, kept = balance_of(traces, band)
    found = _fit(balance, kept, band, None if known is None else known[0])
    rows = _parameters(found, units)
    if not any(math.isfinite(p.value) for p in rows if p.name not in ("delay", "constant")):
        reasons = "; ".join(dict.fromkeys(f"{p.name}: {p.note}" for p in rows if p.note))
        raise InputError(f"measurement '{name}': the records determine nothing of the drive of axis {axis} ({reasons})")
    notes = tuple(_notes(found, balance, units))
    return DriveFit(axis, rotary, tuple(rows), band, found.remaining, notes, _friction(found, balance, traces))


def _of_steady(found: SteadyFit, axis: str, rotary: bool, known: tuple[float, str] | None) -> DriveFit:
    """Return what records of one run at constant velocity each say: friction, and no inertia."""
    rows = list(found.rows)
    if known is None:
        nothing = Estimate(math.nan, math.nan, 0.0, math.inf)
        why = "not determined; the axis runs at constant velocity: measure a step or a stroke as well"
        rows.insert(0, DriveParameter.of("inertia", "both", nothing, KINDS[rotary][3]["inertia"], why))
    return DriveFit(axis, rotary, tuple(rows), 0.0, found.remaining, found.notes, found.friction)


class _Component(NamedTuple):
    """Share of one pair of Stribeck curves; value and covariance of the columns that `place` names."""

    share: float
    place: dict[Name, int]
    curves: tuple[Curve | None, Curve | None]
    value: Real
    covariance: Real
    degrees_of_freedom: float


@dataclass(frozen=True)
class _Fit:
    """All curves that are allowed, and what else was found.

    `seen` is the probability of a Stribeck curve by way, `speeds` median and interval of its speed where there may be
    one, `edges` the range in which it was looked for.
    """

    components: tuple[_Component, ...]
    delay: Estimate
    seen: tuple[float, float]
    speeds: tuple[Estimate | None, Estimate | None]
    edges: tuple[tuple[float, float], tuple[float, float]]
    waves: tuple[float, ...]
    lost: float
    remaining: float
    fixed: float | None
    friction: Real

    def sum_of(self, weights: Weights | Callable[[_Component], Weights], curve_of: str | None = None) -> Estimate:
        """Return a weighted sum of parameters; only of components with a curve of this way, where one is named."""
        parts = [c for c in self.components if curve_of is None or ("boost", curve_of) in c.place]
        share = np.array([c.share for c in parts])
        share = share / share.sum()
        mean, spread = np.empty(len(parts)), np.empty(len(parts))
        for k, c in enumerate(parts):
            wanted = weights(c) if callable(weights) else weights
            here = {c.place[name]: w for name, w in wanted.items() if name in c.place}
            at, w = list(here), np.array(list(here.values()))
            mean[k] = w @ c.value[at]
            spread[k] = math.sqrt(max(float(w @ c.covariance[np.ix_(at, at)] @ w), 1e-300))
        return Estimate.mixed(share, mean, spread, np.array([c.degrees_of_freedom for c in parts]))

    def degrees_of_freedom(self) -> float:
        """Return the mean degrees of freedom."""
        return sum(c.share * c.degrees_of_freedom for c in self.components)


def _fit(b: Balance, kept: Sequence[Kept], band: float, known: float | None) -> _Fit:
    """Delay, ripple and Stribeck curves one after the other, twice, as each hides behind the others."""
    names, base = _columns(b, known is None)
    forces = Forces(kept, band)
    reach = 0.3 / band
    grids = grid_of(b, kept, band, 0), grid_of(b, kept, band, 1)
    columns, delay, waves = base, 0.0, list[float]()
    extra = np.zeros((b.run.size, 0))

    def target(tau: float) -> Real:
        return forces(tau) - (0.0 if known is None else known * b.acceleration)

    for turn in range(2):
        delay = _delay(np.hstack([columns, extra]), target, reach)
        if turn == 0:
            size = math.sqrt(float(np.mean(np.square(target(delay) - _inertial(names, columns, target(delay), b)))))
            extra = _curves(grids, _best(_allowed(columns, target(delay), grids, size, extra, b)))[1]
            waves = waves_of(b, np.hstack([columns, extra]), target(delay), band)
            columns = np.hstack([base, *(ripple_columns(b, k, band) for k in waves)])
        pairs = _allowed(columns, target(delay), grids, size, extra, b)
        extra = _curves(grids, _best(pairs))[1]
    # What a coarse grid leaves looks like scatter: only finer ones say how well the curves are known.
    for _ in range(RULES.stages):
        grids = (
            refined(grids[0], _of_way(pairs.first, grids[0], pairs), kept, band, 0),
            refined(grids[1], _of_way(pairs.second, grids[1], pairs), kept, band, 1),
        )
        for _ in range(2):
            pairs = _allowed(columns, target(delay), grids, size, extra, b)
            extra = _curves(grids, _best(pairs))[1]
    force = target(delay)
    at, shares = drawn(pairs.probability, RULES.drawn)
    power = float(np.sum(forces(delay) ** 2))
    components, timing, least, friction = list[_Component](), 0.0, math.inf, force
    for k, share in zip(at, shares, strict=True):
        ways, more = _curves(grids, (int(pairs.first[k]), int(pairs.second[k])))
        whole = np.hstack([columns, more])
        prior = np.full(whole.shape[1] + 1, math.inf)
        prior[columns.shape[1] : -1] = size
        value, left = _ridge(whole, force, prior[:-1], b)
        slope = _slope(names, value, b, known)
        covariance, free = covariance_of(np.column_stack([whole, slope]), left, b.run, prior)
        place = {n: j for j, n in enumerate(names)} | {("boost", w): columns.shape[1] + j for j, w in enumerate(ways)}
        curves = tuple(grids[j].curves[i] if i >= 0 else None for j, i in enumerate((pairs.first[k], pairs.second[k])))
        components.append(_Component(float(share), place, (curves[0], curves[1]), value, covariance[:-1, :-1], free))
        timing += float(share * covariance[-1, -1])
        if float(left @ left) < least:
            least = float(left @ left)
            sliding = [j for n, j in place.items() if n[0] != "inertia"]
            friction = left + whole[:, sliding] @ value[sliding]
    spread = math.hypot(math.sqrt(timing), RULES.time_base * kept[0].trace.step)
    return _Fit(
        tuple(components),
        Estimate.single(delay, spread, sum(c.share * c.degrees_of_freedom for c in components)),
        (float(pairs.probability[pairs.first >= 0].sum()), float(pairs.probability[pairs.second >= 0].sum())),
        (_speed(pairs.first, grids[0], pairs), _speed(pairs.second, grids[1], pairs)),
        (_edges(b, grids[0], 0), _edges(b, grids[1], 1)),
        tuple(waves),
        _lost(b, kept, band, columns, names),
        math.sqrt(least / power),
        known,
        friction,
    )


def _columns(b: Balance, with_inertia: bool) -> tuple[list[Name], Real]:
    """Names and regressors of inertia, Coulomb and viscous friction, of the ways that the record has."""
    names: list[Name] = [("inertia", "both")] if with_inertia else []
    columns = [b.acceleration] if with_inertia else []
    for way, share, velocity, sign in zip(WAYS, b.share, b.velocity, (1.0, -1.0), strict=True):
        if (share > 0.5).any():
            names += [("coulomb", way), ("viscous", way)]
            columns += [sign * share, velocity]
    return names, np.column_stack(columns)


def _delay(columns: Real, target: Callable[[float], Real], reach: float) -> float:
    """Delay of the least squares [s]; none where the record does not end it."""
    q = np.linalg.qr(columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300))[0]

    def cost(tau: float) -> float:
        y = target(tau)
        return float(y @ y - np.square(q.T @ y).sum())

    found = optimize.minimize_scalar(cost, bounds=(-reach, reach), method="bounded", options={"xatol": 1e-4 * reach})
    return float(found.x) if abs(found.x) < 0.95 * reach else 0.0


def _slope(names: list[Name], value: Real, b: Balance, known: float | None) -> Real:
    """Return what a delay changes in the force, per second: that of the model, as the force itself has noise."""
    of = dict(zip(names, value[: len(names)], strict=True))
    slope = of.get(("inertia", "both"), 0.0 if known is None else known) * b.jerk
    for share, way in zip(b.share, WAYS, strict=True):
        slope = slope + of.get(("viscous", way), 0.0) * share * b.acceleration
    return np.asarray(-slope)


def _inertial(names: list[Name], columns: Real, force: Real, b: Balance) -> Real:
    """Return the part of a force that the inertia takes, by plain least squares."""
    if ("inertia", "both") not in names:
        return np.zeros(force.size)
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    value = np.linalg.lstsq(columns / scale, force, rcond=1e-9)[0] / scale
    return np.asarray(value[names.index(("inertia", "both"))] * b.acceleration)


def _allowed(columns: Real, force: Real, grids: tuple[Grid, Grid], size: float, extra: Real, b: Balance) -> Allowed:
    """Return the probability of all curves; the residual with the best ones so far says what its values are worth."""
    whole = np.hstack([columns, extra])
    left = _ridge(whole, force, np.full(whole.shape[1], math.inf), b)[1]
    independent = independent_values(left, b.run)
    # Slow motion may be less well described than the rest, in which case its values are worth less.
    worst = max(
        (underestimate(c, np.delete(whole, columns.shape[1] + k, axis=1), left, b.run) for k, c in enumerate(extra.T)),
        default=1.0,
    )
    return allowed(columns, force, grids, size, independent, worst)


def _best(pairs: Allowed) -> tuple[int, int]:
    at = int(np.argmax(pairs.probability))
    return int(pairs.first[at]), int(pairs.second[at])


def _curves(grids: tuple[Grid, Grid], which: tuple[int, int]) -> tuple[list[str], Real]:
    """Ways and columns of a pair of curves, -1 for none."""
    ways = [WAYS[k] for k in (0, 1) if which[k] >= 0]
    columns = [grids[k].columns[:, which[k]] for k in (0, 1) if which[k] >= 0]
    return ways, np.column_stack(columns) if columns else np.zeros((grids[0].columns.shape[0], 0))


def _ridge(columns: Real, force: Real, prior: Real, b: Balance) -> tuple[Real, Real]:
    """Least squares with a standard deviation about zero of each unknown: values and residual."""
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    x = columns / scale
    value = np.linalg.lstsq(x, force, rcond=1e-9)[0]
    if np.isfinite(prior).any():
        left = force - x @ value
        noise = float(np.mean(left**2)) * left.size / independent_values(left, b.run)
        root = np.diag(math.sqrt(noise) / (prior * scale))
        value = np.linalg.lstsq(np.vstack([x, root]), np.concatenate([force, np.zeros(prior.size)]), rcond=1e-9)[0]
    return value / scale, force - x @ value


def _edges(b: Balance, grid: Grid, way: int) -> tuple[float, float]:
    """Least and greatest Stribeck speed that a record shows: friction must have begun to fall, and have fallen."""
    size = np.abs(b.velocity[way][b.share[way] > 0.5])
    if not size.size:
        return math.nan, math.nan
    return max(RULES.resolved_speed * float(np.quantile(size, 0.05)), 1.05 * grid.edges[0]), grid.edges[1]


def _of_way(which: NDArray[np.int64], grid: Grid, pairs: Allowed) -> Real:
    """Return the probability of each curve of one way, whatever the other has."""
    return np.array([pairs.probability[which == k].sum() for k in range(len(grid.curves))])


def _speed(which: NDArray[np.int64], grid: Grid, pairs: Allowed) -> Estimate | None:
    """Median and interval of the Stribeck speed of one way, if there is a curve."""
    weight = _of_way(which, grid, pairs)
    return speed_interval(grid.curves, weight) if weight.sum() > 1e-6 else None


def _lost(b: Balance, kept: Sequence[Kept], band: float, columns: Real, names: list[Name]) -> float:
    """Share of the noise of the encoder in the acceleration that nothing else explains: so much falls off the mass."""
    if ("inertia", "both") not in names:
        return 0.0
    q = np.linalg.qr(np.delete(columns, names.index(("inertia", "both")), axis=1))[0]
    across = b.acceleration - q @ (q.T @ b.acceleration)
    noise = np.array([encoder_noise(k.trace, band, 2) for k in kept])[b.run]
    return float(np.mean(noise**2) / max(float(np.mean(across**2)), 1e-300))


def _parameters(f: _Fit, units: dict[str, str]) -> list[DriveParameter]:
    """Return the rows of the balance."""
    force, motion = units["force"], units["motion"]
    rows = [] if f.fixed is not None else [_inertia(f, units["inertia"])]
    ways = [way for way in WAYS if ("coulomb", way) in f.components[0].place]
    scale = math.sqrt(float(np.mean(f.friction**2)))
    for k, way in enumerate(WAYS):
        if way not in ways:
            continue
        note = "includes any constant force, which raises one way and lowers the other"
        slow = "the speeds of the record lie too close together: run at slower and faster ones"
        coulomb = DriveParameter.of("coulomb", way, f.sum_of({("coulomb", way): 1.0}), force, note)
        if coulomb.high - coulomb.low > 2.0 * scale:
            coulomb = replace(coulomb, value=math.nan, note=f"not determined; {slow}")
        rows.append(coulomb)
        rows.append(positive("viscous", way, f.sum_of({("viscous", way): 1.0}), f"{force} s/{motion}", slow))
        rows += _stribeck(f, k, way, units)
    if len(ways) == 2:
        a, b = (("coulomb", way) for way in WAYS)
        slow, note = "too little motion", "mean of both ways, free of a constant force"
        rows.append(positive("coulomb", "both", f.sum_of({a: 0.5, b: 0.5}), force, slow, note))
        note = "such as weight, if Coulomb friction is the same both ways"
        constant = DriveParameter.of("constant", "both", f.sum_of({a: 0.5, b: -0.5}), force, note)
        rows += [constant] if constant.high - constant.low < 2.0 * scale else []
    if not f.delay.low <= 0.0 <= f.delay.high:
        rows.append(DriveParameter.of("delay", "both", f.delay, "s", "from the logged force to the one that acts"))
    return rows


def _stribeck(f: _Fit, k: int, way: str, units: dict[str, str]) -> list[DriveParameter]:
    """Return the rows of static friction and of the Stribeck speed, without values where no curve is seen."""
    speed, seen = f.speeds[k], f.seen[k]
    nothing = Estimate(math.nan, math.nan, 0.0, math.inf)
    if speed is None or seen < RULES.curve_probability:
        why = "the record shows no Stribeck curve this way beyond its noise: move slower and from slow to fast"
        return [
            DriveParameter.of(name, way, nothing, unit, f"not determined; {why}")
            for name, unit in (("static", units["force"]), ("stribeck_speed", f"{units['motion']}/s"))
        ]
    reason, note = "the record has too little slow motion", "limit at rest, beyond the slowest motion of the record"
    static = f.sum_of({("coulomb", way): 1.0, ("boost", way): 1.0}, curve_of=way)
    static = static.widened(RULES.least_spread * abs(static.value), f.degrees_of_freedom())
    rows = [positive("static", way, static, units["force"], reason, note)]
    speed = speed.widened(RULES.least_spread * speed.value, f.degrees_of_freedom())
    slowest, fastest = f.edges[k]
    unit = f"{units['motion']}/s"
    if speed.low > slowest and speed.high < fastest / 1.05 and speed.high < RULES.widest_interval * speed.low:
        rows.append(DriveParameter.of("stribeck_speed", way, speed, unit, "where the rise towards rest is 1/e"))
    else:
        text = "not determined; friction rises towards rest, but the record does not bound the speed at which it falls"
        rows.append(DriveParameter.of("stribeck_speed", way, replace(speed, value=math.nan), unit, text))
        if not speed.low > slowest:
            rows[0] = replace(rows[0], value=math.nan, high=math.inf, note=f"not determined; {reason}")
    return rows


def _inertia(f: _Fit, unit: str) -> DriveParameter:
    """Return the row of the inertia, without a value where the record does not determine it or none can be so small."""
    found = f.sum_of({("inertia", "both"): 1.0})
    row = positive(
        "inertia",
        "both",
        found.widened(abs(found.value) * f.lost, f.degrees_of_freedom()),
        unit,
        "the record accelerates too little against friction and noise: record a faster step or stroke, or give the "
        "known moving_mass",
    )
    if row.high < 0.0:
        raise InputError(
            f"the drive would give out energy: the force accelerates an inertia of {found.value:.4g} {unit}; check the "
            "sign of drive force and encoder"
        )
    least, most = _POSSIBLE[unit]
    if f.lost > RULES.hidden:
        text = (
            "not determined; the steps of the encoder hide the acceleration: take a finer encoder, or record faster "
            "motion"
        )
        return replace(row, value=math.nan, low=0.0, high=math.inf, note=text)
    if math.isfinite(row.value) and not least < row.value < most:
        text = (
            f"{found.value:.3g} {unit} is no inertia of a drive; check the units and scales of force and encoder (a "
            "torque in per cent, an encoder in counts)"
        )
        return replace(row, value=math.nan, note=text)
    return row


def _friction(f: _Fit, b: Balance, traces: Sequence[Trace]) -> pd.DataFrame:
    """Return friction over velocity as the record has it, as its steady runs have it, and as it was identified."""
    thin = np.s_[:: max(1, f.friction.size // RULES.shown)]
    velocity = b.velocity.sum(axis=0)
    motion = pd.DataFrame({"velocity": velocity[thin], "force": f.friction[thin]})
    inertia = f.fixed if f.fixed is not None else f.sum_of({("inertia", "both"): 1.0}).value
    frames = [motion.assign(kind="motion"), _steady_points(traces, inertia).assign(kind="steady run")]
    for k, (way, sign) in enumerate(zip(WAYS, (1.0, -1.0), strict=True)):
        size = np.abs(b.velocity[k][b.share[k] > 0.5])
        if not size.size:
            continue
        rows = []
        for speed in np.linspace(float(size.min()), float(size.max()), 60):

            def at(c: _Component, k: int = k, way: str = way, speed: float = float(speed)) -> Weights:
                curve = c.curves[k]
                fades = 0.0 if curve is None else math.exp(-min((speed / curve.speed) ** curve.shape, 500.0))
                return {("coulomb", way): 1.0, ("viscous", way): speed, ("boost", way): fades}

            found = f.sum_of(at)
            low, high = sorted((sign * found.low, sign * found.high))
            rows.append((sign * speed, sign * found.value, low, high))
        frames.append(pd.DataFrame(rows, columns=["velocity", "force", "low", "high"]).assign(kind="curve"))
    whole = pd.concat([frame for frame in frames if len(frame)], ignore_index=True)
    return whole.reindex(columns=["kind", "velocity", "force", "low", "high"])


def _steady_points(traces: Sequence[Trace], inertia: float) -> pd.DataFrame:
    """Return a row for each stretch of constant velocity: velocity, mean force without inertia, its 95 % interval."""
    reach = float(stats.norm.ppf(0.5 + 0.5 * RULES.level))
    rows = []
    for t in traces:
        place = t.motion
        if t.is_velocity:
            place = np.concatenate([[0.0], np.cumsum(0.5 * (t.motion[1:] + t.motion[:-1])) * t.step])
        record = make_record(
            t.step * np.arange(t.force.size), {"encoder_position": {"x": place}, "drive_force": {"x": t.force}}
        )
        with suppress(InputError):
            for _, run in friction_runs(record, "x").to_dataframe().iterrows():
                force = run["force"] - inertia * run["acceleration"]
                rows.append(
                    (run["velocity"], force, force - reach * run["force_std"], force + reach * run["force_std"])
                )
    return pd.DataFrame(rows, columns=["velocity", "force", "low", "high"])


def _notes(f: _Fit, b: Balance, units: dict[str, str]) -> list[str]:
    """Say what was added to the balance and what it leaves."""
    out = []
    length = float(np.ptp(b.place))
    if f.waves:
        waves = ", ".join(f"{2.0 * math.pi / k:.3g} {units['motion']}" for k in f.waves)
        out.append(f"forces that repeat along the stroke were found and taken into account, period {waves}")
    if f.remaining > RULES.unexplained:
        out.append(
            f"inertia and friction explain the drive force but for {100.0 * f.remaining:.3g} % (root mean square, "
            f"over {length:.3g} {units['motion']}): something else acts, such as a flexible part or a cut"
        )
    return out
