"""Claims: a campaign file gives the same family as the records by hand, and what is proposed next can be done."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from exam.drive import record_of
from places import DATA, DATASETS
from truth.drive import Axis

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson
from process.labels import make_compliance, make_record
from smfe.campaign import AxisModel, Campaign, LobeRequest, load_campaign
from smfe.campaign.tolerances import Tolerances
from smfe.commands.diagnose import diagnose
from smfe.diagnosis.audit import audit
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.compliances import as_listed, axis_baseline, case_of, steadied
from smfe.diagnosis.cases.experiments import proposed_experiments
from smfe.diagnosis.cases.known import with_known
from smfe.diagnosis.cutting.forces import cutting_family
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.drive.control_law import Gains
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.fit import Target, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.judgement.next_experiment import rank
from smfe.diagnosis.story.millimetres import depths_of, stable_depths
from smfe.records import read_records, write_record_netcdf


def public(name: str, monkeypatch: pytest.MonkeyPatch) -> Campaign:
    if not (DATA / name).is_dir():
        pytest.skip(f"{DATA / name} is not here; set SMFE_DATA to the folder of public data")
    monkeypatch.setenv("SMFE_DATA", str(DATA))
    return load_campaign(DATASETS / f"{name}.toml")


# --- records of a moving axis -------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_drive_campaign_is_the_family_of_its_records(monkeypatch: pytest.MonkeyPatch) -> None:
    """The record that is held out has no say in filter, noise and starts, and its moves are the ones held out."""
    campaign = public("emps", monkeypatch)
    baseline, within = campaign.baseline, campaign.tolerances
    case = case_of(campaign, {})
    records = [read_records(m.records[0].files[0], m.records[0].channels)[0] for m in campaign.measurements]
    assert baseline.moving_mass is None
    stated = {"gains": Gains(baseline.Kv, baseline.Kp), "delay": baseline.delay, "tolerances": within}
    first = DriveRecordFamily.from_record(records[0], **stated)
    other = DriveRecordFamily.from_record(records[1], like=first, **stated)
    for mine, byhand in zip(case.family.conditions, (*first.conditions, *other.conditions), strict=True):
        np.testing.assert_array_equal(mine.observed, byhand.observed)
    assert case.family.nuisances == first.nuisances
    assert case.held_out_conditions() == case.groups["moves with pulses"]
    assert len(case.held_out_conditions()) == len(other.conditions)


@pytest.mark.slow
def test_commands_that_are_not_logged_are_found_in_the_record_that_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """25 pulses of 5 V, which are 175.8 N; none in the other record."""
    (found,) = [s for s in audit(public("emps", monkeypatch)) if s.cause == "hidden_input"]
    assert found.where == "moves with pulses"
    assert found.evidence.startswith("25 commands")
    assert float(found.evidence.split("of ")[1].split(" N")[0]) == pytest.approx(175.8, rel=0.02)


def drive_campaign(folder: Path, record: xr.Dataset, more: str = "") -> Campaign:
    write_record_netcdf(record, folder / "moved.nc")
    (folder / "campaign.toml").write_text(
        "[campaign]\nname = 'axis'\n[[measurement]]\nname = 'moved'\nmethod = 'drive'\n"
        "records = [{ file = 'moved.nc' }]\n"
        f"[baseline]\ndrive = 'rigid'\naxis = 'x'\n{more}",
        encoding="utf-8",
    )
    return load_campaign(folder / "campaign.toml")


def to_and_fro(**channels: np.ndarray) -> xr.Dataset:
    time = np.arange(6000) * 1e-3
    given = {"encoder_position": 0.1 * np.sin(2.0 * np.pi * 0.5 * time), "drive_force": np.ones_like(time), **channels}
    return make_record(time, {name: {"x": v} for name, v in given.items() if v is not None})


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ({"encoder_position": None}, "measurement 'moved': the record has no encoder_position_x"),
        ({"encoder_position": np.zeros(6000)}, "measurement 'moved': encoder_position_x is 0 m in all samples"),
        ({}, "measurement 'moved': drive_force_x is 1 N in all samples"),
    ],
)
def test_a_drive_record_that_lacks_something_is_refused_by_name(tmp_path: Path, lost: dict, said: str) -> None:
    with pytest.raises(InputError, match=said):
        case_of(drive_campaign(tmp_path, to_and_fro(**lost)), {})


def test_a_control_law_without_its_reference_is_refused_by_name(tmp_path: Path) -> None:
    campaign = drive_campaign(tmp_path, to_and_fro(), "Kp = '8 N s/m'\nKv = '16 1/s'\n")
    found = audit(campaign)
    assert any("no reference_position_x; the control law needs it" in str(s) for s in found), found


DECLARED = (
    "friction = {{ law = 'andersson', coulomb = '{:g} N', static = '{:g} N', stribeck_speed = '20 mm/s', "
    "sigma = '240 N s/m' }}\n"
)


@pytest.mark.parametrize(("coulomb", "said"), [(20.0, {}), (12.0, {"guideway_friction"})])
@pytest.mark.slow
def test_a_declared_friction_of_a_drive_is_right_or_named(tmp_path: Path, coulomb: float, said: set[str]) -> None:
    """20 N of sliding friction, 30 N at rest, of a simulation with bristles; declared as they are, and 40 % lower."""
    truth = Axis(coulomb=20.0, static=30.0, stribeck_speed=0.02, seconds=20.0)
    # Without a mass the gain of the force channel would do as well: all forces would be two thirds larger.
    declared = "moving_mass = '97 kg'\n" + DECLARED.format(coulomb, 1.5 * coulomb)
    campaign = drive_campaign(tmp_path, record_of(truth, 3), declared)
    found = diagnose(campaign, tmp_path / "finding.json", workers=1)
    assert {c.id for c in found.causes} == set(said)
    assert found.verdict == ("named" if said else "consistent")
    (level,) = (g for g in found.given if g.cause == "guideway_friction")
    assert level.given == coulomb
    assert level.found == pytest.approx(20.0, rel=0.1)
    extended = load_campaign(tmp_path / "finding.toml").baseline.friction
    assert extended.coulomb == pytest.approx(level.found, rel=1e-6)


@pytest.mark.parametrize("law", ["law = 'viscous'", "law = 'coulomb_viscous', coulomb = '20 N'"])
@pytest.mark.slow
def test_friction_that_differs_between_the_directions_is_known_beside_a_declared_one(tmp_path: Path, law: str) -> None:
    """60 N s/m more forwards than in the mean; the campaign of the extended model is read, and says no more of it."""
    record = record_of(Axis(coulomb=0.0 if "'viscous'" in law else 20.0, asymmetry=60.0, seconds=20.0), 5)
    declared = f"moving_mass = '95 kg'\nfriction = {{ {law}, sigma = '240 N s/m' }}\n"
    found = diagnose(drive_campaign(tmp_path, record, declared), tmp_path / "finding.json", workers=1)
    assert [c.id for c in found.causes] == ["friction_asymmetry"]
    extended = load_campaign(tmp_path / "finding.toml")
    assert list(extended.known) == ["friction_asymmetry"]
    again = diagnose(extended, tmp_path / "again.json", workers=1)
    assert (again.verdict, again.causes) == ("consistent", ())


@pytest.mark.parametrize(
    ("exponent", "said", "speed"),
    [(2.0, "", 20.0), (2.0, ", delta = 2", 20.0), (0.7, "", 20.0), (1.0, "", 0.1), (1.0, "", 150.0)],
)
@pytest.mark.slow
def test_a_healthy_axis_is_one_whatever_the_shape_of_its_stribeck_curve(
    tmp_path: Path, exponent: float, said: str, speed: float
) -> None:
    """The exponent is known to nobody, unless it is given; the speed may be one that the moves hardly tell."""
    truth = Axis(coulomb=20.0, static=45.0, stribeck_speed=1e-3 * speed, stribeck_exponent=exponent, seconds=25.0)
    law = DECLARED.format(20.0, 45.0).replace("20 mm/s", f"{speed:g} mm/s").replace(" }", said + " }")
    campaign = drive_campaign(tmp_path, record_of(truth, 3), f"moving_mass = '95 kg'\n{law}")
    found = diagnose(campaign, tmp_path / "finding.json", workers=1)
    assert (found.verdict, found.causes) == ("consistent", ())
    assert found.values["stribeck.exponent"] == pytest.approx(exponent, rel=0.15 if speed == 20.0 else 0.5)
    assert load_campaign(tmp_path / "finding.toml").baseline.friction.delta == pytest.approx(
        found.values["stribeck.exponent"], rel=1e-5
    )


@pytest.mark.parametrize(("static", "known"), [(20.0, False), (30.0, True)])
def test_a_stribeck_curve_that_does_not_rise_is_none(tmp_path: Path, static: float, known: bool) -> None:
    campaign = drive_campaign(tmp_path, record_of(Axis(coulomb=20.0, seconds=14.0), 3), DECLARED.format(20.0, static))
    found = with_known(case_of(campaign, {}).family, campaign)
    assert ("stribeck.boost" in {p.name for p in found.nuisances}) is known
    assert ("low_speed_friction/stribeck" in {c.key for c in found.causes}) is not known
    assert all(len(start) == len(cause.parameters) for cause in found.causes for start in cause.starts)


def test_a_law_of_friction_that_no_drive_record_tells_is_refused_by_its_name(tmp_path: Path) -> None:
    record = record_of(Axis(coulomb=20.0, seconds=14.0), 3)
    with pytest.raises(InputError, match="friction of drive records is one of"):
        drive_campaign(tmp_path, record, "friction = { law = 'gms', coulomb = '20 N' }\n")


def test_a_shape_of_a_stribeck_curve_that_hits_on_an_axis_do_not_test_is_refused() -> None:
    law = Andersson(50.0, 90.0, 0.006, 150.0, 1e4, delta=2.0)
    whole = AxisModel("x", Drive(200.0, 100.0, 4e7, 3e3), {"": Servo(2e4, 0.01, 30.0)}, law)
    with pytest.raises(InputError, match="delta other than 1, which cannot be tested on an axis; leave it out"):
        axis_baseline(whole)
    assert axis_baseline(replace(whole, friction=replace(law, delta=1.0))).known["static"] == 90.0


def test_what_is_held_out_must_be_measured_and_leave_something() -> None:
    case = Case(None, {"a": ("a, move 1", "a, move 2"), "b": ("b, move 1",)}, ("b",))
    assert case.held_out_conditions() == ("b, move 1",)
    with pytest.raises(InputError, match="'c' cannot be held out; compared are 'a', 'b'"):
        case.held_out_conditions(["c"])
    with pytest.raises(InputError, match="everything is held out"):
        case.held_out_conditions(["a"])


# --- forces of cuts -----------------------------------------------------------------------------------------


def test_a_campaign_of_cuts_is_the_family_of_its_records(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = public("milling_forces_ubc", monkeypatch)
    case = case_of(campaign, {})
    test = campaign.cutting_tests[-1]
    cut = SteadyCut(6000.0 * np.pi / 30.0, 0.125e-3, 3e-3, engagement("down", 0.025, 0.025))
    byhand = cutting_family(
        {"cut": (read_records(test.file, test.channels)[0], cut)}, Tool(0.025, 2), (900e6, 300e6, 150e6)
    )
    (held_out,) = case.held_out_conditions()
    assert held_out == "cut at 6000 rpm, 0.125 mm per tooth, 3 mm deep"
    (mine,) = [c for c in case.family.conditions if c.name == held_out]
    np.testing.assert_allclose(mine.observed, byhand.conditions[0].observed, rtol=1e-12)
    names = [p.name for p in case.family.proposals]
    assert names[0] == "cut at 6000 rpm, 0.25 mm per tooth, 3 mm deep"
    assert "spindle in air at 6000 rpm" in names


def test_known_edge_forces_belong_to_the_baseline() -> None:
    """At the null values a baseline with edge forces predicts what one without them does when they are added."""
    tool, arc = Tool(0.025, 2), engagement("down", 0.0125, 0.025)
    cut = SteadyCut(600.0, 1e-4, 2e-3, arc)
    rng = np.random.default_rng(1)
    record = make_record(np.arange(40000) * 1e-4, {"force": {a: rng.standard_normal(40000) for a in "xyz"}})
    coefficients, edge = (900e6, 300e6, 150e6), (3e4, 2e4, 1e4)
    plain, known = (cutting_family({"cut": (record, cut)}, tool, coefficients, **more) for more in ({}, {"edge": edge}))

    def null(family):
        return {p.name: p.start for p in (*family.nuisances, *(p for c in family.causes for p in c.parameters))}

    with_edge = {**null(plain), "Kte": edge[0], "Kre": edge[1], "Kae": edge[2]}
    here = plain.conditions[0]
    np.testing.assert_allclose(known.predict(here, null(known)), plain.predict(here, with_edge), rtol=1e-12)


# --- what could be measured next ----------------------------------------------------------------------------

BASELINE = AxisBaseline(
    Drive(23.1, 11.3, 1.68e6, 104.0, sigma=168.0),
    {"K2": Servo(6268.0, 10.9e-3, 45.5), "K3": Servo(10590.0, 6.5e-3, 76.9)},
)
F = np.linspace(10.0, 150.0, 40)


def values(**more: float) -> dict[str, float]:
    causes = (p for c in BASELINE.causes() for p in c.parameters)
    return {p.name: p.start for p in (*BASELINE.nuisances(), *causes)} | more


def condition(name: str, feed: float, level: float = 1.0, **settings: float | str) -> Condition:
    excited = Excited(F, (("x", "x"),), np.full((F.size, 1), 3e-8), "hammer", level, 4e-3, {"x": feed / 6e4}, "K2")
    given = {"method": "hammer", "feed": feed / 6e4, "level": level, "controller": "K2", "order": 0.0, **settings}
    return Condition(name, given, None, name, excited)


@pytest.mark.parametrize(
    ("given", "orders"),
    [
        # Levels that were meant to be the same, or that come and go, tell a drift from what a level does.
        ([{"level": 1.0}, {"level": 1.1}, {"level": 0.95}], [0.0, 0.5, 1.0]),
        ([{"level": 1.0}, {"level": 2.0}, {"level": 0.5}, {"level": 1.0}], [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]),
        # A list by level, place, feed (to and fro, too) or controller does not.
        ([{"level": 0.5}, {"level": 1.0}, {"level": 2.0}], [0.0, 0.0, 0.0]),
        ([{"position": 0.0}, {"position": 0.2}, {"position": 0.4}], [0.0, 0.0, 0.0]),
        ([{"feed": 0.0}, {"feed": 0.01}, {"feed": -0.02}], [0.0, 0.0, 0.0]),
        ([{"controller": "K1"}, {"controller": "K1"}, {"controller": "K2"}], [0.0, 0.0, 0.0]),
        ([{}], [0.0]),
        # What somebody said stays.
        ([{"order": 1.0}, {"order": 0.0}], [1.0, 0.0]),
    ],
)
def test_measurements_without_a_time_are_as_listed_where_nothing_else_goes_along_with_the_list(given, orders) -> None:
    listed = as_listed([condition(str(n), **{"feed": 0.0, **settings}) for n, settings in enumerate(given)])
    assert [c.settings["order"] for c in listed] == pytest.approx(orders)


def machine(true: dict[str, float], *conditions: Condition) -> MachineFrfs:
    every = MachineFrfs(BASELINE, conditions)
    return replace(every, conditions=tuple(replace(c, observed=every.predict(c, true)) for c in conditions))


def test_each_proposal_changes_one_thing_and_none_was_measured() -> None:
    family = machine(values(), condition("idle", 0.0), condition("moving", 500.0), condition("slow", 100.0))
    proposals = proposed_experiments(family)
    names = [p.name for p in proposals]
    assert "as moving, but at 50 mm/min" in names
    assert "as moving, but at -500 mm/min, the other direction" in names
    assert "as idle, but with controller K3" in names
    assert not [n for n in names if n.startswith("as moving, but at 100 ")]
    measured = {c.name: c for c in family.conditions}
    for p in proposals:
        base = measured[p.name.removeprefix("as ").split(", but")[0]]
        other = {k for k in p.settings if k != "minutes" and p.settings[k] != base.settings.get(k)}
        assert len(other) == 1
        assert p.settings["minutes"] >= 5.0


def test_another_position_is_proposed_as_a_length() -> None:
    family = machine(values(), condition("near", 500.0, position=0.1))
    further = [p for p in proposed_experiments(family) if "further along" in p.name]
    assert [p.settings["position"] for p in further] == [pytest.approx(0.4)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "tolerances",
    [Tolerances(control_gain=0.0, dead_time=0.0, sensor_gain=0.0, clock=0.0), Tolerances()],
)
def test_between_coulomb_and_stribeck_it_asks_for_a_feed_of_the_transition(
    tolerances: Tolerances, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light hits stick at rest and slide alike at 500 mm/min: only in between does the fall of the friction show.

    Of 15 N it is 10 N at 50 mm/min, 2 N at 250 and nothing at 1000 (1/e in 120 mm/min). Stribeck friction contains
    Coulomb's, so that no experiment could prove Coulomb's.
    """
    monkeypatch.setitem(globals(), "BASELINE", replace(BASELINE, tolerances=tolerances))
    true = {"stribeck_coulomb": 40.0, "static_rise": 15.0, "stribeck_speed": 2e-3}
    family = machine(values(**true), condition("idle", 0.0, 0.05), condition("moving", 500.0, 0.05))
    feeds = [condition(f"at {f:g}", f, 0.05, minutes=5.0) for f in (50.0, 250.0, 1000.0)]
    model = Model(family, [*family.conditions, *feeds])
    target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    keys = [c.key for c in model.causes]
    pair = []
    for variant, start in (("coulomb", {"coulomb": 40.0}), ("stribeck", true)):
        near = np.array([values(**start).get(n, s) for n, s in zip(model.names, model.start, strict=True)])
        pair.append(
            fit(model, target, [keys.index(f"guideway_friction/{variant}")], (near - model.start) / model.scale)
        )
    assert pair[0].chi2 < 6.0
    found = rank(model, target, pair, range(2, 5))
    assert [p.name for p in found] == ["at 50", "at 250", "at 1000"]
    assert found[0].probability > 0.99 > found[-1].probability
    # Above noise it goes with the square of the fall, or more: at 50 mm/min the axis hardly moves steadily any more.
    assert all(a.discrimination > 20.0 * b.discrimination for a, b in pairwise(found))


