"""Zero-order (mean directional matrix) limits on a measured 3x3 compliance, without a modal fit.

``F = a_p A0 (1 - exp(-j w T)) Phi F`` with the tooth period T has a solution at the stability limit when, for
an eigenvalue ``mu`` of ``A0 Phi(f)`` and ``sigma = 1/mu``::

    a_lim = |sigma|^2 / (2 Re sigma) = 1 / (2 Re mu)        needs Re sigma > 0
    theta = pi - 2 arg(sigma) = pi + 2 arg(mu),   0 < theta < 2 pi
    T     = (theta + 2 pi k) / w,   n = 60 / (N T)          lobe k = 0, 1, 2, ...

All three eigenvalues and all cross terms count. Depth is the axial depth a_p, not the edge length b. Source:
Altintas and Budak 1995; Altintas 2001 (three dimensions); :eq:`regeneration`, :eq:`limit-depth`.

With unequal pitch the factor ``1 - exp(-j w T)`` becomes its mean S(w) over the delays T_j of the teeth, ``1 = a_p S(w)
mu(w)``, and the speed is no longer explicit: at each speed the frequency is scanned for real positive ``S mu`` (Budak
2003). The averaged equation is unreliable beyond the first crossing: islands there may not exist.

Process damping by the worn flank adds ``j w A_d/v_c`` to ``A0 (1 - exp(-j w T))``: each speed is scanned by itself
(`stability.methods.zero_order_scan`).

The mean directional matrix misses period doubling and parametric resonance: with few teeth in the cut, or
with half the tooth passing frequency near a mode, the true limit can lie below (by up to 32 % in the reference cases).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.cut.engagement import AnyEngagement
from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, label
from process.types import Complex, Real
from stability.methods.rules import RULES
from stability.methods.vibration_mode import NO_MODE, dominant_modes, modal_samples, vibration
from stability.methods.zero_order_branches import Branches, eigenvalue_branches
from stability.methods.zero_order_scan import Loop, loop_of, sampled_crossings
from stability.problem import (
    NO_LOBE,
    Cut,
    Machine,
    Modes,
    Samples,
    check_spindle_speed,
    complete_samples,
    edge_warnings,
    modes_of,
    pattern_of_pitch,
)

Crossings: TypeAlias = tuple[Real, Real, NDArray[np.int64]]
"""Depth [m], chatter frequency [Hz] and lobe at each speed."""


CURVE_COLUMNS: tuple[str, ...] = (
    "branch",
    "lobe",
    "piece",
    "spindle_speed_rpm",
    "limit_depth_mm",
    "chatter_frequency_Hz",
)
"""Columns of `lobe_curves`."""


@dataclass(frozen=True)
class CriticalDepth:
    """The limit that holds at every spindle speed.

    Parameters
    ----------
    limit_depth_mm : float
        Smallest limit depth over all speeds [mm]; inf when the compliance gives none.
    chatter_frequency_Hz : float
        Frequency at which it occurs [Hz].
    warnings : tuple of str
        What the user must know about the data.
    """

    limit_depth_mm: float
    chatter_frequency_Hz: float
    warnings: tuple[str, ...] = ()


def zero_order(
    compliance: xr.Dataset | Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    process_damping: ProcessDamping = NO_DAMPING,
) -> xr.Dataset:
    """Return the zero-order limit depth at given spindle speeds.

    For each speed the smallest limit over branches, lobes and all crossings of the phase condition. Between
    frequency samples the eigenvalue is interpolated along its branch and the phase condition is solved
    exactly there, so that a coarse grid (0.25 Hz) loses no lobe.

    Parameters
    ----------
    compliance : xarray.Dataset or Machine
        One labelled compliance [m/N] on its own grid; masked (NaN) frequencies are skipped, not bridged. Or anything
        with a ``state_space()``, e.g. a `process.ModalModel`: then the grid is ours.
    tool, arc, coefficients
        The cut; one arc of engagement or several, any pitch. A helix has no influence on the mean, at any depth
        (`Cut.mean_warnings`); a warning says so.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.

    Returns
    -------
    xarray.Dataset
        ``limit_depth`` [mm], ``chatter_frequency`` [Hz] and ``lobe`` (whole waves between two teeth, -1 for none) over
        ``spindle_speed``, and the mode of vibration: ``vibration(spindle_speed, axis)``, the complex displacement of
        the tool, of length one, its largest component real; for a machine also ``mode``, the number of the mode that
        moves the tool most, from 1 in the order of frequency (0 for none). The limit is inf, the frequency NaN, where
        nothing crosses within the data: unconditionally stable *as far as the data reach*
        (``attrs["frequency_low_Hz"]`` to ``attrs["frequency_high_Hz"]``). ``attrs["warnings"]`` lists what the user
        must know.

    Raises
    ------
    InputError
        For an unusable compliance or machine, or speeds that are not positive.
    """
    speed = check_spindle_speed(spindle_speed)
    cut = Cut(tool, arc, coefficients)
    modes = None if isinstance(compliance, xr.Dataset) else modes_of(compliance)
    samples = (
        complete_samples(compliance) if isinstance(compliance, xr.Dataset) else modal_samples(modes_of(compliance))
    )
    damped: list[Loop] = []
    if process_damping.coefficient > 0.0:
        damped = [loop_of(tool, arc, coefficients, float(n), process_damping) for n in speed]
    pitch = pattern_of_pitch(tool).delay
    return _limits(samples, cut.directional_matrix(), pitch, speed, modes, cut.mean_warnings, damped)


def zero_order_from_matrix(
    compliance: xr.Dataset, directional: Complex, teeth: int, spindle_speed: ArrayLike
) -> xr.Dataset:
    """Return the zero-order limit for any mean directional matrix, e.g. turning (one "tooth").

    Parameters
    ----------
    compliance : xarray.Dataset
        One labelled compliance [m/N].
    directional : ndarray of complex, shape (3, 3)
        A0 [N/m2], force over displacement per depth (or width) of cut: ``F = a A0 (r(t) - r(t - T))``.
    teeth : int
        Regenerations a turn.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm].

    Returns
    -------
    xarray.Dataset
        As `zero_order`.

    Raises
    ------
    InputError
        As `zero_order`, or when `teeth` is not positive.
    """
    speed = check_spindle_speed(spindle_speed)
    _check_teeth(teeth)
    return _limits(complete_samples(compliance), directional, np.full(teeth, 2.0 * np.pi / teeth), speed)


def _limits(
    samples: Samples,
    directional: Complex,
    pitch: Real,
    speed: Real,
    modes: Modes | None = None,
    notes: Sequence[str] = (),
    damped: Sequence[Loop] = (),
) -> xr.Dataset:
    """Return the labelled limits for pitch angles [rad], shape (teeth,); `damped` holds a loop for each speed."""
    branches = eigenvalue_branches(samples, directional)
    if damped:
        first = np.array([_shallowest(*sampled_crossings(branches, loop)) for loop in damped])
        depth, chatter, lobe = first[:, 0], first[:, 1], _waves(first[:, 1], pitch, speed)
    else:
        depth, chatter, lobe = first_limits(branches, pitch, speed)
    warnings = [*notes, *samples.warnings, *_unlimited_warning(branches, depth)]
    if np.ptp(pitch) >= RULES.equal_pitch:
        warnings.append(
            "with unequal pitch the zero-order equation can have losses of stability that are none, at low speeds "
            "above all; compare with the semi-discretisation"
        )
    if modes is None:
        warnings += [*edge_warnings(samples), *_cut_off_warning(branches, pitch.size, speed, depth)]
    flank = np.array([loop.flank for loop in damped]) if damped else None
    force, moved = vibration(branches, directional, chatter, depth, pitch, speed, flank)
    mode = None if modes is None else dominant_modes(modes, force, chatter)
    return labelled(speed, (depth, chatter, lobe, moved, mode), branches, warnings)


def first_limits(branches: Branches, pitch: Real, speed: Real) -> Crossings:
    """Return depth [m], chatter frequency [Hz] and lobe of the first limit at speeds [rpm], for pitch angles [rad]."""
    return (_equal if np.ptp(pitch) < RULES.equal_pitch else _unequal)(branches, pitch, speed)


def _equal(branches: Branches, pitch: Real, speed: Real) -> Crossings:
    """Take each lobe explicitly; shape (speeds,) each."""
    period = 60.0 / (pitch.size * speed)
    rising = np.argsort(period, kind="stable")
    depth, chatter, lobe = np.empty_like(speed), np.empty_like(speed), np.empty(speed.size, dtype=np.int64)
    depth[rising], chatter[rising], lobe[rising] = branches.envelope(period[rising])
    return depth, chatter, lobe


def _unequal(branches: Branches, pitch: Real, speed: Real) -> Crossings:
    """Scan the frequency at each speed; shape (speeds,) each."""
    found = np.array([branches.first_crossing(pitch / (2.0 * np.pi) * t) for t in 60.0 / speed])
    return found[:, 0], found[:, 1], _waves(found[:, 1], pitch, speed)


def _waves(chatter: NDArray[np.float64], pitch: NDArray[np.float64], speed: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the whole waves between two teeth, on average; `NO_LOBE` without a limit."""
    waves = np.floor(chatter * 60.0 / speed / pitch.size)
    return np.where(np.isfinite(waves), waves, NO_LOBE).astype(np.int64)


