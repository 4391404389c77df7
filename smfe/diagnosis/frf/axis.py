"""Diagnosis of compliances: a baseline machine under hammer and actuator, at every feed, level and controller.

The prediction goes through what the measurement goes through: a hammer hit is a half sine of its impulse and duration
that moves the machine in time, and H1 is taken from that motion; an actuator's sine is balanced at its force level.
Sensors come last. Where a machine is not linear, some hits together do not find what their mean finds: `as_hit` takes
the difference off the data, and what the differences between the hits explain off their scatter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from process.harmonic_balance.quasi_frf import quasi_compliance
from process.machine.machine import Machine
from process.simulation.excitation import Excitation, HalfSine
from process.simulation.machine import Struck
from process.types import Complex, Real
from smfe.diagnosis.frf.axis_baseline import Effective
from smfe.diagnosis.frf.noise import Excited, scatter_of, smooth_errors
from smfe.diagnosis.frf.noise import condition_of as condition_of
from smfe.diagnosis.frf.noise import excitation_of as excitation_of
from smfe.diagnosis.inference.fit import Target, roughly
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values

_RATE = 2000.0  # samples and steps a second of a simulated hit
_ACCURACY = 1e-4  # of friction in a step; with 5e-4 some hits that break the guideway away jump with the parameters
_REST = 1e-7  # of a machine after a hit, next to its largest: a tenth of what the step costs in a hit of 25 N
_SAME_LEVEL = 0.2  # relative difference of levels of hits that are meant to be the same
_KEPT = 20000
_MACHINES = 200

UNSURE = 0.5
"""Share of what the mean of the hits finds more than the mean hit, that is uncertain because the baseline is."""


class Baseline(Protocol):
    """A simulation that can be questioned."""

    @property
    def axis(self) -> str:
        """Name of the axis."""

    def nuisances(self) -> tuple[Parameter, ...]:
        """Parameters that every hypothesis fits anew."""

    def causes(self) -> tuple[Cause, ...]:
        """What the baseline may lack."""

    def effective(self, values: Values, settings: Mapping[str, float | str], feed: float) -> Effective:
        """Return what a set of values comes to under the settings of a condition."""

    def machine(self, found: Effective) -> Machine:
        """Build the machine for what a set of values comes to."""


SENSOR_CAUSES: tuple[Cause, ...] = (
    Cause(
        "sensor_gain",
        "gain of a sensor",
        (Parameter("gain_error", "%", 0.0, 0.02, -0.9, 9.0, shown=100.0),),
        kind="measurement",
    ),
    Cause(
        "time_skew",
        "time skew between force and motion",
        (Parameter("skew", "us", 0.0, 2e-5, -2e-3, 2e-3, shown=1e6),),
        kind="measurement",
    ),
)


def missing_mode(band: tuple[float, float], count: int = 6) -> Cause:
    """Return the cause of a mode that the baseline does not have, searched for all over a band [Hz]."""
    low, high = band
    middle = tuple(float(v) for v in np.geomspace(low * 1.05, high * 0.95, count))
    return Cause(
        "missing_mode",
        "a mode that the model does not have",
        (
            Parameter("mode_compliance", "um/N", 0.0, 1e-8, 0.0, 1e-4, shown=1e6),
            Parameter("mode_frequency", "Hz", float(np.sqrt(low * high)), 0.02 * high, 0.7 * low, 1.5 * high),
            Parameter("mode_damping", "%", 0.03, 0.01, 0.002, 0.3, shown=100.0),
        ),
        starts=tuple((2e-8, f, 0.03) for f in middle),
    )


@dataclass(frozen=True)
class MachineFrfs(Abilities):
    """A family for `smfe.diagnosis.inference.diagnose`: compliances of one machine under many conditions.

    Parameters
    ----------
    baseline : Baseline
        The simulation that is questioned.
    conditions : tuple of Condition
        Measured compliances (`condition_of`).
    proposals : tuple of Condition, optional
        Experiments that could be done next.
    without : sequence of str, optional
        Keys of causes that are left out of the catalogue.
    measured : tuple of Condition, optional
        What `conditions` were before `as_hit`.
    discrepancy : float, optional
        See `as_hit`.
    model_error : float, optional
        Relative error of the predictions that looks like a change of the parameters, root mean square over all lines;
        the intervals allow for it. Between single hits in motion in two simulations of one machine 0.1 to 0.2 % were
        measured, half of it because one takes a sampled servo for a continuous one.
    """

    baseline: Baseline
    conditions: tuple[Condition, ...]
    proposals: tuple[Condition, ...] = ()
    without: Sequence[str] = ()
    measured: tuple[Condition, ...] = ()
    discrepancy: float = 0.0
    model_error: float = 0.002
    _kept: dict[tuple[object, Effective], Complex] = field(default_factory=dict, repr=False, compare=False)
    _machines: dict[Effective, Machine] = field(default_factory=dict, repr=False, compare=False)

    def condition_degrees_of_freedom(self, condition: Condition) -> float:
        """Degrees of freedom with which the noise of a measured compliance is known."""
        return condition.data.noise_freedom if isinstance(condition.data, Excited) else math.inf

    @property
    def roughness(self) -> float:
        """How far predictions are off a smooth function of the parameters: root of the sum of squares, in noise.

        Measured on a hit of 400 N that breaks the guideway away at rest: 1; it stays with ten times the accuracy.
        """
        return 1.0

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Parameters of the baseline."""
        return self.baseline.nuisances()

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Every candidate but those left out."""
        data = [c.data for c in self.conditions if isinstance(c.data, Excited)]
        band = (min(float(d.frequency[0]) for d in data), max(float(d.frequency[-1]) for d in data))
        every = (*self.baseline.causes(), *SENSOR_CAUSES, missing_mode(band))
        return tuple(c for c in every if c.key not in self.without and c.id not in self.without)

    def relative(self, condition: Condition, predicted: Real, slopes: Real) -> Complex:
        """Return slopes of a prediction, (n, p), over the prediction itself, each line by itself, (n/2, p)."""
        assert isinstance(condition.data, Excited)
        return condition.data.unwhitened(slopes) / condition.data.unwhitened(predicted[:, None])

    def alike(self, conditions: Sequence[Condition]) -> list[int]:
        """Return a number for each condition, the same for those that a simulation without causes cannot tell apart."""
        keys: list[tuple[object, float]] = []
        numbers: list[int] = []
        for condition in conditions:
            d = condition.data
            assert isinstance(d, Excited)
            mass = float(condition.settings.get("added_mass", 0.0))
            how = (d.method, tuple(d.feed.items()), d.controller, mass, d.entries, d.frequency.tobytes())
            level = math.log(abs(d.level))
            found = [n for n, (one, other) in enumerate(keys) if how == one and abs(level - other) < _SAME_LEVEL]
            if not found:
                keys.append((how, level))
            numbers.append(found[0] if found else len(keys) - 1)
        return numbers

    def _machine(self, found: Effective) -> Machine:
        """Build a machine once: what is made ready for a hit is found by it."""
        machine = self._machines.get(found)
        if machine is None:
            if len(self._machines) >= _MACHINES:
                self._machines.clear()
            machine = self._machines[found] = self.baseline.machine(found)
        return machine

    @property
    def prepares_data(self) -> bool:
        """Single hits are made to mean hits by a simulation."""
        return True

    def as_found(self, values: Values) -> tuple[Condition, ...]:
        """Return the conditions as the mean hits on a machine of these values would have found them."""
        if not self.measured:
            return self.conditions
        return as_hit(replace(self, conditions=self.measured), self.discrepancy, values).conditions

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return the compliance that a set of values predicts, whitened like the data."""
        excited = condition.data
        assert isinstance(excited, Excited)
        found = self.baseline.effective(values, condition.settings, excited.feed.get(self.baseline.axis, 0.0))
        key = (excited.way, found)
        phi = self._kept.get(key)
        if phi is None:
            phi = compliance_under(self._machine(found), excited)
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            self._kept[key] = phi
        return excited.whitened(_through_sensors(phi, excited.frequency, excited.entries, values))


