"""Friction of a drive from runs at constant velocity, Section 5.1 and Figure 13 of Franco et al. 2024.

Each run is cut into blocks. The mean force of a block b of run i, at the speed v_i in the way s (1 or -1), is

``F_ib = s [Fc + (Fs - Fc) exp(-(v_i/vs)^d) + b v_i] + ripple(x_ib) + u_i + e_ib``

with Fc, Fs, vs, b of each way by itself. e_ib is the noise of the run, its variance that of the blocks of the run about
their mean, enlarged by their correlation. u_i is what changes from run to run and is not in the law (temperature,
place); its variance is that with which the runs scatter about the curve as they should (Paule and Mandel 1982). Ripple
is a sum of waves along the stroke, found in what the runs change within themselves. Every Stribeck curve that the runs
allow counts with its probability (Bayesian model averaging, Hoeting et al. 1999), as in `drive.stribeck`.

A run in which the axis sticks and slips is none at constant velocity, and `friction_runs` leaves it out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import optimize, special, stats

from process.errors import InputError
from process.labels import make_record
from process.types import Real
from smfe.identification.drive.correlated_residual import independent_values
from smfe.identification.drive.friction import friction_runs
from smfe.identification.drive.motion import WAYS, Trace
from smfe.identification.drive.results import DriveParameter, Estimate, positive
from smfe.identification.drive.rules import RULES
from smfe.identification.drive.stribeck import Curve, speed_interval


class Runs(NamedTuple):
    """Blocks of all runs: mean force and place, number of the run, (n,); of each run its velocity and block length.

    `velocity` (m,) is signed, `step` (m,) the time of a block [s], `left_out` the number of records without any run,
    `alone` whether no record holds more than one run.
    """

    force: Real
    place: Real
    run: NDArray[np.int64]
    velocity: Real
    step: Real
    left_out: int
    alone: bool

    @property
    def speed(self) -> Real:
        """Speed of each run (m,)."""
        return np.abs(self.velocity)

    @property
    def way(self) -> NDArray[np.int64]:
        """0 for a run forward, 1 for one backward (m,)."""
        return (self.velocity < 0.0).astype(np.int64)


def steady_runs(traces: Sequence[Trace], mass: float | None = None) -> Runs | None:
    """Return the runs at constant velocity of records that hold little else; None where they are other records.

    At least four fifths of the time of the records that have runs, and four speeds a tenth apart in one direction.

    Parameters
    ----------
    traces : sequence of Trace
        Records of one drive.
    mass : float, optional
        Moved mass [kg] or inertia [kg m^2], for what remains of the acceleration in a run.
    """
    force, place, run = list[Real](), list[Real](), list[NDArray[np.int64]]()
    velocity, step = list[float](), list[float]()
    steady, whole, left_out, alone = 0.0, 0.0, 0, True
    for t in traces:
        at = t.motion
        if t.is_velocity:
            at = np.concatenate([[0.0], np.cumsum(0.5 * (t.motion[1:] + t.motion[:-1])) * t.step])
        record = make_record(
            t.step * np.arange(t.force.size), {"encoder_position": {"x": at}, "drive_force": {"x": t.force}}
        )
        found = None
        with suppress(InputError):
            found = friction_runs(record, "x")
        if found is None:
            left_out += 1
            continue
        whole += t.step * t.force.size
        alone = alone and found.sizes["run"] == 1
        for k in range(found.sizes["run"]):
            one = found.isel(run=k)
            first, count = round(float(one["start"]) / t.step), round(float(one["duration"]) / t.step)
            steady += count * t.step
            length = max(math.ceil(RULES.block / t.step), count // RULES.most_blocks, 1)
            blocks = min(count // length, RULES.most_blocks)
            if blocks < RULES.least_blocks:
                continue
            part = slice(first, first + blocks * length)
            inertial = 0.0 if mass is None else mass * float(one["acceleration"])
            force.append(t.force[part].reshape(blocks, length).mean(axis=1) - inertial)
            place.append(at[part].reshape(blocks, length).mean(axis=1))
            run.append(np.full(blocks, len(velocity)))
            velocity.append(float(one["velocity"]))
            step.append(length * t.step)
    if not velocity or steady < RULES.steady_share * whole:
        return None
    whole_force, whole_place, numbers = np.concatenate(force), np.concatenate(place), np.concatenate(run)
    runs = Runs(whole_force, whole_place, numbers, np.array(velocity), np.array(step), left_out, alone)
    if max(_different(runs.speed[runs.way == k]) for k in (0, 1)) < RULES.least_feeds:
        return None
    return runs


def _different(speeds: Real) -> int:
    """Return the number of speeds that lie a tenth apart."""
    count, last = 0, 0.0
    for v in np.sort(speeds):
        if v > 1.1 * last:
            count, last = count + 1, float(v)
    return count


# --- the linear model of the blocks ----------------------------------------------------------------------------------


def _waves(r: Runs, wave: float) -> Real:
    """Return the columns of one wave number [1/m or 1/rad], averaged over each block, shape (n, 2 or 4)."""
    half = 0.5 * wave * (r.speed * r.step)[r.run]
    passed = np.sinc(half / math.pi)
    pair = passed[:, None] * np.column_stack([np.cos(wave * r.place), np.sin(wave * r.place)])
    if not (r.way == 0).any() or not (r.way == 1).any():
        return np.asarray(pair)
    return np.hstack([pair, np.where(r.velocity > 0.0, 1.0, -1.0)[r.run][:, None] * pair])


def _of_runs(r: Runs, values: Real) -> Real:
    """Return the mean of each run, (m,) or (m, p), of values of the blocks (n,) or (n, p)."""
    starts = np.flatnonzero(np.diff(r.run, prepend=-1))
    count = np.bincount(r.run).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / count)


def _demeaned(r: Runs, values: Real) -> Real:
    """Take the mean of each run away from values of its blocks (n,) or (n, p)."""
    return np.asarray(values - _of_runs(r, values)[r.run])


def _spread(r: Runs, residual: Real) -> Real:
    """Variance (m,) that a block of each run contributes to a mean: of the blocks, enlarged by their correlation."""
    inside = _demeaned(r, residual)
    count = np.bincount(r.run)
    correlated = max(residual.size / independent_values(inside, r.run), 1.0)
    own = np.bincount(r.run, inside**2) / np.maximum(count - 1, 1)
    # A run of few blocks borrows from all: a variance of few degrees of freedom is a poor one.
    common = float(np.sum(inside**2)) / max(residual.size - count.size, 1)
    borrowed = RULES.borrowed
    shared = ((count - 1) * own + borrowed * common) / (count - 1 + borrowed)
    return np.asarray(np.maximum(correlated * shared, 1e-12 * float(np.mean(r.force**2))))


def _find_waves(r: Runs) -> list[float]:
    """Find wave numbers in what the runs change within themselves, largest first."""
    length = float(np.ptp(r.place))
    travel = r.speed * np.bincount(r.run) * r.step
    finest = float(np.quantile((r.speed * r.step), 0.5))
    highest = min(RULES.most_tried, int(length / max(finest, 1e-300)))
    if length <= 0.0 or highest < 2:
        return []
    tried = math.pi / length * np.arange(2.0, highest + 1.0)
    # A wave of which no run sees a half is a slope, and no ripple.
    tried = tried[tried * float(travel.max()) > math.pi]
    found: list[float] = []
    target = _demeaned(r, r.force)
    used = np.zeros((target.size, 0))
    weight = 1.0 / np.sqrt(_spread(r, r.force))[r.run]
    for _ in range(RULES.most_waves):
        q = np.linalg.qr(used * weight[:, None])[0] if used.shape[1] else used
        y = weight * target
        left = y - q @ (q.T @ y)
        power = float(left @ left)

        def remaining(wave: float, q: Real = q, left: Real = left, weight: Real = weight) -> float:
            c = weight[:, None] * _demeaned(r, _waves(r, float(wave)))
            return float(left @ left - np.square(np.linalg.qr(c - q @ (q.T @ c))[0].T @ left).sum())

        at = float(tried[np.argmin([remaining(w) for w in tried])])
        near = optimize.minimize_scalar(
            remaining, bounds=(max(at - tried[0] / 2, 0.0), at + tried[0] / 2), method="bounded"
        )
        independent = independent_values(left, r.run)
        gained = independent * math.log(power / max(float(near.fun), 1e-12 * power))
        added = _demeaned(r, _waves(r, float(near.x)))
        if stats.chi2.sf(gained, added.shape[1] + 1) > RULES.false_wave / tried.size:
            break
        found.append(float(near.x))
        used = np.hstack([used, added])
        fit = np.linalg.lstsq(used * weight[:, None], y, rcond=1e-9)[0]
        weight = 1.0 / np.sqrt(_spread(r, target - used @ fit))[r.run]
    return found


class _Whitened:
    """Blocks turned into values of independent errors of variance one, as few as say something of the fit.

    Errors have the covariance ``s_i^2 I + t^2 1 1'`` in each run, with s_i^2 the `spread` (m,) and t^2 `between`: the
    means of the runs and what the runs change within themselves are independent. Of the latter only the ripple (n, k)
    explains anything, so that its k directions are kept beside the m means.
    """

    def __init__(self, runs: Runs, spread: Real, between: float, ripple: Real) -> None:
        self.spread, self.between = spread, between
        self._runs, count = runs, np.bincount(runs.run)
        self._root = np.sqrt(count / (spread + count * between))
        self._inside = 1.0 / np.sqrt(spread)[runs.run]
        self._turn = np.linalg.qr(self._inside[:, None] * _demeaned(runs, ripple))[0]

    def blocks(self, values: Real) -> Real:
        """Turn values of the blocks (n,) or (n, p) into (m + k,) or (m + k, p)."""
        flat = values.reshape(values.shape[0], -1)
        within = self._turn.T @ (self._inside[:, None] * _demeaned(self._runs, flat))
        whole = np.vstack([self._root[:, None] * _of_runs(self._runs, flat), within])
        return whole.reshape(whole.shape[0], *values.shape[1:])

    def means(self, values: Real) -> Real:
        """Turn what is the same in all blocks of a run, (m, p), into (m + k, p)."""
        return np.vstack([self._root[:, None] * values, np.zeros((self._turn.shape[1], values.shape[1]))])


def _fade(r: Runs, way: int, curve: Curve) -> Real:
    """Return ``s exp(-(v/vs)^d)`` of the runs of one way, zero for the others (m,)."""
    size = np.minimum((r.speed / curve.speed) ** curve.shape, 500.0)
    return np.asarray(np.where(r.way == way, (1.0 - 2.0 * way) * np.exp(-size), 0.0))


def _lines(r: Runs) -> tuple[list[tuple[str, str]], Real]:
    """Names and columns (m, 2 or 4) of Coulomb and viscous friction of the ways that were run."""
    names, columns = [], []
    for k, way in enumerate(WAYS):
        here, sign = r.way == k, 1.0 - 2.0 * k
        if here.any():
            names += [("coulomb", way), ("viscous", way)]
            columns += [np.where(here, sign, 0.0), np.where(here, r.velocity, 0.0)]
    return names, np.column_stack(columns)


# --- which curves the runs allow -------------------------------------------------------------------------------------


class _Side(NamedTuple):
    """Curves of one way with their probabilities, which sum up to one with that of none."""

    curves: list[Curve]
    probability: Real
    none: float

    @property
    def best(self) -> Curve | None:
        """The most probable curve; None where none is more probable."""
        return self.curves[int(np.argmax(self.probability))] if self.curves and self.none < 0.5 else None


def _allowed(r: Runs, w: _Whitened, y: Real, others: Real, way: int, boost: float, free: float) -> _Side:
    """Return the curves of one way, given whitened columns of all else (n, p), on grids that grow finer."""
    speed = r.speed[r.way == way]
    if _different(speed) < RULES.least_feeds:
        return _Side([], np.zeros(0), 1.0)
    q = np.linalg.qr(others)[0]
    y = y - q @ (q.T @ y)
    ridge = 1.0 / boost**2
    ends = RULES.below_slowest * float(speed.min()), RULES.fastest * float(speed.max())
    low, high = ends
    curves: list[Curve] = []
    weight, none = np.zeros(0), 1.0
    for _ in range(RULES.stages + 1):
        speeds = np.geomspace(low, high, RULES.steady_speeds)
        curves = [Curve(float(v), d) for d in RULES.shapes for v in speeds]
        columns = w.means(np.column_stack([_fade(r, way, c) for c in curves]))
        columns = columns - q @ (q.T @ columns)
        a, g = np.sum(columns**2, axis=0), columns.T @ y
        full = a + ridge
        gain = g**2 / full
        most = float(gain.max())
        # Of a variance that the runs give themselves, `free` degrees of freedom: Student, not Gauss.
        log = -0.5 * (free + 1.0) * np.log1p((most - gain) / free)
        log += -0.5 * np.log(full / ridge) + special.log_ndtr(g / np.sqrt(full)) + math.log(2.0)
        log += math.log(RULES.curved / len(RULES.shapes)) + np.log(
            np.tile(np.gradient(np.log(speeds)), len(RULES.shapes)) / math.log(ends[1] / ends[0])
        )
        without = -0.5 * (free + 1.0) * math.log1p(most / free) + math.log(1.0 - RULES.curved)
        total = float(np.logaddexp(special.logsumexp(log), without))
        weight, none = np.exp(log - total), math.exp(without - total)
        if none > 0.5:
            break
        by_speed = weight.reshape(len(RULES.shapes), -1).sum(axis=0)
        there = np.flatnonzero(by_speed > RULES.negligible * by_speed.sum())
        low, high = speeds[max(there[0] - 1, 0)], speeds[min(there[-1] + 1, speeds.size - 1)]
    return _Side(curves, weight, none)


# --- the fit ---------------------------------------------------------------------------------------------------------


class _Component(NamedTuple):
    """One curve of one way, or none: its probability, and value and covariance of what `place` names."""

    share: float
    curve: Curve | None
    value: Real
    covariance: Real
    place: dict[tuple[str, str], int]


@dataclass(frozen=True)
class SteadyFit:
    """What runs at constant velocity say of friction.

    Attributes
    ----------
    rows : tuple of DriveParameter
        Friction of each way, in the order of `parameters.identify_drive`.
    waves : tuple of float
        Wave numbers [1/m or 1/rad] of the ripple that was found.
    friction : DataFrame
        As `results.DriveFit.friction`.
    notes : tuple of str
        What was noticed.
    remaining : float
        Root mean square of what the fit leaves of the mean forces, over that of the forces [1].
    """

    rows: tuple[DriveParameter, ...]
    waves: tuple[float, ...]
    friction: pd.DataFrame
    notes: tuple[str, ...]
    remaining: float


def fit_steady(r: Runs, units: dict[str, str]) -> SteadyFit:
    """Fit friction of each way to runs at constant velocity.

    Parameters
    ----------
    r : Runs
        From `steady_runs`.
    units : dict
        Names of the units of force and motion, as in `motion.KINDS`.

    Returns
    -------
    SteadyFit
        Parameters with their 95 % intervals, and friction over velocity.
    """
    waves = _find_waves(r)
    ripple = np.column_stack([_waves(r, k) for k in waves]) if waves else np.zeros((r.force.size, 0))
    names, lines = _lines(r)
    boost = math.sqrt(float(np.mean(r.force**2)))
    sides = [_Side([], np.zeros(0), 1.0)] * 2
    whiten = _Whitened(r, _spread(r, r.force - ripple @ _within(r, ripple)), 0.0, ripple)
    for _ in range(RULES.steady_turns):
        for k in (0, 1):
            rest = _columns(r, whiten, lines, ripple, [side if j != k else None for j, side in enumerate(sides)])
            sides[k] = _allowed(r, whiten, whiten.blocks(r.force), rest, k, boost, _free(r, sides))
        whiten = _between(r, whiten, lines, ripple, sides)
    free = _free(r, sides)
    parts = [_components(r, whiten, names, lines, ripple, sides, k, boost) for k in (0, 1)]
    rows = _rows(r, parts, sides, free, units)
    value = _least_squares(r, whiten, lines, ripple, sides)
    effect = ripple @ value[lines.shape[1] : lines.shape[1] + ripple.shape[1]]
    left = _of_runs(r, r.force) - _prediction(r, value, lines, ripple, sides)
    remaining = math.sqrt(float(np.mean(left**2) / np.mean(r.force**2)))
    table = _table(r, whiten, r.force - effect, parts, free)
    return SteadyFit(tuple(rows), tuple(waves), table, _notes(r, waves, units), remaining)


def _within(r: Runs, ripple: Real) -> Real:
    """Ripple that the runs show within themselves."""
    if not ripple.shape[1]:
        return np.zeros(0)
    return np.asarray(np.linalg.lstsq(_demeaned(r, ripple), _demeaned(r, r.force), rcond=1e-9)[0])


def _free(r: Runs, sides: Sequence[_Side]) -> float:
    """Degrees of freedom of the scatter from run to run."""
    used = sum(2 * int((r.way == k).any()) for k in (0, 1)) + sum(2 for side in sides if side.best is not None)
    return float(max(r.velocity.size - used, 1))


def _columns(r: Runs, w: _Whitened, lines: Real, ripple: Real, sides: Sequence[_Side | None]) -> Real:
    """Return the whitened columns of all that acts, with the best curves of the sides last."""
    more = [_fade(r, k, s.best)[:, None] for k, s in enumerate(sides) if s is not None and s.best is not None]
    return np.hstack([w.means(lines), w.blocks(ripple), *(w.means(column) for column in more)])


def _least_squares(r: Runs, w: _Whitened, lines: Real, ripple: Real, sides: Sequence[_Side]) -> Real:
    """Return the values of all columns with the best curves."""
    found = np.linalg.lstsq(_columns(r, w, lines, ripple, sides), w.blocks(r.force), rcond=1e-9)[0]
    return np.asarray(found)


def _prediction(r: Runs, value: Real, lines: Real, ripple: Real, sides: Sequence[_Side]) -> Real:
    """Return the mean force of each run (m,) that values of the columns give."""
    more = [_fade(r, k, side.best) for k, side in enumerate(sides) if side.best is not None]
    return np.asarray(np.column_stack([lines, _of_runs(r, ripple), *more]) @ value)


def _between(r: Runs, w: _Whitened, lines: Real, ripple: Real, sides: Sequence[_Side]) -> _Whitened:
    """Return the errors with which the means of the runs scatter as they should (Paule and Mandel 1982)."""
    count, free = np.bincount(r.run).astype(float), _free(r, sides)
    value = _least_squares(r, w, lines, ripple, sides)
    spread = _spread(r, r.force - ripple @ value[lines.shape[1] : lines.shape[1] + ripple.shape[1]])

    def excess(between: float) -> float:
        trial = _Whitened(r, spread, between, ripple)
        value = _least_squares(r, trial, lines, ripple, sides)
        left = _of_runs(r, r.force) - _prediction(r, value, lines, ripple, sides)
        return float(np.sum(left**2 / (spread / count + between))) - free

    top = float(np.mean(r.force**2))
    if excess(0.0) <= 0.0:
        return _Whitened(r, spread, 0.0, ripple)
    if excess(top) >= 0.0:
        return _Whitened(r, spread, top, ripple)
    return _Whitened(r, spread, float(optimize.brentq(excess, 0.0, top, xtol=1e-9 * top)), ripple)


def _components(
    r: Runs,
    w: _Whitened,
    names: list[tuple[str, str]],
    lines: Real,
    ripple: Real,
    sides: Sequence[_Side],
    way: int,
    boost: float,
) -> list[_Component]:
    """Return the fits with each curve of one way that has a probability, the other way with its best one."""
    side = sides[way]
    out = []
    choices: list[tuple[float, Curve | None]] = [(side.none, None)]
    choices += [(float(p), c) for p, c in zip(side.probability, side.curves, strict=True)]
    least = RULES.negligible * max(p for p, _ in choices)
    y = w.blocks(r.force)
    base = _columns(r, w, lines, ripple, [other if k != way else None for k, other in enumerate(sides)])
    for share, curve in choices:
        if share < least:
            continue
        columns = base if curve is None else np.hstack([base, w.means(_fade(r, way, curve)[:, None])])
        scale = np.sqrt(np.mean(columns**2, axis=0))
        scale = np.maximum(scale, 1e-300)
        x, right = columns / scale, y
        if curve is not None:
            row = np.zeros((1, x.shape[1]))
            row[0, -1] = 1.0 / (boost * scale[-1])
            x, right = np.vstack([x, row]), np.append(y, 0.0)
        _, singular, turned = np.linalg.svd(x, full_matrices=False)
        root = turned.T / np.maximum(singular, 1e-9 * singular[0]) / scale[:, None]
        value = np.linalg.lstsq(x, right, rcond=1e-9)[0] / scale
        place = {name: k for k, name in enumerate(names)}
        if curve is not None:
            place[("boost", WAYS[way])] = columns.shape[1] - 1
        out.append(_Component(share, curve, value, root @ root.T, place))
    return out


Weights = dict[tuple[str, str], float]


def _sum_of(
    parts: Sequence[_Component], free: float, weights: Weights | Callable[[_Component], Weights], curved: bool = False
) -> Estimate:
    """Return a weighted sum of parameters, an average over the curves; only of those with one if `curved`."""
    parts = [c for c in parts if c.curve is not None] if curved else list(parts)
    share = np.array([c.share for c in parts])
    mean, spread = np.empty(len(parts)), np.empty(len(parts))
    for k, c in enumerate(parts):
        wanted = weights(c) if callable(weights) else weights
        here = {c.place[name]: x for name, x in wanted.items() if name in c.place}
        at, x = list(here), np.array(list(here.values()))
        mean[k] = x @ c.value[at]
        spread[k] = math.sqrt(max(float(x @ c.covariance[np.ix_(at, at)] @ x), 1e-300))
    return Estimate.mixed(share / share.sum(), mean, spread, np.full(len(parts), free))


def _rows(
    r: Runs, parts: Sequence[list[_Component]], sides: Sequence[_Side], free: float, units: dict[str, str]
) -> list[DriveParameter]:
    """Return the rows of both ways."""
    rows, coulombs = [], []
    per = f"{units['force']} s/{units['motion']}"
    for k, way in enumerate(WAYS):
        if not (r.way == k).any():
            continue
        slow = "the speeds of the runs lie too close together: run at slower and faster ones"
        coulomb = _sum_of(parts[k], free, {("coulomb", way): 1.0})
        coulombs.append(coulomb)
        note = "includes any constant force, which raises one way and lowers the other"
        rows.append(positive("coulomb", way, coulomb, units["force"], slow, note))
        rows.append(positive("viscous", way, _sum_of(parts[k], free, {("viscous", way): 1.0}), per, slow))
        rows += _stribeck_rows(r, parts[k], sides[k], k, free, units)
    if len(coulombs) == 2:
        a, b = coulombs
        note = "mean of both ways, free of a constant force"
        rows.append(DriveParameter.of("coulomb", "both", _half(a, b, 1.0), units["force"], note))
        note = "such as weight, if Coulomb friction is the same both ways"
        rows.append(DriveParameter.of("constant", "both", _half(a, b, -1.0), units["force"], note))
    return rows


def _half(a: Estimate, b: Estimate, sign: float) -> Estimate:
    """Return half the sum or the difference of two independent estimates."""
    middle = 0.5 * (a.value + sign * b.value)
    low_b, high_b = (b.value - b.low, b.high - b.value) if sign > 0.0 else (b.high - b.value, b.value - b.low)
    down, up = 0.5 * math.hypot(a.value - a.low, low_b), 0.5 * math.hypot(a.high - a.value, high_b)
    return Estimate(middle, 0.5 * math.hypot(a.std, b.std), middle - down, middle + up)


def _stribeck_rows(
    r: Runs, parts: list[_Component], side: _Side, k: int, free: float, units: dict[str, str]
) -> list[DriveParameter]:
    """Return the rows of static friction and Stribeck speed, without values where no curve is seen."""
    way, per = WAYS[k], f"{units['motion']}/s"
    if not side.curves or 1.0 - side.none < RULES.curve_probability:
        nothing = Estimate(math.nan, math.nan, 0.0, math.inf)
        why = "not determined; the runs show no rise of friction towards rest this way: add slower and more runs"
        return [
            DriveParameter.of(name, way, nothing, unit, why)
            for name, unit in (("static", units["force"]), ("stribeck_speed", per))
        ]
    static = _sum_of(parts, free, {("coulomb", way): 1.0, ("boost", way): 1.0}, curved=True)
    static = static.widened(RULES.least_spread * abs(static.value), free)
    speed = speed_interval(side.curves, side.probability / side.probability.sum())
    speed = speed.widened(RULES.least_spread * speed.value, free)
    reason, note = "the slowest runs are too fast", "limit at rest, beyond the slowest run"
    rows = [positive("static", way, static, units["force"], reason, note)]
    speeds = r.speed[r.way == k]
    low, high = float(speeds.min()), RULES.fastest * float(speeds.max())
    if speed.low > low and speed.high < high / 1.05 and speed.high < RULES.widest_interval * speed.low:
        return [*rows, DriveParameter.of("stribeck_speed", way, speed, per, "where the rise towards rest is 1/e")]
    text = "not determined; friction rises towards rest, but the runs do not bound the speed at which it falls"
    if not speed.low > low:
        rows[0] = replace(rows[0], value=math.nan, high=math.inf, note=f"not determined; {reason}")
    return [*rows, DriveParameter.of("stribeck_speed", way, replace(speed, value=math.nan), per, text)]


def _table(r: Runs, w: _Whitened, clean: Real, parts: Sequence[list[_Component]], free: float) -> pd.DataFrame:
    """Return friction over velocity: blocks without ripple, means of the runs with their 95 % interval, the curves."""
    thin = np.s_[:: max(1, clean.size // RULES.shown)]
    frames = [pd.DataFrame({"velocity": r.velocity[r.run][thin], "force": clean[thin], "kind": "motion"})]
    count = np.bincount(r.run)
    mean = np.bincount(r.run, clean) / count
    reach = float(stats.norm.ppf(0.5 + 0.5 * RULES.level)) * np.sqrt(w.spread / count + w.between)
    frames.append(
        pd.DataFrame({"velocity": r.velocity, "force": mean, "low": mean - reach, "high": mean + reach})
        .sort_values("velocity")
        .assign(kind="steady run")
    )
    for k, (way, sign) in enumerate(zip(WAYS, (1.0, -1.0), strict=True)):
        speeds = r.speed[r.way == k]
        if not speeds.size:
            continue
        rows = []
        for speed in np.geomspace(float(speeds.min()), float(speeds.max()), 60):

            def at(c: _Component, way: str = way, speed: float = float(speed), sign: float = sign) -> Weights:
                fades = 0.0 if c.curve is None else math.exp(-min((speed / c.curve.speed) ** c.curve.shape, 500.0))
                return {("coulomb", way): 1.0, ("viscous", way): speed, ("boost", way): fades}

            found = _sum_of(parts[k], free, at)
            low, high = sorted((sign * found.low, sign * found.high))
            rows.append((sign * speed, sign * found.value, low, high))
        frames.append(pd.DataFrame(rows, columns=["velocity", "force", "low", "high"]).assign(kind="curve"))
    whole = pd.concat(frames, ignore_index=True)
    return whole.reindex(columns=["kind", "velocity", "force", "low", "high"])


def _notes(r: Runs, waves: Sequence[float], units: dict[str, str]) -> tuple[str, ...]:
    """Say what was added and what was left out."""
    out = []
    if waves:
        periods = ", ".join(f"{2.0 * math.pi / k:.3g} {units['motion']}" for k in waves)
        out.append(f"forces that repeat along the stroke were found and taken into account, period {periods}")
    if r.left_out:
        out.append(
            f"left out: {r.left_out} record{'s' * (r.left_out > 1)} without a run at constant velocity: the axis "
            "stands still, sticks and slips, or the record is too short"
        )
    return tuple(out)
