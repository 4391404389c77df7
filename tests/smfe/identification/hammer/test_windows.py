"""Hammer: windows and estimators against closed forms."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.errors import InputError
from process.labels import make_record
from smfe.comparison.peaks import find_peaks
from smfe.identification.errors.averaging import average, noise_ratio
from smfe.identification.hammer.hammer import Averaging, identify_hammer
from smfe.identification.hammer.windows import exponential, without_window

# A lightly damped mode: 61.3 Hz, 0.4 %, decay constant 0.65 s.
FREQUENCY, DAMPING, STIFFNESS = 61.3, 0.004, 1.68e6
PULSE = 4e-3


def modes(s: np.ndarray, second: bool = False) -> np.ndarray:
    found = np.zeros(s.shape, dtype=complex)
    for f, zeta, k in ((FREQUENCY, DAMPING, STIFFNESS), (74.0, 0.006, 3e6))[: 2 if second else 1]:
        w = 2.0 * np.pi * f
        found += w**2 / k / (s**2 + 2.0 * zeta * w * s + w**2)
    return found


def record(
    duration: float, rate: float = 8000.0, second: bool = False, hits: int = 1, channel: str = "acceleration"
) -> xr.Dataset:
    """Records of one hit each after another, the machine at rest before each."""
    t = np.arange(round(duration * rate)) / rate
    start = 0.02 * duration
    force = 25.0 * np.where((t >= start) & (t <= start + PULSE), np.sin(np.pi * (t - start) / PULSE), 0.0)
    motion = np.zeros(t.size)
    for f, zeta, k in ((FREQUENCY, DAMPING, STIFFNESS), (74.0, 0.006, 3e6))[: 2 if second else 1]:
        w = 2.0 * np.pi * f
        output = ([[-(w**2), -2.0 * zeta * w]], [[w**2 / k]]) if channel == "acceleration" else ([[1.0, 0.0]], [[0.0]])
        system = [[0.0, 1.0], [-(w**2), -2.0 * zeta * w]], [[0.0], [w**2 / k]]
        motion += signal.lsim((*system, *output), force, t)[1]
    return make_record(t, {"force": {"x": force}, channel: {"x": motion}})


def error(found: xr.Dataset, second: bool = False) -> float:
    """Largest error of the compliance relative to the largest compliance."""
    truth = modes(2j * np.pi * found["frequency"].values, second)
    return float(np.max(np.abs(found["compliance"].values[:, 0, 0] - truth)) / np.abs(truth).max())


@pytest.mark.parametrize("second", [False, True], ids=["one mode", "two modes"])
@pytest.mark.parametrize("channel", ["acceleration", "displacement"])
def test_a_record_that_is_too_short_is_right_with_an_exponential_window(channel: str, second: bool) -> None:
    """1 s for a decay of 0.65 s: without a window an error of exp(-1/0.65); with 0.15 s, taken off again, 0.03 %."""
    records = {"x": [record(1.0, second=second, channel=channel)]}
    plain = identify_hammer("short", records, frequency_range=(40.0, 100.0))
    assert error(plain.compliance, second) > 0.1
    window = Averaging(exponential_window=0.15)
    found = identify_hammer("short", records, frequency_range=(40.0, 100.0), averaging=window)
    assert error(found.compliance, second) < 1e-3
    assert any("not decayed" in w for w in plain.warnings)
    assert not any("not decayed" in w for w in found.warnings)


def test_the_window_adds_its_decay_rate_and_nothing_else() -> None:
    """H(1/tau + j w) before it is taken off: every pole decays by 1/tau more, 6.7 1/s on 1.54 1/s of the mode."""
    tau, rate = 0.15, 8000.0
    one = record(1.0, rate)
    taper = exponential(one.sizes["time"], 0, 1.0 / rate, tau)
    f = np.fft.rfftfreq(one.sizes["time"], 1.0 / rate)
    lines = slice(20, 121)
    force, motion = (np.fft.rfft(one[name].values[0] * taper)[lines] for name in ("force", "acceleration"))
    s = 1.0 / tau + 2j * np.pi * f[lines]
    shifted = motion / force / s**2
    assert np.abs(shifted - modes(s)).max() < 2e-3 * np.abs(modes(s)).max()
    (peak,) = find_peaks(f[lines], shifted)
    added = peak.damping * 2.0 * np.pi * peak.frequency - DAMPING * 2.0 * np.pi * FREQUENCY
    assert added == pytest.approx(1.0 / tau, rel=0.03)


def test_the_continuation_is_exact_for_one_mode() -> None:
    f = np.arange(10.0, 200.0, 1.0)
    for tau in (0.1, 0.25, 0.5):
        wide = modes(1.0 / tau + 2j * np.pi * f)
        truth = modes(2j * np.pi * f)
        assert without_window(wide, f, tau) == pytest.approx(truth, abs=1e-6 * np.abs(truth).max())


@pytest.mark.parametrize("tau", [-0.1, 0.0, 0.8, 0.001])
def test_a_window_that_makes_no_sense_is_refused(tau: float) -> None:
    with pytest.raises(InputError, match=r"an exponential window of .* give "):
        identify_hammer("w", {"x": [record(1.0)]}, averaging=Averaging(exponential_window=tau))


# --- estimators ----------------------------------------------------------------------------------------------------


def spectra(noise_x: float, noise_f: float, hits: int = 4000, seed: int = 1) -> tuple[np.ndarray, np.ndarray, complex]:
    """One line: forces of size one, H = 2 - 1j, white noise of given variance on both."""
    rng = np.random.default_rng(seed)

    def white(variance: float) -> np.ndarray:
        return np.sqrt(variance / 2.0) * (rng.standard_normal((40, hits)) + 1j * rng.standard_normal((40, hits)))

    truth = 2.0 - 1.0j
    force = np.exp(2j * np.pi * rng.uniform(size=(40, hits)))
    return (truth * force + white(noise_x))[:, None, :], force + white(noise_f), truth


def test_h1_is_low_by_the_noise_of_the_force_and_h2_high_by_that_of_the_response() -> None:
    """H1 = H/(1 + N_f), H2 = H (1 + N_x/|H|^2), Hv between and right."""
    x, f, truth = spectra(noise_x=0.5, noise_f=0.2)
    means = {e: complex(average(x, f, e, np.full((40, 1), 2.5)).compliance.mean()) for e in ("H1", "H2", "Hv")}
    assert means["H1"] == pytest.approx(truth / 1.2, rel=0.01)
    assert means["H2"] == pytest.approx(truth * 1.1, rel=0.01)
    assert means["Hv"] == pytest.approx(truth, rel=0.01)


def test_the_limits_of_hv_are_h1_and_h2_and_their_mean() -> None:
    x, f, _ = spectra(0.5, 0.2, hits=5)
    h1, h2 = (average(x, f, e).compliance for e in ("H1", "H2"))
    assert average(x, f, "Hv", np.full((40, 1), np.inf)).compliance == pytest.approx(h1)
    assert average(x, f, "Hv", np.full((40, 1), 1e9)).compliance == pytest.approx(h1, rel=1e-6)
    assert average(x, f, "Hv", np.full((40, 1), 1e-9)).compliance == pytest.approx(h2, rel=1e-6)
    ratio = np.sum(np.abs(x) ** 2, axis=2) / np.sum(np.abs(f) ** 2, axis=1)[:, None]
    middle = average(x, f, "Hv", ratio).compliance
    assert np.abs(middle) == pytest.approx(np.sqrt(np.abs(h1 * h2)))


def test_hv_does_not_depend_on_units() -> None:
    """In micrometres the ratio of the variances is 1e12 times what it is in metres, and Hv 1e6 times."""
    x, f, _ = spectra(0.5, 0.2, hits=5)
    metres = average(x, f, "Hv", np.full((40, 1), 2.5)).compliance
    assert average(1e6 * x, f, "Hv", np.full((40, 1), 2.5e12)).compliance == pytest.approx(1e6 * metres)


def test_the_noise_ratio_is_read_from_the_hits() -> None:
    x, f, _ = spectra(0.5, 0.2, hits=400)
    assert noise_ratio(x, f, 0.2) == pytest.approx(2.5, rel=0.25)
    assert np.isinf(noise_ratio(x, f, 0.0)).all()


def test_an_unknown_estimator_and_a_ratio_that_is_none() -> None:
    with pytest.raises(InputError, match="estimator 'H3' is not known; available: H1, H2, Hv"):
        Averaging("H3")
    with pytest.raises(InputError, match="a noise ratio of -1; give a positive number"):
        Averaging("Hv", noise_ratio=-1.0)
