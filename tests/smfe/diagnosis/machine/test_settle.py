"""Claims: fits of a machine begin, and expect what nobody declared, where friction that nobody declared puts it."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from process.machine.modes import ModalModel
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains, Side
from smfe.diagnosis.machine.dynamics import bounded
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.machine.rules import RULES
from smfe.diagnosis.machine.settle import _as_a_whole, settled

MODES = ModalModel(
    frequency=np.array([31.0, 45.0]),
    damping=np.array([0.02, 0.03]),
    stiffness=np.array([4.3e7, 5.0e7]),
    direction=np.array([[0.99, -0.14, 0.0], [0.1, 0.99, 0.05]]),
)
F = np.linspace(3.0, 70.0, 20)
STATES = (("idle", 0.0), ("moving", 3e-3))
HELD = {"hold_x": 0.85, "hold_y": 0.9, "fall_x": 900.0, "fall_y": 500.0}


def hit(name: str, feed: float, error: float = 5e-11, level: float = 0.3) -> Condition:
    """A set of hits along x and y, their compliance known to 0.05 um/kN."""
    entries = tuple((r, e) for r in "xy" for e in "xy")
    std = np.full((F.size, len(entries)), error)
    data = Excited(F, entries, std, "hammer", level, feed={"x": feed, "y": feed}, controller="K1")
    return Condition(name, {"feed": feed, "level": level, "controller": "K1"}, data=data)


def measured(held: dict[str, float]) -> MachineOfAxes:
    """A machine as its maker describes it but for what holds its slides."""
    axes = {
        a: DeclaredAxis(m, {"K1": Gains(kp, 25e-3, 18.0, 2e-3)}, None)
        for a, m, kp in (("x", 3200.0, 2.6e5), ("y", 900.0, 1e5))
    }
    sets = (hit("idle", 0.0), hit("moving", 3e-3))
    family = MachineOfAxes(MODES, sets, axes=axes)
    true = {p.name: p.start for p in (*family.nuisances, *(q for c in family.causes for q in c.parameters))} | held
    return replace(family, conditions=tuple(replace(c, observed=family.predict(c, true)) for c in sets))


def off(values: Mapping[str, float]) -> float:
    """Largest relative error of a natural frequency of the held slides, of which nothing was declared."""
    return max(float(abs(values[f"frequency_{r + 1}"] / f - 1.0)) for r, f in enumerate(MODES.frequency))


def test_what_nobody_declared_is_expected_where_it_is_with_friction() -> None:
    """A fit without friction ends far off; with priors there, gains that were right would have to give way."""
    found = settled(measured(HELD))
    near = off({p.name: p.start for p in found.nuisances})
    assert near < 0.03
    assert off(found.first) > 2.0 * near


def test_a_machine_as_it_was_declared_stays_where_it_is() -> None:
    found = settled(measured({}))
    assert all(name.startswith(RULES.usual) for name in found.first)
    assert off({p.name: p.start for p in found.nuisances}) < 0.001


def test_what_sensors_hits_and_contacts_do_is_expected_where_it_usually_is() -> None:
    """The first fit begins elsewhere; priors there would count against every later one that explains the data."""
    family = measured(HELD | {"aside_x": 0.02, "stir_y": 3e-7, "push_x": 1e-4})
    found = settled(family)
    usual = {p.name: p.start for p in family.nuisances if p.name.startswith(RULES.usual)}
    assert {p.name: p.start for p in found.nuisances if p.name in usual} == usual
    assert any(abs(found.first[name] - at) > 1e-6 for name, at in usual.items())


def test_beside_friction_that_differs_between_the_directions_modes_are_expected_where_they_are() -> None:
    """Without that cause a fit that lets go of what was declared bends modes and gains."""
    side = Side(1200.0, 1450.0, 8e-3, 5e3)
    axes = {a: replace(axis, friction=(side, side), contact=5e8) for a, axis in measured({}).axes.items()}
    sets = tuple(hit(name, feed, 2e-10) for name, feed in (("idle", 0.0), ("forth", 3e-3), ("back", -3e-3)))
    family, rng = MachineOfAxes(MODES, sets, axes=axes), np.random.default_rng(0)
    true = {p.name: p.start for p in (*family.nuisances, *(q for c in family.causes for q in c.parameters))}
    true |= {"friction_asymmetry_x": 0.5, "friction_asymmetry_y": 0.5}
    seen = [(c, family.predict(c, true)) for c in sets]
    noisy = tuple(replace(c, observed=y + rng.standard_normal(y.size)) for c, y in seen)
    found = settled(replace(family, conditions=noisy))
    assert off({p.name: p.start for p in found.nuisances}) < 0.004
    begun = found.with_cause["friction_asymmetry"]
    assert all(abs(begun[f"friction_asymmetry_{a}"] - 0.5) < 0.05 for a in "xy")


def test_friction_that_takes_a_little_of_what_no_cause_explains_is_not_expected() -> None:
    """Errors three times those that were stated: more parameters take a little of them, whatever they stand for."""
    side = Side(1200.0, 1450.0, 8e-3, 5e3)
    axes = {a: replace(axis, friction=(side, side), contact=5e8) for a, axis in measured({}).axes.items()}
    sets = tuple(hit(name, feed, 2e-10) for name, feed in (("idle", 0.0), ("forth", 3e-3), ("back", -3e-3)))
    family, rng = MachineOfAxes(MODES, sets, axes=axes), np.random.default_rng(0)
    true = {p.name: p.start for p in family.nuisances}
    noisy = tuple(replace(c, observed=(y := family.predict(c, true)) + 3.0 * rng.standard_normal(y.size)) for c in sets)
    assert not settled(replace(family, conditions=noisy)).with_cause


def test_beside_a_wrong_gain_modes_and_guideways_are_expected_where_they_are() -> None:
    """With gains held a fit bends modes and contacts until all nearly fits; priors there would keep it."""
    side = Side(1200.0, 1450.0, 8e-3, 5e3)
    axes = {a: replace(axis, friction=(side, side), contact=5e8) for a, axis in measured({}).axes.items()}
    sets = tuple(hit(name, feed, 2e-10) for name, feed in (("idle", 0.0), ("moving", 3e-3)))
    family, rng = MachineOfAxes(MODES, sets, axes=axes), np.random.default_rng(0)
    true = {p.name: p.start for p in (*family.nuisances, *(q for c in family.causes for q in c.parameters))}
    right, true["Kp_y_K1"] = true["contact_y"], 1.3 * true["Kp_y_K1"]
    seen = [(c, family.predict(c, true)) for c in sets]
    noisy = tuple(replace(c, observed=y + rng.standard_normal(y.size)) for c, y in seen)
    found = {p.name: p.start for p in settled(replace(family, conditions=noisy)).nuisances}
    assert off(found) < 0.012
    assert abs(found["contact_y"] / right - 1.0) < 0.5


@pytest.mark.parametrize("levels", [(0.3, 1.0), (1.0, 1.0)])
def test_fits_with_a_joint_begin_along_the_modes_that_move_it(levels: tuple[float, float]) -> None:
    """Two levels tell a joint from modes that are softer; hits of one level show none."""
    side, vector = Side(1200.0, 1450.0, 8e-3, 5e3), np.array([math.cos(2.2), math.sin(2.2)])
    axes = {a: replace(axis, friction=(side, side), contact=5e8) for a, axis in measured({}).axes.items()}
    each = ((f"{state} {level} {n}", feed, 2e-9, level) for n, level in enumerate(levels) for state, feed in STATES)
    sets = tuple(hit(*one) for one in each)
    family, rng = MachineOfAxes(MODES, sets, axes=axes), np.random.default_rng(0)
    true = {p.name: p.start for p in (*family.nuisances, *(q for c in family.causes for q in c.parameters))}
    true |= {"joint_iwan": 0.13, "joint_iwan_travel": 1.5, "joint_iwan_angle_1": 2.2}
    seen = [(c, family.predict(c, true)) for c in sets]
    noisy = tuple(replace(c, observed=y + rng.standard_normal(y.size)) for c, y in seen)
    begun = settled(replace(family, conditions=noisy)).with_cause
    if levels[0] == levels[1]:
        assert not begun
    else:
        found = begun["joint_micro_slip/iwan"]
        angle = found["joint_iwan_angle_1"]
        assert abs(vector @ np.array([math.cos(angle), math.sin(angle)])) > 0.99
        assert abs(found["joint_iwan"] / 0.13 - 1.0) < 0.3


def test_slides_that_move_as_a_whole_move_the_tool_as_much() -> None:
    """What the modes do at the tool, ``sum_r u_r lambda_r/sqrt(m_r)``, is along it one over the root of what moves."""
    axes = {"x": DeclaredAxis(3200.0, {"K1": Gains(2.6e5, 25e-3, 18.0, 2e-3)}, None)}
    modes = ModalModel(
        np.array([31.0, 45.0, 80.0]),
        np.full(3, 0.02),
        np.array([4e7, 9e7, 3e8]),
        np.array([[1.0, 0.2, 0.0], [0.3, 1.0, 0.1], [0.5, 0.1, 1.0]]),
    )
    family = MachineOfAxes(modes, (hit("idle", 0.0),), axes=axes)
    found = np.array(list(_as_a_whole(family).values()))[None]
    at_tool = (modes.direction / np.sqrt(modes.mass)[:, None]).T @ bounded(found)[0]
    assert at_tool * np.sqrt(3200.0) == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    # What moves evenly bends its softest springs.
    assert abs(found[0, 0]) > 2.0 * abs(found[0, 2])
    stated = replace(family, axes={"x": replace(axes["x"], coupling=(10.0, 5.0, 1.0))})
    assert _as_a_whole(stated) == {}
