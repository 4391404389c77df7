"""The chi-square of a difference: exact for circular errors of a known covariance."""

import numpy as np
import pytest
from scipy import stats

from smfe.identification.errors.difference import chi_square, compare


def test_the_p_value_of_correlated_circular_errors_is_uniform() -> None:
    """Errors with a complex covariance (each entry leads the next by 90 degrees): d = R w, C = R R^H."""
    rng = np.random.default_rng(11)
    root = np.array([[1.0, 0.0, 0.0], [0.9j, 0.5, 0.0], [-0.7, 0.6j, 0.2]])
    covariance = np.broadcast_to(root @ root.conj().T, (30, 3, 3)) * np.linspace(0.1, 3.0, 30)[:, None, None] ** 2
    frequency, size = np.arange(1.0, 31.0), np.ones((30, 3))
    p, means = [], []
    for _ in range(400):
        w = (rng.standard_normal((30, 3)) + 1j * rng.standard_normal((30, 3))) / np.sqrt(2.0)
        d = np.linspace(0.1, 3.0, 30)[:, None] * (w @ root.T)
        means.append(chi_square(d, covariance)[0].mean())
        p.append(compare(frequency, d, covariance, size).p_value)
    assert np.mean(means) == pytest.approx(6.0, rel=0.02)
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_rows_that_share_errors_have_fewer_degrees_of_freedom() -> None:
    """Two rows of two entries: independent rows have 8; rows with one and the same error have half of that."""
    apart = np.broadcast_to(np.eye(4, dtype=complex), (5, 4, 4))
    same = np.broadcast_to(np.kron(np.ones((2, 2)), np.eye(2)).astype(complex), (5, 4, 4))
    d = np.ones((5, 4), dtype=complex)
    assert chi_square(d, apart, rows=2)[1] == pytest.approx(8.0)
    assert chi_square(d, same, rows=2)[1] == pytest.approx(4.0)
    np.testing.assert_allclose(chi_square(d, same, rows=2)[0], 8.0)


def test_a_difference_has_its_size_beyond_noise_and_its_place() -> None:
    frequency = np.arange(1.0, 11.0)
    difference = np.full((10, 1), 0.5 + 0.0j)
    difference[6] = 2.0
    covariance = np.full((10, 1, 1), 0.01 + 0.0j)
    found = compare(frequency, difference, covariance, np.full((10, 1), 2.0))
    beyond = 9 * 0.25 + 4.0 - 10 * 0.01
    assert found.size == pytest.approx(np.sqrt(beyond / 40.0))
    assert (found.worst, found.lines) == (7.0, 10)
    assert found.p_value < 1e-20
