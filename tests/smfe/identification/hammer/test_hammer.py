"""Hammer: what averaged hits give, how certain they are, and which hits are refused."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.errors import InputError
from process.labels import make_record
from smfe.identification.errors.averaging import average, degrees_of_freedom, deviations
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.hammer.impacts import FAULTS, HitRules, find_hits, flat_top, usable_band

# The laboratory bench of the paper: one mass of 11.3 kg on 1.68 N/um with 104 N s/m, peak 24.94 um/N at 61.36 Hz.
MASS, STIFFNESS, DAMPING = 11.3, 1.68e6, 104.0
PULSE = 4e-3


def exact(frequency: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * frequency
    return 1.0 / (MASS * s**2 + DAMPING * s + STIFFNESS)


def motion(force: np.ndarray, rate: float, channel: str = "acceleration") -> np.ndarray:
    """The bench under a force that is linear between samples, exact by its ramp-invariant recursion."""
    numerator = [1.0, 0.0, 0.0] if channel == "acceleration" else [1.0]
    b, a, _ = signal.cont2discrete((numerator, [MASS, DAMPING, STIFFNESS]), 1.0 / rate, method="foh")
    return signal.lfilter(b.ravel(), a, force)


def pulses(duration: float, rate: float, hits: list[tuple[float, float]]) -> np.ndarray:
    """Half sines (start [s], peak [N]) of 4 ms."""
    t = np.arange(round(duration * rate)) / rate
    force = np.zeros(t.size)
    for start, peak in hits:
        inside = (t >= start) & (t <= start + PULSE)
        force[inside] += peak * np.sin(np.pi * (t[inside] - start) / PULSE)
    return force


def bench(
    hits: list[tuple[float, float]],
    duration: float,
    rate: float = 2500.0,
    force_noise: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
    channel: str = "acceleration",
    axis: str = "x",
) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    force = pulses(duration, rate, hits)
    response = motion(force, rate, channel) + noise * rng.standard_normal(force.size)
    force = force + force_noise * rng.standard_normal(force.size)
    return make_record(np.arange(force.size) / rate, {"force": {axis: force}, channel: {axis: response}})


def relative_error(compliance: xr.Dataset, row: int = 0, column: int = 0) -> float:
    """Largest error relative to the largest compliance."""
    truth = exact(compliance["frequency"].values)
    return float(np.max(np.abs(compliance["compliance"].values[:, row, column] - truth)) / np.abs(truth).max())


# --- accuracy ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("block", "percent"), [(0.25, 35.0), (0.5, 11.0), (1.0, 1.1), (2.0, 0.01), (4.0, 0.01)])
def test_error_of_a_block_that_is_too_short(block: float, percent: float) -> None:
    """The table of the theory: the error is exp(-T/tau) with tau = 0.217 s until the sampling limits it."""
    record = bench([(0.02 * block, 25.0)], block, rate=20000.0)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0))
    assert 100.0 * relative_error(found.compliance) == pytest.approx(percent, rel=0.1, abs=0.01)


@pytest.mark.parametrize(("block", "percent"), [(0.25, 33.0), (0.5, 11.0), (1.0, 1.1)])
def test_leakage_is_reported_with_its_size(block: float, percent: float) -> None:
    found = identify_hammer("bench", {"x": [bench([(0.02 * block, 25.0)], block)]})
    (note,) = [w for w in found.warnings if "not decayed" in w]
    assert "mostly at" in note
    estimate = float(note.split("estimated error of the compliance there ")[1].split(" %")[0])
    assert estimate == pytest.approx(percent, rel=0.1)


def test_no_leakage_is_reported_for_a_block_that_is_long_enough() -> None:
    found = identify_hammer("bench", {"x": [bench([(0.04, 25.0)], 2.0)]})
    assert not any("decayed" in w for w in found.warnings)


@pytest.mark.parametrize("channel", ["acceleration", "displacement"])
def test_noise_free_hits_recover_the_bench(channel: str) -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0, rate=20000.0, channel=channel)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(20.0, 200.0))
    assert relative_error(found.compliance) < 1e-4
    peak = float(np.abs(found.compliance["compliance"]).max())
    assert peak == pytest.approx(24.94e-6, rel=0.01)  # the nearest line of a 0.25 Hz grid


def test_error_falls_with_noise_and_hits() -> None:
    """Accelerometer noise 0.05 m/s2, five hits of 25 N: better than 2 % of the peak within 30 to 120 Hz."""
    record = bench([(0.1 + 4.0 * k, 25.0) for k in range(5)], 20.0, rate=5000.0, noise=0.05, seed=1)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0))
    assert relative_error(found.compliance) < 0.02
    assert found.compliance["coherence"].sel(frequency=61.0, method="nearest").item() > 0.99


@pytest.mark.parametrize(("seeds", "within"), [(40, 0.3), pytest.param(200, 0.15, marks=pytest.mark.slow)])
def test_standard_deviation_is_calibrated(seeds: int, within: float) -> None:
    """Over 200 seeds the error has the root mean square that is claimed, within 15 %; 40 show it within 30 %."""
    clean = bench([(0.1 + 2.0 * k, 25.0) for k in range(4)], 8.0, rate=2000.0)
    response = clean["acceleration"].values.copy()
    errors, claims = [], []
    truth = identify_hammer("bench", {"x": [clean]}, frequency_range=(30.0, 120.0)).compliance
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noisy = clean.copy(deep=True)
        noisy["acceleration"].values[:] = response + 0.2 * rng.standard_normal(response.shape)
        found = identify_hammer("bench", {"x": [noisy]}, frequency_range=(30.0, 120.0)).compliance
        errors.append(np.abs(found["compliance"].values - truth["compliance"].values) ** 2)
        claims.append(found["compliance_std"].values ** 2)
    ratio = np.sqrt(np.mean(errors, axis=0) / np.mean(claims, axis=0)).squeeze()
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.percentile(ratio, 5.0) > 1.0 - within
    assert np.percentile(ratio, 95.0) < 1.0 + within


def test_h1_against_its_definition() -> None:
    """Least squares by numpy, hits of equal force: the classical standard deviation, and M - 1 degrees of freedom."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((7, 2, 5)) + 1j * rng.standard_normal((7, 2, 5))
    f = np.exp(2j * np.pi * rng.uniform(size=(7, 5)))
    found = average(x, f)
    std = np.sqrt(np.sum(np.abs(deviations(found)) ** 2, axis=2))
    for line in range(7):
        for row in range(2):
            solution, rss, *_ = np.linalg.lstsq(f[line][:, None], x[line, row], rcond=None)
            assert found.compliance[line, row] == pytest.approx(solution[0])
            assert std[line, row] ** 2 == pytest.approx(rss[0] / 4.0 / np.sum(np.abs(f[line]) ** 2))
            total = np.sum(np.abs(x[line, row]) ** 2)
            assert found.coherence[line, row] == pytest.approx(1.0 - rss[0] / total)
    assert degrees_of_freedom(found.leverage) == pytest.approx(np.full((7, 2), 4.0))


