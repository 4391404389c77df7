"""Shaker, a force that neither dwells nor repeats itself: random noise, bursts, a continuous chirp -> compliance.

By default the lines of the whole records are taken as they are (`local_response`), which leaks at no damping and
at no rate of a chirp. ``estimator = "H1"``, ``"H2"`` or ``"Hv"`` average Hann blocks instead (`actuator.welch`).

How much noise the force carries decides by how much a least squares (H1) is too low, ``N/S_FF``, most where the
force drops at a resonance. N is read from the silence before or after the excitation. Where there is none, N is at most
what the response leaves unexplained anywhere, ``N <= min S_ee/|Phi|^2`` over all lines and responses, with the noise of
the force taken as white: half of that is then taken out, and all of it charged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.errors import InputError
from process.labels import AXES
from process.types import Real
from smfe.identification.actuator.columns import Column, joined
from smfe.identification.actuator.continuous_records import (
    Records,
    Response,
    band_of,
    column_of,
    frequency_axis,
    samples_of,
)
from smfe.identification.actuator.local_response import (
    Local,
    RecordLines,
    choose,
    half_widths,
    solve_either,
    solve_sums,
    sums_of,
    with_poles,
)
from smfe.identification.actuator.rules import RULES
from smfe.identification.actuator.welch import averaged_blocks
from smfe.identification.errors.result import Identification, in_words
from smfe.identification.spectra.spectra import check_records
from smfe.identification.sweep.local_polynomial import LocalPolynomial

ESTIMATORS: tuple[str, ...] = ("local_polynomial", "H1", "H2", "Hv")
"""How records of a continuous force become a compliance."""


def identify_continuous(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    frequency_range: tuple[float, float] | None = None,
    resolution: float | None = None,
    estimator: str | None = None,
) -> Identification:
    """Identify compliances from random noise, bursts or continuous chirps.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records; several of an axis are taken together.
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz]. Default: where the force has power.
    resolution : float, optional
        Step of the frequency axis [Hz]; of H1, H2 and Hv one over the length of a block. Default: chosen from the data.
    estimator : {"local_polynomial", "H1", "H2", "Hv"}, optional
        Default: the first.

    Returns
    -------
    Identification
        Compliance [m/N], NaN where the force has no power or is mostly noise, with ``compliance_std``,
        ``compliance_relation``, ``degrees_of_freedom`` and ``coherence``; table "steps", one row a record.

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, a record is too short, clipped in more than one sample
        of twenty, or the force has no power.
    """
    check_records(name, records)
    groups = [samples_of(axis, records[axis]) for axis in AXES if len(records.get(axis, ()))]
    band = band_of(name, groups, frequency_range)
    chosen = estimator or "local_polynomial"
    if chosen == "local_polynomial":
        frequency = frequency_axis(groups, band, resolution)
        columns = [_local(g, frequency) for g in groups]
    else:
        frequency, columns = averaged_blocks(groups, band, resolution, chosen)
        columns = [_against(c, _local(g, frequency), frequency) for c, g in zip(columns, groups, strict=True)]
    known = [np.isfinite(c.compliance).any(axis=1) for c in columns]
    if not np.any(known):
        raise InputError(
            f"measurement '{name}': no line between {band[0]:.4g} and {band[1]:.4g} Hz can be claimed: the force is "
            "mostly noise, or does not explain the motion; check the channels, and excite harder or for longer"
        )
    attrs = {
        "excitation_kind": "continuous",
        "estimator": chosen,
        "error_lines": float(np.mean([c.error_lines for c in columns])),
    }
    compliance = joined(frequency, columns, np.flatnonzero(np.any(known, axis=0)), attrs)
    notes = [note for c in columns for note in c.notes]
    return Identification(name, "actuator", compliance, {"steps": pd.concat([c.table for c in columns])}, tuple(notes))


# --- the lines of whole records -------------------------------------------------------------------------------------


def _local(g: Records, frequency: Real) -> Column:
    lines = [
        RecordLines(1.0 / (f.size * g.dt), g.dt * fft.rfft(f)[:, None], g.dt * fft.rfft(x, axis=1).T, at_rest(x))
        for f, x in zip(g.force, g.motion, strict=True)
    ]
    widths = half_widths(lines, float(frequency[-1] - frequency[0]))
    if 2.0 * widths[0] > 0.25 * frequency[-1]:
        raise InputError(
            f"the records of excitation {g.axis} last {sum(g.seconds):.3g} s together: too short for a response at "
            f"{frequency[-1]:.4g} Hz; record longer"
        )
    sums, rest = [sums_of(lines, frequency, w) for w in widths], all(r.rest for r in lines)
    # Noise of each record by itself, from the narrowest band with enough of its lines.
    own = min(1 + (len(lines) > 1), len(sums) - 1)
    alone = [solve_sums(sums[own][1].of(m), np.ones((1, frequency.size, len(g.response)))) for m in range(len(lines))]
    noise = np.stack([_smooth(a.noise) for a in alone])
    weight = 1.0 / np.maximum(noise, 1e-300) if len(lines) > 1 else np.ones_like(noise)
    density = np.array(g.force_noise([_bound(a, s) for a, s in zip(alone, g.seconds, strict=True)]))
    force_noise = np.broadcast_to((density * g.seconds)[:, None, None], (len(lines), frequency.size, 1))
    plain = choose([solve_either(s, weight, force_noise, rest) for s in sums])
    found, width, bent = with_poles(lines, frequency, weight, force_noise, plain, widths[0])
    value, loss = found.response[..., 0], found.loss[..., 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        lost = np.abs(loss) / np.abs(value)
        charged = RULES.known_to * loss / np.maximum(1.0 - lost, 0.1) if g.noise_known else loss / np.sqrt(12.0)
        value = value if g.noise_known else value - 0.5 * loss
    step = float(np.median(np.diff(frequency)))
    error_lines = [
        LocalPolynomial(resolution=step).error_lines(float(w)) for w in width.ravel()[:: max(1, width.size // 200)]
    ]
    narrow = np.asarray(np.isinf(found.covariance[..., 0, 0].real).any(axis=1))
    response = Response(
        value,
        found.covariance[..., 0, 0].real + np.abs(charged) ** 2,
        charged**2,
        found.degrees_of_freedom,
        found.share,
        lost,
        narrow,
        float(np.mean(error_lines)),
        tuple(_about(g, frequency, width, _clearly(bent, found), narrow, widths[0], step)),
    )
    return column_of(g, frequency, response)


def _against(blocks: Column, whole: Column, frequency: Real) -> Column:
    """Return averages of blocks whose error knows what the lines of the whole record say otherwise.

    A resonance far narrower than a block leaks from blocks of any length alike, and nothing in them shows it.
    """
    with np.errstate(invalid="ignore"):
        away = np.abs(blocks.compliance - whole.compliance) ** 2
        beyond = np.nan_to_num(np.maximum(away - 2.0 * (blocks.variance + whole.variance), 0.0))
        lost = np.asarray((beyond > (RULES.leaked * np.abs(whole.compliance)) ** 2).any(axis=1))
    notes = blocks.notes
    if lost.any():
        notes += (
            f"excitation {blocks.axis}: in {in_words(frequency, lost)} blocks are too short for a resonance that the "
            "whole record resolves; nothing is claimed there: take estimator out",
        )
    cut = np.where(lost, np.nan, 1.0)[:, None]
    return replace(blocks, compliance=blocks.compliance * cut, variance=blocks.variance + beyond, notes=notes)


def at_rest(motion: Real) -> bool:
    """Whether most motions (axes, n) are small over the first and the last thousandth of a record."""
    piece = max(8, motion.shape[1] // 1000)
    ends = np.sqrt([np.mean(part**2, axis=1) for part in (motion[:, :piece], motion[:, -piece:])]).max(axis=0)
    return bool(np.median(ends / np.maximum(np.std(motion, axis=1), 1e-300)) < RULES.decayed)


def _smooth(noise: Real, reach: int = 12) -> Real:
    """Median over neighbouring lines."""
    return np.asarray(ndimage.median_filter(noise, size=(2 * reach + 1, 1), mode="nearest"))


def _bound(alone: Local, seconds: float) -> float:
    """Return what the noise of the force can be at most, as a power density [N2/Hz]."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = alone.noise / np.abs(alone.response[..., 0]) ** 2
    ratio = _smooth(np.where(np.isfinite(ratio), ratio, np.inf), 4)
    return RULES.caution * float(np.min(ratio)) / seconds


