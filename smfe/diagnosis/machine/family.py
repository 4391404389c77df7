"""Diagnosis of a machine of several feed axes: one structure under hammer and actuator at rest and in motion.

The modes are those of the machine with its slides held; slides, drives and guideways are shared by all conditions, and
what an idle measurement shows of them and what it does not is said in `smfe.diagnosis.machine.dynamics`. Everything
that a model of modes alone knows is inherited: posture, drift, joints, missing modes, sensors and their tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from process.labels import AXES
from process.types import Complex, Real
from smfe.diagnosis.frf.causes import OF_DECLARED, RESIDUAL
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.joint_in_hits import TIMED
from smfe.diagnosis.frf.modal_dynamics import joints, linear
from smfe.diagnosis.frf.modes import JOINTS, ModalFrfs
from smfe.diagnosis.frf.noise import Excited, excited_of, kept
from smfe.diagnosis.frf.rules import RULES as FRF_RULES
from smfe.diagnosis.frf.workshop import SENSORS, SensorSlopes, measured, sensor_slopes
from smfe.diagnosis.inference.problem import Cause, Condition, Parameter, Values
from smfe.diagnosis.machine.axes import DeclaredAxis, nuisances, slide
from smfe.diagnosis.machine.causes import axis_causes
from smfe.diagnosis.machine.dynamics import (
    Pulled,
    Slide,
    force_in_time,
    momentum_of,
    moving_compliance,
    pulled_by_joints,
    unbounded,
)
from smfe.diagnosis.machine.rules import RULES
from smfe.diagnosis.machine.slopes import (
    MOST,
    STEP,
    Change,
    Machine,
    Parts,
    parts_of_modes,
    slopes,
    springs_of,
)


@dataclass(frozen=True)
class MachineOfAxes(ModalFrfs):
    """A family for `smfe.diagnosis.judgement.diagnose`: modes that ride on feed axes.

    Settings of a condition besides those of `ModalFrfs`: ``controller`` (name), and the feed of each axis in its data
    (`Excited.feed` [m/s]); an axis without a feed stands.
    """

    axes: Mapping[str, DeclaredAxis] = field(default_factory=dict)  # axis name -> what the campaign says of it
    top: float = math.inf  # modes above it stand for what is not seen of the machine [Hz]
    at: Mapping[str, float] = field(default_factory=dict)
    """Where nuisances that nobody declared are expected, other than at what the modes at rest suggest (SI)."""
    first: Mapping[str, float] = field(default_factory=dict)
    """Where the first fit, without any cause, begins other than there, if the data are far from what was given (SI)."""
    with_cause: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Key of a cause -> where fits with it begin (SI)."""
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
        return tuple(replace(p, start=float(np.clip(self.at.get(p.name, p.start), p.low, p.high))) for p in found)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Every candidate but those left out: of axes, of modes and of sensors."""
        own = {p.name for p in self.nuisances}
        modal = [
            replace(c, starts=c.starts[:: RULES.starts_left_out]) if c.id == "missing_mode" else c
            for c in super().causes
            if c.id not in OF_DECLARED
            and not any(p.name in own for p in c.parameters)
            # One stiffness for a whole hit leaves more than noise; elements are followed through it.
            and c.key != "joint_micro_slip"
        ]
        if self._count_of_levels < RULES.levels_of_two_laws:
            modal = [replace(c, law_of="joint") if c.id in JOINTS else c for c in modal]
        feeds = [abs(v) for c in self.conditions for v in self._feed(c).values() if v]
        seen = (*axis_causes(self.axes, min(feeds, default=0.0)), *modal)
        every = [replace(c, begin=self.with_cause.get(c.key, {})) for c in seen]
        # Beside elements that slip what else hits do is no better known than the course of their slipping: of fits with
        # the true joint some put hits 10 mm beside their point.
        hits = frozenset(name for name in own if name.startswith(RULES.of_hits))
        every = [replace(c, unsettles=c.unsettles | hits) if c.id == "joint_micro_slip" else c for c in every]
        return tuple(c for c in every if c.key not in self.without and c.id not in self.without)

    @property
    def from_hits(self) -> bool:
        """Whether the modes are those of a measurement at rest."""
        return not self.stated

    @property
    def bounded_noise(self) -> bool:
        """Hits scatter as thousands of values say, and 1 % of each line and of each column comes on top."""
        return True

    @property
    def supple(self) -> bool:
        """A curve of friction for each axis, modes and gains that are fitted anew look like much else."""
        return True

    @cached_property
    def _count_of_levels(self) -> int:
        """How many levels the machine was hit at."""
        levels = sorted(math.log(abs(excited_of(c).level)) for c in self.conditions if isinstance(c.data, Excited))
        return 1 + sum(b - a > FRF_RULES.same_level for a, b in pairwise(levels)) if levels else 0

    @property
    def begin(self) -> Values:
        """Where the first fit, without any cause, begins."""
        return self.first

    @property
    def begun(self) -> bool:
        """Whether its nuisances begin near their best values (`smfe.diagnosis.machine.settle`)."""
        return bool(self.at)

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
        return tuple(self.slide_of(a, condition, values) for a in self.axes)

    def slide_of(self, a: str, condition: Condition, values: Values) -> Slide:
        """Return the slide of an axis under the settings of a condition."""
        axis, (feed, name, level) = self.axes[a], self.moved(a, condition)
        momentum = tuple([values.get(f"momentum_{a}_{r + 1}", 0.0) for r in range(self.model.frequency.size)])
        return slide(AXES.index(a), a, axis, values, momentum, feed, name, level)

    def moved(self, a: str, condition: Condition) -> tuple[float, str, float]:
        """Return what a slide depends on of a condition: its feed [m/s], its controller, the level of hits [N s]."""
        axis, name = self.axes[a], str(condition.settings.get("controller", ""))
        hit = isinstance(condition.data, Excited) and condition.data.method == "hammer"
        level = excited_of(condition).level if hit else 0.0
        known = name in axis.controllers or not axis.controllers
        return self._feed(condition).get(a, 0.0), name if known else next(iter(axis.controllers)), level

    def _feed(self, condition: Condition) -> Mapping[str, float]:
        if isinstance(condition.data, Excited):
            return condition.data.feed
        return {a: float(condition.settings.get(f"feed_{a}", 0.0)) for a in self.axes}

    def compliance(self, machine: Changed, slides: tuple[Slide, ...], frequency: Real, shaken: Shaken) -> Complex:
        """Return the compliance at the tool [m/N], shape (f, 3, 3)."""
        return moving_compliance(machine, slides, frequency, shaken)

    def slopes(
        self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]
    ) -> list[Real] | None:
        """Return the derivatives of each condition with parameters, over their scales, in closed form, (n, p).

        None where a joint that is not linear is shaken by a sine, or a mass is free.
        """
        loose = any(values.get(name, 0.0) > 0.0 for c in self.causes if c.id in JOINTS for name in _first(c))
        loose = loose or any(p.name in _first(c) for p in parameters for c in self.causes if c.id in JOINTS)
        if any("free_mass" in c.settings or (loose and excited_of(c).method != "hammer") for c in conditions):
            return None
        beside = Beside.of(self, values, parameters)
        found = [self._slopes_of(c, values, parameters, beside) for c in conditions]
        return found if all(np.all(np.isfinite(x)) for x in found) else None

    def _slopes_of(self, condition: Condition, values: Values, parameters: Sequence[Parameter], beside: Beside) -> Real:
        excited = excited_of(condition)
        frequency, accelerometer = excited.frequency, condition.settings.get("sensor") != "laser"
        shaken = self._measured(excited)
        here = Machine(self.changed(condition, values), self.slides(condition, values))
        pulled = pulled_by_joints(here.modes, here.slides, frequency, shaken)
        parts = beside.parts(condition, here, frequency, shaken, pulled)
        changes = beside.changes(condition, here, frequency, shaken)
        phi = self.compliance(here.modes, here.slides, frequency, shaken)
        tool = beside.sensors.of(phi, frequency, accelerometer)
        tool *= np.array([p.scale for p in parameters])[:, None, None, None]
        if changes:
            moved = slopes(parts, list(changes.values()), frequency)
            at_tool = moved[:, :, :3]
            for n, one in enumerate(pulled, 3):
                at_tool -= beside.pull_changes(
                    condition, one, frequency, shaken, list(changes), at_tool, moved[:, :, n]
                )
            tool[list(changes)] = measured(at_tool, frequency, values, accelerometer)
        for j in beside.in_time if shaken.duration > 0.0 else ():
            at_tool = beside.by_joint(condition, here, phi, frequency, shaken, j)
            tool[j] = measured(at_tool[None], frequency, values, accelerometer)[0]
        rows, columns = ([AXES.index(e[k]) for e in excited.entries] for k in (0, 1))
        return excited.whitened_each(tool[:, :, rows, columns]).T


@dataclass(frozen=True)
class Beside:
    """Machines a small step of each parameter beside some values.

    What several conditions have in common is made once: the modes at one place, speed and mass at the tool, the slides
    at one feed under one controller, hit equally hard.
    """

    family: MachineOfAxes
    values: Values
    steps: Sequence[tuple[Parameter, float, float]]  # with the values below and above
    sensors: SensorSlopes
    axes: Mapping[str, frozenset[str]]  # parameter -> axes whose slides it changes
    in_time: frozenset[int]  # parameters of joints that are simulated in time
    made: dict[Hashable, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, family: MachineOfAxes, values: Values, parameters: Sequence[Parameter]) -> Beside:
        """Return them for some values."""
        steps = []
        for p in parameters:
            at, step = values[p.name], STEP * p.scale
            steps.append((p, max(at - step, p.low), min(at + step, p.high)))
        axes: dict[str, frozenset[str]] = {}
        for a, axis in family.axes.items():
            own = [*nuisances({a: axis}, family.tolerances), *(p for c in axis_causes({a: axis}) for p in c.parameters)]
            momentum = [p.name for p in parameters if p.name.startswith(f"momentum_{a}_")]
            for name in (*(p.name for p in own), *momentum):
                axes[name] = axes.get(name, frozenset()) | {a}
        timed = {name for joint in TIMED for name in family.joint_names(joint)}
        in_time = frozenset(j for j, p in enumerate(parameters) if p.name in timed)
        return cls(family, values, steps, sensor_slopes(values, [p.name for p in parameters]), axes, in_time)

    def parts(
        self, condition: Condition, here: Machine, frequency: Real, shaken: Shaken, pulled: Sequence[Pulled] = ()
    ) -> Parts:
        """Return the parts of the machine under a condition, `here`, with joints whose forces pull at its modes."""
        modes, natural = here.modes, here.modes.frequency
        of_lines = frequency.tobytes() if modes.mode else b""
        key = (_like(condition), of_lines)
        steady = kept(self.made, key, lambda: parts_of_modes(modes, here.slides, frequency), MOST)
        momentum = kept(self.made, natural, lambda: momentum_of(natural, here.slides), MOST)
        base = np.array([s.stiffness(2.0 * np.pi * frequency) for s in here.slides]).reshape(-1, len(frequency))
        at = np.zeros((len(natural) + len(here.slides), len(pulled)))
        pull = np.zeros((3, frequency.size, len(pulled)), dtype=complex)
        for n, one in enumerate(pulled):
            at[: len(natural), n], pull[:, :, n] = one.vector, one.force.T
        return Parts._make([springs_of(modes, shaken), *steady, momentum, base, at, pull])

    def changes(self, condition: Condition, here: Machine, frequency: Real, shaken: Shaken) -> dict[int, Change]:
        """Return how the parts of the machine under a condition, `here`, change with each parameter that changes any.

        By the number of the parameter, for a step of its scale.
        """
        found: dict[int, Change] = {}
        moved = {a: self.family.moved(a, condition) for a in self.family.axes}
        for j, (p, low, high) in enumerate(self.steps):
            if p.name in SENSORS or not low < high or (j in self.in_time and shaken.duration > 0.0):
                continue
            if p.name in self.axes:
                change = self._by_slides(condition, here, frequency, j, moved)
            else:
                change = self._by_modes(condition, here, frequency, shaken, j)
            if change is not None:
                found[j] = change
        return found

    def pull_changes(
        self,
        condition: Condition,
        one: Pulled,
        frequency: Real,
        shaken: Shaken,
        which: Sequence[int],
        at_tool: Complex,
        moved: Complex,
    ) -> Complex:
        """Return what a joint that is simulated in time does more, for steps of the scales of some parameters.

        `at_tool` are the changes of the compliance with its force as it is (p, f, 3, 3), `moved` those of its own
        displacement (p, f, 3). Where it is much of what changes it is simulated once more, a little aside.
        """
        force = one.follows() * moved
        out = one.reached[None, :, :, None] * force[:, :, None, :]
        size = np.sqrt(np.sum(np.abs(out) ** 2, axis=(1, 2)))
        whole = np.linalg.norm(at_tool.reshape(len(at_tool), -1), axis=1)
        name = next(n for n in TIMED if getattr(one.machine, n))
        for place, j in enumerate(which):
            axes = tuple(np.flatnonzero(size[place] > RULES.followed * whole[place]).tolist())
            if not axes:
                continue
            values, per = self._aside(j)
            there, slides = self.family.changed(condition, values), self.family.slides(condition, values)
            there = linear(there)._replace(**{name: getattr(there, name)})
            more = force_in_time(there, slides, frequency, shaken, one.machine, axes)
            change = (more - one.force[:, axes]) * per
            out[place][:, :, axes] = one.reached[:, :, None] * change[:, None, :]
        return out

    def by_joint(
        self, condition: Condition, here: Machine, phi: Complex, frequency: Real, shaken: Shaken, j: int
    ) -> Complex:
        """Return the change of the compliance, `phi`, for a step of the scale of a joint that is simulated in time.

        A difference of two simulations on one grid of time, (f, 3, 3).
        """
        values, per = self._aside(j)
        more = self.family.changed(condition, values)
        if more == here.modes:
            return np.zeros_like(phi)
        return np.asarray((moving_compliance(more, here.slides, frequency, shaken, like=here.modes) - phi) * per)

    def _aside(self, j: int) -> tuple[Values, float]:
        """Return the values with a parameter a step above, at its upper bound below, and its scale over the step."""
        p, low, high = self.steps[j]
        at = self.values[p.name]
        end = high if high > at else low
        return {**self.values, p.name: end}, p.scale / (end - at)

    def _by_slides(
        self,
        condition: Condition,
        here: Machine,
        frequency: Real,
        j: int,
        moved: Mapping[str, tuple[float, str, float]],
    ) -> Change | None:
        """Return how the parts change with a parameter of slides; None for not at all."""
        (p, low, high), both = self.steps[j], list[tuple[int, Slide, Slide]]()
        for n, a in enumerate(self.family.axes):
            if a not in self.axes[p.name]:
                continue

            def ends(a: str = a) -> tuple[Slide, ...]:
                return tuple([self.family.slide_of(a, condition, {**self.values, p.name: x}) for x in (low, high)])

            below, above = kept(self.made, (j, a, *moved[a]), ends, MOST)
            if below != above:
                both.append((n, below, above))
        if not both:
            return None
        change: Change = [None] * len(Parts._fields)
        per = p.scale / (high - low)
        if any(s.mass != t.mass or s.momentum != t.momentum for _, s, t in both):

            def momentum() -> Real:
                less, more = list(here.slides), list(here.slides)
                for n, below, above in both:
                    less[n], more[n] = below, above
                natural = here.modes.frequency
                return (momentum_of(natural, more) - momentum_of(natural, less)) * per

            change[7] = kept(self.made, (j, here.modes.frequency), momentum, MOST)
        change[8] = np.zeros((len(here.slides), frequency.size), dtype=complex)
        for n, below, above in both:
            change[8][n] = (above.stiffness(2.0 * np.pi * frequency) - below.stiffness(2.0 * np.pi * frequency)) * per
        return change

    def _by_modes(self, condition: Condition, here: Machine, frequency: Real, shaken: Shaken, j: int) -> Change | None:
        """Return how the parts change with a parameter of modes; None for not at all."""
        (p, low, high), family, like = self.steps[j], self.family, _like(condition)

        def machines() -> tuple[Changed, ...] | None:
            both = tuple([family.changed(condition, {**self.values, p.name: x}) for x in (low, high)])
            return None if both[0] == both[1] else both

        if (pair := kept(self.made, (j, like), machines, MOST)) is None:
            return None

        less, more = pair
        per, natural = p.scale / (high - low), less.frequency != more.frequency

        def steady() -> Change:
            before, after = (parts_of_modes(m, here.slides, frequency) for m in pair)
            found: Change = [
                None if np.array_equal(x, y) else (y - x) * per for x, y in zip(before, after, strict=True)
            ]
            momenta = [momentum_of(m.frequency, here.slides) for m in pair] if natural else []
            return [*found, (momenta[1] - momenta[0]) * per if natural else None]

        def springs() -> Complex | None:
            before, after = (springs_of(m, shaken) for m in pair)
            return None if np.array_equal(before, after) else (after - before) * per

        of_lines = frequency.tobytes() if less.mode or more.mode else b""
        found = kept(self.made, (j, like, of_lines), steady, MOST)
        hit = shaken if joints(less) or joints(more) else None
        return [kept(self.made, (j, like, hit, "springs"), springs, MOST), *found, None]


def _like(condition: Condition) -> tuple[object, ...]:
    """Return what the modes depend on of the settings of a condition."""
    return tuple(condition.settings.get(k) for k in ("position", "order", "spindle_speed", "added_mass", "sensor"))


def _first(cause: Cause) -> tuple[str, ...]:
    """Return the name of the parameter that says how much there is of a joint."""
    return (cause.parameters[0].name,)
