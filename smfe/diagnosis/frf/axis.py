"""Diagnosis of compliances: a model of one axis under hammer and actuator, at every feed, level and controller.

The prediction is made as the measurement is: a hammer hit is a half sine of its impulse and duration that moves the
machine in time, and H1 is taken from that motion; an actuator's sine is balanced at its force level. Sensors come last.
Where a machine is not linear, the mean of some hits is not their mean hit: `as_hit` takes the difference off the data,
and what the differences between the hits explain off their scatter.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from process.errors import InputError
from process.friction.laws import Viscous
from process.harmonic_balance.quasi_frf import quasi_compliance
from process.machine.machine import Machine
from process.machine.operating_point import OperatingPoint
from process.simulation.excitation import Excitation, HalfSine
from process.simulation.machine import RepeatedImpact
from process.simulation.problem import MachineRun
from process.types import Complex, Real
from smfe.diagnosis.frf.axis_baseline import PRESLIDING, AxisBaseline, Effective
from smfe.diagnosis.frf.causes import sensor_causes
from smfe.diagnosis.frf.noise import Excited, Hits, excited_of, kept, scatter_of, smooth_errors
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.frf.workshop import errors_along_axis
from smfe.diagnosis.inference.fit import Target, plausibly, residuals
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values
from smfe.diagnosis.inference.rules import RULES as INFERENCE_RULES

DRY = "guideway_friction"
"""Cause that makes a guideway dry that was declared not to be."""

GIVES_WAY = "presliding"
"""Name of the parameters, but for their number, of how a guideway gives way before it slides."""


@dataclass(frozen=True)
class MachineFrfs(Abilities):
    """A family for `smfe.diagnosis.judgement.diagnose`: compliances of one machine under many conditions."""

    roughness: ClassVar[float] = RULES.roughness
    model_error: ClassVar[float] = RULES.model_error
    prepares_data: ClassVar[bool] = True  # single hits are made to mean hits by a simulation

    baseline: AxisBaseline  # the simulation that is tested
    conditions: tuple[Condition, ...]  # measured compliances (`smfe.diagnosis.frf.noise.condition_of`)
    proposals: tuple[Condition, ...] = ()  # experiments that could be done next
    without: Sequence[str] = ()  # keys of causes that are left out of the catalogue
    measured: tuple[Condition, ...] = ()  # what `conditions` were before `as_hit`
    discrepancy: float = 0.0  # see `as_hit`
    sliding: Values = field(default_factory=dict)
    """Values with friction that the data show by themselves, where a fit may begin (SI); none: they show none."""
    _kept: dict[tuple[object, Effective], Complex] = field(default_factory=dict, repr=False, compare=False)
    _machines: dict[Effective, SimulatedMachine] = field(default_factory=dict, repr=False, compare=False)

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Parameters of the baseline."""
        named = [excited_of(c).controller for c in self.conditions if c.observed is not None]
        used = Counter(n for n in named if n in self.baseline.servos)
        return (*self.baseline.nuisances([str(n) for n, _ in used.most_common()[1:]]), *self.presliding)

    @property
    def presliding(self) -> tuple[Parameter, ...]:
        """How the guideway gives way before it slides, where it is dry or may be found to be: single hits tell it."""
        data = [excited_of(c) for c in self.conditions]
        hit = any(d.hits is not None for d in data)
        if not any(d.presliding is not None for d in data) and not (hit and {c.id for c in self.causes} & {DRY}):
            return ()
        said = "how the guideway gives way before it slides"
        within = [(-1.0, 3.0, 1.0) if way.later > 1.0 else (-0.5, 1.5, 0.5) for way in PRESLIDING]
        return tuple(Parameter(f"{GIVES_WAY}_{n}", "", 0.0, 0.1, *w, said=said) for n, w in enumerate(within))

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Every candidate but those left out."""
        data = [excited_of(c) for c in self.conditions]
        band = (min(float(d.frequency[0]) for d in data), max(float(d.frequency[-1]) for d in data))
        every = (*self.baseline.causes(), *sensor_causes(band, self.baseline.drive.stiffness))
        return tuple(self._begun(c) for c in every if c.key not in self.without and c.id not in self.without)

    def _begun(self, cause: Cause) -> Cause:
        """Return a cause with the friction that the data show at once, where it is that friction."""
        found = {p.name for p in cause.parameters} & {"stribeck_coulomb", "friction_level"} & set(self.sliding)
        return replace(cause, begin=self.sliding) if found else cause

    @property
    def decisive(self) -> float:
        """Of a guideway that is declared to be dry: no law gives way before it slides as the machine does."""
        return INFERENCE_RULES.decisive if "coulomb" in self.baseline.known else 0.0

    @property
    def convicting(self) -> float:
        """Refused causes of axes that were as declared reached 52."""
        return INFERENCE_RULES.decisive

    def condition_degrees_of_freedom(self, condition: Condition) -> float:
        """Degrees of freedom with which the noise of a measured compliance is known."""
        return excited_of(condition).degrees_of_freedom

    @property
    def each_counts(self) -> bool:
        """Friction matters in the conditions in which the axis moves, whatever the others do."""
        return True

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the relative size of a whitened misfit where it limits the depth of cut [1]."""
        expected = condition.observed
        if expected is None:
            expected = self.predict(condition, {p.name: p.start for p in self.nuisances})
        return excited_of(condition).squared_size(np.asarray(expected), misfit)

    def squared_change(self, condition: Condition, before: Values, after: Values, misfit: Real) -> float:
        """Return the square of what hits show of a change, or vibration as small as that which a cut begins with [1].

        A hit takes a slide to and fro, far beyond its feed: it hardly shows the slope of the friction there, which
        alone damps, or feeds, a vibration that is about to grow. That counts by the most negative real part.
        """
        shown, depths = self.squared_size(condition, misfit), [self._least_real(condition, v) for v in (before, after)]
        if min(depths) <= 0.0 or depths[0] == depths[1]:
            return shown
        return max(shown, (max(depths) / min(depths) - 1.0) ** 2)

    def _least_real(self, condition: Condition, values: Values) -> float:
        """Most negative real part for small vibration, without its sign; 0 at rest, and where none stays small."""
        excited, axis = excited_of(condition), self.baseline.axis
        at = self._sliding(condition, values)
        if at is None or at.unstable_poles():
            return 0.0
        n = "xyz".index(axis)
        return float(-at.matrix(excited.frequency)[:, n, n].real.min())

    def _sliding(self, condition: Condition, values: Values, falling: bool = True) -> OperatingPoint | None:
        """Return the axis on its dry guideway as it moves; None at rest, or without dry friction.

        Without `falling` its friction is not less at a higher speed.
        """
        excited, axis = excited_of(condition), self.baseline.axis
        feed = excited.feed.get(axis, 0.0)
        found = self.baseline.under(self.baseline.effective(values, condition.settings, feed), excited.controller)
        if feed == 0.0 or max(side.static for side in found.friction) == 0.0:
            return None
        if not falling:
            forth, back = (side._replace(static=side.coulomb) for side in found.friction)
            found = found._replace(friction=(forth, back))
        return self.baseline.machine(found).at({axis: feed}, excited.controller)

    def sticks_and_slips(self, condition: Condition) -> bool:
        """Whether an axis as it is declared vibrates by itself at a feed, for its friction falls with speed there."""
        declared = {p.name: p.start for p in self.nuisances}
        with_it, without = (self._sliding(condition, declared, falling) for falling in (True, False))
        return bool(with_it and without and with_it.unstable_poles() and not without.unstable_poles())

    def relative(self, condition: Condition, predicted: Real, slopes: Real) -> Complex:
        """Return slopes of a prediction, (n, p), over the prediction itself, each line by itself, (n/2, p)."""
        excited = excited_of(condition)
        return excited.unwhitened(slopes) / excited.unwhitened(predicted[:, None])

    def alike(self, conditions: Sequence[Condition]) -> list[int]:
        """Return a number for each condition, the same for those that a simulation without causes predicts alike."""
        keys: list[tuple[object, float]] = []
        numbers: list[int] = []
        for condition in conditions:
            d = excited_of(condition)
            mass = float(condition.settings.get("added_mass", 0.0))
            how = (d.method, tuple(d.feed.items()), d.controller, mass, d.entries, d.frequency.tobytes())
            level = math.log(abs(d.level))
            found = [n for n, (one, other) in enumerate(keys) if how == one and abs(level - other) < RULES.same_level]
            if not found:
                keys.append((how, level))
            numbers.append(found[0] if found else len(keys) - 1)
        return numbers

    def as_found(self, values: Values) -> tuple[Condition, ...]:
        """Return the conditions as the mean hits on a machine of these values would have found them."""
        if not self.measured:
            return self.conditions
        return as_hit(replace(self, conditions=self.measured), self.discrepancy, values).conditions

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return the compliance that a set of values predicts, whitened like the data."""
        excited = excited_of(condition)
        found = self.baseline.effective(values, condition.settings, excited.feed.get(self.baseline.axis, 0.0))
        found = self.baseline.under(found, excited.controller)
        phi = kept(
            self._kept, (excited.way, found), lambda: self._machine(found).compliance(excited), RULES.predictions_kept
        )
        if excited.presliding is not None:
            share = [values.get(f"{GIVES_WAY}_{n}", 0.0) for n in range(len(excited.presliding))]
            phi = phi + np.tensordot(share, excited.presliding, 1)
        return excited.whitened(_shown(excited, values) * phi + _further_mode(excited, values))

    def closed_form(self, condition: Condition, values: Values, predicted: Real, name: str) -> Real | None:
        """Slopes with what acts on a simulation that is done: gain, skew, and what the guideway does otherwise."""
        excited = excited_of(condition)
        if name.startswith(GIVES_WAY):
            other = np.zeros_like(excited.std) if excited.presliding is None else excited.presliding[int(name[-1])]
            return excited.whitened(_shown(excited, values) * other)
        if name not in ("gain_error", "skew"):
            return None
        phi = excited.compliance_of(predicted) - _further_mode(excited, values)
        if name == "gain_error":
            return excited.whitened(phi / (1.0 + values[name]))
        return excited.whitened(-2j * np.pi * excited.frequency[:, None] * phi)

    def _machine(self, found: Effective) -> SimulatedMachine:
        return kept(self._machines, found, lambda: self.simulated(found), RULES.machines_kept)

    def simulated(self, found: Effective) -> SimulatedMachine:
        """Return the machine for what a set of values comes to, as it is hit by simulation."""
        return SimulatedMachine(self.baseline.machine(found), self.baseline.rate)


def _shown(excited: Excited, values: Values) -> Complex:
    """Return what sensors show of a compliance [1], shape (f, 1)."""
    gain = (1.0 + values.get("gain_error", 0.0)) * (-1.0 if values.get("reversed_force", 0.0) > 0.5 else 1.0)
    return np.asarray(gain * np.exp(-2j * np.pi * excited.frequency * values.get("skew", 0.0))[:, None])


def _further_mode(excited: Excited, values: Values) -> Complex:
    """Compliance of a mode besides those of the axis [m/N], shape (f, entries)."""
    size, ratio = values.get("mode_compliance", 0.0), excited.frequency / values.get("mode_frequency", 1.0)
    mode = size / (1.0 - ratio**2 + 2j * values.get("mode_damping", 1.0) * ratio)
    return np.asarray(mode[:, None] * np.array([r == e for r, e in excited.entries]))


class SimulatedMachine:
    """A machine that is measured by simulation; what is prepared for its hits is kept.

    Raises InputError when the servos are unstable.
    """

    def __init__(self, machine: Machine, rate: float = RULES.rate) -> None:
        self.machine, self.rate = machine, rate
        laws = [axis.friction for axis in machine.axes.values()]
        self._linear = not machine.joints and all(isinstance(law, Viscous) for law in laws)
        self._prepared: dict[tuple[object, ...], RepeatedImpact] = {}
        self._one: dict[tuple[object, ...], tuple[float, Real, float]] = {}  # window, displacement, rate

    def compliance(self, excited: Excited, pull: float = 0.0) -> Complex:
        """Return the compliance that a measurement of this kind finds [m/N], shape (f, entries); `pull` as of `hit`."""
        if excited.method == "hammer":
            pulse = HalfSine(excited.level, excited.duration, 0.0)
            return self.hit(excited, pulse, _spectrum(pulse, excited.frequency.tobytes()), pull)
        columns = tuple(dict.fromkeys(e for _, e in excited.entries))
        feed = {axis: excited.feed.get(axis, 0.0) for axis in self.machine.axes}
        balanced = (self.machine, excited.frequency, excited.level, feed, excited.controller)
        found = quasi_compliance(*balanced, excitation=columns)["compliance"]
        return np.stack([found.sel(response=r, excitation=e).values for r, e in excited.entries], axis=1)

    def hit(self, excited: Excited, pulse: Excitation, force: Complex, pull: float = 0.0) -> Complex:
        """Return H1 of a hit with a pulse and its spectrum [N s], shape (f, entries), once for each excitation.

        `pull` is what the drive pulls already where the axis came to rest [N].
        """
        if self._linear:
            # H1 of a linear machine knows neither pulse nor feed.
            pulse = HalfSine(1.0, RULES.contact_time, 0.0)
            force = _spectrum(pulse, excited.frequency.tobytes())
        out = np.empty((excited.frequency.size, len(excited.entries)), dtype=complex)
        for axis in dict.fromkeys(e for _, e in excited.entries):
            found, rate = self._displacement(axis, excited, pulse, pull)
            for i, (response, excitation) in enumerate(excited.entries):
                if excitation == axis:
                    out[:, i] = _transform(found["xyz".index(response)], excited, rate) / force
        return out

    def _displacement(self, axis: str, excited: Excited, pulse: Excitation, pull: float = 0.0) -> tuple[Real, float]:
        """Return the displacement (3, m) over the window of a hit, until it is at rest, and its samples a second [Hz].

        That of a linear machine is kept over the longest window so far: a shorter one ends earlier.
        """
        if not self._linear:
            impact = self._impact(axis, excited)
            return impact.displacement(pulse, RULES.rest, pull, RULES.held), impact.rate
        key = (axis, excited.controller)
        if key not in self._one or self._one[key][0] < excited.window:
            impact = self._impact(axis, excited)
            self._one[key] = excited.window, impact.displacement(pulse, RULES.rest), impact.rate
        _, found, rate = self._one[key]
        return found[:, : round(excited.window * rate)], rate

    def _impact(self, axis: str, excited: Excited) -> RepeatedImpact:
        """Return the machine prepared for hits."""
        feed = {a: excited.feed.get(a, 0.0) for a in self.machine.axes}
        key = (axis, excited.controller, excited.window, tuple(feed.items()))
        if key not in self._prepared:
            run = MachineRun(excited.window, feed, excited.controller)
            like = next((one for known, one in self._prepared.items() if known[:2] == key[:2]), None)
            # A fit without friction to an axis that sticks comes to machines much stiffer than the one that was given:
            # the rate follows their fastest pole.
            self._prepared[key] = RepeatedImpact(
                self.machine, axis, run, sample_rate=self.rate, accuracy=RULES.accuracy, like=like
            )
        return self._prepared[key]


@lru_cache(maxsize=256)
def _spectrum(pulse: Excitation, frequency: bytes) -> Complex:
    """Fourier transform of a pulse [N s]."""
    fine = np.linspace(0.0, pulse.end, 401)
    turn = np.exp(-2j * np.pi * np.outer(np.frombuffer(frequency, dtype=float), fine))
    return np.asarray(np.trapezoid(pulse.force(fine) * turn, fine, axis=1))


def _transform(x: Real, excited: Excited, rate: float) -> Complex:
    """Fourier transform of a displacement that stays where it ends, as from its acceleration.

    Where it ends before the window next to nothing moves any more: it stays where it is then on average.
    """
    count, w = round(excited.window * rate), 2.0 * np.pi * excited.frequency
    fine, coarse = _turns(excited.frequency.tobytes(), count, rate)
    whole = np.zeros((-(-x.size // RULES.block), RULES.block))
    whole.reshape(-1)[: x.size] = x
    # Blocks first, then what turns from block to block: a matrix of all samples would not fit into a fast memory.
    out = np.sum((fine @ whole.T) * coarse[:, : len(whole)], axis=1) / rate
    stays = x[-1] if x.size >= count else x[-RULES.block :].mean()
    # As a sum, too: beside an integral half a sample of where it stays would be missing.
    return np.asarray(out + stays * np.exp(-1j * w * x.size / rate) / (1.0 - np.exp(-1j * w / rate)) / rate)


@lru_cache(maxsize=128)
def _turns(frequency: bytes, count: int, rate: float) -> tuple[Complex, Complex]:
    """``exp(-j w t)`` of the samples within a block, (f, block), and of the blocks, (f, blocks)."""
    turn = -2j * np.pi * np.frombuffer(frequency, dtype=float)[:, None] / rate
    blocks = RULES.block * np.arange(-(-count // RULES.block))
    return np.exp(turn * np.arange(RULES.block)), np.exp(turn * blocks)


# --- From single hits to the mean hit.


@dataclass(frozen=True)
class Recorded(Excitation):
    """A hit as its force was recorded: samples [N] from the first contact on, `rate` a second."""

    samples: tuple[float, ...]
    rate: float

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s], by a cubic spline."""
        values = np.array([0.0, *self.samples, 0.0])
        inside = (time >= 0.0) & (time <= self.end)
        return np.where(inside, CubicSpline(np.arange(values.size) / self.rate, values)(time), 0.0)

    @property
    def shortest(self) -> float:
        """Mean width of the pulse [s]: its impulse over its peak."""
        return float(abs(sum(self.samples)) / max(map(abs, self.samples)) / self.rate)

    @property
    def end(self) -> float:
        """End of the pulse [s]."""
        return (len(self.samples) + 1) / self.rate


