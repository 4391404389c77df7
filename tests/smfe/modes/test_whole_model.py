"""A modal model with all that its compliance was fitted with: masses on soft mounts, poles outside the band."""

import numpy as np

from process.labels import make_compliance
from smfe.modes.fit_modes import fit_modes

F = np.arange(20.0, 120.0, 1.0)


def test_a_whole_model_gives_the_compliance_of_a_machine_on_soft_mounts() -> None:
    # 500 kg on mounts of 3 Hz, two modes of its own: the mounts lie far below the band.
    truth = np.zeros(F.size, dtype=complex)
    for frequency, damping, mass in ((3.0, 0.05, 500.0), (48.0, 0.02, 300.0), (85.0, 0.015, 200.0)):
        ratio = F / frequency
        truth += 1.0 / (mass * (2 * np.pi * frequency) ** 2 * (1.0 - ratio**2 + 2j * damping * ratio))
    rng = np.random.default_rng(0)
    std = 2e-3 * np.abs(truth)
    noisy = truth + std * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size)) / np.sqrt(2.0)
    axes = ("frequency", "response", "excitation")
    matrix, error = (np.full((F.size, 3, 3), np.nan, dtype=x.dtype) for x in (noisy, std))
    matrix[:, 0, 0], error[:, 0, 0] = noisy, std
    compliance = make_compliance(F, matrix, extra={"compliance_std": (axes, error)})
    fit = fit_modes(compliance.sel(response=["x"], excitation=["x"]))
    largest = np.abs(truth).max()
    whole = fit.modal_model(whole=True).matrix(F)[:, 0, 0]
    assert np.abs(whole - truth).max() < 0.01 * largest
    # The modes alone miss what the mounts let through.
    alone = fit.modal_model().matrix(F)[:, 0, 0]
    assert np.abs(alone - truth).max() > 0.1 * largest
    inside = fit.modal_model().frequency
    np.testing.assert_allclose(np.sort(inside[inside < 120.0]), [48.0, 85.0], rtol=2e-3)
