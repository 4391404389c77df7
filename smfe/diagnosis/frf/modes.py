"""Diagnosis of a modal model of the machine: compliances from hits or sines in x, y, z, under many conditions.

The prediction is closed form. The modes take up the changes that a cause makes under the settings of a condition
(`smfe.diagnosis.frf.modal_dynamics`); the sensors come last: gains and signs, exchanged and turned axes, a time skew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.causes import AXES, OF_DECLARED, RESIDUAL, TWICE, modal_causes, pairs, vector
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.further_mode import further_mode
from smfe.diagnosis.frf.modal_dynamics import amplitude, full_compliance, left_out, unchanged
from smfe.diagnosis.frf.modal_slopes import LOOSE, STEP, JointChange, Part, joint_slopes, part_slopes
from smfe.diagnosis.frf.noise import Excited, excited_of, kept
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.frf.workshop import (
    SENSORS,
    SensorSlopes,
    errors_of_condition,
    measured,
    sensor_nuisances,
    sensor_slopes,
    without_own_noise,
)
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values
from smfe.diagnosis.inference.rules import RULES as INFERENCE_RULES

SPREAD: dict[str, float] = {"frequency": 0.02, "damping": 0.3, "stiffness": 0.1}
"""Prior standard deviation of what the baseline says of a mode, relative."""

COMMON = 0.4
"""Prior standard deviation of the stiffness of all modes together, over that of each."""

DAMPING_OVER_PLACE = 0.2
"""Prior standard deviation of the relative change of a mode's damping over the places of a campaign."""

DAMPING_OF_PLACE = 0.25
"""Part of that by which damping at a place may be off the line over all places: guideways are not alike everywhere."""

FILLING = 1.0
"""Prior standard deviation of the compliance of what only fills up a fitted compliance, relative."""

BEYOND = 0.5
"""Standard deviation of the direction of a mode beyond the lines, which stands for what lies beyond it too [rad]."""

LEAST_TURN = 1e-3
"""Prior standard deviation of the direction of a fitted mode where hits and sensors do not lean at all [rad]."""

ACCELEROMETERS = {"laser": 0.0, "two": 2.0}
"""Setting ``sensor`` -> accelerometers that the tool carries; one without it."""

JOINTS = ("joint_micro_slip", "joint_hardening")

FURTHER = "missing_mode/in band"
"""Key of a further mode."""

CHANGING = ("free_mass", "added_mass", "spindle_speed")
"""Settings of a condition that make another machine of it."""

MODE = ("mode_compliance", "mode_frequency", "mode_damping", "mode_azimuth", "mode_elevation")
"""Parameters of a further mode, its size first."""


@dataclass(frozen=True)
class FittedModes:
    """What a fit to a measured compliance knows of the modes of a baseline, which nobody declared then."""

    doubt: Real
    """Standard deviations of each mode, shape (M, 4): relative ones of frequency, damping and stiffness; of the
    direction [rad]."""
    of_band: NDArray[np.bool_]
    """Which are modes of the machine, (M,). The others stand for masses on their mounts, modes above the band, and
    what else a compliance needs to be described."""


@dataclass(frozen=True)
class Standing:
    """Where on the stroke, when in the session and how hard shaken a machine cuts."""

    position: float | None = None  # [m]; None: at the first place
    order: float = 0.0  # 0 first, 1 last in the session
    hardest: bool = False  # shaken as in the hardest measurement; else as in the softest


AS_FIRST = Standing()
"""A machine as it was first measured."""


def either_way(stated: float) -> float:
    """Return the standard deviation, over what was declared, of a positive number that is stated within a relative one.

    Who is 40 % too low declares 0.6 of what is there, which is 67 % more: a share of a positive number is a factor
    either way (log-normal), and two standard deviations up are exp(2 s) - 1.
    """
    return 0.5 * math.expm1(2.0 * stated)


def expected_of(model: ModalModel, excited: Excited, settings: Mapping[str, float | str]) -> Complex:
    """Return about the compliance of some modes, or of a free mass, under the settings of a condition, (f, 3, 3)."""
    if (free := float(settings.get("free_mass", 0.0))) > 0.0:
        return np.asarray(np.eye(3) / -(free * (2.0 * np.pi * excited.frequency[:, None, None]) ** 2), dtype=complex)
    carrying = unchanged(model)._replace(mass=float(settings.get("added_mass", 0.0)))
    return full_compliance(carrying, excited.frequency, Shaken(excited.method, excited.level, 1.0))


