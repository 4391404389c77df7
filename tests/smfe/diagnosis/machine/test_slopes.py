"""Claims: slopes in closed form are those of differences of the predictions, of every parameter, whatever acts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from process.machine.modes import ModalModel
from process.types import Real
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition, Parameter, Values
from smfe.diagnosis.machine import family
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains, Side
from smfe.diagnosis.machine.family import MachineOfAxes

MODES = ModalModel(
    frequency=np.array([31.0, 45.0, 52.0]),
    damping=np.array([0.02, 0.03, 0.035]),
    stiffness=np.array([4.3e7, 5.0e7, 8.6e7]),
    direction=np.array([[0.99, -0.14, 0.0], [0.1, 0.99, 0.05], [0.0, -0.1, 0.99]]),
)
F = np.linspace(3.0, 90.0, 12)
ENTRIES = tuple((r, e) for r in "xyz" for e in "xyz")
STEADY = (Side(2000.0, 2600.0, 8e-3, 1e4),) * 2


class ByDifferences(MachineOfAxes):
    """The same machine, of which no slope is known."""

    def slopes(self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]) -> None:
        return None


def hit(name: str, feed: float, level: float, **more: object) -> Condition:
    """A set of hits, all entries of the compliance with one standard deviation."""
    std = np.full((F.size, len(ENTRIES)), 2e-9)
    data = Excited(F, ENTRIES, std, "hammer", level, feed={"x": feed, "y": feed}, controller="K1")
    return Condition(name, {"feed": feed, "level": level, "controller": "K1", **more}, data=data)


def model(of: type[MachineOfAxes], friction: tuple[Side, Side] | None) -> Model:
    axes = {
        a: DeclaredAxis(m, {"K1": Gains(kp, 25e-3, 18.0, 2e-3)}, friction)
        for a, m, kp in (("x", 3200.0, 2.6e5), ("y", 900.0, 1e5))
    }
    conditions = (
        hit("idle", 0.0, 0.3, position=0.0, order=0.0),
        hit("forth", 3e-3, 1.0, position=0.4, order=0.5, spindle_speed=100.0, added_mass=12.0),
        hit("back", -3e-3, 0.3, position=0.0, order=1.0, spindle_speed=300.0),
    )
    return Model(of(MODES, conditions, axes=axes), conditions)


def far_from_null(model: Model, acting: Mapping[str, float]) -> Real:
    """Nuisances within half of their priors, and some causes."""
    rng = np.random.default_rng(3)
    u = model.null()
    width = 1.0 / np.maximum(model.weight[model.nuisance], 0.1)
    u[model.nuisance] += 0.3 * np.minimum(width, 3.0) * rng.uniform(-1.0, 1.0, model.nuisance.size)
    u[model.nuisance] = np.clip(u, model.low + 0.2, model.high - 0.2)[model.nuisance]
    for name, value in acting.items():
        u[model.names.index(name)] = value
    return u


@pytest.mark.parametrize("friction", [STEADY, None])
@pytest.mark.parametrize(
    "acting",
    [
        {},
        {"joint_iwan": 15.0, "joint_iwan_angle_1": 3.0, "joint_iwan_travel": -1.0},
        {"joint_hardening": 6.0, "joint_hardening_angle_1": 2.0},
        {
            "posture_12": 3.0,
            "drift_33": -4.0,
            "bearings_11": 3.0,
            "mode_compliance": 2.0,
            "hold_x": 9.0,
            "fall_x": 30.0,
        },
    ],
)
def test_closed_forms_are_what_differences_show(
    friction: tuple[Side, Side] | None, acting: Mapping[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where every change of a joint's force in a hit is simulated; elements that begin to slip make kinks of 10 %."""
    monkeypatch.setattr(family, "RULES", replace(family.RULES, followed=0.0))
    closed, differences = model(MachineOfAxes, friction), model(ByDifferences, friction)
    u = far_from_null(closed, {n: x for n, x in acting.items() if n in closed.names})
    every = np.arange(len(closed.names))
    found, expected = (m.slopes(range(3), u, every) for m in (closed, differences))
    assert found is not None
    assert expected is not None
    whole = np.linalg.norm(np.concatenate(list(expected.values())), axis=0)
    for row in range(3):
        away = np.linalg.norm(found[row] - expected[row], axis=0)
        near = np.where([n.startswith("joint_iwan_") for n in closed.names], 0.1, 0.01)
        assert np.all(away <= near * whole + 1e-6), np.array(closed.names)[every][away > near * whole + 1e-6]
    assert np.sum(whole > 0.0) > 40


