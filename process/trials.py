"""Virtual trials: what the instruments of a measuring campaign would record on a simulated machine.

Hammer, inertial actuator, sweep milling and cutting tests on a linear modal machine, seen by sensors with noise. Each
returns a record; writing files is left to the measured side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.compliance import ModalModel
from process.errors import InputError
from process.labels import AXES
from process.simulate import MillingCut, Spindle, default_step, simulate_forced, simulate_milling

DEFAULT_SAMPLE_RATE = 2000.0
"""Samples a second [Hz] of a virtual record."""


@dataclass(frozen=True)
class Sensors:
    """White measurement noise of force sensor and accelerometer.

    Parameters
    ----------
    force_noise : (float, float, float), optional
        Root mean square of each force channel's noise [N].
    acceleration_noise : (float, float, float), optional
        The same for the accelerations [m/s2].
    """

    force_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def measure(self, record: xr.Dataset, rng: np.random.Generator, keep_axis: str | None = None) -> xr.Dataset:
        """Return what the sensors record of a true motion: noisy force and acceleration, no displacement.

        Parameters
        ----------
        record : xarray.Dataset
            True force and acceleration on x, y and z.
        rng : numpy.random.Generator
            Source of the noise.
        keep_axis : str, optional
            The force sensor has this axis only (a hammer, an actuator); the other force axes become NaN.
        """
        shape = record["force"].shape
        force = record["force"] + np.asarray(self.force_noise)[:, None] * rng.standard_normal(shape)
        motion = record["acceleration"] + np.asarray(self.acceleration_noise)[:, None] * rng.standard_normal(shape)
        if keep_axis is not None:
            force = force.where(force["axis"] == keep_axis)
        out = record.drop_vars("displacement").assign(force=force, acceleration=motion)
        for name in ("force", "acceleration"):
            out[name].attrs = record[name].attrs
        return out


def _axis(axis: str) -> int:
    if axis not in AXES:
        raise InputError(f"axis {axis!r} is none of {', '.join(AXES)}")
    return AXES.index(axis)


def _oversampling(machine: ModalModel, sample_rate: float, shortest: float) -> int:
    """Integration steps a sample: resolve the modes and whatever lasts only `shortest` seconds."""
    step = min(default_step(machine, None, 0.0), shortest / 40.0)
    return max(1, int(np.ceil(1.0 / (sample_rate * step))))


def half_sine(time: NDArray[np.float64], start: float, impulse: float, duration: float) -> NDArray[np.float64]:
    """Return a half-sine pulse [N] of given impulse [N s] and duration [s].

    The peak is ``pi/2 impulse/duration``.
    """
    u = (time - start) / duration
    inside = (u > 0.0) & (u < 1.0)
    return np.where(inside, 0.5 * np.pi * impulse / duration * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)


def hammer_trial(
    machine: ModalModel,
    axis: str,
    impulses: Sequence[float],
    sensors: Sensors,
    rng: np.random.Generator,
    pulse_duration: float = 4e-3,
    interval: float = 4.0,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
) -> xr.Dataset:
    """Return one record with several hammer hits along `axis`.

    Parameters
    ----------
    machine : ModalModel
        The machine.
    axis : {"x", "y", "z"}
        Direction of the hits.
    impulses : sequence of float
        Impulse of each hit [N s]; one record holds them all.
    sensors : Sensors
        Noise.
    rng : numpy.random.Generator
        Seeded by the caller.
    pulse_duration : float, optional
        Contact time of the half-sine pulses [s].
    interval : float, optional
        Time between hits [s].
    sample_rate : float, optional
        Samples a second [Hz].
    """
    keep = _oversampling(machine, sample_rate, pulse_duration)
    rate = sample_rate * keep
    time = np.arange(round(interval * len(impulses) * rate)) / rate
    force = np.zeros((3, time.size))
    for hit, impulse in enumerate(impulses):
        force[_axis(axis)] += half_sine(time, 0.05 * interval + hit * interval, impulse, pulse_duration)
    return sensors.measure(simulate_forced(machine, force, rate, keep), rng, axis)


def stepped_sine(frequencies: ArrayLike, amplitude: float, dwell: float, rate: float) -> NDArray[np.float64]:
    """Return a constant-force stepped sine [N], phase-continuous, `dwell` seconds a step."""
    f = np.repeat(np.asarray(frequencies, dtype=float), round(dwell * rate))
    phase = 2.0 * np.pi * np.cumsum(f) / rate
    return np.asarray(amplitude * np.sin(phase))


def actuator_trial(
    machine: ModalModel,
    axis: str,
    frequencies: ArrayLike,
    force_amplitude: float,
    sensors: Sensors,
    rng: np.random.Generator,
    dwell: float = 1.5,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
) -> xr.Dataset:
    """Return the record of a constant-force stepped sine along `axis`.

    Parameters
    ----------
    machine : ModalModel
        The machine.
    axis : {"x", "y", "z"}
        Direction of the actuator.
    frequencies : array_like, shape (steps,)
        Frequency of each step [Hz].
    force_amplitude : float
        Amplitude of the force [N].
    sensors : Sensors
        Noise.
    rng : numpy.random.Generator
        Seeded by the caller.
    dwell : float, optional
        Time a step [s].
    sample_rate : float, optional
        Samples a second [Hz].
    """
    keep = _oversampling(machine, sample_rate, 1.0 / float(np.max(frequencies)))
    sine = stepped_sine(frequencies, force_amplitude, dwell, sample_rate * keep)
    force = np.zeros((3, sine.size))
    force[_axis(axis)] = sine
    return sensors.measure(simulate_forced(machine, force, sample_rate * keep, keep), rng, axis)


def milling_trial(
    machine: ModalModel,
    cut: MillingCut,
    spindle: Spindle,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    lead: float = 0.5,
    tail: float = 2.0,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
) -> xr.Dataset:
    """Return the record of a cut from air to air, at constant or sweeping speed.

    Parameters
    ----------
    machine : ModalModel
        The machine.
    cut : MillingCut
        The cut.
    spindle : Spindle
        Its acceleration makes the cut a sweep.
    duration : float
        Time in the cut [s].
    sensors : Sensors
        Noise.
    rng : numpy.random.Generator
        Seeded by the caller.
    lead, tail : float, optional
        Time in air before and after [s]; the tail holds the free decay.
    sample_rate : float, optional
        Samples a second [Hz].
    """
    return sensors.measure(simulate_milling(machine, cut, spindle, duration, sample_rate, lead, tail), rng)
