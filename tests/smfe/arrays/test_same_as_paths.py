"""Each verb with objects gives what it gives with the path of a file that holds them, and writes nothing."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from samples.report import measured

import smfe
from process.errors import InputError
from smfe.records import write_record_netcdf
from smfe.results import write_groups

MODELS = """
[campaign]
name = "models"
[[model]]
name = "m"
modes = [ { frequency = "60 Hz", damping = 0.03, stiffness = "30 N/um", direction = [1, 0, 0] } ]
"""


@pytest.fixture(scope="module")
def compliances() -> dict[str, xr.Dataset]:
    return {
        "hammer": measured("hammer", 90.0, 1.0, 2e-9, 1),
        "moving": measured("hammer", 90.0, 1.0, 2e-9, 2, softer=0.98),
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, compliances: dict[str, xr.Dataset]) -> Path:
    """A compliance file, a record, a campaign."""
    path = tmp_path_factory.mktemp("files")
    write_groups(path / "frf.nc", compliances)
    write_record_netcdf(cut(), path / "cut.nc")
    (path / "c.toml").write_text(MODELS, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Work in an empty folder, which stays empty but for what a test asks for."""
    monkeypatch.chdir(tmp_path)
    yield
    assert [p.name for p in tmp_path.iterdir() if not p.name.startswith("asked")] == []


def cut() -> xr.Dataset:
    """Return a cut at 1500 rpm, sampled at 4 kHz, that chatters at 173 Hz."""
    time = np.arange(16000) / 4000.0
    wave = sum(np.sin(2.0 * np.pi * 25.0 * k * time + k) / (1 + k % 4) for k in range(1, 13))
    noise = np.random.default_rng(1).standard_normal(time.size)
    acceleration = 10.0 * wave + 30.0 * np.sin(2.0 * np.pi * 173.0 * time) + 0.1 * noise
    return smfe.record(4000, acceleration_x=acceleration, spindle_speed="1500 rpm", name="cut.nc")


def test_comparison(folder: Path, compliances: dict[str, xr.Dataset]) -> None:
    table = smfe.compare(compliances)
    pd.testing.assert_frame_equal(table, smfe.compare(folder / "frf.nc"), rtol=1e-12)
    found = [smfe.Identification(n, "hammer", d) for n, d in compliances.items()]
    pd.testing.assert_frame_equal(smfe.compare(found), table, rtol=1e-12)
    with pytest.raises(InputError, match="several of these compliances have one name"):
        smfe.compare([found[0], found[0]])


def test_modes(folder: Path, compliances: dict[str, xr.Dataset], tmp_path: Path) -> None:
    fit = smfe.modal(compliances["hammer"], band=(50, "85 Hz"))
    path = smfe.modal(folder / "frf.nc", tmp_path / "asked.json", "hammer", band=("50 Hz", "85 Hz"))["hammer"]
    pd.testing.assert_frame_equal(fit.table(), path.table(), rtol=1e-12)


def test_verdict(folder: Path) -> None:
    by_path = smfe.chatter(folder / "cut.nc", "1500 rpm", 4)
    assert by_path.verdict == "chatter"
    samples = cut()["acceleration"].sel(axis="x").values
    for found in (
        smfe.chatter(cut(), 1500, 4),
        smfe.chatter(samples, 1500, 4, sample_rate="4 kHz", quantity="acceleration"),
    ):
        assert found.chatter_frequency_Hz == pytest.approx(by_path.chatter_frequency_Hz, rel=1e-12)
        assert found.ratio == pytest.approx(by_path.ratio, rel=1e-9)
    with pytest.raises(InputError, match="samples need their sample_rate"):
        smfe.chatter(samples, 1500, 4)


def test_look(folder: Path) -> None:
    of_file, of_record = smfe.look(folder / "cut.nc"), smfe.look(cut())
    pd.testing.assert_frame_equal(of_file.columns, of_record.columns)
    assert (of_file.kind, of_file.sample_rate) == (of_record.kind, of_record.sample_rate)
    table = pd.DataFrame({"t": np.arange(4000) / 4000.0, "ax": cut()["acceleration"].values[0, :4000], "who": "me"})
    found = smfe.look(table)
    assert found.sample_rate == pytest.approx(4000.0)
    assert any("'who' is not read" in note for note in found.notes)
    with pytest.raises(InputError, match="no column of numbers"):
        smfe.look(table[["who"]])


def test_conversion(folder: Path, tmp_path: Path) -> None:
    (written,) = smfe.convert(cut(), tmp_path / "asked.csv")
    (same,) = smfe.convert(folder / "cut.nc", tmp_path / "asked_too.csv")
    assert written.read_bytes() == same.read_bytes()


def test_a_campaign_that_was_read(folder: Path, tmp_path: Path) -> None:
    campaign = smfe.read_campaign(folder / "c.toml")
    assert smfe.read_campaign(campaign) is campaign
    pd.testing.assert_frame_equal(smfe.check(campaign), smfe.check(folder / "c.toml"))
    for verb in (smfe.diagnose, smfe.lobes, smfe.coefficients, smfe.plan):
        said = []
        for given in (campaign, folder / "c.toml"):
            with pytest.raises(InputError) as refused:
                verb(given, tmp_path / "asked")
            said.append(str(refused.value))
        assert said[0] == said[1]
