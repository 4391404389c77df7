"""Measured slot-milling forces (leekunhwee, ForceCalculation): five feeds at 6000 rpm, two teeth, 3 mm deep.

The authors say in comments that x and y of the dynamometer must be exchanged; nothing here assumes it. The fastest feed
is held out and predicted at the end.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from places import DATA

from process.cut.engagement import engagement
from process.cut.tool import Tool
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cutting.forces import CuttingForces, cutting_family, turned
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.cutting.rigid import rigid_orders
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.finding import Finding
from smfe.diagnosis.judgement.materiality import Worth
from smfe.diagnosis.story.sentences import explain
from smfe.records import Channel, read_records

FEEDS = (300, 600, 900, 1200, 1500)
CHANNELS = {"time": Channel("Time", "s"), **{f"force_{a}": Channel(f"F{a}", "N") for a in "xyz"}}
TOOL = Tool(diameter=0.025, teeth=2)
HANDBOOK = (900e6, 300e6, 150e6)
"""Aluminium, rounded [N/m2]."""


def record(feed: int) -> xr.Dataset:
    path = DATA / "milling_forces_ubc" / f"6-n6000f{feed}ap3ae25.csv"
    if not path.is_file():
        pytest.skip(f"{path} is not here; set SMFE_DATA to the folder of public data")
    (found,) = read_records(path, CHANNELS)
    return found


@pytest.fixture(scope="module")
def family() -> CuttingForces:
    rotation, arc = 6000.0 * math.pi / 30.0, engagement("down", 0.025, 0.025)
    cuts = {f"{f} mm/min": (record(f), SteadyCut(rotation, f / 60e3 / 200.0, 3e-3, arc)) for f in FEEDS}
    return cutting_family(cuts, TOOL, HANDBOOK, tolerances=Tolerances(coefficients=0.3), stated=True)


def test_the_records_are_steady_cuts_at_their_speed(family: CuttingForces) -> None:
    assert not family.suspects
    for condition in family.conditions:
        assert condition.data.cut.rotation * 30.0 / math.pi == pytest.approx(6000.0, rel=2e-4)


@pytest.fixture(scope="module")
def lines(family: CuttingForces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each order and axis a straight line over the feed, start angles free: intercept and slope, what was measured."""
    cuts = [c.data for c in family.conditions]
    design = np.stack([np.ones(len(FEEDS)), np.array(FEEDS) / 1e3], axis=1)
    values = np.stack([c.value for c in cuts])
    line = np.tile(values[-1], (len(FEEDS), 1, 1))
    for _ in range(30):
        aligned = np.stack([_aligned(c, p) for c, p in zip(cuts, line, strict=True)])
        slopes = np.linalg.lstsq(design, aligned.reshape(len(FEEDS), -1), rcond=None)[0]
        line = (design @ slopes).reshape(values.shape)
    return slopes.reshape(2, *values.shape[1:]), line, aligned


def test_no_model_linear_in_the_chip_explains_these_slots(lines: tuple) -> None:
    """What a line over the feed leaves of all orders together, over the alternating force: a tenth and more."""
    _, line, aligned = lines
    left = np.mean(0.5 * np.sum(np.abs(aligned - line)[:, 1:] ** 2, axis=1), axis=0) * 5.0 / (5.0 - 2.3)
    alternating = np.mean(0.5 * np.sum(np.abs(aligned[:, 1:]) ** 2, axis=1), axis=0)
    assert np.all(np.sqrt(left / alternating) > 1.8 * RULES.force_floor)


def test_what_remains_grows_with_the_chip_where_a_full_slot_gives_nothing(family: CuttingForces, lines: tuple) -> None:
    """Why no resonance and no edge names the remainder: neither makes of two teeth in a full slot what was measured.

    The chip of such teeth gives x and y the orders 0 and 2 alone, edge forces do not grow with the feed, and a sensor
    that vibrates multiplies what is not there. Measured is a slope over the feed at the orders 4 to 10.
    """
    (_, slope), _, _ = lines
    even = slice(4, 12, 2)
    measured = np.linalg.norm(slope[even, :2]) / np.linalg.norm(slope[2, :2])
    cut, values = family.conditions[0].data.cut, dict(zip(("Ktc", "Krc", "Kac"), HANDBOOK, strict=True))
    thin, thick = (
        rigid_orders(TOOL, replace(cut, feed_per_tooth=f), 13, values | {"helix": 0.0, "Kte": 3e4, "Kre": 3e4})
        for f in (5e-5, 1e-4)
    )
    slot = np.linalg.norm((thick - thin)[even, :2]) / np.linalg.norm((thick - thin)[2, :2])
    assert slot < 1e-9
    assert measured > 0.5


def _aligned(cut, line):
    """Turn a record to a line: the line turned to the record gives the angle."""
    here = turned(line, cut)
    shift = np.angle(np.sum((here[2] * line[2].conj())[:2])) / 2.0
    both = [np.exp(-1j * np.arange(len(line)) * (shift + half)) for half in (0.0, math.pi)]
    turn = max(both, key=lambda t: float(np.sum((cut.value * t[:, None] * line.conj())[1:].real)))
    return cut.value * turn[:, None]


@pytest.fixture(scope="module")
def finding(family: CuttingForces) -> Finding:
    return diagnose(family, worth=Worth(0.05), held_out=("1500 mm/min",))


@pytest.mark.slow
def test_exchanged_axes_run_out_and_edge_forces_are_found(finding: Finding) -> None:
    accepted = [r.change for r in finding.search_steps if r.accepted]
    assert accepted[:3] == ["+ sensor_axis/turned_over", "+ runout", "+ edge_forces"]
    values = {e.name: e.value for c in finding.causes for e in c.parameters}
    assert values["turned_over"] == pytest.approx(1.0, abs=0.15)
    assert 5.0 < values["runout"] < 30.0
    assert 10.0 < values["Kte"] < 50.0
    assert 10.0 < values["Kre"] < 50.0


@pytest.mark.slow
def test_the_gain_at_the_feed_that_was_held_out(finding: Finding) -> None:
    assert finding.held_out_gain is not None
    assert finding.held_out_gain.error_db > 3.0
    assert finding.misfit_before_db - finding.misfit_after_db > 6.0


@pytest.mark.slow
def test_what_remains_is_said(finding: Finding) -> None:
    """A rigid model behind a simple dynamometer misses more than the floor."""
    assert finding.verdict == "unknown"
    assert finding.remainder is not None
    assert finding.remainder.carriers
    assert "remainder" in explain(finding)
