"""Hammer: hits made along another axis, or from another side than the sensor says, are found and left out."""

import importlib

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.labels import make_record
from smfe.identification.hammer.direction import HitSpectra, compared, wrong_directions
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.hammer.impacts import find_hits

RATE, SPACING, PULSE = 2000.0, 1.5, 5e-3
# Three coupled modes: frequency [Hz], damping, stiffness [N/m], shape along x, y, z.
MODES = (
    (41.0, 0.03, 2e6, (1.0, 0.3, 0.1)),
    (56.0, 0.03, 4e6, (-0.3, 1.0, 0.2)),
    (83.0, 0.04, 6e6, (0.1, -0.3, 1.0)),
)


def hits_along(axes: str, declared: str, noise: float = 0.02, seed: int = 0, sides: tuple[int, ...] = ()) -> xr.Dataset:
    """One record of hits along the axes of a word ("xxyx"); the force sensor calls them all `declared`.

    A side of -1 hits from the other side: with 1 in `flipped` the response sensor is turned round for that hit.
    """
    rng = np.random.default_rng(seed)
    n = round(SPACING * RATE)
    t = np.arange(n) / RATE - 0.05
    pulse = np.where((t >= 0.0) & (t <= PULSE), np.sin(np.pi * t / PULSE), 0.0)
    sides = sides or (1,) * len(axes)
    force, motion = [], []
    for axis, side in zip(axes, sides, strict=True):
        level = 100.0 * rng.uniform(0.8, 1.2)
        own = np.zeros((3, n))
        for f, zeta, k, shape in MODES:
            w = 2.0 * np.pi * f
            system = [w**2 / k], [1.0, 2.0 * zeta * w, w**2]
            b, a, _ = signal.cont2discrete(system, 1.0 / RATE, method="foh")
            q = signal.lfilter(b.ravel(), a, level * side * shape["xyz".index(axis)] * pulse)
            own += np.outer(shape, q)
        force.append(level * side * pulse)
        motion.append(own)
    x = np.concatenate(motion, axis=1)
    x += noise * x.std() * rng.standard_normal(x.shape)
    channels = {"force": {declared: np.concatenate(force)}, "displacement": dict(zip("xyz", x, strict=True))}
    return make_record(np.arange(x.shape[1]) / RATE, channels)


def turned(record: xr.Dataset, hit: int) -> xr.Dataset:
    """The response of one hit with the wrong sign."""
    out = record.copy(deep=True)
    n = round(SPACING * RATE)
    out["displacement"].values[:, hit * n : (hit + 1) * n] *= -1.0
    return out


def test_a_hit_along_another_axis_is_named() -> None:
    records = {"x": [hits_along("xxyx", "x")], "y": [hits_along("yyy", "y", seed=1)]}
    found = identify_hammer("mixed", records)
    table = found.tables["hits"]
    assert table["used"].tolist() == [True, True, False, True, True, True, True]
    assert table["wrong_direction"].tolist() == [False, False, True, False, False, False, False]
    assert "its response is that of a hit along y (gain 1)" in table["reason"][2]
    assert any("hit 3 is not used: wrong direction" in w for w in found.warnings)


def test_a_hit_along_an_axis_that_was_not_measured_is_found_too() -> None:
    table = identify_hammer("mixed", {"x": [hits_along("xzxx", "x")]}).tables["hits"]
    assert table["used"].tolist() == [True, False, True, True]
    assert "not that of the other hits along x" in table["reason"][1]


def test_the_wrong_hit_would_have_spoilt_the_average() -> None:
    good = identify_hammer("good", {"x": [hits_along("xxx", "x")]}, frequency_range=(30.0, 100.0)).compliance
    for exclude, limit in ((("direction",), 0.02), ((), 0.1)):
        mixed = identify_hammer("m", {"x": [hits_along("xxyx", "x")]}, frequency_range=(30.0, 100.0), exclude=exclude)
        change = np.abs(mixed.compliance["compliance"].values - good["compliance"].values).max()
        share = change / np.abs(good["compliance"].values).max()
        assert (share < limit) == bool(exclude)


def test_a_response_of_the_wrong_sign_is_found() -> None:
    table = identify_hammer("sign", {"x": [turned(hits_along("xxxx", "x"), 2)]}).tables["hits"]
    assert table["used"].tolist() == [True, True, False, True]
    assert "turned round (gain -1)" in table["reason"][2]


def test_a_hit_from_the_other_side_is_a_good_hit() -> None:
    """Its force and its response both have the other sign: the compliance does not."""
    record = hits_along("xxxx", "x", sides=(1, 1, -1, 1))
    table = identify_hammer("side", {"x": [record]}).tables["hits"]
    assert table["used"].all()
    assert np.sign(table["peak_force_N"]).tolist() == [1.0, 1.0, -1.0, 1.0]