def test_coherence_of_noise_that_only_some_hits_share_is_below_one() -> None:
    """With noise as strong as the response, M hits give a coherence near 1/2, never above 1."""
    record = bench([(0.1 + 2.0 * k, 25.0) for k in range(10)], 20.0, noise=20.0, seed=2)
    coherence = identify_hammer("bench", {"x": [record]}, frequency_range=(200.0, 300.0)).compliance["coherence"]
    assert float(coherence.max()) <= 1.0
    assert float(coherence.median()) < 0.5


def test_force_noise_lowers_the_compliance_and_the_gate_repairs_it() -> None:
    """H1 is low by S_nn/S_FF; the force between the hits carries no information and can go."""
    hits = [(0.1 + 4.0 * k, 25.0) for k in range(5)]
    record = bench(hits, 20.0, force_noise=0.4, seed=4)
    plain = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0))
    gated = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0), gate_force=True)
    assert any("force noise lowers the compliance" in w for w in plain.warnings)
    assert relative_error(gated.compliance) < 0.01
    assert relative_error(plain.compliance) > 0.02


def test_force_noise_ends_the_band() -> None:
    """Noise of 2 N makes every line of a 25 N hit uncertain by more than a tenth: nothing is claimed."""
    record = bench([(0.1 + 4.0 * k, 25.0) for k in range(3)], 12.0, force_noise=2.0, seed=4)
    with pytest.raises(InputError, match=r"force_window = true \(gate_force=True\) where force noise limits the band"):
        identify_hammer("noisy", {"x": [record]}, frequency_range=(30.0, 120.0))


