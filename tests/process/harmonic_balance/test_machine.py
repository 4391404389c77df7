"""A whole machine at a force level: limits, symmetry, a second machine, closed forms, time integration as oracle."""

import math

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson, CoulombViscous, LuGre, Viscous
from process.harmonic_balance._kernels import forces, gains
from process.harmonic_balance.network import FrictionElement, JointElement, Network
from process.harmonic_balance.quasi_frf import balanced, compliance_map, network, quasi_compliance
from process.machine.joints import CubicSpring, Gap, Iwan, Jenkins, Joint
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.modes import ModalModel
from process.machine.structure import Posture, Structure, free_modes, released_modes, two_mass_axes
from process.simulation.excitation import SteppedSine
from process.simulation.machine import simulate_machine

MM_MIN = 1.0 / 60e3
BENCH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
K2, K3 = Servo(6268.0, 10.9e-3, 45.5), Servo(10590.0, 6.5e-3, 76.9, 0.75e-3)
DRIVE = Drive(23.1, 11.3, 1.68e6, 104.0)
OTHER = Drive(40.0, 15.0, 3e6, 200.0)
COULOMB = CoulombViscous(50.0, 100.0, 15000.0)
ONE = Machine(two_mass_axes({"x": DRIVE}), {"x": FeedAxis({"K2": K2, "K3": K3}, BENCH)})
TWO = Machine(two_mass_axes({"x": DRIVE, "y": OTHER}), {"x": FeedAxis(K2, BENCH), "y": FeedAxis(K3, COULOMB)})
GRID = np.linspace(25.0, 95.0, 15)


def coupled(friction: tuple = (BENCH, COULOMB), spring: float = 4e5) -> Machine:
    """Two axes whose tips are tied by an oblique spring."""
    s = two_mass_axes({"x": DRIVE, "y": OTHER})
    tie = spring * np.outer([1.0, 0.0, 1.0, 0.0], [1.0, 0.0, 1.0, 0.0])
    axes = {"x": FeedAxis(K2, friction[0]), "y": FeedAxis(K3, friction[1])}
    return Machine(Structure(s.mass, s.damping, s.stiffness + tie, s.tool, s.slides), axes)


def oscillator(joint: Joint, stiffness: float = 1e6, damping: float = 60.0) -> Machine:
    """10 kg on a spring in x, the joint in parallel."""
    tool = np.array([[1.0], [0.0], [0.0]])
    return Machine(Structure([[10.0]], [[damping]], [[stiffness]], tool), {}, [MountedJoint(joint, [1.0])])


def x(dataset) -> NDArray:
    return dataset["compliance"].sel(response="x", excitation="x").values


def test_without_friction_the_level_does_not_matter() -> None:
    machine = coupled((Viscous(150.0), Viscous(0.0)))
    expected = machine.at(500.0 * MM_MIN).matrix(GRID)
    for level in (None, 0.0, 1.0, 1000.0):
        found = quasi_compliance(machine, GRID, level, 500.0 * MM_MIN)
        np.testing.assert_allclose(found["compliance"].values, expected, rtol=1e-10, atol=1e-18)


def test_a_friction_law_that_is_linear_is_solved_as_such() -> None:
    as_law = coupled((CoulombViscous(0.0, 150.0, 15000.0), CoulombViscous(0.0, 90.0, 15000.0)))
    expected = coupled((Viscous(150.0), Viscous(90.0))).at(0.0).matrix(GRID)
    found = quasi_compliance(as_law, GRID, 50.0)["compliance"].values
    np.testing.assert_allclose(found[:, :2, :2], expected[:, :2, :2], rtol=1e-8)


def test_the_idle_bench_has_the_peaks_of_the_reference() -> None:
    f = np.arange(60.0, 68.0, 0.05)
    for force, expected in ((1.0, 21.6), (10.0, 6.45), (50.0, 1.75)):
        response = x(quasi_compliance(ONE, f, force, 0.0, "K2", excitation=["x"], tolerance=math.inf))
        assert 1e6 * np.abs(response).max() == pytest.approx(expected, rel=5e-3)


