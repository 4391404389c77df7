"""What a notebook shows of a tool, cutting coefficients and modes; texts with units where numbers are SI."""

import math
from dataclasses import replace

import pytest

from process import CuttingCoefficients, ModalModel, Tool
from process.errors import InputError
from process.notebook import html_table
from process.units import si

TOOL = Tool("80 mm", 2, "45 deg", pitch_angles=("170 deg", "190 deg"), runout=("4 um", -4e-6))


def test_texts_with_units_make_the_same_tool_as_numbers_in_si() -> None:
    angles = (math.radians(170.0), math.radians(190.0))
    same = Tool(0.08, 2, math.radians(45.0), angles, (4e-6, -4e-6))
    assert (TOOL, hash(TOOL)) == (same, hash(same))
    assert replace(TOOL, diameter=0.05) == replace(same, diameter="50 mm")  # type: ignore[arg-type]
    steel = CuttingCoefficients("1900 N/mm^2", 800e6, "300 N/mm^2", "60 N/mm")
    assert steel == CuttingCoefficients(1900e6, 800e6, 300e6, 60e3)


@pytest.mark.parametrize("wrong", ["80", "80 N", True, None, [0.08]])
def test_what_is_no_quantity_is_refused_with_an_example(wrong: object) -> None:
    with pytest.raises(InputError, match="mm"):
        si(wrong, "length")  # type: ignore[arg-type]


def test_a_notebook_sees_each_quantity_with_its_unit() -> None:
    shown = TOOL._repr_html_()
    for part in (">80<", ">mm<", ">45<", "170, 190", "4, -4", "µm"):
        assert part in shown
    assert ">1900</td><td>N/mm^2<" in CuttingCoefficients("1900 N/mm^2", 0.0, 0.0)._repr_html_()
    modes = ModalModel([61.4], [0.012], [1.68e6], [[1.0, 0.0, 0.0]])._repr_html_()  # type: ignore[arg-type]
    assert ">61.4</td><td>1.2</td><td>1.68</td>" in modes
    assert "stiffness [N/µm]" in modes


def test_names_of_users_are_no_html() -> None:
    assert "<script>" not in html_table("<script>", [("<script>", "<script>")], ["<script>"], ["<script>"])
