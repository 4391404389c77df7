"""Claims: a check says what a run would refuse, names planted faults, and is silent on healthy campaigns."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from samples.campaigns import DRIVE
from truth import workshop

from smfe.campaign import load_campaign
from smfe.commands import run as run_command
from smfe.commands.check import check, refusals
from smfe.diagnosis.audit import audit
from smfe.diagnosis.checks.suspect import Suspect
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
