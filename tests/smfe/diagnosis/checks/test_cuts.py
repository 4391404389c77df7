"""Claims: a wrong number of teeth and a wrong clock are found, and run-out and modes are not taken for them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import xarray as xr
from truth import workshop

from process.cut.engagement import CUTS, Engagement, engagement
from process.cut.tool import Tool
from process.labels import make_record
from smfe.diagnosis.checks.cuts import clock_suspects, tooth_suspects
from smfe.identification.sweep.passes import in_cut

RATE, RPM = 3000.0, 1200.0


def turning(seed: int, arc: Engagement | None = None, **tool: float) -> tuple[xr.Dataset, Tool, Engagement]:
    """Forces of a steady cut with run-out, its tool and its arc."""
    rng = np.random.default_rng(seed)
    drawn = {"teeth": int(rng.integers(2, 8)), "runout": rng.uniform(0.0, 0.6)} | tool
    material = {"Ktc": 1900.0, "Krc": rng.uniform(200.0, 900.0), "Kac": rng.uniform(0.0, 400.0)}
    shop = SimpleNamespace(tool=drawn, material=material)
    drawn_arc = engagement(str(rng.choice(CUTS)), 0.1 * rng.uniform(0.05, 1.0), 0.1)
    arc = arc or drawn_arc
    t = np.arange(round(40.0 * 60.0 / RPM * RATE)) / RATE
    force = workshop.chip_force(shop, 2.0 * np.pi * RPM / 60.0 * t, (arc.entry, arc.exit), 2e-3, 1e-4)
    force += 0.01 * np.abs(force).max() * rng.standard_normal(force.shape)
    return make_record(t, {"force": dict(zip("xyz", force, strict=True))}), Tool(0.1, drawn["teeth"]), arc


def test_run_out_is_no_wrong_number_of_teeth_where_the_arc_hardly_has_the_teeth() -> None:
    # The force of four teeth in a slot is constant: at the orders of the spindle only run-out is left.
    record, tool, arc = turning(1, engagement("down", 0.1, 0.1), teeth=4, runout=0.6)
    assert not list(tooth_suspects(record, "cut", RPM, tool, arc))


def test_air_between_teeth_that_cut_one_by_one_belongs_to_the_cut() -> None:
    # In an arc of 55 deg four teeth cut 60 % of the time; with the air between them left out, order 4 becomes order 5.
    shop = SimpleNamespace(tool={"teeth": 4, "runout": 0.05}, material={"Ktc": 1600.0, "Krc": 780.0, "Kac": 230.0})
    arc, t = engagement("down", 0.0172, 0.08), np.arange(round(40.0 * 60.0 / 139.0 * 256.0)) / 256.0
    force = workshop.chip_force(shop, 2.0 * np.pi * 139.0 / 60.0 * t, (arc.entry, arc.exit), 0.57e-3, 8e-5)
    force[:, [*range(200), *range(t.size - 200, t.size)]] = 0.0
    force += 0.01 * np.abs(force).max() * np.random.default_rng(1).standard_normal(force.shape)
    record = make_record(t, {"force": dict(zip("xy", force, strict=False))})
    assert np.mean(in_cut(record)) < 0.9
    assert not list(tooth_suspects(record, "cut", 139.0, Tool(0.08, 4), arc))


def test_a_wrong_number_of_teeth_is_said_and_run_out_is_not() -> None:
    said = []
    for seed in range(25):
        record, tool, arc = turning(seed)
        assert not list(tooth_suspects(record, f"cut {seed}", RPM, tool, arc))
        said += [any(tooth_suspects(record, "cut", RPM, replace(tool, teeth=tool.teeth + 1), arc))]
    assert np.mean(said) > 0.6


def test_an_order_that_a_mode_amplifies_is_no_number_of_teeth() -> None:
    # Run-out of 30 % at order 5, where a mode amplifies it fiftyfold; the teeth are at 4, 8 and 12.
    t = np.arange(round(40.0 * 60.0 / RPM * RATE)) / RATE
    sizes = {4: 1.0, 8: 0.7, 12: 0.5, 5: 15.0, 10: 0.05, 9: 0.2, 11: 0.15, 3: 0.3, 7: 0.2}
    motion = sum(a * np.cos(2.0 * np.pi * RPM / 60.0 * n * t + n) for n, a in sizes.items())
    record = make_record(t, {"acceleration": {"x": motion}})
    assert not list(tooth_suspects(record, "cut", RPM, Tool(0.1, 4), engagement("down", 0.03, 0.1)))
    sizes |= {10: 5.0, 4: 0.1, 8: 0.1, 12: 0.1}
    motion = sum(a * np.cos(2.0 * np.pi * RPM / 60.0 * n * t + n) for n, a in sizes.items())
    (found,) = tooth_suspects(
        make_record(t, {"acceleration": {"x": motion}}), "cut", RPM, Tool(0.1, 4), engagement("down", 0.03, 0.1)
    )
    assert "order 5 of the spindle" in found.evidence


def test_a_clock_that_runs_fast_moves_the_tooth_passing_line() -> None:
    rng, rate = np.random.default_rng(0), 2000.0
    t = np.arange(16000) / rate
    for error, expected in ((0.0, set()), (0.01, {"time_skew"})):
        channels = {name: {axis: rng.standard_normal(16000) for axis in "xyz"} for name in ("force", "acceleration")}
        channels["force"]["x"] = 100.0 * np.sin(2 * np.pi * 80.0 * (1.0 + error) * t)
        record = make_record(t, channels)
        record["spindle_speed"] = ("time", np.full(16000, 1200.0), {"units": "rpm"})
        assert {s.cause for s in clock_suspects(record, "cut", 4)} == expected


def test_a_chatter_line_beside_the_teeth_says_nothing_of_the_clock() -> None:
    # Four teeth at 600 rpm; chatter at 38.3 Hz, its multiples of the spindle order about the teeth, six times as large.
    rng, rate = np.random.default_rng(3), 2000.0
    t = np.arange(16000) / rate
    for clock, chatter, expected in ((1.0, 60.0, set()), (0.957, 0.0, {"time_skew"})):
        force = 2.0 * rng.standard_normal((3, t.size))
        for h in (1, 2, 3):
            force[0] += 20.0 / h * np.cos(2 * np.pi * 40.0 * h * clock * t + h)
            force[1] += chatter / h * np.cos(2 * np.pi * 38.3 * h * clock * t + 2 * h)
        record = make_record(t, {"force": dict(zip("xyz", force, strict=True))})
        record["spindle_speed"] = ("time", np.full(t.size, 600.0), {"units": "rpm"})
        assert {s.cause for s in clock_suspects(record, "cut", 4)} == expected, (clock, chatter)


def test_run_out_where_the_teeth_should_pass_does_not_excuse_a_wrong_clock() -> None:
    # Twenty teeth that pass at 80 20/21 Hz where 80 are stated: run-out has its order 21 at 80 Hz.
    rng, rate = np.random.default_rng(4), 2000.0
    t, turns = np.arange(32000) / rate, 80.0 / 21.0
    force = 2.0 * rng.standard_normal((3, t.size))
    for order, size in ((1, 5.0), (20, 60.0), (21, 8.0), (40, 30.0), (60, 15.0)):
        force[0] += size * np.cos(2 * np.pi * turns * order * t + order)
    record = make_record(t, {"force": dict(zip("xyz", force, strict=True))})
    record["spindle_speed"] = ("time", np.full(t.size, 240.0), {"units": "rpm"})
    assert {s.cause for s in clock_suspects(record, "cut", 20)} == {"time_skew"}
