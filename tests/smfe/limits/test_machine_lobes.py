"""Lobes of a machine with drive, friction and dead time by the methods for linear machines."""

import math

import numpy as np
import pytest
from truth import slot

import smfe
from process import Andersson, CuttingCoefficients, Drive, Machine, Servo, Tool, engagement
from process.errors import InputError
from smfe.campaign import campaign_of_tables
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.cutting_tests import NOT_COMPARED, predictions
from smfe.limits.source_modes import asked_cut
from smfe.progress import silent
from stability import cut_maps, operating_point

MM_MIN = 1.0 / 6e4
METHODS = ("zero_order", "multi_frequency", "semi_discretization")
TOOL, ARC, WORK = Tool(0.0508, 4), engagement("down", 0.0508, 0.0508), CuttingCoefficients(780e6, slot.RADIAL, 0.0)


def bench(controller, delay=0.0):
    servo = Servo(*slot.GAINS[controller], delay)
    return Machine.of_axis(
        Drive(slot.CARRIAGE, slot.TIP, slot.STIFFNESS, slot.DAMPING, servo), Andersson(*slot.FRICTION)
    )


def campaign(delay="0 ms", machine=None, tests=(), sources=("machine",), **request):
    names = ("coulomb", "static", "stribeck_speed", "sigma", "kt")
    gains = {name: dict(zip(("Kp", "Ti", "Kv"), slot.GAINS[name], strict=True)) for name in ("K2", "K3")}
    axis = {
        "moving_mass": slot.CARRIAGE, "tip_mass": slot.TIP, "stiffness": slot.STIFFNESS, "damping": slot.DAMPING,
        "friction": {"law": "andersson", **dict(zip(names, slot.FRICTION, strict=True))},
        "controllers": {name: {**servo, "delay": delay} for name, servo in gains.items()},
    }  # fmt: skip
    usual = {
        "measurements": list(sources), "cut": "down", "width_of_cut": 0.0508, "feed_per_tooth": 2e-4,
        "spindle_speed": ["1000 rpm", "2000 rpm", "250 rpm"],
    }  # fmt: skip
    return campaign_of_tables(
        {
            "tool": {"diameter": 0.0508, "teeth": 4},
            "material": {"Ktc": 780e6, "Krc": slot.RADIAL, "Kac": 0.0},
            "machine": {"axis": {"x": axis}, **(machine or {})},
            "lobes": [{**usual, **request}],
            **({"cutting_test": list(tests)} if tests else {}),
        },
        {"cut.csv": []},
    )


@pytest.mark.parametrize("delay", ["0 ms", "1.5 ms"])
@pytest.mark.parametrize("method", METHODS)
def test_in_a_slot_of_four_teeth_every_method_finds_the_limit_of_a_small_disturbance(method, delay):
    """There the directional factor is constant, zero order exact; the operating point has the dead time exactly."""
    speeds = ["1000 rpm", "2000 rpm", "500 rpm"]
    found = all_lobes(campaign(delay, method=method, spindle_speed=speeds), {}, silent)
    assert [r.source for r in found] == ["machine, controller K2", "machine, controller K3"]
    for result, name in zip(found, ("K2", "K3"), strict=True):
        speeds = result.lobes["spindle_speed"].values
        machine = bench(name, 1e-3 * float(delay.split()[0]))
        exact = operating_point(machine, TOOL, ARC, WORK, speeds, 2e-4)
        np.testing.assert_allclose(result.lobes["limit_depth"], exact["limit_depth"], rtol=3e-3)
        np.testing.assert_allclose(result.lobes["feed"], 2e-4 * 4 * speeds * 1e3)
        np.testing.assert_allclose(result.table["feed_mm_min"], result.lobes["feed"])
        assert result.in_motion
        assert any("small disturbance" in w for w in smfe.results.unpack_warnings(result.lobes))


