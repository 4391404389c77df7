"""How many files a result passes on its way: what somebody who follows it has to open."""

from __future__ import annotations

import importlib
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from samples.linear_machine import MACHINE, MATERIAL

import process
import smfe
import stability
from process.cut.engagement import engagement
from process.cut.tool import Tool
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from smfe.records import write_record_netcdf
from smfe.results import read_groups

PACKAGES = [Path(str(p.__file__)).parent for p in (process, stability, smfe)]

CAMPAIGN = """
[campaign]
name = "one sweep"
[tool]
diameter = "80 mm"
teeth = 2
[material]
Ktc = "1889 N/mm2"
Krc = "806 N/mm2"
Kac = "291 N/mm2"
[[measurement]]
name = "sweep"
method = "sweep"
frequency_range = ["25 Hz", "45 Hz"]
resolution = "1 Hz"
records = [
    { file = "down.nc", cut = "down", width_of_cut = "12 mm" },
    { file = "up.nc", cut = "up", width_of_cut = "12 mm" },
    { file = "central.nc", cut = "central", width_of_cut = "12 mm" },
]
[[lobes]]
method = "zero_order"
measurements = ["sweep"]
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["600 rpm", "1500 rpm"]
"""


def files_passed(action: Callable[[], object]) -> dict[str, set[str]]:
    """Return the files of the three packages of which a function was executed, each with these functions."""
    seen: dict[str, set[str]] = defaultdict(set)
    roots = tuple(str(p) for p in PACKAGES)

    def called(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and (file := frame.f_code.co_filename).startswith(roots):
            seen[file].add(frame.f_code.co_name)

    before = sys.getprofile()
    sys.setprofile(called)
    try:
        action()
    finally:
        sys.setprofile(before)
    home = PACKAGES[0].parent
    return {str(Path(file).relative_to(home)): names for file, names in sorted(seen.items())}


def described(passed: dict[str, set[str]]) -> str:
    """Return a line a file with the number of its functions and the first of them."""
    lines = [f"{file}: {len(names)} ({', '.join(sorted(names)[:4])})" for file, names in passed.items()]
    return "\n".join([f"{len(passed)} files:", *lines])


def test_a_sweep_record_passes_few_files_on_its_way_to_the_lobe_table(tmp_path: Path) -> None:
    for cut in ("down", "up", "central"):
        mill = MillingCut(Tool(0.08, 2, np.pi / 4), engagement(cut, 0.012, 0.08), MATERIAL, 1e-3, feed_rate=2e-3)
        record = simulate_milling(MACHINE, mill, Spindle(20.0 * np.pi, 3.0), 12.0, 400.0, 0.5, 2.0)
        rng = np.random.default_rng(1)
        record["acceleration"] = record["acceleration"] + 3e-3 * rng.standard_normal(record["acceleration"].shape)
        write_record_netcdf(record.drop_vars("displacement"), tmp_path / f"{cut}.nc")
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(CAMPAIGN, encoding="utf-8")

    def to_lobes() -> None:
        smfe.identify(campaign, tmp_path / "frf.nc")
        smfe.lobes(campaign, tmp_path / "lobes.nc", tmp_path / "lobes.csv", tmp_path / "frf.nc")

    for name in ("commands.run", "commands.lobes", "notebook"):  # importing at the first use would count as passing
        importlib.import_module(f"smfe.{name}")
    passed = files_passed(to_lobes)
    assert (tmp_path / "lobes.csv").is_file()
    # Those that no sweep can do without: the test must see them, or it counts nothing.
    for needed in ("sweep.py", "local_polynomial.py", "noise.py", "passes.py"):
        assert str(Path("smfe", "identification", "sweep", needed)) in passed
    assert len(passed) <= MOST_FILES, described(passed)
    # The same passes in memory give the same compliance.
    passes = []
    for cut in ("down", "up", "central"):
        held = smfe.read_record(tmp_path / f"{cut}.nc", {})
        passes.append(held.assign_attrs(cut=cut, width_of_cut_mm=12.0))
    settings = {"frequency_range": (25, 45), "resolution": 1.0, "tool": Tool(0.08, 2)}
    found = smfe.identify(passes, method="sweep", **settings).compliance
    kept = read_groups(tmp_path / "frf.nc")["sweep"]
    for name in ("compliance", "compliance_std"):
        np.testing.assert_allclose(found[name].values, kept[name].values, rtol=1e-12)


MOST_FILES = 55
"""Campaign 5, commands 2, records 8, sweep 9, its results 8, kept 2, cut and vocabulary 9, stability 9, limits 3."""
