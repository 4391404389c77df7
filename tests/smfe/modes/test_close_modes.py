"""Narrow and close modes of fine records: found by default, separated by their shapes, or named.

Data come from `truth.modes`, sums of second-order terms that share no code with the fit.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from truth.modes import beam_shape, term

from smfe.commands.modal import _as_json, as_toml
from smfe.modes.fit_modes import fit_modes
from smfe.modes.likelihood_ratio import Window
from smfe.modes.merged_lines import merged
from smfe.modes.pole_fit import Remainders, refine, solve
from smfe.modes.response_matrix import ResponseMatrix, curves_of, running_mean
from smfe.modes.rules import RULES


def responses(f, modes, shapes, rigid=0.0, level=0.0, seed=0, stated=True) -> ResponseMatrix:
    """Accelerance of the first place's force with white noise, as compliance; `level` of its middle size."""
    values = -rigid / (2.0 * np.pi * f[:, None]) ** 2 + 0.0j
    for (natural, damping), shape in zip(modes, shapes, strict=True):
        values = values + term(f, natural, damping)[:, None] * (shape * shape[0])
    w2 = (2.0 * np.pi * f[:, None]) ** 2
    sigma = level * np.sqrt(np.median(np.abs(w2 * values) ** 2)) / w2 * np.ones(values.shape)
    noise = np.random.default_rng(seed).standard_normal((2, *values.shape))
    values = values + sigma / np.sqrt(2.0) * (noise[0] + 1j * noise[1])
    names = tuple(f"p{k}" for k in range(values.shape[1]))
    std = sigma[:, :, None] if level and stated else None
    return ResponseMatrix(f, values[:, :, None], names, names[:1], std)


def free_beam(f) -> tuple[ResponseMatrix, np.ndarray]:
    """The end of a free beam of 1 kg that is hit there: nine bending modes below 4 kHz, damping .3 %, rigid motion.

    Half-power widths of .5 to 20 Hz on lines 5 Hz apart.
    """
    wave = np.array([beam_shape(k, np.zeros(1))[0] for k in range(13)])
    natural = 84.0 * (wave / wave[0]) ** 2
    modes = np.stack([natural, np.full(13, 0.003)], axis=1)
    return responses(f, modes, np.full((13, 1), 2.0), rigid=4.0), natural[natural < 4000.0]


def test_all_nine_modes_of_a_clean_free_beam_are_found_by_default() -> None:
    f = np.arange(5.0, 4000.0, 5.0)
    matrix, natural = free_beam(f)
    fit = fit_modes(matrix)
    table = fit.table()
    assert natural.size == 9
    assert table["frequency_Hz"].to_numpy() == pytest.approx(natural, rel=1e-3)
    assert table["damping"].to_numpy() == pytest.approx(0.003, rel=0.1)
    assert not fit.unexplained


PAIR = np.array([[640.0, 0.004], [922.0, 0.002], [923.0, 0.002], [1300.0, 0.004]])
FINE = np.arange(500.0, 1500.0, 1.0)


@pytest.mark.slow
def test_two_modes_a_thousandth_apart_are_separated_by_their_shapes() -> None:
    """922 and 923 Hz, half-power width 3.7 Hz, lines 1 Hz apart, four responses to one force, .1 % noise."""
    shapes = np.array([[1.0, 0.8, -0.4, 0.2], [1.0, 0.5, 0.7, -0.6], [0.8, -0.6, 0.3, 0.9], [1.0, -1.0, 0.5, 0.1]])
    table = fit_modes(responses(FINE, PAIR, shapes, level=1e-3, seed=1)).table()
    assert len(table) == 4
    away = (table["frequency_Hz"] - PAIR[:, 0]) / table["frequency_std_Hz"]
    assert np.abs(away).max() < 4.0
    assert table["frequency_std_Hz"].max() < 0.1


@pytest.mark.parametrize("half", [20.0, 60.0, 200.0])
def test_no_pole_below_the_first_line_has_a_negative_frequency(half: float) -> None:
    """Half of a window about 15 Hz lies below zero: what rises towards the lowest lines is no mode of -147 Hz."""
    f = np.arange(5.0, 400.0, 1.0)
    matrix = responses(f, np.array([[60.0, 0.02]]), np.ones((1, 1)), rigid=3.0, level=0.02, seed=1)
    where = Window(curves_of(matrix), (0,), 15.0, half)
    for start in ([[60.0, 0.02], [6.0, 0.7]], [[60.0, 0.02], [12.0, 0.3]]):
        assert where.fit(start).poles[:, 0].min() >= 5.0 / RULES.beyond


