"""The keys of a campaign that say how a sweep is evaluated."""

from pathlib import Path

import numpy as np
import pytest
from samples.linear_machine import MACHINE, MATERIAL

from process.cut.engagement import engagement
from process.cut.tool import Tool
from process.errors import InputError
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from smfe.campaign import load_campaign
from smfe.identification.measurement import identify_measurement, sweep_estimator
from smfe.identification.sweep.local_polynomial import LocalPolynomial
from smfe.identification.sweep.order_tracking import Orders
from smfe.identification.sweep.segments import Segments, SingleReference
from smfe.records import write_record_netcdf
from smfe.records.dynamometer import Dynamometer

HEAD = """
[campaign]
name = "sweeps"
[tool]
diameter = "80 mm"
teeth = 2
[[measurement]]
name = "sweep"
method = "sweep"
frequency_range = ["25 Hz", "45 Hz"]
resolution = "1 Hz"
records = [
    { file = "down.nc", cut = "down", width_of_cut = "12 mm" },
    { file = "up.nc", cut = "up", width_of_cut = "12 mm" },
    { file = "central.nc", cut = "central", width_of_cut = "12 mm" },
]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("sweeps")
    for cut in ("down", "up", "central"):
        mill = MillingCut(Tool(0.08, 2, np.pi / 4), engagement(cut, 0.012, 0.08), MATERIAL, 1e-3, feed_rate=2e-3)
        record = simulate_milling(MACHINE, mill, Spindle(20.0 * np.pi, 3.0), 12.0, 400.0, 0.5, 2.0)
        rng = np.random.default_rng(1)
        record["acceleration"] = record["acceleration"] + 3e-3 * rng.standard_normal(record["acceleration"].shape)
        write_record_netcdf(record.drop_vars("displacement"), where / f"{cut}.nc")
        air = record.drop_vars("displacement").assign(
            force=0.3 * rng.standard_normal(record["force"].shape) + 0.0 * record["force"],
            acceleration=3e-3 * rng.standard_normal(record["force"].shape) + 0.0 * record["acceleration"],
        )
        write_record_netcdf(air, where / "air.nc")
    return where


def campaign(folder: Path, keys: str):
    path = folder / "campaign.toml"
    path.write_text(HEAD + keys, encoding="utf-8")
    return load_campaign(path)


@pytest.mark.parametrize(
    ("keys", "kind"),
    [
        ("", LocalPolynomial),
        ('estimator = "segments"', Segments),
        ('estimator = "orders"', Orders),
        ('estimator = "single_reference"', SingleReference),
        ('references = "x"', SingleReference),
        ('references = "spindle"', LocalPolynomial),
    ],
)
def test_each_key_chooses_its_estimator(folder: Path, keys: str, kind: type) -> None:
    loaded = campaign(folder, keys)
    chosen = sweep_estimator(loaded, loaded.measurements[0])
    assert isinstance(chosen, kind)
    assert getattr(chosen, "instrument_teeth", None) == (2 if "spindle" in keys else None)


def test_an_air_cut_a_dynamometer_and_reciprocity_are_used(folder: Path) -> None:
    plain = 'estimator = "bands"\nreciprocal = true\n'
    keys = plain + 'background = "air.nc"\ndynamometer = { mass = "1 kg", frequency = "400 Hz" }\n'
    loaded = campaign(folder, keys)
    assert loaded.measurements[0].dynamometer == Dynamometer(1.0, 400.0, 0.02)
    found = identify_measurement(loaded, loaded.measurements[0]).compliance
    value = found["compliance"].values
    np.testing.assert_allclose(value, value.swapaxes(1, 2), rtol=1e-9)
    without = campaign(folder, plain)
    other = identify_measurement(without, without.measurements[0]).compliance["compliance"].values
    assert 1e-4 < np.abs(value - other).max() / np.abs(other).max() < 0.5


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('estimator = "orders"\nreferences = "x"', "is that of estimator 'single_reference'"),
        ('references = "x"\nposition_dependent = true', "only the estimator 'local_polynomial' reads it"),
        ('estimator = "welch"', "estimator"),
        ('dynamometer = { mass = "-1 kg" }', "mass"),
        ('axes = ["w"]', "axes"),
    ],
)
def test_what_does_not_go_together_is_refused(folder: Path, keys: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        campaign(folder, keys)
