"""Machine-tool dynamics: records of a measuring campaign -> compliance -> stability lobes -> verdicts.

The commands of the command line are functions of the same name: `run`, `demo`, `check`, `look`, `identify`, `compare`,
`modal`, `lobes`, `pitch`, `chatter`, `coefficients`, `diagnose`, `plan`, `tune`, `simulate`, `convert`, `report`,
`export`, `catalogue`.
They take paths, or objects in memory, which `record`, `compliance`, `Tool` and `CuttingCoefficients` make of arrays.
What a folder of results recommends is its `recommendation`. Files are read by `read_campaign`, `read_record`,
`read_records`, `read_blocks`, `read_reduced`. The methods alone, from records to a compliance with its uncertainty, are
`hammer_compliance`, `actuator_compliance`, `sweep_compliance`.

`load_campaign`, `identify_hammer`, `identify_actuator` and `identify_sweep` are the former names of `read_campaign` and
of the three methods; they go in a later release.
"""

from typing import TYPE_CHECKING

import stability  # noqa: F401  (fails with a clear sentence when a user's own process.py shadows ours)
from process._lazy import lazy
from smfe._version import __version__

if TYPE_CHECKING:
    from process.cut.force import CuttingCoefficients
    from process.cut.tool import Tool
    from process.errors import InputError
    from process.machine.modes import ModalModel
    from smfe.arrays.compliances import compliance
    from smfe.arrays.recommendation import recommendation
    from smfe.arrays.records import record
    from smfe.campaign import Campaign, load_campaign
    from smfe.campaign import load_campaign as read_campaign
    from smfe.commands.chatter import chatter
    from smfe.commands.check import check
    from smfe.commands.coefficients import Coefficients, coefficients
    from smfe.commands.compare import compare
    from smfe.commands.cut.pitch import pitch
    from smfe.commands.demo import demo
    from smfe.commands.diagnose import diagnose
    from smfe.commands.files.convert import convert
    from smfe.commands.files.export import export
    from smfe.commands.files.look import look
    from smfe.commands.identify import identify
    from smfe.commands.lobes import lobes
    from smfe.commands.many.catalogue import catalogue
    from smfe.commands.many.run import run
    from smfe.commands.modal import modal
    from smfe.commands.plan import plan
    from smfe.commands.report import report
    from smfe.commands.simulate import simulate
    from smfe.commands.tune import tune
    from smfe.identification.actuator.stepped_sine import identify_actuator
    from smfe.identification.actuator.stepped_sine import identify_actuator as actuator_compliance
    from smfe.identification.drive.friction import (
        constant_force,
        fit_coulomb_curve,
        fit_friction_curve,
        fit_friction_record,
        friction_runs,
    )
    from smfe.identification.drive.open_loop import fit_open_loop, open_loop_response
    from smfe.identification.errors.intervals import interval
    from smfe.identification.errors.result import Identification
    from smfe.identification.hammer.hammer import identify_hammer
    from smfe.identification.hammer.hammer import identify_hammer as hammer_compliance
    from smfe.identification.sweep.local_polynomial import LocalPolynomial
    from smfe.identification.sweep.passes import SweepPass
    from smfe.identification.sweep.segments import Segments, SingleReference
    from smfe.identification.sweep.sweep import identify_sweep
    from smfe.identification.sweep.sweep import identify_sweep as sweep_compliance
    from smfe.limits.campaign_lobes import LobeResult
    from smfe.limits.recommendation import Recommendation
    from smfe.modes.fit_modes import ModalFit, fit_modes
    from smfe.notebook import plot
    from smfe.progress import SmfeWarning
    from smfe.records import Channel, read_blocks, read_record, read_records, read_reduced
    from smfe.records.look import Look


