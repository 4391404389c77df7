"""Bands on the limits of the converged methods, from the sensitivities of their own crossings.

Each crossing that may become the lowest has a first derivative of 1/a by the compliance at its lines
(`critical_crossings`). With the errors of the compliance (`error_model`) these give the covariance of all crossings at
a speed: of a measured compliance over entries and lines, of modes by their parameters, which all lines share. Drawn
together with the cutting coefficients, the lowest depth of each draw is a draw of the limit::

    1/a_c = (1/a_c0 + own error) exp(sum of shared errors),    a = min over c of a_c

Its quantiles are corrected for the median as those of `sampled_band`: the lowest of several crossings is too low on the
average.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from process.types import Complex, Real
from stability.bands.critical_crossings import CriticalCrossing, CrossingsAt
from stability.bands.depth_quantiles import (
    QUANTILES,
    SAFE_PROBABILITY,
    bias_warning,
    checked_levels,
    corrected_quantiles,
)
from stability.bands.error_model import ErrorModel, ModalError, Spread, measured_error
from stability.bands.rules import RULES
from stability.methods.multi_frequency import Loops
from stability.problem import Cut, complete_samples


def converged_band(
    limits: xr.Dataset,
    compliance: xr.Dataset | ModalModel,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spread: Spread | None = None,
    *,
    measured: xr.Dataset | None = None,
    quantiles: Sequence[float] = QUANTILES,
    safe_probability: float = SAFE_PROBABILITY,
    seed: int = 0,
) -> xr.Dataset:
    """Return limits of multi-frequency or semi-discretisation with their quantiles and a safe depth.

    Parameters
    ----------
    limits : xarray.Dataset
        Of `stability.multi_frequency` or `stability.semi_discretization`, sharp edges.
    compliance : xarray.Dataset or ModalModel
        What they were had from: a measured compliance with its errors, as of `sampled_band`, or modes.
    tool, arc, coefficients
        The cut; any pitch and helix.
    spread : Spread, optional
        Relative standard deviations of coefficients and modes. Default: none.
    measured : xarray.Dataset, optional
        The compliance that the modes were fitted to, whose errors at the lines of each crossing then count.
    quantiles : sequence of float, optional
        Quantiles of the limit depth, each between 0 and 1.
    safe_probability : float, optional
        Probability with which the true limit lies at or above ``safe_depth``.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    xarray.Dataset
        `limits` with ``limit_depth_quantile(quantile, spindle_speed)`` and ``safe_depth`` [mm], NaN where there is no
        limit or its crossing is not found again, which a warning says, and the attribute "safe_probability".

    Raises
    ------
    InputError
        As `stability.sampled_band`.
    """
    levels = checked_levels(quantiles, safe_probability)
    problem = _problem(compliance, Cut(tool, arc, coefficients), spread or Spread(), measured)
    depth = 1e-3 * limits["limit_depth"].values
    speed, line = limits["spindle_speed"].values, limits["chatter_frequency"].values
    counts = limits["harmonics"].values if "harmonics" in limits else np.zeros(speed.size, dtype=int)
    drawn = np.full((RULES.own_draws, speed.size), np.nan)
    for i in np.flatnonzero(np.isfinite(depth)):
        at = CrossingsAt(problem.loops, float(speed[i]), problem.doubled)
        lowest = at.limiting(float(depth[i]), float(line[i]), str(limits["kind"].values[i]), int(counts[i]))
        if lowest is None:
            continue
        deviation = float(problem.draws([lowest], np.random.default_rng(seed)).std()) * lowest.crossing.depth
        low, high = RULES.reach_above
        # A limit that next to nothing determines has a deviation of any size.
        reach = max(low, math.exp(min(math.log(high), RULES.deviations * deviation)))
        crossings = at.competing(lowest, reach * lowest.crossing.depth)
        # The same seed at each speed: neighbouring limits move together.
        inverse = problem.draws(crossings, np.random.default_rng(seed)).max(axis=1)
        drawn[:, i] = depth[i] * lowest.inverse / np.where(inverse > 0.0, inverse, 1e-300)
    known, notes = np.isfinite(drawn).all(axis=0), list(limits.attrs.get("warnings", ()))
    found = np.full((len(levels), speed.size), np.nan)
    common = 0.0 if problem.helical else problem.spread.common
    if known.any():
        found[:, known] = corrected_quantiles(drawn[:, known], depth[known], levels, common)
        notes += bias_warning(drawn[:, known], depth[known])
    safe = np.minimum(depth, found[-2:].min(axis=0))
    over, units = "spindle_speed", {"units": limits["limit_depth"].attrs.get("units", "mm")}
    out = limits.assign_coords(quantile=list(quantiles)).assign(
        limit_depth_quantile=(("quantile", over), 1e3 * found[:-2], units), safe_depth=(over, 1e3 * safe, units)
    )
    lost = int((np.isfinite(depth) & ~known).sum())
    if lost:
        notes.append(
            f"at {lost} of {speed.size} spindle speeds the crossing that limits the depth was not found again: these "
            "limits have no quantiles and no safe depth"
        )
    return out.assign_attrs(safe_probability=safe_probability, warnings=notes)


@dataclass(frozen=True)
class _Problem:
    loops: Loops
    doubled: tuple[Loops, ...]
    error: ErrorModel | None
    lines: Real | None
    spread: Spread

    @property
    def helical(self) -> bool:
        """Whether the depth moves the edges, and is not one over a factor of the coefficients."""
        return self.loops.cut.twist > 0.0

    def draws(self, crossings: Sequence[CriticalCrossing], generator: np.random.Generator) -> Real:
        """Return draws of 1/a [1/m] of crossings at one speed, shape (draws, crossings)."""
        value = np.array([c.inverse for c in crossings])
        shared = [self._shared(c) for c in crossings]
        steps = generator.standard_normal((RULES.own_draws, len(shared[0])))
        out = np.tile(value, (RULES.own_draws, 1))
        if self.lines is not None and self.error is not None:
            size, vectors = np.linalg.eigh(_covariance(self.error, self.lines, crossings))
            own = generator.standard_normal((RULES.own_draws, value.size))
            out = out + own @ (vectors * np.sqrt(np.maximum(size, 0.0))).T
        return np.asarray(out * np.exp(steps @ (np.array(shared) / value[:, None]).T))

    def _shared(self, crossing: CriticalCrossing) -> list[float]:
        """Return d(1/a) [1/m] by each error of unit variance that all lines share."""
        out: list[float] = []
        if self.error is not None and self.lines is None:
            out += crossing.change(self.error.shared(crossing.frequency)).tolist()
        if self.doubled:
            out += (np.array(self.spread.coefficients) * crossing.coefficients).tolist()
        return [*out, self.spread.common * crossing.common * crossing.inverse if self.helical else 0.0]


def _problem(compliance: xr.Dataset | ModalModel, cut: Cut, spread: Spread, measured: xr.Dataset | None) -> _Problem:
    record = compliance if isinstance(compliance, xr.Dataset) else measured
    error: ErrorModel | None = None
    lines = None
    if record is not None:
        if spread.modal.any():
            raise InputError(
                "a measured compliance carries the errors of its frequencies, damping and stiffness itself; give a "
                "Spread of the coefficients only, or the machine as modes"
            )
        lines = complete_samples(record).frequency
        error = measured_error(record, lines)
    elif not (spread.modal.any() or any(spread.coefficients) or spread.common):
        raise InputError(
            "neither modes nor coefficients are uncertain, so that there is no band; give a Spread, e.g. "
            "Spread(coefficients=(0.1, 0.1, 0.1), damping=0.2)"
        )
    elif spread.modal.any() and isinstance(compliance, ModalModel):
        error = ModalError(compliance, spread, np.empty(0))
    work = cut.coefficients
    twice = [replace(work, **{name: 2.0 * getattr(work, name)}) for name in ("Ktc", "Krc", "Kac")]
    separate = twice if any(spread.coefficients) else []
    doubled = tuple(Loops(compliance, replace(cut, coefficients=c)) for c in separate)
    return _Problem(Loops(compliance, cut), doubled, error, lines, spread)


def _covariance(error: ErrorModel, lines: Real, crossings: Sequence[CriticalCrossing]) -> Real:
    """Return the covariance of 1/a [1/m2] of crossings with the errors of the lines of a record."""
    owner, frequency, force = [], [], []
    for number, crossing in enumerate(crossings):
        gradient = crossing.gradient.copy()
        # What is taken of a record outside of it: below its first line the real part there, above the last one nothing.
        gradient[crossing.frequency < lines[0]] = gradient[crossing.frequency < lines[0]].real
        gradient[crossing.frequency > lines[-1]] = 0.0
        own = np.einsum("mre,mrek->mrk", gradient, error.line_factors(crossing.frequency))
        variance = (np.abs(own) ** 2).sum(axis=(1, 2))
        kept = variance > RULES.least_share * variance.max()
        owner.append(np.full(int(kept.sum()), number))
        frequency.append(crossing.frequency[kept])
        force.append(own[kept])
    of, f, own = np.concatenate(owner), np.concatenate(frequency), np.concatenate(force)
    alike = error.correlation(f)
    pairs: Complex = np.einsum("ark,btk,abrt->ab", own, own.conj(), alike, optimize=True)
    member = (of[:, None] == np.arange(len(crossings))).astype(float)
    return np.asarray(0.5 * (member.T @ pairs.real @ member))
