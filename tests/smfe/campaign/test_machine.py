"""Claims about ``[machine]``: a campaign takes the tables of a scenario as they are, and builds the same machine."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from places import DATASETS

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson, MemoryLaw
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import Host, hosted, two_mass_axes
from process.simulation.machine import simulate_machine
from smfe.campaign import Campaign, ModesOf, campaign_of_tables, load_campaign
from smfe.scenario.run import Written, campaign_text
from smfe.scenario.scenario import Scenario, load_scenario

CAMPAIGN = """
[campaign]
name = "Bench"

[tool]
diameter = "40 mm"
teeth = 4

[material]
Ktc = "780 N/mm^2"
Krc = "351 N/mm^2"

[[lobes]]
measurements = ["machine"]
method = "zero_order"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.2 mm"
spindle_speed = ["800 rpm", "2500 rpm"]
"""
BENCH = """
[machine]
name = "Bench of one axis"
maximum_feed = "8000 mm/min"

[machine.axis.x]
moving_mass = "23.1 kg"
tip_mass = "11.3 kg"
stiffness = "1.68 N/um"
damping = "104 N s/m"
friction = { law = "andersson", coulomb = "44.2 N", static = "84 N", stribeck_speed = "6.457 mm/s", \
sigma = "168 N s/m", kt = "15000 s/m" }
controllers.K2 = { Kp = "6268 N s/m", Ti = "10.97 ms", Kv = "45.55 1/s", delay = "0.75 ms" }
controllers.K3 = { Kp = "10590 N s/m", Ti = "6.49 ms", Kv = "76.96 1/s" }
"""
MODES = """
[machine]
modes = [ { frequency = "61.4 Hz", damping = 0.012, stiffness = "1.68 N/um", direction = [1, 0, 0] } ]
"""
TRIAL = """
[scenario]
name = "Bench"

