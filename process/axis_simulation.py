"""Time simulation of one feed axis: `process.machine_simulation` for a `Drive`, a friction law, a force on the tip."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr

from process.drive import Drive
from process.errors import InputError
from process.excitation import Excitation as Excitation
from process.excitation import HalfSine as HalfSine
from process.excitation import SteppedSine as SteppedSine
from process.friction import FrictionLaw, MemoryLaw, Viscous
from process.machine import FeedAxis, Machine
from process.machine_simulation import simulate_machine
from process.machine_simulation import step_error as machine_step_error
from process.structure import two_mass_axes


def as_machine(drive: Drive, friction: FrictionLaw | MemoryLaw | None = None, axis: str = "x") -> Machine:
    """Return the machine of one axis that a drive is; its own sigma is the friction where no law is given.

    Raises
    ------
    InputError
        When the drive has a sigma and a law is given too.
    """
    if friction is None:
        friction = Viscous(drive.sigma)
    elif drive.sigma != 0.0:
        raise InputError(
            f"the drive has sigma {drive.sigma:g} N s/m and a friction law is given: friction would count twice; "
            "put the viscous part into the law and leave sigma 0"
        )
    return Machine(two_mass_axes({axis: replace(drive, sigma=0.0)}), {axis: FeedAxis(drive.servo, friction)})


def simulate_axis(
    drive: Drive,
    friction: FrictionLaw | MemoryLaw | None,
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
    friction : FrictionLaw, MemoryLaw or None
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
        Largest integration step [s]; default that of `simulate_machine`.
    axis : {"x", "y", "z"}, optional
        Name of the axis.

    Returns
    -------
    xarray.Dataset
        That of `process.machine_simulation.simulate_machine`, of this axis alone.
    """
    machine = as_machine(drive, friction, axis)
    return simulate_machine(
        machine, duration=duration, feed=feed, forces={axis: excitation}, sample_rate=sample_rate, step=step
    )


def step_error(
    drive: Drive,
    friction: FrictionLaw | MemoryLaw | None,
    excitation: Excitation,
    feed: float,
    duration: float,
    step: float | None = None,
) -> float:
    """Return `process.machine_simulation.step_error` of an axis; parameters are those of `simulate_axis`."""
    machine = as_machine(drive, friction)
    return machine_step_error(machine, duration=duration, feed=feed, forces={"x": excitation}, step=step)
