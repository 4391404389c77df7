"""A helix: the edges reach over the depth, and the directional matrix is no longer proportional to it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from truth.milling_draws import draw
from truth.milling_map import MillingCut, TurnMap

from process import CuttingCoefficients, ModalModel, ProcessDamping, Tool
from process.cut.engagement import Engagement, engagement
from process.cut.force import gram_matrix, twisted_gram
from stability import (
    floquet_multipliers,
    limit_depth,
    multi_frequency,
    semi_discretization,
    stability_bands,
    zero_order,
)

WORK = CuttingCoefficients(6e8, 2e8, 0.0)
MACHINE = ModalModel([922.0], [0.011], [0.03993 * (2 * math.pi * 922.0) ** 2], [[1.0, 0.0, 0.0]])
NARROW = engagement("down", 0.1e-3, 2e-3)
HELICAL = Tool(2e-3, 2, helix_angle=math.radians(45.0))
PITCH = math.pi * 1e-3  # depth over which this tool's edges run behind by half a turn


def turn(tool: Tool, arc: Engagement, speed: float, reach: float, finer: float = 1.0) -> TurnMap:
    setting = (MACHINE.frequency, MACHINE.damping, MACHINE.stiffness, MACHINE.direction)
    pitch, twist = np.full(2, math.pi), 2.0 * math.tan(tool.helix_angle) / tool.diameter
    cut = MillingCut(*setting, pitch, ((arc.entry, arc.exit),), (6e8, 2e8, 0.0), twist=twist)
    return TurnMap(cut, speed, finer, reach)


def test_the_mean_over_an_edge_is_that_of_its_slices():
    angle = np.linspace(-4.0, 9.0, 40)
    for twist in (0.02, 0.7, 8.0):
        behind = (np.arange(4000) + 0.5) / 4000 * twist
        phi = (angle[:, None] - behind) % (2.0 * math.pi)
        basis = (
            np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)], axis=-1) * ((phi > 2.0) & (phi < 3.0))[..., None]
        )
        sliced = np.einsum("nzi,nzj->nij", basis, basis) / 4000
        np.testing.assert_allclose(twisted_gram(Engagement(2.0, 3.0), angle, twist), sliced, atol=1e-3)


def test_over_a_turn_a_helix_does_what_a_straight_edge_does():
    """The mean directional matrix of zero order is the same for every helix and depth."""
    angle = 2.0 * math.pi * np.arange(5000) / 5000
    for twist in (0.3, 5.0):
        mean = twisted_gram(NARROW, angle, twist).mean(axis=0) * 2.0 * math.pi
        np.testing.assert_allclose(mean, gram_matrix(NARROW).real, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("pitch", [(120.0, 120.0, 120.0), (100.0, 130.0, 130.0)])
@pytest.mark.parametrize(("degrees", "depth", "speed"), [(30.0, 4e-3, 9000.0), (60.0, 40e-3, 12000.0)])
@pytest.mark.parametrize("flank", [0.0, 4e4])
def test_multipliers_are_those_of_a_turn_integrated_in_time(pitch, degrees, depth, speed, flank):
    setting = ([800.0, 850.0], [0.02, 0.02], [2e7, 2e7], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    tool = Tool(16e-3, 3, pitch_angles=tuple(np.radians(pitch)), helix_angle=math.radians(degrees))
    arc, work = Engagement(2.0, math.pi), CuttingCoefficients(8e8, 3e8, 1e8)
    found = floquet_multipliers(
        ModalModel(*setting), tool, arc, work, depth, speed, process_damping=ProcessDamping(flank, 0.3)
    )
    truth = TurnMap(
        MillingCut(
            *map(np.array, setting),
            np.radians(pitch),
            ((2.0, math.pi),),
            (8e8, 3e8, 1e8),
            flank=(flank, 0.3, 16e-3),
            twist=2.0 * math.tan(math.radians(degrees)) / 16e-3,
        ),
        speed,
        reach=depth,
    )
    a_turn = 3 if tool.equal_pitch else 1
    assert abs(found[0]) ** a_turn == pytest.approx(truth.radius(depth), rel=2e-3)


def test_at_a_whole_helix_pitch_zero_order_is_exact():
    """There every harmonic of the matrix averages to zero over the edge: what is left is the mean."""
    speed = 18000.0
    mean = zero_order(MACHINE, HELICAL, NARROW, WORK, [speed])
    depth = float(mean.limit_depth[0]) * 1e-3
    # A helix whose pitch is that depth: twist = 2 pi/(2 depth).
    tool = replace(HELICAL, helix_angle=math.atan(math.pi / depth * 1e-3))
    multiplier = floquet_multipliers(MACHINE, tool, NARROW, WORK, depth, speed)[0]
    assert abs(multiplier) == pytest.approx(1.0, abs=1e-7)
    lines = multi_frequency(MACHINE, tool, NARROW, WORK, [speed])
    assert float(lines.limit_depth[0]) * 1e-3 == pytest.approx(depth, rel=1e-6)
    assert float(lines.chatter_frequency[0]) == pytest.approx(float(mean.chatter_frequency[0]), rel=1e-6)


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
def test_a_helix_closes_period_doubling(method):
    """Straight edges double the period from 1.3 mm on; the helix of this tool leaves the Hopf lobe at 4.9 mm."""
    straight, helical = (
        method(MACHINE, tool, NARROW, WORK, [18000.0]) for tool in (replace(HELICAL, helix_angle=0.0), HELICAL)
    )
    assert straight.kind.values == ["flip"]
    assert helical.kind.values == ["hopf"]
    depth = float(helical.limit_depth[0]) * 1e-3
    assert depth > 3.5e-3 * float(straight.limit_depth[0])


def test_what_the_helix_closes_is_stable_in_time():
    depth = limit_depth(MACHINE, HELICAL, NARROW, WORK, 18000.0).limit_depth_mm * 1e-3
    radius = [turn(HELICAL, NARROW, 18000.0, share * depth).radius(share * depth) for share in (0.3, 0.995, 1.005)]
    assert max(radius[:2]) < 1.0 < radius[2]
    assert turn(replace(HELICAL, helix_angle=0.0), NARROW, 18000.0, 0.0).radius(0.5 * depth) > 1.1


def test_period_doubling_is_an_island_below_the_helix_pitch():
    """With a helix flip lobes are closed and end below each helix pitch (Zatarain, Munoa, Peigne, Insperger 2006)."""
    speed = 54500.0
    bands = stability_bands(MACHINE, HELICAL, NARROW, WORK, speed, 1.2 * PITCH)
    assert bands["stable"].tolist() == [True, False, True]
    assert bands["kind"].tolist() == ["none", "flip", "flip"]
    low, high = bands["to_mm"][0] * 1e-3, bands["to_mm"][1] * 1e-3
    assert high < PITCH
    for border, grows in ((low, 1), (high, -1)):
        below, above = (turn(HELICAL, NARROW, speed, x * border).radius(x * border) for x in (0.99, 1.01))
        assert grows * (above - 1.0) > 0.0 > grows * (below - 1.0)
    # Straight edges never are stable again.
    assert not stability_bands(MACHINE, replace(HELICAL, helix_angle=0.0), NARROW, WORK, speed, 1.2 * PITCH)["stable"][
        1
    ]
    found = limit_depth(MACHINE, HELICAL, NARROW, WORK, speed)
    assert found.limit_depth_mm * 1e-3 == pytest.approx(low, rel=1e-3)
    assert float(multi_frequency(MACHINE, HELICAL, NARROW, WORK, [speed]).limit_depth[0]) * 1e-3 == pytest.approx(
        low, rel=2e-3
    )


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
def test_hardly_a_helix_leaves_the_limit_of_straight_edges(method):
    almost = replace(HELICAL, helix_angle=1e-5)
    straight = replace(HELICAL, helix_angle=0.0)
    one, other = (method(MACHINE, tool, NARROW, WORK, [12000.0, 18000.0]).limit_depth for tool in (almost, straight))
    np.testing.assert_allclose(one, other, rtol=2e-4)


@pytest.mark.slow
def test_a_measured_compliance_has_the_limit_of_its_modes():
    record = MACHINE.compliance(np.arange(100.0, 4000.0, 2.0))
    limits = [float(multi_frequency(c, HELICAL, NARROW, WORK, [18000.0]).limit_depth[0]) for c in (record, MACHINE)]
    assert limits[0] == pytest.approx(limits[1], rel=5e-3)


def helical(seed: int) -> tuple[ModalModel, Tool, Engagement, CuttingCoefficients, float, MillingCut]:
    """Return a cut drawn at random, its helix pitch between 0.3 and 10 times the limit of straight edges."""
    drawn, rng = draw(seed), np.random.default_rng(seed + 1_000_000)
    cut, angle = drawn.cut, float(rng.uniform(math.radians(5), math.radians(55)))
    machine = ModalModel(cut.frequency, cut.damping, cut.stiffness, cut.direction)
    arc, work = Engagement(*np.clip(cut.arcs[0], 0.0, math.pi)), CuttingCoefficients(*cut.k)
    straight = Tool(0.02, cut.pitch.size, cut.approach, pitch_angles=tuple(cut.pitch))
    limit = min(limit_depth(machine, straight, arc, work, drawn.speed).limit_depth_mm * 1e-3, 0.1)
    pitch = limit * math.exp(rng.uniform(math.log(0.3), math.log(10.0)))
    diameter = pitch * cut.pitch.size * math.tan(angle) / math.pi
    tool = replace(straight, diameter=diameter, helix_angle=angle)
    return machine, tool, arc, work, drawn.speed, replace(cut, twist=2.0 * math.tan(angle) / diameter)


def bracketed(seed: int) -> None:
    *cut, speed, truth = helical(seed)
    steps = limit_depth(*cut, speed)
    depth = steps.limit_depth_mm * 1e-3
    lines = multi_frequency(*cut, [speed])
    assert float(lines.limit_depth[0]) == pytest.approx(steps.limit_depth_mm, rel=3e-3)
    radius = [TurnMap(truth, speed, 2.0, share * depth).radius(share * depth) for share in (0.5, 0.8, 0.99, 1.01)]
    assert max(radius[:3]) < 1.0 < radius[3], (seed, radius)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [700_001, 700_002, 700_003, 700_004, 700_005, 700_006, 700_008])
def test_cuts_drawn_at_random_are_bracketed_by_a_turn_in_time(seed):
    bracketed(seed)
