"""Claims: every line of a chatter in which teeth leave the work leads to the line of the vibration, others to none."""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from smfe.diagnosis.cutting.chatter_line import vibrating_line
from stability import ChatterVerdict, chatter_verdict
from stability.methods.semi_discretization import limit_depth

MACHINE = ModalModel([210.0, 245.0], [0.035, 0.03], [16e6, 14e6], [[1.0, 0.1, 0.0], [-0.1, 1.0, 0.0]])
TOOL = Tool(0.05, 5)
ARC = engagement("down", 0.032, 0.05)
MATERIAL = CuttingCoefficients(1.8e9, 0.65e9, 0.0)
SPEED = 850.0  # [rpm]
LIMIT = limit_depth(MACHINE, TOOL, ARC, MATERIAL, SPEED)
PASSING = SPEED * TOOL.teeth / 60.0


@pytest.fixture(scope="module")
def verdict() -> ChatterVerdict:
    """A cut a tenth deeper than the limit."""
    cut = MillingCut(TOOL, ARC, MATERIAL, 1.1e-3 * LIMIT.limit_depth_mm, feed_per_tooth=1.2e-4)
    spindle = Spindle(SPEED * math.pi / 30.0)
    record = simulate_milling(MACHINE, cut, spindle, 1.5, 4000.0, impulse=(0.01, 0.01, 0.0))
    assert record.attrs["lost_contact"] > 0.0
    return chatter_verdict(record[["acceleration"]].sel(axis=["x", "y"]), spindle.rotation, TOOL.teeth)


@pytest.mark.parametrize(("times", "teeth"), [(1, 0), (1, 1), (1, -1), (1, -3), (2, 0), (2, -1)])
def test_each_line_of_a_chatter_leads_to_the_vibration(verdict: ChatterVerdict, times: int, teeth: int) -> None:
    # A chatter deeper than the limit is slower than that of the limit by a per cent at most.
    main = verdict.chatter_frequency_Hz
    assert main == pytest.approx(LIMIT.chatter_frequency_Hz, rel=0.01)
    seen = abs(times * main + teeth * PASSING)
    assert vibrating_line(replace(verdict, chatter_frequency_Hz=seen), TOOL.teeth) == pytest.approx(main, rel=1e-9)


def test_a_line_of_something_else_stays_what_it_is(verdict: ChatterVerdict) -> None:
    frequency = verdict.spectrum["frequency"].values
    for beside in (4.3, -7.1, 0.29 * PASSING):
        other = float(frequency[int(np.argmin(np.abs(frequency - verdict.chatter_frequency_Hz - beside)))])
        assert vibrating_line(replace(verdict, chatter_frequency_Hz=other), TOOL.teeth) == other


def test_a_chatter_on_a_spindle_order_is_not_taken_for_the_run_out(verdict: ChatterVerdict) -> None:
    order = round(verdict.chatter_frequency_Hz / SPEED * 60.0) + 2 * TOOL.teeth
    seen = order * SPEED / 60.0
    assert vibrating_line(replace(verdict, chatter_frequency_Hz=seen), TOOL.teeth) == seen


def test_the_highest_line_is_that_of_the_vibration_though_it_stands_beside_an_order(verdict: ChatterVerdict) -> None:
    """A line of the distance that is resolved from an order was judged to be chatter: its side lines are lower."""
    resolved, turn = verdict.resolution_Hz, SPEED / 60.0
    main = 16 * turn + 0.9 * resolved
    frequency = np.arange(0.0, 2.0 * main, 0.1 * resolved)
    lines = (main, 5.0), (main - 0.997 * PASSING, 0.8)
    shape = sum(h * np.exp(-(((frequency - f) / resolved) ** 2)) for f, h in lines)
    spectrum = xr.Dataset({"vector_amplitude": ("frequency", shape)}, {"frequency": frequency})
    seen = replace(verdict, chatter_frequency_Hz=main, spectrum=spectrum)
    assert vibrating_line(seen, TOOL.teeth) == main


def test_without_a_line_there_is_none(verdict: ChatterVerdict) -> None:
    assert math.isnan(vibrating_line(replace(verdict, chatter_frequency_Hz=math.nan), TOOL.teeth))