def _shallowest(depth: NDArray[np.float64], frequency: NDArray[np.float64]) -> tuple[float, float]:
    """Return the first of the crossings, (inf, NaN) without one."""
    return (float(depth[0]), float(frequency[0])) if depth.size else (float("inf"), float("nan"))


def lobe_curves(
    compliance: xr.Dataset,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: Sequence[float],
    pieces: int = 4,
) -> pd.DataFrame:
    """Return the individual lobes for plotting: all of them, not only their envelope.

    Parameters
    ----------
    compliance, tool, arc, coefficients
        As `zero_order`.
    spindle_speed : (float, float)
        Lowest and highest speed to draw [rpm].
    pieces : int, optional
        Points a step of the frequency grid.

    Returns
    -------
    pandas.DataFrame
        Columns `CURVE_COLUMNS`: within one (branch, lobe, piece) the rows follow the curve; a new piece
        begins where the data have a gap or the branch limits no depth. Draw one line a group; at the edges of the
        range lines end one point beyond.

    Raises
    ------
    InputError
        As `zero_order`, or for an empty range of speeds.
    """
    low, high = _speed_range(spindle_speed)
    cut = Cut(tool, arc, coefficients)
    cut.require_equal_pitch("single lobes")
    frequency, mu = _branches(compliance, cut.directional_matrix()).refined(pieces)
    frames = [_branch_curves(number, frequency, branch, tool.teeth, (low, high)) for number, branch in enumerate(mu)]
    return pd.concat(frames, ignore_index=True)