def _clearly(bent: NDArray[np.bool_], found: Local) -> NDArray[np.bool_]:
    """Mark lines (f,) that bend by what is worth a word: a standard deviation above 2 %."""
    with np.errstate(invalid="ignore"):
        return np.asarray((bent & (found.std[..., 0] > 0.02 * np.abs(found.response[..., 0]))).any(axis=1))


def _about(
    g: Records,
    frequency: Real,
    width: Real,
    bent: NDArray[np.bool_],
    narrow: NDArray[np.bool_],
    finest: float,
    step: float,
) -> list[str]:
    many = f"{len(g.force)} records of together" if len(g.force) > 1 else "one record of"
    notes = [
        f"{many} {sum(g.seconds):.4g} s taken as a whole, without blocks: a polynomial over {2 * width.min():.2g} to "
        f"{2 * width.max():.2g} Hz around each line"
    ]
    if narrow.any():
        notes.append(
            f"the records are too short for resonances as narrow as those in {in_words(frequency, narrow)}; nothing is "
            f"claimed there: record for longer than {max(g.seconds):.3g} s without a break"
        )
    bent = bent & ~narrow
    if bent.any():
        notes.append(
            f"the records are short for the damping in {in_words(frequency, bent)}: even a band of {2.0 * finest:.2g} "
            "Hz bends, which is in the standard deviation; record longer"
        )
    if step > 3.0 * finest:
        notes.append(
            f"the records resolve more than the lines {step:.3g} Hz apart show; give resolution, or a frequency_range"
        )
    return notes