@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.slow)])
def test_noise_is_no_leakage(seeds: int) -> None:
    """A response that drowns in noise at the end of the block has decayed as far as the record shows."""
    for seed in range(seeds):
        record = bench([(0.1 + 4.0 * k, 25.0) for k in range(4)], 16.0, noise=0.5, seed=seed)
        found = identify_hammer("noisy", {"x": [record]}, frequency_range=(30.0, 120.0))
        assert not any("decayed" in w for w in found.warnings)


# --- one hit -------------------------------------------------------------------------------------------------------


def test_one_hit_claims_neither_coherence_nor_standard_deviation() -> None:
    found = identify_hammer("bench", {"x": [bench([(0.1, 25.0)], 4.0, noise=0.1)]})
    assert np.isnan(found.compliance["coherence"]).all()
    assert np.isnan(found.compliance["compliance_std"]).all()
    assert np.isfinite(found.compliance["compliance"]).all()
    assert any("coherence is 1 by construction" in w for w in found.warnings)


# --- which hits ----------------------------------------------------------------------------------------------------


def overload(record: xr.Dataset, limit: float) -> xr.Dataset:
    clipped = record.copy(deep=True)
    clipped["force"].values[:] = np.minimum(clipped["force"].values, limit)
    return clipped


def test_overloaded_hits_are_left_out() -> None:
    record = overload(bench([(0.1, 25.0), (4.1, 80.0), (8.1, 30.0)], 12.0, noise=0.01), 50.0)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0))
    table = found.tables["hits"]
    assert table["overloaded"].tolist() == [False, True, False]
    assert table["used"].tolist() == [True, False, True]
    assert "overloaded at 50 N" in table["reason"][1]
    assert any("hit 2 is not used: the force is overloaded" in w for w in found.warnings)
    assert relative_error(found.compliance) < 0.01
    # A force cut to 50 of 80 N makes the bench look softer than it is.
    careless = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0), exclude=())
    assert relative_error(careless.compliance) > 0.1


def test_double_hit_is_one_hit_with_time_and_size() -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0), (4.13, 12.0), (8.1, 30.0)], 12.0, noise=0.01, force_noise=0.02)
    found = identify_hammer("bench", {"x": [record]})
    table = found.tables["hits"]
    assert table["double_hit"].tolist() == [False, True, False]
    assert table["second_hit_after_ms"][1] == pytest.approx(30.0, abs=0.5)
    assert table["second_hit_N"][1] == pytest.approx(12.0, rel=0.02)
    assert table["used"].tolist() == [True, False, True]
    assert any("double hit: 12 N after 30 ms" in w for w in found.warnings)


def test_a_double_hit_inside_the_block_is_still_right_when_asked_for() -> None:
    """Both pulses are force and response alike; excluding them is caution about level and spectrum zeros."""
    record = bench([(0.1, 40.0), (0.13, 12.0)], 4.0, rate=20000.0)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(50.0, 75.0), exclude=())
    assert relative_error(found.compliance) < 1e-3


