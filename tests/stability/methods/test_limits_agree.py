"""Both converged methods against each other and against the multipliers of a turn integrated in time, any pitch."""

import math
from functools import partial

import numpy as np
import pytest
from exam.limits_agree import METHODS, judged, limits
from truth.milling_draws import draw
from truth.milling_map import MillingCut, TurnMap

from process import CuttingCoefficients, ModalModel, Tool
from process.cut.engagement import engagement
from stability import floquet_multipliers, multi_frequency, semi_discretization
from stability.methods.floquet_crossings import is_unstable

ARC = engagement("down", 4e-3, 16e-3)
SETTING = ([800.0, 850.0], [0.02, 0.02], [2e7, 2e7], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MACHINE = ModalModel(*SETTING)
WORK = CuttingCoefficients(8e8, 3e8, 0.0)


def cut(degrees: tuple[float, ...]) -> tuple[Tool, object, CuttingCoefficients]:
    return Tool(16e-3, 4, pitch_angles=tuple(np.radians(degrees))), ARC, WORK


def turn(degrees: tuple[float, ...], speed: float, finer: float = 2.0) -> TurnMap:
    setting = (np.array(v) for v in SETTING)
    return TurnMap(MillingCut(*setting, np.radians(degrees), ((ARC.entry, ARC.exit),), (8e8, 3e8, 0.0)), speed, finer)


@pytest.mark.parametrize(
    ("degrees", "speed"),
    [
        ((85, 95, 85, 95), 9500),
        *(pytest.param(*v, marks=pytest.mark.slow) for v in (((80, 100, 80, 100), 9700), ((70, 85, 95, 110), 9200))),
    ],
)
def test_a_fold_of_unequal_pitch_is_the_first_loss(degrees, speed):
    """Multiplier +1: lines that were not closed under conjugation at frequency zero missed it by up to a factor two."""
    lines, steps = (method(MACHINE, *cut(degrees), [speed]) for method in (multi_frequency, semi_discretization))
    assert lines.kind.values == steps.kind.values == ["fold"]
    true = turn(degrees, speed)
    depth = float(lines.limit_depth[0]) * 1e-3
    assert depth == pytest.approx(true.limit(0.9 * depth, 1.1 * depth), rel=2e-3)
    assert float(lines.limit_depth[0]) == pytest.approx(float(steps.limit_depth[0]), rel=2e-3)
    np.testing.assert_allclose(true.multipliers(depth)[0], 1.0, atol=5e-3)
    # A motion that repeats with the pattern: its line is a whole multiple of the frequency of the pattern.
    waves = float(lines.chatter_frequency[0]) * 60.0 / speed
    assert waves == pytest.approx(round(waves), abs=1e-9)


def test_equal_pitch_has_no_fold():
    """What repeats with the teeth leaves no wave: no depth makes the multiplier +1."""
    speeds = np.linspace(4000.0, 12000.0, 9)
    assert "fold" not in multi_frequency(MACHINE, Tool(16e-3, 4), ARC, WORK, speeds).kind.values


@pytest.mark.parametrize(
    ("degrees", "speed"),
    [((85, 95, 85, 95), 10900), pytest.param((80, 100, 80, 100), 11500, marks=pytest.mark.slow)],
)
def test_harmonics_that_vanish_do_not_end_the_search(degrees, speed):
    """Of a pulse over a third of the period every third harmonic is zero: adding those changed nothing."""
    found = multi_frequency(MACHINE, *cut(degrees), [speed])
    depth = float(found.limit_depth[0]) * 1e-3
    assert depth == pytest.approx(turn(degrees, speed, 4.0).limit(0.9 * depth, 1.1 * depth), rel=2e-3)


def test_the_map_of_a_turn_is_that_of_the_semi_discretisation():
    degrees, speed, depth = (70, 85, 95, 110), 7800, 15e-3
    found = floquet_multipliers(MACHINE, *cut(degrees), depth, speed)
    np.testing.assert_allclose(np.abs(turn(degrees, speed).multipliers(depth)[0]), np.abs(found[0]), rtol=1e-3)


def test_no_limit_is_claimed_only_where_small_eigenvalues_show_none():
    """Limits at many times the smallest were overlooked by the semi-discretisation of long patterns."""
    found = limits(draw(500_082))
    assert found["multi_frequency"]["depth"] == pytest.approx(293.16, rel=1e-3)
    assert found["semi_discretization"]["depth"] == pytest.approx(293.16, rel=1e-3)


def test_nyquist_counts_what_lies_outside():
    """det(1 - a M) of M = g/(mu - p): the multiplier is p + a g."""
    angles = np.linspace(0.0, math.pi, 9)
    for p, g in ((0.9, 0.5), (-0.9, -0.5), (0.2, -3.0)):

        def signs(t: np.ndarray, depths: np.ndarray, p: float = p, g: float = g) -> np.ndarray:
            loop = 1.0 - depths * g / (np.exp(1j * t[:, None]) - p)
            return loop / np.abs(loop)

        depths = np.array([0.05, 0.19, 0.21, 0.35, 0.41, 1.0])
        outside = np.abs(p + depths * g) > 1.0
        for depth, out in zip(depths, outside, strict=True):
            assert is_unstable(lambda t, d=depth: signs(t, np.array([d])), angles) == out
        assert is_unstable(partial(signs, depths=depths), angles) == outside.any()


@pytest.mark.parametrize(
    "seed", [600_003, 600_008, *(pytest.param(n, marks=pytest.mark.slow) for n in (600_000, 600_005))]
)
def test_cuts_drawn_at_random(seed):
    drawn = draw(seed)
    found = judged(drawn, limits(drawn))
    assert found["verdict"] == "agree, confirmed", found


@pytest.mark.slow
def test_more_cuts_drawn_at_random():
    """Of 60 cuts none is a disagreement that a method does not itself admit."""
    for seed in range(600_100, 600_160):
        drawn = draw(seed)
        found = limits(drawn)
        said = judged(drawn, found)
        admitted = said["verdict"].endswith("says") or "refused" in said["verdict"] or "no limit" in said["verdict"]
        assert admitted or said["verdict"] == "agree, confirmed", (seed, said, found)


@pytest.mark.slow
def test_modes_at_the_last_harmonic_are_not_lost():
    """A first set that ended at the highest mode saw nothing of it, and what is followed from there missed a third."""
    found = limits(draw(500_589))
    assert [found[m]["depth"] for m in METHODS] == pytest.approx([0.625, 0.625], rel=1e-3)


@pytest.mark.parametrize("method", [multi_frequency, semi_discretization])
@pytest.mark.parametrize(("directions", "immersion"), [(1, 1.0), (1, 0.25), (2, 0.5)])
def test_a_limit_does_not_depend_on_the_speeds_asked_beside_it(method, directions, immersion, make_case):
    """Along speeds a limit follows its neighbour, over lobes, islands and period doubling; alone it is searched for."""
    case = make_case["benchmark"](directions, immersion)
    speeds = np.linspace(5000.0, 25000.0, 60)
    along = method(case.machine, *case.cut, speeds)["limit_depth"].values
    some = slice(1, None, 7)
    alone = [float(method(case.machine, *case.cut, [n])["limit_depth"].values[0]) for n in speeds[some]]
    np.testing.assert_allclose(along[some], alone, rtol=2e-3)


def test_limits_of_a_noisy_record_do_not_depend_on_the_speeds_asked_beside_them():
    """Noise of 2.5 % of the largest entry: each of its crossings lives for a line or two; following them lost some."""
    machine = ModalModel([400.0, 900.0], [0.03, 0.04], [4e6, 6e6], np.eye(3)[:2])
    record = machine.compliance(np.arange(20.0, 2000.0, 4.0))
    rng, size = np.random.default_rng(7), record["compliance"].shape
    noise = 0.025 * float(np.abs(record["compliance"]).max()) * rng.standard_normal((2, *size))
    record["compliance"] = record["compliance"] + noise[0] + 1j * noise[1]
    asked, speeds = cut((90, 90, 90, 90)), np.linspace(3000.0, 9000.0, 4)
    along = multi_frequency(record, *asked, speeds)["limit_depth"].values
    alone = [float(multi_frequency(record, *asked, [n])["limit_depth"].values[0]) for n in speeds]
    np.testing.assert_allclose(along, alone, rtol=1e-9)