@dataclass(frozen=True)
class ModalFrfs(Abilities):
    """A family for `smfe.diagnosis.judgement.diagnose`: a modal machine under many conditions.

    Settings of a condition that count: ``position`` [m]; ``order`` (0 first, 1 last in the session); ``spindle_speed``
    [rad/s]; ``added_mass`` [kg]; ``sensor`` (``"laser"`` weighs nothing and has no axes, ``"two"`` has a second one
    beside it); ``free_mass`` [kg], a mass on soft springs in the machine's place. What is not given is zero.
    """

    model: ModalModel  # the baseline
    conditions: tuple[Condition, ...]  # measured compliances (`smfe.diagnosis.frf.noise.condition_of`)
    proposals: tuple[Condition, ...] = ()  # experiments that could be done next
    without: Sequence[str] = ()  # keys or ids of causes that are left out of the catalogue
    spread: Mapping[str, float] = field(default_factory=lambda: dict(SPREAD))
    """Prior standard deviation of ``frequency``, ``damping``, ``stiffness`` of a mode, relative; default `SPREAD`."""
    stated: Sequence[str] = ()  # those of `spread` that somebody stated; the others are what is usual
    tolerances: Tolerances = field(default_factory=Tolerances)  # of the measurements
    fitted: FittedModes | None = field(default=None, compare=False)  # None: somebody declared the modes
    _at_tool: dict[tuple[Excited, Changed, tuple[Any, ...]], Complex] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _predicted: dict[tuple[object, ...], Real] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse conditions of another kind."""
        for c in self.conditions:
            if not isinstance(c.data, Excited):
                raise InputError(f"{c.name}: not a compliance; a modal model can be held against compliances only")

    @cached_property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Frequency, damping, stiffness of each mode, what they have in common, and what sensors and hits do."""
        found = [p for r in range(self.model.frequency.size) for p in self._of_mode(r)]
        if self.fitted is None:
            spread, said = COMMON * self.spread["stiffness"], "stiffness and mass of all modes"
            stated = "stiffness" in self.stated
            more = (spread, 100.0, "modal_scale", stated, said)
            found.append(Parameter("scale_error", "%", 0.0, 0.01, -0.9, 9.0, *more))
        else:
            # Hits and sensors of the measurement they come from lean as those of every other do.
            least = max(math.hypot(self.tolerances.setup_direction, self.tolerances.mounting_angle), LEAST_TURN)
            turns = [math.hypot(least, self.fitted.doubt[r, 3]) for r in self._own]
            for which in ("turn_a", "turn_b"):
                for name, turn in zip(self._names[which], turns, strict=True):
                    limits = (-0.5 * math.pi, 0.5 * math.pi)
                    found.append(Parameter(name, "deg", 0.0, 0.02, *limits, turn, 180.0 / math.pi))
        if len(self._places) > 1:
            for r, name in zip(self._own, self._names["damping_place"], strict=True):
                more = (DAMPING_OVER_PLACE / self._reach, 100.0, "", True, f"change of the damping of mode {r + 1}")
                found.append(Parameter(name, "%/m", 0.0, 0.05, -0.9 / self._reach, 9.0 / self._reach, *more))
        prior = DAMPING_OF_PLACE * DAMPING_OVER_PLACE
        for names in self._damping_at.values():
            found += [Parameter(name, "%", 0.0, 0.02, -0.5, 0.5, prior, 100.0) for name in names]
        return (*found, *sensor_nuisances(self.tolerances))

    def _of_mode(self, r: int) -> list[Parameter]:
        """Return frequency, damping and stiffness of a mode; of one that only stands for something its compliance.

        What a fit has found nobody declared, so that it cannot be declared wrong; it is as sure as the fit has it.
        What only fills up the one compliance that was fitted took up the errors of its hits as well: of it the order of
        magnitude is known, and other measurements may not show it at all.
        """
        m, found = self.model, list[Parameter]()
        if r not in self._own:
            more = (FILLING, 100.0, "", True, f"compliance of mode {r + 1}")
            return [Parameter(f"filling_{r + 1}", "%", 0.0, 0.05, -0.99, 9.0, *more)]
        doubt = np.zeros(3) if self.fitted is None else self.fitted.doubt[r, :3]
        for (name, unit, start, step, shown), unsure in zip(
            (
                ("frequency", "Hz", m.frequency[r], 0.01, 1.0),
                ("damping", "%", m.damping[r], 0.1, 100.0),
                ("stiffness", "N/um", m.stiffness[r], 0.05, 1e-6),
            ),
            doubt,
            strict=True,
        ):
            spread = either_way(self.spread[name]) if name in self.stated else self.spread[name]
            prior, low, high = math.hypot(spread, unsure) * start, 0.1 * start, 10.0 * start
            said = f"{'natural frequency' if name == 'frequency' else name} of mode {r + 1}"
            given = f"modal_{name}" if self.fitted is None else ""
            more = (prior, shown, given, name in self.stated, said)
            found.append(Parameter(f"{name}_{r + 1}", unit, float(start), step * start, low, high, *more))
        return found

    @cached_property
    def _own(self) -> tuple[int, ...]:
        """Numbers of the modes that what happens to the machine happens to: all that somebody declared.

        Of fitted ones those that are modes of the band and make more than what is material of the largest direct
        compliance along some axis: of others, which are lost in the noise, no data could say what became of them.
        """
        m = self.model
        if self.fitted is None:
            return tuple(range(m.frequency.size))
        ratio = np.concatenate([d.frequency for d in self._data])[:, None] / m.frequency
        each = m.direction**2 / m.stiffness[:, None] / (1.0 - ratio**2 + 2j * m.damping * ratio)[:, :, None]
        whole = np.abs(each.sum(axis=1)).max(axis=0)
        share = (np.abs(each).max(axis=0) / np.maximum(whole, RULES.stiff_axis * whole.max())).max(axis=1)
        share = np.where(self.fitted.of_band, share, 0.0)
        return tuple(np.flatnonzero(share > min(self.tolerances.material, 0.5 * float(share.max()))).tolist())

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Every candidate but those left out."""
        data = self._data
        band = (min(float(d.frequency[0]) for d in data), max(float(d.frequency[-1]) for d in data))
        size = float(np.abs(self.model.matrix(np.linspace(*band, 400))).max())
        numbers = [r + 1 for r in self._own]
        inside = (self.model.frequency >= band[0]) & (self.model.frequency <= band[1])
        aside = {r: self.tolerances.mode_direction if inside[r - 1] else BEYOND for r in numbers}
        every = modal_causes(numbers, band, size, self._reach, len(self._places), aside)
        gone = (*self.without, *(() if self.fitted is None else OF_DECLARED))
        kept = (c for c in every if c.key not in gone and c.id not in gone)
        return tuple(replace(c, begin=self._further) if c.key == FURTHER else self._unsettling(c) for c in kept)

    @cached_property
    def _further(self) -> Values:
        """Values of a mode that nobody declared, as the compliances show it by themselves; none: they show none."""
        plain = [
            (excited_of(c), excited_of(c).compliance_of(np.asarray(c.observed)))
            for c in self.conditions
            if c.observed is not None and not any(float(c.settings.get(n, 0.0)) for n in CHANGING)
        ]
        return {} if self.fitted is not None or not plain else further_mode(self.model, plain[: RULES.further_of])

    def _unsettling(self, cause: Cause) -> Cause:
        """Return a cause with what it makes of fitted modes: hits on a joint that gives way show others than it has.

        Its stiffness changes as a hit dies away, so that one peak is fitted by several modes, softer than at rest; one
        with the joint has one of them for all, and the others stiffer by factors.
        """
        if not self.from_hits or cause.id not in JOINTS:
            return cause
        fitted = ("frequency", "damping", "stiffness", "turn_a", "turn_b")
        return replace(cause, unsettles=frozenset(name for what in fitted for name in self._names[what]))

    @property
    def from_hits(self) -> bool:
        """Whether the modes were fitted to what the machine shows, and nobody declared them."""
        return self.fitted is not None

    @cached_property
    def _every(self) -> tuple[Condition, ...]:
        return (*self.conditions, *self.proposals)

    @cached_property
    def _data(self) -> list[Excited]:
        found = [c.data for c in self._every if isinstance(c.data, Excited)]
        if not found:
            raise InputError("no compliance was given; a modal model has nothing to be held against")
        return found

    @cached_property
    def _fastest(self) -> float:
        """Largest speed of the spindle [rad/s]; 1 where it stands still in all conditions."""
        return max((float(c.settings.get("spindle_speed", 0.0)) for c in self._every), default=0.0) or 1.0

    @cached_property
    def _reference(self) -> float:
        """Amplitude of reference: the middle one of all conditions."""
        plain = unchanged(self.model)
        return float(np.median([amplitude(plain, d.method, d.level, d.band) for d in self._data])) or 1.0

    @cached_property
    def _first_place(self) -> float:
        """Position of the first condition that gives one [m]."""
        return next((float(c.settings["position"]) for c in self._every if "position" in c.settings), 0.0)

    def _place(self, condition: Condition) -> float:
        """Position from that of the first condition that gives one [m]."""
        return float(condition.settings.get("position", self._first_place)) - self._first_place

    @cached_property
    def _places(self) -> set[float]:
        return {self._place(c) for c in self._every}

    @cached_property
    def _reach(self) -> float:
        """Largest distance from the first place [m]; 1 where all are alike."""
        return max(map(abs, self._places), default=0.0) or 1.0

    @property
    def each_counts(self) -> bool:
        """One place or one level may be wrong by itself."""
        return True

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the relative size of a whitened misfit where it limits the depth of cut [1]."""
        excited = excited_of(condition)
        expected = condition.observed
        if expected is None:
            expected = self.predict(condition, {p.name: p.start for p in self.nuisances})
        return excited.squared_size(np.asarray(expected), misfit)

    def with_errors(self) -> Self:
        """Return the family with what belongs to one condition alone among the errors of its data: hits, clock.

        Directions that were not measured are taken from those across them, and else from the baseline.
        """
        found = []
        for c in self._every:
            excited = excited_of(c)
            expected = expected_of(self.model, excited, c.settings)
            full = expected.copy()
            seen = None if c.observed is None else excited.compliance_of(np.asarray(c.observed))
            if seen is not None:
                for n, (response, excitation) in enumerate(excited.entries):
                    r, e = AXES.index(response), AXES.index(excitation)
                    full[:, r, e] = without_own_noise(seen[:, n], excited.std[:, n], expected[:, r, e])
                    if (excitation, response) not in excited.entries:
                        full[:, e, r] = full[:, r, e]
            errors = errors_of_condition(excited, full, self.tolerances)
            known = errors if excited.shared is None else np.concatenate([excited.shared, errors])
            wider = replace(excited, shared=known)
            found.append(replace(c, data=wider, observed=None if seen is None else wider.whitened(seen)))
        count = len(self.conditions)
        return replace(self, conditions=tuple(found[:count]), proposals=tuple(found[count:]))

    @property
    def convicting(self) -> float:
        """Refused causes of machines as declared reached 135, those that mattered had 2600 and more."""
        return INFERENCE_RULES.decisive

    def condition_degrees_of_freedom(self, condition: Condition) -> float:
        """Degrees of freedom with which the noise of a measured compliance is known."""
        return excited_of(condition).degrees_of_freedom

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return the compliance that a set of values predicts, whitened like the data.

        Raises InputError when no machine has these values.
        """
        excited, settings = excited_of(condition), condition.settings
        free, laser = float(settings.get("free_mass", 0.0)), settings.get("sensor") == "laser"
        carried = self._carried(condition, values)
        machine = None if free else self.changed(condition, values)
        slides = self.slides(condition, values)

        def at_tool() -> Complex:
            """Compliance of a free mass on soft springs, or of the machine."""
            if machine is None:
                inverse = -((free + carried) * (2.0 * np.pi * excited.frequency[:, None, None]) ** 2)
                return np.asarray(np.eye(3) / inverse, dtype=complex)
            shaken = self._measured(excited)
            make = partial(self.compliance, machine, slides, excited.frequency, shaken)
            return kept(self._at_tool, (excited, machine, slides), make, RULES.modal_kept)

        def predicted() -> Real:
            phi = measured(at_tool(), excited.frequency, values, accelerometer=not laser)
            rows, columns = ([AXES.index(e[k]) for e in excited.entries] for k in (0, 1))
            return excited.whitened(phi[:, rows, columns])

        key = (excited, machine or free + carried, slides, laser, tuple([values.get(n, 0.0) for n in SENSORS]))
        return kept(self._predicted, key, predicted, RULES.modal_kept)

    def slopes(
        self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]
    ) -> list[Real] | None:
        """Return the derivatives of each condition with parameters, over their scales, in closed form, (n, p).

        None where a joint that is not linear is shaken by a sine.
        """
        sizes = [self.joint_names(which)[0] for which in LOOSE]
        loose = any(values.get(n, 0.0) > 0.0 for n in sizes) or any(p.name in sizes for p in parameters)
        if loose and any(excited_of(c).method != "hammer" and "free_mass" not in c.settings for c in conditions):
            return None
        sensors = sensor_slopes(values, [p.name for p in parameters])
        return [self._condition_slopes(c, values, parameters, sensors) for c in conditions]

    def _condition_slopes(
        self, condition: Condition, values: Values, parameters: Sequence[Parameter], sensors: SensorSlopes
    ) -> Real:
        excited, laser = excited_of(condition), condition.settings.get("sensor") == "laser"
        frequency, names = excited.frequency, [p.name for p in parameters]
        if free := float(condition.settings.get("free_mass", 0.0)):
            carried = free + self._carried(condition, values)
            inverse = -(carried * (2.0 * np.pi * frequency[:, None, None]) ** 2)
            phi = np.asarray(np.eye(3) / inverse, dtype=complex)
            more = np.array([-self._accelerometers(condition) / carried if n == "sensor_mass" else 0.0 for n in names])
            tool = more[:, None, None, None] * phi
        else:
            machine, shaken = self.changed(condition, values), self._measured(excited)
            make = partial(self.compliance, machine, self.slides(condition, values), frequency, shaken)
            phi = kept(self._at_tool, (excited, machine, ()), make, RULES.modal_kept)
            tool = self._tool_slopes(condition, values, names, machine, shaken)
        moved = np.flatnonzero(np.any(tool, axis=(1, 2, 3)))
        seen = np.zeros(tool.shape, dtype=complex)
        seen[moved] = measured(tool[moved], frequency, values, accelerometer=not laser)
        rows, columns = ([AXES.index(e[k]) for e in excited.entries] for k in (0, 1))
        seen += sensors.of(phi, frequency, accelerometer=not laser)
        scale = np.array([p.scale for p in parameters])[:, None]
        return np.asarray((excited.whitened_each(seen[:, :, rows, columns]) * scale).T)

    def _tool_slopes(
        self, condition: Condition, values: Values, names: Sequence[str], machine: Changed, shaken: Shaken
    ) -> Complex:
        """Return the derivatives of the compliance at the tool with some parameters, (p, f, 3, 3)."""
        frequency = excited_of(condition).frequency
        chain = self._chain(condition, values, machine)
        found = [chain.get(n, {}) for n in names]
        parts = list(dict.fromkeys(part for weights in found for part in weights))
        weights = np.array([[w.get(part, 0.0) for part in parts] for w in found]).reshape(len(names), len(parts))
        by_part = part_slopes(machine, frequency, shaken, parts).reshape(len(parts), 9 * frequency.size)
        out = (weights @ by_part.view(np.float64)).view(complex).reshape(len(names), frequency.size, 3, 3)
        changes = {n: c for n, name in enumerate(names) if (c := self._joint_change(name, values)) is not None}
        if changes:
            out[list(changes)] += joint_slopes(machine, frequency, shaken, list(changes.values()))
        for n, name in enumerate(names):
            if name in RESIDUAL:
                unit = tuple(float(name == other) for other in RESIDUAL)
                out[n] += left_out(machine._replace(residual=unit, mode=()), frequency)
            elif name in MODE:
                out[n] += self._mode_slope(machine, frequency, values, name)
        return out

    def _chain(self, condition: Condition, values: Values, machine: Changed) -> dict[str, dict[Part, float]]:
        """Return how the parts of a machine change with each parameter of `changed`."""
        names, place, speed = self._names, self._place(condition), self._speed(condition)
        root = math.sqrt(1.0 + values.get("mass_error", 0.0))
        scale, k = 1.0 + values.get("scale_error", 0.0), machine.stiffness
        direction = np.array(machine.direction).reshape(-1, 3)
        # A mode that is stiffer is the same as one that the tool moves less.
        stiffer: list[dict[Part, float]] = [
            {("direction", r, a): -0.5 * float(direction[r, a]) / k[r] for a in range(3)} for r in range(len(k))
        ]
        found: dict[str, dict[Part, float]] = {}
        for r, (f, z, s) in enumerate(zip(*(names[w] for w in ("frequency", "damping", "stiffness")), strict=True)):
            given = values.get(z, float(self.model.damping[r]))
            found[f] = {("frequency", r, 0): 1.0 / root}
            found[z] = {("damping", r, 0): machine.damping[r] / given}
            found[s] = {part: scale * w for part, w in stiffer[r].items()}
            filled = 1.0 + values.get(names["filling"][r], 0.0)
            found[names["filling"][r]] = {part: -k[r] / filled * w for part, w in stiffer[r].items()}
        found["scale_error"] = {p: w * k[r] / scale for r, each in enumerate(stiffer) for p, w in each.items()}
        found["mass_error"] = {("frequency", r, 0): -0.5 * f / root**2 for r, f in enumerate(machine.frequency)}
        found["mass_error"] |= {("damping", r, 0): -0.5 * z / root**2 for r, z in enumerate(machine.damping)}
        for r, name in zip(self._own, names["damping_place"], strict=True):
            over = 1.0 + place * values.get(name, 0.0)
            found[name] = {("damping", r, 0): machine.damping[r] * place / over if over > 0.01 else 0.0}
        for r, name in zip(self._own, self._damping_at.get(place, ()), strict=False):
            found[name] = {("damping", r, 0): machine.damping[r] / (1.0 + values.get(name, 0.0))}
        for n, r in enumerate(self._own):
            both = names["turn_a"][n], names["turn_b"][n]
            at = np.array([values.get(name, 0.0) for name in both])
            for name, unit in zip(both, np.eye(2), strict=True):
                moved = (self._turned(n, *(at + STEP * unit)) - self._turned(n, *(at - STEP * unit))) / (2.0 * STEP)
                found[name] = {("direction", r, a): float(moved[a]) for a in range(3)}
        own = [(self._own[i], self._own[j]) for i, j in pairs(range(len(self._own)))]
        for what, trend in self._trends(condition, values).items():
            found |= {name: {("spring", r, s): trend} for name, (r, s) in zip(names[what], own, strict=True)}
        bent = [values.get(name, 0.0) for name in names["curved"]]
        found["posture_bend"] = {("spring", r, s): place**2 * x for (r, s), x in zip(own, bent, strict=True)}
        across, natural = [(r, s) for r, s in own if r != s], self.model.frequency
        for b in TWICE:
            for name, (r, s) in zip(names[f"{b}gyroscopic"], across, strict=True):
                found[name] = {("gyroscopic", r, s): speed / math.sqrt(natural[r] * natural[s])}
        found["sensor_mass"] = {("mass", 0, 0): self._accelerometers(condition)}
        return found

    def joint_names(self, which: str) -> tuple[str, ...]:
        """Return the names of the parameters of a joint, its size first."""
        of = dict(zip(LOOSE, (*JOINTS, "joint_iwan"), strict=True))[which]
        return (of, *(("joint_iwan_travel",) if which == "iwan" else ()), *self._names[of])

    def _joint_change(self, name: str, values: Values) -> JointChange | None:
        """Return how a joint changes with a parameter; None where it does not."""
        which = next((w for w in LOOSE if name in self.joint_names(w)), None)
        if which is None:
            return None
        size = self.joint_names(which)[0]
        there, step = values.get(size, 0.0) > 0.0, STEP * max(abs(values[name]), 0.01)
        if not there and name != size:
            return None
        less, more = (
            self._joint(which, {**values, name: values[name] + side * step}) for side in (-1.0 if there else 0.0, 1.0)
        )
        return JointChange(which, less, more, 2.0 * step if there else step)

    def _joint(self, which: str, values: Values) -> tuple[float, ...]:
        """Return a joint as a machine has it; empty for none."""
        size = self.joint_names(which)[0]
        if values.get(size, 0.0) <= 0.0:
            return ()
        if which != "iwan":
            return (values[size], *self._vector(values, size))
        # Rayleigh's law: elements of a share s whose travels go up to D lose s X/(2 D) at an amplitude X.
        travel = values["joint_iwan_travel"]
        return (2.0 * travel * values[size], travel, *self._vector(values, size))

    def _mode_slope(self, machine: Changed, frequency: Real, values: Values, name: str) -> Complex:
        """Return the derivative of the compliance with a parameter of the further mode, (f, 3, 3)."""
        size, none = values.get(MODE[0], 0.0), machine._replace(residual=())
        if name == MODE[0]:
            # It is in proportion to its size.
            unit = self._mode({**values, name: 1.0})
            return left_out(none._replace(mode=unit), frequency)
        if size <= 0.0:
            return np.zeros((frequency.size, 3, 3), dtype=complex)
        step = STEP * max(abs(values[name]), 0.01)
        less, more = (
            left_out(none._replace(mode=self._mode({**values, name: values[name] + side * step})), frequency)
            for side in (-1.0, 1.0)
        )
        return np.asarray((more - less) / (2.0 * step))

    def in_the_cut(
        self,
        values: Values,
        spindle_speed: float,
        frequency: Real,
        feed: float = 0.0,
        controller: str = "",
        standing: Standing = AS_FIRST,
    ) -> Complex:
        """Return the compliance of the machine without a sensor while the spindle turns [m/N], shape (f, 3, 3).

        Spindle speed in rpm, frequency in Hz, feed along x in m/s, which counts where modes ride on slides.
        A joint that slips or hardens counts as at the smallest level measured, or as `standing` says.
        """
        machine, slides = self.as_it_cuts(values, spindle_speed, feed, controller, standing)
        return self.compliance(machine, slides, frequency, self._shaken(self._levels[standing.hardest], frequency))

    def as_it_cuts(
        self,
        values: Values,
        spindle_speed: float,
        feed: float = 0.0,
        controller: str = "",
        standing: Standing = AS_FIRST,
    ) -> tuple[Changed, tuple[Any, ...]]:
        """Return the machine in a cut, and the slides that its modes ride on; see `in_the_cut`."""
        place = self._first_place if standing.position is None else standing.position
        settings: dict[str, float | str] = {"sensor": "laser", "position": place, "order": standing.order}
        settings |= {"spindle_speed": spindle_speed * math.pi / 30.0, "feed_x": feed, "controller": controller}
        cut = Condition("cut", settings)
        return self.changed(cut, values), self.slides(cut, values)

    @cached_property
    def _levels(self) -> tuple[Excited, Excited]:
        """How the machine was shaken least and hardest."""
        plain = unchanged(self.model)
        found = sorted(self._data, key=lambda d: amplitude(plain, d.method, d.level, d.band))
        return found[0], found[-1]

    @cached_property
    def standings(self) -> tuple[Standing, ...]:
        """Where, when and how hard shaken the machine was measured, one thing at a time: it may cut so, too.

        First as it was first measured, then at either end of the stroke, at the end of the session, at the hardest.
        """
        found = [AS_FIRST]
        places = [float(c.settings["position"]) for c in self.conditions if "position" in c.settings]
        if places:
            found += [Standing(position=p) for p in sorted({min(places), max(places)} - {self._first_place})]
        latest = max((float(c.settings.get("order", 0.0)) for c in self.conditions), default=0.0)
        if latest > 0.0:
            found.append(Standing(order=latest))
        if self._levels[0].level != self._levels[1].level:
            found.append(Standing(hardest=True))
        return tuple(found)

    def _measured(self, excited: Excited) -> Shaken:
        """Return how hard a machine was shaken where it was measured: a joint is followed through a hit in time."""
        shaken = self._shaken(excited, excited.frequency)
        if excited.method != "hammer":
            return shaken
        impulses = tuple([excited.impulses.get(a, excited.level) for a in AXES])
        return shaken._replace(impulses=impulses, duration=excited.duration)

    def _shaken(self, excited: Excited, frequency: Real) -> Shaken:
        """Return how hard a machine is shaken, for its compliance at some frequencies [Hz]."""
        power = np.gradient(frequency) / excited.band if excited.band > 0.0 and frequency.size > 1 else None
        return Shaken(excited.method, excited.level, self._reference, power)

    def slides(self, condition: Condition, values: Values) -> tuple[Any, ...]:
        """Return what the modes ride on under the settings of a condition: nothing."""
        return ()

    def compliance(self, machine: Changed, slides: tuple[Any, ...], frequency: Real, shaken: Shaken) -> Complex:
        """Return the compliance at the tool [m/N], shape (f, 3, 3)."""
        return full_compliance(machine, frequency, shaken)

    def fine_frequency(self) -> Real:
        """Return frequencies over all modes [Hz], a quarter of the narrowest width at half power apart.

        Modes below what was measured stand for masses on their mounts.
        """
        lowest = min(float(d.frequency[0]) for d in self._data)
        known = self.model.frequency >= min(lowest, float(self.model.frequency.max()))
        f, damping = self.model.frequency[known], self.model.damping[known]
        low, high = 0.5 * float(f.min()), 2.0 * float(f.max())
        step = max(0.5 * float(np.min(f * damping)), (high - low) / 6000.0)
        return np.arange(low, high, step)

    def _carried(self, condition: Condition, values: Values) -> float:
        """Mass that the tool carries beyond its own [kg]."""
        added = float(condition.settings.get("added_mass", 0.0))
        return added + self._accelerometers(condition) * values.get("sensor_mass", 0.0)

    def _accelerometers(self, condition: Condition) -> float:
        return ACCELEROMETERS.get(str(condition.settings.get("sensor", "")), 1.0)

    def changed(self, condition: Condition, values: Values) -> Changed:
        """Return the machine that a set of values comes to under the settings of a condition."""
        names = self._names
        root, scale = math.sqrt(1.0 + values.get("mass_error", 0.0)), 1.0 + values.get("scale_error", 0.0)
        residual, place = tuple(values.get(n, 0.0) for n in RESIDUAL), self._place(condition)
        frequency, damping, stiffness = (
            [values.get(n, at) for n, at in zip(names[w], getattr(self.model, w).tolist(), strict=True)]
            for w in ("frequency", "damping", "stiffness")
        )
        stiffness = [k / (1.0 + values.get(n, 0.0)) for k, n in zip(stiffness, names["filling"], strict=True)]
        for r, by in zip(self._own, names["damping_place"], strict=True):
            damping[r] *= max(1.0 + place * values.get(by, 0.0), 0.01)
        for r, by in zip(self._own, self._damping_at.get(place, ()), strict=False):
            damping[r] *= 1.0 + values.get(by, 0.0)
        return Changed(
            tuple([f / root for f in frequency]),
            tuple([z / root for z in damping]),
            tuple([k * scale for k in stiffness]),
            self._directions(values),
            self._springs(condition, values),
            self._gyroscopic(condition, values),
            self._carried(condition, values),
            self._joint("slip", values),
            self._joint("hardening", values),
            self._mode(values),
            residual if any(residual) else (),
            self._joint("iwan", values),
        )

    def _mode(self, values: Values) -> tuple[float, ...]:
        """Return the further mode; empty for none."""
        if (size := values.get("mode_compliance", 0.0)) <= 0.0:
            return ()
        # Spherical angles: the elevation first.
        turn, lift, length = values["mode_azimuth"], values["mode_elevation"], math.sqrt(size)
        flat = length * math.cos(lift)
        along = (flat * math.cos(turn), flat * math.sin(turn), length * math.sin(lift))
        return (*along, values["mode_frequency"], values["mode_damping"])

    def _vector(self, values: Values, joint: str) -> tuple[float, ...]:
        """Unit vector of the displacement of a joint, in mode space, (M,)."""
        out = np.zeros(self.model.frequency.size)
        out[list(self._own)] = vector([values[a] for a in self._names[joint]])
        return tuple(out.tolist())

    @cached_property
    def _frames(self) -> Real:
        """The vector of each own mode, and two across it of the same length, shape (own, 3, 3)."""
        frames = []
        for u in self.model.direction[list(self._own)]:
            length, a = float(np.linalg.norm(u)), np.cross(u, np.eye(3)[int(np.argmin(np.abs(u)))])
            a *= length / np.linalg.norm(a)
            frames.append([u, a, np.cross(u, a) / length])
        return np.array(frames)

    def _directions(self, values: Values) -> tuple[float, ...]:
        """Mode vectors, turned as a whole without a change of length."""
        turns = [
            (values.get(a, 0.0), values.get(b, 0.0))
            for a, b in zip(self._names["turn_a"], self._names["turn_b"], strict=True)
        ]
        if not any(p or q for p, q in turns):
            return self._as_given
        out = np.array(self.model.direction, dtype=float)
        for n, (r, (p, q)) in enumerate(zip(self._own, turns, strict=True)):
            out[r] = self._turned(n, p, q)
        return tuple(out.ravel().tolist())

    def _turned(self, n: int, p: float, q: float) -> Real:
        """Return the vector of one of the own modes turned across itself."""
        u, a, b = self._frames[n]
        angle = math.hypot(p, q)
        return np.asarray(math.cos(angle) * u + math.sin(angle) / angle * (p * a + q * b)) if angle > 0.0 else u

    @cached_property
    def _as_given(self) -> tuple[float, ...]:
        return unchanged(self.model).direction

    def _springs(self, condition: Condition, values: Values) -> tuple[float, ...]:
        """Change of the modal stiffnesses with position, order and speed, and by itself, (M^2,); empty for none."""
        upper = self._upper(values, self._trends(condition, values), 0)
        return () if upper is None else tuple((upper + np.triu(upper, 1).T).ravel().tolist())

    def _trends(self, condition: Condition, values: Values) -> dict[str, float]:
        """Return what multiplies each group of springs under the settings of a condition."""
        place, speed = self._place(condition), self._speed(condition)
        trends = {"posture": place, "drift": float(condition.settings.get("order", 0.0))}
        trends |= {f"{b}bearings": speed**2 for b in TWICE} | {"coupling": 1.0}
        return trends | {"curved": place * (1.0 + values.get("posture_bend", 0.0) * place)}

    def _gyroscopic(self, condition: Condition, values: Values) -> tuple[float, ...]:
        """Skew coupling of the modes by the turning spindle [1/Hz], (M^2,); empty for none."""
        upper = self._upper(values, {f"{b}gyroscopic": self._speed(condition) for b in TWICE}, 1)
        root = np.sqrt(self.model.frequency)
        return () if upper is None else tuple(((upper - upper.T) / np.outer(root, root)).ravel().tolist())

    def _speed(self, condition: Condition) -> float:
        """Speed of the spindle over the largest."""
        return float(condition.settings.get("spindle_speed", 0.0)) / self._fastest

    def _upper(self, values: Values, trends: Mapping[str, float], diagonal: int) -> Real | None:
        """Sum of groups of parameters times their trends, in the upper half of a matrix; None for nothing."""
        found = {w: [values.get(n, 0.0) for n in self._names[w]] for w, by in trends.items() if by != 0.0}
        acting = [trends[w] * np.array(x) for w, x in found.items() if any(x)]
        if not acting:
            return None
        out, own = np.zeros((self.model.frequency.size,) * 2), np.array(self._own)
        rows, columns = np.triu_indices(own.size, diagonal)
        out[own[rows], own[columns]] = np.sum(acting, axis=0)
        return out

    @property
    def springs_names(self) -> tuple[str, ...]:
        """Names of the springs between own modes, row by row of the upper half of their matrix."""
        return self._names["coupling"]

    @property
    def count_of_own(self) -> int:
        """How many modes what happens to the machine happens to."""
        return len(self._own)

    @cached_property
    def _damping_at(self) -> dict[float, tuple[str, ...]]:
        """Place other than the first -> names of what the damping of each mode of its own is off there."""
        places = sorted({self._place(c) for c in self.conditions} - {0.0})
        return {p: tuple(f"damping_{r + 1}_at_{n}" for r in self._own) for n, p in enumerate(places, 2)}

    @cached_property
    def _names(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameters of each mode, and of those that fill a matrix, row by row of its upper half.

        What belongs to own modes is there for them alone.
        """
        own = [r + 1 for r in self._own]
        whole = pairs(own)
        across = tuple((r, s) for r, s in whole if r < s)
        names = dict.fromkeys(("posture", "curved", "drift", "coupling", *(f"{b}bearings" for b in TWICE)), whole)
        names |= {f"{b}gyroscopic": across for b in TWICE}
        found = {what: tuple(f"{what}_{r}{s}" for r, s in where) for what, where in names.items()}
        found |= {w: tuple(f"{w}_{r + 1}" for r in range(self.model.frequency.size)) for w in (*self.spread, "filling")}
        found |= {w: tuple(f"{w}_{r}" for r in own) for w in ("turn_a", "turn_b", "damping_place")}
        return found | {w: tuple(f"{w}_angle_{r}" for r in own[:-1]) for w in (*JOINTS, "joint_iwan")}
