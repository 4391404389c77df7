"""Time simulation: a linear modal machine under given forces, and under the cut that it makes itself.

Labelled in, labelled out; the loops are in `_milling_kernels`. The step is fixed; `default_step` states the rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import signal

from process.cut import _kernels as cutting
from process.cut.engagement import Engagement
from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, make_record
from process.machine.modes import ModalModel
from process.simulation import _milling_kernels as _kernels
from process.simulation.rules import RULES
from process.types import Real
from process.units import check_feed

CHANNELS = ("force", "displacement", "acceleration")


@dataclass(frozen=True)
class Spindle:
    """Rotation of the spindle, ``speed = rotation (1 + A sin(2 pi f_v t)) + acceleration t``.

    Its integral is ``angle = angle0 + rotation t + acceleration t^2/2 + A rotation/(2 pi f_v) (1 - cos(2 pi f_v t))``.

    Parameters
    ----------
    rotation : float
        Rotation at t = 0 [rad/s].
    acceleration : float, optional
        Angular acceleration [rad/s2].
    angle0 : float, optional
        Angle of tooth 0 at t = 0 [rad].
    variation : float, optional
        Sinusoidal speed variation against chatter: amplitude A relative to `rotation`.
    variation_frequency : float, optional
        Its frequency f_v [Hz].

    Raises
    ------
    InputError
        When a value is not finite, or the variation has no frequency or reverses the spindle.
    """

    rotation: float
    acceleration: float = 0.0
    angle0: float = 0.0
    variation: float = 0.0
    variation_frequency: float = 0.0

    def __post_init__(self) -> None:
        """Refuse values that are not finite, and a variation without frequency."""
        for quantity in fields(self):
            if not math.isfinite(getattr(self, quantity.name)):
                raise InputError(f"the spindle's {quantity.name} is {getattr(self, quantity.name):g}; give a number")
        if not 0.0 <= self.variation < 1.0:
            raise InputError(
                f"the speed varies by {self.variation * 100:g} %; the amplitude must be at least 0 and below 100 %"
            )
        if self.variation > 0.0 and not self.variation_frequency > 0.0:
            raise InputError(
                f"the speed varies with {self.variation_frequency:g} Hz; variation_frequency must be positive"
            )

    def angle(self, time: ArrayLike) -> Real:
        """Return the spindle angle [rad] at times [s]."""
        t = np.asarray(time, dtype=float)
        steady = self.angle0 + self.rotation * t + 0.5 * self.acceleration * t**2
        if self.variation == 0.0:
            return steady
        w = self._variation_omega
        return np.asarray(steady + self.variation * self.rotation / w * (1.0 - np.cos(w * t)))

    def speed(self, time: ArrayLike) -> Real:
        """Return the spindle speed [rpm] at times [s]."""
        return self._rotation_at(np.asarray(time, dtype=float)) * 30.0 / math.pi

    def extremes(self, start: float, end: float) -> tuple[float, float]:
        """Return the lowest and the highest rotation [rad/s] between two times [s].

        Raises
        ------
        InputError
            When the spindle stops or reverses in that time.
        """
        rates = self._rotation_at(np.concatenate([[start, end], self._turning_points(start, end)]))
        lowest, highest = float(rates.min()), float(rates.max())
        if lowest <= 0.0:
            raise InputError(
                f"the spindle turns at {rates[0]:g} rad/s at the start, {rates[1]:g} rad/s at the end and down to "
                f"{lowest:g} rad/s between; it must turn forward throughout"
            )
        return lowest, highest

    @property
    def _variation_omega(self) -> float:
        return 2.0 * math.pi * self.variation_frequency

    def _rotation_at(self, t: Real) -> Real:
        swing = self.variation * np.sin(self._variation_omega * t)
        return np.asarray(self.rotation * (1.0 + swing) + self.acceleration * t)

    def _turning_points(self, start: float, end: float) -> Real:
        """Times [s] at which the rotation is stationary, ``A rotation w cos(w t) = -acceleration``."""
        steepest = self.variation * self.rotation * self._variation_omega
        if abs(steepest) <= abs(self.acceleration):
            return np.empty(0)
        first = math.acos(-self.acceleration / steepest)
        cycles = np.array([start, end]) * self.variation_frequency
        turns = 2.0 * math.pi * np.arange(math.floor(cycles[0]) - 1, math.ceil(cycles[1]) + 1)
        times = np.concatenate([turns + first, turns - first]) / self._variation_omega
        return np.asarray(times[(times > start) & (times < end)])


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
    process_damping : ProcessDamping, optional
        Resistance of the flank to waves on the surface; default: none.

    Raises
    ------
    InputError
        For a cut without depth or without feed, or with two feeds.
    """

    tool: Tool
    arc: Engagement
    coefficients: CuttingCoefficients
    depth: float
    feed_rate: float | None = None
    feed_per_tooth: float | None = None
    process_damping: ProcessDamping = NO_DAMPING

    def __post_init__(self) -> None:
        """Refuse a cut without depth or with two feeds."""
        if not (self.depth > 0.0 and math.isfinite(self.depth)):
            raise InputError(f"the depth of cut is {self.depth * 1e3:g} mm; it must be positive and finite")
        if (self.feed_rate is None) == (self.feed_per_tooth is None):
            number = "neither" if self.feed_rate is None else "both"
            raise InputError(
                f"{number} of feed_rate and feed_per_tooth given; give either a feed_rate [m/s], which is held while "
                "the speed changes, or a feed_per_tooth [m]"
            )
        if self.feed_rate is not None and not 0.0 < self.feed_rate < math.inf:
            raise InputError(f"the feed rate is {self.feed_rate * 6e4:g} mm/min; it must be positive and finite")
        check_feed(self.feed_rate or 0.0)
        if self.feed_per_tooth is not None and not 0.0 < self.feed_per_tooth < math.inf:
            raise InputError(f"the feed per tooth is {self.feed_per_tooth * 1e3:g} mm; it must be positive and finite")