def test_axes_that_do_not_meet_answer_as_if_alone() -> None:
    feeds = {"x": 500.0 * MM_MIN, "y": -250.0 * MM_MIN}
    both = quasi_compliance(TWO, GRID, 60.0, feeds)["compliance"]
    for axis, drive, servo, law in (("x", DRIVE, K2, BENCH), ("y", OTHER, K3, COULOMB)):
        alone = Machine(two_mass_axes({axis: drive}), {axis: FeedAxis(servo, law)})
        expected = quasi_compliance(alone, GRID, 60.0, {axis: feeds[axis]})["compliance"]
        here = {"response": axis, "excitation": axis}
        np.testing.assert_allclose(both.sel(here), expected.sel(here), rtol=1e-6)
    assert not both.sel(response="x", excitation="y").values.any()


def test_a_small_force_finds_the_linear_machine_and_is_reciprocal() -> None:
    machine, feed = coupled(), 500.0 * MM_MIN
    found = quasi_compliance(machine, GRID, 1e-4, feed, tolerance=1e-9)["compliance"].values
    np.testing.assert_allclose(found, machine.at(feed).matrix(GRID), rtol=1e-5, atol=1e-16)
    np.testing.assert_allclose(found, found.transpose(0, 2, 1), rtol=1e-5)
    large = quasi_compliance(machine, GRID, 80.0, feed)["compliance"].values
    assert np.abs(large[:, 0, 1] / large[:, 1, 0] - 1.0).max() > 0.02


@njit(cache=True)
def _two_axes(s, push, mass, damping, stiffness, gains, law, feeds, offset, out):
    """States q (4), q' (4), integral of the velocity error of both carriages (2)."""
    for i in range(4):
        total = push[i]
        for k in range(4):
            total -= damping[i, k] * s[4 + k] + stiffness[i, k] * s[k]
        out[i], out[4 + i] = s[4 + i], total
    for a in range(2):
        c = 2 * a + 1
        error = -gains[a, 2] * s[c] - s[4 + c]
        v = feeds[a] + s[4 + c]
        boost = law[a, 0] + (law[a, 1] - law[a, 0]) * math.exp(-abs(v) / law[a, 2])
        friction = boost * math.tanh(law[a, 4] * v) + law[a, 3] * v - offset[a]
        out[4 + c] += gains[a, 0] * (error + s[8 + a] / gains[a, 1]) - friction
        out[8 + a] = error
    for i in range(4):
        out[4 + i] /= mass[i]


@njit(cache=True)
def _integrate_two(f, push, mass, damping, stiffness, gains, law, feeds, offset, settle, listen, steps):
    h, w = 1.0 / (f * steps), 2.0 * math.pi * f
    s, k = np.zeros(10), np.zeros((4, 10))
    phasor = np.zeros(4, dtype=np.complex128)
    for i in range((settle + listen) * steps):
        t = i * h
        if i >= settle * steps:
            phasor += s[:4] * np.exp(-1j * w * t)
        for stage in range(4):
            part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            at = s if stage == 0 else s + part * k[stage - 1]
            _two_axes(
                at, push * math.cos(w * (t + part)), mass, damping, stiffness, gains, law, feeds, offset, k[stage]
            )
        s = s + h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
    return 2.0 * phasor / (listen * steps)


@pytest.mark.parametrize(("feed", "force", "frequency"), [(500.0, 50.0, 70.0), (250.0, 80.0, 45.0), (0.0, 60.0, 66.0)])
def test_two_coupled_axes_with_friction_equal_the_time_integration(feed: float, force: float, frequency: float) -> None:
    machine = coupled()
    s = machine.structure
    without_delay = Servo(K3.Kp, K3.Ti, K3.Kv)
    machine = Machine(s, {"x": FeedAxis(K2, BENCH), "y": FeedAxis(without_delay, COULOMB)})
    gains_of = np.array([[v.Kp, v.Ti, v.Kv] for v in (K2, without_delay)])
    law = np.array([[44.2, 84.0, BENCH.stribeck_speed, 168.0, 15000.0], [50.0, 50.0, 1.0, 100.0, 15000.0]])
    v0 = feed * MM_MIN
    offset = np.array([float(BENCH.force(v0)), float(COULOMB.force(v0))])
    steps = 2 * math.ceil(1.0 / (frequency * 40e-6))
    args = (np.diag(s.mass).copy(), s.damping, s.stiffness, gains_of, law, np.full(2, v0), offset)
    end = _integrate_two(frequency, np.array([force, 0.0, 0.0, 0.0]), *args, int(3.0 * frequency), 20, steps)
    found = quasi_compliance(machine, [frequency], force, v0, excitation=["x"])["compliance"].values[0, :2, 0]
    expected = end[[0, 2]] / force
    assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)


JOINTS = [Iwan(4e5, 30.0, elements=200), Jenkins(4e5, 30.0), CubicSpring(2e5, 2e14), Gap(8e5, 2e-5)]