def as_hit(family: MachineFrfs, discrepancy: float, values: Values | None = None) -> MachineFrfs:
    """Return a family whose data are what the mean hit of each condition would have found.

    Every hit is simulated with the force that was recorded, and the mean hit, on the machine of `values` (default: the
    baseline, as far as the data move it plausibly, before and after). Two simulations of one machine may differ
    smoothly by the relative `discrepancy` (rms).
    """
    if values is None:
        left, values = _put_right(family, discrepancy)
        if left > RULES.noise_alone and (other := _other_friction(family)) is not None:
            # What was put right with another friction would show that: it must explain nearly all that is left.
            with_other, found_with = _put_right(family, discrepancy, other)
            declared = "coulomb" in family.baseline.known
            if with_other < (left if declared else RULES.nearly_all * left):
                values = found_with
                family = replace(family, sliding=_with_friction(family, values))
    found = tuple(_of_mean_hit(family, c, values, discrepancy) for c in family.conditions)
    return replace(family, conditions=found, measured=family.conditions, discrepancy=discrepancy)


def _put_right(family: MachineFrfs, discrepancy: float, friction: Values | None = None) -> tuple[float, Values]:
    """Return what plausible values leave of hits that were put right with such values, per value, and these.

    Another `friction` than the baseline's stays as it is: what was put right with it has no say in it, and would lead
    away step by step.

    Of a guideway that sticks the way in which it gives way is found first by hits that were put right without it, which
    moves pulls and forces of friction to where they do its part. So the forces begin as declared, and it is found anew
    from hits that were put right with it, until that explains no more.
    """
    if friction is not None:
        first = friction
    else:
        declared = {f"{force}_error": 0.0 for force in ("coulomb", "static") if force in family.baseline.known}
        first = {**_plausible_values(family)[1], **declared}
    made = as_hit(family, discrepancy, first)
    left, values = _plausible_values(made, friction)
    if all(excited_of(c).presliding is None for c in made.conditions):
        return left, values
    best: tuple[float, Values] = left, first
    for _ in range(RULES.presliding_passes):
        before = values
        left, values = _plausible_values(as_hit(family, discrepancy, before), friction)
        if left >= best[0]:
            break
        best = left, before
    return best