INSEPARABLE = np.where(np.arange(4)[:, None] == 2, [922.05, 0.002], PAIR)


def test_two_modes_that_one_response_cannot_separate_are_nearer_than_the_stated_resolution() -> None:
    """.05 Hz apart and of one shape at 3 % noise: one mode, whose resolution says that it may hold two so near."""
    table = fit_modes(responses(FINE, INSEPARABLE, np.ones((4, 1)), level=0.03, seed=2)).table()
    assert len(table) == 3
    assert table["resolution_Hz"][1] > 0.05


@pytest.mark.slow
def test_the_resolution_is_finer_with_the_root_of_the_noise() -> None:
    """Ten times less noise, and two modes are separated at a distance smaller by the fourth root of a hundred."""
    table, finer = (
        fit_modes(responses(FINE, INSEPARABLE, np.ones((4, 1)), level=level, seed=2)).table() for level in (0.03, 0.003)
    )
    assert finer["resolution_Hz"][1] == pytest.approx(table["resolution_Hz"][1] / np.sqrt(10.0), rel=0.25)


def test_a_peak_without_a_mode_is_named_in_every_output(tmp_path: Path) -> None:
    """The mode at 640 Hz is not among those that are asked for."""
    matrix = responses(FINE, PAIR[[0, 1, 3]], np.ones((3, 1)), level=1e-3, seed=3)
    fit = fit_modes(matrix, poles=PAIR[[1, 3]])
    assert [round(f) for f in fit.unexplained] == [640]
    assert any("peaks at 640 Hz stand out" in w for w in fit.warnings)
    assert "640 Hz stand out" in as_toml("beam", fit)
    assert json.loads(json.dumps(_as_json(fit)))["unexplained_Hz"] == [640.0]


def test_entries_that_are_zero_do_no_harm() -> None:
    """A rigid direction: the response of the second place is zero on every line, and no noise is stated."""
    shapes = np.stack([np.ones(3), np.zeros(3)], axis=1)
    table = fit_modes(responses(FINE, PAIR[[0, 1, 3]], shapes)).table()
    assert table["frequency_Hz"].to_numpy() == pytest.approx(PAIR[[0, 1, 3], 0], rel=1e-4)


@pytest.mark.slow
def test_a_clean_fit_leaves_nothing_unexplained() -> None:
    fit = fit_modes(responses(FINE, PAIR[[0, 1, 3]], np.ones((3, 1)), level=1e-2, seed=3))
    assert len(fit.table()) == 3
    assert not fit.unexplained
    assert not np.isfinite(fit.perhaps_two).any()


def test_merging_lines_moves_no_pole() -> None:
    """64,000 lines merged into some hundreds: each pole within half its standard deviation."""
    f = np.linspace(500.0, 1500.0, 64_000)
    shapes = np.ones((3, 1))
    curves = curves_of(responses(f, PAIR[[0, 1, 3]], shapes, level=0.1, seed=4))
    fewer = merged(curves)
    assert fewer.frequency.size < 3000
    start = solve(fewer, PAIR[[0, 1, 3]], Remainders())
    short, whole = refine(start, 6), refine(solve(curves, PAIR[[0, 1, 3]], Remainders()), 3)
    assert np.abs((short.poles - whole.poles) / whole.pole_std).max() < 0.5
    np.testing.assert_allclose(short.pole_std, whole.pole_std, rtol=0.05)


def test_few_lines_and_lines_that_share_errors_are_not_merged() -> None:
    curves = curves_of(responses(np.linspace(500.0, 1500.0, 900), PAIR[:1], np.ones((1, 1)), level=0.1))
    assert merged(curves) is curves
    many = curves_of(responses(np.linspace(500.0, 1500.0, 9000), PAIR[:1], np.ones((1, 1)), level=0.1))
    assert merged(many).frequency.size < 2000
    together = replace(many, error_lines=3.0)
    assert merged(together) is together


def test_noise_levels_of_a_free_part_are_kept_over_ten_decades() -> None:
    """The mean over neighbours of 1e20 ... 1 keeps its smallest values; a sum carried along does not."""
    steep = np.geomspace(1e20, 1.0, 4000)
    np.testing.assert_allclose(running_mean(steep, 9)[10:-10], steep[10:-10], rtol=1e-3)
