"""Limits and cutting tests belong to one controller, one position, and the feed in the direction that it has."""

import math

import numpy as np
import pytest
from truth import operating_points

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_compliance
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, CuttingTest, LobeRequest, Measurement
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.cut_conditions import feed_of, sources_of, turned, turned_modes
from smfe.limits.cutting_tests import NOT_COMPARED, condition_warnings, predictions
from smfe.progress import silent

DIAMETER = 0.1


def measured(name, controller=None, position=None, feed=None, level=None, method="actuator", **more):
    axes = None if feed is None else {"x": 0.0, "y": 0.0, "z": 0.0, **feed}
    return Measurement(
        name=name, method=method, records=(), channels={}, controller=controller, position=position, feed=axes,
        force_level=level, **more,
    )  # fmt: skip


def asked(names, method="operating_point", direction=0.0, speeds=(600.0, 900.0, 1400.0)):
    return LobeRequest(tuple(names), method, "down", 0.05, 1e-4, np.array(speeds), feed_direction=direction)


def campaign(tmp_path, measurements, requests, tests=(), tool=None, work=None):
    return Campaign(
        tmp_path / "campaign.toml", "conditions", tool or Tool(DIAMETER, 4),
        work or CuttingCoefficients(1.9e9, 5e8, 0.0),
        measurements=tuple(measurements), lobes=tuple(requests), cutting_tests=tuple(tests),
    )  # fmt: skip


def cut(tmp_path, name="cut.csv", **said):
    return CuttingTest(tmp_path / name, {}, 900.0, 1e-3, "down", 0.05, 1e-4, **said)


def machine(frequency=60.0, damping=0.03, stiffness=1e7, direction=(1.0, 0.0, 0.0)):
    return ModalModel([frequency], [damping], [stiffness], [direction])


GRID = np.arange(30.0, 160.0, 0.25)
LINE = machine().compliance(GRID)


def limit_of_group(d, group, speed):
    return operating_points.limit(d, [t for t in d.taps if (t.controller, t.position) == group], speed)


@pytest.mark.parametrize("seed", [0, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 4, 5))])
def test_each_controller_position_and_direction_has_the_limit_of_brute_force(tmp_path, seed):
    d = operating_points.draw(seed)
    along = {"x": math.cos(d.direction), "y": math.sin(d.direction)}
    taps = [
        measured(t.name, t.controller, t.position, {a: u * t.feed / 6e4 for a, u in along.items()}, t.level)
        for t in d.taps
    ]
    found = {t.name: make_compliance(d.frequency, t.compliance, ("x", "y"), ("x", "y")) for t in d.taps}
    speeds = np.random.default_rng(1000 + seed).uniform(400.0, 2500.0, 2)
    request = LobeRequest(tuple(found), "operating_point", "down", d.width, d.feed_per_tooth, speeds, None, d.direction)
    tool, work = Tool(d.diameter, d.teeth), CuttingCoefficients(d.tangential, d.radial, 0.0)
    failures = []
    results = all_lobes(campaign(tmp_path, taps, [request], tool=tool, work=work), found, silent, failures)
    groups = {(t.controller, t.position) for t in d.taps}
    lost = [g for g in groups if all(math.isnan(limit_of_group(d, g, n)[0]) for n in speeds)]
    assert all("outside the measured" in f.reason for f in failures)
    assert len(failures) == len(lost)
    answered = {(r.lobes.attrs["controller"], r.lobes.attrs["position"]) for r in results}
    assert answered == groups - set(lost)
    for result in results:
        group = tuple(result.lobes.attrs[k] for k in ("controller", "position"))
        true = np.array([limit_of_group(d, group, n) for n in speeds])
        true = 1e3 * true[np.isfinite(true[:, 0])]
        np.testing.assert_allclose(result.lobes["limit_depth"], true[:, 0], rtol=0.01)
        if "lower_limit_depth" in result.lobes:
            np.testing.assert_allclose(result.lobes["lower_limit_depth"], true[:, 1], rtol=0.01)
        for key, at in (("controller", 0), ("position", 1)):
            several = len({g[at] for g in groups}) > 1
            assert (f"{key} {result.lobes.attrs[key]}" in result.source) == several
            assert set(result.table["source"]) == {result.source}


