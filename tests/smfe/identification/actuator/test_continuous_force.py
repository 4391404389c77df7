"""Random noise, bursts, chirps and multisines of a shaker: right at the peaks, with intervals that hold the truth."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from truth.shaker import Shaken, draw

from process.errors import InputError
from process.labels import AXES, make_record
from smfe.campaign import load_campaign
from smfe.identification.actuator.continuous_force import identify_continuous
from smfe.identification.actuator.continuous_records import clipped_share
from smfe.identification.actuator.excitation_kind import identify_shaken, repetition
from smfe.identification.errors.intervals import interval
from smfe.identification.errors.result import Identification
from smfe.identification.measurement import identify_measurement

RATE = 1024.0
MODES = ((60.0, 0.01, 2e7), (140.0, 0.004, 5e7))


def records_of(drawn: Shaken) -> dict[str, list[xr.Dataset]]:
    pairs = zip(drawn.force, drawn.motion, strict=True)
    along = AXES[drawn.axis]
    return {
        along: [
            make_record(
                np.arange(f.size) / drawn.rate,
                {"force": {along: f}, drawn.channel: dict(zip(AXES, x, strict=True))},
            )
            for f, x in pairs
        ]
    }


def held(drawn: Shaken, found: xr.Dataset) -> float:
    """Share of 95 % intervals that hold the truth."""
    limits, inside = interval(found), []
    for r, response in enumerate(found["response"].values):
        truth = drawn.truth(found["frequency"].values, AXES.index(str(response)))
        known = np.isfinite(found["compliance"].values[:, r, 0])
        low, high = (limits[name].values[known, r, 0] for name in ("lower", "upper"))
        truth = truth[known]
        inside += [(low.real <= truth.real) & (truth.real <= high.real)]
        inside += [(low.imag <= truth.imag) & (truth.imag <= high.imag)]
    return float(np.mean(np.concatenate(inside)))


def exact(f: np.ndarray) -> np.ndarray:
    return np.sum([1.0 / (k * (1.0 - (f / fn) ** 2 + 2j * z * f / fn)) for fn, z, k in MODES], axis=0)


def shaken(
    force: np.ndarray, seed: int = 0, noise: float = 1e-3, force_noise: float = 0.0, quiet: int = 0
) -> xr.Dataset:
    """A record of two modes under a band-limited force, from rest, solved line by line over a longer circle."""
    rng = np.random.default_rng(seed)
    whole = np.concatenate([np.zeros(quiet), force])
    circle = 2 ** int(np.ceil(np.log2(whole.size + 8 * RATE)))
    f = np.fft.rfftfreq(circle, 1.0 / RATE)
    motion = np.fft.irfft(np.fft.rfft(whole, circle) * exact(f) * -((2.0 * np.pi * f) ** 2), circle)[: whole.size]
    motion = motion + noise * motion.std() * rng.standard_normal(motion.size)
    seen = whole + force_noise * force.std() * rng.standard_normal(whole.size)
    return make_record(np.arange(whole.size) / RATE, {"force": {"x": seen}, "acceleration": {"x": motion}})


def noise_between(low: float, high: float, seconds: float, seed: int = 1) -> np.ndarray:
    n = int(seconds * RATE)
    f = np.fft.rfftfreq(n, 1.0 / RATE)
    lines = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    return 50.0 * np.fft.irfft(np.where((f > low) & (f < high), lines, 0.0), n)


def relative(found: Identification, at: float) -> float:
    c = found.compliance
    i = int(np.abs(c["frequency"].values - at).argmin())
    truth = exact(c["frequency"].values[i : i + 1])[0]
    return float(abs(c["compliance"].values[i, 0, 0] / truth - 1.0))


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("random", 900),
        pytest.param("linear chirp", 902, marks=pytest.mark.slow),
        pytest.param("burst", 901, marks=pytest.mark.slow),
        pytest.param("logarithmic chirp", 903, marks=pytest.mark.slow),
    ],
)
def test_intervals_hold_the_truth_of_any_force_that_does_not_repeat_itself(kind: str, seed: int) -> None:
    drawn = draw(seed, kind)
    assert held(drawn, identify_shaken("drawn", records_of(drawn)).compliance) > 0.9


def test_a_resonance_narrower_than_blocks_resolve_is_right() -> None:
    """0.4 % at 140 Hz in 10 s is a width of 1.1 Hz: too narrow for blocks of 1 s, which say so; the record has it."""
    record = shaken(noise_between(10.0, 380.0, 10.0))
    assert relative(identify_shaken("whole", {"x": [record]}, resolution=0.5), 140.0) < 0.01
    blocks = identify_continuous("blocks", {"x": [record]}, resolution=1.0, estimator="H1")
    assert any("blocks are too short for the damping in" in w for w in blocks.warnings)
    assert 140.0 not in blocks.compliance["frequency"].values


@pytest.mark.parametrize("estimator", ["H1", *(pytest.param(e, marks=pytest.mark.slow) for e in ("Hv", "H2"))])
def test_averages_of_blocks_hold_the_truth(estimator: str) -> None:
    """40 s in blocks of 5 s, 1 % of noise on both."""
    record = shaken(noise_between(10.0, 380.0, 40.0), noise=0.01, force_noise=0.01, quiet=512)
    blocks = identify_continuous("blocks", {"x": [record]}, resolution=0.2, estimator=estimator)
    found = blocks.compliance
    limits, truth = interval(found), exact(found["frequency"].values)
    inside = np.abs(found["compliance"].values[:, 0, 0].real - truth.real) <= np.abs(
        limits["upper"].values[:, 0, 0].real - found["compliance"].values[:, 0, 0].real
    )
    assert inside.mean() > 0.93
    assert relative(blocks, 60.0) < 0.05


@pytest.mark.slow
def test_noise_of_the_force_lowers_h1_and_not_hv() -> None:
    """N/S_FF = 0.27^2 370/512 = 0.053: H1 is 5 % low; N is known from silence before the start."""
    record = shaken(noise_between(10.0, 380.0, 60.0), force_noise=0.27, quiet=1024)
    low, right = (
        identify_continuous(e, {"x": [record]}, resolution=0.5, estimator=e, frequency_range=(20.0, 120.0)).compliance
        for e in ("H1", "Hv")
    )
    ratio = [np.nanmedian((c["compliance"].values[:, 0, 0] / exact(c["frequency"].values)).real) for c in (low, right)]
    assert ratio[0] == pytest.approx(0.95, abs=0.01)
    assert ratio[1] == pytest.approx(1.0, abs=0.015)
    whole = identify_shaken("whole", {"x": [record]}, frequency_range=(20.0, 120.0))
    found = whole.compliance["compliance"].values[:, 0, 0] / exact(whole.compliance["frequency"].values)
    assert np.median(found.real) == pytest.approx(1.0, abs=0.015)


def test_lines_without_power_are_not_claimed_and_said() -> None:
    force = noise_between(30.0, 100.0, 20.0) + noise_between(150.0, 200.0, 20.0)
    found = identify_shaken("gap", {"x": [shaken(force)]})
    f = found.compliance["frequency"].values
    assert f.min() > 28.0
    assert f.max() < 202.0
    assert not np.any((f > 105.0) & (f < 145.0))
    assert any("the force has no power in 10" in w for w in found.warnings)


def test_a_clipped_force_is_charged_or_refused() -> None:
    force = noise_between(10.0, 380.0, 10.0)
    clipped = np.clip(force, -2.5 * force.std(), 2.5 * force.std())
    assert clipped_share(clipped) == pytest.approx(0.0124, abs=0.003)
    assert clipped_share(force) == 0.0
    sine = np.round(1000.0 * np.sin(np.arange(10000) * 0.01)) / 1000.0
    assert clipped_share(sine) == 0.0
    said = identify_shaken("a", {"x": [_with_force(shaken(force), clipped)]})
    assert any("at the end of its range" in w for w in said.warnings)
    cut = np.clip(force, -1.5 * force.std(), 1.5 * force.std())
    with pytest.raises(InputError, match=r"at the end of its range in 1. % of its samples"):
        identify_shaken("b", {"x": [_with_force(shaken(force), cut)]})


def _with_force(record: xr.Dataset, force: np.ndarray) -> xr.Dataset:
    return record.assign(force=record["force"].copy(data=force[None]))


def test_a_period_is_found_to_a_fraction_of_a_sample() -> None:
    """A generator 80 ppm slow: 1000 samples of its own are 1000.08 of the recorder."""
    drawn = draw(905, "multisine")
    found = repetition(np.tile(np.random.default_rng(0).standard_normal(1000), 5))
    assert found is not None
    assert found.period == pytest.approx(1000.0, abs=1e-6)
    assert found.stretches == ((0, 5),)
    assert repetition(np.random.default_rng(0).standard_normal(5000)) is None
    shaken_once = identify_shaken("periodic", records_of(drawn))
    assert any("repeats itself after" in w for w in shaken_once.warnings)
    assert held(drawn, shaken_once.compliance) > 0.9


def test_multisines_one_after_another_are_separated() -> None:
    rng = np.random.default_rng(4)
    each = [np.tile(noise_between(10.0, 300.0, 2.0, seed), 4) for seed in range(3)]
    force = np.concatenate(each)
    found = repetition(force)
    assert found is not None
    assert len(found.stretches) == 3
    assert [s for s, _ in found.stretches] == pytest.approx([0, 8192, 16384], abs=260)
    record = shaken(force, seed=int(rng.integers(9)))
    out = identify_shaken("three", {"x": [record]})
    assert any("in 3 stretches along x" in w for w in out.warnings)


def test_kinds_of_excitation_are_not_mixed() -> None:
    tone = 50.0 * np.sin(2.0 * np.pi * 40.0 * np.arange(20 * int(RATE)) / RATE)
    with pytest.raises(InputError, match=r"mixes kinds of excitation .*record 2: steps"):
        identify_shaken("mix", {"x": [shaken(noise_between(10.0, 300.0, 20.0)), shaken(tone)]})


@pytest.mark.parametrize("keys", ["", 'estimator = "H1"', 'resolution = "1 Hz"'])
def test_a_campaign_needs_no_word_on_the_kind_of_force(tmp_path: Path, keys: str) -> None:
    shaken(noise_between(10.0, 380.0, 8.0)).to_netcdf(tmp_path / "r.nc")
    text = f'[campaign]\nname = "c"\n[[measurement]]\nname = "shaker"\nmethod = "actuator"\n{keys}\n'
    (tmp_path / "c.toml").write_text(text + 'records = [{ file = "r.nc", excitation = "x" }]\n')
    campaign = load_campaign(tmp_path / "c.toml")
    found = identify_measurement(campaign, campaign.measurements[0])
    assert relative(found, 60.0) < (0.3 if "estimator" in keys else 0.02)
    said = "independent averages" if "estimator" in keys else "the force was taken for random excitation"
    assert any(said in w for w in found.warnings)


def test_what_cannot_be_done_is_said() -> None:
    record = shaken(noise_between(10.0, 380.0, 10.0))
    with pytest.raises(InputError, match="too short for a response"):
        identify_shaken("short", {"x": [record.isel(time=slice(0, 24))]}, estimator="local_polynomial")
    with pytest.raises(InputError, match="does not lie below half the sample rate"):
        identify_shaken("band", {"x": [record]}, frequency_range=(10.0, 900.0))
    with pytest.raises(InputError, match="force_x is constant"):
        identify_shaken("dead", {"x": [_with_force(record, np.zeros(record.sizes["time"]))]}, estimator="H1")
    with pytest.raises(InputError, match="hold 0 blocks of 50 s"):
        identify_shaken("coarse", {"x": [record]}, estimator="H1", resolution=0.02)


@pytest.mark.slow
def test_a_force_along_another_axis_is_said_and_a_small_one_is_not() -> None:
    record, rng = shaken(noise_between(20.0, 300.0, 6.0)), np.random.default_rng(3)
    x = record["force"].sel(axis="x").values
    motion = {"x": record["acceleration"].sel(axis="x").values}
    for share, count in ((0.03, 0), (0.5, 1)):
        forces = {"x": x, "y": share * x.std() * rng.standard_normal(x.size)}
        both = make_record(record["time"].values, {"force": forces, "acceleration": motion})
        found = identify_shaken("shaker", {"x": [both]})
        assert sum("the force along y is" in w for w in found.warnings) == count