@pytest.mark.parametrize("joint", JOINTS, ids=lambda j: type(j).__name__)
def test_one_harmonic_of_a_joint_is_the_closed_describing_function(joint: Joint) -> None:
    f = np.array([20.0, 30.0, 45.0, 55.0])
    found = quasi_compliance(oscillator(joint), f, 60.0, excitation=["x"], tolerance=math.inf)
    g = x(found)
    amplitude = np.abs(g) * 60.0
    w = 2.0 * np.pi * f
    inside = joint.equivalent_stiffness(amplitude) + 1j * joint.loss_stiffness(amplitude)
    np.testing.assert_allclose(g, 1.0 / (1e6 - 10.0 * w**2 + 60j * w + inside), rtol=1e-6)
    np.testing.assert_allclose(found["joint_amplitude"].values[:, 0, 0], amplitude, rtol=1e-9)
    np.testing.assert_allclose(found["joint_stiffness"].values[:, 0, 0], inside, rtol=1e-6)


@njit(cache=True)
def _integrate_joint(f, force, kind, parameters, stiffness, slip, settle, listen, steps):
    h, w = 1.0 / (f * steps), 2.0 * math.pi * f
    q, v, phasor = 0.0, 0.0, 0j
    anchor = np.zeros(stiffness.size)
    kq, kv = np.zeros(4), np.zeros(4)
    for i in range((settle + listen) * steps):
        t = i * h
        if i >= settle * steps:
            phasor += q * np.exp(-1j * w * t)
        for stage in range(4):
            part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            qs = q if stage == 0 else q + part * kq[stage - 1]
            vs = v if stage == 0 else v + part * kv[stage - 1]
            total = 0.0
            if kind == 0:
                for e in range(stiffness.size):
                    pull = stiffness[e] * (qs - anchor[e])
                    total += min(max(pull, -slip[e]), slip[e])
            elif kind == 1:
                total = parameters[0] * qs + parameters[1] * qs**3
            else:
                total = parameters[0] * (max(qs - parameters[1], 0.0) + min(qs + parameters[1], 0.0))
            kq[stage] = vs
            kv[stage] = (force * math.cos(w * (t + part)) - 1e6 * qs - 60.0 * vs - total) / 10.0
        q += h / 6.0 * (kq[0] + 2.0 * kq[1] + 2.0 * kq[2] + kq[3])
        v += h / 6.0 * (kv[0] + 2.0 * kv[1] + 2.0 * kv[2] + kv[3])
        for e in range(stiffness.size):
            pull = stiffness[e] * (q - anchor[e])
            if abs(pull) > slip[e]:
                anchor[e] = q - math.copysign(slip[e], pull) / stiffness[e]
    return 2.0 * phasor / (listen * steps) / force


@pytest.mark.parametrize("joint", JOINTS, ids=lambda j: type(j).__name__)
@pytest.mark.parametrize("frequency", [20.0, pytest.param(45.0, marks=pytest.mark.slow), 62.0])
def test_many_harmonics_of_a_joint_equal_the_time_integration(joint: Joint, frequency: float) -> None:
    parameters, elements, kind = np.zeros(2), (np.zeros(0), np.zeros(0)), 0
    if isinstance(joint, Iwan):
        elements = joint.packed()
    elif isinstance(joint, Jenkins):
        elements = np.array([joint.stiffness]), np.array([joint.slip_force])
    else:
        kind = 1 if isinstance(joint, CubicSpring) else 2
        parameters = np.array([joint.stiffness, joint.cubic if isinstance(joint, CubicSpring) else joint.gap])
    expected = _integrate_joint(frequency, 60.0, kind, parameters, *elements, int(3.0 * frequency), 20, 2000)
    found = quasi_compliance(oscillator(joint), [frequency], 60.0, excitation=["x"])
    assert found.attrs["status"] == "ok"
    assert abs(x(found)[0] - expected) < 2e-3 * abs(expected)


def test_a_level_lowers_a_micro_slip_peak_and_raises_the_frequency_of_a_hardening_one() -> None:
    f = np.linspace(40.0, 75.0, 176)

    def peaks(joint: Joint, levels: tuple) -> tuple[NDArray, NDArray]:
        r = np.abs([x(quasi_compliance(oscillator(joint), f, q, excitation=["x"], tolerance=math.inf)) for q in levels])
        return f[np.nanargmax(r, axis=1)], np.nanmax(r, axis=1)

    at, height = peaks(Iwan(4e5, 60.0), (1.0, 5.0, 20.0))
    assert np.all(np.diff(at) < 0.0)
    assert np.all(np.diff(height) < 0.0)
    at, _ = peaks(CubicSpring(2e5, 2e14), (1.0, 5.0, 10.0))
    assert np.all(np.diff(at) > 0.0)


