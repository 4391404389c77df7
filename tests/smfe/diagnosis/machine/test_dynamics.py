"""Claims: modes that ride on slides are the machine that `process` makes of them, and its limits are what they must."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from process.drive.servo import Servo
from process.friction.laws import LuGre, Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import released_modes
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.changed import Shaken
from smfe.diagnosis.frf.modal_dynamics import full_compliance, unchanged
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains, nuisances, sides_of, slide
from smfe.diagnosis.machine.causes import axis_causes
from smfe.diagnosis.machine.dynamics import Slide, bounded, moving_compliance, unbounded

Real = NDArray[np.float64]
F = np.linspace(3.0, 120.0, 60)
MODES = ModalModel(
    frequency=np.array([31.0, 45.0, 52.0]),
    damping=np.array([0.02, 0.03, 0.035]),
    stiffness=np.array([4.3e7, 5.0e7, 8.6e7]),
    direction=np.array([[0.99, -0.14, 0.0], [0.1, 0.99, 0.05], [0.0, -0.1, 0.99]]),
)
MASSES = {"x": 3200.0, "y": 900.0, "z": 350.0}
SHARES = np.array([[0.7, 0.08, 0.01], [-0.1, 0.8, 0.02], [0.0, -0.03, 0.6]])
SERVOS = {
    "x": Servo(2.6e5, 30e-3, 16.0, 2e-3),
    "y": Servo(1.0e5, 22e-3, 22.0, 1.5e-3),
    "z": Servo(6.0e4, 15e-3, 34.0, 1e-3),
}
SMALL = Shaken("actuator", 1e-9, 1.0)


def momentum() -> Real:
    """L [kg] of released_modes."""
    mass = MODES.mass / 1.0
    return SHARES * np.sqrt(np.array(list(MASSES.values()))[:, None] * mass[None, :])


def slides(**changes: object) -> tuple[Slide, ...]:
    free = unbounded(SHARES)
    return tuple(
        Slide(i, MASSES[a], tuple(free[i]), (s.Kp, s.Ti, s.Kv, s.delay), 3000.0)._replace(**changes)
        for i, (a, s) in enumerate(SERVOS.items())
    )


def test_in_motion_it_is_the_machine_whose_slides_are_released() -> None:
    """`released_modes` with a servo an axis: matrices of mass, damping and stiffness in place of the closed form."""
    structure = released_modes(MODES, MASSES, coupling=momentum())
    machine = Machine(structure, {a: FeedAxis(s, Viscous(3000.0)) for a, s in SERVOS.items()})
    expected = machine.at(0.01).matrix(F)
    found = moving_compliance(unchanged(MODES), slides(), F, SMALL)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_friction_is_linearised_as_bristles_are() -> None:
    law = LuGre(9e8, 0.0, 2000.0, 2600.0, 8e-3, 3000.0)
    structure = released_modes(MODES, MASSES, coupling=momentum())
    machine = Machine(structure, {a: FeedAxis(s, law) for a, s in SERVOS.items()})
    declared = {
        a: DeclaredAxis(MASSES[a], {"K1": Gains(s.Kp, s.Ti, s.Kv, s.delay)}, sides_of(law), law.stiffness)
        for a, s in SERVOS.items()
    }
    values = {p.name: p.start for p in nuisances(declared, Tolerances())} | {f"contact_loss_{a}": 0.0 for a in "xyz"}
    for feed in (0.0, 200.0 / 6e4, -500.0 / 6e4):
        ride = tuple(
            slide(i, a, declared[a], values, tuple(unbounded(SHARES)[i]), feed, "K1") for i, a in enumerate("xyz")
        )
        expected = machine.at(feed).matrix(F)
        found = moving_compliance(unchanged(MODES), ride, F, SMALL)
        assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()


def test_shaking_averages_the_friction_curve_over_the_speeds_it_makes() -> None:
    """In proportion to its square where there is little of it, so that fits that begin without it find it."""
    law = LuGre(9e8, 0.0, 2000.0, 2600.0, 8e-3, 3000.0)
    declared = DeclaredAxis(900.0, {}, sides_of(law), law.stiffness)
    still = {p.name: p.start for p in nuisances({"x": declared}, Tolerances())} | {"stir_x": 0.0, "push_x": 0.0}
    feed, phase = 200.0 / 6e4, np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)

    def fall(speed: float) -> float:
        values = still | {"stir_x": speed**2}
        return slide(0, "x", declared, values, (), feed, "", 1.0).fall

    for speed in (0.0, 2e-3, 6e-3):
        curve = -600.0 / 8e-3 * np.exp(-(feed + speed * np.cos(phase)) / 8e-3)
        assert fall(speed) == pytest.approx(float(curve.mean()), rel=1e-9)
    assert (fall(2e-4) - fall(0.0)) / (fall(1e-4) - fall(0.0)) == pytest.approx(4.0, rel=1e-3)


def test_friction_that_has_fallen_before_the_slowest_feed_is_not_looked_for() -> None:
    """Any force would do, of which nothing is seen."""
    axes = {"x": DeclaredAxis(900.0, {"K1": Gains(1e5, 22e-3, 22.0, 1.5e-3)})}
    lows = []
    for slowest in (0.0, 200.0 / 6e4, 1e-2, 0.1):
        (friction,) = axis_causes(axes, slowest)
        speed = next(p for p in friction.parameters if p.name == "stribeck_speed_x")
        lows.append(speed.low)
        assert all(speed.low <= start[2] <= speed.high for start in friction.starts)
    assert lows == pytest.approx([5e-4, 200.0 / 6e4 / 3.0, 1e-2 / 3.0, 4e-3])


def test_a_rigid_contact_leaves_the_modes_at_rest_alone() -> None:
    held = moving_compliance(unchanged(MODES), slides(contact=1e15), F, SMALL)
    assert np.abs(held - MODES.matrix(F)).max() < 1e-5 * np.abs(held).max()


def test_without_slides_it_is_the_model_of_modes() -> None:
    hard = unchanged(MODES)._replace(
        slip=(0.2, 0.6, 0.8, 0.0), springs=tuple((0.05 * np.eye(3)).ravel()), residual=(1e-9, 2e-9, 1e-9, 0.0, 0.0, 0.0)
    )
    for how in (Shaken("hammer", 1.0, 0.01), Shaken("actuator", 100.0, 0.05)):
        expected = full_compliance(hard, F, how)
        assert np.abs(moving_compliance(hard, (), F, how) - expected).max() < 1e-9 * np.abs(expected).max()


def test_far_below_the_modes_the_tool_feels_the_servo() -> None:
    """``1/B``, the drive and the mass that moves with it, behind the springs of the modes."""
    low = np.array([0.5])
    phi = moving_compliance(unchanged(MODES), slides(), low, SMALL)
    for i, one in enumerate(slides()):
        drive = 1.0 / one.stiffness(2.0 * math.pi * low)[0]
        assert abs(phi[0, i, i] - MODES.matrix(low)[0, i, i] - drive) < 0.02 * abs(drive)


def test_a_mass_at_the_tool_moves_with_slides_and_modes() -> None:
    """The same mass as a further body of the structure, bolted to the tool."""
    extra = 25.0
    structure = released_modes(MODES, MASSES, coupling=momentum())
    loaded = replace(structure, mass=structure.mass + extra * structure.tool.T @ structure.tool)
    machine = Machine(loaded, {a: FeedAxis(s, Viscous(3000.0)) for a, s in SERVOS.items()})
    found = moving_compliance(unchanged(MODES)._replace(mass=extra), slides(), F, SMALL)
    expected = machine.at(0.01).matrix(F)
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_hardening_joint_is_the_spring_that_its_amplitude_makes_it() -> None:
    """At a vanishing level nothing of it is left."""
    joint = unchanged(MODES)._replace(hardening=(0.5, 1.0, 0.0, 0.0))
    plain = moving_compliance(unchanged(MODES), slides(), F, SMALL)
    assert np.abs(moving_compliance(joint, slides(), F, SMALL) - plain).max() < 1e-9 * np.abs(plain).max()
    loud = moving_compliance(joint, slides(), F, Shaken("hammer", 1.0, 0.02))
    assert np.abs(loud - plain).max() > 0.01 * np.abs(plain).max()
    assert np.allclose(loud[:, 2, 2], plain[:, 2, 2], rtol=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_modes_never_carry_more_than_what_they_ride_on(seed: int) -> None:
    wild = 10.0 * np.random.default_rng(seed).standard_normal((3, 5))
    share = bounded(wild)
    assert np.linalg.eigvalsh(share @ share.T)[-1] < 1.0
    assert np.allclose(unbounded(share), wild, rtol=1e-6)


def by_small_steps(ride: tuple[Slide, ...], vector: Real, share: float, limits: Real, impulse: float) -> Real:
    """Spectrum of the tool's motion over that of a hit along x: steps of 20 us, each Jenkins element by itself."""
    shape = MODES.direction / np.sqrt(MODES.stiffness)[:, None]
    own = 2.0 * math.pi * MODES.frequency
    n, count, dt = 3 + len(ride), round(1.2 / 2e-5), 2e-5
    mass = np.diag([*own**-2.0, *(s.mass for s in ride)])
    mass[3:, :3] = SHARES * np.sqrt([s.mass for s in ride])[:, None] / own
    mass[:3, 3:] = mass[3:, :3].T
    inverse, tool = np.linalg.inv(mass), np.concatenate([shape, np.eye(3)])
    stiffness = np.diag([1.0, 1.0, 1.0, *(s.contact for s in ride)])
    damping = np.diag([*2.0 * MODES.damping / own, *(s.viscous for s in ride)])
    drives = np.array([s.drive for s in ride])
    late = np.round(drives[:, 3] / dt).astype(int)
    queue, wound = np.zeros((len(ride), late.max() + 1)), np.zeros(len(ride))
    q, v, elements = np.zeros(n), np.zeros(n), np.zeros(limits.size)
    each, moved, force = share / limits.size, np.zeros((count, 3)), np.zeros(count)
    duration, before = 4e-3, 0.0
    for k in range(count):
        t = k * dt
        force[k] = impulse * math.pi / (2.0 * duration) * math.sin(math.pi * t / duration) if t < duration else 0.0
        moved[k] = tool.T @ q
        y = float(vector @ q[:3])
        elements = np.clip(elements + each * (y - before), -each * limits, each * limits)
        before = y
        push = tool @ np.array([force[k], 0.0, 0.0]) - stiffness @ q - damping @ v
        push[:3] -= vector * (float(elements.sum()) - share * y)
        error = v[3:] + drives[:, 2] * q[3:]
        wound = wound + dt * error / drives[:, 1]
        queue[:, k % queue.shape[1]] = drives[:, 0] * (error + wound)
        push[3:] -= queue[range(len(ride)), (k - late) % queue.shape[1]]
        v = v + dt * (inverse @ push)
        q = q + dt * v
    turn = np.exp(-2j * np.pi * F[:, None] * dt * np.arange(count + 1))
    stays = turn[:, count, None] / (2j * np.pi * F[:, None] * dt) * moved[-1]  # elements that have slipped do
    return np.asarray((turn[:, :count] @ moved + stays) / (turn[:, :count] @ force)[:, None])


@pytest.mark.parametrize(("contact", "viscous"), [(0.0, 3000.0), (4e8, 6e4)])
@pytest.mark.slow
def test_a_joint_that_slips_in_a_hit_is_followed_in_time(contact: float, viscous: float) -> None:
    """Beside an integration element by element, in motion and on contacts that hold; one stiffness a hit is far off."""
    vector = np.array([0.8, 0.36, 0.48])
    ride, limits = slides(contact=contact, viscous=viscous), 0.03 * (np.arange(40) + 0.5) / 40
    expected = by_small_steps(ride, vector, 0.5, limits, 1.0)
    machine = unchanged(MODES)._replace(iwan=(0.5, 1.0, *vector))
    hit = Shaken("hammer", 1.0, 0.03, None, (1.0, 1.0, 1.0), 4e-3)
    found = moving_compliance(machine, ride, F, hit)[:, :, 0]
    at_once = moving_compliance(machine, ride, F, hit._replace(duration=0.0))[:, :, 0]
    linear = moving_compliance(unchanged(MODES), ride, F, hit)[:, :, 0]
    does = np.linalg.norm(expected - linear)
    assert np.linalg.norm(found - expected) < 0.03 * does
    assert np.linalg.norm(at_once - expected) > 0.25 * does
