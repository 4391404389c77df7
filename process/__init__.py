"""The machine and the cut: tool, forces, modes, drive, friction, time simulation, virtual trials, vocabulary."""

from process.axis_simulation import HalfSine, SteppedSine, simulate_axis
from process.compliance import ModalModel
from process.cutting import CuttingCoefficients, directional_matrix, force_harmonics
from process.drive import Drive, fit_open_loop
from process.engagement import Engagement, engagement
from process.equivalent_friction import equivalent_damping
from process.errors import InputError
from process.friction import (
    Andersson,
    Coulomb,
    CoulombViscous,
    GeneralisedMaxwellSlip,
    LuGre,
    Viscous,
    fit_friction_curve,
)
from process.harmonic_balance import SlidingAxis, quasi_frf
from process.joints import CubicSpring, Gap, Iwan, Jenkins
from process.labels import make_compliance, make_record
from process.servo import Servo, tune
from process.simulate import MillingCut, Spindle, simulate_forced, simulate_milling
from process.tool import Tool
from process.trials import Sensors, actuator_trial, hammer_trial, milling_trial
from process.units import parse, show

__all__ = [
    "Andersson",
    "Coulomb",
    "CoulombViscous",
    "CubicSpring",
    "CuttingCoefficients",
    "Drive",
    "Engagement",
    "Gap",
    "GeneralisedMaxwellSlip",
    "HalfSine",
    "InputError",
    "Iwan",
    "Jenkins",
    "LuGre",
    "MillingCut",
    "ModalModel",
    "Sensors",
    "Servo",
    "SlidingAxis",
    "Spindle",
    "SteppedSine",
    "Tool",
    "Viscous",
    "actuator_trial",
    "directional_matrix",
    "engagement",
    "equivalent_damping",
    "fit_friction_curve",
    "fit_open_loop",
    "force_harmonics",
    "hammer_trial",
    "make_compliance",
    "make_record",
    "milling_trial",
    "parse",
    "quasi_frf",
    "show",
    "simulate_axis",
    "simulate_forced",
    "simulate_milling",
    "tune",
]