def _plausible_values(
    family: MachineFrfs, known: Values | None = None, causes: Sequence[int] = (), rows: Collection[int] | None = None
) -> tuple[float, Values]:
    """Return what values leave, per value, that data of some `rows` (default: all) move plausibly, and these.

    Of the `known` values those of causes stay, or are where a fit of some `causes` begins. What predicts other rows not
    at all (an unstable servo) leaves infinitely much.
    """
    model = Model(family, family.conditions)
    data = {r: np.asarray(c.observed) for r, c in enumerate(family.conditions) if c.observed is not None}
    target = Target({r: y for r, y in data.items() if rows is None or r in rows}, model.null())
    own = [p.name for c in model.causes for p in c.parameters]
    u = plausibly(model, target, causes, model.scaled({n: v for n, v in (known or {}).items() if n in own}))
    found, count = residuals(model, Target(data, target.centre), u), sum(y.size for y in target.observed.values())
    left = np.inf if found is None else sum(float(found[r] @ found[r]) for r in target.observed) / count
    return left, model.values(u)


def _other_friction(family: MachineFrfs) -> Values | None:
    """Return values with the friction that the hits show; None where nothing shows any.

    Hits in motion find no pull of the drive, but hardly the level of the friction, in which hits at rest let go. That
    is the one with which these leave least, each as it came and with the pull that explains it best: of mean hits that
    were put right with too little friction, pulls have taken the rest.
    """
    name = _other_level(family)
    causes, feeds = family.causes, [excited_of(c).feed.get(family.baseline.axis, 0.0) for c in family.conditions]
    index = next((k for k, c in enumerate(causes) if c.key == name), None)
    moving = [r for r, c in enumerate(family.conditions) if feeds[r] != 0.0 and c.observed is not None]
    still = [c for c, feed in zip(family.conditions, feeds, strict=True) if feed == 0.0 and excited_of(c).hits]
    if index is None or (name.endswith("stribeck") and not (moving and still)):
        return None
    parameters = causes[index].parameters
    begin = [dict(zip((p.name for p in parameters), start, strict=True)) for start in causes[index].starts or ((0.0,),)]
    fits = [_plausible_values(family, start, [index], moving or None) for start in begin]
    least, values = min(fits, key=lambda found: found[0])
    if not still or math.isinf(least):
        return None if math.isinf(least) else values
    level = parameters[0]
    # Feeds that are too near each other tell a slope alone, any rise over a speed in proportion: 530 N were found of 5.
    if any(values[p.name] >= p.high - 1e-6 * p.scale for p in parameters[1:]):
        return None
    tried: dict[float, float] = {}

    def left(force: float) -> float:
        if force not in tried:
            with_it = {**values, level.name: force}
            tried[force] = sum(s.left for c in still for s in _states(family, c, with_it))
        return tried[force]

    ladder = RULES.levels
    if name.endswith("stribeck"):
        ladder = tuple(begin[0][level.name] * x for x in RULES.loads)
    n = int(np.argmin([left(x) for x in ladder]))
    around = ladder[max(n - 1, 0)], ladder[min(n + 1, len(ladder) - 1)]
    known = RULES.level_known * (around[1] - around[0])
    minimize_scalar(left, bounds=around, method="bounded", options={"xatol": known, "maxiter": RULES.pulls})
    best = min(tried, key=lambda x: tried[x])
    # A level within what declared forces may be off is no other friction.
    declared = not name.endswith("stribeck") and abs(best) < 2.0 * family.baseline.tolerances.declared_friction
    return None if declared else {**values, level.name: best}