@pytest.mark.parametrize(("name", "size"), [("joint_iwan_angle_1", "joint_iwan"), ("joint_hardening", "")])
def test_a_joint_at_its_upper_bound_has_the_slope_below_it(name: str, size: str) -> None:
    """Without it no fit would come back from there."""
    here = model(MachineOfAxes, STEADY)
    u = far_from_null(here, {size: 15.0} if size else {})
    j = here.names.index(name)
    u[j] = here.high[j]
    found = here.slopes(range(3), u, np.array([j]))
    assert found is not None
    below = u.copy()
    below[j] -= 1e-3
    for row in range(3):
        at, there = here.predict(row, u), here.predict(row, below)
        assert at is not None
        assert there is not None
        assert np.linalg.norm(found[row][:, 0] - (at - there) / 1e-3) < 0.02 * np.linalg.norm(found[row]) + 1e-6
    assert np.linalg.norm(np.concatenate(list(found.values()))) > 0.1


@pytest.mark.parametrize("acting", [{"joint_iwan": 15.0, "joint_iwan_angle_1": 3.0}, {"joint_hardening": 6.0}])
def test_what_hardly_changes_the_force_of_a_joint_need_not_be_simulated(
    acting: Mapping[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its force as that of a spring, line by line, is a tenth off where a simulation is not worth its time."""
    closed, differences = model(MachineOfAxes, STEADY), model(ByDifferences, STEADY)
    u = far_from_null(closed, acting)
    every = np.array([j for j, n in enumerate(closed.names) if not n.startswith("joint_")])
    found, expected = (m.slopes(range(3), u, every) for m in (closed, differences))
    assert found is not None
    assert expected is not None
    one, other = (np.concatenate([x[r] for r in range(3)]) for x in (found, expected))
    whole = np.linalg.norm(other, axis=0)
    assert np.all(np.linalg.norm(one - other, axis=0) <= 0.1 * whole + 1e-6)
    # Were nothing simulated it would be more.
    monkeypatch.setattr(family, "RULES", replace(family.RULES, followed=np.inf))
    none = model(MachineOfAxes, STEADY).slopes(range(3), u, every)
    assert none is not None
    off = np.linalg.norm(np.concatenate([none[r] for r in range(3)]) - other, axis=0)
    assert np.max(off / np.maximum(whole, 1e-2 * whole.max())) > 0.1


def test_a_sine_on_a_loose_joint_has_no_closed_form() -> None:
    """Its stiffness depends on frequency by way of the response itself."""
    plain = model(MachineOfAxes, STEADY)
    one = plain.conditions[1]
    shaken = Condition("sine", one.settings, data=Excited(F, ENTRIES, np.ones((F.size, 9)), "actuator", 100.0))
    values = plain.values(plain.null())
    slipping = [p for c in plain.causes if c.id == "joint_micro_slip" for p in c.parameters]
    assert plain.family.slopes([shaken], values, slipping) is None
    assert plain.family.slopes([shaken], values, plain.family.nuisances) is not None


def test_slopes_that_are_known_are_not_taken_again() -> None:
    """Whatever parameters are asked for together, and of which conditions."""
    asked: list[tuple[int, int]] = []

    class Counted(MachineOfAxes):
        def slopes(
            self, conditions: Sequence[Condition], values: Values, parameters: Sequence[Parameter]
        ) -> list[Real] | None:
            asked.append((len(conditions), len(parameters)))
            return super().slopes(conditions, values, parameters)

    here = model(Counted, STEADY)
    u = far_from_null(here, {})
    first = here.slopes([0, 1], u, np.arange(5))
    again = here.slopes([1, 2], u, np.arange(2, 7))
    elsewhere = here.slopes([1], u + 1e-3, np.arange(5))
    assert asked == [(2, 5), (1, 2), (1, 5), (1, 5)]
    assert first is not None
    assert again is not None
    assert elsewhere is not None
    assert np.array_equal(first[1][:, 2:], again[1][:, :3])
    assert not np.array_equal(first[1], elsewhere[1])
