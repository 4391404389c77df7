"""Peaks from local modal fits, and measurements side by side."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance
from process.machine.modes import ModalModel
from smfe.comparison.compare import CompareRules, compare, response_assurance
from smfe.comparison.peaks import PeakRules, find_peaks, peak_table

# The laboratory bench of the paper: 61.37 Hz, 1.19 %, 24.94 um/N.
BENCH_FREQUENCY, BENCH_DAMPING, BENCH_PEAK = 61.367, 0.011935, 24.94e-6


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


def noisy(h: np.ndarray, level: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Add complex noise of root mean square `level` times the largest value; return it and its level."""
    s = level * np.abs(h).max()
    rng = np.random.default_rng(seed)
    return h + s / np.sqrt(2.0) * (rng.standard_normal(h.size) + 1j * rng.standard_normal(h.size)), np.full(h.size, s)


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


# --- peaks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spacing", [0.1, 0.25, 0.5, 1.0])
def test_a_single_mode_is_recovered_exactly_on_any_grid(spacing: float) -> None:
    """Half-power reading on a 0.25 Hz grid gives 0.0163 for a damping of 0.0119; the fit is exact even on 1 Hz."""
    f = np.arange(30.0, 120.0, spacing)
    (peak,) = find_peaks(f, bench(f))
    assert peak.frequency == pytest.approx(BENCH_FREQUENCY, rel=1e-5)
    assert peak.damping == pytest.approx(BENCH_DAMPING, rel=1e-4)
    assert peak.amplitude == pytest.approx(BENCH_PEAK, rel=1e-3)


@pytest.mark.parametrize("spacing", [0.25, 1.0])
def test_close_modes_are_told_apart(spacing: float) -> None:
    """24, 29, 34 Hz overlap: frequencies within 0.1 %, damping within 1 %; 58 and 95 Hz stand alone."""
    f = np.arange(10.0, 120.0, spacing)
    peaks = find_peaks(f, ram(f))
    assert [p.frequency for p in peaks] == pytest.approx([24.0, 29.0, 34.0, 58.0, 95.0], rel=2e-3)
    assert [p.damping for p in peaks] == pytest.approx([0.022, 0.026, 0.030, 0.040, 0.030], rel=0.01)
    # At its maximum the curve is what it is, neighbours included.
    assert peaks[0].amplitude == pytest.approx(np.abs(ram(np.linspace(23.0, 25.0, 2001))).max(), rel=3e-4)


@pytest.mark.parametrize(("spacing", "level"), [(0.25, 0.01), (0.5, 0.02), (1.0, 0.01)])
def test_peak_uncertainty_is_calibrated(spacing: float, level: float) -> None:
    """Over 200 seeds the scatter of frequency, damping and amplitude is what is claimed, within 15 %."""
    f = np.arange(30.0, 120.0, spacing)
    values, claims = [], []
    for seed in range(200):
        (peak,) = find_peaks(f, *noisy(bench(f), level, seed))
        values.append((peak.frequency, peak.damping, peak.amplitude))
        claims.append((peak.frequency_std, peak.damping_std, peak.amplitude_std))
    ratio = np.std(values, axis=0) / np.sqrt(np.mean(np.square(claims), axis=0))
    assert ratio == pytest.approx(np.ones(3), abs=0.15)
    # No bias beyond what 200 seeds can show.
    bias = (np.mean(values, axis=0) - [BENCH_FREQUENCY, BENCH_DAMPING, BENCH_PEAK]) / np.std(values, axis=0)
    assert np.abs(bias).max() < 0.3


def test_without_standard_deviation_the_residual_speaks() -> None:
    f = np.arange(30.0, 120.0, 0.25)
    values, claims = [], []
    for seed in range(100):
        (peak,) = find_peaks(f, noisy(bench(f), 0.01, seed)[0])
        values.append(peak.damping)
        claims.append(peak.damping_std)
        assert np.isnan(peak.misfit)
    assert np.std(values) / np.sqrt(np.mean(np.square(claims))) == pytest.approx(1.0, abs=0.25)


