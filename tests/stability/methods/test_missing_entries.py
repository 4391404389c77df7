"""What was not measured is rigid, in every method, with one warning: two taps, xx and yy, give limits."""

import math
from functools import partial

import numpy as np
import pytest
import xarray as xr

from process import CuttingCoefficients, InputError, ModalModel, Tool, engagement
from process.labels import full_matrix, make_compliance
from smfe.modes.fit_modes import fit_modes
from stability import (
    critical_depth,
    linearised_band,
    lobe_curves,
    multi_frequency,
    operating_point,
    sampled_band,
    semi_discretization,
    zero_order,
)

MACHINE = ModalModel([410.0, 520.0], [0.03, 0.025], [1.2e7, 1.5e7], [[1, 0, 0], [0, 1, 0]])
CUT = (Tool(16e-3, 3), engagement("down", 6e-3, 16e-3), CuttingCoefficients(7e8, 2.5e8, 0.0))
FREQUENCY = np.arange(20.0, 3000.0, 2.0)
SPEEDS = [4200.0, 6100.0, 8300.0]
PARTIAL = "partial matrix (no response z; no excitation z; no xy, yx)"


def two_taps(axes: str = "xy", std: float = 0.0, cut_off: float = math.inf) -> xr.Dataset:
    """Direct entries as measured; every other one NaN, as a tap without that sensor leaves it."""
    exact = MACHINE.matrix(FREQUENCY)
    held = np.full((FREQUENCY.size, len(axes), len(axes)), np.nan, dtype=complex)
    for i, axis in enumerate(axes):
        held[:, i, i] = exact[:, "xyz".index(axis), "xyz".index(axis)]
    held[cut_off <= FREQUENCY] = np.nan
    extra = {}
    if std:
        scatter = np.where(np.isnan(held), np.nan, std * np.abs(exact[:, 0, 0])[:, None, None])
        rows = np.where(np.eye(len(axes), dtype=bool), scatter[..., None] ** 2, 0.0)
        extra["compliance_std"] = (("frequency", "response", "excitation"), scatter.real)
        extra["compliance_covariance"] = (
            ("frequency", "response", "excitation", "other_excitation"),
            np.where(np.isnan(scatter)[..., None] | np.isnan(scatter)[..., None, :], np.nan, rows).astype(complex),
        )
    return make_compliance(FREQUENCY, held, tuple(axes), tuple(axes), extra)


def complete(source: xr.Dataset) -> xr.Dataset:
    """The same with zeros: a machine whose axes are known to be uncoupled."""
    return source.map(lambda v: v.fillna(0.0).assign_attrs(v.attrs), keep_attrs=True)


def one_warning(found: xr.Dataset, expected: str = PARTIAL) -> bool:
    return sum("partial matrix" in w for w in found.attrs["warnings"]) == 1 and any(
        expected in w for w in found.attrs["warnings"]
    )


@pytest.mark.parametrize("method", [zero_order, multi_frequency])
def test_a_missing_cross_term_is_rigid(method):
    found = method(two_taps(), *CUT, SPEEDS)
    np.testing.assert_array_equal(found.limit_depth, method(complete(two_taps()), *CUT, SPEEDS).limit_depth)
    modal = method(MACHINE, *CUT, SPEEDS)
    np.testing.assert_allclose(found.limit_depth, modal.limit_depth, rtol=5e-3)
    assert one_warning(found)


def test_modes_are_fitted_to_what_was_measured():
    found = fit_modes(two_taps()).modal_model()
    np.testing.assert_allclose(np.sort(found.frequency), [410.0, 520.0], rtol=1e-4)
    fitted = semi_discretization(found, *CUT, SPEEDS)
    np.testing.assert_allclose(fitted.limit_depth, semi_discretization(MACHINE, *CUT, SPEEDS).limit_depth, rtol=2e-3)