def test_the_tangent_of_every_point_is_the_derivative_of_its_force() -> None:
    rng = np.random.default_rng(1)
    elements = (
        FrictionElement(BENCH, 3e-3),
        FrictionElement(COULOMB, -2e-3, 300.0),
        JointElement(JOINTS[0]),
        JointElement(JOINTS[1]),
        JointElement(JOINTS[2], 1e5),
    )
    packed = (net := Network(lambda f: np.zeros((f.size, 6, 6)), elements)).packed()
    grid, scale = net.grid(4), gains(net.packed(), 300.0)
    size = np.array([1e-2, 1e-2, 4e-2, 4e-2, 4e-2])
    shape = (5, grid.orders.size)
    u = size[:, None] * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / (1.0 + grid.orders)
    u[:, 0] = u[:, 0].real
    n, lags = shape[1], grid.lag_cosine.shape[1]
    tangent, slope, spare = np.empty((5, 2 * n, 2 * n)), np.empty((5, 2 * lags)), np.empty((5, 2 * n, 2 * n))
    middle, force = np.empty(shape, complex), np.empty(shape, complex)
    forces(packed, scale, u, grid, middle, tangent, slope)
    du = 1e-6 * size[:, None] * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    du[:, 0] = 0.0
    ends = []
    for side in (1.0, -1.0):
        forces(packed, scale, u + side * du, grid, force, spare, slope)
        ends.append(force.copy())
    change = 0.5 * (ends[0] - ends[1])
    real = np.einsum("pij,pj->pi", tangent, np.concatenate([du.real, du.imag], axis=1))
    predicted = real[:, :n] + 1j * real[:, n:]
    assert np.all(np.linalg.norm(predicted - change, axis=1) < 0.02 * np.linalg.norm(change, axis=1))


def test_a_map_holds_every_condition_and_states_where_the_machine_is_self_excited() -> None:
    found = compliance_map(
        ONE, GRID, [0.0, 30.0 * MM_MIN, 500.0 * MM_MIN], ["K2", "K3"], force_levels=[None, 40.0], excitation=["x"]
    )
    assert found["compliance"].dims == ("feed", "controller", "force_level", "frequency", "response", "excitation")
    assert found["feed"].attrs["units"] == "mm/min"
    assert found["force_level"].attrs["units"] == "N"
    resting = found["status"] == "ok"
    assert not resting.sel(feed=30.0, controller="K2").any()
    assert str(found["status"].sel(feed=30.0, controller="K2", force_level=40.0).item()).startswith("self-excited")
    assert np.isnan(found["compliance"].sel(feed=30.0, controller="K2")).all()
    assert resting.sel(feed=500.0).all()
    here = found["compliance"].sel(feed=500.0, controller="K3")
    np.testing.assert_array_equal(here.sel(force_level=0.0).values, ONE.at(500.0 * MM_MIN, "K3").matrix(GRID)[:, :, :1])
    alone = quasi_compliance(ONE, GRID, 40.0, 500.0 * MM_MIN, "K3", excitation=["x"])
    np.testing.assert_array_equal(here.sel(force_level=40.0).values, alone["compliance"].values)


def test_a_posture_is_reproduced_at_its_positions() -> None:
    structures = tuple(two_mass_axes({"x": Drive(23.1, 11.3, k, 104.0)}) for k in (1.68e6, 1.2e6))
    machine = Machine(Posture("x", [0.0, 0.4], structures), {"x": FeedAxis(K2, BENCH)})
    found = compliance_map(
        machine, GRID, [500.0 * MM_MIN], positions=[0.0, 0.2, 0.4], force_levels=[50.0], excitation=["x"]
    )
    assert found["feed"].item() == pytest.approx(500.0)
    for at, structure in ((0.0, structures[0]), (0.4, structures[1])):
        alone = quasi_compliance(Machine(structure, machine.axes), GRID, 50.0, 500.0 * MM_MIN, excitation=["x"])
        np.testing.assert_allclose(found["compliance"].sel(position=at), alone["compliance"], rtol=1e-12)


