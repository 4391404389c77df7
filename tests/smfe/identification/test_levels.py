"""Force levels and feeds as dimensions of a compliance."""

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance, make_record
from smfe.identification.errors.intervals import interval
from smfe.identification.levels import force_levels, hammer_levels, stack_conditions

RATE = 2000.0


def duffing(levels: list[float]) -> xr.Dataset:
    """Hits on a hardening spring, integrated by Runge-Kutta on a fine grid: stiffer at each higher level."""
    mass, stiffness, damping, cubic = 10.0, 1.5e6, 500.0, 4e13
    fine, spacing = 8, 1.5
    dt = 1.0 / (RATE * fine)
    n = round(len(levels) * spacing * RATE) * fine
    t = np.arange(2 * n + 1) * 0.5 * dt
    force = np.zeros(t.size)
    for k, level in enumerate(levels):
        u = (t - (k + 0.1) * spacing) / 4e-3
        force += np.where((u > 0.0) & (u < 1.0), level * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
    x = v = 0.0
    out = np.empty(n)

    def acceleration(x: float, v: float, f: float) -> float:
        return (f - damping * v - stiffness * x - cubic * x**3) / mass

    for i in range(n):
        out[i] = x
        f0, f1, f2 = force[2 * i : 2 * i + 3]
        a1, b1 = v, acceleration(x, v, f0)
        a2, b2 = v + 0.5 * dt * b1, acceleration(x + 0.5 * dt * a1, v + 0.5 * dt * b1, f1)
        a3, b3 = v + 0.5 * dt * b2, acceleration(x + 0.5 * dt * a2, v + 0.5 * dt * b2, f1)
        a4, b4 = v + dt * b3, acceleration(x + dt * a3, v + dt * b3, f2)
        x += dt / 6.0 * (a1 + 2 * a2 + 2 * a3 + a4)
        v += dt / 6.0 * (b1 + 2 * b2 + 2 * b3 + b4)
    motion = out[::fine] + 1e-8 * np.random.default_rng(1).standard_normal(n // fine)
    force = force[: 2 * n : 2 * fine]
    return make_record(np.arange(motion.size) / RATE, {"force": {"x": force}, "displacement": {"x": motion}})


@pytest.fixture(scope="module")
def study() -> xr.Dataset:
    return duffing([50.0, 800.0, 52.0, 780.0, 48.0, 820.0])


@pytest.mark.slow
def test_levels_in_one_record_become_a_dimension(study: xr.Dataset) -> None:
    found = hammer_levels("levels", {"x": [study]}, frequency_range=(30.0, 120.0))
    compliance = found.compliance["compliance"]
    assert compliance.dims == ("force_level", "frequency", "response", "excitation")
    assert compliance["force_level"].values == pytest.approx([50.0, 800.0], rel=0.01)
    weak, strong = np.abs(compliance.values[:, :, 0, 0])
    f = compliance["frequency"].values
    assert f[np.argmax(weak)] == pytest.approx(np.sqrt(1.5e6 / 10.0) / 2.0 / np.pi, abs=1.0)
    assert f[np.argmax(strong)] > f[np.argmax(weak)] + 1.0
    assert found.tables["levels"]["hits"].tolist() == [3, 3]
    assert found.tables["hits"]["level_N"].tolist() == pytest.approx([50.0, 800.0] * 3, rel=0.01)
    assert np.isfinite(interval(found.compliance)["upper"]).all()


def test_levels_are_told_by_their_gaps() -> None:
    assert force_levels([50.0, -55.0, 48.0, 1000.0, 900.0]) == [(48.0, 55.0), (900.0, 1000.0)]
    assert force_levels([10.0, 15.0, 22.0, 30.0]) == [(10.0, 30.0)]
    assert force_levels([10.0]) == [(10.0, 10.0)]


def one(value: complex, frequency: list[float], axes: str = "x") -> xr.Dataset:
    values = np.full((len(frequency), len(axes), len(axes)), value, dtype=complex)
    std = {"compliance_std": (("frequency", "response", "excitation"), np.full(values.shape, 0.1))}
    return make_compliance(frequency, values, list(axes), list(axes), std)


def test_levels_and_feeds_make_a_cube() -> None:
    parts = [
        ({"force_level": level, "feed": feed}, one(level + 1j * feed, [10.0, 20.0]))
        for level, feed in ((150.0, 0.0), (50.0, 500.0), (50.0, 0.0))
    ]
    cube = stack_conditions(parts)
    assert cube["compliance"].dims == ("force_level", "feed", "frequency", "response", "excitation")
    assert cube["force_level"].values.tolist() == [50.0, 150.0]
    assert cube["compliance"].sel(force_level=50.0, feed=500.0).values == pytest.approx(50.0 + 500.0j)
    assert cube["compliance"].sel(force_level=150.0, feed=0.0).values == pytest.approx(150.0)
    assert np.isnan(cube["compliance"].sel(force_level=150.0, feed=500.0)).all()
    assert (cube["feed"].attrs["units"], cube["force_level"].attrs["units"]) == ("mm/min", "N")
    assert cube["compliance_std"].attrs["units"] == "m/N"


def test_the_order_of_what_is_stacked_does_not_matter() -> None:
    parts = [({"force_level": level}, one(level, [10.0, 20.0], axes)) for level, axes in ((5.0, "x"), (1.0, "zx"))]
    xr.testing.assert_identical(stack_conditions(parts), stack_conditions(parts[::-1]))


def test_steps_that_are_nearly_at_the_same_frequency_are_one_line() -> None:
    parts = [({"force_level": 1.0}, one(1.0, [10.0, 20.0])), ({"force_level": 2.0}, one(2.0, [10.001, 25.0]))]
    cube = stack_conditions(parts)
    assert cube["frequency"].values == pytest.approx([10.0005, 20.0, 25.0])
    assert np.isnan(cube["compliance"].values[0, 2]).all()
    assert np.isnan(cube["compliance"].values[1, 1]).all()


def test_what_cannot_be_stacked() -> None:
    with pytest.raises(InputError, match="no compliances to stack"):
        stack_conditions([])
    with pytest.raises(InputError, match="have different conditions"):
        stack_conditions([({"feed": 1.0}, one(1.0, [10.0])), ({"force_level": 1.0}, one(1.0, [10.0]))])
    with pytest.raises(InputError, match=r"have the same conditions \(feed 1\); average or leave out one"):
        stack_conditions([({"feed": 1.0}, one(1.0, [10.0])), ({"feed": 1.0}, one(1.0, [10.0]))])
