"""Claims: the extended model is a campaign that loads, and that predicts what was found, whatever was tested."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import DATA, DATASETS
from samples.diagnosed import AXIS, CHANNELS, CUT, HIT, MODES, MOVED, TOOL, campaign, condition, forces, limits, moved

from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, load_campaign
from smfe.diagnosis.cases.compliances import axis_baseline
from smfe.diagnosis.cases.known import known_values, settled
from smfe.diagnosis.cutting.forces import cutting_family
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.inference.problem import Family
from smfe.diagnosis.judgement.finding import Finding, FoundCause
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains, sides_of
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.story.extended import HEAD, extended_campaign
from smfe.diagnosis.story.millimetres import depths_of, given_values, stable_depths
from smfe.identification.compliances import of_model
from smfe.limits.campaign_lobes import all_lobes
from smfe.progress import silent

LOBES = """[[lobes]]
measurements = ["maker"]
method = "zero_order"
cut = "down"
width_of_cut = "12.5 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["2000 rpm", "6000 rpm", "100 rpm"]
"""


def found(family: Family, *keys: str, **values: float) -> Finding:
    """A finding that names some causes, with these values of the best model."""
    causes, declared = {c.key: c for c in family.causes}, {p.given for p in family.nuisances if p.given}
    assert set(keys) <= set(causes) | declared
    told = tuple(
        FoundCause(c.id, c.variant, c.title, c.kind, (), 9.0, None, None)
        if (c := causes.get(key)) is not None
        else FoundCause(key, "declared", key, "declared", (), 9.0, None, None)
        for key in keys
    )
    return Finding("named", "it is", told, values={**given_values(family), **values})


def read(folder: Path, given: Campaign, family: Family, finding: Finding) -> Campaign:
    """The extended model, written into a folder of its own and read back."""
    out = folder / "results"
    out.mkdir(exist_ok=True)
    made = extended_campaign(given, family, finding, out)
    assert made.text.startswith(HEAD)
    (out / "finding.toml").write_text(made.text, encoding="utf-8")
    whole = load_campaign(out / "finding.toml")
    assert [f.resolve() for f in whole.files] == [f.resolve() for f in given.files]
    return whole


def start(family: Family, whole: Campaign) -> dict[str, float]:
    """What a family predicts with before any fit, what is known of it included."""
    return {**given_values(family), **known_values(family, whole.known)}


def axis(whole: Campaign) -> MachineFrfs:
    return MachineFrfs(axis_baseline(whole.baseline), (condition("hammer_500"), condition("idle", 0.0)))


def test_an_axis_with_friction_gains_delay_and_a_joint_is_written_and_read(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, AXIS, HIT)
    family = axis(given)
    keys = ("guideway_friction/stribeck", "joint_micro_slip", "servo_gains", "loop_delay")
    finding = found(
        family,
        *keys,
        moving_mass=24.0,
        stribeck_coulomb=40.0,
        static_rise=45.0,
        stribeck_speed=6.8e-3,
        friction_asymmetry=0.1,
        Kp_error=0.3,
        extra_delay=0.4e-3,
        micro_slip_share=0.05,
        micro_slip_travel=1e-4,
    )
    whole = read(tmp_path, given, family, finding)
    again = axis(whole)
    assert set(whole.known) == {"joint_micro_slip"}
    assert not {"guideway_friction/coulomb", "guideway_friction/stribeck"} & {c.key for c in again.causes}
    here = start(again, whole)
    for feed in (0.0, 500.0 / 6e4, -500.0 / 6e4):
        was, now = family.baseline.effective(finding.values, {}, feed), again.baseline.effective(here, {}, feed)
        for one, two in zip(np.ravel(_numbers(was)), np.ravel(_numbers(now)), strict=True):
            assert two == pytest.approx(one, rel=1e-6, abs=1e-12)


def _numbers(effective) -> list[float]:
    servos = [x for s in effective.servos for x in (s.Kp, s.Ti, s.Kv, s.delay)]
    sides = [x for side in effective.friction for x in side]
    return [*effective.masses, effective.stiffness, effective.damping, *sides, *servos, *effective.micro_slip]


def modal(model: ModalModel) -> ModalFrfs:
    second = condition("hammer_200", 200.0)
    second = replace(second, settings={**second.settings, "position": 0.5, "order": 1.0})
    return ModalFrfs(model, (condition("hammer_500"), second))


def test_modes_with_a_further_one_another_scale_and_springs_predict_the_same(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, TOOL, MODES, LOBES, HIT)
    two = ModalModel(np.array([60.0, 80.0]), np.array([0.04, 0.03]), np.array([2e7, 3e7]), np.eye(2, 3))
    family = modal(two)
    finding = found(
        family,
        "posture",
        "cross_axis_coupling/springs",
        "missing_mode/in band",
        "modal_scale",
        frequency_1=62.0,
        scale_error=0.2,
        coupling_12=0.1,
        posture_11=0.15,
        mode_compliance=2e-8,
        mode_frequency=110.0,
        mode_damping=0.03,
        mode_azimuth=0.4,
        mode_elevation=0.1,
    )
    whole = read(tmp_path, given, family, finding)
    (model,) = whole.models
    assert (model.name, model.modal.frequency.size) == ("maker", 3)
    assert set(whole.known) == {"posture"}
    again = modal(model.modal)
    here = start(again, whole)
    first = family.conditions[0]
    one, two = family.predict(first, finding.values), again.predict(again.conditions[0], here)
    assert np.linalg.norm(two - one) < 2e-3 * np.linalg.norm(one)  # springs: damping between modes is left out
    assert whole.lobes[0].measurements == ("maker",)


def test_modes_that_ride_on_an_axis_are_written_with_its_mass_gains_and_friction(tmp_path: Path) -> None:
    ride = """[machine.axis.x]
