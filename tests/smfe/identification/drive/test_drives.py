"""Inertia and friction of a drive: motions written down exactly, drives simulated apart from the package, an axis."""

import math
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from places import CHECKOUT
from samples.campaigns import DRIVE
from truth.drive_rig import draw, truths

import smfe
from process.errors import InputError
from process.labels import make_record
from smfe.commands.check import check
from smfe.commands.files.look import look
from smfe.identification.drive.parameters import identify_drive
from smfe.identification.drive.results import DriveFit, DriveParameter

REPOSITORY = CHECKOUT
EMPS = Path(os.environ.get("SMFE_DATA", REPOSITORY.parent / "shared" / "data")) / "emps" / "DATA_EMPS.mat"
RATE = 1000.0
MASS, COULOMB, VISCOUS = 240.0, (310.0, 270.0), (900.0, 1100.0)


def strokes(fastest: float = 0.3, count: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Acceleration, velocity and position at 1 kHz of strokes to and fro with smooth ends, each slower."""
    velocity = [np.zeros(300)]
    for k in range(count):
        rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(250) / 250)
        one = np.concatenate([rise, np.ones(300), rise[::-1], np.zeros(200)])
        velocity += [fastest * one / (1 + k), -fastest * one / (1 + k)]
    v = np.concatenate([*velocity, np.zeros(100)])
    return np.gradient(v) * RATE, v, np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))]) / RATE


def friction(v: np.ndarray) -> np.ndarray:
    up, down = v > 0.0, v < 0.0
    return up * (COULOMB[0] + VISCOUS[0] * v) - down * (COULOMB[1] - VISCOUS[1] * v)


def record(place: np.ndarray, force: np.ndarray, rotary: bool = False) -> xr.Dataset:
    names = ("encoder_angle", "drive_torque") if rotary else ("encoder_position", "drive_force")
    channels = dict(zip(names, ({"x": place}, {"x": force}), strict=True))
    return make_record(np.arange(place.size) / RATE, channels, attrs={"source": "r.csv"})


def exact(noise: float = 0.0, constant: float = 0.0, rotary: bool = False, seed: int = 0) -> xr.Dataset:
    a, v, x = strokes()
    rng = np.random.default_rng(seed)
    return record(x, MASS * a + friction(v) + constant + noise * rng.standard_normal(x.size), rotary)


def of(fit: DriveFit, name: str, way: str = "both") -> DriveParameter:
    return next(p for p in fit.parameters if (p.name, p.direction) == (name, way))


@pytest.fixture(scope="module")
def without_noise() -> DriveFit:
    return identify_drive("m", [exact()])


@pytest.fixture(scope="module")
def with_noise() -> DriveFit:
    return identify_drive("m", [exact(3.0)])


def test_strokes_that_are_written_down_come_back(without_noise: DriveFit) -> None:
    fit = without_noise
    assert of(fit, "inertia").value == pytest.approx(MASS, rel=1e-3)
    for k, way in enumerate(("forward", "backward")):
        assert of(fit, "coulomb", way).value == pytest.approx(COULOMB[k], rel=5e-3)
        assert of(fit, "viscous", way).value == pytest.approx(VISCOUS[k], rel=2e-2)
    assert fit.remaining < 1e-3


def test_an_angle_and_a_torque_give_the_same_numbers_in_units_of_turning(with_noise: DriveFit) -> None:
    turning = identify_drive("m", [exact(3.0, rotary=True)])
    for p, q in zip(with_noise.parameters, turning.parameters, strict=True):
        assert (p.name, p.direction) == (q.name, q.direction)
        np.testing.assert_equal([p.value, p.low, p.high], [q.value, q.low, q.high])
    assert of(turning, "inertia").unit == "kg m^2"
    assert of(turning, "viscous", "forward").unit == "N m s/rad"


def test_a_record_turned_round_exchanges_the_directions(with_noise: DriveFit) -> None:
    plain = exact(3.0)
    turned = record(-plain["encoder_position"].values[0], -plain["drive_force"].values[0])
    one, other = with_noise, identify_drive("m", [turned])
    assert of(one, "inertia").value == pytest.approx(of(other, "inertia").value, rel=1e-6)
    for name in ("coulomb", "viscous"):
        assert of(one, name, "forward").value == pytest.approx(of(other, name, "backward").value, rel=1e-4)


def test_weight_raises_one_way_and_lowers_the_other(without_noise: DriveFit) -> None:
    without, hanging = without_noise, identify_drive("m", [exact(constant=150.0)])
    for way, sign in (("forward", 1.0), ("backward", -1.0)):
        change = of(hanging, "coulomb", way).value - of(without, "coulomb", way).value
        assert change == pytest.approx(150.0 * sign, abs=0.5)
    assert of(hanging, "coulomb").value == pytest.approx(of(without, "coulomb").value, abs=0.5)
    assert of(hanging, "inertia").value == pytest.approx(of(without, "inertia").value, rel=1e-4)


def test_a_force_that_acts_later_than_it_is_logged_has_its_delay() -> None:
    a, v, x = strokes()
    late = np.interp(np.arange(x.size) + 2.4, np.arange(x.size), MASS * a + friction(v))
    found = of(identify_drive("m", [record(x, late)]), "delay")
    assert found.low < 2.4e-3 < found.high
    assert found.value == pytest.approx(2.4e-3, abs=5e-5)


def test_a_known_mass_is_taken_and_not_fitted() -> None:
    plain = exact(3.0)
    known = identify_drive("m", [plain], known=(MASS, "mass"))
    assert not any(p.name == "inertia" for p in known.parameters)
    assert of(known, "coulomb", "forward").value == pytest.approx(COULOMB[0], rel=1e-2)
    with pytest.raises(InputError, match=r"moving_mass is an inertia, but the records are those of a linear drive"):
        identify_drive("m", [plain], known=(0.1, "inertia"))


def test_a_drive_that_gives_out_energy_is_refused() -> None:
    plain = exact(3.0)
    turned = record(plain["encoder_position"].values[0], -plain["drive_force"].values[0])
    with pytest.raises(InputError, match=r"give out energy.*check the sign"):
        identify_drive("m", [turned])


def test_an_axis_that_does_not_move_is_refused() -> None:
    with pytest.raises(InputError, match=r"encoder_position_x is 0 m in all samples; take a record of an axis that"):
        identify_drive("m", [record(np.zeros(3000), np.random.default_rng(0).standard_normal(3000))])


def test_torque_steps_declared_as_forces_are_no_mass_of_a_billionth() -> None:
    """A small servo on a bench: 2e-7 kg m^2, which read as metres and newtons is no mass that a drive moves."""
    _, v, x = strokes(fastest=150.0)
    a = np.gradient(v) * RATE
    torque = 2e-7 * a + 4e-5 * np.sign(v) + 2e-7 * v
    turning = identify_drive("bench", [record(x, torque, rotary=True)])
    assert of(turning, "inertia").value == pytest.approx(2e-7, rel=1e-2)
    straight = of(identify_drive("bench", [record(x, torque)]), "inertia")
    assert math.isnan(straight.value)
    assert "2e-07 kg is no inertia of a drive; check the units" in straight.note


def runs(slowest: float, boost: float) -> xr.Dataset:
    """Constant velocities from `slowest` to 0.3 m/s both ways; friction rises below 8 mm/s by `boost` newtons."""
    speeds = np.geomspace(slowest, 0.3, 7)
    velocity = [np.zeros(200)]
    for s in speeds:
        rise = s * (0.5 - 0.5 * np.cos(np.pi * np.arange(150) / 150))
        one = np.concatenate([rise, np.full(500, s), rise[::-1], np.zeros(100)])
        velocity += [one, -one]
    v = np.concatenate(velocity)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))]) / RATE
    force = MASS * np.gradient(v) * RATE + friction(v) + boost * np.sign(v) * np.exp(-np.abs(v) / 8e-3)
    return record(x, force + 2.0 * np.random.default_rng(1).standard_normal(x.size))


def test_slow_and_fast_motion_shows_the_stribeck_curve() -> None:
    fit = identify_drive("m", [runs(1e-3, 200.0)])
    for k, way in enumerate(("forward", "backward")):
        speed, static = of(fit, "stribeck_speed", way), of(fit, "static", way)
        assert speed.low < 8e-3 < speed.high < 1.2 * speed.low
        assert static.low < COULOMB[k] + 200.0 < static.high < 1.2 * static.low


def test_motion_that_is_never_slow_gives_no_stribeck_speed() -> None:
    fit = identify_drive("m", [runs(0.1, 200.0)])
    for way in ("forward", "backward"):
        assert math.isnan(of(fit, "stribeck_speed", way).value)
        assert math.isnan(of(fit, "static", way).value)
    assert of(fit, "coulomb", "forward").low < COULOMB[0] < of(fit, "coulomb", "forward").high


@pytest.mark.parametrize("step", [0.0, 1e-6])
def test_one_velocity_shows_neither_inertia_nor_viscous_friction(step: float) -> None:
    v = np.full(4000, 0.2)
    x = np.cumsum(v) / RATE
    x = x if step == 0.0 else step * np.round(x / step + np.random.default_rng(4).uniform(-0.5, 0.5, x.size))
    noisy = friction(v) + 3.0 * np.random.default_rng(2).standard_normal(v.size)
    with pytest.raises(InputError, match=r"determine nothing of the drive of axis x \(inertia: not determined"):
        identify_drive("m", [record(x, noisy)])


def test_cogging_is_found_and_taken_out_of_the_friction() -> None:
    a, v, x = strokes()
    force = MASS * a + friction(v) + 40.0 * np.sin(2.0 * np.pi * x / 0.024 + 0.7)
    fit = identify_drive("m", [record(x, force + np.random.default_rng(3).standard_normal(x.size))])
    assert any("repeat along the stroke" in note and "0.024 m" in note for note in fit.notes)
    assert of(fit, "coulomb").value == pytest.approx(sum(COULOMB) / 2, rel=5e-3)


@pytest.mark.slow
def test_the_intervals_hold_on_drives_that_were_simulated_apart() -> None:
    """Linear and rotary, 24 draws: quantised encoders, noisy torque, delays, cogging, weight, Stribeck curves."""
    inside, given = 0, 0
    for seed in range(300, 324):
        rig, r = draw(seed, ("stroke", "strokes", "step")[seed % 3])
        names = ("encoder_angle", "drive_torque") if rig.rotary else ("encoder_position", "drive_force")
        channels = dict(zip(names, ({"x": r["place"]}, {"x": r["force"]}), strict=True))
        for p in identify_drive("m", [make_record(r["time"], channels)]).parameters:
            truth = truths(rig).get((p.name, p.direction))
            if truth is not None and math.isfinite(p.value):
                given += 1
                inside += p.low <= truth <= p.high
    assert given > 90
    assert inside / given > 0.9


@pytest.mark.slow
def test_the_public_axis_has_its_published_mass() -> None:
    """Janot, Gautier and Brunot 2019: 95.15 kg; friction is higher backward, the force acts 0.65 to 0.85 ms late."""
    if not EMPS.is_file():
        pytest.skip("public data not here: emps (set SMFE_DATA)")
    from scipy.io import loadmat

    data = loadmat(EMPS)
    time, place, volts = (np.ravel(data[n]) for n in ("t", "qm", "vir"))
    channels = {"encoder_position": {"x": place}, "drive_force": {"x": 35.15065188 * volts}}
    fit = identify_drive("moves", [make_record(time, channels)])
    inertia, delay = of(fit, "inertia"), of(fit, "delay")
    assert inertia.low < 95.154 < inertia.high
    assert (inertia.high - inertia.low) / inertia.value < 0.03
    assert 0.65e-3 < delay.value < 0.85e-3
    assert of(fit, "viscous", "backward").low > of(fit, "viscous", "forward").high


def written(folder: Path) -> Path:
    """One stroke to and fro as a file, with the names that controls use."""
    r = exact(3.0)
    frame = pd.DataFrame(
        {
            "time [s]": r["time"].values,
            "enc_x [m]": r["encoder_position"].values[0],
            "Fd_x [N]": r["drive_force"].values[0],
        }
    )
    frame.to_csv(folder / "stroke.csv", index=False)
    return folder / "stroke.csv"


def test_a_run_writes_the_drive_into_its_results_and_its_report(tmp_path: Path) -> None:
    written(tmp_path)
    (tmp_path / "c.toml").write_text(DRIVE)
    report = smfe.run(tmp_path / "c.toml", tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "drives.csv")
    row = table[table["parameter"] == "inertia"].iloc[0]
    assert row["low"] < MASS < row["high"]
    assert row["unit"] == "kg"
    page = report.read_text()
    assert "plot-drive-1" in page
    assert (tmp_path / "out" / "figures" / "drive_1.png").stat().st_size > 1e4
    friction_table = pd.read_csv(tmp_path / "out" / "tables" / "stroke.friction_x.csv")
    curve = friction_table[friction_table["kind"] == "curve"]
    v = curve["velocity [m/s]"].to_numpy()
    np.testing.assert_allclose(curve["force [N]"], friction(v), rtol=0.03)


@pytest.mark.slow
def test_a_drive_that_cannot_be_identified_fails_alone_and_the_check_says_so(tmp_path: Path) -> None:
    path = written(tmp_path)
    frame = pd.read_csv(path)
    frame["Fd_x [N]"] *= -1.0
    frame.to_csv(tmp_path / "turned.csv", index=False)
    text = DRIVE + DRIVE.split("[[measurement]]")[1].join(["[[measurement]]", ""])
    text = text.replace('name = "stroke"', 'name = "turned"', 1).replace('"stroke.csv"', '"turned.csv"', 1)
    (tmp_path / "c.toml").write_text(text)
    said = check(tmp_path / "c.toml")
    fault = said[said["level"] == "fault"].iloc[0]
    assert fault["where"] == "turned"
    assert "give out energy" in fault["evidence"]
    failures: list = []
    smfe.identify(tmp_path / "c.toml", tmp_path / "frf.nc", failures=failures)
    assert [f.name for f in failures] == ["turned"]
    assert set(pd.read_csv(tmp_path / "drives.csv")["measurement"]) == {"stroke"}


@pytest.mark.slow
def test_the_starter_of_a_stroke_checks_and_gives_numbers(tmp_path: Path) -> None:
    result = look(written(tmp_path), tmp_path)
    assert result.kind.name == "drive stroke"
    starter = tmp_path / "stroke.csv.look.toml"
    assert not (check(starter)["level"] == "fault").any()
    smfe.identify(starter, tmp_path / "frf.nc")
    row = pd.read_csv(tmp_path / "drives.csv").query("parameter == 'inertia'").iloc[0]
    assert row["low"] < MASS < row["high"]
