"""The machines of Section 2 as scenarios: what motion does to them, in closed form from the files."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from places import DATASETS

from process.machine.machine import Machine
from process.types import Complex, Real
from process.units import parse
from smfe.scenario.scenario import load_scenario

FOLDER = DATASETS / "scenarios" / "paper"
FREQUENCY = np.arange(5.0, 130.0, 0.1)
AXES = {"x": 0, "y": 1, "z": 2}


@cache
def machine(name: str) -> Machine:
    found = load_scenario(FOLDER / f"{name}.toml").machine
    assert isinstance(found, Machine)
    return found


@cache
def compliance(name: str, feed: float) -> Complex:
    """Compliance at a feed [mm/min] of all axes, which must be steady there."""
    point = machine(name).at(parse(f"{feed} mm/min", "speed"))
    assert point.unstable_poles() == 0, (name, feed)
    return point.matrix(FREQUENCY)


def size(matrix: Complex, entry: str, low: float = 5.0, high: float = 130.0) -> tuple[float, float]:
    """Frequency [Hz] and height [m/N] of the highest peak of an entry between two frequencies."""
    one: Real = np.abs(matrix[:, AXES[entry[0]], AXES[entry[1]]])
    inside = np.where((low <= FREQUENCY) & (high >= FREQUENCY), one, 0.0)
    k = int(inside.argmax())
    return float(FREQUENCY[k]), float(inside[k])


def change(name: str, entry: str, feed: float = 500.0) -> tuple[float, float]:
    """Relative change of frequency and height of the main peak from rest to a feed."""
    rest, moving = size(compliance(name, 0.0), entry), size(compliance(name, feed), entry)
    return moving[0] / rest[0] - 1.0, moving[1] / rest[1] - 1.0


def step(name: str, entry: str, one: float, other: float) -> float:
    """Largest change of an entry between two feeds, of the peak at the first."""
    i, j = AXES[entry[0]], AXES[entry[1]]
    before, after = compliance(name, one)[:, i, j], compliance(name, other)[:, i, j]
    return float(np.abs(after - before).max() / np.abs(before).max())


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_a_machine_of_the_paper_fits_on_two_pages_and_says_what_is_chosen(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 120
    magnitudes = [line for line in lines if line.startswith(("moving_mass", "controllers", "coupling", "impulse"))]
    assert magnitudes
    if path.stem.startswith("bench"):  # Tables 1 and 2 give its magnitudes
        assert any("chosen" in line for line in lines)
    else:
        assert all("chosen" in line for line in magnitudes)


def test_the_robot_loses_half_when_brakes_are_released_and_three_quarters_in_motion() -> None:
    braked = size(machine("robot").idle_compliance(FREQUENCY), "zz")
    energised, moving = size(compliance("robot", 0.0), "zz"), size(compliance("robot", 10.0), "zz")
    assert energised[1] / braked[1] - 1.0 == pytest.approx(-0.50, rel=0.05)
    assert moving[1] / braked[1] - 1.0 == pytest.approx(-0.77, rel=0.05)


def test_the_turret_changes_at_its_main_resonance_and_below_50_hz() -> None:
    rest, moving = compliance("lathe_turret", 0.0), compliance("lathe_turret", 500.0)
    assert size(rest, "zz")[0] == pytest.approx(95.0, abs=0.5)
    # Slide and turret free of each other's hold: sqrt(1 + m_tip/m_slide) times 95 Hz.
    assert size(moving, "zz", 80.0)[0] == pytest.approx(95.0 * np.sqrt(1.0 + 250.0 / 900.0), rel=0.02)
    assert size(moving, "zz", 80.0)[1] < 0.5 * size(rest, "zz")[1]
    assert size(moving, "zz", 5.0, 50.0)[1] > 3.0 * size(rest, "zz", 5.0, 50.0)[1]


def test_yy_changes_and_cross_terms_are_more_damped_in_the_first_two_columns() -> None:
    for name, damped in (("column_1", ("xy", "yx")), ("column_2", ("xy", "yx", "yz", "zy"))):
        assert change(name, "yy")[1] < -0.4, name
        assert all(change(name, entry)[1] < -0.4 for entry in damped), name
        assert abs(change(name, "xx")[1]) < 0.05, name


def test_column_3_changes_from_25_mm_per_min_and_no_more_above_500() -> None:
    assert step("column_3", "yy", 0.0, 25.0) > 0.5
    assert change("column_3", "yy", 25.0)[0] < -0.03  # frequency and amplitude change
    assert step("column_3", "yy", 25.0, 250.0) > 0.3
    assert 0.001 < step("column_3", "yy", 250.0, 500.0) < 0.02
    assert step("column_3", "yy", 500.0, 1000.0) < 0.001
    assert all(change("column_3", entry)[1] < -0.3 for entry in ("yy", "xy", "yx", "yz"))


def test_portal_1_loses_its_main_peak_in_x_and_gains_a_second_one() -> None:
    rest, moving = compliance("portal_1", 0.0), compliance("portal_1", 500.0)
    main, second = (12.0, 21.0), (22.0, 32.0)
    assert size(rest, "xx") == size(rest, "xx", *main)
    assert size(moving, "xx", *main)[1] < 0.35 * size(rest, "xx", *main)[1]
    assert size(moving, "xx", *second)[1] > 1.25 * size(rest, "xx", *second)[1]
    assert abs(size(moving, "xx", *second)[0] - size(rest, "xx", *second)[0]) > 0.5
    frequency, height = change("portal_1", "yy")
    assert frequency < -0.05
    assert height < -0.25


def test_portal_2_loses_60_percent_in_x_though_x_does_not_move() -> None:
    assert set(machine("portal_2").axes) == {"y", "z"}
    frequency, height = change("portal_2", "xx")
    assert height == pytest.approx(-0.60, rel=0.05)
    assert -0.1 < frequency < -0.02
    assert step("portal_2", "xx", 250.0, 1000.0) < 0.02  # it converges to one response in motion
