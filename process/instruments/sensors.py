"""A measuring chain: sensors, filters, clocks and converters in the order of a real one.

`Sensors` applies its stages (`instruments.stages`), anti-alias filter, clocks, sampling, noise, converters. The mass
of an accelerometer is no stage: it changes the machine (`with_added_mass`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy import signal

from process.errors import InputError
from process.instruments.stages import (
    FINE,
    AntiAlias,
    Clock,
    Converter,
    Drift,
    Grid,
    HammerTip,
    Inertia,
    Noise,
    Resonance,
    Sensitivity,
    Stage,
    Stinger,
    Tone,
    Triple,
)
from process.labels import AXES, axis_index
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.machine.structure import Posture, Structure, free_modes

__all__ = [
    "FINE",
    "AntiAlias",
    "Clock",
    "Converter",
    "Drift",
    "Grid",
    "HammerTip",
    "Inertia",
    "Noise",
    "Resonance",
    "Sensitivity",
    "Sensors",
    "Stage",
    "Stinger",
    "Tone",
    "with_added_mass",
]


@dataclass(frozen=True)
class Sensors:
    """A measuring chain; without arguments a perfect one.

    Parameters
    ----------
    force_noise, acceleration_noise : (float, float, float), optional
        Root mean square of the white noise of each axis in the record [N], [m/s2].
    stages : tuple of Stage, optional
        What sensors do before the sampling, in order: inertia, resonance, sensitivity, drift, tones.
    anti_alias : AntiAlias, optional
        Default: a sharp low-pass without delay.
    clocks : tuple of Clock, optional
        Channels that come late, and recorders of their own.
    digital : tuple of Stage, optional
        After the sampling and the noise, in order: `Noise` with a corner, `Grid`, `Converter`.
    """

    force_noise: Triple = (0.0, 0.0, 0.0)
    acceleration_noise: Triple = (0.0, 0.0, 0.0)
    stages: tuple[Stage, ...] = ()
    anti_alias: AntiAlias | None = None
    clocks: tuple[Clock, ...] = ()
    digital: tuple[Stage, ...] = ()

    @property
    def oversampling(self) -> int:
        """Samples that the chain wants for each one of the record."""
        return FINE if self.stages or self.anti_alias or self.clocks else 1

    def measure(
        self, record: xr.Dataset, rng: np.random.Generator, keep_axis: str | None = None, keep: int = 1
    ) -> xr.Dataset:
        """Return the record of a true motion by the instruments, without its displacement.

        Parameters
        ----------
        record : xarray.Dataset
            True force and acceleration on x, y and z, with whatever else a simulation gives.
        rng : numpy.random.Generator
            Source of noise and random phases.
        keep_axis : str, optional
            The force sensor has this axis only (a hammer, an actuator); the other force axes become NaN.
        keep : int, optional
            Samples of `record` for each of the result.
        """
        out = _on_all_axes(record.drop_vars("displacement", errors="ignore"))
        before = (*self.stages, *((self.anti_alias,) if self.anti_alias else ()), *self.clocks)
        for stage in before:
            out = stage.apply(out, rng)
        out = _sampled(out, keep, filtered=self.anti_alias is not None)
        white = (Noise("force", self.force_noise), Noise("acceleration", self.acceleration_noise))
        for stage in (*white, *self.digital):
            out = stage.apply(out, rng)
        if keep_axis is not None:
            axis_index([keep_axis])
            out = out.assign(force=out["force"].where(out["axis"] == keep_axis).assign_attrs(out["force"].attrs))
        return out


def _on_all_axes(record: xr.Dataset) -> xr.Dataset:
    """Return the record on x, y and z: nothing acts and nothing moves along an axis that the machine has not."""
    if list(record["axis"].values) == list(AXES):
        return record
    return record.reindex(axis=list(AXES)).fillna({"force": 0.0, "acceleration": 0.0})


def _sampled(record: xr.Dataset, keep: int, filtered: bool) -> xr.Dataset:
    """Keep every `keep`-th sample; force and acceleration that no filter has seen are low-passed without delay."""
    if keep == 1:
        return record
    out = record.isel(time=slice(None, None, keep))
    for name in () if filtered else ("force", "acceleration"):
        low = signal.decimate(record[name].values, keep, ftype="fir", axis=-1, zero_phase=True)
        out = out.assign({name: out[name].copy(data=low)})
    return out


# --- the mass of an accelerometer ---------------------------------------------------------------------------


def with_added_mass(machine: Machine | ModalModel, mass: float, directions: Sequence[str] = AXES) -> Machine:
    """Return the machine with a point mass at the tool, such as an accelerometer or the target of a hammer.

    ``M + m T_d^T T_d`` in the coordinates of the structure, so that for one direction
    ``Phi' = Phi + Phi e m w^2 e^T Phi/(1 - m w^2 e^T Phi e)`` (Sherman and Morrison); it is exact for any damping.

    Parameters
    ----------
    machine : Machine or ModalModel
        The bare machine.
    mass : float
        m [kg].
    directions : sequence of str, optional
        Axes in which the mass moves with the tool; all three for one that is fixed to it.
    """
    if not 0.0 <= mass < math.inf:
        raise InputError(f"the added mass is {mass:g} kg; it must be zero or positive")
    rows = axis_index(list(directions))

    def heavier(structure: Structure) -> Structure:
        moved = structure.tool[rows]
        return replace(structure, mass=structure.mass + mass * moved.T @ moved)

    if isinstance(machine, ModalModel):
        modes = free_modes(machine.frequency, machine.damping, machine.mass, machine.direction, {})
        return Machine(heavier(modes))
    structure = machine.structure
    if isinstance(structure, Posture):
        return replace(machine, structure=replace(structure, structures=tuple(map(heavier, structure.structures))))
    return replace(machine, structure=heavier(structure))
