"""Actuator: multisines and chirps are exact over whole periods; intervals hold the truth; masses are taken off."""

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_record
from smfe.identification.actuator.periodic import identify_periodic
from smfe.identification.errors.intervals import interval

# 24 Hz, 2.2 % and 41 Hz, 3 %, seen in x and y.
MODES = ((24.0, 0.022, 40e6, (1.0, 0.4)), (41.0, 0.03, 60e6, (-0.3, 1.0)))
RATE, PERIOD = 512.0, 2.0
N = round(RATE * PERIOD)


def exact(frequency: np.ndarray) -> np.ndarray:
    out = np.zeros((frequency.size, 2), dtype=complex)
    for f, zeta, k, shape in MODES:
        r = frequency / f
        out += np.outer(shape[0] / (k * (1.0 - r**2 + 2j * zeta * r)), shape)
    return out


def multisine(seed: int = 0, low: int = 20, high: int = 140) -> np.ndarray:
    """Amplitudes of the harmonics of 0.5 Hz from 10 to 70 Hz, random phases, 100 N rms together."""
    lines = np.zeros(N // 2 + 1, dtype=complex)
    count = high - low + 1
    lines[low : high + 1] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=count)) * np.sqrt(2.0 / count)
    return 100.0 * lines


def chirp() -> np.ndarray:
    t = np.arange(N) / RATE
    return np.fft.rfft(100.0 * np.sin(2.0 * np.pi * (10.0 * t + 15.0 * t**2))) / (0.5 * N)


def steady(lines: np.ndarray, periods: int, channel: str = "acceleration") -> tuple[np.ndarray, np.ndarray]:
    """Force and motion in the steady state, closed form line by line."""
    f = np.arange(lines.size) / PERIOD
    response = exact(f).T * lines
    if channel == "acceleration":
        response = response * (2j * np.pi * f) ** 2
    force, motion = (np.fft.irfft(0.5 * N * part, N) for part in (lines, response))
    return np.tile(force, periods), np.tile(motion, periods)


def record(
    lines: np.ndarray,
    periods: int = 5,
    force_noise: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
    transient: float = 0.0,
    channel: str = "acceleration",
    cubic: float = 0.0,
) -> xr.Dataset:
    """Force noise in N; noise of the motion as share of its rms, coloured like a 1/f sensor; transient likewise."""
    rng = np.random.default_rng(seed)
    force, motion = steady(lines, periods, channel)
    t = np.arange(force.size) / RATE
    size = motion.std()
    motion = motion + cubic * size * (motion / size) ** 3
    motion = motion + transient * size * np.exp(-t / 0.8) * np.sin(2.0 * np.pi * 24.0 * t)
    white = np.fft.rfft(rng.standard_normal(motion.shape))
    f = np.maximum(np.fft.rfftfreq(force.size, 1.0 / RATE), 1.0)
    motion = motion + noise * size * np.fft.irfft(white * np.sqrt(1.0 + 20.0 / f), force.size)
    force = force + force_noise * rng.standard_normal(force.size)
    return make_record(t, {"force": {"x": force}, channel: {"x": motion[0], "y": motion[1]}})


@pytest.mark.parametrize("channel", ["acceleration", "displacement"])
@pytest.mark.parametrize("kind", ["multisine", "chirp"])
def test_whole_periods_are_exact(kind: str, channel: str) -> None:
    lines = multisine() if kind == "multisine" else chirp()
    found = identify_periodic("exact", {"x": [record(lines, channel=channel)]}, PERIOD).compliance
    f = found["frequency"].values
    assert f[0] <= 12.0
    assert f[-1] >= 60.0
    assert np.diff(f) == pytest.approx(0.5)
    assert found["compliance"].values[:, :, 0] == pytest.approx(exact(f), rel=1e-6, abs=1e-9 * np.abs(exact(f)).max())


def test_only_excited_lines_are_claimed() -> None:
    found = identify_periodic("band", {"x": [record(multisine(), noise=0.01, force_noise=0.1)]}, PERIOD).compliance
    assert found["frequency"].values == pytest.approx(np.arange(10.0, 70.25, 0.5))
    part = identify_periodic("part", {"x": [record(multisine())]}, PERIOD, frequency_range=(20.0, 30.0)).compliance
    assert part["frequency"].values == pytest.approx(np.arange(20.0, 30.25, 0.5))


