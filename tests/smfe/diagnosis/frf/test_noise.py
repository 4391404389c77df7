"""Hits of a campaign one by one: what they are, that they are kept, and what a diagnosis of an axis makes of them."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from exam.records import baseline
from truth.axis import Friction, Truth
from truth.campaign import Condition as Plan
from truth.campaign import Design, measure
from truth.chain import Chain

from process.errors import InputError
from process.labels import make_record
from smfe.campaign import load_campaign
from smfe.commands.check import check
from smfe.commands.diagnose import diagnose
from smfe.diagnosis.cases import compliances
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.noise import compared, excitation_of
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.direction import UNLIKE
from smfe.identification.hammer.hammer import Averaging, identify_hammer
from smfe.identification.measurement import cached_identification
from smfe.records import write_record_netcdf

RATE = 4096.0


def recorded(count: int = 4, sign: float = 1.0) -> xr.Dataset:
    """A mode at 40 Hz, hit now and then, with a little noise on both channels."""
    time, rng = np.arange(round(1.2 * count * RATE)) / RATE, np.random.default_rng(0)
    force, moved = np.zeros(time.size), np.zeros(time.size)
    wn, zeta, mass = 2.0 * np.pi * 40.0, 0.05, 20.0
    wd = wn * np.sqrt(1.0 - zeta**2)
    response = np.exp(-zeta * wn * time) * np.sin(wd * time) / (mass * wd)
    for k in range(count):
        since = time - 0.1 - 1.2 * k
        pulse = sign * (100.0 + 10.0 * k) * np.sin(np.pi * since / 5e-3) * ((since > 0.0) & (since < 5e-3))
        force += pulse
        moved += np.convolve(pulse, response)[: time.size] / RATE
    force += 0.02 * rng.standard_normal(time.size)
    return make_record(
        time, {"force": {"x": force}, "displacement": {"x": moved + 1e-9 * rng.standard_normal(time.size)}}
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_mean_of_single_hits_weighted_by_their_power_is_h1(sign: float) -> None:
    found = identify_hammer("hit", {"x": [recorded(sign=sign)]})
    hits, mean = found.hits["x"], found.compliance["compliance"].sel(response="x", excitation="x")
    assert hits["force"].sizes["hit"] == 4
    impulse = hits["force"].sum("contact_time").values / RATE
    assert impulse == pytest.approx(sign * (100.0 + 10.0 * np.arange(4)) * 2.0 / np.pi * 5e-3, rel=5e-3)
    low = mean["frequency"].values < 60.0  # there the pulse is short, and its power goes with its impulse
    each = hits["compliance"].sel(response="x", frequency=mean["frequency"]).values[:, low]
    weighted = impulse**2 @ each / np.sum(impulse**2)
    assert np.abs(weighted / mean.values[low] - 1.0).max() < 2e-3


def test_hits_under_a_window_are_not_kept_one_by_one() -> None:
    assert identify_hammer("hit", {"x": [recorded()]}, averaging=Averaging(exponential_window=0.3)).hits == {}


@pytest.mark.parametrize(("lost", "left"), [([], 4), ([1], 3), ([0, 1], None)])
def test_hits_whose_sensor_was_elsewhere_are_not_compared(lost: list[int], left: int | None) -> None:
    found = identify_hammer("hit", {"x": [recorded()]})
    hits = found.hits["x"].copy(deep=True)
    hits["compliance"][{"hit": lost}] = np.nan
    excited = compared(excitation_of(found.compliance, "hammer", 0.3, (20.0, 60.0)), found.compliance, hits)
    assert (excited.hits and len(excited.hits.force)) == left
    assert np.all(np.isfinite(excited.std))
    assert np.all(np.isfinite(excited.shared))


AXIS = replace(
    Truth(),
    friction=Friction(coulomb=(41.0, 41.0), static=(86.0, 86.0), stribeck=(6.7e-3, 6.7e-3), viscous=(159.0, 159.0)),
)


def name_of(plan: Plan) -> str:
    return plan.name.replace("/", " per ")


def written(folder: Path, truth: Truth, plans: tuple[Plan, ...], seed: int) -> Path:
    """Measure an axis that the campaign file describes rightly, and write both down."""
    servo = baseline(truth=truth).servos["K2"]
    lines = [
        "[campaign]\nname = 'axis'\n[baseline]\naxis = 'x'\nmoving_mass = '23.1 kg'\ntip_mass = '11.3 kg'",
        "stiffness = '1.68 N/um'\ndamping = '104 N s/m'",
        f"Kp = '{servo.Kp} N s/m'\nTi = '{1e3 * servo.Ti} ms'\nKv = '{servo.Kv} 1/s'\ndelay = '{1e3 * servo.delay} ms'",
        "friction = { law = 'andersson', coulomb = '41 N', static = '86 N', stribeck_speed = '402 mm/min', "
        "sigma = '159 N s/m', kt = '1e4 s/m' }",
    ]
    for k, record in enumerate(measure(truth, Design("small", plans), seed, Chain(snr=30.0, double=0.0))):
        names = []
        for n, (force, acceleration) in enumerate(zip(record["force"], record["acceleration"], strict=True)):
            one = make_record(record["time"], {"force": {"x": force}, "acceleration": {"x": acceleration}})
            names.append(f"{{ file = 'hit_{k}_{n}.nc', excitation = 'x' }}")
            write_record_netcdf(one, folder / f"hit_{k}_{n}.nc")
        feed = f"feed = {{ x = '{plans[k].feed} mm/min' }}\n" if plans[k].feed else ""
        lines.append(
            f"[[measurement]]\nname = '{name_of(plans[k])}'\nmethod = 'hammer'\n{feed}records = [{', '.join(names)}]"
        )
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "campaign.toml"


@pytest.mark.slow
def test_hits_are_kept_and_a_measurement_of_two_is_left_out_and_named(tmp_path: Path) -> None:
    path = written(tmp_path, AXIS, (Plan(repeats=3), Plan(feed=500.0, repeats=2)), 5)
    campaign, found = load_campaign(path), dict[str, Identification]()
    for m in campaign.measurements:
        fresh, again = (cached_identification(campaign, m, tmp_path / "kept") for _ in range(2))
        assert (fresh[1], again[1]) == (False, True)
        xr.testing.assert_identical(fresh[0].hits["x"], again[0].hits["x"])
        found[m.name] = again[0]
    case = case_of(campaign, found)
    assert isinstance(case.family, MachineFrfs)
    (compared,) = case.family.conditions
    assert compared.name == name_of(Plan())
    assert len(compared.data.hits.force) == 3
    (few,) = case.suspects
    assert (few.cause, few.level, few.where) == ("few_hits", "warning", name_of(Plan(feed=500.0)))
    # A third that only found the guideway otherwise is no fault of who hit.
    two = found[name_of(Plan(feed=500.0))].tables
    other = two["hits"].iloc[:1].assign(used=False, reason=f"{UNLIKE} x")
    two["hits"] = pd.concat([two["hits"], other], ignore_index=True)
    assert [few.level for few in case_of(campaign, found, as_measured=True).suspects] == ["note"]
    hits = found[name_of(Plan())].tables["hits"]
    hits["used"] = [True, True, False]
    hits["reason"] = ["", "", "double hit: 25 N after 28 ms"]
    with pytest.raises(InputError, match=r"2 of 3 hits are used \(hit \d+ of .*: double hit: 25 N after 28 ms\)"):
        case_of(campaign, found)


@pytest.mark.parametrize(("position_gain", "said"), [(None, False), ("3000 1/s", True)])
def test_a_check_says_what_a_diagnosis_would_refuse_and_fits_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, position_gain: str | None, said: bool
) -> None:
    path = written(tmp_path, AXIS, (Plan(repeats=3), Plan(feed=500.0, repeats=3)), 5)
    if position_gain is not None:
        path.write_text(re.sub(r"Kv = '[^']*'", f"Kv = '{position_gain}'", path.read_text(encoding="utf-8")))
        with pytest.raises(InputError, match="unstable with its servos"):
            diagnose(path, tmp_path / "finding.json")
    fits = []
    monkeypatch.setattr(compliances, "as_hit", lambda *_: fits.append(1))
    unusable = [row for row in check(path).to_dict("records") if row["cause"] == "unusable"]
    assert [("unstable with its servos" in row["evidence"]) for row in unusable] == [True] * said
    assert not fits


MIXED = (
    Plan(),
    Plan(level=400.0),
    Plan(feed=500.0, level=200.0),
    Plan(feed=-500.0, level=50.0),
    Plan(feed=1000.0, level=200.0),
    Plan(feed=-1000.0, level=200.0),
)
"""Hits that stick, break away, reverse the carriage, and leave it in motion."""


@pytest.mark.parametrize(
    ("asymmetry", "said", "listed"),
    [
        (0.0, [], []),
        # Ten per cent either way change the limit depth by 2 %: seen, but less than matters.
        (0.2, [], ["friction_asymmetry"]),
        (0.4, ["friction_asymmetry"], []),
    ],
)
@pytest.mark.exam
def test_an_axis_that_is_hit_hard_in_motion_is_judged_rightly_from_its_campaign_file(
    tmp_path: Path, asymmetry: float, said: list[str], listed: list[str]
) -> None:
    """The mean of hits that reverse the carriage is not their mean hit: that alone made healthy axes unknown."""
    f = AXIS.friction
    sides = {
        name: (value * (1.0 + 0.5 * asymmetry), value * (1.0 - 0.5 * asymmetry))
        for name, value in (("coulomb", f.coulomb[0]), ("static", f.static[0]), ("viscous", f.viscous[0]))
    }
    truth = replace(AXIS, friction=replace(f, **sides)).with_nuisances(np.random.default_rng(11))
    diagnose(written(tmp_path, truth, MIXED, 11), tmp_path / "finding.json")
    finding = json.loads((tmp_path / "finding.json").read_text(encoding="utf-8"))
    assert [c["id"] for c in finding["causes"]] == said
    assert [c["id"] for c in finding["immaterial"] if c["id"] in ("guideway_friction", "friction_asymmetry")] == listed
    assert finding["verdict"] == ("named" if said else "consistent")
    for c in (*finding["causes"], *finding["immaterial"]):
        if c["id"] == "friction_asymmetry":
            # What sliding differs by is hardly told beside how the guideway gives way before it slides; the rise is.
            told = next(e for e in c["parameters"] if e["name"] in ("friction_asymmetry", "asymmetry_rise"))
            assert told["value"] == pytest.approx(50.0 * asymmetry, rel=0.15)
            assert (c["size"] > 0.05) == bool(said)