def _through_sensors(phi: Complex, f: Real, entries: Sequence[tuple[str, str]], values: Values) -> Complex:
    phi = phi * (1.0 + values.get("gain_error", 0.0)) * np.exp(-2j * np.pi * f * values.get("skew", 0.0))[:, None]
    size = values.get("mode_compliance", 0.0)
    if size > 0.0:
        ratio = f / values["mode_frequency"]
        mode = size / (1.0 - ratio**2 + 2j * values["mode_damping"] * ratio)
        phi = phi + mode[:, None] * np.array([r == e for r, e in entries])
    return phi


def compliance_under(machine: Machine, excited: Excited) -> Complex:
    """Return what a measurement of this kind finds on a machine [m/N], shape (f, entries).

    Raises
    ------
    InputError
        When the servos are unstable.
    """
    feed = {axis: excited.feed.get(axis, 0.0) for axis in machine.axes}
    if excited.method == "actuator":
        columns = tuple(dict.fromkeys(e for _, e in excited.entries))
        found = quasi_compliance(
            machine, excited.frequency, excited.level, feed, excited.controller, excitation=columns
        )["compliance"]
        return np.stack([found.sel(response=r, excitation=e).values for r, e in excited.entries], axis=1)
    return _hit(machine, excited, feed)


def _hit(machine: Machine, excited: Excited, feed: Mapping[str, float]) -> Complex:
    """H1 of the mean hit."""
    pulse = HalfSine(excited.level, excited.duration, 0.0)
    return _struck(machine, excited, feed, pulse, _spectrum(pulse, excited.frequency.tobytes()))


