"""What no machine has is refused in one sentence that says what was given and what is meant."""

import math

import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson, LuGre, Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import two_mass_axes
from process.simulation.milling import MillingCut
from process.units import implausible

MACHINE = Machine(
    two_mass_axes({"x": Drive(4000.0, 300.0, 4e7, 5e3)}), {"x": FeedAxis(Servo(4e5, 0.03, 25.0), Viscous(4000.0))}
)


def test_a_static_force_below_the_sliding_one_is_no_stribeck_curve() -> None:
    with pytest.raises(InputError, match=r"static force of 44[.]2 N is below the sliding force .* of 84 N"):
        Andersson(84.0, 44.2, 6e-3, 168.0, 1e4)
    with pytest.raises(InputError, match=r"static force of 44[.]2 N is below"):
        LuGre(5e8, 6e4, 84.0, 44.2, 6e-3, 168.0)
    # Equal ones are Coulomb friction.
    assert Andersson(44.2, 44.2, 6e-3, 0.0, math.inf).force(1.0) == pytest.approx(44.2)


@pytest.mark.parametrize("damping", [1.0, 2.9])
def test_a_damping_ratio_in_per_cent_is_refused(damping: float) -> None:
    with pytest.raises(InputError, match="damping ratio of a mode is"):
        ModalModel([60.0, 80.0], [0.02, damping], [1e7, 1e7], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert ModalModel([60.0], [0.99], [1e7], [[1.0, 0.0, 0.0]]).damping[0] == 0.99


@pytest.mark.parametrize("feed", [3000.0, -500.0, {"x": 3000.0}])
def test_a_feed_in_millimetres_a_minute_is_refused(feed: float | dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"m/s is beyond any machine tool .* mm/min are"):
        MACHINE.at(feed)
    assert MACHINE.feeds(4.0) == {"x": 4.0}


def test_a_feed_rate_of_a_cut_in_millimetres_a_minute_is_refused() -> None:
    tool, material = Tool(0.08, 2), CuttingCoefficients(1.9e9, 0.8e9, 0.3e9)
    with pytest.raises(InputError, match=r"a feed of 120 m/s is beyond"):
        MillingCut(tool, engagement("down", 0.012, 0.08), material, 2e-3, feed_rate=120.0)
    assert MillingCut(tool, engagement("down", 0.012, 0.08), material, 2e-3, feed_rate=2e-3).feed_rate == 2e-3


def test_a_tool_in_millimetres_is_refused() -> None:
    with pytest.raises(InputError, match=r"tool diameter is 125 m, larger than any .* so that 125 mm are 0.125"):
        Tool(125.0, 8)
    assert Tool(0.63, 20).diameter == 0.63


class TestFittedParameters:
    def test_coefficients_of_every_material_pass(self) -> None:
        """From acrylic to hardened steel, with thin chips, worn edges and negative axial coefficients."""
        for ktc, krc, kac in (
            (120, 40, 10),
            (796, 169, 222),
            (2100, 900, 300),
            (6500, 5000, -700),
        ):
            values = {"Ktc": 1e6 * ktc, "Krc": 1e6 * krc, "Kac": 1e6 * kac, "Kte": 27.7e3, "Kre": 30.8e3, "Kae": 1.4e3}
            assert implausible(values) == []

    def test_values_that_no_work_material_has_are_named(self) -> None:
        (said,) = implausible({"Ktc": 5.25e6, "helix": 0.3})
        assert said.startswith("Ktc is 5.25 N/mm^2, outside of 30 to 2e+04 N/mm^2")
        (said,) = implausible({"Ktc": 100e6, "Krc": 700e6})
        assert said.startswith("Krc is 7 times Ktc")
        assert len(implausible({"moving_mass": 9e-8})) == 1