[[trial]]
method = "hammer"
impulse = "0.1 N s"
directions = ["x"]
feed = "1500 mm/min"
controller = "K3"
"""


def write(folder: Path, text: str, name: str = "campaign.toml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def refused(folder: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        load_campaign(write(folder, text))
    return str(caught.value)


def test_the_machine_of_a_campaign_is_the_axis_of_its_tables(tmp_path: Path) -> None:
    campaign = load_campaign(write(tmp_path, CAMPAIGN + BENCH))
    assert (campaign.machine, campaign.machine_limits.feed) == ("Bench of one axis", pytest.approx(8.0 / 60.0))
    assert isinstance(campaign.machine_model, Machine)
    assert campaign.models == ()
    law = Andersson(44.2, 84.0, 6.457e-3, 168.0, 15000.0)
    drive = Drive(23.1, 11.3, 1.68e6, 104.0, Servo(6268.0, 10.97e-3, 45.55, 0.75e-3))
    direct = Machine.of_axis(drive, law).at(0.01)
    f = np.linspace(5.0, 120.0, 24)
    found = campaign.machine_model.at({"x": 0.01}, "K2").matrix(f)
    assert np.allclose(found, direct.matrix(f), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("path", sorted((DATASETS / "scenarios").glob("*.toml")), ids=lambda path: path.stem)
def test_the_tables_of_a_scenario_are_taken_as_they_are(tmp_path: Path, path: Path) -> None:
    raw = tomllib.loads(path.read_text(encoding="utf-8"))
    one = campaign_of_tables({"machine": raw["machine"]}).machine_model
    other = load_scenario(path).machine
    f = np.linspace(5.0, 120.0, 24)
    if isinstance(one, ModalModel) and isinstance(other, ModalModel):
        assert np.array_equal(one.compliance(f)["compliance"], other.compliance(f)["compliance"])
        return
    assert isinstance(one, Machine)
    assert isinstance(other, Machine)
    for name in next(iter(raw["machine"]["axis"].values()))["controllers"]:
        assert np.array_equal(one.at(0.02, name).matrix(f), other.at(0.02, name).matrix(f))


def test_modes_alone_are_a_model_of_that_name(tmp_path: Path) -> None:
    campaign = load_campaign(write(tmp_path, CAMPAIGN + MODES))
    (model,) = campaign.models
    assert model.name == "machine"
    assert model.modal is campaign.machine_model
    assert model.spread is None
    static = campaign.models[0].modal.compliance([1e-6])["compliance"].values[0, 0, 0]
    assert static == pytest.approx(1.0 / 1.68e6)


def test_plain_numbers_of_a_program_are_si() -> None:
    tables = tomllib.loads(BENCH)
    in_si = {"moving_mass": 23.1, "tip_mass": 11.3, "stiffness": 1.68e6, "damping": 104}
    one = campaign_of_tables({"machine": {"axis": {"x": in_si}}}).machine_model
    axis = {key: tables["machine"]["axis"]["x"][key] for key in in_si}
    other = campaign_of_tables({"machine": {"axis": {"x": axis}}}).machine_model
    assert isinstance(one, Machine)
    assert isinstance(other, Machine)
    assert np.array_equal(one.at().matrix([50.0]), other.at().matrix([50.0]))


def machine_of(**axis: object) -> Machine:
    made = campaign_of_tables({"machine": {"axis": {"x": {**tomllib.loads(BENCH)["machine"]["axis"]["x"], **axis}}}})
    assert isinstance(made.machine_model, Machine)
    return made.machine_model


TABLE_1 = {
    "law": "andersson",
    **{"coulomb": "44.2 N", "static": "84 N", "stribeck_speed": "387.4 mm/min", "sigma": "0.0028 N min/mm"},
    **{"kt": "0.25 min/mm", "negative": {"coulomb": "38.7 N", "static": "88 N", "stribeck_speed": "421 mm/min"}},
}
TABLE_1["negative"] |= {"sigma": "0.0025 N min/mm"}  # type: ignore[operator]


@pytest.mark.parametrize(
    ("feed", "fc", "fs", "vs", "sigma"), [(500.0, 44.2, 84.0, 387.4, 168.0), (-500.0, 38.7, 88.0, 421.0, 150.0)]
)
def test_the_direction_of_the_feed_decides_which_friction_acts(
    feed: float, fc: float, fs: float, vs: float, sigma: float
) -> None:
    machine, v = machine_of(friction=TABLE_1), feed / 6e4
    force = np.sign(v) * (fc + (fs - fc) * np.exp(-abs(feed) / vs)) + sigma * v
    slope = sigma - (fs - fc) / (vs / 6e4) * np.exp(-abs(feed) / vs)
    quiet = simulate_machine(machine, duration=0.1, feed=v, controller="K3")
    assert np.allclose(quiet["drive_force"].sel(axis="x"), force, rtol=1e-6)
    assert machine.at(v, "K3").slides[0].friction.direct == pytest.approx(slope, rel=1e-9)


def test_each_law_of_friction_may_differ_with_the_direction() -> None:
    for law, given in (
        ("viscous", {"sigma": "150 N s/m"}),
        ("coulomb", {"coulomb": "40 N", "kt": "0.25 min/mm"}),
        ("coulomb_viscous", {"coulomb": "40 N", "sigma": "150 N s/m", "kt": "0.25 min/mm"}),
        (
            "lugre",
            {"bristle_stiffness": "20 N/um", "bristle_damping": "1e3 N s/m", "coulomb": "40 N", "static": "80 N"},
        ),
        (
            "gms",
            {
                "element_stiffness": ["20 N/um"],
                "share": [1],
                "attraction": "1e6 N/s",
                "coulomb": "40 N",
                "static": "80 N",
            },
        ),
    ):
        more = {"stribeck_speed": "7 mm/s", "sigma": "150 N s/m"} if law in ("lugre", "gms") else {}
        other = {"sigma": "100 N s/m"} if law == "viscous" else {"coulomb": "30 N"}
        one, back, both = (
            machine_of(friction={"law": law, **given, **more, **change}).axes["x"].friction
            for change in ({}, other, {"negative": other})
        )
        for v in (0.02, -0.02):
            wanted = one if v > 0.0 else back
            forces = [law.steady_force(v) if isinstance(law, MemoryLaw) else law.force(v) for law in (both, wanted)]
            assert float(forces[0]) == pytest.approx(float(forces[1]), rel=1e-12)


def test_a_host_and_a_coupling_are_those_of_their_tables() -> None:
    f = np.linspace(5.0, 100.0, 20)
    found = machine_of(host={"mass": "300 kg", "frequency": "48.5 Hz", "damping": "2 %"})
    direct = hosted(two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)}), {"x": Host(300.0, 48.5, 0.02)})
    law = found.axes["x"].friction
    servo = Servo(6268.0, 10.97e-3, 45.55, 0.75e-3)
    assert np.array_equal(
        found.at(0.02, "K2").matrix(f), Machine(direct, {"x": FeedAxis(servo, law)}).at(0.02).matrix(f)
    )
    modes = [
        {"frequency": f"{v} Hz", "damping": 0.02, "stiffness": "40 N/um", "direction": [1, v / 100, 0]}
        for v in (24, 33)
    ]
    axes = {"x": {"moving_mass": "9000 kg", "coupling": ["300 kg", "-50 kg"]}, "y": {"moving_mass": "6000 kg"}}
    made = campaign_of_tables({"machine": {"modes": modes, "axis": axes}}).machine_model
    assert isinstance(made, Machine)
    momentum = made.structure_at().mass @ np.array([0.0, 0.0, 1.0, 1.0])
    assert momentum[0] == pytest.approx(250.0)
    at_tool = sum(4e7 / (2 * np.pi * v) ** 2 / (1 + (v / 100) ** 2) * v / 100 for v in (24, 33))
    assert momentum[1] == pytest.approx(at_tool)


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"coupling": ["3 kg"]}, "axis.x.coupling is the momentum of modes along the axis, and there are no modes"),
        ({"host": {"mass": "300 kg", "damping": 0.02}}, "machine.axis.x.host.frequency: is missing"),
        (
            {"friction": {**TABLE_1, "negative": {"delta": 1, "share": [1]}}},
            "friction.negative: friction law 'andersson'",
        ),
        (
            {"friction": {**TABLE_1, "negative": {"static": "20 N"}}},
            "axis.x: friction.negative: the static force of 20 N",
        ),
    ],
)
def test_what_an_axis_cannot_be_is_said(axis: dict, said: str) -> None:
    with pytest.raises(InputError) as caught:
        machine_of(**axis)
    assert said in str(caught.value)


JOINT = """
[[machine.joint]]
law = "gap"
stiffness = "9 N/um"
gap = "5 um"
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BENCH.replace('"23.1 kg"', "23.1"), "line 26: machine.axis.x.moving_mass: 23.1 has no unit; write it as text"),
        (BENCH.replace("tip_mass", "tip_mas"), "line 27: machine.axis.x.tip_mas: this key is not known (did you mean"),
        (BENCH.replace('tip_mass = "11.3 kg"', ""), "line 21: machine: axis.x: tip_mass missing; an axis without"),
        (BENCH.replace('law = "andersson"', 'law = "coulomb"'), "line 21: machine: axis.x: friction law 'coulomb': "),
        (BENCH.replace('"15000 s/m"', '"15000 s"'), "line 30: machine.axis.x.friction.kt: unit 's' is not a unit of"),
        (BENCH.replace("axis.x", "axis.u"), "line 25: machine.axis.u: axis 'u' is not known; available: x, y, z"),
        (BENCH + JOINT, "line 21: machine: joint[0]: a joint of two masses needs the axis"),
        ('\n[machine]\ntip_mass = "3 kg"\n', "line 21: machine: no modes and no axis; give modes"),
        (MODES.replace("[1, 0, 0]", "[0, 0, 0]"), "line 21: machine: modes[0].direction must not be zero"),
        (
            MODES + MODES.replace("[machine]", "[[model]]\nname = 'machine'"),
            "'machine' is already the name of [machine]",
        ),
        (
            BENCH + '[plan]\nmachine = "machine"\n',
            "line 34: plan.machine: the machine of [machine] has a compliance for",
        ),
        ("\n[machine]\nname = 'Bench'\n", "line 14: lobes[0].measurements[0]: 'machine' is neither a measurement nor"),
        (BENCH.replace("[machine]", "[machin]"), "line 21: machin: this key is not known (did you mean 'machine'?)"),
    ],
)
def test_what_is_no_machine_is_said_with_line_and_table(tmp_path: Path, text: str, said: str) -> None:
    assert said in refused(tmp_path, CAMPAIGN + text)


