"""The machine and the cut: tool, forces, modes, drive, friction, time simulation, virtual trials, vocabulary."""

from process.axis_simulation import simulate_axis
from process.compliance import ModalModel
from process.cutting import CuttingCoefficients, ProcessDamping, directional_matrix, force_harmonics
from process.drive import Drive, fit_open_loop, open_loop_response
from process.engagement import AnyEngagement, Engagement, Engagements, engagement, engagement_of_strips
from process.equivalent_friction import equivalent_damping
from process.errors import InputError
from process.excitation import (
    Chirp,
    HalfSine,
    HammerHits,
    LogarithmicChirp,
    Multisine,
    PseudoRandom,
    SteppedSine,
    Sum,
)
from process.friction import (
    Andersson,
    Coulomb,
    CoulombViscous,
    GeneralisedMaxwellSlip,
    LuGre,
    Viscous,
)
from process.friction_fit import (
    constant_force,
    fit_coulomb_curve,
    fit_friction_curve,
    fit_friction_record,
    friction_runs,
)
from process.friction_impedance import FrictionImpedance, linearised
from process.harmonic_balance import SlidingAxis, quasi_frf
from process.joints import CubicSpring, Gap, Iwan, Jenkins
from process.labels import make_compliance, make_record
from process.machine import FeedAxis, Machine, MountedJoint
from process.machine_balance import compliance_map, quasi_compliance
from process.machine_simulation import SampledControl, simulate_machine
from process.operating_point import OperatingPoint
from process.preload import DoublePinion
from process.released import released_compliance
from process.sampled_servo import SampledServo, sampled_poles
from process.sensors import Sensors, with_added_mass
from process.servo import Servo, tune
from process.simulate import MillingCut, Spindle, milling_step_error, simulate_forced, simulate_milling
from process.structure import Posture, Structure, free_modes, released_modes, two_mass_axes
from process.tool import Tool
from process.trials import Running, actuator_trial, hammer_trial, milling_trial, moving_trial, silent_trial
from process.units import parse, show

__all__ = [
    "Andersson",
    "AnyEngagement",
    "Chirp",
    "Coulomb",
    "CoulombViscous",
    "CubicSpring",
    "CuttingCoefficients",
    "DoublePinion",
    "Drive",
    "Engagement",
    "Engagements",
    "FeedAxis",
    "FrictionImpedance",
    "Gap",
    "GeneralisedMaxwellSlip",
    "HalfSine",
    "HammerHits",
    "InputError",
    "Iwan",
    "Jenkins",
    "LogarithmicChirp",
    "LuGre",
    "Machine",
    "MillingCut",
    "ModalModel",
    "MountedJoint",
    "Multisine",
    "OperatingPoint",
    "Posture",
    "ProcessDamping",
    "PseudoRandom",
    "Running",
    "SampledControl",
    "SampledServo",
    "Sensors",
    "Servo",
    "SlidingAxis",
    "Spindle",
    "SteppedSine",
    "Structure",
    "Sum",
    "Tool",
    "Viscous",
    "actuator_trial",
    "compliance_map",
    "constant_force",
    "directional_matrix",
    "engagement",
    "engagement_of_strips",
    "equivalent_damping",
    "fit_coulomb_curve",
    "fit_friction_curve",
    "fit_friction_record",
    "fit_open_loop",
    "force_harmonics",
    "free_modes",
    "friction_runs",
    "hammer_trial",
    "linearised",
    "make_compliance",
    "make_record",
    "milling_step_error",
    "milling_trial",
    "moving_trial",
    "open_loop_response",
    "parse",
    "quasi_compliance",
    "quasi_frf",
    "released_compliance",
    "released_modes",
    "sampled_poles",
    "show",
    "silent_trial",
    "simulate_axis",
    "simulate_forced",
    "simulate_machine",
    "simulate_milling",
    "tune",
    "two_mass_axes",
    "with_added_mass",
]