def test_errors_shared_by_neighbouring_lines_widen_the_claim() -> None:
    f = np.arange(30.0, 120.0, 0.25)
    h, std = noisy(bench(f), 0.01, 1)
    (one,), (four,) = find_peaks(f, h, std), find_peaks(f, h, std, error_lines=4.0)
    assert four.frequency_std == pytest.approx(2.0 * one.frequency_std)


def test_noise_alone_has_no_peaks() -> None:
    f = np.arange(10.0, 200.0, 0.25)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        h = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
        assert find_peaks(f, h, np.full(f.size, np.sqrt(2.0))) == []


def test_peaks_below_the_significance_are_ignored() -> None:
    f = np.arange(10.0, 120.0, 0.25)
    h, std = noisy(ram(f), 0.02, 3)
    found = [round(p.frequency) for p in find_peaks(f, h, std)]
    assert 95 not in found  # 0.053 um/N against a noise of 0.023 um/N
    assert {24, 34} <= set(found)
    assert [round(p.frequency) for p in find_peaks(f, h, std, PeakRules(significance=25.0))] == [24]


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_high_mode_of_little_compliance_is_a_peak(noise: float) -> None:
    """Equal masses, 1 % damping, 100 and 1000 Hz: 1/100 of the compliance, -40 dB, with noise of -80 dB (seed 1)."""
    f = np.arange(20.0, 1500.0, 0.5)
    h = sum(1.0 / (k**2 - f**2 + 2j * 0.01 * k * f) for k in (100.0, 1000.0))
    level = noise * np.abs(h).max()
    rng = np.random.default_rng(1)
    seen = h + level / np.sqrt(2.0) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    peaks = find_peaks(f, seen)
    assert [p.frequency for p in peaks] == pytest.approx([100.0, 1000.0], rel=1e-3)
    assert peaks[1].damping == pytest.approx(0.01, rel=0.05)
    assert len(find_peaks(f, seen, rules=PeakRules(clear=1.1))) == 1
    assert len(find_peaks(f, seen, rules=PeakRules(floor=0.02))) == 1


def test_gaps_and_short_curves() -> None:
    f = np.arange(30.0, 120.0, 0.25)
    h = bench(f)
    h[f > 90.0] = np.nan
    (peak,) = find_peaks(f, h)
    assert peak.frequency == pytest.approx(BENCH_FREQUENCY, rel=1e-4)
    assert find_peaks(f[:5], h[:5]) == []
    assert find_peaks(f, np.full(f.size, np.nan + 0j)) == []


def test_peak_table_names_units() -> None:
    table = peak_table(measurement([24.0, 34.0], 1, GRID))
    assert table["response"].tolist() == ["x", "x", "x", "x", "y", "y", "y", "y"]
    assert {"frequency_Hz", "frequency_std_Hz", "damping", "amplitude_um_per_N"} <= set(table.columns)
    assert table["amplitude_um_per_N"].max() == pytest.approx(1.14, rel=0.02)


# --- comparison ----------------------------------------------------------------------------------------------------


def test_equal_machines_differ_insignificantly() -> None:
    """Two measurements of one machine with different noise: matched throughout, next to nothing significant.

    At three standard deviations, 20 comparisons of 8 peaks in 3 quantities leave about one false alarm.
    """
    alarms = 0
    for seed in range(20):
        table = compare({"a": measurement([24.0, 34.0], seed, GRID), "b": measurement([24.0, 34.0], 100 + seed, GRID)})
        assert (table["match"] == "both").all()
        alarms += int(table[["frequency_significant", "damping_significant", "amplitude_significant"]].sum().sum())
    assert alarms <= 6


def test_differences_scatter_as_claimed() -> None:
    scores = []
    for seed in range(25):
        table = compare({"a": measurement([24.0, 34.0], seed, GRID), "b": measurement([24.0, 34.0], 100 + seed, GRID)})
        for name in ("frequency", "damping", "amplitude"):
            scores += (table[f"{name}_difference_percent"] / table[f"{name}_difference_std_percent"]).tolist()
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.1)


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