moving_mass = "20 kg"
controllers = { K2 = { Kp = "6000 N s/m", Ti = "11 ms", Kv = "45 1/s", delay = "1 ms" } }
friction = { law = "coulomb_viscous", coulomb = "40 N", sigma = "100 N s/m" }
"""
    given = campaign(tmp_path, CHANNELS, MODES, ride, HIT)
    one = ModalModel(np.array([60.0]), np.array([0.04]), np.array([2e7]), np.array([[1.0, 0.2, 0.0]]))
    declared = {
        name: DeclaredAxis(a.moving_mass, {n: Gains(*g) for n, g in a.controllers.items()}, sides_of(a.friction))
        for name, a in given.baseline.axes.items()
    }
    family = MachineOfAxes(one, (condition("hammer_500"),), axes=declared)
    values = {"moving_mass_x": 22.0, "Kp_x_K2": 8000.0, "delay_x_K2": 1.6e-3, "friction_x": 0.5, "viscous_x": 140.0}
    whole = read(tmp_path, given, family, found(family, **values))
    axis_found = whole.baseline.axes["x"]
    assert axis_found.moving_mass == pytest.approx(22.0)
    assert axis_found.controllers["K2"] == pytest.approx((8000.0, 11e-3, 45.0, 1.6e-3))
    assert (axis_found.friction.coulomb, axis_found.friction.sigma) == pytest.approx((60.0, 140.0))


def test_coefficients_run_out_and_what_the_sensor_does_predict_the_same_forces(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, TOOL, '[baseline]\nforces = "mechanistic"\n', CUT)
    family = forces()
    finding = found(
        family,
        "edge_forces",
        "runout",
        "sensor_offset",
        Ktc=2.7e9,
        Kte=3e4,
        Kre=2e4,
        runout=2e-5,
        runout_angle=0.7,
        helix=0.3,
        offset_x=5.0,
    )
    whole = read(tmp_path, given, family, finding)
    k = whole.coefficients
    assert (1e-6 * k.Ktc, 1e-3 * k.Kte) == pytest.approx((2700.0, 30.0))
    assert np.ptp(whole.tool.runout) > 2e-5
    again = replace(
        family, tool=whole.tool, coefficients=(k.Ktc, k.Krc, k.Kac), edge=(k.Kte, k.Kre, k.Kae), proposals=()
    )
    orders = [f.orders(f.conditions[0].data, v) for f, v in ((family, finding.values), (again, start(again, whole)))]
    np.testing.assert_allclose(orders[1], orders[0], rtol=1e-6, atol=1e-6)


def test_coefficients_of_no_material_leave_those_that_were_declared_and_say_so(tmp_path: Path) -> None:
    """Forces of a sensor that lies are fitted down to a coefficient of zero: the finding is written all the same."""
    given = campaign(tmp_path, CHANNELS, TOOL, '[baseline]\nforces = "mechanistic"\n', CUT)
    family = forces()
    finding = found(family, "edge_forces", "runout", Ktc=0.0, Kte=3e4, runout=2e-5, runout_angle=0.7)
    whole = read(tmp_path, given, family, finding)
    assert whole.coefficients == given.coefficients
    (said, *_) = extended_campaign(given, family, finding, tmp_path).left_out
    assert "what was declared stands here: K_tc is 0 N/mm^2; the tangential coefficient must be positive" in said


def test_limits_come_from_the_modes_and_coefficients_that_are_written(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, TOOL, MODES.replace('from = "maker"', 'limits = "maker"'), CUT)
    family = limits()
    finding = found(family, "process_damping", coefficients=0.35, process_damping=2e4)
    whole = read(tmp_path, given, family, replace(finding, values={**finding.values, "frequency_1": 0.01}))
    assert 1e-6 * whole.coefficients.Ktc == pytest.approx(2700.0)
    assert whole.models[0].modal.frequency[0] == pytest.approx(60.6)
    assert whole.known == {"process_damping": {"process_damping": "20 N/mm"}}


@pytest.mark.slow
def test_friction_mass_and_delay_of_a_drive_are_written_and_read(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, '[baseline]\ndrive = "rigid"\naxis = "x"\nmoving_mass = "95 kg"\n', MOVED)
    family = moved()
    finding = found(
        family,
        "guideway_friction/coulomb",
        "friction_asymmetry",
        **{"mass": 96.0, "coulomb.force": 20.0, "asymmetry.viscous": -40.0, "loop_delay.delay": 0.6e-3},
    )
    whole = read(tmp_path, given, family, finding)
    assert whole.baseline.moving_mass == pytest.approx(96.0)
    assert whole.baseline.delay == pytest.approx(0.6e-3)
    here = known_values(family, whole.known)
    assert {n: here[n] for n in ("coulomb.force", "asymmetry.viscous")} == {
        "coulomb.force": 20.0,
        "asymmetry.viscous": -40.0,
    }
    assert not {"guideway_friction/coulomb", "friction_asymmetry"} & {
        c.key for c in settled(family, whole.known).causes
    }


def test_known_causes_are_part_of_the_baseline_and_no_candidates(tmp_path: Path) -> None:
    family = axis(campaign(tmp_path, CHANNELS, AXIS, HIT))
    known = {"backlash": {"gap_share": "20 %", "gap": "3 um"}}
    mine = settled(family, known)
    assert "backlash" not in {c.key for c in mine.causes}
    assert {p.name: p.start for p in mine.nuisances if p.name.startswith("gap")} == {"gap_share": 0.2, "gap": 3e-6}
    assert [c.name for c in mine.conditions] == [c.name for c in family.conditions]
    assert mine.model_error == family.model_error
    for wrong, said in (
        ({"backlas": {}}, "'backlas' is no cause of these measurements .did you mean 'backlash'"),
        ({"backlash": {"gab": "3 um"}}, "'gab' is none of its parameters"),
        ({"backlash": {"gap": "3 mm"}}, "has not the unit of finding.json; write a number and 'um'"),
        ({"backlash": {"gap": "-3 um"}}, "is not possible; give 0 to 1000 um"),
    ):
        with pytest.raises(InputError, match=said.replace("'", ".")):
            settled(family, wrong)


def test_a_campaign_in_memory_has_an_extended_model_too(tmp_path: Path) -> None:
    family = cutting_family(
        {c.name: (_record(c), c.data.cut) for c in forces().conditions}, forces().tool, (2e9, 6e8, 3e8)
    )
    given = replace(campaign(tmp_path, CHANNELS, TOOL, '[baseline]\nforces = "mechanistic"\n', CUT), path=Path("none"))
    text = extended_campaign(given, family, found(family, Ktc=2.7e9), tmp_path).text
    assert 'Ktc = "2700 N/mm^2"' in text
    assert math.isclose(float(text.split('Krc = "')[1].split()[0]), 600.0)


ASKED = LOBES.replace('"100 rpm"]', '"2000 rpm"]')
FORCES = MODES.split("[baseline]")[0] + '[baseline]\nforces = "mechanistic"\n'
OF_HITS = ASKED.replace('"maker"', '"hammer_500"')


@pytest.mark.parametrize(
    ("make", "tables", "keys", "values"),
    [
        (
            "axis",
            (AXIS, OF_HITS, HIT),
            ("guideway_friction/stribeck",),
            {"stribeck_coulomb": 40.0, "static_rise": 45.0},
        ),
        ("modes", (MODES, ASKED, HIT), ("modal_scale",), {"scale_error": 0.3}),
        ("forces", (FORCES, ASKED, CUT), ("runout",), {"Ktc": 2.7e9, "runout": 2e-5}),
        ("limits", (MODES.replace("from", "limits"), ASKED, CUT), ("force_coefficients",), {"coefficients": 0.35}),
    ],
)
def test_lobes_of_the_extended_model_are_those_that_the_finding_states(
    tmp_path: Path, make: str, tables: tuple[str, ...], keys: tuple[str, ...], values: dict[str, float]
) -> None:
    """As `smfe lobes` computes them from the file; before and after differ, and after is what the page says."""
    given = campaign(tmp_path, CHANNELS, TOOL, *tables)
    family = {"axis": lambda: axis(given), "modes": lambda: modal(ONE), "forces": forces, "limits": limits}[make]()
    finding = found(family, *(k for k in keys if k in {c.key for c in family.causes}), **values)
    whole = read(tmp_path, given, family, finding)
    source = "machine" if make == "axis" else "maker"
    own = tuple(r for r in whole.lobes if r.measurements == (source,))
    assert len(own) == 1
    compliances = {m.name: of_model(m.modal) for m in whole.models}
    (result,) = all_lobes(replace(whole, lobes=own), compliances, silent)
    depths, why = depths_of(given, family)
    assert depths is not None, why
    told = stable_depths(given, depths, finding.values)
    after = [r.after_mm for r in told if r.where == given.lobes[0].name]
    # The operating point is read between frequencies of its own choice.
    assert result.lobes["limit_depth"].values == pytest.approx(after, rel=0.02)
    if make != "axis":  # whose friction gives way to small vibration, once it slides at the feed of the cut
        assert max(abs(r.after_mm / r.before_mm - 1.0) for r in told) > 0.05


@pytest.mark.slow
def test_lobes_of_an_axis_with_the_friction_that_its_records_found_are_those_that_the_finding_states(
    tmp_path: Path,
) -> None:
    rides = """[machine.axis.x]
