"""Time simulation of one feed axis with its servo, dead time and friction law: hammer hits and stepped sines in motion.

Deviations from the ramp ``x_ref = v0 t`` are integrated: the steady friction is held by the integrator, so there is
no start-up transient, no baseline run and no cancellation. Labelled in and out; the loop is in
`process._axis_kernels`. The step is fixed in a run; `sliding_step` and `default_step` state the rules, `step_error`
halves the step, and every record carries its energy error.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import signal

from process import _axis_kernels as kernels
from process.drive import Drive
from process.errors import InputError
from process.friction import FrictionLaw, Viscous
from process.labels import make_record
from process.trials import half_sine
from process.units import from_si

STEPS_PER_PERIOD = 200
"""Steps in the period of the fastest linear pole."""

STEPS_PER_EVENT = 100
"""Steps in the shortest event of the excitation."""

DECAY_PER_STEP = 0.55
"""Largest product of step and fastest decay rate (friction slope at rest over mass); Runge-Kutta allows 2.78."""

_DECAY_LIMIT = 2.5
_COARSEST_PERIOD = 20
_FAST = 10.0
_WINDOW = 0.25
_STANDSTILL = 0.1
_FILTER_SAMPLES = 10


class Excitation(ABC):
    """A force on the tip as a function of time."""

    @abstractmethod
    def force(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force [N] at times [s], shape (n,)."""

    @property
    @abstractmethod
    def shortest(self) -> float:
        """Shortest event [s] that the step has to resolve."""

    @property
    @abstractmethod
    def end(self) -> float:
        """Time [s] after which there is no force."""


@dataclass(frozen=True)
class HalfSine(Excitation):
    """Hammer hit: a half-sine pulse of given impulse and duration.

    Parameters
    ----------
    impulse : float
        [N s]. On an idle axis this, not the peak force, decides whether the carriage breaks away.
    duration : float, optional
        Contact time [s].
    start : float, optional
        [s]; the low-pass of the record needs some samples before the hit.
    """

    impulse: float
    duration: float = 4e-3
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a pulse that does not last."""
        if not (self.duration > 0.0 and self.start >= 0.0 and math.isfinite(self.impulse)):
            raise InputError(
                f"a pulse of {self.impulse:g} N s, {self.duration:g} s long, at {self.start:g} s; "
                "the duration must be positive and the start not negative"
            )

    @classmethod
    def from_peak(cls, peak: float, duration: float = 4e-3, start: float = 0.02) -> HalfSine:
        """Return the pulse of a peak force [N]; its impulse is ``2/pi peak duration``."""
        return cls(2.0 / math.pi * peak * duration, duration, start)

    def force(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force [N] at times [s]."""
        return half_sine(time, self.start, self.impulse, self.duration)

    @property
    def shortest(self) -> float:
        """The pulse [s]."""
        return self.duration

    @property
    def end(self) -> float:
        """End of the pulse [s]."""
        return self.start + self.duration


@dataclass(frozen=True)
class SteppedSine(Excitation):
    """Actuator: a sine of constant amplitude, phase-continuous from step to step.

    Parameters
    ----------
    frequencies : tuple of float
        Frequency of each step [Hz].
    amplitude : float
        [N].
    dwell : float
        Time a step [s].
    start : float, optional
        [s].
    """

    frequencies: tuple[float, ...]
    amplitude: float
    dwell: float = 1.5
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a sine without frequency or time."""
        if not self.frequencies or min(self.frequencies) <= 0.0 or not self.dwell > 0.0:
            raise InputError(f"frequencies {self.frequencies} Hz for {self.dwell:g} s each; all must be positive")

    def force(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force [N] at times [s], ``A sin(2 pi int f dt)``."""
        f = np.asarray(self.frequencies)
        turns = np.concatenate([[0.0], np.cumsum(f * self.dwell)])
        u = (time - self.start) / self.dwell
        k = np.clip(np.floor(u).astype(int), 0, f.size - 1)
        inside = (u >= 0.0) & (u < f.size)
        phase = 2.0 * np.pi * (turns[k] + f[k] * (u - k) * self.dwell)
        return np.where(inside, self.amplitude * np.sin(phase), 0.0)

    @property
    def shortest(self) -> float:
        """Half a period of the highest frequency [s]."""
        return 0.5 / max(self.frequencies)

    @property
    def end(self) -> float:
        """End of the last step [s]."""
        return self.start + self.dwell * len(self.frequencies)


