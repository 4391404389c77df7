"""A machine that is prepared once and hit often, against one that is simulated anew for each impact."""

from dataclasses import replace

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import LuGre
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import HalfSine
from process.simulation.machine import RepeatedImpact, integrate_problem
from process.simulation.problem import MachineRun, resolve
from process.simulation.record import displacement_of

MM_MIN = 1.0 / 6e4
FRICTION = LuGre(5e8, 6e4, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
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
