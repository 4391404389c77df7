"""One convention of ``degrees_of_freedom`` for all methods: Student's t of each part, a value for each entry."""

import numpy as np
import pytest
import xarray as xr

from process.labels import make_record
from smfe import LocalPolynomial, Segments, SweepPass, identify_hammer, identify_sweep
from smfe.identification.errors.intervals import interval, student_quantile
from smfe.identification.sweep.least_squares import Columns, solve
from smfe.identification.sweep.noise import pooled_noise
from smfe.identification.sweep.order_tracking import Orders

RATE = 200.0
STATIC = 2e-7 - 1e-7j


def coverage(force: np.ndarray, correlation: np.ndarray | None, seeds: int) -> tuple[float, float, float]:
    """Share of 95 % intervals that hold zero, of t and of the normal distribution, and the relative nu of s^2."""
    rng = np.random.default_rng(1)
    m = force.shape[1]
    root = np.eye(m) if correlation is None else np.linalg.cholesky(correlation)
    inside, normal, power = [], [], []
    for _ in range(seeds):
        noise = root @ (rng.standard_normal(m) + 1j * rng.standard_normal(m))
        found = solve(Columns(force, noise[None], np.zeros(m, dtype=np.int64), correlation), force.shape[0])
        parts = found.compliance[0, 0].real, found.compliance[0, 0].imag
        std = found.std[0, 0] / np.sqrt(2.0)
        reach = float(student_quantile(found.degrees_of_freedom, 0.95)[0])
        inside += [abs(v) <= reach * std for v in parts]
        normal += [abs(v) <= 1.96 * std for v in parts]
        power.append(found.std[0, 0] ** 2)
    scatter = 2.0 * np.mean(power) ** 2 / np.var(power)
    return float(np.mean(inside)), float(np.mean(normal)), scatter / float(found.degrees_of_freedom[0])


def columns(m: int) -> np.ndarray:
    rng = np.random.default_rng(2)
    return rng.standard_normal((3, m)) + 1j * rng.standard_normal((3, m))


SEEDS = pytest.mark.parametrize(("seeds", "wider"), [(600, 2.2), pytest.param(3000, 1.0, marks=pytest.mark.slow)])


@SEEDS
def test_m_columns_and_p_unknowns_have_twice_m_minus_p_and_the_t_of_it_is_exact(seeds: int, wider: float) -> None:
    held, by_normal, relative = coverage(columns(6), None, seeds)
    assert held == pytest.approx(0.95, abs=0.01 * wider)
    assert by_normal < 0.92
    assert relative == pytest.approx(1.0, abs=0.12 * wider)
    found = solve(Columns(columns(6), columns(6)[:1], np.zeros(6, dtype=np.int64)), 3)
    assert found.degrees_of_freedom[0] == pytest.approx(6.0)


@SEEDS
def test_columns_that_share_noise_count_less(seeds: int, wider: float) -> None:
    lag = np.abs(np.arange(16)[:, None] - np.arange(16)[None, :])
    correlation = np.select([lag == 0, lag == 1, lag == 2], [1.0, 0.66, 0.17], 0.0).astype(complex)
    correlation *= np.exp(0.7j * (np.arange(16)[:, None] - np.arange(16)[None, :]))
    held, _, relative = coverage(columns(16), correlation, seeds)
    assert held == pytest.approx(0.95, abs=0.015 * wider)
    assert relative == pytest.approx(1.0, abs=0.15 * wider)
    found = solve(Columns(columns(16), columns(16)[:1], np.zeros(16, dtype=np.int64), correlation), 3)
    assert found.degrees_of_freedom[0] < 0.7 * 2.0 * 13.0


def sweeps(rng: np.random.Generator, count: int = 1, n: int = 800) -> list[SweepPass]:
    """Four seconds each of a compliance that does not change with frequency, with noise on the displacement."""
    out = []
    for k in range(count):
        force = np.zeros(n)
        force[80:-80] = 100.0 * rng.standard_normal(n - 160)  # air at both ends, long enough to show that it is silent
        spectrum = np.fft.rfft(force) * STATIC
        spectrum[[0, -1]] = spectrum[[0, -1]].real
        motion = np.fft.irfft(spectrum, n) + 1e-5 * rng.standard_normal(n)
        record = make_record(np.arange(n) / RATE, {"force": {"x": force}, "displacement": {"x": motion}})
        out.append(SweepPass(record, str(k)))
    return out


