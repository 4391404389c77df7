"""A quantity is a number with a unit; the unit decides the number."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from process.errors import InputError
from process.units import UNITS, factor, from_si, parse, show


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("125 mm", "length", 0.125),
        ("500 rpm", "rotation", 500 * 2 * math.pi / 60),
        ("500 mm/min", "speed", 500 * 1e-3 / 60),
        ("1900 N/mm^2", "pressure", 1.9e9),
        ("1900 N/mm2", "pressure", 1.9e9),
        ("30 N/mm", "line_force", 30e3),
        ("1.68 N/um", "stiffness", 1.68e6),
        ("45 deg", "angle", math.pi / 4),
        ("50 us", "time", 50e-6),
        ("-3.1 N/mm", "line_force", -3100.0),
        ("1e3 N", "force", 1000.0),
        ("9.8 m/s²", "acceleration", 9.8),
        (".5 Hz", "frequency", 0.5),
        ("60 in/min", "speed", 0.0254),
        ("60 ipm", "speed", 0.0254),
        ("100 psi", "pressure", 689475.729316836),
        ("1 lb", "mass", 0.45359237),
        ("1 lbf/in", "stiffness", 175.126835246476),
        ("1 in/lbf", "compliance", 1.0 / 175.126835246476),
        ("1 hp", "power", 745.69987158227),
        ("0.0028 N min/mm", "viscosity", 168.0),
        ("0.25 min/mm", "steepness", 15000.0),
    ],
)
def test_field_units_become_si(text: str, dimension: str, value: float) -> None:
    assert parse(text, dimension) == pytest.approx(value, rel=1e-14)


def test_g_is_a_gravity_as_acceleration_and_a_gram_as_mass() -> None:
    assert parse("1 g", "acceleration") == 9.80665
    assert parse("1 g", "mass") == 1e-3


@given(st.floats(1e-9, 1e9), st.sampled_from([(d, u) for d, table in UNITS.items() for u in table if u]))
def test_what_is_written_reads_back(value: float, unit: tuple[str, str]) -> None:
    dimension, name = unit
    assert parse(show(value, name, dimension, digits=15), dimension) == pytest.approx(value, rel=1e-12)
    assert from_si(value, name, dimension) * factor(name, dimension) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "dimension", "message"),
    [
        ("125", "length", "has no unit"),
        ("mm 125", "length", "not a number with a unit"),
        ("125 kg", "length", "not a unit of length"),
        ("1.2.3 mm", "length", "not a unit of length"),
        ("nan mm", "length", "not a number"),
        ("1e400 mm", "length", "'1e400 mm' is not finite"),
    ],
)
def test_a_quantity_without_sense_is_refused_with_the_units_that_fit(text: str, dimension: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(text, dimension)


def test_a_bare_number_is_refused() -> None:
    with pytest.raises(InputError, match="has no unit"):
        parse(125, "length")  # type: ignore[arg-type]


def test_every_dimension_has_exactly_one_si_unit() -> None:
    for dimension, table in UNITS.items():
        assert next(iter(table.values())) == 1.0, dimension
        assert all(np.isfinite(v) and v > 0 for v in table.values())