def test_modes_are_fitted_where_the_errors_were_measured_too():
    found = fit_modes(two_taps(std=0.02))
    np.testing.assert_allclose(np.sort(found.modal_model().frequency), [410.0, 520.0], rtol=1e-3)
    assert np.isfinite(found.table()["frequency_Hz"]).all()


def test_curves_and_the_smallest_limit():
    taps = two_taps()
    smallest = critical_depth(taps, *CUT)
    assert smallest.limit_depth_mm == critical_depth(complete(taps), *CUT).limit_depth_mm
    assert any(PARTIAL in w for w in smallest.warnings)
    assert len(lobe_curves(taps, *CUT, (4000.0, 9000.0))) > 0


@pytest.mark.parametrize("band", [partial(sampled_band, count=40), linearised_band], ids=["sampled", "linearised"])
def test_the_band_is_that_of_the_entries_measured(band):
    found, exact = (band(c, *CUT, SPEEDS) for c in (two_taps(std=0.05), complete(two_taps(std=0.05))))
    np.testing.assert_array_equal(found.limit_depth_quantile, exact.limit_depth_quantile)
    assert (found.limit_depth_quantile[0] < found.limit_depth).all()
    assert one_warning(found)


def test_an_operating_point_of_two_taps():
    idle, moving = two_taps(), two_taps()
    moving["compliance"] = moving["compliance"] * 0.6
    moving["compliance"].attrs["units"] = "m/N"
    together = xr.concat([idle, moving], xr.DataArray([0.0, 9000.0], dims="feed", name="feed"))
    found = operating_point(together, *CUT, SPEEDS, 1e-4)
    exact = operating_point(complete(together), *CUT, SPEEDS, 1e-4)
    np.testing.assert_array_equal(found.limit_depth, exact.limit_depth)
    assert one_warning(found)
    # One condition knows the cross terms, the other does not.
    feeds = xr.DataArray([0.0, 9000.0], dims="feed", name="feed")
    mixed = xr.concat([MACHINE.compliance(FREQUENCY), moving], feeds, join="outer")
    np.testing.assert_allclose(operating_point(mixed, *CUT, SPEEDS, 1e-4).limit_depth, exact.limit_depth, rtol=1e-12)
    assert one_warning(operating_point(mixed, *CUT, SPEEDS, 1e-4))


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ("x", "(no response y, z; no excitation y, z)"),
        ("xyz", "(no xy, xz, yx, yz, zx, zy)"),
    ],
)
def test_the_warning_names_what_is_missing(axes, expected):
    assert one_warning(zero_order(two_taps(axes), *CUT, SPEEDS), expected)


def test_a_row_that_holds_nothing_is_as_good_as_absent():
    taps = two_taps("xyz")
    taps["compliance"].loc[{"response": "z"}] = np.nan
    assert one_warning(zero_order(taps, *CUT, SPEEDS), PARTIAL)


def test_lines_that_some_entries_lack_are_left_out_not_filled():
    taps = two_taps()
    taps["compliance"].loc[{"response": "y", "excitation": "y", "frequency": slice(700.0, None)}] = np.nan
    assert np.isnan(full_matrix(taps)[-1, 1, 1])
    assert full_matrix(taps)[0, 0, 1] == 0.0
    found = zero_order(taps, *CUT, SPEEDS)
    assert found.attrs["frequency_high_Hz"] == 698.0


def test_what_holds_nothing_is_refused():
    with pytest.raises(InputError, match="holds no number at any frequency"):
        zero_order(two_taps(cut_off=0.0), *CUT, SPEEDS)
    apart = two_taps()
    apart["compliance"].loc[{"response": "x", "frequency": slice(None, 500.0)}] = np.nan
    apart["compliance"].loc[{"response": "y", "frequency": slice(500.0, None)}] = np.nan
    with pytest.raises(InputError, match="know no frequencies in common"):
        multi_frequency(apart, *CUT, SPEEDS)
