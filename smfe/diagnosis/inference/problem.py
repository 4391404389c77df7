"""What a diagnosis works on: parameters, causes that nest a baseline, conditions with whitened data, a family.

A family predicts every condition from one set of values. With every cause at its null value it is the baseline; the
engine (`smfe.diagnosis.judgement.diagnose`) knows nothing else about the physics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Complex, Real

Values = Mapping[str, float]
"""Parameter name -> value (SI)."""


@dataclass(frozen=True)
class Parameter:
    """One number of a model."""

    name: str  # unique within the family, e.g. ``"loop_delay.delay"``
    unit: str  # as shown to people
    start: float  # of a nuisance the most likely value, of a cause the null value (SI)
    scale: float  # size of a change that matters (SI); fits work in units of it
    low: float = -math.inf  # admissible range (SI): outside, the model is not physics
    high: float = math.inf
    prior: float = math.inf  # standard deviation of a Gaussian prior around `start` (SI); infinite: none
    shown: float = 1.0  # number shown for one SI unit (1000 for mm)
    given: str = ""
    """Of a nuisance with a prior, which somebody declared or a workshop holds to: id of the cause under which a value
    beyond its prior is named."""
    stated: bool = True
    """Of a given one: whether it was declared with its uncertainty; else what matters counts within the prior, too."""
    said: str = ""  # what it is, for people: "gain of the force sensor"; empty: its name
    secondary: bool = False
    """Of a cause: whether it only shapes what the cause does, so that a value on its bound is no objection."""
    nameless: bool = False
    """Of a given one: whether a value beyond its prior is no cause by itself. With the others of its kind it stands for
    nearly anything, so that a fit that needs it is one that nothing of the catalogue explains."""

    def __post_init__(self) -> None:
        """Refuse a parameter that cannot be fitted."""
        if not (self.scale > 0.0 and self.prior > 0.0 and self.low <= self.start <= self.high):
            raise InputError(
                f"parameter {self.name}: start {self.start:g} in {self.low:g} to {self.high:g}, scale {self.scale:g}, "
                f"prior {self.prior:g}; the start must be admissible, scale and prior positive"
            )


@dataclass(frozen=True)
class Cause:
    """Something that the baseline leaves out. At the null values of its parameters it leaves the baseline unchanged."""

    id: str  # cause id, the same everywhere (``"guideway_friction"``)
    title: str  # for people, e.g. ``"Stribeck friction of the guideway"``
    parameters: tuple[Parameter, ...]  # what a fit finds
    variant: str = ""  # distinguishes several models of one cause (``"stribeck"``)
    kind: str = "physics"  # or "measurement": a fault that is excluded before physics
    starts: tuple[tuple[float, ...], ...] = ()
    """More values to start a fit from (SI), besides what the linearised score suggests."""
    begin: Values = field(default_factory=dict, compare=False)
    """Values of nuisances and of its own parameters where the data have been seen to fit with it (SI); none: not known.
    What competes with a cause may be far off without it."""
    law_of: str = ""
    """What it is a law of, where these data cannot hold two laws of one thing: one of them only is in a model."""
    equivalent: Callable[[Mapping[str, float]], tuple[float, ...]] | None = None
    """From values to other ones of the parameters that predict (nearly) the same: a symmetry of the cause. Of two that
    fit alike the nearer to the null is taken."""

    known: Values = field(default_factory=dict)
    """Standard deviation with which anybody knows each of its parameters (SI); none: zero until shown not to be."""

    unsettles: frozenset[str] = frozenset()
    """Nuisances that are not what they were known to be where this cause acts: it was there when they were found."""

    beyond: Callable[[Mapping[str, float]], str] | None = field(default=None, compare=False)
    """From values to the parameter that is where this cause cannot be, in words; "" for none. As an end of its bounds:
    a fit may pass there, and what ends there is refused."""

    @property
    def key(self) -> str:
        """Id and variant."""
        return f"{self.id}/{self.variant}" if self.variant else self.id


@dataclass(frozen=True)
class Condition:
    """One condition of the campaign: the unit that is held out as a whole."""

    name: str  # for people, e.g. ``"actuator x, 500 mm/min, 50 N, K2"``
    settings: Mapping[str, float | str]
    """Feed, level, direction, controller, position, added mass, order in time ... as far as they are known."""
    observed: Real | None = field(default=None, repr=False)
    """Shape (n,): real data whitened to unit variance (complex values as real and imaginary parts); None: a proposed
    experiment."""
    source: str = ""  # independent experiment that it belongs to: parameters must agree between sources
    data: object = field(default=None, repr=False)  # whatever the family needs to predict it


class Abilities(Protocol):
    """What a family may know beyond `Family`; families inherit these defaults and override what applies to them."""

    @property
    def noise_degrees_of_freedom(self) -> float:
        """Degrees of freedom with which the noise that all conditions have in common is known."""
        return math.inf

    def condition_degrees_of_freedom(self, condition: Condition) -> float:
        """Return the degrees of freedom with which the noise of one condition is known."""
        return math.inf

    def noises(self, columns: Sequence[tuple[Condition, Real]]) -> Sequence[Real]:
        """Return products X^T X of columns of conditions, (m, m), one for each noise that may be true; none: white."""
        return ()

    @property
    def common(self) -> tuple[str, ...]:
        """Ids of causes that nearly every machine has: pairs with them are always tried, for they mask the others."""
        return ()

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the square of the relative size of a whitened misfit of a condition where it matters [1].

        A quadratic form of the misfit, from which the share of noise is subtracted. Here its squares over those of the
        data; without data over nothing, so that it is infinite.
        """
        whole = 0.0 if condition.observed is None else float(condition.observed @ condition.observed)
        return float(misfit @ misfit) / whole if whole > 0.0 else math.inf

    def squared_change(self, condition: Condition, before: Values, after: Values, misfit: Real) -> float:
        """Return the square of the relative size of what lies between two predictions, `misfit` apart [1].

        It may have a part that is not compared with data. Here that of the misfit alone.
        """
        return self.squared_size(condition, misfit)

    @property
    def each_counts(self) -> bool:
        """Whether a misfit matters that is large in one condition alone; else its rms over all of them counts."""
        return False

    @property
    def one_scale(self) -> bool:
        """Whether nothing of the catalogue scales one condition alone: forces of a cut, by its depth and width."""
        return False

    @property
    def masks(self) -> bool:
        """Whether a cause may hide from what was declared, and that from it: data of few values that all move alike."""
        return False

    @property
    def bounded_noise(self) -> bool:
        """Whether data are whitened by no less than their noise, so that what scatters with it is known from above."""
        return False

    @property
    def supple(self) -> bool:
        """Whether causes have parameters enough to take up what others do: little left is no sign that all is found."""
        return False

    @property
    def decisive(self) -> float:
        """Likelihood ratio, over what is left, from which on counts what no condition left out bears out; 0: any does.

        It is that which a model reaches by what it misses of a machine that is as declared.
        """
        return 0.0

    @property
    def convicting(self) -> float:
        """Likelihood ratio, over what is left, from which a refused cause that nothing else proves convicts a baseline.

        0: any that noise does not reach does. A model of a machine that is as declared misses a little of it.
        """
        return self.decisive

    def measured_noise(self, condition: Condition) -> Real | None:
        """Return the standard deviation of the noise in whitened data that was measured, (n,); None: all of it.

        What else data are whitened by is the most that a model may miss. That is no misfit, but part of the size of
        one, and how much of it a model does miss is seen in what a fit leaves.
        """
        return None

    def kinds(self, condition: Condition) -> NDArray[np.int64] | None:
        """Return the kind of each value, (n,), of which a missing effect may be in one alone; None: all are alike."""
        return None

    @property
    def roughness(self) -> float:
        """Distance of predictions from a smooth function of the parameters: root of the sum of squares, in noise."""
        return 0.0

    @property
    def model_error(self) -> float:
        """Relative error of predictions that looks like a change of the parameters (rms over all lines)."""
        return 0.0

    def relative(self, condition: Condition, predicted: Real, slopes: Real) -> Complex:
        """Return slopes of a prediction, (n, p), over the prediction itself, value by value."""
        return np.asarray(slopes / predicted[:, None], dtype=np.complex128)

    def closed_form(self, condition: Condition, values: Values, predicted: Real, name: str) -> Real | None:
        """Return the slope of a prediction with a parameter (SI) that follows from it; None: by differences."""
        return None

    def alike(self, conditions: Sequence[Condition]) -> Sequence[int]:
        """Return a number for each condition, equal where the error of the prediction is the same."""
        return range(len(conditions))

    def slopes(
        self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]
    ) -> Sequence[Real] | None:
        """Return the derivatives of each condition with parameters, over their scales, (n, p), in closed form.

        None where they are taken by differences of predictions.
        """
        return None

    @property
    def begin(self) -> Values:
        """Values where the first fit of the baseline begins, other than at their most likely ones (SI)."""
        return {}

    @property
    def begun(self) -> bool:
        """Whether all nuisances begin near their best values, so that nothing need be fitted to bring them there."""
        return False

    @property
    def prepares_data(self) -> bool:
        """Whether the data rest on a simulation, so that `as_found` prepares them anew with what was found."""
        return False

    def as_found(self, values: Values) -> Sequence[Condition]:
        """Return the measured conditions as a machine of these values makes them (with `prepares_data`)."""
        return ()


class Family(Abilities, Protocol):
    """A baseline with its nuisances, the causes that extend it, and the conditions that were measured."""

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Parameters of the baseline that every hypothesis fits anew."""

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Candidates."""

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What was measured."""

    @property
    def proposals(self) -> tuple[Condition, ...]:
        """Experiments that could be done next, without data."""

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return the prediction of a condition, whitened like its data, shape (n,)."""