def _other_level(family: MachineFrfs) -> str:
    """Return the key of the cause that is another friction than the baseline's."""
    return "guideway_friction/" + ("level" if "coulomb" in family.baseline.known else "stribeck")


def _with_friction(family: MachineFrfs, values: Values) -> Values:
    """Return the values of nuisances and of a friction that is not the baseline's."""
    (cause,) = (c for c in family.causes if c.key == _other_level(family))
    return {p.name: values[p.name] for p in (*family.nuisances, *cause.parameters)}


def _states(family: MachineFrfs, condition: Condition, values: Values) -> list[State]:
    """Return the states at rest in which the hits of a condition find what they did."""
    excited = excited_of(condition)
    assert excited.hits is not None
    found = family.baseline.effective(values, condition.settings, 0.0)
    machine, held = family.simulated(found), min(side.static for side in found.friction)
    return [
        at_rest(hit, held, y, excited.std)
        for hit, y in zip(_hits_of(machine, excited), excited.hits.compliance, strict=True)
    ]


def _hits_of(machine: SimulatedMachine, excited: Excited) -> list[Callable[[float], Complex]]:
    """Return for each hit that was recorded what a machine finds of it with a pull of its drive."""
    assert excited.hits is not None
    lines = excited.frequency.tobytes()
    return [partial(machine.hit, excited, p, _spectrum(p, lines)) for p in _pulses(excited.hits)]


