"""What a catalogue says of machines: drift, scatter, doubt and prior, of fleets whose truth is known."""

import json
import tomllib
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

import smfe
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.fleet.columns import COLUMNS, schema
from smfe.fleet.doubts import FAR, doubt_table, scores
from smfe.fleet.prior import prior_of
from smfe.fleet.select import selected
from smfe.fleet.table import read_catalogue
from smfe.fleet.tracks import drift_table, fleet_table, modes_of

Row = dict[str, object]
NOISE = {"frequency": 0.002, "damping": 0.03, "amplitude": 0.02}


def peak(machine: str, day: date, axis: str, f: float, z: float, height: float) -> Row:
    """A peak with the standard deviations of NOISE."""
    return {
        "campaign": f"{machine} {day}",
        "machine": machine,
        "date": day,
        "kind": "peak",
        "measurement": "hammer",
        "response": axis,
        "excitation": axis,
        "peak": 1.0,
        "frequency_Hz": f,
        "frequency_std_Hz": NOISE["frequency"] * f,
        "damping": z,
        "damping_std": NOISE["damping"] * z,
        "amplitude_um_per_N": height,
        "amplitude_std_um_per_N": NOISE["amplitude"] * height,
    }


def fleet(machines: int = 6, visits: int = 16, seed: int = 0, worn: float = 0.0, own: float = 0.04) -> pd.DataFrame:
    """Peaks of machines: 60 Hz scattered by `own`, 3 %, 0.4 um/N; the first sinks by the share `worn` a year."""
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for m in range(machines):
        base = np.exp(rng.normal(np.log([60.0, 0.03, 0.4]), [own, 0.1, 0.06]))
        for v in range(visits):
            day = date(2024, 1, 1) + timedelta(days=45 * v)
            values = base * np.exp(rng.normal(0.0, list(NOISE.values())))
            values[0] *= np.exp(-worn * 45.0 * v / 365.25) if m == 0 else 1.0
            row = peak(f"M{m}", day, "x", *values)
            rows += [
                row,
                {"campaign": row["campaign"], "machine": f"M{m}", "kind": "campaign", "verdict": "done", "date": day},
            ]
    return pa.Table.from_pylist(rows, schema=schema()).to_pandas()


def write(root: Path, rows: pd.DataFrame) -> None:
    parquet.write_table(pa.Table.from_pandas(rows, schema=schema(), preserve_index=False), root / "catalogue.parquet")


def test_a_drift_is_found_with_its_interval() -> None:
    table = drift_table(modes_of(fleet(worn=0.03)))
    drift = table[table["quantity"] == "frequency"].set_index("machine")
    assert drift.loc["M0", "percent_per_year"] == pytest.approx(-3.0, abs=0.3)
    assert drift.loc["M0", "high"] < 0.0


def test_the_interval_of_a_drift_holds_what_it_promises() -> None:
    held = [
        row.low <= 0.0 <= row.high
        for seed in range(12)
        for row in drift_table(modes_of(fleet(visits=8, seed=seed))).itertuples()
    ]
    # 216 intervals of 95 %: 205 +- 3.2 hold.
    assert 195 <= sum(held) <= 214


def test_the_scatter_of_a_fleet_is_that_of_its_machines() -> None:
    row = fleet_table(modes_of(fleet(machines=40, visits=3))).iloc[0]
    assert row["machines"] == 40
    assert row["frequency_scatter_percent"] == pytest.approx(4.0, rel=0.35)
    assert row["frequency_Hz"] == pytest.approx(60.0, rel=0.02)


def test_one_campaign_that_lies_far_off_is_doubted_and_a_drift_is_not() -> None:
    rows = fleet(worn=0.05, seed=3)
    wrong = rows.index[(rows["kind"] == "peak") & (rows["machine"] == "M2")][5]
    rows.loc[wrong, "frequency_Hz"] *= 1.04  # an accelerometer at another place
    doubts = doubt_table(rows, modes_of(rows))
    assert doubts.iloc[0]["campaign"] == rows.loc[wrong, "campaign"]
    assert "frequency" in doubts.iloc[0]["why"]
    drifting = next(m for m in modes_of(rows) if m.machine == "M0")
    assert np.abs(scores(drifting, "frequency")).max() < FAR


def test_modes_are_followed_where_they_drift_past_each_others_place() -> None:
    rows = []
    for v in range(12):
        day = date(2024, 1, 1) + timedelta(days=30 * v)
        rows += [peak("M", day, "x", 80.0 * 0.98**v, 0.03, 1.0), peak("M", day, "x", 100.0 * 0.98**v, 0.03, 1.0)]
        if v == 4:
            rows.append(peak("M", day, "x", 150.0, 0.03, 0.1))  # seen once: no mode
    modes = modes_of(pa.Table.from_pylist(rows, schema=schema()).to_pandas())
    assert [len(m.rows) for m in modes] == [12, 12]
    assert modes[0].values("frequency") == pytest.approx(80.0 * 0.98 ** np.arange(12))