def test_a_mix_of_controllers_is_not_one_machine(tmp_path):
    # K2 is stiffer at every feed: half the compliance has twice the limit, and a mix has one between them.
    taps = [measured(f"{c}, {v}", c, feed={"x": v / 6e4}, level=100.0) for c in ("K1", "K2") for v in (0, 500)]
    found = {m.name: machine(stiffness=1e7 if m.controller == "K1" else 2e7).compliance(GRID) for m in taps}
    one, two = all_lobes(campaign(tmp_path, taps, [asked(found)]), found, silent)
    assert one.source == "K1, 0 + K1, 500, controller K1"
    assert two.source == "K2, 0 + K2, 500, controller K2"
    np.testing.assert_allclose(two.lobes["limit_depth"], 2.0 * one.lobes["limit_depth"], rtol=1e-9)
    alone = all_lobes(campaign(tmp_path, taps, [asked(["K1, 0", "K1, 500"])]), found, silent)[0]
    assert alone.source == "K1, 0 + K1, 500"
    np.testing.assert_array_equal(alone.lobes["limit_depth"], one.lobes["limit_depth"])
    assert (alone.lobes.attrs["controller"], one.lobes.attrs["controller"]) == ("K1", "K1")


def test_a_controller_that_is_not_stated_is_a_group_of_its_own(tmp_path):
    taps = [measured("a", "K1/2", "left"), measured("b", None, "left")]
    labels = [s.label for s in sources_of(campaign(tmp_path, taps, []), asked(["a", "b"]))]
    assert labels == ["a, controller K1 per 2", "b, controller not stated"]


@pytest.mark.parametrize("angle", [0.5 * math.pi, math.pi, 0.6, -2.0])
def test_what_a_feed_changes_is_read_along_the_feed(tmp_path, angle):
    # The same machine, turned with its motion: everything that a cut along x sees it sees along its own feed.
    def results(direction):
        feeds = [{"x": math.cos(direction) * v / 6e4, "y": math.sin(direction) * v / 6e4} for v in (0, 900)]
        taps = [measured(f"t{i}", feed=f, level=10.0) for i, f in enumerate(feeds)]
        moving = machine(damping=0.08, direction=(1.0, 0.4, 0.1)), machine(55.0, direction=(1.0, 0.4, 0.1))
        found = {f"t{i}": turned_modes(m, -direction).compliance(GRID) for i, m in enumerate(reversed(moving))}
        return all_lobes(campaign(tmp_path, taps, [asked(found, direction=direction)]), found, silent)[0]

    along_x, along = results(0.0), results(angle)
    np.testing.assert_allclose(along.lobes["limit_depth"], along_x.lobes["limit_depth"], rtol=1e-9)
    np.testing.assert_allclose(along.lobes["feed"], [0.1 * 4 * n for n in (600.0, 900.0, 1400.0)])
    assert along.lobes.attrs["feed_direction_deg"] == pytest.approx(math.degrees(angle))
    assert len(set(along_x.lobes["limit_depth"].values.round(3))) == 3


@pytest.mark.parametrize("method", ["zero_order", "multi_frequency", "semi_discretization"])
def test_every_method_sees_a_cut_along_y_as_one_along_x_of_the_turned_machine(tmp_path, method):
    taps = [measured("here"), measured("there")]
    modes = machine(direction=(1.0, 0.5, 0.0))
    found = {"here": modes.compliance(GRID), "there": turned_modes(modes, 0.5 * math.pi).compliance(GRID)}
    requests = [asked(["here"], method, 0.5 * math.pi), asked(["there"], method)]
    one, two = all_lobes(campaign(tmp_path, taps, requests), found, silent)
    np.testing.assert_allclose(one.lobes["limit_depth"], two.lobes["limit_depth"], rtol=1e-6)


def test_a_quarter_turn_leaves_missing_what_was_not_measured_and_an_oblique_one_says_what_it_lacks():
    two = make_compliance(GRID, machine().compliance(GRID, "x", "x")["compliance"].values, "x", "x")
    quarter, notes = turned(two, 0.5 * math.pi)
    assert (list(quarter["response"].values), list(quarter["excitation"].values), notes) == (["y"], ["y"], [])
    np.testing.assert_array_equal(quarter["compliance"].values, two["compliance"].values)
    oblique, (text,) = turned(two, 0.5)
    assert oblique["compliance"].shape[1:] == (2, 2)
    assert "no response y, z" in text
    assert "rigid" in text
    found = turned(LINE, 0.5)[0]["compliance"].values
    np.testing.assert_allclose(found[:, 0, 0], math.cos(0.5) ** 2 * LINE["compliance"].values[:, 0, 0])