def _struck(
    machine: Machine, excited: Excited, feed: Mapping[str, float], pulse: Excitation, force: Complex
) -> Complex:
    """H1 of a hit with a pulse and its spectrum [N s], once for each excitation."""
    out = np.empty((excited.frequency.size, len(excited.entries)), dtype=complex)
    for axis in dict.fromkeys(e for _, e in excited.entries):
        ready = _made_ready(_One(machine), axis, excited.window, tuple(feed.items()), excited.controller)
        found = ready.displacement(pulse, _REST)
        for i, (response, excitation) in enumerate(excited.entries):
            if excitation == axis:
                out[:, i] = _transform(found["xyz".index(response)], excited) / force
    return out


class _One:
    """A machine that is like no other."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine

    def __hash__(self) -> int:
        return id(self.machine)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _One) and self.machine is other.machine


@lru_cache(maxsize=_MACHINES)
def _made_ready(
    one: _One, axis: str, window: float, feed: tuple[tuple[str, float], ...], controller: str | None
) -> Struck:
    return Struck(
        one.machine,
        axis,
        duration=window,
        feed=dict(feed),
        controller=controller,
        sample_rate=_RATE,
        accuracy=_ACCURACY,
    )


@lru_cache(maxsize=256)
def _spectrum(pulse: Excitation, frequency: bytes) -> Complex:
    return _spectrum_of(pulse, np.frombuffer(frequency, dtype=float))


def _spectrum_of(pulse: Excitation, frequency: Real) -> Complex:
    """Fourier transform of a pulse [N s]."""
    fine = np.linspace(0.0, pulse.end, 401)
    return np.asarray(np.trapezoid(pulse.force(fine) * np.exp(-2j * np.pi * np.outer(frequency, fine)), fine, axis=1))


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

    Every hit is simulated with the force that was recorded, and the mean hit.

    Parameters
    ----------
    family : MachineFrfs
        Conditions whose `Excited` has its hits.
    discrepancy : float
        Root mean square of the smooth relative error that two simulations of one machine may differ by.
    values : mapping, optional
        Of the machine that is simulated; default the baseline, roughly fitted.
    """
    if values is None:
        values = _rough_baseline(family)
    told = [_told(family, c, values, discrepancy) for c in family.conditions]
    return replace(family, conditions=tuple(told), measured=family.conditions, discrepancy=discrepancy)


def _rough_baseline(family: MachineFrfs) -> Values:
    model = Model(family, family.conditions)
    data = {r: np.asarray(c.observed) for r, c in enumerate(family.conditions) if c.observed is not None}
    return model.values(roughly(model, Target(data, model.null())))


def _told(family: MachineFrfs, condition: Condition, values: Values, discrepancy: float) -> Condition:
    excited = condition.data
    assert isinstance(excited, Excited)
    hits = excited.hits
    if hits is None:
        return condition
    axis = family.baseline.axis
    machine = family.baseline.machine(
        family.baseline.effective(values, condition.settings, excited.feed.get(axis, 0.0))
    )
    feed = {a: excited.feed.get(a, 0.0) for a in machine.axes}
    pulses = [Recorded(tuple(f.tolist()), hits.rate) for f in hits.force]
    spectra = [_spectrum_of(p, excited.frequency) for p in pulses]
    each = np.stack([_struck(machine, excited, feed, p, f) for p, f in zip(pulses, spectra, strict=True)])
    weight = np.abs(np.array(spectra)) ** 2
    weight = (weight / weight.sum(axis=0))[:, :, None]
    more = (weight * each).sum(axis=0) - _hit(machine, excited, feed)
    mean, unexplained = (weight * hits.compliance).sum(axis=0), hits.compliance - each
    own = np.stack([scatter_of(x, hits.impulse)[1] for x in np.moveaxis(unexplained, 2, 0)], axis=2)
    shared = np.concatenate([own, smooth_errors(excited.frequency, mean, discrepancy), UNSURE * more[None]])
    told = replace(excited, shared=shared)
    return replace(condition, data=told, observed=told.whitened(mean - more))


def _transform(x: Real, excited: Excited) -> Complex:
    """Fourier transform of a displacement that stays where it ends after the window, as from its acceleration.

    Where it ends before the window it is back where it was.
    """
    count = round(excited.window * _RATE)
    turn = _fourier(excited.frequency.tobytes(), count)
    cosine, sine = turn[:, :, : x.size] @ x
    out = np.asarray((cosine - 1j * sine) / _RATE)
    if x.size < count:
        return out
    w = 2.0 * np.pi * excited.frequency
    return np.asarray(out + x[-1] * np.exp(-1j * w * count / _RATE) / (1j * w))


@lru_cache(maxsize=16)
def _fourier(frequency: bytes, count: int) -> Real:
    """Cosines and sines of sampled time at some frequencies, shape (2, f, count)."""
    turn = 2.0 * np.pi * np.outer(np.frombuffer(frequency, dtype=float), np.arange(count) / _RATE)
    return np.array([np.cos(turn), np.sin(turn)])
