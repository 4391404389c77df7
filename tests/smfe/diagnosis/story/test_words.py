"""Claims: nothing of a catalogue reaches a sentence by its name in the code; numbers keep two digits of doubt."""

import math
import re

import numpy as np
import pytest
from exam.records import baseline

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits
from smfe.diagnosis.drive import terms
from smfe.diagnosis.drive.terms import HIDDEN_COMMAND
from smfe.diagnosis.frf.causes import modal_causes, sensor_causes
from smfe.diagnosis.inference.problem import Cause, Parameter
from smfe.diagnosis.judgement.finding import Estimate, FoundCause
from smfe.diagnosis.story.causes import numbers_of, row_of
from smfe.diagnosis.story.words import in_words, parameter_words, with_interval

TOOL = Tool(0.08, 4)
MODES = ModalModel(np.array([60.0, 90.0]), np.array([0.03, 0.04]), np.array([2e7, 3e7]), np.eye(3)[:2])


def catalogues() -> tuple[list[Parameter], list[Cause]]:
    """Every parameter and every cause of every family."""
    axis, arc = baseline(), engagement("down", 0.04, 0.08)
    forces = CuttingForces(TOOL, (2e9, 8e8, 3e8), ())
    limits = CuttingLimits(MODES, TOOL, arc, CuttingCoefficients(2e9, 8e8, 3e8), ())
    moves = [*terms.always(0.0, 1.0, 90.0, 0.2), terms.ripple(2.5e-3, 0.0, False), terms.tone(50.0, 20.0)]
    moves.append(terms.hidden_force([(0.0, 1.0, 1.0)]))
    causes = [
        *axis.causes(),
        *sensor_causes((5.0, 200.0)),
        *modal_causes((1, 2, 3), (10.0, 200.0), 1e-6, 0.5, 4),
        *forces.causes,
        *limits.causes,
        *(t.cause for t in moves),
        HIDDEN_COMMAND,
        terms.saturation(100.0, 80.0),
    ]
    parameters = [*axis.nuisances(), *forces.nuisances, *limits.nuisances, *(p for c in causes for p in c.parameters)]
    return parameters, causes


PARAMETERS, CAUSES = catalogues()
CODE = re.compile(r"_|[a-z]\.[a-z]|\{|\}|None|\bnan\b")


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_every_parameter_has_words(parameter: Parameter) -> None:
    words = parameter_words(parameter.name)
    assert not CODE.search(words)
    coded = "_" in parameter.name or "." in parameter.name
    assert in_words(f"{parameter.name} ends on the limit") == f"{words if coded else parameter.name} ends on the limit"


@pytest.mark.parametrize("intervals", [False, True])
@pytest.mark.parametrize("cause", CAUSES, ids=lambda c: c.key)
def test_every_cause_is_told_without_a_name_of_the_code(cause: Cause, intervals: bool) -> None:
    estimates = tuple(
        Estimate(p.name, sign * 1.234, sign * 1.234 - 0.1, sign * 1.234 + 0.1, p.unit)
        for p, sign in zip(cause.parameters, (1.0, -1.0) * 9, strict=False)
    )
    found = FoundCause(cause.id, cause.variant, cause.title, cause.kind, estimates, 99.0, 3.0, 0.1)
    said = f"{row_of(found).name}: {numbers_of(found, intervals)}"
    assert not CODE.search(said), said


def test_files_and_units_stay_as_they_are() -> None:
    text = "cut_500.csv has N/mm^2, friction_level changes with spindle_rpm and with order"
    assert in_words(text) == (
        "cut_500.csv has N/mm^2, level of the friction changes with spindle speed and with the order of the "
        "measurements"
    )


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "said"),
    [
        (0.82241, 0.798, 0.8469, "ms", "0.822 ms (0.798 to 0.847)"),
        (41.37, 38.2, 44.5, "N", "41.4 N (38.2 to 44.5)"),
        (8557.4, 8000.0, 9000.0, "N s/m", "8560 N s/m (8000 to 9000)"),
        (11.88, 11.463, 12.298, "um", "11.88 µm (11.46 to 12.30)"),
        (3.2, -math.inf, math.inf, "%", "3.20 % (not separable from others in these data)"),
        (3.2, math.nan, math.nan, "1", "3.20"),
    ],
)
def test_an_interval_has_two_digits_of_its_width(value: float, low: float, high: float, unit: str, said: str) -> None:
    assert with_interval(value, low, high, unit) == said