def test_a_slide_without_servo_is_solved_with_its_friction() -> None:
    free = Machine(two_mass_axes({"x": DRIVE}), {"x": FeedAxis(None, BENCH)})
    held = balanced(network(free), 300.0, GRID).balance
    assert held.converged.all()
    w = 2.0 * np.pi * GRID
    q = 104j * w + 1.68e6
    carriage = -23.1 * w**2 + 1j * w * held.coefficient[:, 0] + q
    expected = carriage / ((-11.3 * w**2 + q) * carriage - q**2)
    np.testing.assert_allclose(held.compliance[:, 0], expected, rtol=1e-4)


def test_unknown_names_are_refused_with_those_there_are() -> None:
    lugre = LuGre(1e7, 100.0, 44.2, 84.0, 6e-3, 168.0)
    memory = Machine(two_mass_axes({"x": DRIVE}), {"x": FeedAxis(K2, lugre)})
    with pytest.raises(InputError, match="has memory; harmonic balance takes Andersson"):
        quasi_compliance(memory, GRID, 10.0)
    assert quasi_compliance(memory, GRID, None).attrs["status"] == "ok"
    free = Machine(two_mass_axes({"x": DRIVE}), {"x": FeedAxis(None, COULOMB)})
    with pytest.raises(InputError, match="no servo that would hold its speed"):
        quasi_compliance(free, GRID, 10.0, 1e-3)
    with pytest.raises(InputError, match="harmonic balance needs a positive one"):
        quasi_compliance(ONE, GRID, -1.0, 0.0, "K2")
    with pytest.raises(InputError, match="no feed is given"):
        compliance_map(ONE, GRID, [])


def test_the_status_states_several_responses_to_one_force() -> None:
    """A Duffing oscillator beyond its bend: three responses at one frequency and force."""
    k, m, c = 1e6, 10.0, 30.0
    structure = free_modes([np.sqrt(k / m) / (2 * np.pi)], [c / (2 * np.sqrt(k * m))], [m], [[1.0, 0.0, 0.0]], {})
    machine = Machine(structure, {}, [MountedJoint(CubicSpring(0.0, 4e14), [1.0])])
    f0 = np.sqrt(k / m) / (2 * np.pi)
    found = quasi_compliance(machine, np.linspace(1.0, 1.9, 31) * f0, 30.0, excitation=["x"], response=["x"])
    assert "several responses" in found.attrs["status"]
    weak = quasi_compliance(machine, np.linspace(1.0, 1.9, 31) * f0, 0.01, excitation=["x"], response=["x"])
    assert weak.attrs["status"] == "ok"


@pytest.mark.parametrize("jointed", [False, True])
def test_heavy_slides_that_stick_at_rest_have_the_periodic_response_of_a_simulation_in_time(jointed: bool) -> None:
    """A ram on three axes: its guideways hardly move, with a slope that no mass limits at the harmonics of a sine."""
    ram = ModalModel(
        [24.0, 29.0, 33.5],
        [0.022, 0.026, 0.03],
        [4e7, 6e7, 5e7],
        [[0.1, 0.7, 0.6], [0.6, -0.5, 0.2], [0.9, 0.1, -0.3]],
    )
    mass = {"x": 9000.0, "y": 6000.0, "z": 3000.0}
    law = Andersson(400.0, 600.0, 300.0 * MM_MIN, 3000.0, 15000.0)
    axes = {a: FeedAxis(Servo(m * 2.0 * math.pi * 12.0, 0.02, 20.0), law) for a, m in mass.items()}
    joints = [MountedJoint(Jenkins(5e6, 300.0), np.eye(6)[3 + k]) for k in range(3 * jointed)]
    machine = Machine(released_modes(ram, mass), axes, joints)
    f = np.linspace(18.0, 42.0, 13)
    found = quasi_compliance(machine, f, 150.0, excitation=["x"])
    assert found.attrs["status"] == "ok"
    assert set(np.unique(found["method"])) == {0, 1}
    for i in (3, 8):
        sine = SteppedSine((f[i],), 150.0, 50.0 / f[i], 0.0)
        record = simulate_machine(machine, duration=sine.end, forces={"x": sine}, sample_rate=64.0 * f[i])
        last = record["displacement"].values[:, -64:]
        measured = last @ np.exp(-2j * np.pi * np.arange(64) / 64) / 32.0 * 1j / 150.0
        expected = found["compliance"].values[i, :, 0]
        assert np.abs(measured - expected).max() < 2e-3 * np.abs(expected).max()
