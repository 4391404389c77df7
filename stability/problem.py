"""What is asked of a stability method: the cut, its pitch, the spindle speeds, the compliance or the modes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.cut.engagement import AnyEngagement
from process.cut.force import (
    NO_DAMPING,
    CuttingCoefficients,
    ProcessDamping,
    directional_matrix,
    force_projection,
)
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, at_tool, check_compliance, full_matrix, never_known
from process.types import Complex, Real
from stability.rules import RULES

NO_LOBE = -1
"""Value of ``lobe`` where there is no limit."""


@dataclass(frozen=True)
class Cut:
    """The cut whose limit depth is asked: everything but depth and spindle speed.

    Parameters
    ----------
    tool : Tool
        Geometry of the tool.
    arc : Engagement or Engagements
        One arc of engagement or several.
    coefficients : CuttingCoefficients
        Work material [N/m2]; edge coefficients do not regenerate and have no influence.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.
    """

    tool: Tool
    arc: AnyEngagement
    coefficients: CuttingCoefficients
    process_damping: ProcessDamping = NO_DAMPING

    @property
    def twist(self) -> float:
        """How far the upper end of the edges runs behind the tip, a unit of depth [rad/m]: ``2 tan(helix)/D``."""
        return 2.0 * math.tan(self.tool.helix_angle) / self.tool.diameter

    @property
    def helix_pitch(self) -> float:
        """Depth [m] over which a helical edge runs behind by the mean angle between two teeth; inf if straight."""
        return 2.0 * math.pi / (self.tool.teeth * self.twist) if self.twist > 0.0 else math.inf

    @property
    def worn(self) -> bool:
        """Whether the flank resists the vibration at all."""
        return self.process_damping.coefficient > 0.0

    def flank_projection(self) -> Real:
        """Return P of the worn flank [N/m2], shape (3, 3): ``F = a_p P (s, c, 1)^T (s, c, 1) Q dr/dphi`` of a tooth.

        The cutting speed is ``Omega D/2`` and ``r' = Omega dr/dphi``: against the slope of the vibration over the angle
        of the tool the flank does the same at every spindle speed, ``P = (2 C/D) P(mu, 1, 0)`` :eq:`process-damping`.
        """
        flank = self.process_damping
        triple = np.array([flank.friction, 1.0, 0.0]) * (2.0 * flank.coefficient / self.tool.diameter)
        return force_projection(triple, self.tool.approach_angle)

    def directional_matrix(self) -> Complex:
        """Return the mean directional matrix A0 [N/m2] of all teeth, shape (3, 3), per axial depth; any pitch."""
        return directional_matrix(replace(self.tool, pitch_angles=None), self.arc, self.coefficients)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is unusual about the work material."""
        if self.coefficients.Krc >= 0.0:
            return ()
        return (
            f"K_rc is {self.coefficients.Krc / 1e6:g} N/mm^2: the radial force would pull the tool into the work; "
            "check the sign",
        )

    @property
    def mean_warnings(self) -> tuple[str, ...]:
        """The same where the mean directional matrix stands for the cut: it does not know a helix.

        Over edges that run behind by ``t = 2 a_p tan(helix)/D`` the harmonic k of the directional matrix is multiplied
        by ``sin(k t/2)/(k t/2) exp(-j k t/2)``, the mean, k = 0, by one at every depth; at whole helix pitches the
        others vanish and the mean is all there is. Each part of the edge passes the same arc in a turn, only later:
        averaged over a turn it does what that of a straight edge does. What is lost is what the mean loses anyhow, and
        a helix changes: the harmonics, and with them period doubling.
        """
        if self.tool.helix_angle == 0.0:
            return self.warnings
        return (
            *self.warnings,
            f"the mean directional matrix does not know the helix of {math.degrees(self.tool.helix_angle):g} deg: over "
            "a turn it is that of straight edges. The harmonics that it leaves out (few teeth in the cut) are not",
        )

    def require_equal_pitch(self, what: str) -> None:
        """Raise `InputError` when the teeth are not equally spaced: then a lobe is no explicit curve."""
        if not self.tool.equal_pitch:
            degrees = ", ".join(f"{math.degrees(p):g}" for p in self.tool.pitch_angles or ())
            raise InputError(
                f"the tool has unequal pitch ({degrees} deg); {what} can be had for equally spaced teeth only. Ask for "
                "the limits at the speeds of interest, or leave pitch_angles out to treat the teeth as equally spaced"
            )


