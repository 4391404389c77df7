"""Time simulation: a linear modal machine under given forces, and under the cut that it makes itself.

Labelled in, labelled out; the loops are in `process._kernels`. The step is fixed; `default_step` states the rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from process import _kernels
from process.compliance import ModalModel
from process.cutting import CuttingCoefficients
from process.engagement import Engagement
from process.errors import InputError
from process.labels import AXES, make_record
from process.tool import Tool

STEPS_PER_PERIOD = 60
"""Steps in the shortest natural period."""

STEPS_PER_TOOTH = 120
"""Steps from one tooth to the next, at the highest speed."""


@dataclass(frozen=True)
class Spindle:
    """Rotation of the spindle: ``angle = angle0 + rotation t + acceleration t^2/2``.

    Parameters
    ----------
    rotation : float
        Rotation at t = 0 [rad/s].
    acceleration : float, optional
        Angular acceleration [rad/s2].
    angle0 : float, optional
        Angle of tooth 0 at t = 0 [rad].
    """

    rotation: float
    acceleration: float = 0.0
    angle0: float = 0.0

    def angle(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return the spindle angle [rad] at times [s]."""
        t = np.asarray(time, dtype=float)
        return self.angle0 + self.rotation * t + 0.5 * self.acceleration * t**2

    def speed(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return the spindle speed [rpm] at times [s]."""
        return (self.rotation + self.acceleration * np.asarray(time, dtype=float)) * 30.0 / math.pi


@dataclass(frozen=True)
class MillingCut:
    """A cut with one tool: everything that makes the force but the vibration.

    Parameters
    ----------
    tool : Tool
        Geometry, pitch, run-out and helix.
    arc : Engagement
        Arc of engagement.
    coefficients : CuttingCoefficients
        Work material.
    depth : float
        Axial depth of cut a_p [m].
    feed_rate : float, optional
        Feed that is held while the speed changes [m/s].
    feed_per_tooth : float, optional
        Feed that follows the spindle [m]; give this or `feed_rate`.
    """

    tool: Tool
    arc: Engagement
    coefficients: CuttingCoefficients
    depth: float
    feed_rate: float | None = None
    feed_per_tooth: float | None = None

    def __post_init__(self) -> None:
        """Refuse a cut without depth or with two feeds."""
        if not self.depth > 0.0:
            raise InputError(f"the depth of cut is {self.depth * 1e3:g} mm; it must be positive")
        given = [f for f in (self.feed_rate, self.feed_per_tooth) if f is not None]
        if len(given) != 1 or not given[0] > 0.0:
            raise InputError("give either a positive feed_rate [m/s] or a positive feed_per_tooth [m]")


def default_step(machine: ModalModel, cut: MillingCut | None, highest_rotation: float) -> float:
    """Return the largest step [s] that resolves the machine and the tooth.

    The smaller of 1/60 of the shortest natural period and, when cutting, 1/120 of the shortest tooth period.
    """
    step = 1.0 / (STEPS_PER_PERIOD * float(machine.frequency.max()))
    if cut is not None:
        step = min(step, 1.0 / (STEPS_PER_TOOTH * cut.tool.tooth_passing_frequency(highest_rotation)))
    return step


def _discretise(machine: ModalModel, step: float) -> _kernels.Modes:
    """First-order hold: exact for forces that are linear between samples."""
    n = machine.frequency.size
    a, b0, b1 = np.empty((n, 2, 2)), np.empty((n, 2)), np.empty((n, 2))
    w = 2.0 * np.pi * machine.frequency
    for r in range(n):
        system = (
            np.array([[0.0, 1.0], [-(w[r] ** 2), -2.0 * machine.damping[r] * w[r]]]),
            np.array([[0.0], [1.0 / machine.mass[r]]]),
            np.eye(2),
            np.zeros((2, 1)),
        )
        # scipy's first-order hold works on a shifted state z = s - g f, with g returned in its output matrix d.
        ad, bd, _, dd, _ = signal.cont2discrete(system, step, method="foh")
        gain = dd[:, 0]
        a[r] = ad
        b1[r] = gain
        b0[r] = bd[:, 0] - ad @ gain
    shape = np.ascontiguousarray(machine.direction)
    return _kernels.Modes(a, b0, b1, shape, machine.mass, w**2, 2.0 * machine.damping * w)


def _decimated(samples: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Low-pass (zero phase, the same for every channel) and keep every `factor`-th sample."""
    if factor == 1:
        return samples
    out: NDArray[np.float64] = signal.decimate(samples, factor, ftype="fir", axis=-1, zero_phase=True)
    return out


def simulate_forced(machine: ModalModel, force: NDArray[np.float64], sample_rate: float, keep: int = 1) -> xr.Dataset:
    """Return the record of a machine under a given force.

    Parameters
    ----------
    machine : ModalModel
        The machine, at rest before the first sample.
    force : ndarray, shape (3, n)
        Force on the tool [N], linear between samples.
    sample_rate : float
        Samples a second of `force` [Hz].
    keep : int, optional
        Low-pass and keep every `keep`-th sample.

    Returns
    -------
    xarray.Dataset
        Noise-free record with force, displacement and acceleration of the tool.
    """
    force = np.ascontiguousarray(force, dtype=float)
    displacement, acceleration = np.empty_like(force), np.empty_like(force)
    modes = _discretise(machine, 1.0 / sample_rate)
    _kernels.forced_response(modes, force, displacement, acceleration)
    channels = {"force": force, "displacement": displacement, "acceleration": acceleration}
    return _as_record({n: _decimated(c, keep) for n, c in channels.items()}, keep / sample_rate)


def simulate_milling(
    machine: ModalModel,
    cut: MillingCut,
    spindle: Spindle,
    duration: float,
    sample_rate: float,
    lead: float = 0.0,
    tail: float = 0.0,
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0),
    step: float | None = None,
) -> xr.Dataset:
    """Return the record of a machine that mills: from air, through the cut, to air.

    The chip is what lies between a tooth and the surface that earlier teeth have left, so regeneration over any
    number of teeth, loss of contact and run-out need no further model. Teeth follow circles, which is good while
    f_z << D.

    Parameters
    ----------
    machine : ModalModel
        The machine, at rest at t = 0.
    cut : MillingCut
        The cut.
    spindle : Spindle
        Constant or sweeping speed.
    duration : float
        Time in the cut [s].
    sample_rate : float
        Samples a second of the record [Hz].
    lead, tail : float, optional
        Time in air before and after the cut [s].
    impulse : (float, float, float), optional
        Impulse on the tool at entry [N s], to disturb a cut on purpose.
    step : float, optional
        Largest integration step [s]; default `default_step`. The step used divides the sampling interval.

    Returns
    -------
    xarray.Dataset
        Noise-free record with force, displacement, acceleration, spindle_angle and spindle_speed; attributes
        ``step_s`` and ``lost_contact`` (share of engaged tooth steps without contact).

    Raises
    ------
    InputError
        When the spindle stops or reverses within the record.
    """
    total = lead + duration + tail
    rates = (spindle.rotation, spindle.rotation + spindle.acceleration * total)
    if min(rates) <= 0.0:
        raise InputError(
            f"the spindle turns at {rates[0]:g} rad/s at the start and {rates[1]:g} rad/s at the end; "
            "it must turn forward throughout"
        )
    largest = default_step(machine, cut, max(rates)) if step is None else step
    keep = max(1, math.ceil(1.0 / (sample_rate * largest)))
    dt = 1.0 / (sample_rate * keep)
    steps = round(total * sample_rate) * keep
    modes = _discretise(machine, dt)
    out = {name: np.empty((3, steps)) for name in ("force", "displacement", "acceleration")}
    motion = _kernels.Motion(
        spindle.angle0,
        spindle.rotation,
        spindle.acceleration,
        lead,
        lead + duration,
        cut.feed_rate or 0.0,
        (cut.feed_per_tooth or 0.0) * cut.tool.teeth / (2.0 * math.pi),
    )
    teeth = _teeth(cut, dt * max(rates))
    nodes = max(64, math.ceil(2.0 * math.pi / (dt * min(rates))))
    kick = np.asarray(impulse, dtype=float)
    lost, thickest = _kernels.milling(modes, motion, teeth, dt, nodes, kick, *out.values())
    engaged = duration / dt * teeth.lag.size * teeth.slice_lag.size * cut.arc.arc / (2.0 * math.pi)
    record = _as_record({n: _decimated(c, keep) for n, c in out.items()}, 1.0 / sample_rate)
    record["spindle_angle"] = ("time", spindle.angle(record["time"].values), {"units": "rad"})
    record["spindle_speed"] = ("time", spindle.speed(record["time"].values), {"units": "rpm"})
    record.attrs.update(step_s=dt, lost_contact=lost / engaged, largest_chip_thickness_m=thickest)
    return record