def test_a_simulated_campaign_knows_its_machine_only_where_its_lobes_ask_for_it(tmp_path: Path) -> None:
    lobes = CAMPAIGN[CAMPAIGN.index("[tool]") :]
    asked = load_scenario(write(tmp_path, TRIAL + lobes + BENCH, "asked.toml"))
    unasked = load_scenario(write(tmp_path, TRIAL + lobes.replace('"machine"', '"hammer"') + BENCH, "unasked.toml"))

    def machine(scenario: Scenario) -> dict:
        return tomllib.loads(campaign_text(scenario, [[Written("records/hammer_x.csv", {})]]))["machine"]

    written = tomllib.loads(BENCH)["machine"]
    assert machine(asked) == written
    assert machine(unasked) == {key: written[key] for key in ("name", "maximum_feed")}


class TestAxesBesideMeasuredModes:
    """``[machine.axis.x]`` alone, where the baseline has the modes."""

    TEXT = (
        "[campaign]\nname = 'portal'\n[channels]\ntime = { column = 't', unit = 's' }\n"
        "force_x = { column = 'Fx', unit = 'N' }\nacceleration_x = { column = 'ax', unit = 'm/s^2' }\n"
        "[[measurement]]\nname = 'idle'\nmethod = 'hammer'\nrecords = [{ file = 'hit.csv', excitation = 'x' }]\n"
        "[machine.axis.x]\nmoving_mass = '3200 kg'\n"
        "controllers.K1 = { Kp = '263000 N s/m', Ti = '30 ms', delay = '2 ms' }\n"
    )

    def load(self, folder: Path, baseline: str) -> Campaign:
        (folder / "hit.csv").write_text("t,Fx,ax\n0,0,0\n", encoding="utf-8")
        path = folder / "campaign.toml"
        path.write_text(self.TEXT + baseline, encoding="utf-8")
        return load_campaign(path)

    def test_they_are_what_the_modes_ride_on_and_a_gain_may_be_unknown(self, tmp_path: Path) -> None:
        campaign = self.load(tmp_path, "[baseline]\nfrom = 'idle'\n")
        assert isinstance(campaign.baseline, ModesOf)
        axis = campaign.baseline.axes["x"]
        assert axis.moving_mass == 3200.0
        assert axis.controllers["K1"] == (263000.0, pytest.approx(0.03), None, pytest.approx(0.002))
        assert axis.friction is None
        assert campaign.machine_model is None

    def test_alone_they_are_no_machine(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="Kv"):
            self.load(tmp_path, "")