def with_errors(values, std, axes="xyz"):
    return make_compliance(GRID, values, axes, axes, {"compliance_std": (("frequency", "response", "excitation"), std)})


def test_errors_turn_with_the_axes_in_closed_form():
    generator = np.random.default_rng(4)
    std = generator.uniform(1e-9, 2e-9, (GRID.size, 3, 3))
    here = with_errors(machine(direction=(1.0, 0.5, 0.0)).matrix(GRID), std)
    c, s = math.cos(0.5), math.sin(0.5)
    found = turned(here, 0.5)[0]
    # Independent entries: the variance of c^2 xx + c s (xy + yx) + s^2 yy, and of c xz + s yz.
    square = std**2
    xx = c**4 * square[:, 0, 0] + (c * s) ** 2 * (square[:, 0, 1] + square[:, 1, 0]) + s**4 * square[:, 1, 1]
    xz = c**2 * square[:, 0, 2] + s**2 * square[:, 1, 2]
    np.testing.assert_allclose(found["compliance_std"].values[:, 0, 0] ** 2, xx)
    np.testing.assert_allclose(found["compliance_std"].values[:, 0, 2] ** 2, xz)
    back = turned(found, -0.5)[0]
    np.testing.assert_allclose(back["compliance_std"], std, rtol=1e-9)
    # A quarter turn moves the errors from entry to entry; what was not measured stays so.
    two = with_errors(here["compliance"].values[:, :1, :1], std[:, :1, :1], "x")
    quarter = turned(two, 0.5 * math.pi)[0]
    np.testing.assert_allclose(quarter["compliance_std"].values, std[:, :1, :1])


def test_the_band_of_a_cut_along_y_is_that_of_one_along_x_of_the_turned_machine(tmp_path):
    values = machine(direction=(1.0, 0.5, 0.0)).matrix(GRID)
    std = np.full(values.shape, 0.005 * np.abs(values).max()) * np.array([[1.0, 0.5, 0.5], [0.5, 2.0, 0.5], [0.5] * 3])
    here = with_errors(values, std)
    found = {"here": here, "there": turned(here, 0.5 * math.pi)[0]}
    taps = [measured("here"), measured("there")]
    requests = [asked(["here"], "zero_order", 0.5 * math.pi), asked(["there"], "zero_order")]
    one, two = (r.table for r in all_lobes(campaign(tmp_path, taps, requests), found, silent))
    for name in ("limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"):
        assert one[name].notna().all()
        np.testing.assert_allclose(one[name], two[name], rtol=1e-6)
    assert (one["limit_depth_p95_mm"] > 1.05 * one["limit_depth_p05_mm"]).all()


def test_motions_that_are_not_that_of_the_cut_are_refused_and_the_other_sense_is_said(tmp_path):
    def joined(*feeds, direction=0.0):
        taps = [measured(f"t{i}", feed=f, level=10.0) for i, f in enumerate(feeds)]
        found = {m.name: LINE for m in taps}
        return all_lobes(campaign(tmp_path, taps, [asked(found, direction=direction)]), found, silent)[0].lobes

    rest, along, against, across = {}, {"x": 0.01}, {"x": -0.02}, {"y": 0.01}
    with pytest.raises(InputError, match=r"'t1' moves along y, and the cut is fed along x; .* feed_direction"):
        joined(rest, across)
    with pytest.raises(InputError, match="'t1' moves along x, and the cut is fed along 30 deg from x towards y"):
        joined(rest, along, direction=math.pi / 6)
    with pytest.raises(InputError, match="moves along the tool axis"):
        joined(rest, {"x": 0.01, "z": 0.01})
    with pytest.raises(InputError, match="'t1' does not say its feed, and others of this operating point do"):
        joined(along, None)
    with pytest.raises(InputError, match=r"'t0' and 't1' both have the feed 600 mm/min and level 10: leave one out"):
        joined(along, along)
    assert "t2 moved against the feed of the cut and is left out" in joined(rest, along, against).attrs["warnings"]
    assert "all motions are against the feed" in joined(rest, against).attrs["warnings"]
    # One speed for all axes has no direction of its own.
    assert joined(rest, {"x": 0.01, "y": 0.01, "z": 0.01}, direction=1.0).attrs["warnings"].count("against") == 0