moving_mass = "80 kg"
tip_mass = "15 kg"
stiffness = "8 N/um"
damping = "900 N s/m"
controllers = { K2 = { Kp = "20000 N s/m", Ti = "10 ms", Kv = "30 1/s", delay = "1 ms" } }
friction = { law = "viscous", sigma = "200 N s/m" }
"""
    asked = ASKED.replace('"maker"', '"machine"').replace("zero_order", "operating_point")
    drive = '[baseline]\ndrive = "rigid"\naxis = "x"\nmoving_mass = "95 kg"\n'
    given = campaign(tmp_path, CHANNELS, TOOL, drive, rides, asked, MOVED)
    family = moved()
    finding = found(family, "loop_delay", **{"viscous": 4000.0, "loop_delay.delay": 0.5e-3})
    whole = read(tmp_path, given, family, finding)
    (result,) = all_lobes(whole, {}, silent)
    depths, why = depths_of(given, family)
    assert depths is not None, why
    told = stable_depths(given, depths, finding.values)
    assert result.lobes["limit_depth"].values == pytest.approx([r.after_mm for r in told], rel=0.02)
    assert max(abs(r.after_mm / r.before_mm - 1.0) for r in told) > 0.02


RIDES = """[machine.axis.x]
moving_mass = "400 kg"
controllers = { K2 = { Kp = "120000 N s/m", Ti = "11 ms", Kv = "45 1/s", delay = "1 ms" } }
friction = { law = "coulomb_viscous", coulomb = "40 N", sigma = "3000 N s/m" }
[machine.axis.y]
moving_mass = "600 kg"
controllers = { K2 = { Kp = "160000 N s/m", Ti = "12 ms", Kv = "40 1/s", delay = "1 ms" } }
"""


def riding(given: Campaign) -> MachineOfAxes:
    """Two modes that ride on both axes of a campaign."""
    declared = {
        name: DeclaredAxis(
            a.moving_mass,
            {n: Gains(*g) for n, g in a.controllers.items()},
            None if a.friction is None else sides_of(a.friction),
        )
        for name, a in given.baseline.axes.items()
    }
    way = np.array([[1.0, 0.2, 0.0], [-0.1, 1.0, 0.1]])
    two = ModalModel(np.array([60.0, 85.0]), np.array([0.04, 0.03]), np.array([2e7, 3e7]), way)
    return MachineOfAxes(two, (condition("hammer_500"),), axes=declared)


@pytest.mark.parametrize("springs", [0.0, 0.15])
def test_lobes_of_the_axes_that_carry_the_modes_are_those_that_the_finding_states(
    tmp_path: Path, springs: float
) -> None:
    """Modes, their momentum along each axis and the axes are one machine, whose lobes `smfe lobes` computes."""
    asked = ASKED.replace('["maker"]', '["hammer_500"]\ncontroller = "K2"').replace("zero_order", "operating_point")
    given = campaign(tmp_path, CHANNELS, TOOL, MODES, RIDES, HIT, asked)
    family = riding(given)
    values = {"Kp_x_K2": 70000.0, "Ti_y_K2": 0.02, "momentum_x_1": 0.5, "momentum_y_1": -0.2, "momentum_y_2": 0.4}
    values |= {"viscous_y": 5000.0, "coupling_12": springs}
    finding = found(family, "servo_gains", **values)
    whole = read(tmp_path, given, family, finding)
    (own,) = (r for r in whole.lobes if r.measurements == ("machine",))
    (result,) = all_lobes(replace(whole, lobes=(own,)), {}, silent)
    depths, why = depths_of(given, family)
    assert depths is not None, why
    told = stable_depths(given, depths, finding.values)
    after = [r.after_mm for r in told if r.where == given.lobes[0].name]
    assert result.lobes["limit_depth"].values == pytest.approx(after, rel=0.02)
    assert max(abs(r.after_mm / r.before_mm - 1.0) for r in told) > 0.05


def test_lobes_of_axes_that_carry_measured_modes_are_asked_of_the_extended_model(tmp_path: Path) -> None:
    asked = ASKED.replace('"maker"', '"machine"')
    measured = '[baseline]\nfrom = "hammer_500"\n'
    with pytest.raises(InputError, match="only a diagnosis identifies"):
        campaign(tmp_path, CHANNELS, TOOL, measured, RIDES, HIT, asked)
    open_gain = RIDES.replace('Kp = "120000 N s/m", ', "")
    with pytest.raises(InputError, match=r"axis\.x: 'Kp' missing"):
        campaign(tmp_path, CHANNELS, TOOL, MODES, open_gain, HIT, asked)
    assert campaign(tmp_path, CHANNELS, TOOL, MODES, open_gain, HIT).machine_model is None


def test_records_of_a_public_data_set_keep_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not (DATA / "milling_forces_ubc").is_dir():
        pytest.skip(f"{DATA} is not here; set SMFE_DATA to the folder of public data")
    monkeypatch.setenv("SMFE_DATA", str(DATA))
    given = load_campaign(DATASETS / "milling_forces_ubc.toml")
    whole = read(tmp_path, given, forces(), Finding("consistent", "it is"))
    assert whole.files == given.files


def _record(_):
    from process.labels import make_record

    rng = np.random.default_rng(1)
    return make_record(np.arange(40000) * 1e-4, {"force": {a: rng.standard_normal(40000) for a in "xyz"}})


ONE = ModalModel(np.array([60.0]), np.array([0.04]), np.array([2e7]), np.array([[1.0, 0.2, 0.0]]))
FORCE = 'force_x = { column = "a", unit = "N", scale = 0.5 }\n'
MOTIONS = "".join(
    f'acceleration_{a} = {{ column = "a{a}", unit = "m/s^2"{more} }}\n'
    for a, more in (("x", ', scale = 2.0, sign = -1, delay = "10 us"'), ("y", ""))
)


def test_what_is_wrong_with_a_sensor_is_put_right_in_its_channel(tmp_path: Path) -> None:
    """A channel that shows too much is scaled down, one that comes late is moved, and exchanged ones change columns."""
    given = campaign(tmp_path, CHANNELS, FORCE, MOTIONS, MODES, HIT)
    family = modal(ONE)
    keys = ("sensor_gain", "sensor_gain/sign_y", "sensor_axis/exchanged_xy", "time_skew")
    values = {"gain_x": 0.25, "gain_force": -0.2, "reversed_y": 1.0, "exchanged_xy": 1.0, "skew": 5e-5, "gain_y": 0.004}
    whole = read(tmp_path, given, family, found(family, *keys, **values))
    assert whole.known == {}
    told = {c: ch for c, ch in whole.measurements[0].records[0].channels.items() if c != "time"}
    assert told["force_x"].scale == pytest.approx(0.5 / 0.8)
    x, y = told["acceleration_x"], told["acceleration_y"]
    assert (y.column, y.scale, y.sign, y.delay) == pytest.approx(("ax", 2.0 / 1.25, -1.0, 60e-6))
    # A gain within what a workshop holds to stays as it is.
    assert (x.column, x.scale, x.sign, x.delay) == pytest.approx(("ay", 1.0, -1.0, 50e-6))


@pytest.mark.parametrize(("way", "turned"), [(1.0, "x"), (-1.0, "y")])
def test_a_sensor_turned_by_a_right_angle_has_two_channels_exchanged_and_one_turned_round(
    tmp_path: Path, way: float, turned: str
) -> None:
    given = campaign(tmp_path, CHANNELS, FORCE, MOTIONS.replace("sign = -1, ", ""), MODES, HIT)
    family = modal(ONE)
    whole = read(tmp_path, given, family, found(family, "sensor_axis/quarter_xy", quarter_xy=way))
    told = whole.measurements[0].records[0].channels
    assert (told["acceleration_x"].column, told["acceleration_y"].column) == ("ay", "ax")
    assert {a for a in "xy" if told[f"acceleration_{a}"].sign == -1.0} == {turned}


def test_a_sensor_that_may_as_well_be_right_keeps_its_channel(tmp_path: Path) -> None:
    given = campaign(tmp_path, CHANNELS, FORCE, MOTIONS, MODES, HIT)
    family = modal(ONE)
    finding = found(family, "sensor_gain", "modal_scale", gain_force=-0.2)
    finding = replace(finding, causes=tuple(replace(c, set=0) for c in finding.causes))
    whole = read(tmp_path, given, family, finding)
    assert "do not say whether a sensor is wrong" in (tmp_path / "results" / "finding.toml").read_text(encoding="utf-8")
    assert whole.measurements[0].records[0].channels["force_x"].scale == 0.5
