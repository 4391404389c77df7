"""What a page keeps of its curves is what a screen can show of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.page import decoded

from process.machine.modes import ModalModel
from smfe.reporting.figures.thinning import STEPS, coded, columns_of, largest, thinned

SPAN, COLUMNS = (0.0, 200.0), 1200
HEIGHT = 600.0
"""Points of a figure."""


def machine(frequency: np.ndarray, damping: float = 0.02) -> np.ndarray:
    """Return a compliance with two resonances and an anti-resonance [um/N]."""
    model = ModalModel([58.0, 91.0], [damping, 0.5 * damping], [4e7, 9e7], [[1.0, 0, 0], [1.0, 0.3, 0]])
    return 1e6 * model.compliance(frequency, ["x"], ["x"])["compliance"].values[:, 0, 0]


def ranges_of(values: np.ndarray) -> tuple[float, float, float]:
    parts = np.concatenate([values.real, values.imag])
    return float(np.ptp(np.log10(np.abs(values)))), float(np.ptp(parts)), 370.0


class TestSpectra:
    @given(st.integers(50, 3000), st.integers(0, 2**32 - 1))
    @settings(max_examples=30, deadline=None)
    def test_no_line_is_lost(self, count: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        frequency = np.linspace(0.0, 400.0, count)
        amplitude = rng.rayleigh(size=count)
        kept = largest(columns_of(frequency, (0.0, 100.0), 40, 20), amplitude)
        assert kept.size <= 60
        # A line of any frequency stands in the column that its picture has.
        width = np.where(frequency < 100.0, 100.0 / 40, 300.0 / 20)
        for at in range(0, count, 7):
            near = np.abs(frequency[kept] - frequency[at]) <= width[at]
            assert amplitude[kept][near].max() >= amplitude[at]

    def test_few_points_all_stay(self) -> None:
        frequency = np.arange(30.0)
        assert largest(columns_of(frequency, (0.0, 30.0), 300, 100), np.ones(30)).size == 30

    def test_what_is_unknown_is_left_out(self) -> None:
        assert largest(np.zeros(3, dtype=np.intp), np.full(3, np.nan)).size == 0


class TestCompliances:
    @pytest.mark.parametrize("damping", [0.002, 0.05])
    def test_no_view_is_off_by_more_than_half_a_line(self, damping: float) -> None:
        frequency = np.arange(0.05, 200.0, 0.05)
        values = machine(frequency, damping)
        ranges = ranges_of(values)
        kept = thinned(frequency, values, SPAN, ranges, COLUMNS)
        assert kept.size < 0.3 * frequency.size
        views = [
            (np.log10(np.abs(values)), ranges[0]),
            (values.real, ranges[1]),
            (values.imag, ranges[1]),
            (np.angle(values, deg=True), ranges[2]),
        ]
        column = columns_of(frequency, SPAN, COLUMNS, 1)
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        # A line is 1.5 points wide, a column one.
        for view, whole in views:
            drawn = np.interp(frequency, frequency[kept], view[kept])
            for end in (np.maximum, np.minimum):
                apart = end.reduceat(drawn, starts) - end.reduceat(view, starts)
                assert np.abs(apart).max() / whole * HEIGHT <= 0.75

    def test_noise_keeps_the_ends_of_each_column(self) -> None:
        rng = np.random.default_rng(1)
        frequency = np.linspace(0.1, 200.0, 20_000)
        values = machine(frequency) * (1.0 + 0.3 * rng.standard_normal(frequency.size))
        kept = thinned(frequency, values, SPAN, ranges_of(values), 300)
        assert kept.size < 0.2 * frequency.size
        column = columns_of(frequency, SPAN, 300, 300)
        for at in range(300):
            inside = column == at
            shown = np.intersect1d(kept, np.flatnonzero(inside))
            for curve in (np.abs(values), values.real, values.imag):
                assert curve[shown].max() == curve[inside].max()
                assert curve[shown].min() == curve[inside].min()

    def test_a_gap_stays_a_gap(self) -> None:
        frequency = np.arange(1.0, 200.0, 0.25)
        values = machine(frequency)
        values[(frequency > 100.0) & (frequency < 120.0)] = np.nan
        kept = thinned(frequency, values, SPAN, (4.0, 1.0, 370.0), COLUMNS)
        inside = (frequency[kept] > 100.0) & (frequency[kept] < 120.0)
        assert np.isnan(values[kept][inside]).all()
        assert 1 <= inside.sum() <= 3
        assert {100.0, 120.0} <= set(frequency[kept])

    def test_nothing_claimed(self) -> None:
        frequency = np.arange(1.0, 50.0)
        kept = thinned(frequency, np.full(49, np.nan + 0j), SPAN, (4.0, 1.0, 370.0), COLUMNS)
        assert kept.size <= 2


class TestCodes:
    @given(st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), max_size=40))
    def test_sixteen_bits_of_a_range(self, values: list[float]) -> None:
        array = np.array(values, dtype=float)
        back = decoded(coded(array))
        np.testing.assert_array_equal(np.isnan(back), np.isnan(array))
        if np.isfinite(array).any():
            step = np.ptp(array[np.isfinite(array)]) / STEPS
            assert np.nanmax(np.abs(back - array)) <= 0.51 * step + 1e-9

    @given(st.lists(st.floats(1e-8, 1e3), min_size=1, max_size=40))
    def test_nine_decades_to_a_thousandth(self, values: list[float]) -> None:
        array = np.array(values)
        shown = array > 1e-9 * array.max()
        np.testing.assert_allclose(decoded(coded(array, logarithmic=True))[shown], array[shown], rtol=5e-4)

    def test_zero_and_nothing(self) -> None:
        assert decoded(coded(np.zeros(3), logarithmic=True)).tolist() == [0.0] * 3
        assert decoded(coded(np.empty(0))).size == 0
        assert np.isnan(decoded(coded(np.full(2, np.nan), logarithmic=True))).all()
        assert decoded(coded(np.array([0.0, 1.0]), logarithmic=True)).tolist() == [1.0, 1.0]