def test_of_two_experiments_that_separate_alike_the_shorter_comes_first() -> None:
    """What was measured first does not show whether the stiffness drifts; what is measured last does."""
    exact = replace(BASELINE, tolerances=Tolerances(control_gain=0.0, dead_time=0.0, sensor_gain=0.0, clock=0.0))
    family = replace(machine(values(), condition("moving", 500.0)), baseline=exact)
    twice = [condition("long", 500.0, order=1.0, minutes=30.0), condition("short", 500.0, order=1.0, minutes=5.0)]
    model = Model(family, [*family.conditions, *twice])
    target = Target({0: family.conditions[0].observed}, model.null())
    keys = [c.key for c in model.causes]
    null = fit(model, target, [], model.null())
    near = np.array(
        [values(stiffness_over_session=0.1).get(n, s) for n, s in zip(model.names, model.start, strict=True)]
    )
    other = fit(model, target, [keys.index("drift")], (near - model.start) / model.scale)
    found = rank(model, target, [null, other], [1, 2])
    assert [p.name for p in found] == ["short", "long"]
    assert found[0].minutes == 5.0


# --- what it means ------------------------------------------------------------------------------------------


def cut_campaign() -> Campaign:
    request = LobeRequest((), "zero_order", "down", 0.1, 0.2e-3, np.array([300.0, 450.0, 600.0]))
    return Campaign(
        Path("campaign.toml"),
        "cut",
        tool=Tool(0.125, 8, approach_angle=np.pi / 4),
        coefficients=CuttingCoefficients(1900e6, 500e6, 300e6),
        lobes=(request,),
    )