def check_spindle_speed(spindle_speed: ArrayLike) -> Real:
    """Return spindle speeds [rpm] as an array of shape (speeds,).

    Raises
    ------
    InputError
        When there is none, or one is not a positive finite number.
    """
    speed = np.atleast_1d(np.asarray(spindle_speed, dtype=float))
    if speed.ndim != 1 or speed.size == 0:
        raise InputError(f"spindle speeds of shape {speed.shape}; a list of at least one speed in rpm is needed")
    bad = ~(np.isfinite(speed) & (speed > 0.0))
    if bad.any():
        raise InputError(f"a spindle speed of {speed[bad][0]:g} rpm; speeds must be positive and finite")
    return speed


@dataclass(frozen=True)
class Samples:
    """A measured compliance on its own frequency grid, complete frequencies only.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Frequencies above zero at which every entry is known that was measured at all [Hz].
    matrix : ndarray of complex, shape (n, 3, 3)
        Compliance [m/N]; entries that were not measured are zero.
    bridged : ndarray of bool, shape (n - 1,)
        Whether a method may interpolate between a sample and the next.
    warnings : tuple of str
        What the user must know about the data.
    """

    frequency: Real
    matrix: Complex
    bridged: NDArray[np.bool_]
    warnings: tuple[str, ...]


def complete_samples(compliance: xr.Dataset) -> Samples:
    """Return the samples of a compliance at which all measured entries are finite.

    Raises
    ------
    InputError
        When the dataset holds no compliance, holds more than one (a condition such as ``feed`` is still a
        dimension), or has fewer than two complete frequencies.
    """
    compliance = at_tool(check_compliance(compliance))
    array = compliance["compliance"]
    extra = [str(d) for d in array.dims if d not in ("frequency", "response", "excitation")]
    if extra:
        values = ", ".join(f"{v}" for v in array[extra[0]].values)
        raise InputError(
            f"the compliance still has the dimension '{extra[0]}' ({values}); choose one, "
            f"e.g. compliance.sel({extra[0]}=...)"
        )
    every = compliance["frequency"].values.astype(float)
    missing = never_known(array)
    if missing.all():
        raise InputError("the compliance holds no number at any frequency; measure at least one direct entry, e.g. xx")
    names = [tuple(map(str, array[dim].values)) for dim in ("response", "excitation")]
    full = _as_it_is(array, missing, names)
    finite = np.isfinite(full)
    complete = (finite.reshape(every.size, -1).all(axis=1) if not finite.all() else np.True_) & (every > 0.0)
    if complete.sum() < 2:
        raise InputError(
            f"the compliance is complete at {int(complete.sum())} of {every.size} frequencies above 0 Hz; "
            "at least 2 are needed: its entries know no frequencies in common, so measure them over one band"
        )
    frequency, matrix = (every, full) if complete.all() else (every[complete], full[complete])
    masked_between = np.diff(np.flatnonzero(complete)) > 1
    bridged = ~(masked_between | _long_steps(frequency))
    both = [i for i, a in enumerate(AXES) if a in names[0] and a in names[1]]
    warnings = [
        *partial_warning(names[0], names[1], missing),
        *_gap_warnings(frequency, bridged),
        *_active_warning(frequency, matrix, both, _noise(compliance)[complete]),
    ]
    return Samples(frequency, matrix, bridged, tuple(warnings))


def _as_it_is(array: xr.DataArray, missing: xr.DataArray, names: list[tuple[str, ...]]) -> Complex:
    """Return the full matrix; without a copy where the compliance is one already."""
    dims = ("frequency", "response", "excitation")
    if array.dims == dims and names == [AXES, AXES] and not missing.values.any():
        return np.ascontiguousarray(array.values, dtype=np.complex128)
    return full_matrix(array.to_dataset(name="compliance"))


def edge_warnings(samples: Samples) -> tuple[str, ...]:
    """Say where a compliance ends before its modes do: what lies outside is not known, and limits come out too high."""
    f, matrix = samples.frequency, samples.matrix
    size = np.sqrt(np.einsum("nk,nk->n", *[np.ascontiguousarray(matrix).view(float).reshape(f.size, -1)] * 2))
    out = []
    if size[-1] > RULES.edge_size * size.max():
        out.append(
            f"at {f[-1]:.6g} Hz, its last sample, the compliance still is {100.0 * size[-1] / size.max():.0f} % of its "
            "peak: modes there and above are missing, and limits may be too high; measure further up"
        )
    if np.linalg.norm(matrix[0].imag) > RULES.edge_phase * size[0]:
        out.append(
            f"at {f[0]:.6g} Hz, its first sample, the compliance is out of phase with the force: modes there and below "
            "are missing, and limits may be too high; measure further down"
        )
    return tuple(out)