def _teeth(cut: MillingCut, angle_step: float) -> _kernels.Teeth:
    sin_k, cos_k = math.sin(cut.tool.approach_angle), math.cos(cut.tool.approach_angle)
    return _kernels.Teeth(
        cut.tool.tooth_angles(),
        cut.tool.tooth_offsets(),
        _slice_lags(cut, angle_step),
        cut.arc.entry,
        cut.arc.exit,
        sin_k,
        cos_k,
        cut.depth / sin_k,
        cut.coefficients.cutting,
        cut.coefficients.edge,
    )


def _slice_lags(cut: MillingCut, angle_step: float) -> NDArray[np.float64]:
    """Angles by which slices along a helical edge trail the tip; one slice where the edge is straight."""
    turn = 2.0 * cut.depth * math.tan(cut.tool.helix_angle) / cut.tool.diameter
    count = max(1, math.ceil(turn / max(angle_step, 0.02)))
    return (np.arange(count) + 0.5) * turn / count


def _as_record(channels: dict[str, NDArray[np.float64]], dt: float) -> xr.Dataset:
    n = next(iter(channels.values())).shape[1]
    vectors = {name: dict(zip(AXES, rows, strict=True)) for name, rows in channels.items()}
    return make_record(np.arange(n) * dt, vectors)