def test_a_rebound_of_the_force_is_no_hit() -> None:
    record = hits_along("xxx", "x")
    force = record["force"].values
    force[0] -= 0.3 * np.roll(force[0], round(0.01 * RATE))
    hits = find_hits(record, "x")
    assert len(hits) == 3
    assert all(hit.peak_force > 0.0 and not hit.double for hit in hits)


@pytest.mark.parametrize("noise", [1.0, 5.0])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_noise_makes_no_hit_a_wrong_direction(noise: float, seed: int) -> None:
    table = identify_hammer("noisy", {"x": [hits_along("xxxxx", "x", noise=noise, seed=seed)]}).tables["hits"]
    assert not table["wrong_direction"].any()


def test_two_hits_cannot_outvote_each_other() -> None:
    found = identify_hammer("two", {"x": [turned(hits_along("xx", "x"), 1)]})
    assert found.tables["hits"]["used"].all()
    assert any("a ratio of -1" in w and "two do not decide which; add a third" in w for w in found.warnings)


def test_levels_of_a_machine_with_friction_are_not_compared() -> None:
    """A weak hit that finds a compliance three times as large is physics, not a wrong direction."""
    record = hits_along("xxxx", "x")
    n = round(SPACING * RATE)
    record["force"].values[:, n : 2 * n] *= 0.1
    record["displacement"].values[:, n : 2 * n] *= 0.3
    assert identify_hammer("levels", {"x": [record]}).tables["hits"]["used"].all()


@pytest.mark.parametrize(("apart", "wrong"), [(0.9, []), (0.4, [2])])
def test_a_hit_is_not_outvoted_by_hits_that_differ_as_much(apart: float, wrong: list[int]) -> None:
    """Of a guideway that sticks each hit finds another state: shapes of three hits, two of them as far apart as given.

    The modal assurance criterion of vectors an angle apart is the square of its cosine.
    """

    def at(angle: float) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle)], dtype=complex)

    hits = find_hits(hits_along("xxx", "x", noise=0.0), "x")
    w = 2.0 * np.pi * np.array([10.0, 20.0])
    shapes = np.stack([at(0.0), at(0.65 * apart), at(1.35)], axis=1) / w[:, None]
    faults, _ = wrong_directions({"x": HitSpectra(hits, w / (2.0 * np.pi), shapes[:, None, :], np.ones((2, 3)) + 0j)})
    assert [m for _, m in faults] == wrong


def test_shapes_are_compared_without_regard_to_size() -> None:
    a = np.array([1.0, 2.0j, -1.0])
    assert compared(a, a) == (pytest.approx(1.0), pytest.approx(1.0))
    shape, gain = compared(-0.5 * a, a)
    assert (shape, gain) == (pytest.approx(1.0), pytest.approx(-0.5))
    assert compared(np.array([1.0, 0.0]), np.array([0.0, 1.0]))[0] == 0.0
    assert compared(np.array([np.nan, np.nan]), np.array([1.0, 1.0]))[0] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("feed", [0.0, 100.0])
@pytest.mark.parametrize("kind", ["lugre", "stick", "gms"])
def test_friction_makes_no_hit_a_wrong_direction(kind: str, feed: float) -> None:
    """Five hits by hand on the bench with sliding friction in the guideway, 25 to 1000 N: none is a wrong direction."""
    axis, chain = (importlib.import_module(f"truth.{name}") for name in ("axis", "chain"))
    rng = np.random.default_rng(round(feed))
    truth = axis.Truth(friction=axis.Friction(kind=kind))
    for level in (25.0, 100.0, 400.0, 1000.0):
        records = []
        for _ in range(5):
            hit = chain.hit(rng, level, 0.0)
            hit[:, 0] += 0.1
            setting = axis.Setting(feed * axis.MM_MIN, "K2", arrival=float(rng.uniform(-0.3, 0.3)))
            raw = axis.simulate(truth, setting, hit, np.zeros((0, 5)), 2.0)[:, ::4]
            force = raw[3] + 0.02 * rng.standard_normal(raw.shape[1])
            motion = raw[0] + 1e-3 * rng.standard_normal(raw.shape[1])
            t = np.arange(raw.shape[1]) * 4.0 / axis.RATE
            records.append(make_record(t, {"force": {"x": force}, "acceleration": {"x": motion}}))
        found = identify_hammer("bench", {"x": records}, frequency_range=(10.0, 150.0))
        assert not found.tables["hits"]["wrong_direction"].any()