@pytest.mark.slow
def test_a_sweep_with_few_lines_states_intervals_that_hold() -> None:
    """A band of 2 Hz in a record of 4 s: 8 lines, 3 unknowns, 10 degrees of freedom."""
    rng, narrow, inside = np.random.default_rng(3), LocalPolynomial(4.0, (1.0,), rational=False), []
    for _ in range(150):
        found = identify_sweep("s", sweeps(rng), (20.0, 80.0), narrow, axes=("x",)).compliance
        bounds = interval(found)
        low, high = bounds["lower"].values, bounds["upper"].values
        inside += [(low.real <= STATIC.real) & (STATIC.real <= high.real)]
        inside += [(low.imag <= STATIC.imag) & (STATIC.imag <= high.imag)]
    assert found["degrees_of_freedom"].values == pytest.approx(10.0)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_noise_of_passes_is_pooled_as_far_as_its_scatter_explains_the_difference() -> None:
    """Logarithms of means of n lines scatter by psi'(n): such passes become alike, others stay what they are."""
    rng, n = np.random.default_rng(6), 8
    alike = rng.gamma(n, 1.0 / n, (500, 3, 1))
    pooled = pooled_noise(alike, np.full((500, 3), float(n)))
    assert np.log(pooled).std(axis=1).mean() < 0.45 * np.log(alike).std(axis=1).mean()
    np.testing.assert_allclose(np.log(pooled).mean(axis=1), np.log(alike).mean(axis=1))
    unlike = alike * np.array([1.0, 100.0, 1e4])[:, None]
    np.testing.assert_allclose(pooled_noise(unlike, np.full((500, 3), float(n))), unlike, rtol=0.1)
    np.testing.assert_allclose(pooled_noise(alike[:, :1], np.full((500, 1), float(n))), alike[:, :1])


@pytest.mark.parametrize("seeds", [12, pytest.param(80, marks=pytest.mark.slow)])
def test_short_passes_of_equal_noise_are_weighted_alike(seeds: int) -> None:
    """Two passes of 2 s, four lines each: noise learnt from each alone made intervals that hold in 85 %."""
    rng, narrow, inside = np.random.default_rng(3), LocalPolynomial(4.0, (1.0,), rational=False), []
    for _ in range(seeds):
        bounds = interval(identify_sweep("s", sweeps(rng, 2, 400), (20.0, 80.0), narrow, axes=("x",)).compliance)
        low, high = bounds["lower"].values, bounds["upper"].values
        inside += [(low.real <= STATIC.real) & (STATIC.real <= high.real)]
        inside += [(low.imag <= STATIC.imag) & (STATIC.imag <= high.imag)]
    assert np.mean(inside) > 0.88


def hits(count: int = 4) -> xr.Dataset:
    t = np.arange(round(count * 1.2 * 1000.0)) / 1000.0
    force, motion = np.zeros(t.size), np.zeros(t.size)
    for k in range(count):
        since = t - 0.1 - 1.2 * k
        force += np.where((since > 0.0) & (since < 4e-3), 300.0 * np.sin(np.pi * since / 4e-3), 0.0)
        after = np.clip(since - 2e-3, 0.0, None)
        motion += 2e-6 * np.exp(-8.0 * after) * np.sin(2.0 * np.pi * 40.0 * after)
    motion = motion + 1e-9 * np.random.default_rng(4).standard_normal(t.size)
    return make_record(t, {"force": {"x": force}, "displacement": {"x": motion}})


def test_every_method_says_it_for_each_entry_and_intervals_need_nothing_else() -> None:
    three = ("frequency", "response", "excitation")
    data = sweeps(np.random.default_rng(5), 3)
    for p in data:
        t = p.record["time"].values
        p.record["spindle_angle"] = ("time", 2.0 * np.pi * (14.5 * t + 0.75 * t**2), {"units": "rad"})
    found = [identify_hammer("h", {"x": [hits()]}, frequency_range=(20.0, 80.0)).compliance]
    found += [
        identify_sweep("s", data, (30.0, 40.0), e, axes=("x",)).compliance for e in (None, Segments(2.0), Orders(2))
    ]
    for compliance in found:
        freedom = compliance["degrees_of_freedom"]
        assert freedom.dims == three
        assert freedom.shape == compliance["compliance"].shape
        assert (freedom.values > 1.0).all()
        assert np.isfinite(interval(compliance)["upper"].values).all()
    # Four hits of equal force: three for each part.
    assert found[0]["degrees_of_freedom"].values == pytest.approx(3.0, abs=0.05)
