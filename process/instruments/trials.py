"""Virtual trials: records of a simulated machine by the instruments of a measuring campaign.

Hammer, inertial actuator, sweep milling, cutting tests, and axes that move under their drives, on a linear modal
machine or on one with drives, guideways and joints, seen by a chain of sensors. Each returns a record; writing files is
left to the measured side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.instruments.actuator import MovingCoil
from process.instruments.sensors import Sensors
from process.labels import AXES, axis_index
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.simulation.excitation import Excitation, HalfSine, SteppedSine, Sum
from process.simulation.machine import simulate_machine
from process.simulation.milling import MillingCut, Spindle, default_step, simulate_forced, simulate_milling
from process.simulation.problem import SampledControl

DEFAULT_SAMPLE_RATE = 2000.0
"""Samples a second [Hz] of a virtual record."""

STEPS_PER_EVENT = 40
"""Integration steps in the shortest event of an excitation, half a sine."""


@dataclass(frozen=True)
class Running:
    """How a machine with drives runs while it is measured; a machine of modes alone only rests.

    Parameters
    ----------
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s].
    controller : str, optional
        Name of the controllers.
    position : float, optional
        Position [m] of the axis that a posture depends on.
    control : SampledControl, optional
        Default: a controller that acts continuously.
    """

    feed: float | Mapping[str, float] = 0.0
    controller: str | None = None
    position: float | None = None
    control: SampledControl | None = None


AT_REST = Running()


def hammer_trial(
    machine: ModalModel | Machine,
    axis: str,
    impulses: Sequence[float],
    sensors: Sensors,
    rng: np.random.Generator,
    pulse_duration: float = 4e-3,
    interval: float = 4.0,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
) -> xr.Dataset:
    """Return one record with several hammer hits along `axis`.

    Parameters
    ----------
    machine : ModalModel or Machine
        The machine.
    axis : {"x", "y", "z"}
        Direction of the hits.
    impulses : sequence of float
        Impulse of each hit [N s]; one record holds them all.
    sensors : Sensors
        Measuring chain.
    rng : numpy.random.Generator
        Seeded by the caller.
    pulse_duration : float, optional
        Contact time of the half-sine pulses [s].
    interval : float, optional
        Time between hits [s].
    sample_rate : float, optional
        Samples a second [Hz].
    running : Running, optional
        Feed, controller, position.
    """
    starts = interval * (0.05 + np.arange(len(impulses)))
    hits = Sum(tuple(HalfSine(float(i), pulse_duration, float(t)) for i, t in zip(impulses, starts, strict=True)))
    return _excited(machine, axis, hits, interval * len(impulses), sensors, rng, sample_rate, running)


def actuator_trial(
    machine: ModalModel | Machine,
    axis: str,
    frequencies: ArrayLike,
    force_amplitude: float,
    sensors: Sensors,
    rng: np.random.Generator,
    dwell: float = 1.5,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
    coil: MovingCoil | None = None,
) -> xr.Dataset:
    """Return the record of a constant-force stepped sine along `axis`.

    Parameters
    ----------
    machine : ModalModel or Machine
        The machine.
    axis : {"x", "y", "z"}
        Direction of the actuator.
    frequencies : array_like, shape (steps,)
        Frequency of each step [Hz].
    force_amplitude : float
        Amplitude of the force [N].
    sensors : Sensors
        Measuring chain.
    rng : numpy.random.Generator
        Seeded by the caller.
    dwell : float, optional
        Time a step [s].
    sample_rate : float, optional
        Samples a second [Hz].
    running : Running, optional
        Feed, controller, position.
    coil : MovingCoil, optional
        The actuator, on the tool: the force is then what is commanded, and the record holds what acts. Default: the
        force acts as it is.
    """
    steps = tuple(float(f) for f in np.atleast_1d(np.asarray(frequencies, dtype=float)))
    sine = SteppedSine(steps, force_amplitude, dwell, start=0.0)
    return shaker_trial(machine, axis, sine, sine.end, sensors, rng, sample_rate, running, coil)


def shaker_trial(
    machine: ModalModel | Machine,
    axis: str,
    excitation: Excitation,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
    coil: MovingCoil | None = None,
) -> xr.Dataset:
    """Return the record of any force along `axis`, at the tool.

    Parameters
    ----------
    machine : ModalModel or Machine
        The machine.
    axis : {"x", "y", "z"}
        Direction of the force.
    excitation : Excitation
        The force; of a coil, what is commanded.
    duration : float
        Of the record [s].
    sensors : Sensors
        Measuring chain.
    rng : numpy.random.Generator
        Seeded by the caller.
    sample_rate : float, optional
        Samples a second [Hz].
    running : Running, optional
        Feed, controller, position.
    coil : MovingCoil, optional
        As of `actuator_trial`.
    """
    if coil is None:
        return _excited(machine, axis, excitation, duration, sensors, rng, sample_rate, running)
    fine = sensors.oversampling
    force = coil.on_floor(excitation)
    true = _simulated(coil.mounted(machine, axis), duration, sample_rate * fine, running, forces={axis: force})
    moved = true["acceleration"].sel(axis=axis).values
    acting = true["force"].copy()
    acting.loc[{"axis": axis}] += coil.reaction(moved, sample_rate * fine)
    return sensors.measure(true.assign(force=acting), rng, axis, fine)


def _excited(
    machine: ModalModel | Machine,
    axis: str,
    excitation: Excitation,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    sample_rate: float,
    running: Running,
) -> xr.Dataset:
    """Return the measured record of a force along one axis at the tool."""
    row = axis_index([axis])[0]
    fine = sensors.oversampling
    if isinstance(machine, Machine):
        true = _simulated(machine, duration, sample_rate * fine, running, forces={axis: excitation})
        return sensors.measure(true, rng, axis, fine)
    _require_rest(running)
    step = min(default_step(machine, None, 0.0), excitation.shortest / STEPS_PER_EVENT)
    inner = max(1, int(np.ceil(1.0 / (sample_rate * fine * step))))
    rate = sample_rate * fine * inner
    time = np.arange(round(duration * sample_rate) * fine * inner) / rate
    force = np.zeros((3, time.size))
    force[row] = excitation.force(time)
    return sensors.measure(simulate_forced(machine, force, rate, inner), rng, axis, fine)


def _simulated(machine: Machine, duration: float, rate: float, running: Running, **loads: Any) -> xr.Dataset:
    return simulate_machine(machine, duration=duration, sample_rate=rate, **vars(running), **loads)


def _require_rest(running: Running) -> None:
    if running != AT_REST:
        raise InputError(
            "a machine of modes alone has no drives: it takes neither feed, controller, position nor sampled control; "
            "give a Machine with axes"
        )


def moving_trial(
    machine: Machine,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    drive_forces: Mapping[str, Excitation] | None = None,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
    commanded: bool = False,
) -> xr.Dataset:
    """Return the record of axes that move under their drives, without a force on the tool.

    With excitation: the open loop of a drive. Without: what the machine does by itself, limit cycles and backgrounds.

    Parameters
    ----------
    machine : Machine
        The machine.
    duration : float
        [s].
    sensors : Sensors
        Measuring chain; there is no force sensor.
    rng : numpy.random.Generator
        Seeded by the caller.
    drive_forces : mapping, optional
        Axis name -> force added to that of its servo.
    sample_rate : float, optional
        Samples a second [Hz].
    running : Running, optional
        Feed, controller, position.
    commanded : bool, optional
        The drive force of the record is what the controllers command, before the dead time, and forces add to it.
    """
    fine = sensors.oversampling
    true = _simulated(machine, duration, sample_rate * fine, running, drive_forces=drive_forces, commanded=commanded)
    return sensors.measure(true, rng, keep=fine)


def silent_trial(
    machine: ModalModel | Machine,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
) -> xr.Dataset:
    """Return the record of a machine that nothing excites: noise, tones, and the limit cycles of its drives.

    Parameters are those of `moving_trial`.
    """
    if isinstance(machine, Machine):
        return moving_trial(machine, duration, sensors, rng, None, sample_rate, running)
    _require_rest(running)
    fine = sensors.oversampling
    nothing = np.zeros((len(AXES), round(duration * sample_rate) * fine))
    return sensors.measure(simulate_forced(machine, nothing, sample_rate * fine), rng, keep=fine)


def milling_trial(
    machine: ModalModel | Machine,
    cut: MillingCut,
    spindle: Spindle,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    lead: float = 0.5,
    tail: float = 2.0,
    sample_rate: float = DEFAULT_SAMPLE_RATE,
    running: Running = AT_REST,
) -> xr.Dataset:
    """Return the record of a cut from air to air, at constant or sweeping speed.

    Parameters
    ----------
    machine : ModalModel or Machine
        The machine.
    cut : MillingCut
        The cut.
    spindle : Spindle
        Its acceleration makes the cut a sweep.
    duration : float
        Time in the cut [s].
    sensors : Sensors
        Measuring chain.
    rng : numpy.random.Generator
        Seeded by the caller.
    lead, tail : float, optional
        Time in air before and after [s]; the tail holds the free decay.
    sample_rate : float, optional
        Samples a second [Hz].
    running : Running, optional
        Feed, controller, position.
    """
    fine = sensors.oversampling
    rate = sample_rate * fine
    if isinstance(machine, ModalModel):
        _require_rest(running)
        return sensors.measure(simulate_milling(machine, cut, spindle, duration, rate, lead, tail), rng, keep=fine)
    loads = {"cut": cut, "spindle": spindle, "lead": lead, "tail": tail}
    true = _simulated(machine, duration, rate, running, **loads)
    return sensors.measure(true, rng, keep=fine)