def _noise(compliance: xr.Dataset) -> Real:
    """Return the standard deviation of the whole matrix at each frequency [m/N]; zero where it is not known."""
    if "compliance_std" not in compliance:
        return np.zeros(compliance.sizes["frequency"])
    std = compliance["compliance_std"].transpose("frequency", ...).values
    return np.asarray(np.sqrt(np.nansum(std.reshape(std.shape[0], -1) ** 2, axis=1)))


def _active_warning(frequency: Real, matrix: Complex, axes: list[int], noise: Real) -> list[str]:
    """Say when a compliance gives energy: ``j (Phi - Phi^H)/2`` of a passive machine has no negative eigenvalue.

    That is so where no principal minor is negative, of the axes that were both driven and measured.
    """
    entry = {(i, k): matrix[:, i, k] for i in axes for k in axes}
    size = np.sqrt(sum((z.real**2 + z.imag**2 for z in entry.values()), np.zeros(frequency.size)))
    allowed = RULES.active_share * size + RULES.beyond_noise * noise
    own = {i: allowed - entry[i, i].imag for i in axes}
    across = {(i, k): 0.5j * (entry[i, k] - entry[k, i].conj()) for i, k in combinations(axes, 2)}
    square = {pair: z.real**2 + z.imag**2 for pair, z in across.items()}
    minors = [*own.values(), *(own[i] * own[k] - square[i, k] for i, k in across)]
    if len(axes) == 3:
        cycle = (across[0, 1] * across[1, 2] * across[0, 2].conj()).real
        minors.append(
            own[0] * (own[1] * own[2] - square[1, 2]) + 2.0 * cycle - own[1] * square[0, 2] - own[2] * square[0, 1]
        )
    passive = np.logical_and.reduce([minor >= 0.0 for minor in minors]) if minors else np.ones(size.size, dtype=bool)
    bad = np.flatnonzero(~passive & (size > 0.1 * size.max(initial=0.0)))
    if bad.size == 0:
        return []
    return [
        f"the compliance is not that of a passive machine at {bad.size} of {size.size} frequencies "
        f"({frequency[bad[0]]:.6g} to {frequency[bad[-1]]:.6g} Hz): it would give energy to the cut. A channel of the "
        "wrong sign or a delay between force and motion does that; a servo may. Check before limits there are used"
    ]


def _long_steps(frequency: Real) -> NDArray[np.bool_]:
    """Mark the steps that are longer than `gap_factor` times the longer of their neighbours."""
    step = np.diff(frequency)
    if step.size < 2:
        return np.zeros(step.size, dtype=bool)
    before = np.concatenate([[0.0], step[:-1]])
    after = np.concatenate([step[1:], [0.0]])
    return np.asarray(step > RULES.gap_factor * np.maximum(before, after), dtype=bool)


def partial_warning(response: ArrayLike, excitation: ArrayLike, missing: xr.DataArray) -> list[str]:
    """Name what is taken as rigid: axes that are not there, and entries (response, excitation) without a number."""
    there = {"response": set(np.asarray(response)), "excitation": set(np.asarray(excitation))}
    if not missing.values.any() and all(len(axes) == 3 for axes in there.values()):
        return []
    for dim, other in (("response", "excitation"), ("excitation", "response")):
        there[dim] -= set(missing[dim].values[missing.all(other).values])
    absent = [f"no {dim} {', '.join(a for a in AXES if a not in axes)}" for dim, axes in there.items() if len(axes) < 3]
    single = [
        f"{r}{e}"
        for r in AXES
        for e in AXES
        if r in there["response"] and e in there["excitation"] and missing.sel(response=r, excitation=e)
    ]
    absent += [f"no {', '.join(single)}"] if single else []
    if not absent:
        return []
    return [
        f"the compliance is a partial matrix ({'; '.join(absent)}): what was not measured is taken as rigid. "
        "The limit with the rest can be several times lower or higher, and no measured entry bounds by how much; "
        "excite and measure the missing directions, at least x and y"
    ]


def _gap_warnings(frequency: Real, bridged: NDArray[np.bool_]) -> list[str]:
    """Say which bands are missing, in one sentence."""
    gaps = np.flatnonzero(~bridged)
    if gaps.size == 0:
        return []
    bands = [f"{frequency[i]:.6g} to {frequency[i + 1]:.6g} Hz" for i in gaps[:5]]
    more = f" and {gaps.size - 5} more" if gaps.size > 5 else ""
    return [
        f"the compliance is missing between its samples in {gaps.size} band(s): {', '.join(bands)}{more}; "
        "no limit with a chatter frequency there is found"
    ]


# --- the pattern in which the teeth pass, and the machine in its modes ------------------------------------------------