def test_clipped_response_is_left_out() -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0)
    record["acceleration"].values[:] = np.clip(record["acceleration"].values, -1.5, 1.5)
    table = identify_hammer("bench", {"x": [record]}, exclude=("double_hit",)).tables["hits"]
    assert table["response_overloaded"].tolist() == ["x", "x"]
    with pytest.raises(InputError, match="the response is overloaded in x"):
        identify_hammer("bench", {"x": [record]})


def test_hit_table_holds_what_was_hit() -> None:
    """Peak, impulse 2 A d/pi, duration and band of a half sine; the axis, file and time of each hit."""
    record = bench([(0.1, 25.0), (4.1, -0.0), (4.1, 40.0)], 8.0, rate=20000.0).assign_attrs(file="hx_1.csv")
    table = identify_hammer("bench", {"x": [record]}).tables["hits"]
    assert table["excitation"].tolist() == ["x", "x"]
    assert table["file"].tolist() == ["hx_1.csv", "hx_1.csv"]
    assert table["time_s"].tolist() == pytest.approx([0.102, 4.102], abs=1e-4)
    assert table["peak_force_N"].tolist() == pytest.approx([25.0, 40.0], rel=1e-3)
    assert table["impulse_Ns"].tolist() == pytest.approx([25 * 2 * PULSE / np.pi, 40 * 2 * PULSE / np.pi], rel=1e-3)
    assert table["duration_ms"].tolist() == pytest.approx([3.745, 3.745], abs=0.1)  # above 10 % of the peak
    # |F| of a half sine falls to a tenth at 1.25/d; its first zero is at 1.5/d.
    assert table["usable_to_Hz"].tolist() == pytest.approx([1.25 / PULSE, 1.25 / PULSE], rel=0.05)


def test_a_negative_force_is_a_hit_in_the_other_direction() -> None:
    record = bench([(0.1, -25.0), (4.1, -40.0)], 8.0)
    found = identify_hammer("bench", {"x": [record]}, frequency_range=(30.0, 120.0))
    assert found.tables["hits"]["peak_force_N"].tolist() == pytest.approx([-25.0, -40.0], rel=0.01)
    assert relative_error(found.compliance) < 0.01


def test_hits_survive_an_overload_ten_times_their_size() -> None:
    force = pulses(12.0, 5000.0, [(0.1, 17.0), (8.1, 15.0)])
    force[20500:20503] = 200.0
    record = make_record(np.arange(force.size) / 5000.0, {"force": {"x": force}, "acceleration": {"x": force}})
    hits = find_hits(record, "x")
    assert [h.overloaded for h in hits] == [False, True, False]


def test_full_scale_marks_hits_that_reach_it() -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0)
    hits = find_hits(record, "x", rules=HitRules(full_scale=40.0))
    assert [h.overloaded for h in hits] == [False, True]


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("share", [0.7, 0.9, 0.97])
def test_flat_top_is_distinguished_from_a_coarse_converter(bits: int, share: float) -> None:
    """A half sine of 200 samples, read with few bits, repeats its largest value too, but is not cut off."""
    t = np.linspace(0.0, np.pi, 200)
    step = 2.0 / 2**bits
    whole = np.round(np.sin(t) / step) * step
    assert not flat_top(whole)
    assert flat_top(np.round(np.minimum(np.sin(t), share) / step) * step)


@pytest.mark.parametrize("clipped", [False, True])
def test_noise_that_repeats_the_largest_value_thrice_cuts_nothing_off(clipped: bool) -> None:
    """Noise of 50 steps of the converter makes three values alike one time in 30,000, and ten of them never."""
    rng, t = np.random.default_rng(7), np.arange(3000) * 0.15
    heard = np.where(t > 60.0, np.exp(-(t - 60.0) / 60.0) * np.sin(t), 0.0) + 0.035 * rng.standard_normal(t.size)
    top = int(np.argmax(heard))
    heard[top - 1 : top + 2] = heard[top]
    if clipped:
        heard = np.minimum(heard, 0.6)
    step = 0.035 / 50.0
    assert flat_top(np.round(heard / step) * step) == clipped