def depth_rows(values):
    campaign = cut_campaign()
    depths, why = depths_of(campaign, MachineFrfs(BASELINE, ()))
    assert why == ""
    return stable_depths(campaign, depths, values)


def test_the_stable_depth_of_an_unchanged_machine_is_unchanged() -> None:
    for row in depth_rows(values()):
        assert row.after_mm == row.before_mm
        assert row.feed_mm_min == pytest.approx(1.6 * row.spindle_speed_rpm)


def test_a_machine_twice_as_heavy_stiff_and_damped_cuts_twice_as_deep() -> None:
    """All impedances times two: the compliance halves, and the limit depth is inverse to it."""
    start = values()
    twice = {n: 2.0 * start[n] for n in ("moving_mass", "tip_mass", "stiffness", "damping", "viscous")}
    for row in depth_rows(values(**twice, Kp_error=1.0)):
        assert row.after_mm == pytest.approx(2.0 * row.before_mm, rel=1e-6)


def test_an_axis_that_vibrates_without_a_cut_has_no_stable_depth() -> None:
    """Friction that falls steeply with the speed takes more damping than the loop has."""
    falling = values(stribeck_coulomb=5.0, static_rise=600.0, stribeck_speed=8e-3, viscous=1.0, Kp_error=-0.8)
    assert [row.after_mm for row in depth_rows(falling)] == [0.0, 0.0, 0.0]