def _pulses(hits: Hits) -> list[Recorded]:
    return [Recorded(tuple(f.tolist()), hits.rate) for f in hits.force]


def _of_mean_hit(family: MachineFrfs, condition: Condition, values: Values, discrepancy: float) -> Condition:
    excited = excited_of(condition)
    hits, baseline = excited.hits, family.baseline
    tolerances = baseline.tolerances
    if hits is None:
        if condition.observed is None:
            return condition
        seen = excited.compliance_of(np.asarray(condition.observed))
        errors = errors_along_axis(excited, seen, tolerances)
        wider = replace(excited, shared=errors if excited.shared is None else np.concatenate([excited.shared, errors]))
        return replace(condition, data=wider, observed=wider.whitened(seen))
    feed = excited.feed.get(baseline.axis, 0.0)
    found = baseline.effective(values, condition.settings, feed)
    spectra = [_spectrum(p, excited.frequency.tobytes()) for p in _pulses(hits)]
    weight = np.abs(np.array(spectra)) ** 2
    weight = (weight / weight.sum(axis=0))[:, :, None]
    held = min(side.static for side in found.friction) if feed == 0.0 else 0.0

    hits_of, machine = partial(_hits_of, excited=excited), family.simulated(found)

    def states_of(machine: SimulatedMachine, measured: Complex) -> list[State]:
        return [at_rest(h, held, y, excited.std) for h, y in zip(hits_of(machine), measured, strict=True)]

    presliding, given, states = None, np.zeros_like(hits.compliance), states_of(machine, hits.compliance)
    share = np.array([values.get(f"{GIVES_WAY}_{n}", 0.0) for n in range(len(PRESLIDING))])
    if held > 0.0 and share.any():
        given = np.tensordot(share, _presliding(family, found, excited, states), 1)
        states = states_of(machine, hits.compliance - given)
    if held > 0.0 and sum(s.left for s in states) >= RULES.well * hits.compliance.size:
        bare = hits.compliance - given
        found = found._replace(stiffness=_local_stiffness(family, found, hits_of, held, bare, excited.std))
        machine = family.simulated(found)
        states = states_of(machine, bare)
    if max(side.static for side in found.friction) > 0.0:
        other = _presliding(family, found, excited, states)
        presliding, given = np.sum(weight * other, axis=1), np.tensordot(share, other, 1)
    each = np.stack([s.compliance for s in states])
    more = (weight * each).sum(axis=0) - machine.compliance(excited)
    mean, unexplained = (weight * hits.compliance).sum(axis=0), hits.compliance - each - given
    own = np.stack([scatter_of(x, hits.impulse)[1] for x in np.moveaxis(unexplained, 2, 0)], axis=2)
    smooth = smooth_errors(excited.frequency, mean, discrepancy)
    errors = errors_along_axis(excited, mean, tolerances)
    rows = [own, smooth, errors, RULES.unsure * more[None]]
    rows += [w[None] * s.unsure for w, s in zip(weight, states, strict=True) if s.unsure is not None]
    if held > 0.0:
        # A friction that differs between the directions does at rest what a pull does that all hits found.
        alike = (machine.compliance(excited, sign * RULES.pull * held) for sign in (1.0, -1.0))
        rows += [x[None] - machine.compliance(excited)[None] for x in alike]
        # It lets go sooner where hits before have shaken it loose.
        part = 1.0 - RULES.shaken_loose
        forth, back = (s._replace(coulomb=part * s.coulomb, static=part * s.static) for s in found.friction)
        loose = family.simulated(found._replace(friction=(forth, back))).compliance(excited)
        rows.append(loose[None] - machine.compliance(excited)[None])
    corrected = replace(excited, shared=np.concatenate(rows), presliding=presliding)
    return replace(condition, data=corrected, observed=corrected.whitened(mean - more))