def default_step(machine: ModalModel, cut: MillingCut | None, highest_rotation: float) -> float:
    """Return the largest step [s] that resolves the machine and the tooth.

    The smaller of 1/60 of the shortest natural period and, when cutting, 1/120 of the shortest tooth period.
    """
    step = 1.0 / (RULES.steps_per_period * float(machine.frequency.max()))
    if cut is not None:
        step = min(step, 1.0 / (RULES.steps_per_tooth * cut.tool.tooth_passing_frequency(highest_rotation)))
    return step


def _discretise(machine: ModalModel, step: float) -> _kernels.Modes:
    """First-order hold: exact for forces that are linear between samples."""
    w = 2.0 * np.pi * machine.frequency
    rows = np.empty((w.size, 10))
    for r in range(w.size):
        system = (
            np.array([[0.0, 1.0], [-(w[r] ** 2), -2.0 * machine.damping[r] * w[r]]]),
            np.array([[0.0], [1.0 / machine.mass[r]]]),
            np.eye(2),
            np.zeros((2, 1)),
        )
        # scipy's first-order hold works on a shifted state z = s - g f, with g returned in its output matrix d.
        ad, bd, _, dd, _ = signal.cont2discrete(system, step, method="foh")
        gain = dd[:, 0]
        held = bd[:, 0] - ad @ gain + gain
        rows[r] = [*ad.ravel(), *held, *gain, *(ad @ gain + held)]
    law = np.column_stack([1.0 / machine.mass, 2.0 * machine.damping * w, w**2])
    return _kernels.Modes(rows, np.ascontiguousarray(machine.direction), law)


def _decimated(samples: Real, factor: int) -> Real:
    """Low-pass (zero phase, the same for every channel) and keep every `factor`-th sample."""
    if factor == 1:
        return samples
    out: Real = signal.decimate(samples, factor, ftype="fir", axis=-1, zero_phase=True)
    return out


