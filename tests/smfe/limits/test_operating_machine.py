"""Operating points of the machine of a campaign: controllers, feeds, band, table, refusals."""

import numpy as np
import pandas as pd
import pytest
from truth import slot

import smfe
from process import Andersson, CuttingCoefficients, Machine, Servo, Tool, engagement
from process.drive.axis import Drive
from process.errors import InputError
from smfe.campaign import campaign_of_tables
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.cutting_tests import NOT_COMPARED, predictions
from smfe.progress import silent
from stability import operating_point, read_table

CUT = Tool(0.0508, 4), engagement("down", 0.0508, 0.0508), CuttingCoefficients(780e6, slot.RADIAL, 0.0)
SERVOS = {name: dict(zip(("Kp", "Ti", "Kv"), gains, strict=True)) for name, gains in slot.GAINS.items()}
SPEEDS = ("1400 rpm", "1600 rpm", "100 rpm")


def bench(controller):
    drive = Drive(slot.CARRIAGE, slot.TIP, slot.STIFFNESS, slot.DAMPING, Servo(*slot.GAINS[controller]))
    return Machine.of_axis(drive, Andersson(*slot.FRICTION))


def campaign(*requests, machine=None, tests=()):
    names = ("coulomb", "static", "stribeck_speed", "sigma", "kt")
    axis = {
        "moving_mass": slot.CARRIAGE, "tip_mass": slot.TIP, "stiffness": slot.STIFFNESS, "damping": slot.DAMPING,
        "friction": {"law": "andersson", **dict(zip(names, slot.FRICTION, strict=True))},
        "controllers": {name: SERVOS[name] for name in ("K2", "K3")},
    }  # fmt: skip
    usual = {
        "measurements": ["machine"], "method": "operating_point", "cut": "down", "width_of_cut": 0.0508,
        "feed_per_tooth": 2e-4, "spindle_speed": list(SPEEDS),
    }  # fmt: skip
    return campaign_of_tables(
        {
            "tool": {"diameter": 0.0508, "teeth": 4},
            "material": {"Ktc": 780e6, "Krc": slot.RADIAL, "Kac": 0.0},
            "machine": {"axis": {"x": axis}, **(machine or {})},
            "lobes": [{**usual, **request} for request in requests],
            **({"cutting_test": list(tests)} if tests else {}),
        },
        {"cut.csv": []},
    )


def test_each_controller_of_the_machine_has_the_limits_of_its_own():
    both = all_lobes(campaign({}), {}, silent)
    assert [r.source for r in both] == ["machine, controller K2", "machine, controller K3"]
    for result, name in zip(both, ("K2", "K3"), strict=True):
        alone = operating_point(bench(name), *CUT, [1400.0, 1500.0, 1600.0], 2e-4)
        for variable in ("limit_depth", "lower_limit_depth", "kick"):
            np.testing.assert_allclose(result.lobes[variable], alone[variable], rtol=1e-6)
        assert result.lobes.attrs["controller"] == name
        assert (result.kind, result.in_motion) == ("model", True)
        assert result.table["safe_depth_mm"].isna().all()
        np.testing.assert_allclose(result.table["lower_limit_depth_mm"], alone["lower_limit_depth"], rtol=1e-6)


def test_a_feed_of_its_own_belongs_to_limits_table_and_removal_rate(tmp_path):
    asked = {"feed": "100 mm/min", "controller": "K3"}
    (result,) = all_lobes(campaign(asked), {}, silent)
    assert result.source == "machine"
    assert float(result.lobes["lower_limit_depth"].sel(spindle_speed=1500)) == pytest.approx(0.67, rel=0.02)
    np.testing.assert_allclose(result.table["feed_mm_min"], 100.0)
    expected = result.table["limit_depth_mm"] * 50.8 * 100.0 / 1e3
    np.testing.assert_allclose(result.table["removal_rate_cm3_min"], expected)
    smfe.lobes(campaign(asked), table=tmp_path / "table.csv")
    found = read_table(tmp_path / "table.csv")
    np.testing.assert_allclose(found["kick_Ns"], result.lobes["kick"], rtol=1e-6)
    frame = pd.read_csv(tmp_path / "table.csv").drop(columns=["lower_limit_depth_mm", "kick_Ns"])
    frame.to_csv(tmp_path / "older.csv", index=False)
    assert read_table(tmp_path / "older.csv")["kick_Ns"].isna().all()


def test_what_is_not_known_of_the_machine_gives_a_band_and_a_safe_depth_below_the_lower_limit():
    machine = {"uncertainty": {"friction": "10 %", "stiffness": "3 %"}}
    (result,) = all_lobes(campaign({"controller": "K3", "feed": "100 mm/min"}, machine=machine), {}, silent)
    table = result.table
    assert (table["limit_depth_p05_mm"] < table["limit_depth_mm"]).all()
    # 10 % of the coefficients, the default, are in it.
    assert (np.log(table["limit_depth_p95_mm"] / table["limit_depth_mm"]) > 0.164).all()
    assert (table["safe_depth_mm"] < table["lower_limit_depth_mm"]).all()


def test_a_cutting_test_is_predicted_at_its_own_speed_and_a_refusal_predicts_nothing():
    test = {
        "file": "cut.csv", "spindle_speed": "1500 rpm", "depth_of_cut": "1.7 mm", "cut": "down",
        "width_of_cut": "50.8 mm", "feed_per_tooth": "0.2 mm", "controller": "K3",
    }  # fmt: skip
    loaded = campaign({}, tests=[test])
    row = predictions(loaded, loaded.cutting_tests[0], {})
    assert row["predicted_machine, controller K3"] == "stable"
    assert row["limit_machine, controller K3_mm"] == pytest.approx(1.83, rel=1e-2)
    assert row["predicted_machine, controller K2"] == NOT_COMPARED
    stuck = campaign({"feed": "40 mm/min", "controller": "K2"}, tests=[test | {"controller": "K2"}])
    row = predictions(stuck, stuck.cutting_tests[0], {})
    assert row["predicted_machine"] == NOT_COMPARED
    assert "stick-slip" in row["not_compared"]
    with pytest.raises(InputError, match="3 of 3 limits are not known, at uniform motion that is unstable"):
        all_lobes(stuck, {}, silent)


def test_what_a_campaign_is_refused_for():
    with pytest.raises(InputError, match="controller 'K9' is none of K2, K3"):
        all_lobes(campaign({"controller": "K9"}), {}, silent)


def test_lobes_of_a_machine_in_memory():
    given = {"cut": "down", "width_of_cut": "50.8 mm", "spindle_speed": SPEEDS, "feed_per_tooth": "0.2 mm"}
    found = smfe.lobes(bench("K3"), CUT[0], CUT[2], **given, method="operating_point", feed="250 mm/min")
    assert float(found["lower_limit_depth"].sel(spindle_speed=1500)) == pytest.approx(1.04, rel=0.02)
    small = smfe.lobes(bench("K3"), CUT[0], CUT[2], **given, method="semi_discretization", feed="250 mm/min")
    np.testing.assert_allclose(small["limit_depth"], found["limit_depth"], rtol=2e-3)
