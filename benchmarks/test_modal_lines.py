"""Modes of a response of 64,000 lines: merged lines against scipy's AAA, which takes all of them."""

import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import AAA

from smfe.modes.fit_modes import fit_modes
from smfe.modes.response_matrix import ResponseMatrix

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from truth.modes import beam_shape, term

LINES = 64_000


def beam(level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, compliance at the end of a free beam with white noise in its accelerance, natural frequencies."""
    wave = np.array([beam_shape(k, np.zeros(1))[0] for k in range(13)])
    natural = 84.0 * (wave / wave[0]) ** 2
    f = np.linspace(0.0, 4000.0, LINES + 1)[1:]
    w2 = (2.0 * np.pi * f) ** 2
    values = -4.0 / w2 + 4.0 * sum(term(f, n, 0.003) for n in natural)
    sigma = level * np.sqrt(np.median(np.abs(w2 * values) ** 2)) / w2
    noise = np.random.default_rng(1).standard_normal((2, LINES))
    return f, values + sigma / np.sqrt(2.0) * (noise[0] + 1j * noise[1]), natural[natural < 4000.0]


@pytest.mark.benchmark(group="modal")
@pytest.mark.parametrize("level", [0.0, 0.01])
def test_modes_of_64000_lines(benchmark, level: float) -> None:  # type: ignore[no-untyped-def]
    f, values, natural = beam(level)
    matrix = ResponseMatrix(f, values[:, None, None], ("p",), ("p",))
    found = benchmark.pedantic(lambda: fit_modes(matrix).table(), rounds=1)
    own = benchmark.stats.stats.min
    start = time.perf_counter()
    # Two poles a mode, and as many again for what lies outside the band and for the noise.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # with noise it never converges
        poles = AAA(2j * np.pi * f, values, max_terms=4 * natural.size, clean_up=False).poles()
    other = time.perf_counter() - start
    near = np.abs(np.abs(poles)[:, None] / (2.0 * np.pi) / natural - 1.0).min(axis=0) < 1e-3
    assert found["frequency_Hz"].to_numpy() == pytest.approx(natural, rel=1e-3)
    benchmark.extra_info.update(aaa_seconds=round(other, 2), ratio=round(other / own, 2), aaa_modes=int(near.sum()))
    print(
        f"\nnoise {level:g}: {own:.1f} s, {len(found)} of {natural.size} modes; AAA on all lines {other:.1f} s "
        f"({other / own:.1f} times), {near.sum()} of {natural.size} modes within .1 %"
    )
