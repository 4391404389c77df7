"""A pass of a sweep, and what is looked up of its record: the cut, the air around it, the motion at its ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.cut.engagement import Engagement
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.identification.spectra.spectra import BlockSpectra, block_spectra, motion_axes
from smfe.identification.spectra.spindle_angle import spindle_angle
from smfe.identification.sweep.rules import RULES


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
    speeds : (float, float), optional
        Stated spindle rotation where the cut begins and ends [rad/s], to compare the clock of the record with.
    """

    record: xr.Dataset = field(repr=False)
    label: str
    arc: Engagement | None = None
    speeds: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class PreparedPass(SweepPass):
    """A pass with what is looked up of its record: each quantity once, when it is first asked for.

    Parameters
    ----------
    compared : dict
        Source of a speed, teeth of the tool -> what `spindle_clock` found of that speed in this pass.
    """

    compared: dict[tuple[str, int | None], Any] = field(default_factory=dict, repr=False)

    @cached_property
    def interval(self) -> float:
        """Sampling interval [s]."""
        return sample_interval(self.record)

    @cached_property
    def seconds(self) -> float:
        """Length of the record [s]."""
        return self.record.sizes["time"] * self.interval

    @cached_property
    def force_axes(self) -> list[str]:
        """Axes along which the force was recorded."""
        return axis_present(self.record, "force")

    @cached_property
    def motion(self) -> tuple[str, list[str]]:
        """Motion channel ("displacement" or "acceleration") and its axes."""
        return motion_axes(self.record)

    @cached_property
    def cutting(self) -> NDArray[np.bool_]:
        """Samples in the cut."""
        return in_cut(self.record)

    @cached_property
    def cut_piece(self) -> slice | None:
        """Samples from the first to the last in the cut; None where there are fewer than 32."""
        inside = np.flatnonzero(self.cutting)
        return slice(int(inside[0]), int(inside[-1]) + 1) if inside.size >= 32 else None

    @cached_property
    def air(self) -> list[slice]:
        """Samples in the air before and after the cut."""
        return air_pieces(self.record)

    @cached_property
    def at_rest(self) -> bool:
        """Whether the record begins and ends in the air, with the motion decayed."""
        return at_rest(self.record)

    @cached_property
    def place(self) -> Real:
        """Place along the pass at each sample: -1 where the cut begins, 1 where it ends, at a constant feed."""
        inside = np.flatnonzero(self.cutting)
        first, last = int(inside[0]), int(inside[-1])
        sample = np.arange(self.record.sizes["time"])
        return np.asarray(np.clip(np.interp(sample, [first, max(last, first + 1)], [-1.0, 1.0]), -1, 1))

    def angle(self, teeth: int | None = None) -> Real:
        """Return the angle of the spindle [rad]; `teeth` is needed where it is found from the force alone."""
        return spindle_angle(self.record, teeth)[0]


def prepare(sweep: SweepPass) -> PreparedPass:
    """Return the pass ready for use; one that is already is returned as it is."""
    if isinstance(sweep, PreparedPass):
        return sweep
    return PreparedPass(**{f.name: getattr(sweep, f.name) for f in fields(SweepPass)})


def in_cut(record: xr.Dataset) -> NDArray[np.bool_]:
    """Mark the samples in the cut: force over 50 ms above a fifth of its upper quartile."""
    level = force_level(record)
    return np.asarray(level > 0.2 * np.quantile(level, 0.75))


def force_level(record: xr.Dataset) -> Real:
    """Return the magnitude of the force, mean over 50 ms [N]."""
    total = np.zeros(record.sizes["time"])
    for axis in axis_present(record, "force"):
        total += record["force"].sel(axis=axis).values ** 2
    width = max(1, round(0.05 / sample_interval(record)))
    return np.asarray(ndimage.uniform_filter1d(np.sqrt(total, out=total), width))


def air_pieces(record: xr.Dataset) -> list[slice]:
    """Return the samples before and after the cut, at least `shortest_air` long; none where the record has no air.

    Air is where the force stays below its quietest level and a fifth of the way to that of the cut; a record whose
    force hardly changes has none.
    """
    level = force_level(record)
    in_work, quiet = float(np.quantile(level, 0.75)), float(level.min())
    if not quiet < 0.5 * in_work:
        return []
    cutting = np.flatnonzero(level > quiet + 0.2 * (in_work - quiet))
    dt, n = sample_interval(record), level.size
    margin, shortest = round(RULES.air_margin / dt), max(8, round(RULES.shortest_air / dt))
    pieces = slice(0, max(int(cutting[0]) - margin, 0)), slice(min(int(cutting[-1]) + margin, n), n)
    return [p for p in pieces if p.stop - p.start >= shortest]


def whole_record(record: xr.Dataset, reach: tuple[float, float], response: Sequence[str]) -> BlockSpectra:
    """Transform the whole record, padded with rest to a length that transforms fast."""
    n = record.sizes["time"]
    length = int(fft.next_fast_len(n, real=True))
    return block_spectra(record, [0], n, None, reach, detrend=False, response=response, padded=length)


def end_pieces(record: xr.Dataset, channel: str, duration: float = 0.1) -> Real:
    """Return the rms of consecutive pieces of a channel, shape (axes, pieces)."""
    n = record.sizes["time"]
    piece = min(max(8, round(duration / sample_interval(record))), n)
    # One axis at a time: the squares of a long record need as much room as the record.
    rows = (record[channel].sel(axis=a).values[: n // piece * piece] for a in axis_present(record, channel))
    return np.array([np.sqrt(np.mean(row.reshape(-1, piece) ** 2, axis=1)) for row in rows])


def at_rest(record: xr.Dataset) -> bool:
    """Whether the record begins and ends in the air, with the motion decayed.

    The tool enters and leaves the work for all axes at once, so the axis whose force stands out most from its own
    quietest 0.1 s decides where the air is; an axis with little force and much noise does not. The motion of every
    axis has decayed where its first and last 0.1 s are below 0.05 of its largest, or no more than three times what is
    usual in the air at the quieter end. Nothing depends on the unit or gain of a channel.
    """
    force, motion = end_pieces(record, "force"), end_pieces(record, motion_axes(record)[0])
    in_work = np.quantile(force, 0.75, axis=1)
    clearest = force[int(np.argmax(in_work / np.maximum(force.min(axis=1), max(1e-9 * in_work.max(), 1e-300))))]
    air = clearest <= 0.3 * clearest.max()
    if not (air[0] and air[-1]) or air.all():
        return False
    cutting = np.flatnonzero(~air)
    before, after = motion[:, : cutting[0]], motion[:, cutting[-1] + 1 :]
    usual = np.minimum(np.median(before, axis=1), np.median(after, axis=1))
    quiet = np.maximum(0.05 * motion.max(axis=1), 3.0 * usual)
    return bool(np.all(np.maximum(motion[:, 0], motion[:, -1]) <= quiet))
