"""Claims about `smfe coefficients`: the coefficients of cuts come back, within their intervals."""

import math
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from truth.cutting import FEEDS, Mill, measure_cuts
from typer.testing import CliRunner

import smfe
from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_record
from smfe.cli import app
from smfe.commands.coefficients import CUTTING, EDGE, Coefficients, average_force, mean_force_design
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.cutting.rigid import rigid_orders
from smfe.records import read_records, write_record_netcdf

TRUE = {"Ktc": 1.8e9, "Krc": 7e8, "Kac": 2e8, "Kte": 30e3, "Kre": 40e3, "Kae": 5e3}
TOOL = Tool(0.05, 4, approach_angle=math.radians(70.0))


def cuts() -> list[SteadyCut]:
    arc = engagement("down", 0.03, TOOL.diameter)
    return [SteadyCut(150.0, 1e-3 * f, 2e-3, arc) for f in (0.05, 0.1, 0.15, 0.2, 0.25)]


def draw(rng: np.random.Generator, noise: float) -> list[tuple[SteadyCut, np.ndarray]]:
    truth = np.array([TRUE[n] for n in (*CUTTING, *EDGE)])
    return [(c, mean_force_design(TOOL, c) @ truth + noise * rng.standard_normal(3)) for c in cuts()]


def test_the_mean_of_a_slot_in_closed_form() -> None:
    """Straight teeth in a slot: ``Fx = -N a (Krc f/4 + Kre/pi)``, ``Fy = N a (Ktc f/4 + Kte/pi)`` (Altintas)."""
    tool, cut = Tool(0.02, 3), SteadyCut(100.0, 1e-4, 2e-3, engagement("down", 0.02, 0.02))
    design = mean_force_design(tool, cut)
    size = 3 * 2e-3
    np.testing.assert_allclose(design[0], [0.0, -size * 1e-4 / 4, 0.0, 0.0, -size / math.pi, 0.0], atol=1e-12)
    np.testing.assert_allclose(design[1], [size * 1e-4 / 4, 0.0, 0.0, size / math.pi, 0.0, 0.0], atol=1e-12)


def test_it_is_the_mean_of_the_force_model() -> None:
    """The mean agrees with order 0 of the numerical orders that the diagnosis uses, helix or not."""
    for cut in cuts()[:2]:
        mean = mean_force_design(TOOL, cut) @ [TRUE[n] for n in (*CUTTING, *EDGE)]
        np.testing.assert_allclose(rigid_orders(TOOL, cut, 5, TRUE | {"helix": 0.3})[0].real, mean, rtol=2e-2, atol=1.0)
    assert force_harmonics(TOOL, cut.arc, CuttingCoefficients(1e9, 0.0, 0.0), 1e-3, 1e-4, [1]).shape == (1, 3)


def test_intervals_hold() -> None:
    """Of 400 draws with 2 N of noise 95 % of each interval hold the truth (within four standard deviations)."""
    rng = np.random.default_rng(1)
    hits = {n: 0 for n in TRUE}
    for _ in range(400):
        found = average_force(TOOL, draw(rng, 2.0))
        for name, (low, high) in found.intervals.items():
            hits[name] += low <= TRUE[name] <= high
    assert all(0.906 <= count / 400 <= 0.994 for count in hits.values()), hits


def test_what_does_not_determine_them_is_refused() -> None:
    with pytest.raises(InputError, match="3 cuts at 1 feeds per tooth; at least three cuts at two feeds"):
        average_force(TOOL, [draw(np.random.default_rng(0), 1.0)[0]] * 3)


CAMPAIGN = """
[campaign]
name = "slots"
[tool]
diameter = "50.8 mm"
teeth = 2
"""


