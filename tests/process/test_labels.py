"""Labelled arrays carry names, units and axes; what is not one is refused."""

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import (
    AXES,
    axis_present,
    check_compliance,
    check_record,
    full_matrix,
    make_compliance,
    make_record,
    restarting_rate,
    sample_interval,
)


def record(**change: object) -> xr.Dataset:
    n = 100
    arguments: dict[str, object] = {
        "time": np.arange(n) * 1e-3,
        "vectors": {"force": {"x": np.ones(n)}, "acceleration": {"x": np.ones(n), "z": np.zeros(n)}},
        "scalars": {"spindle_speed": np.full(n, 500.0)},
    }
    return make_record(**{**arguments, **change})  # type: ignore[arg-type]


def test_every_variable_of_a_record_carries_its_unit() -> None:
    r = record()
    assert {str(n): r[n].attrs["units"] for n in [*r.data_vars, "time"]} == {
        "force": "N",
        "acceleration": "m/s^2",
        "spindle_speed": "rpm",
        "time": "s",
    }


def test_an_axis_that_was_not_recorded_is_absent_not_zero() -> None:
    r = record()
    assert axis_present(r, "force") == ["x"]
    assert axis_present(r, "acceleration") == ["x", "z"]
    assert axis_present(r, "displacement") == []


def test_nan_in_a_channel_is_named_with_its_place() -> None:
    bad = np.ones(100)
    bad[40] = np.nan
    with pytest.raises(InputError, match=r"force_x has 1 values that are not finite, the first at sample 40"):
        record(vectors={"force": {"x": bad}})


def test_time_must_rise_and_be_uniform() -> None:
    t = np.arange(100) * 1e-3
    with pytest.raises(InputError, match="time does not rise at sample 51"):
        record(time=np.where(np.arange(100) == 51, 0.0, t))
    with pytest.raises(InputError, match="not uniform"):
        record(time=t + 1e-2 * (np.arange(100) > 50))
    assert sample_interval(record(time=np.round(t, 3))) == pytest.approx(1e-3)


def test_a_clock_that_begins_anew_with_each_block_says_its_rate() -> None:
    block = np.round((np.arange(400) - 20) / 25600, 6)
    with pytest.raises(InputError, match=r'sample 400: .* begins anew .* sample_rate = "25600 Hz"'):
        sample_interval(xr.Dataset(coords={"time": np.tile(block, 3)}))
    for time in (block, np.append(block, block[50:]), np.append(block[::-1], block), np.array([0.0, 1.0, 0.0])):
        assert restarting_rate(time) is None


def test_an_empty_record_is_refused() -> None:
    with pytest.raises(InputError, match="1 samples; at least 2"):
        make_record([0.0], {"force": {"x": [1.0]}})


def test_a_partial_compliance_is_legitimate_and_the_rest_counts_as_rigid() -> None:
    c = make_compliance([1.0, 2.0], np.full((2, 1, 2), 1j), ["z"], ["x", "z"])
    full = full_matrix(c)
    assert full.shape == (2, 3, 3)
    assert full[0, 2, 0] == 1j
    assert full[0, 2, 2] == 1j
    assert np.count_nonzero(full) == 4


@pytest.mark.parametrize("frequency", [[2.0, 1.0], [1.0, 1.0], [-1.0, 1.0]])
def test_frequencies_of_a_compliance_rise(frequency: list[float]) -> None:
    with pytest.raises(InputError, match="must be non-negative and rise"):
        make_compliance(frequency, np.zeros((2, 3, 3), complex))


def test_a_compliance_in_other_units_is_refused() -> None:
    c = make_compliance([1.0], np.zeros((1, 3, 3), complex), AXES, AXES)
    c["compliance"].attrs["units"] = "um/N"
    with pytest.raises(InputError, match="units 'um/N'"):
        check_compliance(c)


def test_axes_come_in_their_order_whatever_that_of_the_dataset() -> None:
    r = record(vectors={"force": {"z": np.ones(100), "x": np.ones(100)}})
    assert axis_present(r.isel(axis=slice(None, None, -1)), "force") == ["x", "z"]


def test_an_axis_that_is_not_known_is_refused_not_dropped() -> None:
    with pytest.raises(InputError, match="axis 'w' is none of x, y, z"):
        record(vectors={"force": {"x": np.ones(100), "w": np.ones(100)}})
    with pytest.raises(InputError, match="axis 'w'"):
        check_record(record().assign_coords(axis=["x", "w"]))
    with pytest.raises(InputError, match="axis 'w'"):
        axis_present(record().assign_coords(axis=["x", "w"]), "force")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vectors": {"force": {"y": np.ones(99)}}}, r"channel force_y has the shape \(99,\), the time \(100,\)"),
        ({"vectors": {"force": {"y": 1.0}}}, r"channel force_y has the shape \(\)"),
        ({"scalars": {"spindle_speed": np.ones(101)}}, r"channel spindle_speed has the shape \(101,\)"),
    ],
)
def test_every_channel_has_a_sample_for_each_time(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        record(**change)