def test_a_hit_that_began_before_the_record_is_not_used() -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0).isel(time=slice(255, None))
    table = identify_hammer("bench", {"x": [record]}).tables["hits"]
    assert table["reason"][0] == "the pulse began before the record"


# --- band and blocks -----------------------------------------------------------------------------------------------


def test_nothing_is_claimed_outside_the_force_spectrum() -> None:
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0)
    cut = identify_hammer("bench", {"x": [record]}).compliance
    assert float(cut["frequency"][-1]) == pytest.approx(1.25 / PULSE, rel=0.05)
    assert cut.attrs["usable_to_Hz"] == [pytest.approx(float(cut["frequency"][-1]))]
    # From acceleration: 2/(block length); its noise is raised by -1/w^2 without bound below.
    assert float(cut["frequency"][0]) == pytest.approx(2.0 / cut.attrs["block_length_s"])
    assert np.isfinite(cut["compliance"]).all()
    asked = identify_hammer("bench", {"x": [record]}, frequency_range=(10.0, 800.0))
    f = asked.compliance["frequency"].values
    assert f[-1] == pytest.approx(800.0, abs=0.3)
    assert np.isnan(asked.compliance["compliance"].values[f > 330.0]).all()
    assert np.isfinite(asked.compliance["compliance"].values[f < 300.0]).all()
    assert any("nothing is claimed outside" in w for w in asked.warnings)


def test_displacement_is_claimed_from_the_first_line() -> None:
    cut = identify_hammer("bench", {"x": [bench([(0.1, 25.0)], 4.0, channel="displacement")]}).compliance
    assert float(cut["frequency"][0]) == pytest.approx(1.0 / cut.attrs["block_length_s"])


def test_usable_band_of_a_known_spectrum() -> None:
    f = np.arange(1.0, 1001.0)
    low, high = usable_band(f, 1.0 / (1.0 + (f / 50.0) ** 2))  # -20 dB where (f/50)^2 = 99
    assert low == 1.0
    assert high == pytest.approx(50.0 * np.sqrt(99.0), abs=2.0)
    assert usable_band(f, np.ones(1000))[1] == pytest.approx(2000.0 / 2.56)


def test_resolution_sets_the_block() -> None:
    record = bench([(0.1 + 4.0 * k, 25.0) for k in range(3)], 12.0)
    found = identify_hammer("bench", {"x": [record]}, resolution=0.5)
    assert found.compliance.attrs["block_length_s"] == pytest.approx(2.0)
    assert np.allclose(np.diff(found.compliance["frequency"]), 0.5)
    with pytest.raises(InputError, match=r"no hit is left .*shorter than the block of 10 s"):
        identify_hammer("bench", {"x": [record]}, resolution=0.1)


def test_one_stray_hit_does_not_shorten_all_blocks() -> None:
    record = bench([(0.1, 25.0), (4.1, 25.0), (8.1, 25.0), (8.6, 10.0), (12.1, 25.0)], 16.0)
    found = identify_hammer("bench", {"x": [record]})
    assert found.compliance.attrs["block_length_s"] > 3.0
    assert found.tables["hits"]["used"].tolist() == [True, True, False, True, True]


def test_records_of_one_hit_each_give_what_one_record_gives() -> None:
    one = bench([(0.1, 25.0), (4.1, 40.0)], 8.0)
    parts = [one.isel(time=slice(0, 10000)), one.isel(time=slice(10000, None))]
    together = identify_hammer("one", {"x": [one]}, resolution=0.5).compliance
    apart = identify_hammer("two", {"x": parts}, resolution=0.5).compliance
    assert np.allclose(together["compliance"], apart["compliance"], rtol=1e-9)


# --- matrices ------------------------------------------------------------------------------------------------------


