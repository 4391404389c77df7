"""The machine and the cut: tool, forces, modes, drive, friction, time simulation, virtual trials, vocabulary."""

from typing import TYPE_CHECKING

from process._kernel_cache import provide
from process._lazy import lazy

if TYPE_CHECKING:
    from process.cut.engagement import (
        AnyEngagement,
        Engagement,
        Engagements,
        engagement,
        engagement_of_offset,
        engagement_of_strips,
    )
    from process.cut.force import CuttingCoefficients, ProcessDamping, directional_matrix, force_harmonics
    from process.cut.tool import Tool
    from process.drive.axis import Drive
    from process.drive.sampled_servo import SampledServo
    from process.drive.servo import Loop, Margins, Servo, tune
    from process.errors import InputError
    from process.friction.laws import Andersson, Coulomb, CoulombViscous, GeneralisedMaxwellSlip, LuGre, Viscous
    from process.friction.linearised import FrictionImpedance, equivalent_damping, invariant_feed, linearised
    from process.harmonic_balance.quasi_frf import compliance_map, quasi_compliance
    from process.instruments.actuator import MovingCoil
    from process.instruments.sensors import Sensors, with_added_mass
    from process.instruments.trials import (
        Running,
        actuator_trial,
        hammer_trial,
        milling_trial,
        moving_trial,
        shaker_trial,
        silent_trial,
    )
    from process.labels import make_compliance, make_record
    from process.machine.jointed_mode import JointedMode
    from process.machine.joints import CubicSpring, DoublePinion, Gap, Iwan, Jenkins, PowerIwan
    from process.machine.machine import FeedAxis, Machine, MountedJoint, released_compliance
    from process.machine.modes import ModalModel
    from process.machine.operating_point import OperatingPoint
    from process.machine.structure import Host, Posture, Structure, free_modes, hosted, released_modes, two_mass_axes
    from process.simulation.excitation import (
        Chirp,
        HalfSine,
        HammerHits,
        LogarithmicChirp,
        Multisine,
        PseudoRandom,
        SteppedSine,
        Sum,
    )
    from process.simulation.machine import simulate_machine, step_error
    from process.simulation.milling import MillingCut, Spindle, simulate_forced, simulate_milling
    from process.simulation.problem import MachineRun, SampledControl
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
    "Host",
    "InputError",
    "Iwan",
    "Jenkins",
    "JointedMode",
    "LogarithmicChirp",
    "Loop",
    "LuGre",
    "Machine",
    "MachineRun",
    "Margins",
    "MillingCut",
    "ModalModel",
    "MountedJoint",
    "MovingCoil",
    "Multisine",
    "OperatingPoint",
    "Posture",
    "PowerIwan",
    "ProcessDamping",
    "PseudoRandom",
    "Running",
    "SampledControl",
    "SampledServo",
    "Sensors",
    "Servo",
    "Spindle",
    "SteppedSine",
    "Structure",
    "Sum",
    "Tool",
    "Viscous",
    "actuator_trial",
    "compliance_map",
    "directional_matrix",
    "engagement",
    "engagement_of_offset",
    "engagement_of_strips",
    "equivalent_damping",
    "force_harmonics",
    "free_modes",
    "hammer_trial",
    "hosted",
    "invariant_feed",
    "linearised",
    "make_compliance",
    "make_record",
    "milling_trial",
    "moving_trial",
    "parse",
    "quasi_compliance",
    "released_compliance",
    "released_modes",
    "shaker_trial",
    "show",
    "silent_trial",
    "simulate_forced",
    "simulate_machine",
    "simulate_milling",
    "step_error",
    "tune",
    "two_mass_axes",
    "with_added_mass",
]

_HOMES = {
    "process.cut.engagement": "AnyEngagement, Engagement, Engagements, engagement, engagement_of_offset, "
    "engagement_of_strips",
    "process.cut.force": "CuttingCoefficients, ProcessDamping, directional_matrix, force_harmonics",
    "process.cut.tool": "Tool",
    "process.drive.axis": "Drive",
    "process.drive.sampled_servo": "SampledServo",
    "process.drive.servo": "Loop, Margins, Servo, tune",
    "process.errors": "InputError",
    "process.friction.laws": "Andersson, Coulomb, CoulombViscous, GeneralisedMaxwellSlip, LuGre, Viscous",
    "process.friction.linearised": "FrictionImpedance, equivalent_damping, invariant_feed, linearised",
    "process.harmonic_balance.quasi_frf": "compliance_map, quasi_compliance",
    "process.instruments.actuator": "MovingCoil",
    "process.instruments.sensors": "Sensors, with_added_mass",
    "process.instruments.trials": "Running, actuator_trial, hammer_trial, milling_trial, moving_trial, shaker_trial, "
    "silent_trial",
    "process.labels": "make_compliance, make_record",
    "process.machine.jointed_mode": "JointedMode",
    "process.machine.joints": "CubicSpring, DoublePinion, Gap, Iwan, Jenkins, PowerIwan",
    "process.machine.machine": "FeedAxis, Machine, MountedJoint, released_compliance",
    "process.machine.modes": "ModalModel",
    "process.machine.operating_point": "OperatingPoint",
    "process.machine.structure": "Host, Posture, Structure, free_modes, hosted, released_modes, two_mass_axes",
    "process.simulation.excitation": (
        "Chirp, HalfSine, HammerHits, LogarithmicChirp, Multisine, PseudoRandom, SteppedSine, Sum"
    ),
    "process.simulation.machine": "simulate_machine, step_error",
    "process.simulation.milling": "MillingCut, Spindle, simulate_forced, simulate_milling",
    "process.simulation.problem": "MachineRun, SampledControl",
    "process.units": "parse, show",
}
"""Module -> the names that it gives; `__all__` and the imports for the type checker say the same."""

provide()

if not TYPE_CHECKING:  # a type checker takes the imports above, and so finds a name that is not there
    __getattr__, __dir__ = lazy(__name__, _HOMES)
