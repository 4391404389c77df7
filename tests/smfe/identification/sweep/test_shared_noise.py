"""Noise that reaches several sensors: the rows of a compliance share errors, and reciprocity has to know.

Forces and response are closed forms: bursts of noise as forces, the response line by line from mass, damping and
stiffness matrices, everything periodic in a record that begins and ends at rest.
"""

import numpy as np
import pytest
from scipy import signal

from process.labels import make_compliance, make_record
from smfe import LocalPolynomial, SweepPass, identify_sweep
from smfe.identification.errors.covariance import entry_covariance
from smfe.identification.errors.difference import reciprocity, symmetric
from smfe.identification.errors.intervals import interval
from smfe.identification.sweep.noise import noise_between, possible, shared_noise

RATE, N = 250.0, 6000
BAND = (25.0, 65.0)
MASS = np.diag([200.0, 150.0, 300.0])
STIFFNESS = np.array([[20e6, 2e6, 3e6], [2e6, 9e6, 1e6], [3e6, 1e6, 11e6]])
DAMPING = 8.0 * MASS + 1.5e-4 * STIFFNESS
MIX = np.array([1.0, 0.9, -0.8])
BANDS = LocalPolynomial(2.0, (0.5,), rational=False)


def truth(frequency: np.ndarray) -> np.ndarray:
    w = 2.0 * np.pi * frequency[:, None, None]
    return np.linalg.inv(STIFFNESS + 1j * w * DAMPING - w**2 * MASS)


def sweeps(seed: int, common: float, own: float = 1e-2) -> list[SweepPass]:
    """Three passes; `common` [m/s2] of noise reaches x, y and z with the weights `MIX`, `own` each for itself."""
    rng, out = np.random.default_rng(seed), []
    band = signal.butter(4, (15.0, 90.0), "bandpass", fs=RATE, output="sos")
    edge = signal.windows.tukey(N - 1000, 0.1)
    for k in range(3):
        force = np.zeros((3, N))
        force[:, 100 : N - 900] = 200.0 * signal.sosfilt(band, rng.standard_normal((3, N - 1000))) * edge
        f = np.fft.rfftfreq(N, 1.0 / RATE)
        motion = np.einsum("fij,jf->if", truth(f), np.fft.rfft(force)) * -((2.0 * np.pi * f) ** 2)
        acceleration = np.fft.irfft(motion, N) + own * rng.standard_normal((3, N))
        acceleration += common * MIX[:, None] * rng.standard_normal(N)
        channels = {"force": force, "acceleration": acceleration}
        channels = {name: dict(zip("xyz", rows, strict=True)) for name, rows in channels.items()}
        out.append(SweepPass(make_record(np.arange(N) / RATE, channels), str(k)))
    return out


def expected(common: float, own: float = 1e-2) -> np.ndarray:
    """Return the coherence of the noise of two rows."""
    power = common**2 * np.outer(MIX, MIX) + own**2 * np.eye(3)
    size = np.sqrt(np.diag(power))
    return np.asarray(power / np.outer(size, size))


@pytest.mark.parametrize(
    "estimator", [BANDS, pytest.param(LocalPolynomial(2.0), marks=pytest.mark.slow)], ids=["bands", "model"]
)
def test_common_noise_is_seen_as_a_covariance_of_the_rows(estimator: LocalPolynomial) -> None:
    found = [identify_sweep("s", sweeps(k, 3e-2), BAND, estimator).compliance for k in range(8)]
    d = np.array([c["compliance"].values - truth(c["frequency"].values) for c in found])
    d /= np.array([c["compliance_std"].values for c in found])
    each = np.array([entry_covariance(c) for c in found])
    size = np.sqrt(np.diagonal(each, axis1=2, axis2=3).real)
    stated = np.mean(each / size[..., :, None] / size[..., None, :], axis=0)
    for i, k in ((0, 1), (0, 2), (1, 2)):
        stated_share = np.mean([stated[:, 3 * i + j, 3 * k + j].real.mean() for j in range(3)])
        seen = np.mean((d[:, :, i] * d[:, :, k].conj()).real)
        assert np.sign(stated_share) == np.sign(expected(3e-2)[i, k])
        assert abs(stated_share) > 0.3
        assert seen == pytest.approx(stated_share, abs=0.2)


def test_independent_noise_stays_independent() -> None:
    whole = entry_covariance(identify_sweep("s", sweeps(1, 0.0, 5e-2), BAND, BANDS).compliance).reshape(-1, 3, 3, 3, 3)
    outside = np.array([whole[:, i, :, k] for i in range(3) for k in range(3) if i != k])
    assert np.mean(outside == 0.0) > 0.9