@pytest.mark.parametrize(("controller", "share"), [("K2", 0.97), ("K2", 1.03), ("K3", 0.97), ("K3", 1.03)])
def test_a_tiny_push_grows_beyond_the_limit_only_in_an_integration_with_friction_as_it_is(controller, share):
    (found,) = all_lobes(campaign(method="semi_discretization", controller=controller), {}, silent)
    speed = 1250.0
    depth = share * 1e-3 * float(found.lobes["limit_depth"].sel(spindle_speed=speed))
    state = [0.0, 1e-6, 0.0, 0.0, 0.0]
    record, count = slot.cut(controller, 0.8 * speed * MM_MIN, speed, depth, 1.5, tip=lambda t: 0.0, state=state)
    size = slot.envelope(record, count)
    assert (size[-1] > size[size.size // 2]) == (share > 1.0)


def test_the_feed_makes_the_machine_and_its_limit():
    depth = {}
    for feed in ("100 mm/min", "800 mm/min"):
        (found,) = all_lobes(campaign(method="multi_frequency", feed=feed, controller="K3"), {}, silent)
        depth[feed] = found.lobes["limit_depth"].values
        rate = float(feed.split()[0]) * MM_MIN
        expected = operating_point(bench("K3"), TOOL, ARC, WORK, found.lobes["spindle_speed"].values, 2e-4, feed=rate)
        np.testing.assert_allclose(depth[feed], expected["limit_depth"], rtol=3e-3)
    assert np.abs(depth["100 mm/min"] / depth["800 mm/min"] - 1.0).max() > 0.01


def test_fed_along_y_it_is_the_same_machine_turned():
    """A machine that gives way in x alone, fed along -x: what turns by half a turn is itself."""
    (one,) = all_lobes(campaign(method="semi_discretization", controller="K3"), {}, silent)
    (other,) = all_lobes(campaign(method="semi_discretization", controller="K3", feed_direction="-x"), {}, silent)
    np.testing.assert_allclose(one.lobes["limit_depth"], other.lobes["limit_depth"], rtol=1e-3)


def test_stick_slip_has_no_limit_and_predicts_nothing():
    with pytest.raises(InputError, match=r"5 of 5 limits are not known.*uniform motion is unstable"):
        all_lobes(campaign(method="zero_order", feed="40 mm/min", controller="K2"), {}, silent)
    test = {
        "file": "cut.csv", "spindle_speed": "1500 rpm", "depth_of_cut": "1.7 mm", "cut": "down",
        "width_of_cut": "50.8 mm", "feed_per_tooth": "0.2 mm", "controller": "K2",
    }  # fmt: skip
    stuck = campaign(method="zero_order", feed="40 mm/min", controller="K2", tests=[test])
    row = predictions(stuck, stuck.cutting_tests[0], {})
    assert row["predicted_machine"] == NOT_COMPARED


def test_bands_and_maps_are_of_the_machine_at_one_feed():
    given = {"method": "semi_discretization", "controller": "K3", "maps_up_to": "2 mm", "bands_up_to": "4 mm"}
    with pytest.raises(InputError, match="say one feed in"):
        all_lobes(campaign(**given), {}, silent)
    loaded = campaign(**given, feed="800 mm/min")
    (found,) = all_lobes(loaded, {}, silent)
    first = found.lobes["band_to_mm"].values[found.lobes["band_from_mm"].values == 0.0]
    np.testing.assert_allclose(first, np.minimum(found.lobes["limit_depth"], 4.0), rtol=2e-3)
    machine = asked_cut(loaded, loaded.lobes[0], "machine", None).modes
    expected = cut_maps(machine, TOOL, ARC, WORK, [2e-3], 2e-4, [1500.0])
    at = list(found.lobes["map_spindle_speed"].values).index(1500.0)
    assert found.lobes["map_deflection"].values[at, -1] == pytest.approx(float(expected["deflection"][0, 0]), rel=1e-9)


def test_the_band_of_a_machine_whose_uncertainty_is_stated_is_that_of_its_operating_points():
    machine = {"uncertainty": {"friction": "10 %", "stiffness": "3 %"}}
    asked = {"controller": "K3", "feed": "100 mm/min", "spindle_speed": ["1500 rpm", "1600 rpm", "100 rpm"]}
    (found,) = all_lobes(campaign(machine=machine, method="semi_discretization", **asked), {}, silent)
    (point,) = all_lobes(campaign(machine=machine, method="operating_point", **asked), {}, silent)
    for column in ("limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"):
        np.testing.assert_allclose(found.table[column], point.table[column], rtol=3e-3)


def test_a_long_dead_time_of_a_fast_mode_is_said():
    servo = Servo(*slot.GAINS["K2"], 1.5e-3)
    stiff = Machine.of_axis(Drive(slot.CARRIAGE, 1.0, 2e7, 200.0, servo), Andersson(*slot.FRICTION))
    given = {"cut": "down", "width_of_cut": "50.8 mm", "spindle_speed": (1000, 2000, 500), "feed_per_tooth": "0.2 mm"}
    with pytest.warns(smfe.SmfeWarning) as said:
        found = smfe.lobes(stiff, TOOL, WORK, **given, method="zero_order", feed="800 mm/min")
    assert any("is long for the mode at 7" in str(w.message) for w in said), [str(w.message) for w in said]
    assert math.isfinite(float(found["limit_depth"][0]))


def test_a_feed_of_a_measurement_is_refused():
    with pytest.raises(InputError, match="and the machine of \\[machine\\] ask for"):
        campaign(method="zero_order", sources=("other",), feed="100 mm/min")


def test_strips_of_work_under_a_moving_machine_have_the_same_limit_by_operating_point_and_zero_order():
    strips = {"cut": "strips", "strips": [["-20 mm", "-8 mm"], ["5 mm", "20 mm"]], "width_of_cut": None}
    asked = {**strips, "controller": "K3", "feed": "250 mm/min", "spindle_speed": "1500 rpm"}
    depth = []
    for method in ("zero_order", "operating_point"):
        (found,) = all_lobes(campaign(method=method, **asked), {}, silent)
        assert found.asked.width_of_cut == pytest.approx(0.027)
        depth.append(float(found.lobes["limit_depth"][0]))
    assert depth[0] == pytest.approx(depth[1], rel=3e-3)
    assert depth[0] > 3.0  # less work in the cut than in the slot


def test_the_pitch_for_a_machine_in_motion_is_that_of_one_feed(tmp_path):
    """Two teeth a right angle apart cut at any time in this slot: equal pitch stays best, and both curves are one."""
    asked = {"method": "semi_discretization", "controller": "K3", "spindle_speed": ["1200 rpm", "1300 rpm", "50 rpm"]}
    found = smfe.pitch(campaign(**asked, feed="800 mm/min"), 1250.0, tmp_path)
    assert found.least_mm == pytest.approx(float(found.design.check["limit_depth_mm"].min()))
    assert found.design.pattern == "equal"
    np.testing.assert_allclose(found.table["gain"], 1.0, rtol=1e-3)
    assert any("no unequal pitch" in note for note in found.notes)
    assert (tmp_path / "figures" / "pitch.png").is_file()
    with pytest.raises(InputError, match="say one feed in"):
        smfe.pitch(campaign(**asked), 1250.0)
