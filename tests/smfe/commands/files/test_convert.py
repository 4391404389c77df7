"""Claims about `smfe convert`: what is written is what was read, in SI, whole or not at all."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from process.errors import InputError
from process.labels import make_record
from smfe import convert
from smfe.cli import app
from smfe.records import (
    read_records,
    record_columns,
    uff_columns,
    write_record_netcdf,
)

RATE = 2000.0


def a_record(n: int = 500) -> xr.Dataset:
    rng = np.random.default_rng(1)
    vectors = {"force": {a: rng.standard_normal(n) for a in "xyz"}, "acceleration": {"x": rng.standard_normal(n)}}
    return make_record(np.arange(n) / RATE, vectors, {"spindle_speed": np.linspace(300, 600, n), "sound": np.ones(n)})


CAMPAIGN = """
[campaign]
name = "kN and g"
[channels]
time = { column = "t", unit = "s" }
force_x = { column = "Fx", unit = "kN", sign = -1 }
[[measurement]]
name = "m"
method = "actuator"
records = [{ file = "r.csv", excitation = "x" }]
"""


class TestConvert:
    @pytest.mark.parametrize("suffix", [".nc", ".csv", ".mat", ".uff"])
    def test_there_and_back(self, tmp_path: Path, suffix: str) -> None:
        record = a_record()
        write_record_netcdf(record, tmp_path / "r.nc")
        (written,) = convert(tmp_path / "r.nc", tmp_path / f"new{suffix}")
        channels = uff_columns(record) if suffix == ".uff" else record_columns(record)
        (back,) = read_records(written, channels)
        tolerance = 1e-15 if suffix in (".csv", ".uff") else 0.0
        xr.testing.assert_allclose(back, record, rtol=tolerance, atol=0.0)

    def test_a_campaign_gives_columns_units_and_signs(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text("t,Fx\n" + "".join(f"{k / RATE},{k}\n" for k in range(200_000)))
        (tmp_path / "c.toml").write_text(CAMPAIGN)
        seen: list[str] = []
        (written,) = convert(
            tmp_path / "r.csv", tmp_path / "r.nc", tmp_path / "c.toml", lambda what, done, of: seen.append(what)
        )
        (record,) = read_records(written, {})
        np.testing.assert_array_equal(record["force"][0], -1000.0 * np.arange(200_000))
        assert set(seen) == {"converting r.csv"}
        assert len(seen) > 2, "piece by piece"

    def test_nothing_half_written_is_left(self, tmp_path: Path) -> None:
        rows = "".join(f"{k / RATE},{k}\n" for k in range(100_000))
        (tmp_path / "r.csv").write_text("t,Fx\n" + rows + f"{100_000 / RATE},oops\n")
        (tmp_path / "c.toml").write_text(CAMPAIGN)
        with pytest.raises(InputError, match="holds the text 'oops' in data row 100001"):
            convert(tmp_path / "r.csv", tmp_path / "r.nc", tmp_path / "c.toml")
        assert sorted(p.name for p in tmp_path.iterdir()) == ["c.toml", "r.csv"]

    def test_faults(self, tmp_path: Path) -> None:
        write_record_netcdf(a_record(), tmp_path / "r.nc")
        with pytest.raises(InputError, match=r"new\.xlsx: files with suffix '\.xlsx' are not written; known are \.nc"):
            convert(tmp_path / "r.nc", tmp_path / "new.xlsx")
        with pytest.raises(InputError, match=r"r\.nc: the source itself would be overwritten"):
            convert(tmp_path / "r.nc", tmp_path / "r.nc")

    def test_the_command(self, tmp_path: Path) -> None:
        write_record_netcdf(a_record(), tmp_path / "r.nc")
        done = CliRunner().invoke(app, ["convert", str(tmp_path / "r.nc"), str(tmp_path / "r.csv")])
        assert done.exit_code == 0
        assert "r.csv" in done.output
        assert (tmp_path / "r.csv").read_text().startswith("t,Fx,Fy,Fz,ax,n,sound\n")