@pytest.fixture(scope="module")
def slots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four slots of an independent generator, with noise, wander of the speed and run-out."""
    folder = tmp_path_factory.mktemp("slots")
    mill = Mill(helix=0.1, runout=1e-5, edge=(25e3, 30e3, 4e3))
    text = CAMPAIGN
    for k, record in enumerate(measure_cuts(mill, list(FEEDS), 5)):
        force = dict(zip("xyz", record["force"], strict=True))
        write_record_netcdf(make_record(record["time"], {"force": force}), folder / f"{k}.nc")
        text += f'[[cutting_test]]\nfile = "{k}.nc"\nspindle_speed = "1500 rpm"\ndepth_of_cut = "1 mm"\ncut = "down"\n'
        text += f'width_of_cut = "50.8 mm"\nfeed_per_tooth = "{1e3 * FEEDS[k].feed_per_tooth:g} mm"\n'
    (folder / "c.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def fits(slots: Path) -> list[Coefficients]:
    return smfe.coefficients(slots / "c.toml", slots / "material.toml")


def test_coefficients_of_an_independent_generator_come_back(slots: Path, fits: list[Coefficients]) -> None:
    average, orders = fits
    for found in (average, orders):
        for name, true in zip(CUTTING, (780e6, 351e6, 100e6), strict=True):
            assert found.values[name] == pytest.approx(true, abs=0.02 * 780e6)
        for name, true in zip(EDGE, (25e3, 30e3, 4e3), strict=True):
            assert found.values[name] == pytest.approx(true, abs=0.05 * 30e3)
        assert found.residual < 0.2
        assert not found.warnings
    material = tomllib.loads((slots / "material.toml").read_text())["material"]
    assert material["Ktc"].endswith("N/mm^2")
    (slots / "d.toml").write_text((slots / "c.toml").read_text() + (slots / "material.toml").read_text())
    assert smfe.load_campaign(slots / "d.toml").coefficients.Ktc == pytest.approx(780e6, rel=0.03)


def test_exchanged_axes_are_noticed(slots: Path) -> None:
    channels = "".join(f"force_{a} = {{ sign = {s} }}\n" for a, s in (("x", -1), ("y", -1), ("z", 1)))
    (slots / "e.toml").write_text((slots / "c.toml").read_text() + "[channels]\n" + channels)
    done = CliRunner().invoke(app, ["coefficients", str(slots / "e.toml"), "-o", str(slots / "e.out")])
    assert done.exit_code == 0
    assert "a force channel has the wrong sign or axis" in " ".join(done.output.split())


@pytest.mark.skipif("SMFE_DATA" not in os.environ, reason="public data are not here: SMFE_DATA is not set")
def test_the_public_slots_give_the_published_coefficients(tmp_path: Path) -> None:
    """K_tc 959, K_rc 251, K_ac 146 N/mm^2 by mean forces, with x and y of the dynamometer exchanged."""
    folder = Path(os.environ["SMFE_DATA"]) / "milling_forces_ubc"
    if not folder.is_dir():
        pytest.skip("milling_forces_ubc is not in SMFE_DATA")
    text = CAMPAIGN.replace("50.8 mm", "25 mm") + '[channels]\ntime = { column = "Time", unit = "s" }\n'
    for axis, column, sign in (("x", "Fy", 1), ("y", "Fx", 1), ("z", "Fz", -1)):
        text += f'force_{axis} = {{ column = "{column}", unit = "N", sign = {sign} }}\n'
    for feed in (300, 600, 900, 1200, 1500):
        text += f'[[cutting_test]]\nfile = "{folder}/6-n6000f{feed}ap3ae25.csv"\nspindle_speed = "6000 rpm"\n'
        text += f'depth_of_cut = "3 mm"\ncut = "down"\nwidth_of_cut = "25 mm"\nfeed_per_tooth = "{feed / 12000:g} mm"\n'
    (tmp_path / "c.toml").write_text(text)
    average, orders = smfe.coefficients(tmp_path / "c.toml")
    assert [1e-6 * average.values[n] for n in CUTTING] == pytest.approx([959.0, 251.0, 146.0], abs=0.6)
    assert any("prefer the average forces" in w for w in orders.warnings), "resonances of this dynamometer"


def test_records_in_memory_give_what_the_campaign_gives(slots: Path, fits: list[Coefficients]) -> None:
    campaign = smfe.read_campaign(slots / "c.toml")
    said = {"cut": "down", "width_of_cut": "50.8 mm", "depth_of_cut": "1 mm", "spindle_speed": "1500 rpm"}
    records = []
    for test in campaign.cutting_tests:
        held = smfe.read_record(test.file, test.channels)
        force = {f"force_{a}": held["force"].sel(axis=a).values for a in "xyz"}
        records.append(smfe.record(time=held["time"], feed_per_tooth=test.feed_per_tooth, **said, **force))
    found = smfe.coefficients(records, tool={"diameter": "50.8 mm", "teeth": 2})
    for one, other in zip(found, fits, strict=True):
        # A helix of 1e-5 rad is none: it is what is left of rounding.
        assert {**one.values, "helix": 0.0} == pytest.approx({**other.values, "helix": 0.0}, rel=1e-6)
        assert one.values.get("helix", 0.0) == pytest.approx(other.values.get("helix", 0.0), abs=1e-5)
    assert found[0].cutting_coefficients.Ktc == found[0].values["Ktc"]
    assert "95 % from" in found[0]._repr_html_()
    del records[0].attrs["depth_of_cut_mm"]
    with pytest.raises(InputError, match="depth_of_cut is missing"):
        smfe.coefficients(records, tool=TOOL)


def test_air_before_and_after_the_cut_and_the_zero_of_the_dynamometer_change_nothing(slots: Path) -> None:
    """A second of air at both ends takes a third off the mean, and 20 N of zero would be edge forces."""
    rng = np.random.default_rng(3)
    plain, padded = CAMPAIGN, CAMPAIGN
    offset = np.array([20.0, -10.0, 5.0])
    for k, feed in enumerate(FEEDS):
        record = read_records(slots / f"{k}.nc", {})[0]
        dt = float(record["time"].values[1] - record["time"].values[0])
        force = record["force"].sel(axis=["x", "y", "z"]).transpose("axis", "time").values
        air = rng.standard_normal((2, 3, round(1.0 / dt)))
        whole = np.hstack([air[0], force, air[1]]) + offset[:, None]
        data = {"force": dict(zip("xyz", whole, strict=True))}
        write_record_netcdf(make_record(dt * np.arange(whole.shape[1]), data), slots / f"air_{k}.nc")
        rest = 'spindle_speed = "1500 rpm"\ndepth_of_cut = "1 mm"\ncut = "down"\nwidth_of_cut = "50.8 mm"\n'
        rest += f'feed_per_tooth = "{1e3 * feed.feed_per_tooth:g} mm"\n'
        plain += f'[[cutting_test]]\nfile = "{k}.nc"\n{rest}'
        padded += f'[[cutting_test]]\nfile = "air_{k}.nc"\n{rest}'
    (slots / "plain.toml").write_text(plain)
    (slots / "padded.toml").write_text(padded)
    one, other = (smfe.coefficients(slots / name)[0] for name in ("plain.toml", "padded.toml"))
    for name in (*CUTTING, *EDGE):
        scale = 780e6 if name in CUTTING else 30e3
        assert other.values[name] == pytest.approx(one.values[name], abs=0.01 * scale), name


BENCH = """
[scenario]
name = "slots on the bench"
seed = 5
[machine.axis.x]
moving_mass = "23.1 kg"
tip_mass = "11.3 kg"
stiffness = "1.68 N/um"
damping = "104 N s/m"
controllers.K3 = { Kp = "10590 N s/m", Ti = "6.4 ms", Kv = "77 1/s" }
[machine.axis.x.friction]
law = "andersson"
coulomb = "44.2 N"
static = "84 N"
stribeck_speed = "387.4 mm/min"
sigma = "168 N s/m"
kt = "15000 s/m"
[tool]
diameter = "16 mm"
teeth = 2
[material]
Ktc = "780 N/mm^2"
Krc = "351 N/mm^2"
[sensors]
dynamometer = { mass = "4 kg", noise = "2 N" }
"""


@pytest.mark.slow
def test_the_coefficients_of_the_bench_come_back_from_simulated_slots(tmp_path: Path) -> None:
    """780 and 351 N/mm^2 of Franco et al. 2024, 2400 rpm, 1 mm, four feeds, in motion under K3; seed 5."""
    text = BENCH
    for feed in (0.05, 0.1, 0.15, 0.2):
        text += f'[[trial]]\nname = "slot_{feed:g}"\nmethod = "cut"\nspindle_speed = "2400 rpm"\n'
        text += f'depth_of_cut = "1 mm"\nfeed_per_tooth = "{feed:g} mm"\ncut = "down"\nwidth_of_cut = "16 mm"\n'
        text += 'duration = "1.5 s"\ncontroller = "K3"\n'
    (tmp_path / "bench.toml").write_text(text)
    smfe.simulate(tmp_path / "bench.toml", tmp_path / "campaign")
    found = smfe.coefficients(tmp_path / "campaign" / "campaign.toml")[0]
    assert found.method == "average force"
    for name, true in (("Ktc", 780e6), ("Krc", 351e6), ("Kac", 0.0), ("Kte", 0.0), ("Kre", 0.0), ("Kae", 0.0)):
        low, high = found.intervals[name]
        assert low < true < high, name
    assert found.intervals["Ktc"][1] - found.intervals["Ktc"][0] < 0.03 * 780e6
