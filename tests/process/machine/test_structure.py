"""Structures against closed forms: an axis on a flexible host, momenta of modes, slides held by brakes."""

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import tune
from process.errors import InputError
from process.friction.laws import Andersson, Viscous
from process.machine.joints import CubicSpring
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.modes import ModalModel
from process.machine.structure import Host, Posture, hosted, released_modes, two_mass_axes
from process.simulation.excitation import HalfSine
from process.simulation.machine import simulate_machine

BENCH = Drive(23.1, 11.3, 1.68e6, 104.0)
HOST = Host(300.0, 48.5, 0.01)
FRICTION = Andersson(44.2, 84.0, 6.457e-3, 168.0, 15000.0)
TWO_MODES = ModalModel([24.0, 33.5], [0.022, 0.03], [4e7, 5e7], [[0.1, 0.7, 0.6], [0.9, 0.1, -0.3]])


def on_host(host: Host = HOST) -> Machine:
    return Machine(hosted(two_mass_axes({"x": BENCH}), {"x": host}), {"x": FeedAxis(tune(29.0, 34.4), FRICTION)})


def test_the_bench_in_its_host_has_the_resonance_and_antiresonance_of_the_paper() -> None:
    # Franco et al. 2024, Section 5.3: a small resonance at 45 Hz and an antiresonance at 48 Hz.
    f = np.linspace(30.0, 55.0, 5001)
    held = np.abs(on_host(Host(300.0, 48.5, 0.002)).idle_compliance(f)[:, 0, 0])
    resonance, antiresonance = f[np.argmax(held)], f[f > 46.0][np.argmin(held[f > 46.0])]
    assert resonance == pytest.approx(45.0, abs=0.5)
    assert antiresonance == pytest.approx(48.0, abs=0.5)
    k, k_h, m = 1.68e6, 300.0 * (2.0 * np.pi * 48.5) ** 2, 323.1
    roots = np.roots([m * 11.3, -(k * m + (k_h + k) * 11.3), (k_h + k) * k - k**2])
    assert resonance == pytest.approx(np.sqrt(roots.min()) / 2.0 / np.pi, abs=0.02)
    assert antiresonance == pytest.approx(np.sqrt((k_h + k) / m) / 2.0 / np.pi, abs=0.02)


def test_a_host_on_which_the_servo_acts_both_ways() -> None:
    # Two by two by hand: the servo pushes the carriage against the host, G (x_m - x_h) on both with opposite signs.
    f, point = np.array([7.0, 45.0, 61.0, 90.0]), on_host().at(0.025)
    s = 2j * np.pi * f
    sigma, servo = float(FRICTION.slope(0.025)), tune(29.0, 34.4)
    g, spring = servo.feedback(s) + sigma * s, BENCH.stiffness + BENCH.damping * s
    w_h = 2.0 * np.pi * HOST.frequency
    bed = HOST.mass * (s**2 + 2.0 * HOST.damping * w_h * s + w_h**2)
    through = 1.0 / (1.0 / g + 1.0 / bed)  # servo and bed in series hold the carriage
    carriage = BENCH.moving_mass * s**2 + through
    tip = BENCH.tip_mass * s**2 + 1.0 / (1.0 / spring + 1.0 / carriage)
    assert np.allclose(point.matrix(f)[:, 0, 0], 1.0 / tip, rtol=1e-10)


def test_a_very_heavy_host_is_none() -> None:
    f = np.linspace(10.0, 100.0, 10)
    plain = Machine(two_mass_axes({"x": BENCH}), on_host().axes)
    for feed in (0.0, 0.02):
        heavy = on_host(Host(1e12, 5000.0)).at(feed).matrix(f)
        assert np.allclose(heavy, plain.at(feed).matrix(f), rtol=1e-6)


def test_time_simulation_on_a_host_follows_the_compliance() -> None:
    run = simulate_machine(on_host(), duration=4.0, feed=0.05, forces={"x": HalfSine(0.01)}, sample_rate=1000.0)
    f = np.fft.rfftfreq(run.sizes["time"], 1e-3)
    band = (f > 20.0) & (f < 100.0)
    force, moved = (np.fft.rfft(run[name].sel(axis="x").values)[band] for name in ("force", "displacement"))
    true = on_host().at(0.05).matrix(f[band])[:, 0, 0]
    assert np.abs(moved / force - true).max() < 0.01 * np.abs(true).max()


