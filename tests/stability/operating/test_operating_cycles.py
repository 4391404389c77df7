"""Limits of a machine model at its feed and vibration: reference values, integrated cuts, symmetries, closed forms."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from truth import slot

from process import Andersson, CuttingCoefficients, InputError, LuGre, Servo, Tool, Viscous, compliance_map, engagement
from process.drive.axis import Drive
from process.machine.joints import CubicSpring
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import Structure, two_mass_axes
from stability import operating_point, zero_order
from stability.operating.cycles import contact_gain
from stability.operating.guideways import CutLoop, moving_machine
from stability.problem import Cut, pattern_of_pitch

MM_MIN = slot.MM_MIN
LAW = Andersson(*slot.FRICTION)
DRIVE = Drive(slot.CARRIAGE, slot.TIP, slot.STIFFNESS, slot.DAMPING)
SLOT = Tool(0.0508, 4), engagement("down", 0.0508, 0.0508), CuttingCoefficients(780e6, slot.RADIAL, 0.0)
CHIP = 2e-4


def bench(controller, law=LAW, axis="x"):
    return Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0, Servo(*slot.GAINS[controller])), law, axis)


def fed(machine, feed, direction=0.0):
    cut = Cut(*SLOT)
    loop = CutLoop(cut.directional_matrix(), pattern_of_pitch(cut.tool).delay, CHIP)
    return moving_machine(machine, loop, direction, None, None, [feed]).at(feed)


# Theory, each limit at the feed of its own speed, 0.2 mm a tooth, as the converged limits of the state space are too.
SPEEDS = (800, 920, 1000, 1200, 1500, 1800, 2000, 2250, 2500)
LIMITS = {
    "K1": (1.422, 2.662, 3.667, 2.963, 1.110, 1.140, 1.339, 1.750, 2.349),
    "K2": (1.845, 2.900, 3.828, 3.624, 1.645, 1.587, 1.763, 2.147, 2.702),
    "K3": (2.279, 3.213, 4.062, 2.524, 1.830, 1.884, 2.089, 2.487, 3.035),
    "K4": (2.367, 1.386, 0.893, 0.727, 0.963, 1.432, 1.838, 2.432, 3.119),
}


@pytest.mark.parametrize("controller", LIMITS)
def test_the_limit_of_a_small_disturbance_is_that_of_the_feed_of_its_speed(controller):
    machine = bench(controller)
    found = [1e3 * fed(machine, 0.8 * n * MM_MIN).cycle(0.0, float(n)).depth for n in SPEEDS]
    np.testing.assert_allclose(found, LIMITS[controller], atol=6e-4)


@pytest.mark.parametrize(("feed", "limit"), [(25.0, 0.36), (100.0, 0.67), (250.0, 1.04)])
def test_the_lower_limit_is_that_of_a_kicked_cut(feed, limit):
    # Reference: K3 at 1500 rpm after 0.5 N s, by integration; with one harmonic alone 0.342, 0.709 and 1.117 mm.
    found = operating_point(bench("K3"), *SLOT, [1500.0], CHIP, feed=feed * MM_MIN)
    assert float(found.lower_limit_depth[0]) == pytest.approx(limit, rel=0.02)
    assert 0.2 < float(found.kick[0]) < 0.6
    assert float(found.feed[0]) == pytest.approx(feed)
    assert found.attrs["warnings"] == []


POINTS = [
    ("K3", 25, 1500, 0.3), ("K3", 100, 1500, 0.3), ("K3", 250, 1500, 0.3), ("K3", 25, 1500, 0.7),
    ("K3", 100, 1500, 0.7), ("K3", 250, 1500, 0.7), ("K2", 250, 1500, 0.5), ("K1", 1200, 1500, 0.5),
    ("K3", 250, 1000, 0.5), ("K4", 250, 1500, 0.5),
]  # fmt: skip
QUICK = POINTS[1:2]


def unstable_cycle(controller, feed, speed, share):
    """Return the cycle at a depth between both limits that a vibration must exceed to grow, and that depth."""
    at = fed(bench(controller), feed * MM_MIN)
    found = operating_point(bench(controller), *SLOT, [speed], CHIP, feed=feed * MM_MIN)
    low, high = (1e-3 * float(found[name][0]) for name in ("lower_limit_depth", "limit_depth"))
    depth, sizes = low + share * (high - low), found.cycle_amplitude.values[0]
    i = next(i for i, a in enumerate(1e-3 * found.cycle_depth.values[0]) if a <= depth)
    small = at.cycle(0.0, speed)
    size = brentq(lambda v: at.cycle(v, speed, small).depth - depth, sizes[i - 1] or 1e-6, sizes[i], xtol=1e-9)
    return at, at.cycle(size, speed, small), depth


@pytest.mark.parametrize(
    "point", [*QUICK, *(pytest.param(p, marks=pytest.mark.slow) for p in POINTS if p not in QUICK)]
)
def test_a_cut_started_on_nine_tenths_of_the_cycle_decays_and_on_eleven_tenths_grows(point):
    controller, feed, speed, share = point
    at, cycle, depth = unstable_cycle(controller, feed, float(speed), share)
    motion, w = cycle.motion, 2 * math.pi * cycle.chatter
    if motion is None:
        motion = at.imposed(cycle.amplitude * cycle.elements, depth, cycle.chatter, speed)
    assert motion.converged
    order, u = motion.orders, motion.motion[0]
    g = at.compliance(order * cycle.chatter)
    cut = depth * at.moving.loop.regeneration(order * cycle.chatter, speed)[:, None, None] * at.moving.loop.directional
    tip = -np.linalg.solve(np.eye(3) - g[:, :3, :3] @ cut, g[:, :3, 3:])[:, 0, 0] * motion.force[0]
    assert abs(tip[0]) == pytest.approx(abs(cycle.tool[0]), rel=0.01)
    speed_gain = slot.GAINS[controller][2]
    for factor in (0.9, 1.1):
        state = [tip, 1j * order * w * tip, u / (1j * order * w), u]
        state.append((u + speed_gain * state[2]) / (1j * order * w))
        record, count = slot.cut(
            controller, feed * MM_MIN, speed, depth, 1.5,
            tip=lambda t, f=factor: f * float(np.sum(tip * np.exp(1j * order * w * t)).real),
            state=[factor * float(np.sum(q).real) for q in state],
        )  # fmt: skip
        size = slot.envelope(record, count)
        assert (size[-1] > 1.2 * abs(tip[0])) == (factor > 1.0)
        assert (size[-1] < 0.5 * abs(tip[0])) == (factor < 1.0)


@pytest.mark.parametrize("point", [*QUICK, *(pytest.param(p, marks=pytest.mark.slow) for p in POINTS[6:8])])
def test_the_kick_leads_over_the_cycle(point):
    controller, feed, speed, share = point
    _, cycle, depth = unstable_cycle(controller, feed, float(speed), share)
    for factor in (0.9, 1.1):
        state = [0.0, factor * cycle.kick / slot.TIP, 0.0, 0.0, 0.0]
        record, count = slot.cut(controller, feed * MM_MIN, speed, depth, 2.5, tip=lambda t: 0.0, state=state)
        assert (slot.envelope(record, count)[-1] > 0.5 * abs(cycle.tool[0])) == (factor > 1.0)


TINY = [("K1", 1500), ("K2", 1200), ("K2", 800), ("K3", 1800), ("K4", 1000)]


@pytest.mark.parametrize("share", [0.97, 1.03])
@pytest.mark.parametrize(("controller", "speed"), TINY)
def test_a_tiny_disturbance_grows_beyond_the_limit_only(controller, speed, share):
    # Ten integrated cuts, five limits within 3 %.
    feed = 0.8 * speed * MM_MIN
    depth = share * fed(bench(controller), feed).cycle(0.0, float(speed)).depth
    state = [0.0, 1e-6, 0.0, 0.0, 0.0]
    record, count = slot.cut(controller, feed, speed, depth, 1.5, tip=lambda t: 0.0, state=state)
    size = slot.envelope(record, count)
    assert (size[-1] > size[size.size // 2]) == (share > 1.0)


def test_without_friction_that_changes_both_limits_are_those_of_zero_order():
    machine = bench("K2", Viscous(168.0))
    found = operating_point(machine, *SLOT, [900.0, 1500.0], CHIP)
    plain = zero_order(machine.at(0.01), *SLOT, [900.0, 1500.0])
    np.testing.assert_allclose(found.limit_depth, plain.limit_depth, rtol=1e-3)
    np.testing.assert_array_equal(found.lower_limit_depth, found.limit_depth)
    np.testing.assert_array_equal(found.kick, 0.0)
    np.testing.assert_allclose(found.chatter_frequency, plain.chatter_frequency, rtol=1e-3)


def test_each_axis_moves_with_its_share_of_the_feed_and_the_friction_of_its_direction():
    backwards = Andersson(38.7, 88.0, 421.0 * MM_MIN, 150.0, 15000.0)
    law = Andersson(*slot.FRICTION, negative=backwards)
    drives = {a: Drive(23.1, 11.3, 1.68e6, 104.0, Servo(*slot.GAINS["K2"])) for a in "xy"}
    two = Machine(two_mass_axes(drives), {a: FeedAxis(drives[a].servo, law) for a in "xy"})
    speed, feed = 1500.0, 600.0 * MM_MIN
    limits = {d: fed(two, feed, d).cycle(0.0, speed).depth for d in (0.0, 0.5 * math.pi, math.pi, 0.25 * math.pi)}
    assert limits[0.5 * math.pi] == pytest.approx(limits[0.0], rel=1e-6)
    other = Machine(two_mass_axes(drives), {a: FeedAxis(drives[a].servo, f) for a, f in (("x", backwards), ("y", law))})
    assert limits[math.pi] == pytest.approx(fed(other, feed).cycle(0.0, speed).depth, rel=1e-6)
    assert limits[math.pi] != pytest.approx(limits[0.0], rel=1e-3)
    # On the diagonal both axes move at the same rate, and the plane of the slot is isotropic again.
    slope = Viscous(float(law.slope(feed / math.sqrt(2.0))) + 1e4)
    assert slope.sigma > 0.0
    moving = fed(two, feed, 0.25 * math.pi)
    assert moving.coefficients(np.zeros(2)).real == pytest.approx([float(law.slope(feed / math.sqrt(2.0)))] * 2)
    still = operating_point(two, *SLOT, [speed], CHIP)
    assert "axis y stands still in this cut" in still.attrs["warnings"][-1]


def test_two_guideways_share_the_motion_of_the_mode():
    # Moved alike along the diagonal: each has the amplitude of one axis that is fed by its share.
    drives = {a: Drive(23.1, 11.3, 1.68e6, 104.0, Servo(*slot.GAINS["K3"])) for a in "xy"}
    two = Machine(two_mass_axes(drives), {a: FeedAxis(drives[a].servo, LAW) for a in "xy"})
    speed, feed = 1500.0, 250.0 * MM_MIN
    at = fed(two, feed * math.sqrt(2.0), 0.25 * math.pi)
    small = at.cycle(0.0, speed)
    cycle = at.cycle(1.6 * feed, speed, small)
    c = at.coefficients(1.6 * feed * np.abs(cycle.elements))
    assert np.abs(cycle.elements).max() == pytest.approx(1.0)
    assert cycle.depth < small.depth
    assert c.shape == (2,)
    assert math.isfinite(cycle.kick)
    # In the isotropic slot both axes are alike: the curve over the amplitude has no gap.
    found = operating_point(two, *SLOT, [speed], CHIP, feed=feed * math.sqrt(2.0), feed_direction=0.25 * math.pi)
    assert 0.0 < float(found.lower_limit_depth[0]) < float(found.limit_depth[0])


def test_a_hardening_joint_has_the_stiffness_of_its_amplitude():
    # m x'' + c x' + k x + k3 x^3: a sine of amplitude X sees k + 3/4 k3 X^2.
    m, k, c, cubic = 10.0, 1.4e6, 150.0, 1e14
    tool = np.zeros((3, 1))
    tool[0] = 1.0
    joint = MountedJoint(CubicSpring(1e4, cubic), np.ones(1))
    machine = Machine(Structure([[m]], [[c]], [[k]], tool, {}), {}, [joint])
    at = fed(machine, 0.01)
    speed, small = 1000.0, fed(machine, 0.01).cycle(0.0, 1000.0)
    cycle = at.cycle(0.02, speed, small)
    size = abs(cycle.tool[0])
    stiff = Machine(Structure([[m]], [[c]], [[k + 1e4 + 0.75 * cubic * size**2]], tool, {}), {})
    plain = operating_point(stiff, *SLOT, [speed], CHIP)
    assert 0.75 * cubic * size**2 > 0.1 * k
    assert 1e3 * cycle.depth == pytest.approx(float(plain.limit_depth[0]), rel=0.01)


def test_a_machine_in_stick_slip_has_no_limit():
    found = operating_point(bench("K1"), *SLOT, [1500.0, 2000.0], CHIP, feed=100.0 * MM_MIN)
    assert np.isnan(found.limit_depth).all()
    (text,) = found.attrs["warnings"]
    assert text.startswith("2 of 2 limits are not known, at uniform motion that is unstable without a cut (stick-slip)")


def test_the_band_holds_coefficients_in_closed_form_and_friction_by_trial():
    machine = bench("K2")
    found = operating_point(machine, *SLOT, [1500.0], CHIP, uncertainty={"coefficients": 0.1})
    for name in ("limit_depth", "lower_limit_depth"):
        np.testing.assert_allclose(
            found[f"{name}_quantile"].values[:, 0] / float(found[name][0]),
            np.exp(0.1 * np.array([-1.644854, 0, 1.644854])),
        )
    np.testing.assert_array_equal(found.safe_depth, found["lower_limit_depth_quantile"].values[0])
    assert float(found.safe_depth[0]) < float(found["limit_depth_quantile"].values[0, 0])
    width = {}
    for friction in (0.1, 0.2):
        band = operating_point(machine, *SLOT, [1500.0], CHIP, uncertainty={"friction": friction})
        width[friction] = np.log(band["limit_depth_quantile"].values[2] / band["limit_depth_quantile"].values[1])[0]
    assert width[0.2] == pytest.approx(2.0 * width[0.1], rel=0.25)
    # Against 60 machines drawn at random.
    rng, depths = np.random.default_rng(3), []
    for _ in range(60):
        f = np.exp(0.1 * rng.standard_normal(4))
        law = Andersson(44.2 * f[0], 84.0 * f[1], LAW.stribeck_speed * f[2], 168.0 * f[3], 15000.0)
        depths.append(fed(bench("K2", law), 1200 * MM_MIN).cycle(0.0, 1500.0).depth)
    assert width[0.1] / 1.645 == pytest.approx(float(np.std(np.log(depths))), rel=0.35)


def test_a_cut_whose_own_forces_stop_a_guideway_is_said():
    # Half a slot with two teeth has a first harmonic; the full slot with four has none.
    tool, half = Tool(0.0508, 2), engagement("down", 0.0254, 0.0508)
    text = "the tooth passing forces alone shake a guideway faster than it is fed"
    slow = operating_point(bench("K3"), tool, half, SLOT[2], [1500.0], CHIP, feed=25 * MM_MIN)
    assert any(text in w for w in slow.attrs["warnings"])
    fast = operating_point(bench("K3"), tool, half, SLOT[2], [1500.0], CHIP, feed=20000 * MM_MIN)
    full = operating_point(bench("K3"), *SLOT, [1500.0], CHIP, feed=25 * MM_MIN)
    assert not any(text in w for one in (fast, full) for w in one.attrs["warnings"])


@pytest.mark.slow
def test_a_library_of_sines_has_the_limits_of_the_machine_that_it_was_measured_on():
    machine, feeds = bench("K2"), np.array([500.0, 1000.0, 2000.0])
    library = compliance_map(machine, np.arange(8.0, 250.0, 0.5), feeds=(feeds * MM_MIN).tolist())
    speeds = [800.0, 1000.0, 1200.0, 1500.0, 2000.0]
    found, true = (operating_point(m, *SLOT, speeds, CHIP) for m in (library, machine))
    off = np.abs(found.limit_depth / true.limit_depth - 1.0).values
    assert off.max() < 0.012
    assert off.max() < found.attrs["interpolation_error"] < 0.06
    # At levels of force: both limits and the kick, from what stepped sines measure.
    machine, feed = bench("K3"), 250.0 * MM_MIN
    levels = [1.0, 15.0, 25.0, 35.0, 42.0, 50.0, 80.0]
    library = compliance_map(machine, np.arange(40.0, 120.0, 1.0), feeds=[feed], force_levels=levels)
    library = library.expand_dims(feed=[250.0]) if "feed" not in library.dims else library
    found, true = (operating_point(m, *SLOT, [1500.0, 1800.0], CHIP, feed=feed) for m in (library, machine))
    np.testing.assert_allclose(found.limit_depth, true.limit_depth, rtol=2e-3)
    np.testing.assert_allclose(found.lower_limit_depth, true.lower_limit_depth, rtol=0.15)
    np.testing.assert_allclose(found.kick, true.kick, rtol=0.35)


def test_a_tooth_that_leaves_the_cut_cuts_less():
    t = np.linspace(0.0, 2 * math.pi, 20001)[:-1]
    for swing in (0.5, 1.0, 1.2, 2.0):
        chip = np.maximum(0.0, 1.0 + swing * np.cos(t))
        assert contact_gain(swing) == pytest.approx(2.0 * float(np.mean(chip * np.cos(t))) / swing, rel=1e-6)


def test_what_is_refused():
    machine = bench("K2")
    with pytest.raises(InputError, match="force_level is given with a machine model"):
        operating_point(machine, *SLOT, [1500.0], CHIP, lambda depth: depth)
    with pytest.raises(InputError, match=r"the feed is .* m/s; give one, or one a spindle speed"):
        operating_point(machine, *SLOT, [1500.0], CHIP, feed=[0.01, 0.02])
    with pytest.raises(InputError, match="belong to a machine model"):
        operating_point(machine.at(0.01).compliance([50.0, 60.0]), *SLOT, [1500.0], CHIP, controller="K2")
    with pytest.raises(InputError, match="an uncertainty of 'wear' is given; there are coefficients, friction"):
        operating_point(machine, *SLOT, [1500.0], CHIP, uncertainty={"wear": 0.1})
    bristles = LuGre(5e8, 6e4, 44.2, 84.0, 0.006, 168.0)
    with pytest.raises(InputError, match="has memory"):
        operating_point(bench("K2", bristles), *SLOT, [1500.0], CHIP)
