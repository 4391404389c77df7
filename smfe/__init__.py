"""Machine-tool dynamics: records of a measuring campaign -> compliance -> stability lobes -> verdicts.

The verbs of the command line are functions: `run`, `demo`, `identify`, `lobes`, `chatter`, `convert`, `simulate` here,
and ``compare``, ``modal`` and ``report`` in `smfe.pipeline`, ``plan`` in `smfe.plan`, whose names are taken by what
does the work.
"""

# ruff: noqa: I001  (the version and the check for a foreign process.py come before everything that needs them)

import importlib.metadata

__version__ = importlib.metadata.version("smfe")

import stability  # noqa: F401  (fails with a clear sentence when a user's own process.py shadows ours)
from process.errors import InputError
from smfe.campaign import Campaign, load_campaign
from smfe.conversion import convert
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.actuator.stepped_sine import identify_actuator
from smfe.identification.errors.result import Identification
from smfe.identification.errors.intervals import interval
from smfe.limits.campaign_lobes import LobeResult
from smfe.cutting_coefficients import Coefficients, coefficients
from smfe.commands.look import look
from smfe.records.look import Look
from smfe.pipeline import chatter, demo, identify, lobes, run
from smfe.records import read_blocks, read_records, read_reduced
from smfe.scenario import simulate
from smfe.identification.sweep.sweep import identify_sweep
from smfe.identification.sweep.estimators import LocalPolynomial, Segments, SingleReference, SweepPass

__all__ = [
    "Campaign",
    "Coefficients",
    "Identification",
    "InputError",
    "LobeResult",
    "LocalPolynomial",
    "Look",
    "Segments",
    "SingleReference",
    "SweepPass",
    "__version__",
    "chatter",
    "coefficients",
    "convert",
    "demo",
    "identify",
    "identify_actuator",
    "identify_hammer",
    "identify_sweep",
    "interval",
    "load_campaign",
    "lobes",
    "look",
    "read_blocks",
    "read_records",
    "read_reduced",
    "run",
    "simulate",
]
