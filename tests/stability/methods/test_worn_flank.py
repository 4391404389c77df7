"""Process damping in the converged methods: closed form, zero order, each other, and a turn integrated in time."""

import math
from functools import partial

import numpy as np
import pytest
from truth.milling_map import MillingCut, TurnMap

from process import CuttingCoefficients, Engagement, ModalModel, ProcessDamping, Tool, engagement
from process.errors import InputError
from stability import (
    floquet_multipliers,
    limit_depth,
    multi_frequency,
    semi_discretization,
    stability_bands,
    zero_order,
)

SETTING = ([62.0, 88.0, 140.0], [0.035, 0.03, 0.04], [1.9e7, 2.6e7, 6e7], [[1, 0.1, 0], [0, 1, 0.2], [0.1, 0.2, 1]])
MACHINE = ModalModel(*SETTING)
K = (1.9e9, 0.8e9, 0.3e9)
STEEL = CuttingCoefficients(*K)
QUARTER = math.pi / 4.0
DOWN = engagement("down", 20e-3, 80e-3)
SLOT = Engagement(0.0, math.pi)
FLANK = ProcessDamping(4e5)

# Diameter 80 mm; teeth or pitch [deg], approach angle, arc, flank [N/m] and its friction, spindle speed [rpm].
CUTS = {
    "half": ((180.0, 180.0), math.pi / 2, engagement("down", 40e-3, 80e-3), (1e6, 0.3), 900.0),
    "short": ((90.0,) * 4, QUARTER, DOWN, (1e6, 0.0), 400.0),
    "unequal": ((80.0, 100.0, 80.0, 100.0), math.pi / 2, DOWN, (4e5, 0.5), 600.0),
    "up": ((120.0,) * 3, math.pi / 3, engagement("up", 25e-3, 80e-3), (2e6, 0.3), 350.0),
}


def cut_of(name):  # type: ignore[no-untyped-def]
    degrees, approach, arc, flank, speed = CUTS[name]
    pitch = None if len(set(degrees)) == 1 else np.radians(degrees)
    tool = Tool(0.08, len(degrees), approach, pitch_angles=pitch)
    map_of = MillingCut(
        *(np.array(v, dtype=float) for v in SETTING),
        np.radians(degrees), ((arc.entry, arc.exit),), K, approach, (*flank, 0.08),
    )  # fmt: skip
    return (MACHINE, tool, arc, STEEL), ProcessDamping(*flank), speed, map_of


@pytest.mark.parametrize("name", CUTS)
def test_a_turn_integrated_in_time_has_the_same_limit(name):
    """Within 0.5 %, where the flank has moved the limit by more than that; both methods within 0.2 % of one another."""
    cut, flank, speed, map_of = cut_of(name)
    sharp = limit_depth(*cut, speed).limit_depth_mm
    steps = limit_depth(*cut, speed, process_damping=flank).limit_depth_mm
    lines = float(multi_frequency(*cut, [speed], process_damping=flank)["limit_depth"][0])
    assert lines == pytest.approx(steps, rel=2e-3)
    assert steps > 1.03 * sharp
    turn = TurnMap(map_of, speed, 2.0)
    assert turn.radius(0.995e-3 * steps) < 1.0 < turn.radius(1.005e-3 * steps)


