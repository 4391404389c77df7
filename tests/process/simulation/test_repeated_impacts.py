"""A machine that is prepared once and hit often, against one that is simulated anew for each impact."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import GeneralisedMaxwellSlip, LuGre, MemoryLaw
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Excitation, HalfSine
from process.simulation.machine import RepeatedImpact, integrate_problem
from process.simulation.problem import MachineRun, resolve
from process.simulation.record import displacement_of
from process.types import Real

MM_MIN = 1.0 / 6e4
FRICTION = LuGre(5e8, 6e4, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
ELEMENTS = GeneralisedMaxwellSlip((2e8, 2e8, 1e8), (0.1, 0.4, 0.5), 44.2, 84.0, 387.4 * MM_MIN, 168.0, 2e5)
MACHINE = Machine(
    two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)}), {"x": FeedAxis(Servo(6268.0, 10.9e-3, 45.5), FRICTION)}
)


@pytest.mark.parametrize("feed", [0.0, 500.0, -1000.0])
def test_a_machine_prepared_for_any_impact_moves_as_one_that_is_simulated(feed: float) -> None:
    run = MachineRun(1.9, feed * MM_MIN)
    prepared = RepeatedImpact(MACHINE, "x", run, accuracy=1e-4)
    for impact in (HalfSine.from_peak(50.0, start=0.0), HalfSine.from_peak(400.0, 3e-3, 0.0)):
        problem = resolve(MACHINE, replace(run, forces={"x": impact}))
        _, states = integrate_problem(problem, 2000.0, 1.0 / 2000.0, 1e-4)
        whole, found = displacement_of(problem, states), prepared.displacement(impact)
        np.testing.assert_array_equal(found, whole[:, : found.shape[1]])
        assert not whole[:, found.shape[1] :].any()


def test_a_hit_in_motion_that_is_followed_to_rest_has_the_spectrum_of_one_followed_to_the_end() -> None:
    # In less than a third of the time; the transform of what is left out is below 1e-5 of that of the whole.
    prepared = RepeatedImpact(MACHINE, "x", MachineRun(1.9, 500 * MM_MIN), accuracy=1e-4)
    impact = HalfSine.from_peak(100.0, start=0.0)
    whole, found = prepared.displacement(impact)[0], prepared.displacement(impact, rest=1e-7)[0]
    assert found.size < 0.3 * 1.9 * 2000.0
    kernel = np.exp(-2j * np.pi * np.outer(np.arange(8.0, 128.0), np.arange(whole.size) / 2000.0))
    missing = np.abs(kernel[:, found.size :] @ whole[found.size :]) / np.abs(kernel @ whole)
    assert missing.max() < 1e-5


def test_a_slide_that_its_guideway_holds_need_not_be_followed_to_the_end_of_the_window() -> None:
    """It does not come back, so that it is never at rest as a moving one is."""
    structure, servo = two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 300.0)}), Servo(6268.0, 10.9e-3, 45.5, 7.5e-4)
    damped = Machine(structure, {"x": FeedAxis(servo, FRICTION)})
    prepared = RepeatedImpact(damped, "x", MachineRun(1.9), accuracy=1e-4)
    impact = HalfSine.from_peak(50.0, start=0.0)
    whole, usual = prepared.displacement(impact)[0], prepared.displacement(impact, rest=1e-7)[0]
    found = prepared.displacement(impact, rest=1e-7, held=(1e-5, 0.02))[0]
    assert usual.size == whole.size
    assert found.size < 0.7 * whole.size
    assert np.abs(whole[found.size :] - found[-64:].mean()).max() < 2e-4 * np.abs(whole).max()


@dataclass(frozen=True)
class Held(Excitation):
    """A force that rises within a second, and stays."""

    size: float
    shortest: float = 1.0
    end: float = 10.0

    def force(self, time: Real) -> Real:
        """Return the force [N]."""
        return np.asarray(self.size * (1.0 - np.cos(np.pi * np.clip(time, 0.0, 1.0))) / 2.0)


@pytest.mark.parametrize("law", [FRICTION, ELEMENTS], ids=["LuGre", "Maxwell slip"])
@pytest.mark.parametrize("pull", [-60.0, 50.0])
def test_a_hit_finds_a_guideway_that_holds_a_pull_as_one_whose_drive_was_made_to_pull_before(
    law: MemoryLaw, pull: float
) -> None:
    """And not as one at rest without: the pull helps the slide to break away, or holds it back, by tens of per cent."""
    free = Machine(MACHINE.structure, {"x": FeedAxis(None, law)})
    before, after = 1.5, 0.3
    pulled = MachineRun(before + after, forces={"x": HalfSine(0.25, 4e-3, before)}, drive_forces={"x": Held(pull)})
    problem = resolve(free, pulled)
    _, states = integrate_problem(problem, 4000.0, 1.0 / 4000.0, 1e-5)
    x = displacement_of(problem, states)[0]
    at = round(before * 4000.0)
    hit = RepeatedImpact(free, "x", MachineRun(after), accuracy=1e-5, sample_rate=4000.0)
    ours, without = (hit.displacement(HalfSine(0.25, 4e-3, 0.0), pull=p)[0] for p in (pull, 0.0))
    expected = x[at : at + ours.size] - x[at - 1]
    assert np.abs(ours - expected).max() < 2e-3 * np.abs(expected).max()
    assert np.abs(without - expected).max() > 0.1 * np.abs(expected).max()


def test_no_guideway_holds_more_than_its_static_friction() -> None:
    prepared = RepeatedImpact(MACHINE, "x", MachineRun(0.1), accuracy=1e-4)
    with pytest.raises(InputError, match="holds a pull of 90 N along x"):
        prepared.displacement(HalfSine.from_peak(50.0), pull=90.0)
