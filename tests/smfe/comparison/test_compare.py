"""Measurements compared pair by pair: peaks matched, differences with their significance, assurance figures."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance
from process.machine.modes import ModalModel
from smfe.comparison.compare import CompareRules, compare, response_assurance
from smfe.comparison.peaks import all_peaks


def bench(frequency: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * frequency
    return 1.0 / (11.3 * s**2 + 104.0 * s + 1.68e6)


def ram(frequency: np.ndarray) -> np.ndarray:
    """Five modes like those of a ram type machine; pole sum, written out."""
    total = np.zeros(frequency.size, complex)
    for f, stiffness, damping, part in (
        (24.0, 20e6, 0.022, 1.0),
        (29.0, 30e6, 0.026, 0.6),
        (34.0, 25e6, 0.030, 0.8),
        (58.0, 60e6, 0.040, 1.0),
        (95.0, 90e6, 0.030, -0.5),
    ):
        s, w = 2j * np.pi * frequency, 2.0 * np.pi * f
        total += part**2 * w**2 / stiffness / (s**2 + 2.0 * damping * w * s + w**2)
    return total


def measurement(frequencies: list[float], seed: int, grid: np.ndarray, level: float = 0.003) -> xr.Dataset:
    """Two modes in x and y with noise and its standard deviation."""
    model = ModalModel(frequencies, [0.022, 0.030], [20e6, 30e6], [[1.0, 0.2, 0.0], [0.3, 1.0, 0.0]])
    clean = model.compliance(grid, "xy", "xy")["compliance"].values
    s = level * np.abs(clean).max()
    rng = np.random.default_rng(seed)
    values = clean + s / np.sqrt(2.0) * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    std = (("frequency", "response", "excitation"), np.full(clean.shape, s))
    return make_compliance(grid, values, "xy", "xy", {"compliance_std": std})


GRID = np.arange(10.0, 60.0, 0.5)


@pytest.fixture(scope="module", params=[8, pytest.param(25, marks=pytest.mark.slow)], ids="{} seeds".format)
def repeated(request: pytest.FixtureRequest) -> list[pd.DataFrame]:
    """Return comparisons of one machine with itself: two modes in four entries, other noise in each measurement."""
    pairs = [(measurement([24.0, 34.0], seed, GRID), measurement([24.0, 34.0], 100 + seed, GRID)) for seed in range(25)]
    return [compare({"a": a, "b": b}) for a, b in pairs[: request.param]]


def test_equal_machines_differ_insignificantly(repeated: list[pd.DataFrame]) -> None:
    """Two measurements of one machine with different noise: matched throughout, next to nothing significant.

    Each table calls something significant with a probability of 5 %: in 20 tables about one false alarm.
    """
    alarms = 0
    for table in repeated[:20]:
        assert (table["match"] == "both").all()
        alarms += int(table[["frequency_significant", "damping_significant", "amplitude_significant"]].sum().sum())
    assert alarms <= (6 if len(repeated) > 8 else 3)


def test_differences_scatter_as_claimed(repeated: list[pd.DataFrame]) -> None:
    """Differences over their standard deviations: 24 a table, so that their rms scatters by 0.05 over 8 tables."""
    scores = []
    for table in repeated:
        for name in ("frequency", "damping", "amplitude"):
            scores += (table[f"{name}_difference_percent"] / table[f"{name}_difference_std_percent"]).tolist()
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.1 if len(repeated) > 8 else 0.17)


def test_the_same_data_twice_differ_by_nothing() -> None:
    one = measurement([24.0, 34.0], 1, GRID)
    table = compare({"a": one, "b": one})
    assert (table["frequency_difference_percent"] == 0.0).all()
    assert not table["significant"].any()
    assert table["frac"].tolist() == pytest.approx([1.0] * len(table))
    assert table["relative_difference_percent"].tolist() == pytest.approx([0.0] * len(table))


def test_a_shift_of_five_percent_is_found() -> None:
    """Only the second mode moves; different grids and bands do not matter because fits are compared."""
    before = measurement([24.0, 34.0], 1, GRID)
    after = measurement([24.0, 34.0 * 1.05], 2, np.arange(15.0, 80.0, 0.3))
    table = compare({"before": before, "after": after})
    upper = table[table["frequency_a_Hz"] > 30.0]
    assert upper["frequency_significant"].all()
    direct = upper[(upper["response"] == "y") & (upper["excitation"] == "y")].iloc[0]
    assert direct["frequency_difference_percent"] == pytest.approx(5.0, abs=0.15)
    assert direct["frequency_difference_std_percent"] < 0.1
    assert direct["frac"] < 0.8
    assert not table[table["frequency_a_Hz"] < 30.0]["frequency_significant"].any()
    assert table["band_from_Hz"].tolist() == [15.0] * len(table)


def test_unmatched_peaks_are_listed() -> None:
    before = measurement([24.0, 34.0], 1, GRID)
    after = measurement([24.0, 50.0], 2, GRID)
    cut = after.sel(frequency=slice(10.0, 30.0))
    table = compare({"a": before, "b": after})
    yy = table[(table["response"] == "y") & (table["excitation"] == "y")]
    assert yy["match"].tolist() == ["both", "a only", "b only"]
    assert np.isnan(yy["frequency_difference_percent"].iloc[1])
    assert not yy["significant"].iloc[1]
    narrow = compare({"a": before, "b": cut})
    assert "a only, outside the band of b" in narrow["match"].tolist()


def test_tolerance_decides_what_is_one_mode() -> None:
    pair = {"a": measurement([24.0, 34.0], 1, GRID), "b": measurement([24.0, 39.0], 2, GRID)}
    assert "a only" in compare(pair)["match"].tolist()
    assert (compare(pair, rules=CompareRules(tolerance=0.2))["match"] == "both").all()


def test_every_pair_and_shared_entry() -> None:
    three = {name: measurement([24.0, 34.0], k, GRID) for k, name in enumerate("abc")}
    three["c"] = three["c"].sel(response=["x"])
    table = compare(three)
    pairs = table[["measurement_a", "measurement_b"]].drop_duplicates().to_numpy().tolist()
    assert pairs == [["a", "b"], ["a", "c"], ["b", "c"]]
    assert set(table[table["measurement_b"] == "c"]["response"]) == {"x"}


def test_of_many_each_is_compared_with_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    many = {f"m{k}": measurement([24.0, 34.0], k, GRID) for k in range(4)}
    monkeypatch.setattr("smfe.comparison.compare.MOST_PAIRED", 3)
    table = compare(many, peaks=all_peaks(many))
    pairs = table[["measurement_a", "measurement_b"]].drop_duplicates().to_numpy().tolist()
    assert pairs == [["m0", "m1"], ["m0", "m2"], ["m0", "m3"]]


def test_frac_is_blind_to_a_factor_and_the_difference_is_not() -> None:
    f = np.arange(30.0, 120.0, 0.5)
    frac, difference = response_assurance(f, bench(f), f, 1.3 * bench(f))
    assert frac == pytest.approx(1.0)
    assert difference == pytest.approx(0.3)


def test_frac_on_different_grids_interpolates_the_finer() -> None:
    coarse, fine = np.arange(30.0, 100.0, 0.5), np.arange(40.0, 120.0, 0.02)
    frac, difference = response_assurance(coarse, bench(coarse), fine, bench(fine))
    assert frac == pytest.approx(1.0, abs=1e-6)
    assert difference < 1e-3
    assert response_assurance(fine, bench(fine), coarse, bench(coarse))[0] == pytest.approx(frac, rel=1e-9)
    assert np.isnan(response_assurance(f := np.arange(5.0, 10.0), bench(f), coarse, bench(coarse))[0])


def test_frac_against_a_plain_sum() -> None:
    f = np.arange(10.0, 60.0, 1.0)
    a, b = bench(f), ram(f)
    plain = abs(sum(x * np.conj(y) for x, y in zip(a, b, strict=True))) ** 2 / (
        sum(abs(x) ** 2 for x in a) * sum(abs(y) ** 2 for y in b)
    )
    assert response_assurance(f, a, f, b)[0] == pytest.approx(plain)


def test_nothing_to_compare_with_is_an_empty_table_with_its_columns() -> None:
    one = measurement([24.0, 34.0], 1, GRID)
    table = compare({"a": one})
    assert table.empty
    assert table.columns.tolist() == compare({"a": one, "b": one}).columns.tolist()
    assert compare({"a": one.sel(response=["x"]), "b": one.sel(response=["y"])}).empty


def test_a_flat_compliance_has_a_row_without_peak() -> None:
    flat = make_compliance(GRID, np.full((GRID.size, 1, 1), 1e-8 + 0j), "x", "x")
    table = compare({"a": flat, "b": flat})
    assert table["match"].tolist() == ["no peak"]
    assert table["frac"].tolist() == pytest.approx([1.0])


def test_wrong_input() -> None:
    with pytest.raises(InputError, match="no measurement to compare"):
        compare({})
    one = measurement([24.0, 34.0], 1, GRID)
    feeds = xr.concat([one, one], pd.Index([0.0, 500.0], name="feed"))
    with pytest.raises(InputError, match=r"depends on feed as well; select one value, e.g. .sel\(feed=...\)"):
        compare({"a": one, "b": feeds})
