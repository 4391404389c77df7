"""Diagnosis of a mode from its free decays: frequency and damping over the level, against a linear mode.

A linear mode has one frequency and one damping ratio at all levels. What bends them tells its cause: micro-slip lowers
the frequency and raises the damping, the one in proportion to the other (`process.PowerIwan`); a spring that hardens,
and a play, move the frequency alone; dry friction changes the damping alone, with one over the level. Only the level
over that of reference counts, so that displacements, velocities and accelerations serve alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from scipy import special

from process.errors import InputError
from process.machine.jointed_mode import JointedMode
from process.machine.joints import CubicSpring, Gap, ParallelJoints, PowerIwan
from process.types import Real
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values

FLOOR = 0.01
"""Error of the damping ratio, and of the frequency over half the width of the peak, that one mode leaves out [1]."""

BLOCK = math.sqrt(2.0)
"""Largest over smallest level of a condition."""

WIDEST = 1e3
"""Level over that of reference up to which an extrapolated joint does not slip as a whole."""


@dataclass(frozen=True)
class Decay:
    """Frequency and damping of a mode at some levels."""

    level: Real  # amplitude, as measured, shape (n,)
    frequency: Real  # [Hz]
    frequency_std: Real
    damping: Real  # [1]
    damping_std: Real

    @property
    def scale(self) -> Real:
        """Standard deviations of frequencies and damping ratios, one after the other, shape (2 n,)."""
        half_width = self.damping * self.frequency
        return np.concatenate(
            [np.hypot(self.frequency_std, FLOOR * half_width), np.hypot(self.damping_std, FLOOR * self.damping)]
        )

    @property
    def width(self) -> Real:
        """What makes a difference of the size one: half the width of the peak, and the damping, shape (2 n,)."""
        return np.concatenate([self.damping * self.frequency, self.damping])


@dataclass(frozen=True)
class RingDowns(Abilities):
    """A family for `smfe.diagnosis.judgement.diagnose`: a linear mode, and decays of it at several levels."""

    conditions: tuple[Condition, ...]  # of `ring_down_conditions`
    without: Sequence[str] = ()  # ids of causes that are left out of the catalogue
    proposals: tuple[Condition, ...] = ()

    def __post_init__(self) -> None:
        """Refuse conditions of another kind."""
        for c in self.conditions:
            if not isinstance(c.data, Decay):
                raise InputError(f"{c.name}: not a free decay; take conditions of ring_down_conditions")

    @cached_property
    def reference(self) -> float:
        """Level of reference: the geometric mean of all."""
        return float(np.exp(np.mean(np.log(np.concatenate([_decay(c).level for c in self.conditions])))))

    @cached_property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Frequency and damping ratio of the linear mode."""
        f, zeta = (
            float(np.median(np.concatenate(x)))
            for x in zip(*((_decay(c).frequency, _decay(c).damping) for c in self.conditions), strict=True)
        )
        return (
            Parameter("frequency", "Hz", f, zeta * f, 0.5 * f, 2.0 * f),
            Parameter("damping", "%", zeta, 0.1 * zeta, 0.0, 1.0, shown=100.0),
        )

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """What bends frequency and damping over the level."""
        zeta = self.nuisances[1].start
        levels = np.concatenate([_decay(c).level for c in self.conditions]) / self.reference

        def exponent(name: str) -> Parameter:
            return Parameter(name, "1", -0.3, 0.1, -0.95, 1.0, secondary=True)

        def part(name: str, low: float, high: float) -> Parameter:
            return Parameter(name, "%", 0.0, 0.1 * zeta, low, high, shown=100.0)

        gap = Parameter("gap_level", "1", 1.0, 0.1, 0.0, 10.0 * float(levels.max()), secondary=True)
        every = (
            Cause(
                "joint_micro_slip",
                "micro-slip in a joint",
                (part("micro_slip", 0.0, 0.9), exponent("joint_exponent")),
                starts=((zeta, -0.3), (zeta, 0.2), (10.0 * zeta, 0.0)),
            ),
            Cause(
                "joint_micro_slip",
                "micro-slip in a joint",
                (
                    part("also_micro_slip", 0.0, 0.9),
                    exponent("also_joint_exponent"),
                    part("even_micro_slip", 0.0, 0.9),
                ),
                "two laws",
                starts=((2.0 * zeta, -0.7, zeta), (zeta, -0.3, 0.3 * zeta)),
            ),
            Cause("joint_hardening", "a joint that hardens or softens with displacement", (part("cubic", -0.9, 9.0),)),
            Cause(
                "backlash",
                "play in a joint",
                (part("gap_share", 0.0, 0.95), gap),
                starts=tuple((zeta, float(g)) for g in np.geomspace(levels.min(), levels.max(), 4)),
            ),
            Cause("guideway_friction", "dry friction", (part("dry_friction", 0.0, 1.0),)),
        )
        return tuple(c for c in every if c.id not in self.without)

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the mean square of what is missed, over the damping ratio and over half the width of the peak."""
        decay = _decay(condition)
        return float(2.0 * np.mean((misfit * decay.scale / decay.width) ** 2))

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return frequencies and damping ratios at the levels of a condition, whitened like the data."""
        decay = _decay(condition)
        mode, unit = self.mode(values), 1.0 / self.reference
        f, zeta = mode.backbone(decay.level * unit)
        # Dry friction F takes 4 F X a cycle: beside what a joint with a stiffness can say.
        zeta = zeta + values.get("dry_friction", 0.0) / (decay.level * unit)
        return np.concatenate([f, zeta]) / decay.scale

    def mode(self, values: Values, mass: float = 1.0, unit: float = 1.0) -> JointedMode:
        """Return the mode that a set of values comes to, without dry friction.

        Its displacements count from 1 at the level of reference; with `unit`, the displacement [m] there, and its modal
        `mass` [kg] it stands in SI units.
        """
        w = 2.0 * math.pi * values["frequency"]
        stiffness, viscous = mass * w**2, 2.0 * mass * w * values["damping"]
        laws = [
            (values.get("micro_slip", 0.0), values.get("joint_exponent", 0.0)),
            (values.get("also_micro_slip", 0.0), values.get("also_joint_exponent", 0.0)),
            (values.get("even_micro_slip", 0.0), 0.0),
        ]
        joints = [_slipping(lost * stiffness, chi, stiffness, unit) for lost, chi in laws if lost > 0.0]
        if joints:
            beside = stiffness - sum(j.stiffness for j in joints)
            return JointedMode(mass, beside, viscous, joints[0] if len(joints) == 1 else ParallelJoints(tuple(joints)))
        if cubic := values.get("cubic", 0.0):
            return JointedMode(mass, 0.0, viscous, CubicSpring(stiffness, cubic * stiffness / 0.75 / unit**2))
        if gap := values.get("gap_share", 0.0):
            return JointedMode(mass, (1.0 - gap) * stiffness, viscous, Gap(gap * stiffness, values["gap_level"] * unit))
        return JointedMode(mass, 0.0, viscous, CubicSpring(stiffness, 0.0))