@pytest.mark.parametrize(
    ("estimator", "seeds"),
    [
        pytest.param(BANDS, 4, id="bands"),
        pytest.param(BANDS, 12, marks=pytest.mark.slow, id="bands of more seeds"),
        pytest.param(LocalPolynomial(2.0), 12, marks=pytest.mark.slow, id="model"),
    ],
)
def test_a_symmetric_compliance_from_common_noise_is_better_and_its_intervals_hold(
    estimator: LocalPolynomial, seeds: int
) -> None:
    inside, with_it, without = [], [], []
    for seed in range(seeds):
        data = sweeps(seed, 3e-2)
        tied = identify_sweep("s", data, BAND, estimator, reciprocal=True).compliance
        exact, bounds = truth(tied["frequency"].values), interval(tied)
        low, high = bounds["lower"].values, bounds["upper"].values
        inside += [(low.real <= exact.real) & (exact.real <= high.real)]
        inside += [(low.imag <= exact.imag) & (exact.imag <= high.imag)]
        with_it.append(np.mean(np.abs(tied["compliance"].values - exact) ** 2))
        if seed < 5:
            free = identify_sweep("s", data, BAND, estimator).compliance
            without.append(np.mean(np.abs(free["compliance"].values - exact) ** 2))
            assert reciprocity(free).p_value > 1e-4
    # Of 20 lines, 9 entries and 2 parts, the errors of neighbours are shared: some 100 independent ones a seed.
    assert abs(np.mean(inside) - 0.95) < (0.03 if seeds == 12 else 0.05)
    assert np.mean(inside, axis=(0, 1)).min() > (0.89 if seeds == 12 else 0.85)
    assert np.mean(with_it) < np.mean(without)


def test_common_noise_neither_hides_nor_feigns_a_lack_of_reciprocity() -> None:
    """A difference of two rows is quieter than their errors where these are alike: 3 % of asymmetry stands out."""
    data = sweeps(3, 3e-2)
    for p in data:
        p.record["acceleration"].loc[{"axis": "y"}] *= 1.03
    found = identify_sweep("s", data, BAND, BANDS).compliance
    assert reciprocity(found).p_value < 1e-6
    blind = reciprocity(found.drop_vars("entry_covariance"))
    assert reciprocity(found).p_value != blind.p_value


def test_a_constraint_says_what_entries_share_also_where_rows_shared_nothing() -> None:
    """Standard deviations 1, 2 of xy, yx: both become the weighted mean of variance 4/5, with one error."""
    std = np.ones((4, 3, 3))
    std[:, 1, 0] = 2.0
    value = np.arange(9.0).reshape(3, 3) + np.zeros((4, 1, 1)) + 0j
    alone = make_compliance(
        [1.0, 2.0, 3.0, 4.0], value, extra={"compliance_std": (("frequency", "response", "excitation"), std)}
    )
    tied = symmetric(alone)
    assert tied["compliance"].values[:, 0, 1] == pytest.approx(0.8 * 1.0 + 0.2 * 3.0)
    whole = entry_covariance(tied).reshape(4, 3, 3, 3, 3)
    for r, e, other_r, other_e in ((0, 1, 0, 1), (0, 1, 1, 0), (1, 0, 1, 0)):
        assert whole[:, r, e, other_r, other_e] == pytest.approx(0.8)
    assert whole[:, 0, 2, 2, 0] == pytest.approx(0.5)
    assert whole[:, 0, 0, 0, 1] == pytest.approx(0.0)
    assert tied["entry_covariance"].attrs["units"] == "m^2/N^2"


def test_the_coherence_of_rows_by_hand() -> None:
    """Products of known coherence come back; what fewer lines might have by accident does not."""
    products = np.zeros((9, 2, 2, 2), dtype=complex)
    products[..., 0, 0], products[..., 1, 1], products[..., 0, 1] = 4.0, 1.0, 0.6j
    products[..., 1, 0] = -0.6j
    rho = shared_noise(products, np.full((9, 2), 50.0), 2)
    np.testing.assert_allclose(rho[:, 0, 1], 0.3j, rtol=1e-12)
    assert np.all(shared_noise(products, np.full((9, 2), 10.0), 2)[:, 0, 1] == 0.0)
    covariance = np.broadcast_to(np.diag([4.0, 9.0]).astype(complex), (9, 2, 2, 2))
    same = noise_between(covariance, rho, np.ones((9, 2)), np.ones((9, 2)))
    np.testing.assert_allclose(same[:, 0, :, 1], np.broadcast_to(0.3j * np.diag([4.0, 9.0]), (9, 2, 2)))
    assert np.all(same[:, 0, :, 0] == 0.0)
    # Twice the noise in a band four times as wide: its covariance is the same, its part in the other row 1/2.
    wide = noise_between(covariance, rho, np.broadcast_to([1.0, 2.0], (9, 2)), np.broadcast_to([1.0, 4.0], (9, 2)))
    np.testing.assert_allclose(wide[:, 0, :, 1], np.broadcast_to(0.15j * np.diag([4.0, 9.0]), (9, 2, 2)))


def test_covariances_that_cannot_be_are_shrunk_to_such_that_can() -> None:
    covariance = np.broadcast_to(np.eye(1, dtype=complex), (1, 3, 1, 1))
    between = np.zeros((1, 3, 1, 3, 1), dtype=complex)
    for i, k in ((0, 1), (0, 2)):
        between[0, i, 0, k, 0] = between[0, k, 0, i, 0] = 0.9
    whole = possible(covariance, between).reshape(3, 3) + np.eye(3)
    assert np.linalg.eigvalsh(whole)[0] == pytest.approx(1e-3)
    assert whole[0, 1].real == pytest.approx(0.999 / np.sqrt(2.0))
    np.testing.assert_allclose(possible(covariance, 0.5 * between), 0.5 * between)