def test_a_feed_is_a_vector_in_the_plane_of_the_table():
    assert feed_of({"x": 0.0, "y": 0.0, "z": 0.0}).speed == 0.0
    assert feed_of({"x": 3.0, "y": 4.0, "z": 0.0}).speed == pytest.approx(5.0)
    assert feed_of({"x": 0.0, "y": 0.0, "z": 0.01}) is None


# --- cutting tests ---------------------------------------------------------------------------------------------------


@pytest.fixture
def two_controllers(tmp_path):
    taps = [measured("of K1", "K1", "left"), measured("of K2", "K2", "left"), measured("plain")]
    found = {"of K1": LINE, "of K2": machine(stiffness=2e7).compliance(GRID), "plain": LINE}

    def make(*tests, names=("of K1", "of K2"), **more):
        return campaign(tmp_path, taps, [asked(names, "zero_order", **more)], tests), found

    return make


def test_a_cut_is_compared_with_what_was_measured_under_its_controller_and_at_its_position(tmp_path, two_controllers):
    test = cut(tmp_path, controller="K2", position="left")
    loaded, found = two_controllers(test)
    row = predictions(loaded, test, found)
    assert row["predicted_of K1"] == NOT_COMPARED
    assert math.isnan(row["limit_of K1_mm"])
    assert row["predicted_of K2"] in ("stable", "chatter")
    assert row["not_compared"] == "of K1: controller K1, the cut K2"
    assert condition_warnings(loaded) == ()
    elsewhere = cut(tmp_path, controller="K2", position="right")
    (text,) = condition_warnings(two_controllers(elsewhere)[0])
    assert text.startswith("cut.csv: no source of lobes belongs to it, so nothing is predicted (of K1: controller K1")
    assert "of K2: position left, the cut right" in text


def test_a_cut_that_states_no_controller_is_said_where_there_are_two(tmp_path, two_controllers):
    tests = [cut(tmp_path, f"{i}.csv") for i in range(3)]
    (text,) = condition_warnings(two_controllers(*tests)[0])
    assert text.startswith("3 cutting tests (0.csv, ...): states no controller, and the lobes are of K1 and K2")
    assert condition_warnings(two_controllers(*tests, names=("of K1", "plain"))[0]) == ()
    loaded, found = two_controllers(tests[0])
    row = predictions(loaded, tests[0], found)
    assert NOT_COMPARED not in (row["predicted_of K1"], row["predicted_of K2"])


def test_a_cut_along_y_is_predicted_in_its_own_axes_and_an_operating_point_only_along_its_motion(tmp_path):
    taps = [measured("rest", feed={}, level=1.0), measured("moving", feed={"x": 0.01}, level=1.0)]
    found = {"rest": machine(direction=(1.0, 0.2, 0.0)).compliance(GRID), "moving": LINE}
    test = cut(tmp_path, feed={"x": 0.0, "y": 6e-3, "z": 0.0})
    loaded = campaign(tmp_path, taps, [asked(["rest", "moving"]), asked(["rest"], "zero_order")], [test])
    row = predictions(loaded, test, found)
    assert row["predicted_rest + moving"] == NOT_COMPARED
    assert row["not_compared"] == "rest + moving: fed along x, the cut along y"
    turned_round = {"rest": turned(found["rest"], 0.5 * math.pi)[0]}
    along_x = cut(tmp_path)
    same = predictions(campaign(tmp_path, taps, [asked(["rest"], "zero_order")], [along_x]), along_x, turned_round)
    assert row["limit_rest_mm"] == pytest.approx(same["limit_rest_mm"], rel=1e-9)
    assert row["limit_rest_mm"] != pytest.approx(predictions(loaded, along_x, found)["limit_rest_mm"], rel=0.05)


def test_a_feed_that_speed_and_teeth_do_not_make_is_said(tmp_path, two_controllers):
    wrong = cut(tmp_path, controller="K2", feed={"x": 1e-3, "y": 0.0, "z": 0.0})
    (text,) = condition_warnings(two_controllers(wrong, names=("of K2",))[0])
    assert "states a feed of 60 mm/min, and its speed, teeth and feed_per_tooth make 360" in text
    right = cut(tmp_path, controller="K2", feed={"x": 6e-3, "y": 6e-3, "z": 6e-3})
    assert condition_warnings(two_controllers(right, names=("of K2",))[0]) == ()
