"""Held-out gain where no condition can be left out: alternate blocks of the values of each."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from smfe.diagnosis.inference.cross_validation import within
from smfe.diagnosis.inference.fit import Target, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.judgement.diagnose import diagnose

X = np.linspace(0.0, 1.0, 96)


def wave(k):
    return np.cos(k * np.pi * X)


@dataclass(frozen=True)
class Two(Abilities):
    """At rest the one, in motion the other parameter of a cause acts: each condition measures one of them."""

    conditions: tuple
    nuisances: tuple = (Parameter("offset", "m", 0.0, 1.0),)
    causes: tuple = (
        Cause("friction", "Friction", (Parameter("stuck", "m", 0.0, 1.0), Parameter("sliding", "m", 0.0, 1.0))),
        Cause("gain", "Gain", (Parameter("gain", "m", 0.0, 1.0),)),
    )
    proposals: tuple = ()

    def predict(self, condition, values):
        at_rest = condition.settings["feed"] == 0.0
        acting = values.get("stuck", 0.0) * wave(2) if at_rest else values.get("sliding", 0.0) * wave(3)
        return (values["offset"] + values.get("gain", 0.0)) * (1.0 if at_rest else 2.0) * wave(0) + acting


def measured(seed, **truth):
    rng = np.random.default_rng(seed)
    plain = Two((Condition("idle", {"feed": 0.0}), Condition("motion", {"feed": 1.0})))
    seen = (plain.predict(c, {"offset": 0.3, **truth}) + rng.standard_normal(X.size) for c in plain.conditions)
    return replace(plain, conditions=tuple(replace(c, observed=y) for c, y in zip(plain.conditions, seen, strict=True)))


def test_a_strong_cause_is_named_by_blocks_of_values_and_that_is_said():
    found = diagnose(measured(0, stuck=3.0, sliding=-3.0))
    assert (found.verdict, [c.id for c in found.causes]) == ("named", ["friction"])
    assert "blocks of values" in found.reason
    assert found.gain.held_out == "blocks of values"
    # The effect of each parameter has 9 x 48 of chi-square, the noise of the fit one.
    assert found.gain.db == pytest.approx(10.0 * np.log10(2 * 9 * 48 / 4.0), abs=2.0)


@pytest.mark.parametrize("draws", [2, pytest.param(8, marks=pytest.mark.slow)])
def test_nothing_is_named_by_blocks_of_values_where_there_is_nothing(draws):
    assert [diagnose(measured(seed)).verdict for seed in range(draws)] == ["consistent"] * draws


def test_what_leaves_structure_is_not_named_by_blocks_of_values():
    family = measured(0, stuck=3.0, sliding=-3.0)
    wrong = tuple(replace(c, observed=c.observed + 1.5 * wave(5)) for c in family.conditions)
    assert diagnose(replace(family, conditions=wrong)).verdict == "unknown"


@dataclass(frozen=True)
class Curved(Two):
    """A force that falls over a speed: a small one over a small speed is nearly a larger one over a larger."""

    nuisances: tuple = (Parameter("fall", "N", 20.0, 1.0), Parameter("speed", "m/s", 0.02, 0.01, 1e-3))
    causes: tuple = ()

    def predict(self, condition, values):
        return values["fall"] * np.exp(-(X + condition.settings["feed"]) / values["speed"])


@pytest.mark.parametrize("seed", [2, 3])
def test_blocks_are_predicted_no_worse_for_a_step_that_its_slopes_promise_in_vain(seed):
    """Where the first block alone tells the speed, a step without it goes to anything: a force of 100 in the block."""
    plain = Curved((Condition("one", {"feed": 0.0}), Condition("other", {"feed": 0.02})))
    noise = np.random.default_rng(seed)
    exact = (plain.predict(c, {"fall": 20.0, "speed": 0.02}) for c in plain.conditions)
    shown = [y + noise.standard_normal(X.size) for y in exact]
    seen = tuple(replace(c, observed=y) for c, y in zip(plain.conditions, shown, strict=True))
    model = Model(replace(plain, conditions=seen), seen)
    target = Target(dict(enumerate(shown)), model.null())
    held = within(model, target, fit(model, target, (), model.null()))
    # Noise has 8 in a block.
    assert max(held.squares.values()) < 30.0