def test_the_first_period_is_left_to_settle() -> None:
    lines = multisine()
    clean = record(lines, 6, transient=1.0)
    error = {}
    for settling in (0.0, None, 4.0):
        found = identify_periodic("settling", {"x": [clean]}, PERIOD, settling=settling)
        f = found.compliance["frequency"].values
        error[settling] = (
            np.abs(found.compliance["compliance"].values[:, :, 0] - exact(f)).max() / np.abs(exact(f)).max()
        )
    assert error[None] < 0.2 * error[0.0]
    assert error[4.0] < 0.2 * error[None]
    noisy = record(lines, 6, transient=1.0, noise=0.01)
    found = identify_periodic("settling", {"x": [noisy]}, PERIOD, settling=0.0)
    assert any("it has not settled" in w for w in found.warnings)
    assert identify_periodic("settling", {"x": [record(lines, 6, noise=0.01)]}, PERIOD).warnings == ()


def coverage(seeds: int, records: int, periods: int, cubic: float = 0.0) -> np.ndarray:
    inside = []
    for seed in range(seeds):
        group = [
            record(multisine(seed=100 * seed + k), periods, 1.0, 0.1, 1000 * seed + k, cubic=cubic)
            for k in range(records)
        ]
        found = identify_periodic("noisy", {"x": group}, PERIOD).compliance
        bounds, truth = interval(found), exact(found["frequency"].values)
        low, high = bounds["lower"].values[:, :, 0], bounds["upper"].values[:, :, 0]
        real = (low.real <= truth.real) & (truth.real <= high.real)
        imaginary = (low.imag <= truth.imag) & (truth.imag <= high.imag)
        inside.append(np.stack([real.mean(axis=0), imaginary.mean(axis=0)], axis=1))
    return 100.0 * np.mean(inside, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(("records", "periods"), [(1, 4), (2, 4), (3, 4)])
def test_intervals_hold_the_truth_as_often_as_they_say(records: int, periods: int) -> None:
    """95 % intervals, 200 seeds, force noise 1 % and coloured noise of 10 % of the response: 92 to 98 % for each "
    "part."""
    found = coverage(200, records, periods)
    assert found.min() > 92.0
    assert found.max() < 98.0


def test_distortion_repeats_and_only_other_phases_show_it() -> None:
    """With a cubic part of 3 % the period-to-period noise is blind; three realisations know better."""
    lines = [multisine(seed=k) for k in range(4)]
    group = [record(part, cubic=0.03) for part in lines]
    one = identify_periodic("one", {"x": group[:1]}, PERIOD).compliance
    four = identify_periodic("four", {"x": group}, PERIOD).compliance
    assert float(one["compliance_std"].max() / np.abs(one["compliance"]).max()) < 1e-10
    assert float((four["compliance_std"] / np.abs(four["compliance"])).median()) > 0.003
    assert four["degrees_of_freedom"].values == pytest.approx(3.0)


def test_names_signs_and_units() -> None:
    base = record(multisine(), noise=0.05, force_noise=1.0)
    one = identify_periodic("a", {"x": [base]}, PERIOD).compliance
    force, moved = base["force"].sel(axis="x").values, base["acceleration"].values
    channels = {"force": {"z": -1e-3 * force}, "acceleration": {"z": 1e3 * moved[0], "y": 1e3 * moved[1]}}
    two = identify_periodic("a", {"z": [make_record(base["time"].values, channels)]}, PERIOD).compliance
    for old, new in (("x", "z"), ("y", "y")):
        a, b = (d.sel(response=r, excitation=e) for d, r, e in ((one, old, "x"), (two, new, "z")))
        assert b["compliance"].values == pytest.approx(-1e6 * a["compliance"].values, rel=1e-9)
        assert b["compliance_std"].values == pytest.approx(1e6 * a["compliance_std"].values, rel=1e-9)


def test_what_is_refused() -> None:
    good = record(multisine())
    with pytest.raises(InputError, match=r"a period of 2.001 s is 1024.51 samples long; lines would leak"):
        identify_periodic("p", {"x": [good]}, 2.001)
    with pytest.raises(InputError, match=r"10 s hold 1 periods of 6 s after 0 s of settling; two are needed"):
        identify_periodic("p", {"x": [good]}, 6.0)
    with pytest.raises(InputError, match="a period of -1 s; it must be positive"):
        identify_periodic("p", {"x": [good]}, -1.0)
    with pytest.raises(InputError, match="excites no line of the period between 100 and 200 Hz"):
        identify_periodic("p", {"x": [good]}, PERIOD, frequency_range=(100.0, 200.0))
    with pytest.raises(InputError, match="'empty' has no records"):
        identify_periodic("empty", {}, PERIOD)