# --- records without excitation -----------------------------------------------------------------------------


# --- how well a compliance is known -------------------------------------------------------------------------


def test_residuals_of_noise_have_unit_variance_whatever_the_number_of_hits() -> None:
    """The standard deviation of a line from four hits would make their mean square 1.5."""
    rng, lines, hits = np.random.default_rng(7), 4000, 4
    f = np.linspace(10.0, 110.0, lines)
    noise = 1e-8 * (20.0 / f)[:, None] * (rng.standard_normal((lines, hits)) + 1j * rng.standard_normal((lines, hits)))
    std = np.sqrt(np.sum(np.abs(noise - noise.mean(axis=1)[:, None]) ** 2, axis=1) / (hits - 1) / hits)
    std[:9] = np.nan
    dims = ("frequency", "response", "excitation")
    given = make_compliance(
        f, noise.mean(axis=1)[:, None, None], ["x"], ["x"], extra={"compliance_std": (dims, std[:, None, None])}
    )
    square = np.abs(given["compliance"].values.ravel()) ** 2
    raw, smooth = (d["compliance_std"].values.ravel() for d in (given, steadied(given)))
    assert np.nanmean(square / raw**2) > 1.3
    assert np.nanmean(square / smooth**2) == pytest.approx(1.0, abs=0.08)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(raw))
