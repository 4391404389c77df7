"""Maps over speed and depth: against integration in time by other code, closed forms, and the means over a turn."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process import CuttingCoefficients, Engagement, InputError, ModalModel, Tool, engagement, engagement_of_strips
from process.cut.force import force_projection
from stability import cut_maps, floquet_multipliers, limit_depth
from stability.vibration_maps import depths_within
from tests.truth.milling_steady import steady

FEED = 1e-4
STEEL = CuttingCoefficients(1.9e9, 8e8, 3e8, 3e4, 4e4, 1e4)


def drawn(seed):
    """A cut drawn at random, its depth at 20 to 70 % of its limit."""
    rng = np.random.default_rng(seed)
    teeth, count = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    pitch = None
    if teeth > 1 and seed % 2:
        parts = 1.0 + rng.uniform(-0.12, 0.12, teeth)
        pitch = tuple(2.0 * math.pi * parts / parts.sum())
    tool = Tool(80e-3, teeth, pitch_angles=pitch)
    arcs = (
        engagement("down", rng.uniform(8e-3, 70e-3), 80e-3),
        engagement("up", rng.uniform(8e-3, 70e-3), 80e-3),
        engagement_of_strips([(-40e-3, rng.uniform(-30e-3, -10e-3)), (5e-3, rng.uniform(10e-3, 40e-3))], 80e-3),
    )
    arc = arcs[seed % 3]
    shape = rng.normal(size=(count, 3)) * [1.0, 1.0, 0.3]
    shape /= np.linalg.norm(shape, axis=1)[:, None]
    modes = ModalModel(
        rng.uniform(60.0, 400.0, count), rng.uniform(0.02, 0.06, count), rng.uniform(1e7, 6e7, count), shape
    )
    rpm = float(rng.uniform(600.0, 3000.0))
    depth = rng.uniform(0.2, 0.7) * 1e-3 * min(limit_depth(modes, tool, arc, STEEL, rpm).limit_depth_mm, 8.0)
    return modes, tool, arc, rpm, depth


def compare(seed):
    """Return errors of vibration, deflection, walls and force, over the size of each, of one drawn cut."""
    modes, tool, arc, rpm, depth = drawn(seed)
    found = cut_maps(modes, tool, arc, STEEL, [depth], FEED, [rpm]).isel(spindle_speed=0, depth_of_cut=0)
    # Until what was there at the start has died out, by the multiplier, and 300 steps in the fastest period.
    pitch = tool.pitch_angles or (2.0 * math.pi / tool.teeth,) * tool.teeth
    period = 1.0 / tool.teeth if tool.equal_pitch else 1.0
    radius = abs(floquet_multipliers(modes, tool, arc, STEEL, depth, rpm)[0])
    turns = max(8, math.ceil(-period * math.log(3e4) / math.log(radius)))
    a_turn = max(4000, math.ceil(300.0 * modes.frequency.max() * 60.0 / rpm))
    each = list(zip(modes.frequency, modes.damping, modes.stiffness, modes.direction, strict=True))
    kc, ke = (STEEL.Ktc, STEEL.Krc, STEEL.Kac), (STEEL.Kte, STEEL.Kre, STEEL.Kae)
    lag = np.concatenate([[0.0], np.cumsum(pitch)[:-1]])
    arcs = [(part.entry, part.exit) for part in arc.arcs]
    truth = steady(each, lag, arcs, kc, ke, depth, FEED * tool.teeth, rpm, turns, a_turn)
    peak = np.ptp(truth.displacement, axis=0)
    largest = float(np.linalg.norm(truth.displacement, axis=1).max())
    errors = [np.abs(1e-6 * found["vibration"].values - peak).max() / peak.max()]
    errors.append(abs(1e-6 * float(found["deflection"]) - largest) / largest)
    errors += [
        abs(1e-6 * float(found["surface_error"].sel(wall=w)) - truth.wall(w)) / largest for w in found["wall"].values
    ]
    strongest = float(np.linalg.norm(truth.force, axis=1).max())
    errors.append(abs(float(found["peak_force"]) - strongest) / strongest)
    at = np.linspace(0, truth.angle.size - 1, 2000).round().astype(int)
    assert np.isfinite(truth.displacement[at]).all()
    return errors, len(found["wall"])


@pytest.mark.parametrize("seed", range(6))
def test_vibration_wall_and_force_are_where_a_long_simulation_ends(seed):
    errors, walls = compare(seed)
    assert max(errors) < 0.01, errors
    assert walls >= 1


@pytest.mark.slow
def test_sixty_random_cuts_end_where_a_long_simulation_does():
    every = [max(compare(seed)[0]) for seed in range(100, 160)]
    print(
        f"60 cuts: median {100 * np.median(every):.3f} %, largest {100 * max(every):.3f} % at {100 + np.argmax(every)}"
    )
    assert max(every) < 0.02, every
    assert np.median(every) < 0.005


@pytest.mark.parametrize("cut", ["down", "up"])
def test_far_below_the_mode_the_wall_is_off_by_the_static_deflection(cut):
    """One degree of freedom normal to the wall, a slow cut: F_y(phi)/k at the passing of a tooth."""
    stiffness, depth, teeth = 2e7, 1e-3, 8
    modes = ModalModel([1500.0], [0.3], [stiffness], [[0.0, 1.0, 0.0]])
    tool, arc = Tool(80e-3, teeth), engagement(cut, 55e-3, 80e-3)
    sharp = replace(STEEL, Kte=0.0, Kre=0.0, Kae=0.0)
    found = cut_maps(modes, tool, arc, sharp, [depth], FEED, [120.0])
    at = 0.0 if cut == "up" else math.pi
    phi = (at + 2.0 * math.pi * np.arange(teeth) / teeth) % (2.0 * math.pi)
    phi = phi[(phi > arc.entry - 1e-9) & (phi < arc.exit + 1e-9)]
    projection = force_projection(sharp.cutting, tool.approach_angle)
    force = sum(depth * FEED * np.sin(p) * (projection @ [np.sin(p), np.cos(p), 1.0])[1] for p in phi)
    expected = 1e6 * force / stiffness * (1.0 if cut == "up" else -1.0)
    assert abs(expected) > 1.0
    assert float(found["surface_error"].sel(wall=cut)[0, 0]) == pytest.approx(expected, rel=2e-3)


def test_at_resonance_a_light_mode_swings_by_its_harmonic_times_the_quality():
    """Tooth passing at the natural frequency: peak to peak |F_1|/(k zeta), the other harmonics being small there."""
    zeta, stiffness, f = 0.002, 5e7, 100.0
    modes = ModalModel([f], [zeta], [stiffness], [[0.0, 1.0, 0.0]])
    tool, arc, depth = Tool(80e-3, 4), engagement("central", 50e-3, 80e-3), 1e-5
    found = cut_maps(modes, tool, arc, STEEL, [depth], FEED, [60.0 * f / 4])
    phi = np.linspace(arc.entry, arc.exit, 20001)
    basis = np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)])
    force = FEED * np.sin(phi) * (force_projection(STEEL.cutting, tool.approach_angle) @ basis)
    force = depth * (force + force_projection(STEEL.edge, tool.approach_angle) @ basis)[1]
    first = 4.0 / math.pi * abs(np.trapezoid(force * np.exp(-4j * phi), phi))
    swing = 1e6 * first / (stiffness * zeta)
    assert float(found["vibration"].sel(axis="y")[0, 0]) == pytest.approx(swing, rel=0.02)


def test_torque_power_and_removal_rate_are_those_of_the_work_done():
    """A slot with sharp edges: power = Ktc times the removal rate; and the mean force times the speed agrees."""
    tool, arc = Tool(80e-3, 5), engagement("down", 80e-3, 80e-3)
    sharp = replace(STEEL, Kte=0.0)
    modes = ModalModel([200.0], [0.03], [3e7], [[1.0, 0.0, 0.0]])
    found = cut_maps(modes, tool, arc, sharp, [1e-3, 2e-3], FEED, [900.0, 1800.0], [1.5e-3, 2.5e-3])
    rate = found["removal_rate"].values / 60e6
    np.testing.assert_allclose(1e3 * found["spindle_power"], sharp.Ktc * rate, rtol=1e-12)
    assert rate[1, 1] == pytest.approx(2e-3 * 80e-3 * FEED * 5 * 1800.0 / 60.0)
    np.testing.assert_allclose(1e3 * found["spindle_power"][1], found["mean_torque"][1] * 1800.0 * math.pi / 30.0)
    assert found["stable"].values.tolist() == [[True, False], [True, True]]


@pytest.mark.parametrize("pitch", [None, (math.radians(80), math.radians(100)) * 2])
def test_the_depth_within_a_limit_is_where_the_map_reaches_it(pitch):
    modes = ModalModel([180.0, 230.0], [0.03, 0.03], [3e7, 4e7], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    tool, arc, speeds = Tool(80e-3, 4, pitch_angles=pitch), engagement("up", 30e-3, 80e-3), [900.0, 1100.0]
    deepest = [1e-3 * limit_depth(modes, tool, arc, STEEL, n).limit_depth_mm for n in speeds]
    by_deflection, by_wall = depths_within(modes, tool, arc, STEEL, FEED, speeds, deepest, 20e-6, 5e-6)
    for k, n in enumerate(speeds):
        for depth, name, allowed in ((by_deflection[k], "deflection", 20.0), (by_wall[k], "surface_error", 5.0)):
            if math.isfinite(depth):
                at = cut_maps(modes, tool, arc, STEEL, [depth], FEED, [n])[name]
                assert float(np.abs(at).max()) == pytest.approx(allowed, rel=0.01)
    assert np.isfinite(by_deflection).all()


def test_what_is_refused():
    modes = ModalModel([200.0], [0.03], [3e7], [[1.0, 0.0, 0.0]])
    cut = Tool(80e-3, 5), Engagement(0.5, 2.0), STEEL
    with pytest.raises(InputError, match="do not rise"):
        cut_maps(modes, *cut, [2e-3, 1e-3], FEED, [900.0])
    with pytest.raises(InputError, match="the cut leaves no wall"):
        depths_within(modes, *cut, FEED, [900.0], [1e-3], surface_error=1e-6)
    with pytest.raises(InputError, match="run-out"):
        cut_maps(modes, Tool(80e-3, 2, runout=(1e-5, -1e-5)), *cut[1:], [1e-3], FEED, [900.0])
    with pytest.raises(InputError, match="helix"):
        cut_maps(modes, Tool(80e-3, 2, helix_angle=0.3), *cut[1:], [1e-3], FEED, [900.0])