class Machine(Protocol):
    """Anything linear seen from the tool: a `process.ModalModel`, a closed loop."""

    def state_space(self) -> tuple[Real, Real, Real]:
        """Return A (N, N), B (N, 3), C (3, N) of ``q' = A q + B F``, ``r = C q``."""


@dataclass(frozen=True)
class Pattern:
    """How the teeth follow each other; all angles [rad].

    Parameters
    ----------
    repeats : int
        How often the pattern repeats in a turn: the number of teeth for equal pitch.
    lag : ndarray, shape (teeth,)
        How far each tooth runs behind tooth 0.
    delay : ndarray, shape (teeth,)
        How far each tooth runs behind the tooth that has cut before it.
    """

    repeats: int
    lag: Real
    delay: Real

    @property
    def period(self) -> float:
        """Angle after which the cut repeats."""
        return 2.0 * math.pi / self.repeats

    def lobe(self, turns: float) -> int:
        """Return the whole waves between two teeth, on average, of a line with so many waves in a period."""
        return math.floor(turns * self.repeats / self.lag.size + 1e-9)

    def duration(self, spindle_speed: float) -> float:
        """Return the time after which the cut repeats [s] at a spindle speed [rpm]."""
        return 60.0 / (spindle_speed * self.repeats)


def pattern_of_pitch(tool: Tool) -> Pattern:
    """Return the pattern of the pitch angles of a tool."""
    lag = tool.tooth_angles()
    pitch = np.diff(np.append(lag, 2.0 * math.pi))
    shift = next(s for s in range(1, lag.size + 1) if np.allclose(pitch, np.roll(pitch, s), rtol=0.0, atol=1e-9))
    return Pattern(lag.size // shift, lag, np.roll(pitch, 1))


@dataclass(frozen=True)
class Modes:
    """A machine in its modal coordinates ``z' = rate z + participation F``, ``r = shape z``.

    Parameters
    ----------
    rate : ndarray of complex, shape (N,)
        Poles [1/s].
    shape : ndarray of complex, shape (3, N)
        Displacement of the tool a unit of each coordinate.
    participation : ndarray of complex, shape (N, 3)
        What a force at the tool does to each coordinate.
    """

    rate: Complex
    shape: Complex
    participation: Complex

    def matrix(self, frequency: ArrayLike) -> Complex:
        """Return the compliance [m/N], shape (f, 3, 3), at frequencies [Hz] of either sign."""
        gain = 1.0 / (2j * np.pi * np.asarray(frequency, dtype=float)[:, None] - self.rate)
        return np.asarray((gain @ self._products).reshape(-1, 3, 3))

    @cached_property
    def _products(self) -> Complex:
        """What each coordinate gives to the nine entries, shape (N, 9)."""
        return np.asarray((self.shape[:, :, None] * self.participation).transpose(1, 0, 2).reshape(-1, 9))


def modes_of(machine: Machine) -> Modes:
    """Return a machine in its modal coordinates; coinciding poles that share one vector are moved apart by 1e-9.

    Raises
    ------
    InputError
        When the shapes do not fit, the machine is itself unstable, or its modes cannot be separated.
    """
    if not hasattr(machine, "state_space"):
        raise InputError(
            f"a {type(machine).__name__} has no state space of its own; give a modal model, or a machine at an "
            "operating point: machine.at(feed, controller)"
        )
    a, b, c = (np.asarray(m, dtype=float) for m in machine.state_space())
    n = a.shape[0]
    if a.shape != (n, n) or b.shape != (n, 3) or c.shape != (3, n):
        raise InputError(
            f"the state space has A {a.shape}, B {b.shape}, C {c.shape}; force and displacement of the tool in x, y "
            "and z are needed: A (N, N), B (N, 3), C (3, N)"
        )
    if not all(np.isfinite(m).all() for m in (a, b, c)):
        raise InputError("the state space of the machine holds values that are not finite; give finite numbers")
    growth = float(np.linalg.eigvals(a).real.max())
    if growth >= 0.0:
        raise InputError(
            f"the machine is not stable without cutting: a pole grows with {growth:.3g} 1/s, so that no depth is "
            "stable. Check damping, gains and delay"
        )
    for nudge in (0.0, 1e-9):
        rate, vectors = np.linalg.eig(a * (1.0 + nudge * np.cos(np.arange(a.size)).reshape(a.shape)))
        inverse = np.linalg.pinv(vectors)
        if np.linalg.norm((vectors * rate) @ inverse - a) <= 1e-6 * np.linalg.norm(a):
            return Modes(rate.astype(complex), (c @ vectors).astype(complex), (inverse @ b).astype(complex))
    raise InputError("poles of the machine coincide so that its modes cannot be separated; shift one by 0.1 %")
