"""The machines of Sections 2 and 6 as scenarios: what motion does to them, in closed form from the files."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from places import DATASETS

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.harmonic_balance.quasi_frf import quasi_compliance
from process.labels import make_compliance
from process.machine.machine import Machine
from process.types import Complex, Real
from process.units import parse
from smfe.scenario.scenario import load_scenario
from stability.methods.zero_order import zero_order

FOLDER = DATASETS / "scenarios" / "paper"
FREQUENCY = np.arange(5.0, 130.0, 0.1)
AXES = {"x": 0, "y": 1, "z": 2}


@cache
def machine(name: str) -> Machine:
    found = load_scenario(FOLDER / f"{name}.toml").machine
    assert isinstance(found, Machine)
    return found


@cache
def compliance(name: str, feed: float, controller: str | None = None) -> Complex:
    """Compliance at a feed [mm/min] of all axes, which must be steady there."""
    point = machine(name).at(parse(f"{feed} mm/min", "speed"), controller)
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
    at_rest = machine("robot").braked().at()
    braked = size(at_rest.matrix(FREQUENCY), "zz")
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


# --- The ram-type machine of Section 6.


def within_a_quarter(stated: float) -> object:
    return pytest.approx(stated, rel=0.25)


@pytest.mark.parametrize(
    ("entry", "frequency", "height"), [("yy", -0.061, 0.58), ("xy", -0.061, 0.368), ("zz", None, 0.28)]
)
def test_feed_softens_and_amplifies_the_mode_of_24_hz_of_the_ram(
    entry: str, frequency: float | None, height: float
) -> None:
    rest, moving = (size(compliance("ram", feed, "K1"), entry, 18.0, 26.0) for feed in (0.0, 560.0))
    assert rest[0] == pytest.approx(24.0, abs=0.15)
    assert moving[1] / rest[1] - 1.0 == within_a_quarter(height)
    if frequency is not None:
        assert moving[0] / rest[0] - 1.0 == within_a_quarter(frequency)


def test_feed_amplifies_the_ram_in_x_around_15_hz_and_leaves_the_mode_of_33_hz() -> None:
    rest, moving = compliance("ram", 0.0, "K1"), compliance("ram", 560.0, "K1")
    low = size(moving, "xx", 12.0, 19.5)
    assert 14.0 < low[0] < 18.0
    assert low[1] > 1.5 * size(rest, "xx", low[0] - 0.05, low[0] + 0.05)[1]
    assert size(rest, "xx")[0] == pytest.approx(33.5, abs=0.5)
    assert size(moving, "xx", 30.0)[1] == pytest.approx(size(rest, "xx")[1], rel=0.1)


def level(entry: str, frequency: Real, force: float, feed: dict[str, float], controller: str) -> tuple[float, float]:
    """Peak [Hz, m/N] of a stepped sine of constant force [N], by balance of the first harmonic."""
    one = quasi_compliance(
        machine("ram"), frequency, force, feed, controller, None, [entry[1]], [entry[0]], tolerance=1.0
    )
    assert one.attrs["status"] == "ok"
    height = np.abs(one["compliance"].values[:, 0, 0])
    return float(frequency[height.argmax()]), float(height.max())


@pytest.mark.parametrize(
    ("band", "stated"), [((22.7, 24.0), (-0.08, -0.16)), ((33.0, 34.0), (-0.084, -0.20))], ids=["24 Hz", "33 Hz"]
)
def test_the_actuator_at_rest_finds_lower_peaks_at_higher_force(
    band: tuple[float, float], stated: tuple[float, float]
) -> None:
    frequency = np.arange(*band, 0.15)
    least, *more = (level("xx", frequency, force, {}, "K1")[1] for force in (50.0, 100.0, 150.0))
    assert [peak / least - 1.0 for peak in more] == [within_a_quarter(change) for change in stated]


def test_in_the_cut_level_lowers_the_peak_in_x_but_not_in_z() -> None:
    # The sine of 110 N stands for the tooth passing of 1 mm: 100 N/mm in the down cut, 150 N/mm in the central one.
    moving = {"x": parse("560 mm/min", "speed")}
    least, *more = (
        level("xx", np.arange(32.6, 34.0, 0.1), 110.0 * depth, moving, "K2")[1] for depth in (1.0, 1.5, 2.0)
    )
    assert [peak / least - 1.0 for peak in more] == [within_a_quarter(change) for change in (-0.16, -0.27)]
    low, high = (level("zz", np.arange(21.0, 22.2, 0.4), force, moving, "K2")[1] for force in (30.0, 60.0))
    assert high == pytest.approx(low, rel=0.01)


def lobes(controller: str, feed: float | dict[str, float]) -> xr.Dataset:
    """Limits of the paper's cut, 125 mm, 8 inserts of 45 degrees in C45, at 300 to 700 rpm."""
    table = load_scenario(FOLDER / "ram.toml").file
    assert table.tool is not None
    assert table.material is not None
    frequency = np.arange(15.0, 90.0, 0.1)
    phi = make_compliance(frequency, machine("ram").at(feed, controller).matrix(frequency), "xyz", "xyz")
    tool = Tool("125 mm", 8, "45 deg")
    coefficients = CuttingCoefficients(table.material.Ktc, table.material.Krc, table.material.Kac)
    return zero_order(phi, tool, engagement("down", 0.08, 0.125), coefficients, [300.0, 400.0, 500.0, 600.0, 700.0])


def test_k2_cuts_deeper_than_k1_least_at_400_rpm_and_most_at_700() -> None:
    feed = {"x": parse("560 mm/min", "speed")}  # the cut feeds along x; y and z stand
    one, other = lobes("K1", feed), lobes("K2", feed)
    gain = (other["limit_depth"] / one["limit_depth"]).values - 1.0
    assert gain.argmin() == 1
    assert gain.argmax() == 4
    assert gain[1] == within_a_quarter(0.16)
    assert gain[4] == within_a_quarter(0.50)
    for limits in (one, other):
        assert np.all((limits["chatter_frequency"] > 28.5) & (limits["chatter_frequency"] < 37.0))


def test_the_hammer_with_all_axes_in_motion_underrates_k1_in_the_cut() -> None:
    feed = parse("560 mm/min", "speed")
    ratio = (lobes("K1", feed)["limit_depth"] / lobes("K1", {"x": feed})["limit_depth"]).values
    assert np.all(ratio[1:] < 0.85)