__all__ = [
    "Campaign",
    "Channel",
    "Coefficients",
    "CuttingCoefficients",
    "Identification",
    "InputError",
    "LobeResult",
    "LocalPolynomial",
    "Look",
    "ModalFit",
    "ModalModel",
    "Recommendation",
    "Segments",
    "SingleReference",
    "SmfeWarning",
    "SweepPass",
    "Tool",
    "__version__",
    "actuator_compliance",
    "catalogue",
    "chatter",
    "check",
    "coefficients",
    "compare",
    "compliance",
    "constant_force",
    "convert",
    "demo",
    "diagnose",
    "export",
    "fit_coulomb_curve",
    "fit_friction_curve",
    "fit_friction_record",
    "fit_modes",
    "fit_open_loop",
    "friction_runs",
    "hammer_compliance",
    "identify",
    "identify_actuator",
    "identify_hammer",
    "identify_sweep",
    "interval",
    "load_campaign",
    "lobes",
    "look",
    "modal",
    "open_loop_response",
    "pitch",
    "plan",
    "plot",
    "read_blocks",
    "read_campaign",
    "read_record",
    "read_records",
    "read_reduced",
    "recommendation",
    "record",
    "report",
    "run",
    "simulate",
    "sweep_compliance",
    "tune",
]

_HOMES = {
    "process.cut.force": "CuttingCoefficients",
    "process.cut.tool": "Tool",
    "process.errors": "InputError",
    "process.machine.modes": "ModalModel",
    "smfe.arrays.compliances": "compliance",
    "smfe.arrays.recommendation": "recommendation",
    "smfe.arrays.records": "record",
    "smfe.campaign": "Campaign, load_campaign, load_campaign as read_campaign",
    "smfe.commands.chatter": "chatter",
    "smfe.commands.check": "check",
    "smfe.commands.coefficients": "Coefficients, coefficients",
    "smfe.commands.compare": "compare",
    "smfe.commands.cut.pitch": "pitch",
    "smfe.commands.files.convert": "convert",
    "smfe.commands.demo": "demo",
    "smfe.commands.diagnose": "diagnose",
    "smfe.commands.files.export": "export",
    "smfe.commands.identify": "identify",
    "smfe.commands.lobes": "lobes",
    "smfe.commands.files.look": "look",
    "smfe.commands.many.catalogue": "catalogue",
    "smfe.commands.many.run": "run",
    "smfe.commands.modal": "modal",
    "smfe.commands.plan": "plan",
    "smfe.commands.report": "report",
    "smfe.commands.simulate": "simulate",
    "smfe.commands.tune": "tune",
    "smfe.identification.actuator.stepped_sine": "identify_actuator, identify_actuator as actuator_compliance",
    "smfe.identification.drive.friction": (
        "constant_force, fit_coulomb_curve, fit_friction_curve, fit_friction_record, friction_runs"
    ),
    "smfe.identification.drive.open_loop": "fit_open_loop, open_loop_response",
    "smfe.identification.errors.intervals": "interval",
    "smfe.identification.errors.result": "Identification",
    "smfe.identification.hammer.hammer": "identify_hammer, identify_hammer as hammer_compliance",
    "smfe.identification.sweep.local_polynomial": "LocalPolynomial",
    "smfe.identification.sweep.passes": "SweepPass",
    "smfe.identification.sweep.segments": "Segments, SingleReference",
    "smfe.identification.sweep.sweep": "identify_sweep, identify_sweep as sweep_compliance",
    "smfe.limits.campaign_lobes": "LobeResult",
    "smfe.limits.recommendation": "Recommendation",
    "smfe.modes.fit_modes": "ModalFit, fit_modes",
    "smfe.notebook": "plot",
    "smfe.progress": "SmfeWarning",
    "smfe.records": "Channel, read_blocks, read_record, read_records, read_reduced",
    "smfe.records.look": "Look",
}
"""Module -> the names that it gives; `__all__` and the imports for the type checker say the same."""

if not TYPE_CHECKING:  # a type checker takes the imports above, and so finds a name that is not there
    __getattr__, __dir__ = lazy(__name__, _HOMES, {"xarray": "smfe.notebook"})
