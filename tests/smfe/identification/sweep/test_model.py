"""When the rational model of a sweep gives way to a band: not because of noise, and where the bands contradict it."""

import numpy as np
from scipy import ndimage

from process.types import Complex
from smfe.identification.sweep.least_squares import Estimate
from smfe.identification.sweep.local_polynomial import LocalPolynomial, lack_of_fit

LINES, WIDTH = 161, 2.0
ESTIMATOR = LocalPolynomial()


def estimate(compliance: Complex, std: float) -> Estimate:
    covariance = np.broadcast_to(std**2 * np.eye(3), (LINES, 3, 3, 3)).astype(complex)
    width = np.full((LINES, 3), WIDTH)
    return Estimate(compliance, covariance, np.ones((LINES, 3)), np.ones(LINES), 1.0, width)


def errors(rng: np.random.Generator) -> Complex:
    """Errors of bands of unit variance: white noise through the kernel of a parabola, alike within a row."""
    x = np.arange(-8, 9) / 8.0
    kernel = 9.0 - 15.0 * x**2
    white = rng.standard_normal((2, LINES + 16, 3, 1))
    smooth = ndimage.convolve1d(white[0] + 1j * white[1], kernel / np.linalg.norm(kernel) / np.sqrt(2.0), axis=0)
    return np.repeat(smooth[8:-8], 3, axis=2)


def test_noise_of_the_bands_does_not_contradict_a_model_that_is_right() -> None:
    rng, count = np.random.default_rng(3), 300
    model = estimate(np.zeros((LINES, 3, 3), complex), 0.5)
    charged, lost = 0, 0
    for _ in range(count):
        lack, contradicted = lack_of_fit(model, estimate(errors(rng), 1.0), ESTIMATOR)
        variance = 0.25 + np.diagonal(lack, axis1=2, axis2=3).real.mean(axis=2)
        charged += bool((variance >= 1.0).any())
        lost += bool(contradicted.any())
    # In every third sweep the charge alone would have given the model up somewhere.
    assert charged > count / 4
    assert lost <= 0.03 * count


def test_a_model_that_is_wrong_over_some_hertz_is_contradicted() -> None:
    rng = np.random.default_rng(4)
    wrong = np.zeros((LINES, 3, 3), complex)
    wrong[60:100, 1] = 3.0
    hits = [lack_of_fit(estimate(wrong, 0.5), estimate(errors(rng), 1.0), ESTIMATOR)[1] for _ in range(20)]
    assert np.mean([h[70:90, 1].all() for h in hits]) > 0.9
    assert np.mean([h[:, [0, 2]].any() for h in hits]) < 0.1
