"""Diagnosis of a machine of several feed axes: one structure under hammer and actuator at rest and in motion.

The modes are those of the machine with its slides held; slides, drives and guideways are shared by all conditions, and
what an idle measurement shows of them and what it does not is said in `smfe.diagnosis.machine.dynamics`. Everything
that a model of modes alone knows is inherited: posture, drift, joints, missing modes, sensors and their tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from process.labels import AXES
from process.types import Complex, Real
from smfe.diagnosis.frf.causes import RESIDUAL
from smfe.diagnosis.frf.modal_dynamics import Changed, Shaken
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import Excited, excited_of
from smfe.diagnosis.inference.problem import Cause, Condition, Parameter, Values
from smfe.diagnosis.machine.axes import DeclaredAxis, nuisances, slide
from smfe.diagnosis.machine.causes import REPEATED, axis_causes
from smfe.diagnosis.machine.dynamics import Slide, moving_compliance, unbounded
from smfe.diagnosis.machine.rules import RULES


@dataclass(frozen=True)
class MachineOfAxes(ModalFrfs):
    """A family for `smfe.diagnosis.judgement.diagnose`: modes that ride on feed axes.

    Settings of a condition besides those of `ModalFrfs`: ``controller`` (name), and the feed of each axis in its data
    (`Excited.feed` [m/s]); an axis without a feed stands.
    """

    axes: Mapping[str, DeclaredAxis] = field(default_factory=dict)  # axis name -> what the campaign says of it
    top: float = math.inf  # modes above it stand for what is not seen of the machine [Hz]
    begin: Mapping[str, float] = field(default_factory=dict)
    """Where nuisances that nobody declared begin, other than at what the modes at rest suggest (SI)."""
    turn: float = RULES.spread["turn"]  # prior standard deviation of the direction of a mode [rad]

    @cached_property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Modes with their directions, their momentum along each axis, and the axes."""
        free = {f"modal_{name}" for name in self.spread if name not in self.stated}
        # What the modes at rest suggest is no statement of anybody, and how large all of them are together a machine of
        # masses and gains tells.
        found = [replace(p, given="") if p.given in free else p for p in super().nuisances if p.name != "scale_error"]
        for r in self._inside:
            for side in "ab":
                turned = Parameter(f"turn_{side}_{r + 1}", "deg", 0.0, 0.02, -1.57, 1.57, self.turn, 180.0 / math.pi)
                found.append(turned)
        for a, row in zip(self.axes, self._momentum, strict=True):
            stated = self.axes[a].coupling is not None
            prior = RULES.momentum_given if stated else RULES.momentum
            found += [
                Parameter(f"momentum_{a}_{r + 1}", "%", float(row[r]), 0.05, -3.0, 3.0, prior, 100.0)
                for r in self._inside
            ]
        found += nuisances(self.axes, self.tolerances)
        size = 1.0 / float(self.model.stiffness.min())
        for name in RESIDUAL:  # modes above the band: there always are some
            low = 0.0 if name[-1] == name[-2] else -size
            found.append(Parameter(name, "um/N", 0.0, 0.01 * size, low, size, RULES.above * size, 1e6))
        return tuple(replace(p, start=float(np.clip(self.begin.get(p.name, p.start), p.low, p.high))) for p in found)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Every candidate but those left out: of axes, of modes and of sensors."""
        own = {p.name for p in self.nuisances}
        modal = [
            replace(c, starts=c.starts[:: RULES.starts_left_out]) if c.id == "missing_mode" else c
            for c in super().causes
            if c.id not in REPEATED and not any(p.name in own for p in c.parameters)
        ]
        every = (*axis_causes(self.axes), *modal)
        return tuple(c for c in every if c.key not in self.without and c.id not in self.without)

    @cached_property
    def _inside(self) -> list[int]:
        """Numbers of the modes within the band."""
        return np.flatnonzero(self.model.frequency <= self.top).tolist()

    @cached_property
    def _momentum(self) -> Real:
        """Momentum of the modes, as `unbounded` has it, where fits begin, shape (axes, modes).

        Where the campaign gives none the mass of a mode is taken to sit at the tool: ``m_r u/|u|^2``.
        """
        m = self.model
        mass, out = m.mass, np.zeros((len(self.axes), m.frequency.size))
        at_tool = m.direction * (mass / np.sum(m.direction**2, axis=1))[:, None]
        for i, (a, axis) in enumerate(self.axes.items()):
            row = at_tool[:, AXES.index(a)] if axis.coupling is None else np.array(axis.coupling)
            out[i] = row / np.sqrt(axis.moving_mass * mass)
        out[:, m.frequency > self.top] = 0.0
        largest = float(np.linalg.eigvalsh(out @ out.T)[-1]) if len(out) else 0.0
        return unbounded(out * min(1.0, math.sqrt(RULES.most_momentum / max(largest, 1e-300))))

    def slides(self, condition: Condition, values: Values) -> tuple[Slide, ...]:
        """Return the slides under the settings of a condition."""
        feed = self._feed(condition)
        name = str(condition.settings.get("controller", ""))
        hit = isinstance(condition.data, Excited) and condition.data.method == "hammer"
        level = excited_of(condition).level if hit else 0.0
        modes = range(1, self.model.frequency.size + 1)
        found = []
        for a, axis in self.axes.items():
            known = name in axis.controllers or not axis.controllers
            only = name if known else next(iter(axis.controllers))
            momentum = tuple([values.get(f"momentum_{a}_{r}", 0.0) for r in modes])
            found.append(slide(AXES.index(a), a, axis, values, momentum, feed.get(a, 0.0), only, level))
        return tuple(found)

    def _feed(self, condition: Condition) -> Mapping[str, float]:
        if isinstance(condition.data, Excited):
            return condition.data.feed
        return {a: float(condition.settings.get(f"feed_{a}", 0.0)) for a in self.axes}

    def compliance(self, machine: Changed, slides: tuple[Slide, ...], frequency: Real, shaken: Shaken) -> Complex:
        """Return the compliance at the tool [m/N], shape (f, 3, 3)."""
        return moving_compliance(machine, slides, frequency, shaken)
