"""Claims: a check says what a run would refuse, names planted faults, and is silent on healthy campaigns."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from samples.campaigns import DRIVE
from truth import workshop

from process.cut.engagement import CUTS, Engagement, engagement
from process.cut.tool import Tool
from process.labels import make_record
from smfe.campaign import load_campaign
from smfe.commands import run as run_command
from smfe.commands.check import check, refusals
from smfe.diagnosis.audit import audit
from smfe.diagnosis.checks.cuts import tooth_suspects
from smfe.diagnosis.checks.same_data import Seen, same_suspects
from smfe.diagnosis.checks.suspect import Suspect
from smfe.identification.sweep.passes import in_cut
from smfe.results import read_groups


@pytest.fixture
def shop(tmp_path: Path) -> workshop.Workshop:
    """A campaign of two hammer measurements and a model: one of two that differ is known to be the wrong one."""
    found = workshop.healthy(1027)
    assert [p.keys.get("name") for p in found.parts[:2]] == ['"tip 1"', '"hammer_2"']
    found.model = workshop.model_text(found, np.ones(len(found.modes["frequency"])))
    workshop.write(found, tmp_path)
    return found


def levels(folder: Path) -> dict[str, list[str]]:
    table = check(folder / "campaign.toml")
    return {level: list(table.loc[table["level"] == level, "cause"]) for level in ("fault", "warning")}


@pytest.mark.parametrize("seed", [1000, pytest.param(1005, marks=pytest.mark.slow)])
def test_healthy_campaigns_are_silent(seed: int, tmp_path: Path) -> None:
    workshop.write(workshop.healthy(seed), tmp_path)
    assert levels(tmp_path) == {"fault": [], "warning": []}


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("one accelerometer 9.8 times too large", "unit_error"),
        ("one record under two names", "same_data"),
        ("wrong stated speed", "spindle_speed"),
        pytest.param("wrong pulses of the tacho", "spindle_speed", marks=pytest.mark.slow),
        ("block of NaN", "unusable"),
        pytest.param("force 1000 times too small (cut)", "unit_error", marks=pytest.mark.slow),
        ("acceleration of the wrong sign", "sensor_gain"),
    ],
)
def test_a_planted_fault_of_a_record_is_found_by_the_audit(fault: str, cause: str, tmp_path: Path) -> None:
    found = [s.cause for s in audit(load_campaign(planted(fault, tmp_path) / "campaign.toml")) if s.level == "fault"]
    # Exchanged or doubled records may first be unusable for another reason: the hits are then on no force channel.
    assert cause in found or (fault == "one record under two names" and "unusable" in found)


@pytest.mark.parametrize(
    "fault",
    ["no modes for the method asked", pytest.param("tooth passing above the band", marks=pytest.mark.slow)],
)
def test_a_request_that_a_run_would_refuse_is_unusable_before_anything_is_computed(fault: str, tmp_path: Path) -> None:
    assert "unusable" in levels(planted(fault, tmp_path))["fault"]


def planted(fault: str, folder: Path) -> Path:
    """Write the first campaign that can have a fault, with it; return its folder."""
    for seed in range(1000, 1040):
        shop = workshop.healthy(seed)
        if workshop.write(shop, folder / str(seed)) and workshop.FAULTS[fault](shop, folder / str(seed)):
            return folder / str(seed)
    raise AssertionError(f"no campaign can have the fault '{fault}'")


@pytest.mark.slow
def test_a_run_leaves_out_what_the_check_finds_and_computes_the_rest(
    shop: workshop.Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_command, "report", lambda folder, progress: Path(folder) / "report.html")
    part = shop.parts[1]
    for record, _ in part.records:
        for name in record.data:
            record.data[name] = record.data[name] * (workshop.G if name.startswith("acceleration") else 1.0)
        workshop.write_record(shop, record, tmp_path)
    run_command.run(tmp_path / "campaign.toml", tmp_path / "results")
    kept = json.loads((tmp_path / "results" / "provenance.json").read_text())
    (failed,) = (f for f in kept["failures"] if f["part"] == "measurement")
    assert failed["name"] == "hammer_2"
    assert "acceleration in g" in failed["reason"]
    assert {s["cause"] for s in kept["check"] if s["level"] == "fault"} == {"unit_error"}
    assert "tip 1" in read_groups(tmp_path / "results" / "frf.nc")


def test_one_record_for_two_conditions_is_a_fault_and_for_two_methods_is_none() -> None:
    one = Seen(("measurement", "a"), "x.csv", ("'K2'",), "1")
    assert not list(same_suspects([one, Seen(("measurement", "b"), "x.csv", ("'K2'",), "1")]))
    assert not list(same_suspects([one, Seen(("measurement", "b"), "x.csv", ("None",), "1")]))
    (copied,) = same_suspects([one, Seen(("measurement", "b"), "y.csv", ("'K2'",), "1")])
    assert (copied.level, copied.excludes) == ("warning", ())
    (wrong,) = same_suspects([one, Seen(("measurement", "b"), "x.csv", ("'K3'",), "1")])
    assert wrong.level == "fault"
    assert dict(wrong.excludes) == {"measurement": "b"}
    assert len(wrong.excludes) == 2
    assert not list(same_suspects([one, Seen(("measurement", "b"), "y.csv", ("'K3'",), "2")]))


def test_the_generator_moves_as_its_machine_does() -> None:
    """A force at rest for long, then held: the motion ends at the compliance at rest times the force."""
    shop = workshop.healthy(3)
    n = round(12.0 / float(np.min(shop.modes["frequency"] * shop.modes["damping"])) * shop.rate)
    force = np.zeros((3, n))
    ramp = np.clip((np.arange(n) - 0.1 * n) / (0.3 * n), 0.0, 1.0)
    force[0] = 100.0 * (3.0 * ramp**2 - 2.0 * ramp**3)
    moved = np.cumsum(np.cumsum(workshop.acceleration(shop, force), axis=1), axis=1) / shop.rate**2
    still = workshop.receptance(shop.modes, np.zeros(1))[0, :, 0].real
    np.testing.assert_allclose(moved[0, round(0.7 * n)], 100.0 * still[0], rtol=0.05)


# --- number of teeth -------------------------------------------------------------------------------------------------

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


# --- what is asked of few records ------------------------------------------------------------------------------------


def taps(folder: Path, *measurements: str) -> list[Suspect]:
    """Audit a campaign of taps along x and y, each recorded along its own axis."""
    t = np.arange(6000) / 1000.0
    force = sum(1000.0 * np.sin(np.pi * np.clip(t - s, 0, 4e-3) / 4e-3) for s in (0.1, 2.1, 4.1))
    noise = np.random.default_rng(1)
    for axis, frequency in (("x", 50.0), ("y", 70.0)):
        r = np.fft.rfftfreq(2 * t.size, 1 / 1000.0) / frequency
        accelerance = -((2 * np.pi * frequency * r) ** 2) / (5e7 * (1.0 - r**2 + 2j * 0.03 * r))
        moved = np.fft.irfft(accelerance * np.fft.rfft(force, 2 * t.size))[: t.size]
        noisy = {
            "t": t,
            "F": force + 0.1 * noise.standard_normal(t.size),
            "a": moved + 1e-3 * noise.standard_normal(t.size),
        }
        pd.DataFrame(noisy).to_csv(folder / f"{axis}.csv", index=False)
    lobes = """
