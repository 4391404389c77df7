"""`smfe modal`: what it writes is what a campaign file reads, and what it refuses."""

import json
import sys
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import pyuff
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance
from smfe import cli
from smfe.campaign import load_campaign
from smfe.commands.modal import modal
from smfe.results import write_groups

GRID = np.arange(15.0, 90.0, 1.0)
MODES = ((30.0, 0.03, 20e6, (1.0, 0.3)), (52.0, 0.02, 35e6, (-0.3, 1.0)))
CAMPAIGN = '[campaign]\nname = "pasted"\n'


def measurement(seed: int, sign: float = 1.0, grid: np.ndarray = GRID) -> xr.Dataset:
    """Two modes in x and y, written out in mass, damping and stiffness, with 0.5 % noise."""
    w = 2.0 * np.pi * grid
    clean = np.zeros((grid.size, 2, 2), complex)
    for natural, damping, stiffness, direction in MODES:
        u, wn = np.array(direction) / np.linalg.norm(direction), 2.0 * np.pi * natural
        gain = 1.0 / (stiffness * (1.0 - (w / wn) ** 2 + 2j * damping * w / wn))
        clean += np.outer(u, u) * gain[:, None, None]
    s = 0.005 * np.abs(clean).max()
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, *clean.shape))
    std = (("frequency", "response", "excitation"), np.full(clean.shape, s))
    values = sign * clean + s / np.sqrt(2.0) * (noise[0] + 1j * noise[1])
    return make_compliance(grid, values, "xy", "xy", {"compliance_std": std}, {"method": "hammer"})


@pytest.fixture(scope="module")
def frf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A compliance file of two measurements, one whose force has the wrong sign, and a model."""
    groups = {"idle": measurement(1), "motion": measurement(2), "turned": measurement(3, -1.0)}
    groups["known"] = measurement(4).assign_attrs(method="model")
    return write_groups(tmp_path_factory.mktemp("modal") / "frf.nc", groups)


def test_what_is_written_can_be_pasted_into_a_campaign(frf: Path, tmp_path: Path) -> None:
    fits = modal(frf, tmp_path / "modes.toml")
    assert set(fits) == {"idle", "motion", "turned"}
    text = (tmp_path / "modes.toml").read_text()
    (tmp_path / "campaign.toml").write_text(CAMPAIGN + text)
    models = {m.name: m for m in load_campaign(tmp_path / "campaign.toml").models}
    assert set(models) == {"idle_modes", "motion_modes"}
    assert "# no mode shapes: the mode at 30.0" in text or "# no mode shapes: the mode at 30 Hz" in text
    for name in ("idle", "motion"):
        own, read = fits[name].modal_model(), models[f"{name}_modes"].modal
        np.testing.assert_allclose(
            read.matrix(GRID), own.matrix(GRID), rtol=1e-5, atol=1e-5 * np.abs(own.matrix(GRID)).max()
        )
        assert own.frequency[:2].tolist() == pytest.approx([30.0, 52.0], rel=2e-3)
        assert own.stiffness[:2].tolist() == pytest.approx([20e6, 35e6], rel=0.03)
        assert 0.0 < models[f"{name}_modes"].spread.stiffness < 0.05


def test_the_table_has_intervals_and_units(frf: Path, tmp_path: Path) -> None:
    modal(frf, tmp_path / "modes.toml", "idle")
    table = pd.read_csv(tmp_path / "modes.csv")
    assert table["measurement"].tolist() == ["idle", "idle"]
    for name, end, truth in (("frequency", "_Hz", [30.0, 52.0]), ("stiffness", "_N_um", [20.0, 35.0])):
        assert (table[f"{name}_low{end}"] < table[f"{name}{end}"]).all()
        assert table[f"{name}{end}"].tolist() == pytest.approx(truth, rel=0.03)
    assert (tmp_path / "modes.png").read_bytes().startswith(b"\x89PNG")
    assert tomllib.loads((tmp_path / "modes.toml").read_text())["model"][0]["name"] == "idle_modes"


def test_the_command_prints_modes_and_writes_json(frf: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    target = tmp_path / "modes.json"
    options = ["--measurement", "idle", "--band", "20 Hz", "80 Hz"]
    monkeypatch.setattr(sys, "argv", ["smfe", "modal", str(frf), "-o", str(target), *options])
    with pytest.raises(SystemExit) as stop:
        cli.app_entry()
    assert not stop.value.code
    assert "idle" in capsys.readouterr().out
    content = json.loads(target.read_text())
    assert content["models"]["idle"]["modes"][0]["frequency_Hz"] == pytest.approx(30.0, rel=2e-3)


def test_wrong_input_is_one_sentence_and_writes_nothing(frf: Path, tmp_path: Path) -> None:
    for output, options, match in (
        ("m.txt", {}, "ends in .toml or .json"),
        ("m.toml", {"measurement": "idel"}, "has no measurement 'idel' with a compliance; there are: idle, motion"),
        ("m.toml", {"band": ("80 Hz", "20 Hz")}, "lower frequency first"),
        (
            "m.toml",
            {"band": ("80 Hz", "81 Hz")},
            "no modes could be fitted: idle: the matrix is known at 2 frequencies",
        ),
        ("m.toml", {"band": ("80", "81 Hz")}, "has no unit"),
    ):
        with pytest.raises(InputError, match=match):
            modal(frf, tmp_path / output, **options)
    only = write_groups(tmp_path / "models.nc", {"known": measurement(1).assign_attrs(method="model")})
    with pytest.raises(InputError, match="holds no measured compliance"):
        modal(only, tmp_path / "m.toml")
    with pytest.raises(InputError, match="does not exist"):
        modal(tmp_path / "none.nc", tmp_path / "m.toml")
    assert [p.name for p in tmp_path.iterdir()] == ["models.nc"]


@pytest.mark.parametrize("binary", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_universal_file_needs_no_campaign(tmp_path: Path, binary: int) -> None:
    """Accelerances of dataset 58 between node 7 and nodes 7 and 9, in g/N, as another program writes them."""
    grid = np.arange(1.0, 90.0, 1.0)
    clean = measurement(5, grid=grid)["compliance"].values
    sets = []
    for row, node in enumerate((7, 9)):
        h = clean[:, row, 0] * -((2.0 * np.pi * grid) ** 2) / 9.80665
        sets.append(
            {
                "type": 58, "binary": binary, "func_type": 4, "rsp_node": node, "rsp_dir": 1, "ref_node": 7,
                "ref_dir": 1, "id1": "frf", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE",
                "load_case_id": 0, "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "ver_num": 0, "func_id": 0,
                "ord_data_type": 6, "abscissa_spacing": 1, "abscissa_min": grid[0], "abscissa_inc": 1.0,
                "z_axis_value": 0.0, "num_pts": grid.size, "data": h, "x": grid, "abscissa_spec_data_type": 18,
                "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13, "z_axis_spec_data_type": 0,
                "ordinate_axis_units_lab": "g", "orddenom_axis_units_lab": "N",
            }
        )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves a file open
        pyuff.UFF(str(tmp_path / "plate.unv")).write_sets(sets, "add")
    modal(tmp_path / "plate.unv", tmp_path / "modes.json")
    found = pd.read_csv(tmp_path / "modes.csv")
    assert np.sort(found["frequency_Hz"]) == pytest.approx([30.0, 52.0], rel=5e-3)
    assert list(json.loads((tmp_path / "modes.json").read_text())["models"]) == ["plate"]