def simulate_forced(machine: ModalModel, force: Real, sample_rate: float, keep: int = 1) -> xr.Dataset:
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
    state = np.zeros((modes.shape.shape[0], 3))
    state[:, 2] = modes.shape @ force[:, 0]
    _kernels.forced_response(modes, state, force, displacement, acceleration)
    channels = (_decimated(c, keep) for c in (force, displacement, acceleration))
    return _as_record(dict(zip(CHANNELS, channels, strict=True)), keep / sample_rate)


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
        ``step_s``, ``largest_chip_thickness_m`` and ``lost_contact`` (share of engaged tooth steps without contact).

    Raises
    ------
    InputError
        When a time or the sample rate is not possible, the spindle stops or reverses within the record, or the step is
        too coarse.
    """
    _require_times(duration, lead, tail, sample_rate)
    total = lead + duration + tail
    slowest, fastest = spindle.extremes(0.0, total)
    largest = default_step(machine, cut, fastest) if step is None else step
    _require_resolved(machine, cut, fastest, largest)
    keep = max(1, math.ceil(1.0 / (sample_rate * largest) * (1.0 - 1e-12)))
    dt = 1.0 / (sample_rate * keep)
    steps = round(total * sample_rate) * keep
    modes = _discretise(machine, dt)
    out = np.empty((3, 3, steps))
    teeth = pack_teeth(cut, dt, slowest, fastest)
    lost, thickest = _kernels.milling(
        modes,
        np.zeros((modes.shape.shape[0], 3)),
        pack_motion(spindle, cut),
        teeth,
        flat_surfaces(teeth),
        dt,
        lead,
        lead + duration,
        np.asarray(impulse, dtype=float),
        *out,
    )
    engaged = duration / dt * teeth.lag.size * cut.arc.arc / (2.0 * math.pi)
    record = _as_record(dict(zip(CHANNELS, _decimated(out, keep), strict=True)), 1.0 / sample_rate)
    record["spindle_angle"] = ("time", spindle.angle(record["time"].values), {"units": "rad"})
    record["spindle_speed"] = ("time", spindle.speed(record["time"].values), {"units": "rpm"})
    record.attrs.update(step_s=dt, lost_contact=lost / engaged, largest_chip_thickness_m=thickest)
    return record


def _require_times(duration: float, lead: float, tail: float, sample_rate: float) -> None:
    if not (0.0 < duration < math.inf and 0.0 <= lead < math.inf and 0.0 <= tail < math.inf):
        raise InputError(
            f"{lead:g} s in air, {duration:g} s in the cut, {tail:g} s in air; the cut must last, and the others must "
            "be zero or positive"
        )
    if not (sample_rate < math.inf and (lead + duration + tail) * sample_rate >= 2.0):
        raise InputError(f"{lead + duration + tail:g} s at {sample_rate:g} Hz; at least two samples are needed")


def _require_resolved(machine: ModalModel, cut: MillingCut, fastest: float, step: float) -> None:
    """Refuse a step that is coarse against the shortest natural period or against the tooth period."""
    period, tooth = 1.0 / float(machine.frequency.max()), 1.0 / cut.tool.tooth_passing_frequency(fastest)
    if not 0.0 < step <= min(period / RULES.coarsest_per_period, tooth / RULES.coarsest_per_tooth):
        raise InputError(
            f"the step is {step * 1e6:g} us, the shortest natural period {period * 1e6:g} us and the shortest tooth "
            f"period {tooth * 1e6:g} us; at least {RULES.coarsest_per_period} steps in the one and "
            f"{RULES.coarsest_per_tooth} in the other are needed. Leave step out for "
            f"{default_step(machine, cut, fastest) * 1e6:.3g} us"
        )


def pack_motion(spindle: Spindle, cut: MillingCut) -> cutting.Motion:
    """Return spindle and feed as the kernels take them."""
    return cutting.Motion(
        float(spindle.angle0),
        float(spindle.rotation),
        float(spindle.acceleration),
        float(spindle.variation),
        2.0 * math.pi * spindle.variation_frequency,
        float(cut.feed_rate or 0.0),
        (cut.feed_per_tooth or 0.0) * cut.tool.teeth / (2.0 * math.pi),
    )


def pack_teeth(cut: MillingCut, step: float, slowest: float, fastest: float) -> cutting.Teeth:
    """Return the edge elements of a cut as the kernels take them.

    For steps [s] at rotations between two rates [rad/s]; the surface has at least one node a step.
    """
    slices = _slice_lags(cut, step * fastest)
    count, teeth = slices.size, cut.tool.teeth
    lag = (slices[:, None] + cut.tool.tooth_angles()).ravel()
    before = (np.arange(count)[:, None] * teeth + (np.arange(teeth) - 1) % teeth).ravel()
    nodes = 1 << max(6, math.ceil(math.log2(2.0 * math.pi / (step * slowest))))
    scale = nodes / (2.0 * math.pi)
    margin = 2.0 + 0.5 * step * fastest * scale
    sin_k, cos_k = math.sin(cut.tool.approach_angle), math.cos(cut.tool.approach_angle)
    length = cut.depth / sin_k / count
    # (tangential, radial, axial) to (tangential, normal in the plane, along the tool axis).
    turned = np.array([[1.0, 0.0, 0.0], [0.0, sin_k, cos_k], [0.0, cos_k, -sin_k]])
    return cutting.Teeth(
        lag=lag * scale,
        sin_lag=np.sin(lag),
        cos_lag=np.cos(lag),
        offset=np.tile(cut.tool.tooth_offsets(), count) * sin_k,
        before=before,
        sin_node=np.sin(np.arange(nodes) / scale),
        cos_node=np.cos(np.arange(nodes) / scale),
        back=nodes if teeth == 1 else 0,
        nodes=nodes,
        scale=scale,
        spacing=1.0 / scale,
        entry=cut.arc.entry * scale,
        leave=cut.arc.exit * scale,
        low=cut.arc.entry * scale - margin,
        high=cut.arc.exit * scale + margin,
        sin_k=sin_k,
        cos_k=cos_k,
        chip=length * turned @ cut.coefficients.cutting,
        edge=length * turned @ cut.coefficients.edge,
        damping=2.0 * length * cut.process_damping.coefficient / cut.tool.diameter,
        friction=float(cut.process_damping.friction),
    )


def flat_surfaces(teeth: cutting.Teeth) -> Real:
    """Return the surfaces of a block that no tooth has touched, shape (elements, ring)."""
    return np.zeros((teeth.lag.size, teeth.nodes + teeth.back))


def _slice_lags(cut: MillingCut, angle_step: float) -> Real:
    """Angles by which slices along a helical edge trail the tip; one slice where the edge is straight."""
    turn = 2.0 * cut.depth * math.tan(cut.tool.helix_angle) / cut.tool.diameter
    count = max(1, math.ceil(turn / max(angle_step, 0.02)))
    return (np.arange(count) + 0.5) * turn / count


def _as_record(channels: dict[str, Real], dt: float) -> xr.Dataset:
    n = next(iter(channels.values())).shape[1]
    vectors = {name: dict(zip(AXES, rows, strict=True)) for name, rows in channels.items()}
    return make_record(np.arange(n) * dt, vectors)