def _presliding(family: MachineFrfs, found: Effective, excited: Excited, states: Sequence[State]) -> Complex:
    """Return what hits find with other ways of giving way before sliding [m/N], shape (ways, hits, f, entries).

    No law does what guideways do there. What elements do is told from a bristle, and what lags from the same elements
    without. Elements with which a hit cannot be simulated, or what they are told from, add nothing to it.
    """
    baseline, made, bristle = family.baseline, [], np.stack([state.compliance for state in states])
    for way in PRESLIDING:
        machine = SimulatedMachine(baseline.machine(found, way), baseline.rate)
        each = np.full_like(bristle, np.nan)
        for n, (hit, state) in enumerate(zip(_hits_of(machine, excited), states, strict=True)):
            with suppress(InputError):
                each[n] = hit(state.pull)
        made.append(each)
    prompt = made[PRESLIDING.index(PRESLIDING[-1]._replace(later=1.0))]
    more = np.stack([x - (prompt if way.later > 1.0 else bristle) for x, way in zip(made, PRESLIDING, strict=True)])
    return np.where(np.isnan(more), 0.0, more)


def _local_stiffness(
    family: MachineFrfs,
    found: Effective,
    hits_of: Callable[[SimulatedMachine], list[Callable[[float], Complex]]],
    held: float,
    measured: Complex,
    std: Real,
) -> float:
    """Return the stiffness [N/m] with which hits at rest find what was measured, pulled by any force that is held.

    What changes the stiffness of one place or hour alone must not be taken for a state at rest: a stiffness 15 % less
    was explained by pulls at their limits, and what they did was taken off the data.
    """

    def left(times: float) -> float:
        every = hits_of(family.simulated(found._replace(stiffness=times * found.stiffness)))
        return sum(
            min(float(np.sum(np.abs((hit(p * held) - y) / std) ** 2)) for p in RULES.pulls_roughly)
            for hit, y in zip(every, measured, strict=True)
        )

    tried = {float(x): left(float(x)) for x in (1.0, *RULES.stiffnesses)}
    for apart in (0.05, 0.025, 0.0125):
        best = min(tried, key=lambda x: tried[x])
        tried |= {x: left(x) for x in (best - apart, best + apart)}
    return min(tried, key=lambda x: tried[x]) * found.stiffness