def three_axis(axis: str, responses: str, seed: int) -> xr.Dataset:
    """Hits along an axis of a machine that answers alike in all of `responses`."""
    record = bench([(0.1, 25.0), (4.1, 40.0)], 8.0, noise=0.01, seed=seed)
    samples = record["acceleration"].values[0]
    return make_record(
        record["time"].values,
        {"force": {axis: record["force"].values[0]}, "acceleration": dict.fromkeys(responses, samples)},
    )


def test_partial_matrix() -> None:
    """Two columns of three, and y not recorded in one of them: absent columns are absent, absent rows NaN."""
    found = identify_hammer("part", {"z": [three_axis("z", "xz", 1)], "x": [three_axis("x", "xyz", 2)], "y": []})
    compliance = found.compliance["compliance"]
    assert compliance["excitation"].values.tolist() == ["x", "z"]
    assert compliance["response"].values.tolist() == ["x", "y", "z"]
    assert np.isnan(compliance.sel(response="y", excitation="z")).all()
    for entry in (("x", "x"), ("y", "x"), ("z", "x"), ("x", "z"), ("z", "z")):
        assert np.isfinite(compliance.sel(response=entry[0], excitation=entry[1])).all()
    assert found.compliance["coherence"].dims == ("frequency", "response", "excitation")


def test_roving_accelerometer() -> None:
    """Each response is averaged over the records that hold it."""
    records = [three_axis("x", "x", 1), three_axis("x", "y", 2)]
    found = identify_hammer("roving", {"x": records}, frequency_range=(30.0, 120.0))
    assert found.compliance["response"].values.tolist() == ["x", "y"]
    assert relative_error(found.compliance, row=0) < 0.01
    assert relative_error(found.compliance, row=1) < 0.01


# --- wrong input ---------------------------------------------------------------------------------------------------


def test_no_records() -> None:
    with pytest.raises(InputError, match="'empty' has no records"):
        identify_hammer("empty", {})
    with pytest.raises(InputError, match="'empty' has no records"):
        identify_hammer("empty", {"x": []})


def test_no_force_along_the_excitation() -> None:
    with pytest.raises(InputError, match=r"record 1 was excited along y but holds force_x; declare force_y"):
        identify_hammer("wrong", {"y": [bench([(0.1, 25.0)], 4.0)]})


def test_no_motion() -> None:
    record = bench([(0.1, 25.0)], 4.0)[["force"]]
    with pytest.raises(InputError, match="neither acceleration nor displacement"):
        identify_hammer("wrong", {"x": [record]})


def test_unknown_axis() -> None:
    with pytest.raises(InputError, match="axis 'u' is none of"):
        identify_hammer("wrong", {"u": [bench([(0.1, 25.0)], 4.0)]})


def test_all_hits_overloaded() -> None:
    record = overload(bench([(0.1, 80.0), (4.1, 90.0)], 8.0), 50.0)
    with pytest.raises(InputError, match=r"no hit is left \(record 1 hit 1: the force is overloaded at 50 N; .*hit 2"):
        identify_hammer("wrong", {"x": [record]})


@pytest.mark.parametrize("kind", ["stepped sine", "noise", "nothing"])
def test_what_is_no_hammer_record(kind: str) -> None:
    t = np.arange(20000) / 1000.0
    force = {
        "stepped sine": 100.0 * np.sin(2.0 * np.pi * np.cumsum(np.repeat(np.arange(10.0, 20.0), 2000)) / 1000.0),
        "noise": np.random.default_rng(1).standard_normal(t.size),
        "nothing": np.zeros(t.size),
    }[kind]
    record = make_record(t, {"force": {"x": force}, "acceleration": {"x": force}})
    with pytest.raises(InputError, match=r"not a series of hammer hits .*method = 'actuator'"):
        identify_hammer("swapped", {"x": [record]})


