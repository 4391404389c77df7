"""The report has compliances over force level and feed (conditions.nc), and says what they do."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance
from smfe.identification.levels import stack_conditions
from smfe.reporting import write_report
from smfe.reporting.content.conditions import cubes, largest_changes
from smfe.results import read_groups, write_groups

GRID = np.arange(20.0, 120.0, 0.25)


def machine(level: float, feed: float) -> xr.Dataset:
    """One mode whose joint gives way: 4 % lower, 1.5 times as damped at ten times the force; the feed damps it more."""
    share = np.log10(level / 40.0)
    natural, damping = 61.0 * 0.96**share, 0.02 * 1.5**share * (1.0 + feed / 1000.0)
    values = 1e-7 / (1.0 - (GRID / natural) ** 2 + 2j * damping * GRID / natural)
    std = (("frequency", "response", "excitation"), np.full((GRID.size, 1, 1), 2e-8))
    return make_compliance(GRID, values[:, None, None], "x", "x", {"compliance_std": std})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    cells = [
        ({"force_level": level, "feed": feed}, machine(level, feed)) for level in (40.0, 400.0) for feed in (0.0, 500.0)
    ]
    write_groups(tmp_path / "frf.nc", {"tap": machine(40.0, 0.0).assign_attrs(method="hammer")})
    by_level = [({"force_level": level}, machine(level, 0.0)) for level in (40.0, 125.0, 400.0)]
    groups = {"hammer, controller K2": stack_conditions(cells), "tap, by level": stack_conditions(by_level)}
    write_groups(tmp_path / "conditions.nc", groups)
    return tmp_path


def test_each_set_has_a_figure_in_the_page_and_as_a_picture(folder: Path) -> None:
    page = write_report(folder).read_text(encoding="utf-8")
    assert {p.name for p in (folder / "figures").iterdir()} == {
        "compliance.png",
        "conditions_1.png",
        "conditions_2.png",
    }
    assert 'id="plot-cube-1"' in page
    assert "hammer, controller K2" in page
    # 1 / (2 damping stiffness): 2.5 um/N at the lowest damping, 1.11 at three times of it and a half more.
    assert "Largest magnitude of xx: from 1.11 µm/N at 58.5 Hz (400 N, 500 mm/min) to 2.5 µm/N at 61 Hz" in page
    # A later run without them takes the pictures away.
    (folder / "conditions.nc").unlink()
    page = write_report(folder).read_text(encoding="utf-8")
    assert "plot-cube" not in page
    assert {p.name for p in (folder / "figures").iterdir()} == {"compliance.png"}


def test_colour_stands_for_the_level_and_dashes_for_the_feed(folder: Path) -> None:
    first, second = cubes(read_groups(folder / "conditions.nc"))
    assert [cell.name for cell in first.cells] == [
        "40 N, 0 mm/min",
        "40 N, 500 mm/min",
        "400 N, 0 mm/min",
        "400 N, 500 mm/min",
    ]
    looks = [first.looks[cell.name] for cell in first.cells]
    assert looks[0].colour == looks[1].colour != looks[2].colour == looks[3].colour
    assert [look.dash for look in looks] == ["solid", "dash", "solid", "dash"]
    assert len({second.looks[cell.name].colour for cell in second.cells}) == 3
    assert len(largest_changes(second)) == 1


def test_a_combination_that_was_not_measured_has_no_line(folder: Path) -> None:
    missing = [({"force_level": a, "feed": b}, machine(a, b)) for a, b in ((40.0, 0.0), (400.0, 0.0), (400.0, 500.0))]
    (cube,) = cubes({"hammer": stack_conditions(missing)})
    assert [cell.name for cell in cube.cells] == ["40 N, 0 mm/min", "400 N, 0 mm/min", "400 N, 500 mm/min"]


def test_a_file_of_something_else_is_refused(folder: Path) -> None:
    write_groups(folder / "conditions.nc", {"tap": machine(40.0, 0.0)})
    with pytest.raises(InputError, match="'tap' has no compliance over a force level or feed"):
        write_report(folder)
