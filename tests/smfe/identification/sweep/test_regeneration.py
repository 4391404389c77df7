"""Closed loop: what shakes the machine comes back through the cut, and the passing of the teeth takes it out."""

import math

import numpy as np
import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Multisine, all_harmonics
from process.simulation.machine import simulate_machine
from process.simulation.milling import MillingCut, Spindle
from smfe import LocalPolynomial, SweepPass, identify_sweep

pytestmark = pytest.mark.slow

TOOL = Tool(0.08, 4, approach_angle=math.pi / 4.0)
WIDTHS = {"down": 0.024, "up": 0.04, "central": 0.068}
STEEL = CuttingCoefficients(1.8e9, 0.7e9, 0.25e9, 3e4, 4.5e4, 5e3)
AXIS = Drive(460.0, 226.0, 3.4e7, 4000.0, Servo(1.25e5, 10.9e-3, 45.5))
BAND = (24.0, 58.0)
DURATION = 24.0


def swept(shaken: float) -> list[SweepPass]:
    """Tooth passing from 20 to 50 Hz; `shaken`: unmeasured force on the slide [N rms]."""
    machine = Machine(two_mass_axes({"x": AXIS}), {"x": FeedAxis(AXIS.servo, Viscous(3000.0))})
    spindle = Spindle(2.0 * math.pi * 5.0, 2.0 * math.pi * 7.5 / DURATION)
    out = []
    for k, (cut, width) in enumerate(WIDTHS.items()):
        arc = engagement(cut, width, TOOL.diameter)
        mill = MillingCut(TOOL, arc, STEEL, 1e-3, feed_rate=3e-3)
        push = {"x": Multisine(0.03, all_harmonics(600, 2200), shaken, 1, k, 0.0)} if shaken else None
        record = simulate_machine(
            machine,
            duration=DURATION,
            lead=0.5,
            tail=3.0,
            cut=mill,
            spindle=spindle,
            drive_forces=push,
            sample_rate=1000.0,
        )
        rng = np.random.default_rng(k)
        record = record.drop_vars("acceleration")
        record["displacement"] = record["displacement"] + 1e-8 * rng.normal(size=record["displacement"].shape)
        out.append(SweepPass(record, cut, arc))
    return out


def compliance_x(passes: list[SweepPass], teeth: int | None) -> np.ndarray:
    estimator = LocalPolynomial(1.0, (0.5, 1.0), rational=False, instrument_teeth=teeth)
    return identify_sweep("s", passes, BAND, estimator).compliance["compliance"].sel(response="x").values


def test_the_spindle_as_instrument_takes_out_the_bias_that_least_squares_has() -> None:
    quiet, disturbed = swept(0.0), swept(80.0)
    true = compliance_x(quiet, None)
    # The projection on the truth averages the noise of the band; it would be 1.
    plain, teeth = (
        abs(np.vdot(true, compliance_x(disturbed, n)) / np.vdot(true, true) - 1.0) for n in (None, TOOL.teeth)
    )
    assert plain > 0.15
    assert teeth < 0.4 * plain
    # Nothing to take out, nothing changed.
    same = compliance_x(quiet, TOOL.teeth)
    assert np.linalg.norm(same - true) < 0.005 * np.linalg.norm(true)
