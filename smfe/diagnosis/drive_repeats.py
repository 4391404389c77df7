"""Moves that a record repeats: what of a remainder comes again, and whether anything changed between two halves.

A reference that repeats itself gives the noise floor without any model: what differs from one repeat to the next. What
a model leaves and what comes again each time is the model's; an axis that has not changed leaves it in the second half
as it did in the first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.diagnosis.drive import noise
from smfe.diagnosis.drive.balance import Channels, kind_of
from smfe.diagnosis.drive.filters import Motion, Real, motion
from smfe.diagnosis.drive.noise import noise_draws
from smfe.diagnosis.drive.record import DriveRecordFamily, ForceData
from smfe.diagnosis.inference.problem import Condition, Values

_FEWEST = 4
_SAME = 1e-3
"""Largest difference between repeats [rms over the stroke] that counts as a repeat."""


@dataclass(frozen=True)
class Repeatability:
    """What a model leaves, split into what comes again and what does not.

    Attributes
    ----------
    period : float
        Time after which the moves repeat [s].
    scatter : float
        rms of what differs between repeats, for one of them [N].
    remainder : float
        rms of what the model leaves every time [N]; zero where the scatter explains all of it.
    """

    period: float
    scatter: float
    remainder: float


def repeat_lag(position: Real) -> int | None:
    """Return after how many samples a record of positions repeats itself; None where it does not, at least once."""
    n = position.size
    x = position - position.mean()
    size = 2 ** math.ceil(math.log2(2 * n))
    spectrum = np.fft.rfft(x, size)
    together = np.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    squares = np.concatenate(([0.0], np.cumsum(x**2)))
    lags = np.arange(n // 2 + 1)
    apart = squares[n] - squares[lags] + squares[n - lags] - 2.0 * together[lags]
    rms = np.sqrt(np.maximum(apart, 0.0) / (n - lags)) / max(float(np.ptp(x)), 1e-300)
    left = np.flatnonzero(rms > 10.0 * _SAME)
    if left.size == 0:
        return None
    inner = np.flatnonzero(rms[left[0] :] < _SAME) + left[0]
    if inner.size == 0:
        return None
    run = inner[: np.flatnonzero(np.diff(inner, append=n) > 1)[0] + 1]
    return int(run[np.argmin(rms[run])])


@dataclass(frozen=True)
class _Shifted:
    """Residuals of a model anywhere in a record."""

    family: DriveRecordFamily
    raw: Channels
    moving: Motion
    values: Values

    def residual(self, condition: Condition, lag: int) -> Real | None:
        """Return force - model of a move [N], `lag` samples earlier; None where the record has nothing there."""
        data = condition.data
        if not isinstance(data, ForceData):
            return None
        first = round((data.motion.time[0] - self.moving.time[0]) / self.raw.step) - lag
        lost = self.family.model.resampler.margin
        if first < lost or first + data.drive.size > self.raw.force.size - lost:
            return None
        part = slice(first, first + data.drive.size)
        there = replace(data, motion=self.moving[part], drive=self.raw.force[part])
        return self.family.model.resampler(there.drive) - self.family.force(there, self.values)


def _shifted(record: xr.Dataset, axis: str, family: DriveRecordFamily, values: Values) -> tuple[_Shifted, int]:
    raw = Channels.read(record, axis)
    lag = repeat_lag(raw.position)
    if lag is None:
        raise InputError("the record does not repeat its moves; record the same moves at least twice")
    moving = motion(raw.position, raw.step, 2.0 * family.model.resampler.cutoff)
    return _Shifted(family, raw, moving, values), lag


def repeatability(record: xr.Dataset, axis: str, family: DriveRecordFamily, values: Values) -> Repeatability:
    """Split what a model leaves of a record that repeats its moves.

    Parameters
    ----------
    record : xarray.Dataset
        The record that `family` was made of.
    axis : str
        Its axis.
    family : DriveRecordFamily
        Of the record.
    values : mapping
        Of all parameters.
    """
    at, lag = _shifted(record, axis, family, values)
    own, apart = [], []
    for c in family.conditions:
        now, before = at.residual(c, 0), at.residual(c, lag)
        if now is not None and before is not None:
            own.append(now)
            apart.append(now - before)
    if not own:
        raise InputError("no move of the record is repeated as a whole; record the same moves at least twice")
    scatter = 0.5 * float(np.mean(np.square(np.concatenate(apart))))
    whole = float(np.mean(np.square(np.concatenate(own))))
    return Repeatability(lag * at.raw.step, math.sqrt(scatter), math.sqrt(max(whole - scatter, 0.0)))


def since_first_half(record: xr.Dataset, axis: str, family: DriveRecordFamily, values: Values) -> DriveRecordFamily:
    """Return the family that asks whether anything has changed between the halves of a record that repeats its moves.

    The baseline is the model as it was fitted to the first half, with what it left there, move by move. The noise is
    that between repeats within the first half: two of them differ by the scatter of both.

    Parameters
    ----------
    record : xarray.Dataset
        The record that `family` was made of.
    axis : str
        Its axis.
    family : DriveRecordFamily
        With the causes of the model in its baseline (`settled`), all moves in it.
    values : mapping
        Of the fit to the first half.
    """
    at, lag = _shifted(record, axis, family, values)
    early = [c for c in family.conditions if c.source == "first half"]
    late = [c for c in family.conditions if c.source == "second half"]
    pairs = [(c, at.residual(c, 0), at.residual(c, lag)) for c in early]
    differences = [(c, a - b) for c, a, b in pairs if a is not None and b is not None]
    if len(differences) < _FEWEST:
        raise InputError("the first half of the record does not repeat its moves; record them at least four times")
    whitener = noise.fit_whitener([d for _, d in differences])
    kinds, none = [kind_of(c.settings) for c, _ in differences], np.zeros((sum(d.size for _, d in differences), 0))
    draws = noise_draws(whitener, [d for _, d in differences], none, kinds)
    loud: dict[object, list[float]] = {}
    for c, d in differences:
        loud.setdefault(kind_of(c.settings), []).extend(np.square(whitener(d)))
    every = float(np.mean(np.concatenate(list(loud.values()))))
    back = lag * math.ceil(0.5 * at.raw.force.size / lag - 0.5)
    found = []
    for c in late:
        before = at.residual(c, back)
        if before is not None and isinstance(c.data, ForceData):
            size = math.sqrt(float(np.mean(loud.get(kind_of(c.settings), every))))
            data = replace(c.data, noise=size)
            found.append(replace(c, observed=whitener(c.data.force - before) / size, data=data, source=""))
    return replace(family, model=replace(family.model, whitener=whitener, draws=draws), conditions=tuple(found))
