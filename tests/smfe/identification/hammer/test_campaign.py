"""The keys of a campaign that say how hits and steps become a compliance, each with its bad input."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_record
from smfe import identify, run
from smfe.campaign import load_campaign
from smfe.identification.errors.intervals import interval
from smfe.identification.levels import condition_cubes
from smfe.identification.measurement import identify_measurement, split_levels
from smfe.records.write import write_record_netcdf
from smfe.results import read_groups

RATE = 1000.0
MASS, STIFFNESS, DAMPING = 20.0, 3e6, 300.0


def answer(force: np.ndarray, mass: float = MASS) -> np.ndarray:
    """Displacement of one mass on a spring: exact for its poles, force taken as steps, by recursion."""
    dt = 1.0 / RATE
    w, delta = np.sqrt(STIFFNESS / mass - (0.5 * DAMPING / mass) ** 2), 0.5 * DAMPING / mass
    t = np.arange(force.size) * dt
    kernel = np.exp(-delta * t) * np.sin(w * t) / (mass * w)
    n = 2 * force.size
    return np.fft.irfft(np.fft.rfft(force, n) * np.fft.rfft(kernel, n), n)[: force.size] * dt


def exact(frequency: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * frequency
    return 1.0 / (MASS * s**2 + DAMPING * s + STIFFNESS)


def hits(folder: Path, name: str = "hits.nc", mass: float = MASS, level: float = 100.0, drift: float = 0.0) -> None:
    t = np.arange(round(8.0 * RATE)) / RATE
    force = np.zeros(t.size)
    for k in range(4):
        u = (t - 0.2 - 2.0 * k) / 6e-3
        force += np.where((u > 0.0) & (u < 1.0), level * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
    rng = np.random.default_rng(3)
    moved = answer(force, mass) + drift * t + 1e-9 * rng.standard_normal(t.size)
    record = make_record(t, {"force": {"x": force + 0.01 * rng.standard_normal(t.size)}, "displacement": {"x": moved}})
    write_record_netcdf(record, folder / name)


def periodic(folder: Path) -> None:
    n = round(RATE)
    rng = np.random.default_rng(4)
    lines = np.zeros(n // 2 + 1, dtype=complex)
    lines[20:141] = 5.0 * np.exp(2j * np.pi * rng.uniform(size=121))
    force = np.tile(np.fft.irfft(0.5 * n * lines, n), 5)
    moved = np.tile(np.fft.irfft(0.5 * n * lines * exact(np.arange(lines.size)), n), 5)
    channels = {"force": {"x": force}, "displacement": {"x": moved + 1e-9 * rng.standard_normal(force.size)}}
    write_record_netcdf(make_record(np.arange(force.size) / RATE, channels), folder / "periodic.nc")


def campaign(folder: Path, *tables: str) -> Path:
    path = folder / "campaign.toml"
    path.write_text('[campaign]\nname = "keys"\n' + "\n".join(f"[[measurement]]\n{table}" for table in tables))
    return path


def table(keys: str = "", name: str = "hammer", method: str = "hammer", file: str = "hits.nc") -> str:
    record = f'records = [ {{ file = "{file}", excitation = "x" }} ]'
    return f'name = "{name}"\nmethod = "{method}"\nfrequency_range = ["20 Hz", "120 Hz"]\n{record}\n{keys}\n'


def identified(folder: Path, *tables: str) -> dict[str, xr.Dataset]:
    loaded = load_campaign(campaign(folder, *tables))
    return {m.name: identify_measurement(loaded, m).compliance for m in loaded.measurements}


def error(found: xr.Dataset) -> float:
    truth = exact(found["frequency"].values)
    return float(np.abs(found["compliance"].values[:, 0, 0] - truth).max() / np.abs(truth).max())


@pytest.fixture(scope="module")
def with_hits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hits")
    hits(folder)
    return folder


def test_each_key_reaches_the_estimate(with_hits: Path) -> None:
    keys = ('estimator = "Hv"', "force_window = true", 'exponential_window = "0.3 s"', "remove_background = true")
    found = identified(with_hits, table(name="plain"), *(table(key, name=key.split(" ")[0]) for key in keys))
    plain = found.pop("plain")
    assert plain.attrs["estimator"] == "H1"
    assert found["estimator"].attrs["estimator"] == "Hv"
    assert found["exponential_window"].attrs["exponential_window_s"] == 0.3
    for name, dataset in found.items():
        assert error(dataset) < 0.01, name
        assert not np.array_equal(dataset["compliance"].values, plain["compliance"].values), name


def test_the_mass_of_the_accelerometer_is_taken_off(tmp_path: Path) -> None:
    """30 g would not show on 20 kg; 0.5 kg moves the resonance by 1.2 %, and taken off leaves 1 %."""
    hits(tmp_path, mass=MASS + 0.5)
    found = identified(tmp_path, table(name="heavy"), table('accelerometer_mass = "500 g"', name="corrected"))
    assert error(found["heavy"]) > 0.1
    assert error(found["corrected"]) < 0.01
    assert found["corrected"].attrs["attached_mass_kg"] == 0.5


def test_a_feed_removes_the_background_unless_the_campaign_says_otherwise(tmp_path: Path) -> None:
    hits(tmp_path, drift=500e-3 / 60.0)
    found = identified(
        tmp_path,
        table('feed = "500 mm/min"', name="moving"),
        table('feed = "500 mm/min"\nremove_background = false', name="left"),
        table('feed = "0 mm/min"', name="idle"),
    )
    assert error(found["moving"]) < 0.01
    assert error(found["left"]) > 0.2
    assert error(found["idle"]) > 0.2


def test_a_period_makes_the_actuator_periodic(tmp_path: Path) -> None:
    periodic(tmp_path)
    keys = 'period = "1 s"\nsettling = "1 s"'
    found = identified(tmp_path, table(keys, "multisine", "actuator", "periodic.nc"))["multisine"]
    assert error(found) < 1e-3
    assert found["degrees_of_freedom"].values == pytest.approx(6.0)
    heavier = identified(tmp_path, table(f'{keys}\nframe_mass = "1 kg"', "frame", "actuator", "periodic.nc"))["frame"]
    w2 = (2.0 * np.pi * found["frequency"].values) ** 2
    by_hand = found["compliance"].values[:, 0, 0] / (1.0 + w2 * found["compliance"].values[:, 0, 0])
    assert heavier["compliance"].values[:, 0, 0] == pytest.approx(by_hand)


def test_full_scale_marks_what_reaches_it(with_hits: Path) -> None:
    with pytest.raises(InputError, match=r"measurement 'hammer'.*the force is overloaded at 100"):
        identified(with_hits, table('full_scale = "100 N"'))


@pytest.mark.parametrize(
    ("keys", "method", "sentence"),
    [
        ('estimator = "H3"', "hammer", "estimator: estimator 'H3' is not known; available: H1, H2, Hv"),
        (
            'estimator = "bands"',
            "actuator",
            "estimator: 'bands' is no estimator of an actuator; take 'H1', 'H2', 'Hv', 'local_polynomial'",
        ),
        (
            'estimator = "H1"\nperiod = "1 s"',
            "actuator",
            "period: an estimator is for a force that does not repeat itself; take one of both out",
        ),
        ("force_window = 1", "hammer", "force_window: "),
        ('exponential_window = "0 s"', "hammer", "exponential_window: '0 s' is not possible; it must be positive"),
        ('exponential_window = "2 mm"', "hammer", "exponential_window: unit 'mm' is not a unit of time"),
        ('remove_background = "yes"', "hammer", "remove_background: "),
        ("split_levels = 3", "hammer", "split_levels: "),
        (
            "split_levels = true",
            "actuator",
            "split_levels: method 'actuator' does not read it; only a hammer or a sweep does",
        ),
        ('full_scale = "-5 N"', "hammer", "full_scale: '-5 N' is not possible; it must be positive"),
        ('accelerometer_mass = "30"', "hammer", "accelerometer_mass: '30' has no unit"),
        ('accelerometer_mass = "0 kg"', "hammer", "accelerometer_mass: '0 kg' is not possible; it must be positive"),
        ('frame_mass = "2 kg"', "hammer", "frame_mass: method 'hammer' does not read it; only an actuator does"),
        ('period = "-1 s"', "actuator", "period: '-1 s' is not possible; it must be positive"),
        ('period = "1 s"\nresolution = "1 Hz"', "actuator", "resolution: a periodic force has lines 1/period apart"),
        ('settling = "-1 s"', "actuator", "settling: '-1 s' is not possible; it must be zero or more"),
        ('settling = "1 s"', "hammer", "settling: method 'hammer' does not read it"),
    ],
)
def test_bad_keys_are_said_in_one_sentence(with_hits: Path, keys: str, method: str, sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        load_campaign(campaign(with_hits, table(keys, method=method)))
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_window_that_does_not_fit_the_block_is_said_with_the_measurement(with_hits: Path) -> None:
    with pytest.raises(
        InputError, match=r"measurement 'hammer': an exponential window of 3 s on blocks of 1.83 s; give"
    ):
        identified(with_hits, table('exponential_window = "3 s"'))


def test_levels_in_the_records_of_one_measurement_are_split(tmp_path: Path) -> None:
    for level in (100, 400):
        hits(tmp_path, f"h{level}.nc", level=float(level))
    loaded = load_campaign(
        campaign(tmp_path, table("split_levels = true", file="h*.nc"), table(name="plain", file="h100.nc"))
    )
    (name,) = found = split_levels(loaded)
    assert name == "hammer, by level"
    assert found[name]["force_level"].values.tolist() == [100.0, 400.0]
    assert np.isfinite(found[name]["compliance_std"]).all()


@pytest.mark.slow
def test_levels_are_identified_once_and_read_back_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for level in (100, 400):
        hits(tmp_path, f"h{level}.nc", level=float(level))
    loaded = load_campaign(campaign(tmp_path, table("split_levels = true", file="h*.nc")))
    plain, first = split_levels(loaded), split_levels(loaded, tmp_path / "kept")

    def again(*_: object, **__: object) -> None:
        raise AssertionError("identified again")

    monkeypatch.setattr("smfe.identification.measurement.hammer_levels", again)
    second = split_levels(loaded, tmp_path / "kept")
    for name, dataset in plain.items():
        xr.testing.assert_identical(dataset, first[name])
        xr.testing.assert_identical(dataset, second[name])
    # A program that identifies otherwise does not read back what an older one has kept.
    with monkeypatch.context() as changed:
        changed.setattr("smfe.identification.measurement.FORM", -1)
        with pytest.raises(AssertionError, match="identified again"):
            split_levels(loaded, tmp_path / "kept")
    # Other records are other results.
    hits(tmp_path, "h400.nc", level=300.0)
    with pytest.raises(AssertionError, match="identified again"):
        split_levels(load_campaign(tmp_path / "campaign.toml"), tmp_path / "kept")


@pytest.mark.slow
def test_measurements_that_differ_in_level_and_feed_are_stacked(tmp_path: Path) -> None:
    for level in (100, 400):
        hits(tmp_path, f"h{level}.nc", level=float(level))
    tables = [
        table(f'force_level = "{level} N"\nfeed = "{feed} mm/min"', f"h{level}_{feed}", file=f"h{level}.nc")
        for level in (100, 400)
        for feed in (0, 500)
    ]
    loaded = load_campaign(campaign(tmp_path, *tables, table('controller = "K1"', "other", file="h100.nc")))
    found = {m.name: identify_measurement(loaded, m).compliance for m in loaded.measurements}
    cubes, notes = condition_cubes(loaded.measurements, found)
    assert list(cubes) == ["hammer"]
    assert notes == []
    assert dict(cubes["hammer"]["compliance"].sizes) == {
        "force_level": 2, "feed": 2, "frequency": found["h100_0"].sizes["frequency"], "response": 1, "excitation": 1,
    }  # fmt: skip
    one = cubes["hammer"]["compliance"].sel(force_level=400.0, feed=500.0)
    assert one.values == pytest.approx(found["h400_500"]["compliance"].values)


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["identify", "run"])
def test_levels_and_feeds_are_written_as_dimensions(tmp_path: Path, whole: bool) -> None:
    for level in (100, 400):
        hits(tmp_path, f"h{level}.nc", level=float(level))
    tables = [table(f'force_level = "{level} N"', f"at_{level}", file=f"h{level}.nc") for level in (100, 400)]
    path = campaign(tmp_path, *tables, table("split_levels = true", "both", file="h*.nc"))
    if whole:
        run(path, tmp_path / "results")
    else:
        identify(path, tmp_path / "results" / "frf.nc")
    groups = read_groups(tmp_path / "results" / "conditions.nc")
    assert set(groups) == {"hammer", "both, by level"}
    for dataset in groups.values():
        assert dataset["compliance"].sel(force_level=400.0).dims == ("frequency", "response", "excitation")
    kept = read_groups(tmp_path / "results" / "frf.nc")["at_100"]
    assert np.isfinite(interval(kept)["upper"]).all()