class State(NamedTuple):
    """An axis at rest as a hit found it."""

    pull: float  # of its drive, which the guideway holds [N]
    compliance: Complex  # that the hit finds [m/N], shape (f, entries)
    left: float  # squares over the noise of a line that it leaves of what was measured
    unsure: Complex | None  # what it changes by as far as the pull is not known, shape (1, f, entries); None: no pull


def at_rest(hit: Callable[[float], Complex], held: float, measured: Complex, std: Real) -> State:
    """Return the state at rest in which a hit finds what was measured, of a guideway that holds a force [N].

    The integrator of a servo at rest winds up until the slide breaks away, again and again: where a hit comes, the
    drive pulls with anything up to the static friction, either way. Each hit that breaks the guideway away tells how
    much it was; what the machine of the data has otherwise must not be taken for that, so that how far the pull is
    known counts as a part of all that it may be.
    """

    def seen(pull: float) -> tuple[float, Complex]:
        at = hit(pull)
        return float(np.sum(np.abs((at - measured) / std) ** 2)), at

    if held <= 0.0:
        left, at = seen(0.0)
        return State(0.0, at, left, None)
    # Most hits come shortly before the slide breaks away or after it: there they tell most, and lie closest.
    pulls = held * np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, RULES.pulls))
    tried = {float(p): seen(float(p)) for p in pulls}
    n = int(np.argmin([left for left, _ in tried.values()]))
    around = (float(pulls[max(n - 1, 0)]), float(pulls[min(n + 1, pulls.size - 1)]))

    def left_by(pull: float) -> float:
        tried[float(pull)] = seen(float(pull))
        return tried[float(pull)][0]

    minimize_scalar(
        left_by, bounds=around, method="bounded", options={"xatol": RULES.pull_known * held, "maxiter": RULES.pulls}
    )
    pull = min(tried, key=lambda p: tried[p][0])
    left, at = tried[pull]
    low, high = (float(np.clip(pull + x * RULES.pull_known * held, -held, held)) for x in (-2.0, 2.0))
    by_pull = (seen(high)[1] - seen(low)[1]) / (high - low)
    return State(pull, at, left, RULES.pull * held * by_pull[None])
