"""The machine and the cut: tool, forces, modal machine, time simulation, virtual trials, vocabulary."""

from process.compliance import ModalModel
from process.cutting import CuttingCoefficients, directional_matrix, force_harmonics
from process.engagement import Engagement, engagement
from process.errors import InputError
from process.labels import make_compliance, make_record
from process.simulate import MillingCut, Spindle, simulate_forced, simulate_milling
from process.tool import Tool
from process.trials import Sensors, actuator_trial, hammer_trial, milling_trial
from process.units import parse, show

__all__ = [
    "CuttingCoefficients",
    "Engagement",
    "InputError",
    "MillingCut",
    "ModalModel",
    "Sensors",
    "Spindle",
    "Tool",
    "actuator_trial",
    "directional_matrix",
    "engagement",
    "force_harmonics",
    "hammer_trial",
    "make_compliance",
    "make_record",
    "milling_trial",
    "parse",
    "show",
    "simulate_forced",
    "simulate_milling",
]