def test_the_multipliers_are_those_of_a_turn_integrated_in_time():
    cut, flank, speed, map_of = cut_of("unequal")
    for depth in (1e-3, 4e-3):
        found = floquet_multipliers(*cut, depth, speed, process_damping=flank)[0]
        # The pattern repeats twice in a turn.
        assert abs(found) ** 2 == pytest.approx(TurnMap(map_of, speed, 2.0).radius(depth), rel=2e-3)


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
def test_a_slot_of_many_teeth_has_the_limit_of_zero_order(method):
    """The directional matrices of edge and flank are constant in x and y: their harmonics are those of z alone."""
    flat = ModalModel(*(v[:2] for v in SETTING[:3]), [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0]])
    cut, speeds = (Tool(0.08, 8), SLOT, STEEL), [150.0, 300.0, 500.0]
    mean, sharp = (zero_order(flat, *cut, speeds, p) for p in (FLANK, ProcessDamping(0.0)))
    found = method(flat, *cut, speeds, process_damping=FLANK)
    np.testing.assert_allclose(found["limit_depth"], mean["limit_depth"], rtol=1e-4)
    np.testing.assert_allclose(found["chatter_frequency"], mean["chatter_frequency"], rtol=1e-4)
    assert found["lobe"].values.tolist() == mean["lobe"].values.tolist()
    assert np.all(mean["limit_depth"] > 1.02 * sharp["limit_depth"])


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
def test_one_mode_in_closed_form(method):
    """Slot of four teeth, one mode along x: 1/(a Phi) = -K_rc (1 - exp(-j w T)) - j w C/v."""
    speed, flank = 400.0, ProcessDamping(4e5, 0.0)
    found = method(ModalModel([60.0], [0.03], [2e7], [[1, 0, 0]]), Tool(0.05, 4), SLOT, STEEL, [speed], 1e-6, flank)
    depth, frequency = float(found["limit_depth"][0]) * 1e-3, float(found["chatter_frequency"][0])
    w, cutting = 2.0 * math.pi * frequency, math.pi * 0.05 * speed / 60.0
    dynamic = 2e7 * (1.0 - (frequency / 60.0) ** 2 + 0.06j * frequency / 60.0)
    force = -STEEL.Krc * (1.0 - np.exp(-1j * w * 60.0 / (4.0 * speed))) - 1j * w * flank.coefficient / cutting
    assert abs(depth * force / dynamic - 1.0) < 1e-5


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
def test_a_flank_hardly_worn_leaves_the_limit_of_a_sharp_edge(method):
    cut = MACHINE, Tool(0.08, 3), DOWN, STEEL, [450.0, 700.0]
    sharp, worn = (method(*cut, process_damping=ProcessDamping(c)) for c in (0.0, 1.0))
    np.testing.assert_allclose(worn["limit_depth"], sharp["limit_depth"], rtol=2e-3)
    np.testing.assert_array_equal(sharp["limit_depth"], method(*cut)["limit_depth"])


@pytest.mark.parametrize("method", [semi_discretization, multi_frequency])
@pytest.mark.parametrize(("teeth", "arc", "worn"), [(2, DOWN, 1e6), (4, engagement("up", 10e-3, 80e-3), 4e5)])
def test_a_curve_of_speeds_has_the_limits_of_single_speeds(method, teeth, arc, worn):
    """The flank is another at each speed: a limit that follows its neighbour is that which is searched for alone."""
    limits = partial(method, MACHINE, Tool(0.08, teeth), arc, STEEL, process_damping=ProcessDamping(worn))
    speeds = np.linspace(300.0, 1500.0, 50)
    along = limits(speeds)["limit_depth"].values
    some = slice(1, None, 6)
    alone = [float(limits([n])["limit_depth"].values[0]) for n in speeds[some]]
    np.testing.assert_allclose(along[some], alone, rtol=2e-3)


def test_large_problems_are_solved_alike():
    """Many steps, beyond dense matrices: Arnoldi's method sees the flank as well."""
    cut, flank, speed, _ = cut_of("half")
    few, many = (floquet_multipliers(*cut, 3e-3, speed, n, flank)[0] for n in (30, 240))
    assert abs(few) == pytest.approx(abs(many), rel=1e-4)


def test_a_measured_compliance_has_the_limit_of_its_modes():
    cut, flank, speed, _ = cut_of("short")
    measured = MACHINE.compliance(np.arange(1.0, 1500.0, 0.25))
    whole, sampled = (multi_frequency(c, *cut[1:], [speed], process_damping=flank) for c in (MACHINE, measured))
    np.testing.assert_allclose(sampled["limit_depth"], whole["limit_depth"], rtol=3e-3)


def test_bands_begin_at_the_limit():
    cut, flank, speed, _ = cut_of("half")
    limit = limit_depth(*cut, speed, process_damping=flank).limit_depth_mm
    bands = stability_bands(*cut, speed, 1.5e-3 * limit, process_damping=flank)
    assert bands["stable"].tolist()[:2] == [True, False]
    assert bands["to_mm"][0] == pytest.approx(limit, rel=2e-3)


def test_a_tool_that_jumps_with_the_force_has_no_slope():
    """Its displacement would follow the force at once, and the flank would have no speed to resist."""

    class Jumping:
        def state_space(self):  # type: ignore[no-untyped-def]
            c = np.array([[1.0], [0.0], [0.0]])
            return np.array([[-50.0]]), 1e-6 * c.T, c

    with pytest.raises(InputError, match="jumps"):
        limit_depth(Jumping(), Tool(0.08, 3), SLOT, STEEL, 500.0, process_damping=FLANK)