def critical_depth(
    compliance: xr.Dataset, tool: Tool, arc: AnyEngagement, coefficients: CuttingCoefficients
) -> CriticalDepth:
    """Return the smallest limit over all spindle speeds, ``min over f of 1/(2 Re mu)``.

    Parameters
    ----------
    compliance, tool, arc, coefficients
        As `zero_order`.

    Raises
    ------
    InputError
        As `zero_order`.
    """
    cut = Cut(tool, arc, coefficients)
    cut.require_equal_pitch("the smallest limit of all speeds")
    found = critical_depth_from_matrix(compliance, cut.directional_matrix())
    return replace(found, warnings=(*cut.mean_warnings, *found.warnings))


def critical_depth_from_matrix(compliance: xr.Dataset, directional: Complex) -> CriticalDepth:
    """Return the smallest limit over all speeds for any mean directional matrix [N/m2], shape (3, 3)."""
    branches = _branches(compliance, directional)
    frequency, mu = branches.refined(64)
    real = np.where(np.isfinite(mu), mu.real, -np.inf).max(axis=0)
    top = int(np.argmax(real))
    if not real[top] > 0.0:
        return CriticalDepth(float("inf"), float("nan"), branches.samples.warnings)
    return CriticalDepth(500.0 / float(real[top]), float(frequency[top]), branches.samples.warnings)


def _branches(compliance: xr.Dataset, directional: Complex) -> Branches:
    return eigenvalue_branches(complete_samples(compliance), directional)


def _check_teeth(teeth: int) -> None:
    if teeth < 1:
        raise InputError(f"the tool has {teeth} teeth; at least one is needed")


def _speed_range(spindle_speed: Sequence[float]) -> tuple[float, float]:
    speed = check_spindle_speed(spindle_speed)
    if speed.size < 2 or not speed.min() < speed.max():
        raise InputError(
            f"a speed range of {speed.min():g} to {speed.max():g} rpm is empty; give a lowest and a highest"
        )
    return float(speed.min()), float(speed.max())


