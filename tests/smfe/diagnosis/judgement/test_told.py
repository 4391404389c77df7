"""Causes beside what a model misses: one that its interval does not tell from nothing is none."""

from dataclasses import dataclass

import numpy as np
import pytest

from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.materiality import Worth

V = np.concatenate([-(half := np.geomspace(1e-4, 0.2, 60))[::-1], half])
NOISE = 2.0


@dataclass(frozen=True)
class Guideway(Abilities):
    """Friction over the speed, of bristles that bend as a hyperbolic tangent; 150 N of it are declared."""

    conditions: tuple
    proposals: tuple = ()
    nuisances: tuple = (
        Parameter("viscous", "N s/m", 700.0, 50.0),
        Parameter("coulomb", "N", 150.0, 5.0, 0.0, prior=15.0, given="guideway_friction"),
        Parameter("bend", "m/s", 3e-4, 1e-4, 1e-5, 3e-3, prior=1e-3, secondary=True),
    )
    causes: tuple = (
        Cause(
            "lubricant",
            "friction that builds up",
            (Parameter("shear", "N", 0.0, 1.0, 0.0), Parameter("speed", "m/s", 8e-3, 3e-3, 5e-4, 3e-2)),
            "shear",
        ),
        Cause(
            "lubricant",
            "friction that falls",
            (Parameter("boost", "N", 0.0, 1.0, 0.0), Parameter("slow", "m/s", 8e-3, 3e-3, 5e-4, 3e-2)),
            "stribeck",
        ),
    )

    def predict(self, condition, values):
        built = -np.expm1(-np.abs(V) / values.get("speed", 8e-3))
        low = np.exp(-np.abs(V) / values.get("slow", 8e-3))
        force = values["coulomb"] + values.get("shear", 0.0) * built + values.get("boost", 0.0) * low
        return (values["viscous"] * V + np.tanh(V / values["bend"]) * force) / NOISE

    def squared_size(self, condition, residual):
        return float(residual @ residual / (condition.observed @ condition.observed))


def measured(coulomb, builds_up, bend):
    """Eight moves of an axis whose bristles bend otherwise than the model has it."""
    rng = np.random.default_rng(3)
    force = 700.0 * V + coulomb * V / np.hypot(V, bend) + builds_up * np.sign(V) * -np.expm1(-np.abs(V) / 8e-3)
    noise = rng.standard_normal((8, V.size))
    return Guideway(tuple(Condition(f"move {n}", {}, observed=force / NOISE + x) for n, x in enumerate(noise)))


def test_friction_that_its_interval_does_not_tell_from_nothing_is_no_finding():
    """The bristles bend otherwise in every move, so that moves left out bear out what imitates it."""
    found = diagnose(measured(150.0, 0.0, 2e-3), worth=Worth(0.05))
    assert found.verdict == "consistent"
    assert [c.id for c in found.immaterial] == ["lubricant"]
    (declared,) = (g for g in found.given if g.name == "coulomb")
    assert declared.found == pytest.approx(150.0, abs=5.0)


def test_friction_that_builds_up_is_found_beside_bristles_that_bend_otherwise():
    found = diagnose(measured(110.0, 40.0, 3e-4), worth=Worth(0.05))
    assert found.verdict == "named"
    (cause,) = found.causes
    assert (cause.id, cause.parameters[0].value) == ("lubricant", pytest.approx(40.0, abs=8.0))