def _slopes(friction: FrictionLaw) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Friction slope [N s/m], the steeper of both directions, on speeds [m/s] from zero up."""
    speeds = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 1000)])
    slopes = np.maximum(friction.slope(speeds), friction.slope(-speeds))
    if not np.all(np.isfinite(slopes)):
        raise InputError(
            "the friction law jumps at rest (kt is infinite); a time simulation needs a finite kt, e.g. 15000 s/m"
        )
    return speeds, slopes


def _dead_time(drive: Drive) -> float:
    return 0.0 if drive.servo is None else drive.servo.delay


def _fastest_pole(drive: Drive, friction: FrictionLaw) -> float:
    """Largest pole [rad/s] of the axis when it slides fast, without its dead time."""
    prompt = None if drive.servo is None else replace(drive.servo, delay=0.0)
    return float(np.abs(replace(drive, servo=prompt, sigma=float(friction.slope(_FAST))).poles()).max())


def _decay(drive: Drive, slope: float) -> float:
    """Decay rate [1/s] of the carriage against friction, servo and joint."""
    kp = 0.0 if drive.servo is None else drive.servo.Kp
    return (slope + kp) / drive.moving_mass + drive.damping * (1.0 / drive.moving_mass + 1.0 / drive.tip_mass)


def sliding_step(drive: Drive, friction: FrictionLaw, excitation: Excitation) -> float:
    """Return the integration step [s] while the carriage slides.

    The smallest of: 1/200 of the fastest linear period; 1/100 of the shortest event; the dead time.
    """
    period = 2.0 * math.pi / _fastest_pole(drive, friction)
    step = min(period / STEPS_PER_PERIOD, excitation.shortest / STEPS_PER_EVENT)
    return min(step, _dead_time(drive) or math.inf)


def default_step(drive: Drive, friction: FrictionLaw, excitation: Excitation) -> float:
    """Return the integration step [s] that also follows the friction at rest.

    The smaller of `sliding_step` and 0.55 over the fastest decay rate, which is about the friction slope at rest over
    the carriage mass (10 us for the bench of Franco et al. 2024).
    """
    steepest = float(_slopes(friction)[1].max())
    return min(sliding_step(drive, friction, excitation), DECAY_PER_STEP / _decay(drive, steepest))


def _slowest(drive: Drive, friction: FrictionLaw, step: float, product: float) -> float:
    """Speed [m/s] that the carriage must keep so that decay rate times step stays below `product`; 0: any speed."""
    speeds, slopes = _slopes(friction)
    rest = product * (1.0 + 1e-12) / step - _decay(drive, 0.0)
    steep = np.flatnonzero(slopes / drive.moving_mass > rest)
    if not steep.size:
        return 0.0
    return float(speeds[steep[-1] + 1]) if steep[-1] + 1 < speeds.size else math.inf


def _tries(
    drive: Drive, friction: FrictionLaw, excitation: Excitation, step: float | None
) -> list[tuple[float, float]]:
    """Steps [s] to march with, one after the other, and the speed [m/s] that the carriage must keep with each."""
    if step is None:
        sliding = sliding_step(drive, friction, excitation)
        slowest = _slowest(drive, friction, sliding, DECAY_PER_STEP)
        return [(sliding, slowest), (default_step(drive, friction, excitation), 0.0)]
    period = 2.0 * math.pi / _fastest_pole(drive, friction)
    largest = min(period / _COARSEST_PERIOD, _dead_time(drive) or math.inf)
    if not 0.0 < step <= largest * (1.0 + 1e-12):
        raise InputError(
            f"the step is {step * 1e6:g} us; at most {largest * 1e6:.4g} us follow the fastest pole and the dead time "
            "of this axis; leave the step out to have it chosen"
        )
    return [(step, _slowest(drive, friction, step, _DECAY_LIMIT))]


def _friction_of(drive: Drive, friction: FrictionLaw | None) -> FrictionLaw:
    if friction is None:
        return Viscous(drive.sigma)
    if drive.sigma != 0.0:
        raise InputError(
            f"the drive has sigma {drive.sigma:g} N s/m and a friction law is given: friction would count twice; "
            "put the viscous part into the law and leave sigma 0"
        )
    return friction


def _require_bounded(drive: Drive, friction: FrictionLaw) -> None:
    """Friction limits a motion only where its force rises with speed: the servo must be stable when sliding fast."""
    for slope in {float(friction.slope(-_FAST)), float(friction.slope(_FAST))}:
        replace(drive, sigma=slope).require_stable()


def simulate_axis(
    drive: Drive,
    friction: FrictionLaw | None,
    excitation: Excitation,
    feed: float,
    duration: float,
    sample_rate: float = 2000.0,
    step: float | None = None,
    axis: str = "x",
) -> xr.Dataset:
    """Return the record of an axis that moves at a constant feed while its tip is hit or shaken.

    Parameters
    ----------
    drive : Drive
        Masses, joint and servo; the axis follows its ramp steadily before the excitation.
    friction : FrictionLaw or None
        Friction of the carriage; None means the drive's own sigma. With a law, the drive's sigma must be zero.
    excitation : Excitation
        Force on the tip.
    feed : float
        Feed v0 [m/s], of either sign; zero is idle.
    duration : float
        Length of the record [s].
    sample_rate : float, optional
        Samples a second [Hz]; above it every channel is low-passed alike.
    step : float, optional
        Largest integration step [s]; default `sliding_step`, or `default_step` when the carriage comes near rest. The
        step used divides the sampling interval.
    axis : {"x", "y", "z"}, optional
        Name of the axis.

    Returns
    -------
    xarray.Dataset
        ``force``, ``displacement`` and ``acceleration`` of the tip (deviations from the ramp), ``encoder_position`` and
        ``reference_position`` (with the ramp), ``drive_force`` (with the steady friction). Attributes: ``feed_mm_min``;
        ``step_s``; ``energy_error`` (of the largest energy); ``unstable_poles`` of uniform motion, with the local
        friction slope; of the last quarter second, ``residual_m`` (half the swing of the tip) and ``standstill_share``
        (carriage slower than a tenth of the feed, or going back); and ``motion``: "settled", "excited to the end",
        "still decaying", or a sentence that begins with "self-excited": not at rest without excitation.

    Raises
    ------
    InputError
        When the servo is unstable, the step is too large, or the law jumps at rest.
    """
    law = _friction_of(drive, friction)
    _require_bounded(drive, law)
    if not (duration * sample_rate >= 2.0 and math.isfinite(feed)):
        raise InputError(f"{duration:g} s at {sample_rate:g} Hz and feed {feed:g} m/s; at least two samples are needed")
    samples = round(duration * sample_rate)
    run = _integrate(drive, law, excitation, feed, sample_rate, samples, step)
    kept = _decimated(np.vstack([run.force[::2], run.out[[0, 2, 4, 5]]]), run.keep)[:, :samples]
    record = _as_record(drive, law, feed, kept, sample_rate, axis)
    record.attrs.update(feed_mm_min=from_si(feed, "mm/min", "speed"), step_s=run.step, energy_error=run.error)
    local = replace(drive, sigma=float(law.slope(feed)))
    poles = 0 if drive.servo is None else local.unstable_poles()
    record.attrs.update(_verdict(run.out[:, : samples * run.keep], run.step, feed, excitation.end, poles))
    return record


class _Run(NamedTuple):
    """Half-step force (2 n - 1,), kernel channels (CHANNELS, n), relative energy error, step [s], steps a sample."""

    force: NDArray[np.float64]
    out: NDArray[np.float64]
    error: float
    step: float
    keep: int


def _integrate(
    drive: Drive,
    law: FrictionLaw,
    excitation: Excitation,
    feed: float,
    sample_rate: float,
    samples: int,
    step: float | None,
) -> _Run:
    """March with the step given; or with `sliding_step`, and with `default_step` when the carriage comes near rest."""
    for largest, slowest in _tries(drive, law, excitation, step):
        if 0.0 < slowest >= abs(feed):
            continue
        keep = max(1, math.ceil(1.0 / (sample_rate * largest) - 1e-9))
        dt = 1.0 / (sample_rate * keep)
        # The low-pass looks ahead: march beyond the end of the record.
        steps = (samples + (2 * _FILTER_SAMPLES if keep > 1 else 0)) * keep
        force = excitation.force(np.arange(2 * steps - 1, dtype=np.float64) * (0.5 * dt))
        out = np.empty((kernels.CHANNELS, steps))
        done, error, energy = kernels.march(*_packed(drive, law, feed), _dead_time(drive), dt, slowest, force, out)
        if done == steps:
            return _Run(force, out, error / energy if energy > 0.0 else 0.0, dt, keep)
        if not abs(out[0, done - 1]) < 1.0:
            raise InputError(f"the tip left the range of 1 m after {done * dt:.3g} s; it is hit too hard, or unstable")
    at_rest = _DECAY_LIMIT / _decay(drive, float(_slopes(law)[1].max()))
    raise InputError(
        f"the step is {largest * 1e6:g} us, too large for the friction of a carriage slower than "
        f"{from_si(slowest, 'mm/min', 'speed'):.3g} mm/min, as this one is or becomes; at most "
        f"{at_rest * 1e6:.4g} us are not; leave the step out to have it chosen"
    )


def _packed(drive: Drive, law: FrictionLaw, feed: float) -> tuple[kernels.Axis, kernels.Friction]:
    masses = (drive.tip_mass, drive.moving_mass, drive.stiffness, drive.damping)
    v = drive.servo
    gains = (0.0, 0.0, 0.0) if v is None else (v.Kp, 1.0 / v.Ti, v.Kv)
    code, parameters = law.packed()
    return kernels.Axis(*masses, *gains, feed), kernels.Friction(code, parameters, float(law.force(feed)))


def _decimated(samples: NDArray[np.float64], keep: int) -> NDArray[np.float64]:
    """Low-pass without phase, the same for every channel, and take every `keep`-th sample."""
    if keep == 1:
        return samples
    out: NDArray[np.float64] = signal.decimate(samples, keep, ftype="fir", axis=-1, zero_phase=True)
    return out


def _as_record(
    drive: Drive, law: FrictionLaw, feed: float, kept: NDArray[np.float64], sample_rate: float, axis: str
) -> xr.Dataset:
    """Label the channels and put the ramp and the steady friction back; kept (5, n) as unpacked below."""
    time = np.arange(kept.shape[1]) / sample_rate
    force, tip, carriage, acceleration, push = kept
    lag = 0.0 if drive.servo is None else drive.servo.following_error(feed)
    vectors = {
        "force": force,
        "displacement": tip,
        "acceleration": acceleration,
        "encoder_position": feed * time - lag + carriage,
        "reference_position": feed * time,
        "drive_force": float(law.force(feed)) + push,
    }
    return make_record(time, {name: {axis: values} for name, values in vectors.items()})


def _verdict(out: NDArray[np.float64], dt: float, feed: float, end: float, poles: int) -> dict[str, float | int | str]:
    """Say how the record ends: settled, decaying, or in a motion that nobody excites.

    The third and the last quarter of the time after the excitation are compared; they should hold several periods.
    """
    quarter = max(2, (out.shape[1] - round(end / dt)) // 4)
    last, before = float(np.std(out[1, -quarter:])), float(np.std(out[1, -2 * quarter : -quarter]))
    quiet = last <= 1e-3 * float(np.abs(out[1]).max())
    motion = "settled"
    if poles:
        motion = (
            f"self-excited: uniform motion is unstable at this feed (stick-slip, {poles} poles in the right half plane)"
        )
    elif (out.shape[1] - 2 * quarter) * dt < end:
        motion = "excited to the end"
    elif not quiet and last > 0.97 * before:
        motion = "self-excited: the motion is not at rest without excitation and does not decay"
    elif not quiet:
        motion = "still decaying"
    if motion.startswith("self-excited"):
        motion += "; a frequency response from this record is not a property of the axis alone"
    window = out[:, -min(round(_WINDOW / dt), out.shape[1]) :]
    slow = float(np.mean((feed + window[3]) * np.sign(feed) < _STANDSTILL * abs(feed)))
    residual = 0.5 * float(np.ptp(window[0]))
    return {"unstable_poles": poles, "residual_m": residual, "standstill_share": slow, "motion": motion}


def step_error(
    drive: Drive,
    friction: FrictionLaw | None,
    excitation: Excitation,
    feed: float,
    duration: float,
    step: float | None = None,
) -> float:
    """Return what the step costs: largest change of the tip's displacement when it is halved, over the largest [1].

    Parameters are those of `simulate_axis`; the default step is `default_step`. The order is four, so the remaining
    error of the halved step is about 1/15 of this.
    """
    law = _friction_of(drive, friction)
    dt = default_step(drive, law, excitation) if step is None else step
    coarse, fine = (
        simulate_axis(drive, friction, excitation, feed, duration, 1.0 / h, h)["displacement"].values[0]
        for h in (dt, 0.5 * dt)
    )
    n = min(coarse.size, fine[::2].size)
    return float(np.abs(coarse[:n] - fine[::2][:n]).max() / np.abs(fine).max())