def test_hosts_that_are_none_are_refused() -> None:
    with pytest.raises(InputError, match="host under axis y, which does not move; the structure moves along x"):
        hosted(two_mass_axes({"x": BENCH}), {"y": HOST})
    with pytest.raises(InputError, match="must be positive"):
        Host(0.0, 48.5)


def test_coupling_is_the_momentum_of_a_mode_along_an_axis() -> None:
    # L of one axis, the other as if the mass sat at the tool: momentum S M p' of the carriage's coordinate.
    row = [300.0, -50.0]
    coupled = released_modes(TWO_MODES, {"x": 9000.0, "y": 6000.0}, coupling={"y": row})
    velocity = np.array([0.0, 0.0, 1.0, 1.0])
    assert (coupled.mass @ velocity)[1] == pytest.approx(sum(row))
    plain = released_modes(TWO_MODES, {"x": 9000.0, "y": 6000.0})
    assert (coupled.mass @ velocity)[0] == pytest.approx((plain.mass @ velocity)[0])
    both = released_modes(TWO_MODES, {"x": 9000.0, "y": 6000.0}, coupling=[coupled.mass[0, 2:], row])
    assert np.array_equal(both.mass, coupled.mass)
    # A slide that is free takes the momentum away: 1/m_r becomes 1/(m_r - L^2/M), the mode rises.
    one = ModalModel([30.0], [0.0001], [3e7], [[1.0, 0.0, 0.0]])
    free = Machine(released_modes(one, {"x": 2000.0}, coupling={"x": [400.0]}), {"x": FeedAxis(None, Viscous(0.0))})
    ((frequency, _),) = free.at(0.01).modes()
    assert frequency == pytest.approx(30.0 / np.sqrt(1.0 - 400.0**2 / (2000.0 * float(one.mass[0]))), rel=1e-6)


def test_a_coupling_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="coupling of axis x has 3 values; give 2"):
        released_modes(TWO_MODES, {"x": 9000.0}, coupling={"x": [1.0, 2.0, 3.0]})
    with pytest.raises(InputError, match="coupling of axis z has 2 values"):
        released_modes(TWO_MODES, {"x": 9000.0}, coupling={"z": [1.0, 2.0]})


def test_brakes_hold_the_slides_of_their_axes_alone() -> None:
    f = np.linspace(10.0, 60.0, 11)
    axes = {a: FeedAxis(tune(20.0, 6000.0), Viscous(2e4)) for a in "xy"}
    machine = Machine(released_modes(TWO_MODES, {"x": 9000.0, "y": 6000.0}), axes)
    idle = TWO_MODES.compliance(f)["compliance"].values
    assert np.allclose(machine.braked().at().matrix(f), idle, rtol=1e-9)
    # Second method: a slide of the other axis that a stiff servo holds.
    one = machine.braked(["y"])
    assert list(one.axes) == ["x"]
    stiff = {**axes, "y": FeedAxis(tune(20.0, 1e15))}
    held = Machine(machine.structure, stiff).at(0.01).matrix(f)
    assert np.allclose(one.at(0.01).matrix(f), held, rtol=1e-6)
    with pytest.raises(InputError, match="brakes hold axis z, and this machine moves along x, y"):
        machine.braked(["z"])


def test_brakes_keep_joints_and_postures() -> None:
    f = np.linspace(10.0, 60.0, 11)
    light, heavy = (released_modes(TWO_MODES, {"x": mass}) for mass in (8000.0, 9000.0))
    joint = MountedJoint(CubicSpring(1e7, 0.0), np.array([0.0, 1.0, 0.5]))
    machine = Machine(Posture("x", [0.0, 1.0], (light, heavy)), {"x": FeedAxis(tune(20.0, 8500.0))}, [joint])
    braked = machine.braked().at(position=0.3).matrix(f)
    assert np.allclose(braked, machine.idle_compliance(f, 0.3), rtol=1e-9)