def test_different_sampling_rates() -> None:
    """Blocks of 100 ms have 500 samples at 5000 Hz and 472.5 at 4725 Hz: no number of them has the same lines."""
    records = [bench([(0.1, 25.0)], 4.0, rate=rate) for rate in (5000.0, 4725.0)]
    with pytest.raises(InputError, match="different rates, whose lines are not the same; resample"):
        identify_hammer("mixed", {"x": records}, resolution=10.0)


@pytest.mark.parametrize("rate", [5000.5, 4999.0])
def test_two_clocks_that_differ_a_little_have_the_same_lines(rate: float) -> None:
    """Records of one axis, and of two, as two sessions of a recorder write them; both rates are wrong as likely."""
    one, other = (bench([(0.1, 25.0)], 4.0, rate=r, noise=1e-3, seed=int(r)) for r in (5000.0, rate))
    found = identify_hammer("clocks", {"x": [one, other]}, frequency_range=(30.0, 120.0))
    assert found.tables["hits"]["used"].all()
    assert relative_error(found.compliance) < 5e-3
    axes = {"x": [three_axis("x", "xyz", 1)], "y": [three_axis("y", "xyz", 2)]}
    slower = axes["y"][0].assign_coords(time=axes["y"][0]["time"] * 1.0001)
    both = identify_hammer("clocks", axes | {"y": [slower]})
    assert both.compliance.sizes["excitation"] == 2


@pytest.mark.parametrize("rates", [(10000.0, 8000.0), (8000.0, 10000.0), (8000.0, 25600.0)])
def test_records_of_different_rates_are_averaged_on_their_common_lines(rates: tuple[float, float]) -> None:
    records = [bench([(0.1, 25.0)], 3.987, rate=rate, noise=1e-3, seed=int(rate)) for rate in rates]
    found = identify_hammer("mixed", {"x": records}, frequency_range=(30.0, 120.0))
    assert found.tables["hits"]["used"].all()
    assert relative_error(found.compliance) < 2e-3
    length = found.compliance.attrs["block_length_s"]
    for rate in rates:
        assert length * rate == pytest.approx(round(length * rate), abs=1e-6)


@pytest.mark.parametrize(("gap", "limit"), [(0.4, 0.12), (0.6, 0.07), (0.8, 0.03)])
def test_tails_that_overlap_are_reported_and_in_the_standard_deviation(gap: float, limit: float) -> None:
    """Ten hits before the bench has rung down (0.217 s): an error of exp(-T/tau) that scatter alone does not show."""
    starts = 0.1 + np.cumsum(gap * (1.0 + 0.3 * np.random.default_rng(1).uniform(size=10)))
    record = bench([(float(start), 25.0) for start in starts], float(starts[-1] + 1.1 * gap), rate=10000.0)
    found = identify_hammer("tails", {"x": [record]}, frequency_range=(30.0, 120.0))
    assert relative_error(found.compliance) < limit
    assert any("not decayed" in w and "leave more time between hits" in w for w in found.warnings)
    error = found.compliance["compliance"].values[:, 0, 0] - exact(found.compliance["frequency"].values)
    ratio = np.sqrt(np.mean(np.abs(error / found.compliance["compliance_std"].values[:, 0, 0]) ** 2))
    assert 0.3 < ratio < 1.5


def test_a_range_the_force_does_not_reach() -> None:
    with pytest.raises(InputError, match="nothing can be claimed between 3000 and 4000 Hz"):
        identify_hammer("high", {"x": [bench([(0.1, 25.0)], 4.0)]}, frequency_range=(3000.0, 4000.0))
    with pytest.raises(InputError, match=r"nothing can be claimed between 500 and 800 Hz \(usable: x 0\.5"):
        identify_hammer("high", {"x": [bench([(0.1, 25.0)], 4.0)]}, frequency_range=(500.0, 800.0))


def test_unknown_fault() -> None:
    assert FAULTS == ("overloaded", "double_hit", "direction")
    with pytest.raises(InputError, match="exclude names soft_tip"):
        identify_hammer("wrong", {"x": [bench([(0.1, 25.0)], 4.0)]}, exclude=("soft_tip",))