[tool]
diameter = "80 mm"
teeth = 2
[material]
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
Kac = "0 N/mm^2"
[[lobes]]
measurements = [{}]
method = "zero_order"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["900 rpm", "1000 rpm", "50 rpm"]
"""
    names = ", ".join(f'"{m.split(chr(34))[1]}"' for m in measurements)
    (folder / "campaign.toml").write_text("\n".join(['[campaign]\nname = "taps"', *measurements, lobes.format(names)]))
    return audit(load_campaign(folder / "campaign.toml"))


def tap(*axes: str, name: str, more: str = "") -> str:
    each = (
        f'{{ file = "{a}.csv", excitation = "{a}", channels = {{ time = {{ column = "t", unit = "s" }}, '
        f'force_{a} = {{ column = "F", unit = "N" }}, acceleration_{a} = {{ column = "a", unit = "m/s^2" }} }} }}'
        for a in axes
    )
    return f'[[measurement]]\nname = "{name}"\nmethod = "hammer"\n{more}\nrecords = [ {", ".join(each)} ]'


def test_two_taps_without_cross_terms_are_a_note_and_as_two_measurements_a_warning(tmp_path: Path) -> None:
    (note,) = taps(tmp_path, tap("x", "y", name="both"))
    assert (note.cause, note.level, note.where) == ("cross_terms", "note", "both")
    assert "xx, yy and no cross terms" in note.evidence
    (warning,) = taps(tmp_path, tap("x", name="one"), tap("y", name="other"))
    assert (warning.cause, warning.level, warning.where) == ("cross_terms", "warning", "one and other")
    assert "one [[measurement]] with both records" in warning.advice
    assert taps(tmp_path, tap("x", name="one", more='controller = "K1"'), tap("y", name="other")) == []


@pytest.mark.slow
def test_what_a_plan_would_refuse_is_said(tmp_path: Path) -> None:
    taps(tmp_path, tap("x", "y", name="both"))
    path = tmp_path / "campaign.toml"
    plain = path.read_text()

    def refused(to: float) -> list[Suspect]:
        band = f'frequency_range = ["20 Hz", "{to} Hz"]\nsample_rate = "20 kHz"'
        path.write_text(f'{plain}\n[plan]\nmachine = "both"\n{band}\n')
        return [s for s in refusals(load_campaign(path), {}, []) if s.where == "plan"]

    assert refused(80.0) == []
    (said,) = refused(900.0)
    assert (said.cause, said.level) == ("unusable", "fault")
    assert "the estimate 'both' holds" in said.evidence


def test_one_stroke_is_too_little_for_a_drive_and_the_check_says_so(tmp_path: Path) -> None:
    rng, t = np.random.default_rng(1), np.arange(0.0, 6.0, 1e-3)
    speed = 0.1 * np.clip((t - 1.0) / 0.5, 0.0, 1.0) * np.clip((5.0 - t) / 0.5, 0.0, 1.0)
    force = 95.0 * np.gradient(speed, t) + 20.0 * (speed > 1e-6) + 200.0 * speed + 0.5 * rng.standard_normal(t.size)
    place = np.cumsum(speed) * 1e-3 + 1e-6 * rng.standard_normal(t.size)
    frame = pd.DataFrame({"time [s]": t, "enc_x [m]": place, "Fd_x [N]": force})
    frame.to_csv(tmp_path / "stroke.csv", index=False)
    baseline = '[baseline]\ndrive = "rigid"\naxis = "x"\nmoving_mass = "95 kg"\n'
    (tmp_path / "campaign.toml").write_text(DRIVE + baseline)
    (row,) = check(tmp_path / "campaign.toml").to_dict("records")
    assert (row["cause"], row["level"], row["where"]) == ("unusable", "fault", "diagnosis")
    assert "record more moves" in row["evidence"]