def _slipping(lost: float, chi: float, most: float, unit: float) -> PowerIwan:
    """Return a joint that loses a stiffness [N/m] at a displacement `unit` [m], and slips as a whole far from there."""
    # Of R X^(chi + 1) 8 B/(pi (chi + 1)), lost at X, follows K_T = R D^(chi + 1)/(chi + 1) where it slips at D.
    p, far = chi + 1.0, WIDEST
    whole = lost * math.pi / (8.0 * special.beta(p + 1.5, 1.5)) * far**p
    if whole > 0.4 * most:
        far *= (0.4 * most / whole) ** (1.0 / p)
        whole = 0.4 * most
    return PowerIwan(whole, whole * far * unit * p / (p + 1.0), chi)


def ring_down_conditions(decay: xr.Dataset, name: str = "decay", unit: str = "") -> list[Condition]:
    """Return a free decay (`smfe.modes.ring_down.ring_down`) as conditions, one for each factor of 1.4 of the level.

    Parameters
    ----------
    decay : xarray.Dataset
        Amplitude, frequency and damping over time.
    name, unit : str, optional
        Of the record, and of its amplitudes, for people.
    """
    level = decay["amplitude"].values
    block = np.floor(np.log(level.max() / level) / math.log(BLOCK) + 1e-9).astype(int)
    found = []
    for b in np.unique(block):
        rows = np.flatnonzero(block == b)
        data = Decay(
            level[rows],
            *(decay[n].values[rows] for n in ("frequency", "frequency_std", "damping", "damping_std")),
        )
        middle = float(np.exp(np.mean(np.log(data.level))))
        observed = np.concatenate([data.frequency, data.damping]) / data.scale
        words = f"{name} at {middle:.3g} {unit}".strip()
        found.append(Condition(words, {"level": middle}, observed, name, data))
    return found


def _decay(condition: Condition) -> Decay:
    assert isinstance(condition.data, Decay)
    return condition.data