def test_a_prior_is_the_law_that_the_fleet_was_drawn_from() -> None:
    prior = prior_of(modes_of(fleet(machines=200, visits=3, seed=5)))
    assert prior.modes == (("xx", 1),)
    assert np.exp(prior.mean[:2]) == pytest.approx([60.0, 0.03], rel=0.02)
    own = np.array([0.04, 0.1])
    expected = np.sqrt(own**2 * (1.0) + np.array([NOISE["frequency"], NOISE["damping"]]) ** 2 * (1.0 + 1.0 / 3.0))
    assert prior.std[0, :2] == pytest.approx(expected, rel=0.15)  # 200 draws: 5 % of one standard deviation
    # k = 1/(2 A zeta): damping and stiffness err against each other.
    assert prior.covariance[1, 2] == pytest.approx(-(0.1**2), rel=0.4)


def test_a_prior_is_a_model_that_a_campaign_takes(tmp_path: Path) -> None:
    parquet.write_table(
        pa.Table.from_pandas(fleet(), schema=schema(), preserve_index=False), tmp_path / "catalogue.parquet"
    )
    smfe.catalogue(tmp_path, machine=["M1", "M2", "M3"], prior=tmp_path / "prior.toml")
    text = (tmp_path / "prior.toml").read_text()
    assert tomllib.loads(text)["model"][0]["name"] == "fleet"
    campaign = tmp_path / "next.toml"
    campaign.write_text(f'[campaign]\nname = "Next"\n{text}')
    (model,) = load_campaign(campaign).models
    said = json.loads((tmp_path / "prior.json").read_text())
    assert model.modal.frequency == pytest.approx(np.exp(said["mean"][0]), rel=1e-5)
    assert model.spread is not None
    assert model.spread.frequency == pytest.approx(np.sqrt(said["covariance"][0][0]), rel=1e-3)
    with pytest.raises(InputError, match="no mode in common"):
        smfe.catalogue(tmp_path, kind="campaign", prior=tmp_path / "other.toml")


@pytest.mark.parametrize(
    ("asked", "count"),
    [
        ({"where": ["frequency_Hz > 30"]}, 96),
        ({"where": ["frequency_Hz > 30", "damping <= 0"]}, 0),
        ({"machines": ["M1", "M2"], "kind": "peak"}, 32),
        ({"since": "2025-01-01", "kind": "peak"}, 6 * 7),
        ({"since": "2025-01-01", "until": "2025-02-28", "kind": "peak"}, 6),
        ({"where": ["kind = campaign"]}, 96),
        ({"where": ["measurement != hammer"]}, 0),
    ],
)
def test_rows_are_chosen_by_what_they_hold(asked: dict[str, object], count: int) -> None:
    assert len(selected(fleet(), **asked)) == count  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"where": ["frequency > 30"]}, "did you mean 'frequency_Hz'"),
        ({"where": ["frequency_Hz > high"]}, "holds numbers"),
        ({"where": ["frequency_Hz"]}, "no condition"),
        ({"where": ["date > 1.3.2024"]}, "write a date as"),
        ({"machines": ["M9"]}, "no machine 'M9'"),
        ({"kind": "peaks"}, "no kind of rows"),
    ],
)
def test_what_cannot_be_asked_is_said(asked: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        selected(fleet(2, 2), **asked)  # type: ignore[arg-type]


def test_a_file_that_is_no_catalogue_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no catalogue\.parquet"):
        read_catalogue(tmp_path)
    (tmp_path / "catalogue.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="cannot be read"):
        read_catalogue(tmp_path)
    parquet.write_table(pa.table({"campaign": ["a"]}), tmp_path / "catalogue.parquet")
    with pytest.raises(InputError, match="no column title"):
        read_catalogue(tmp_path)


def test_pictures_are_drawn_and_rows_written(tmp_path: Path) -> None:
    parquet.write_table(
        pa.Table.from_pandas(fleet(3, 6), schema=schema(), preserve_index=False), tmp_path / "catalogue.parquet"
    )
    smfe.catalogue(tmp_path, kind="peak", output=tmp_path / "rows.csv", draw=tmp_path / "pictures")
    assert {p.name for p in (tmp_path / "pictures").iterdir()} == {"drift.png", "fleet.png", "doubts.png"}
    assert list(pd.read_csv(tmp_path / "rows.csv").columns) == list(COLUMNS)