def _branch_curves(
    number: int,
    frequency: Real,
    mu: Complex,
    teeth: int,
    speeds: tuple[float, float],
) -> pd.DataFrame:
    """Return all lobes of one branch within a range of speeds [rpm]."""
    limiting = np.isfinite(mu) & (mu.real > 0.0)
    turns = 0.5 + np.angle(np.where(limiting, mu, 1.0)) / np.pi
    tooth = teeth * np.array(speeds) / 60.0
    first = max(0, int(np.floor((frequency / tooth[1] - turns).min())))
    last = int(np.ceil((frequency / tooth[0] - turns).max()))
    # A new run begins after every sample that limits nothing or is missing.
    run = np.cumsum(~limiting)
    parts = []
    for lobe in range(first, last + 1):
        speed = 60.0 * frequency / (teeth * (turns + lobe))
        shown = limiting & (speed >= speeds[0]) & (speed <= speeds[1])
        # One point beyond the range at either end: lines reach the edge of the figure.
        shown = limiting & (shown | np.append(shown[1:], False) | np.append(False, shown[:-1]))
        at = np.flatnonzero(shown)
        broken = (np.diff(at) > 1) | (np.diff(run[at]) > 0)
        piece = np.concatenate([[0], np.cumsum(broken)])[: at.size]
        depth = 500.0 / mu.real[at]
        columns = (np.full(at.size, number), np.full(at.size, lobe), piece, speed[at], depth, frequency[at])
        parts.append(pd.DataFrame(dict(zip(CURVE_COLUMNS, columns, strict=True))))
    return pd.concat(parts, ignore_index=True)


def _unlimited_warning(branches: Branches, depth: Real) -> list[str]:
    """Say that infinity means "as far as the data reach"."""
    count = int(np.isinf(depth).sum())
    if count == 0:
        return []
    f = branches.samples.frequency
    return [
        f"{count} of {depth.size} spindle speeds have no limit: stable at any depth as far as the data reach "
        f"({f[0]:.6g} to {f[-1]:.6g} Hz)"
    ]


def _cut_off_warning(branches: Branches, teeth: int, speed: Real, depth: Real) -> list[str]:
    """Say when a lobe within the speed range ends at an edge of the data while it is the lowest one."""
    s = branches.samples
    below = np.concatenate([[True], ~s.bridged])
    above = np.concatenate([~s.bridged, [True]])
    cut_off = []
    for i in np.flatnonzero(below | above):
        f = float(s.frequency[i])
        ends = _lowest_ends(branches.eigenvalue[:, i], f, teeth, speed, depth)
        if ends.size:
            # On a lobe the frequency rises with the speed.
            side = "above" if above[i] else "below"
            rpm = ", ".join(f"{n:.4g}" for n in ends[:3]) + (", ..." if ends.size > 3 else "")
            cut_off.append(f"lobes {side} {rpm} rpm need data {side} {f:.6g} Hz")
    if not cut_off:
        return []
    return [
        "the frequency range of the compliance cuts off lobes within the speed range, where they still limit the "
        f"depth: {'; '.join(cut_off[:5])}{' and more' if len(cut_off) > 5 else ''}. Measure beyond, or do not use the "
        "limits near these lobes"
    ]


def _lowest_ends(
    mu: Complex,
    frequency: float,
    teeth: int,
    speed: Real,
    depth: Real,
) -> Real:
    """Return speeds at which a lobe ends at `frequency` and is, within 2 %, the envelope at the nearest speed asked."""
    out = []
    for value in mu[mu.real > 0.0]:
        turns = 0.5 + np.angle(value) / np.pi
        lobes = np.arange(int(frequency * 60.0 / (teeth * speed.min()) - turns) + 1)
        ends = 60.0 * frequency / (teeth * (turns + lobes))
        ends = ends[(ends >= speed.min()) & (ends <= speed.max())]
        nearest = np.abs(speed[None, :] - ends[:, None]).argmin(axis=1)
        out.append(ends[0.5 / value.real <= 1.02 * depth[nearest]])
    return np.sort(np.concatenate(out))[::-1] if out else np.empty(0)


def labelled(speed: Real, found: tuple[Any, ...], branches: Branches, warnings: list[str]) -> xr.Dataset:
    """Put names and units on a result; depth comes in metres."""
    depth, chatter, lobe, moved, mode = found
    f = branches.samples.frequency
    data: dict[str, Any] = {
        "limit_depth": ("spindle_speed", depth * 1e3),
        "chatter_frequency": ("spindle_speed", chatter),
        "lobe": ("spindle_speed", lobe),
        "vibration": (("spindle_speed", "axis"), moved, {"units": "1"}),
    }
    if mode is not None:
        data["mode"] = ("spindle_speed", mode, {"units": "1", "none": NO_MODE})
    attrs = {
        "method": "zero_order",
        "frequency_low_Hz": float(f[0]),
        "frequency_high_Hz": float(f[-1]),
        "warnings": warnings,
    }
    out = label(xr.Dataset(data, coords={"spindle_speed": speed, "axis": list(AXES)}, attrs=attrs))
    out["limit_depth"].attrs["infinity"] = "no crossing within the frequency range of the data"
    out["lobe"].attrs["none"] = NO_LOBE
    return out
