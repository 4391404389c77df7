"""The weighted least squares core: exact without noise, calibrated with it."""

import numpy as np
import pytest

from smfe.identification.sweep.least_squares import Columns, condition_number, solve


def complex_normal(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def test_without_noise_the_compliance_is_exact_and_coherent() -> None:
    rng = np.random.default_rng(1)
    truth, force = complex_normal(rng, 3, 3), complex_normal(rng, 3, 12)
    result = solve(Columns(force, truth @ force, np.zeros(12, int)), 3)
    np.testing.assert_allclose(result.compliance, truth, rtol=1e-12)
    np.testing.assert_allclose(result.coherence, 1.0)
    assert result.condition == pytest.approx(np.linalg.cond(force))


def test_the_stated_std_is_the_scatter_over_many_seeds() -> None:
    rng = np.random.default_rng(2)
    truth, force = complex_normal(rng, 3, 3), complex_normal(rng, 3, 20)
    test, noise = np.repeat([0, 1], 10), np.array([[0.01, 0.2]] * 3)
    error, stated = [], []
    for _ in range(400):
        x = truth @ force + np.sqrt(noise[:, test]) * complex_normal(rng, 3, 20)
        result = solve(Columns(force, x, test), 3, noise)
        error.append(np.abs(result.compliance - truth) ** 2)
        stated.append(result.std**2)
    ratio = np.sqrt(np.mean(error, axis=0) / np.mean(stated, axis=0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.12)


def test_the_stated_covariance_has_the_right_sign_of_its_phase() -> None:
    rng = np.random.default_rng(6)
    truth, force = complex_normal(rng, 1, 3), complex_normal(rng, 3, 5)
    scatter, stated = np.zeros((3, 3), complex), np.zeros((3, 3), complex)
    for _ in range(2000):
        result = solve(Columns(force, truth @ force + complex_normal(rng, 1, 5), np.zeros(5, int)), 3)
        error = (result.compliance - truth)[0]
        scatter += np.outer(error, error.conj())
        stated += result.covariance[0]
    np.testing.assert_allclose(scatter / 2000, stated / 2000, atol=0.1 * np.abs(stated).max() / 2000)
    assert np.abs(np.imag(stated)).max() > 0.1 * np.abs(stated).max()


def test_weights_lower_the_scatter_when_one_test_is_noisy() -> None:
    rng = np.random.default_rng(3)
    truth, force = complex_normal(rng, 1, 3), complex_normal(rng, 3, 20)
    test, noise = np.repeat([0, 1], 10), np.array([[1e-4, 1.0]])
    scatter = np.zeros(2)
    for _ in range(100):
        x = truth @ force + np.sqrt(noise[:, test]) * complex_normal(rng, 1, 20)
        for i, weight in enumerate((None, noise)):
            scatter[i] += np.sum(np.abs(solve(Columns(force, x, test), 3, weight).compliance - truth) ** 2)
    assert scatter[1] < 0.01 * scatter[0]


def test_correlated_columns_are_not_counted_as_independent() -> None:
    rng = np.random.default_rng(4)
    n, lag = 24, np.arange(24)
    correlation = 0.8 ** np.abs(lag[:, None] - lag) * np.exp(0.7j * (lag[:, None] - lag))
    root = np.linalg.cholesky(correlation)
    truth, force = complex_normal(rng, 1, 2), complex_normal(rng, 2, n)
    error, stated = [], []
    for _ in range(600):
        x = truth @ force + (root @ complex_normal(rng, n))[None, :]
        result = solve(Columns(force, x, np.zeros(n, int), correlation), 2)
        error.append(np.abs(result.compliance - truth) ** 2)
        stated.append(result.std**2)
    np.testing.assert_allclose(np.sqrt(np.mean(error, axis=0) / np.mean(stated, axis=0)), 1.0, atol=0.12)


def test_coherence_of_pure_noise_is_zero_on_average_after_adjustment() -> None:
    rng = np.random.default_rng(5)
    values = []
    for _ in range(300):
        columns = Columns(complex_normal(rng, 3, 9), complex_normal(rng, 1, 9), np.zeros(9, int))
        values.append(solve(columns, 3).coherence[0])
    # Clipped at zero, so the mean is small and positive; unadjusted it would be 3/9.
    assert np.mean(values) < 0.12


def test_dependent_forces_are_not_solved() -> None:
    force = np.ones((3, 8), complex)
    result = solve(Columns(force * np.array([[1], [2], [3]]), np.ones((3, 8), complex), np.zeros(8, int)), 3)
    assert result.condition > 1e12
    assert condition_number(np.ones((3, 2), complex)) == np.inf
    few = solve(Columns(np.eye(3, dtype=complex), np.eye(3, dtype=complex), np.zeros(3, int)), 3)
    assert np.isnan(few.compliance).all()
