"""A machine of several axes reduces to its closed forms, is reciprocal, and is refused where it is unstable."""

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo, tune
from process.errors import InputError
from process.friction.laws import Andersson, CoulombViscous, GeneralisedMaxwellSlip, LuGre, Viscous
from process.friction.linearised import linearised
from process.harmonic_balance.quasi_frf import quasi_compliance
from process.machine.joints import CubicSpring, Gap, Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint, released_compliance
from process.machine.modes import ModalModel
from process.machine.operating_point import OperatingPoint
from process.machine.structure import Posture, Structure, free_modes, released_modes, two_mass_axes

MM_MIN = 1.0 / 6e4
TABLE_1 = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
K1, K2, K3 = Servo(3242.0, 21.2e-3, 23.5), Servo(6268.0, 10.9e-3, 45.5), Servo(10590.0, 6.5e-3, 76.9)
BENCH = Drive(23.1, 11.3, 1.68e6, 104.0)
F = np.linspace(0.5, 150.0, 300)
# Three coupled modes in space, of the size of a ram.
RAM = ModalModel(
    [24.0, 29.0, 33.5], [0.022, 0.026, 0.03], [4e7, 6e7, 5e7], [[0.1, 0.7, 0.6], [0.6, -0.5, 0.2], [0.9, 0.1, -0.3]]
)
MASS = {"x": 9000.0, "y": 6000.0}


def ram(friction: float = 2e3) -> Machine:
    axes = {a: FeedAxis(tune(20.0, m, 1e-3), Viscous(friction)) for a, m in MASS.items()}
    return Machine(released_modes(RAM, MASS), axes)


def with_delay(servo: Servo, delay: float) -> Servo:
    return Servo(servo.Kp, servo.Ti, servo.Kv, delay)


class TestOneAxis:
    @pytest.mark.parametrize("delay", [0.0, 0.75e-3])
    @pytest.mark.parametrize("servo", [K1, K2, K3])
    def test_equals_equation_4_and_its_poles(self, servo: Servo, delay: float) -> None:
        servo = with_delay(servo, delay)
        drive = Drive(23.1, 11.3, 1.68e6, 104.0, servo, 168.0)
        point = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(servo, Viscous(168.0))}).at()
        np.testing.assert_allclose(point.matrix(F)[:, 0, 0], drive.tip_compliance(F), rtol=1e-12)
        assert not point.matrix(F)[:, 1:].any()
        np.testing.assert_allclose(point.poles(), drive.poles(), rtol=1e-7)
        assert point.matrix([0.0])[0, 0, 0] == pytest.approx(1.0 / 1.68e6, rel=1e-12)

    def test_the_idle_mode_and_the_moving_mass_make_equation_4(self) -> None:
        idle = ModalModel([BENCH.locked_frequency], [BENCH.locked_damping], [1.68e6], [[1.0, 0.0, 0.0]])
        axis = FeedAxis(with_delay(K2, 0.75e-3), TABLE_1)
        machine = Machine(released_modes(idle, {"x": 34.4}), {"x": axis})
        feed = 500.0 * MM_MIN
        whole = Machine(two_mass_axes({"x": BENCH}), {"x": axis})
        np.testing.assert_allclose(machine.at(feed).matrix(F), whole.at(feed).matrix(F), rtol=1e-11)
        np.testing.assert_allclose(machine.idle_compliance(F), idle.matrix(F), rtol=1e-11)
        measured = idle.compliance(F, ["x"], ["x"])
        released = released_compliance(measured, {"x": axis}, {"x": 34.4}, 11.3, feed)
        np.testing.assert_allclose(released["compliance"].values, whole.at(feed).matrix(F)[:, :1, :1], rtol=1e-11)

    def test_unstable_feeds_are_those_of_the_drive(self) -> None:
        machine = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(K2, TABLE_1)})
        feeds = np.geomspace(5.0, 3000.0, 30) * MM_MIN
        counts = [machine.at(v).unstable_poles() for v in feeds]
        slopes = TABLE_1.slope(feeds)
        assert counts == [Drive(23.1, 11.3, 1.68e6, 104.0, K2, float(s)).unstable_poles() for s in slopes]
        assert set(counts) == {0, 2}
        with pytest.raises(InputError, match=r"friction of axis x falls with speed .* feed faster"):
            machine.at(feeds[counts.index(2)]).compliance(F)

    def test_friction_of_any_slope_at_rest_tends_to_the_idle_compliance(self) -> None:
        errors = []
        for kt in (1.5e4, 1.5e5, 1.5e6):
            law = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, kt)
            machine = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(K2, law)})
            errors.append(np.abs(machine.at(0.0).matrix(F) - machine.idle_compliance(F)).max())
        assert errors[1] < 0.2 * errors[0]
        assert errors[2] < 0.2 * errors[1]

    def test_bad_input(self) -> None:
        structure = two_mass_axes({"x": BENCH})
        with pytest.raises(InputError, match="axis y has no slide"):
            Machine(structure, {"y": FeedAxis(K2)})
        machine = Machine(structure, {"x": FeedAxis({"K1": K1, "K2": K2})})
        with pytest.raises(InputError, match="controller 'K3' is none of K1, K2"):
            machine.at(controller="K3")
        with pytest.raises(InputError, match="feed of axis z"):
            machine.at({"z": 0.1})
        with pytest.raises(InputError, match="1 participations; the structure has 2"):
            Machine(structure, {}, [MountedJoint(Gap(1e6, 1e-6), [1.0])])
        unstable = Machine(structure, {"x": FeedAxis(Servo(2e5, 1e-3, 200.0, 2e-3))})
        with pytest.raises(InputError, match=r"uniform motion is unstable: .* Lower Kp or Kv"):
            unstable.at().compliance(F)


class TestSeveralAxes:
    def test_reciprocal_and_passive(self) -> None:
        phi = ram().at({"x": 0.01, "y": 0.005}).matrix(F)
        np.testing.assert_allclose(phi, phi.transpose(0, 2, 1), rtol=1e-11)
        # Force does no negative work: -Im(Phi) of a structure with dampers only (no servo) is positive semi-definite.
        idle = ram().idle_compliance(F)
        least = np.linalg.eigvalsh(-(idle - idle.conj().transpose(0, 2, 1)) / 2j).min(axis=1)
        assert np.all(least > -1e-12 * np.abs(idle).max())

    def test_locked_slides_give_the_idle_modes_back(self) -> None:
        np.testing.assert_allclose(ram().idle_compliance(F), RAM.matrix(F), rtol=1e-10, atol=1e-22)

    def test_measured_idle_compliance_equals_the_modal_assembly_for_a_tip_mass(self) -> None:
        axes = {a: FeedAxis(tune(20.0, m, 1e-3), Viscous(2e3)) for a, m in MASS.items()}
        machine = Machine(released_modes(RAM, MASS, tip_mass=600.0), axes)
        released = released_compliance(RAM.compliance(F), axes, MASS, 600.0)
        np.testing.assert_allclose(released["compliance"].values, machine.at().matrix(F), rtol=1e-9, atol=1e-20)

    def test_motion_of_one_axis_reaches_the_others(self) -> None:
        """Portal 2 of Franco et al. 2024: x changes although only y moves."""
        law = Andersson(1500.0, 2500.0, 400.0 * MM_MIN, 5e3, 15000.0)
        axes = {a: FeedAxis(tune(20.0, m), law) for a, m in MASS.items()}
        aligned = ModalModel(RAM.frequency, RAM.damping, RAM.stiffness, np.eye(3))
        changes = []
        for modes in (RAM, aligned):
            machine = Machine(released_modes(modes, MASS), axes)
            idle, y_moves = (machine.at(feed).matrix(F)[:, 0, 0] for feed in (0.0, {"y": 3000.0 * MM_MIN}))
            changes.append(np.abs(y_moves - idle).max() / np.abs(idle).max())
        assert changes[0] > 0.1
        assert changes[1] < 1e-9

    def test_state_space_without_dead_time_is_exact(self) -> None:
        axes = {a: FeedAxis(tune(20.0, m), Viscous(2e3)) for a, m in MASS.items()}
        point = Machine(released_modes(RAM, MASS), axes).at()
        a, b, c = point.state_space()
        s = 2j * np.pi * F
        response = c @ np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b)
        np.testing.assert_allclose(response, point.matrix(F), rtol=1e-9, atol=1e-20)

    def test_a_pade_fraction_of_rising_order_tends_to_the_dead_time(self) -> None:
        point = ram().at()
        s = 2j * np.pi * F

        def error(order: int) -> float:
            a, b, c = point.state_space(order)
            response = c @ np.linalg.solve(s[:, None, None] * np.eye(len(a)) - a, b)
            return float(np.abs(response - point.matrix(F)).max() / np.abs(point.matrix(F)).max())

        errors = [error(n) for n in (1, 2, 4)]
        assert errors[1] < 0.1 * errors[0]
        assert errors[2] < 1e-6

    def test_every_pole_with_dead_times_makes_the_dynamic_stiffness_singular(self) -> None:
        axes = {"x": FeedAxis(tune(20.0, 9000.0, 1e-3)), "y": FeedAxis(tune(15.0, 6000.0, 2.5e-3))}
        point = Machine(released_modes(RAM, MASS), axes).at()
        s = point.poles()
        z = point.dynamic_stiffness(s)
        singular = np.linalg.svd(z, compute_uv=False)
        assert s.size >= 2 * 3 + 2
        assert np.all(singular[:, -1] < 1e-6 * singular[:, 0])

    @pytest.mark.parametrize("bandwidth", [10.0, 30.0, 60.0, 120.0])
    def test_counted_unstable_poles_are_the_poles_in_the_right_half_plane(self, bandwidth: float) -> None:
        axes = {a: FeedAxis(tune(bandwidth, m, 3e-3)) for a, m in MASS.items()}
        point = Machine(released_modes(RAM, MASS), axes).at()
        assert point.unstable_poles() == np.sum(point.poles().real > 0.0)

    def test_controllers_by_name(self) -> None:
        axes = {
            "x": FeedAxis({"soft": tune(10.0, 9000.0), "stiff": tune(30.0, 9000.0)}),
            "y": FeedAxis(tune(20.0, 6e3)),
        }
        machine = Machine(released_modes(RAM, MASS), axes)
        alone = Machine(released_modes(RAM, MASS), {"x": FeedAxis(tune(30.0, 9000.0)), "y": axes["y"]})
        np.testing.assert_allclose(machine.at(controller="stiff").matrix(F), alone.at().matrix(F))


class TestStructure:
    def test_modes_that_weigh_more_than_their_axis_are_refused(self) -> None:
        with pytest.raises(InputError, match="mass matrix is not positive definite; a mode may not carry more mass"):
            released_modes(RAM, {"x": 100.0})
        with pytest.raises(InputError, match="moving mass of axis x is -5 kg"):
            released_modes(RAM, {"x": -5.0})
        with pytest.raises(InputError, match="damping matrix is not positive"):
            Structure(np.eye(2), -np.eye(2), np.eye(2), np.zeros((3, 2)))

    def test_free_modes_of_two_masses_are_the_two_masses(self) -> None:
        mm, mt, k, c = 23.1, 11.3, 1.68e6, 104.0
        reduced = mm * mt / (mm + mt)
        w = np.sqrt(k / reduced)
        shapes = np.array([[1.0, 0.0, 0.0], [mm / (mm + mt), 0.0, 0.0]])
        structure = free_modes(
            [0.0, w / 2 / np.pi],
            [0.0, c / (2 * reduced * w)],
            [mm + mt, reduced],
            shapes,
            {"x": [1.0, -mt / (mm + mt)]},
        )
        axis = FeedAxis(K2, TABLE_1)
        one, two = Machine(structure, {"x": axis}), Machine(two_mass_axes({"x": BENCH}), {"x": axis})
        np.testing.assert_allclose(one.at(0.01).matrix(F), two.at(0.01).matrix(F), rtol=1e-10)
        np.testing.assert_allclose(one.idle_compliance(F), two.idle_compliance(F), rtol=1e-10)

    def test_a_posture_gives_its_structures_back_and_stays_passive_between(self) -> None:
        far = ModalModel(RAM.frequency * 0.9, RAM.damping, RAM.stiffness * 0.81, RAM.direction)
        posture = Posture("x", [0.0, 1.0], (released_modes(RAM, MASS), released_modes(far, MASS)))
        machine = Machine(posture, {a: FeedAxis(tune(20.0, m)) for a, m in MASS.items()})
        np.testing.assert_allclose(machine.idle_compliance(F, 0.0), RAM.matrix(F), rtol=1e-9, atol=1e-22)
        np.testing.assert_allclose(machine.idle_compliance(F, 1.0), far.matrix(F), rtol=1e-9, atol=1e-22)
        peaks = [F[np.argmax(np.abs(machine.idle_compliance(F, p)[:, 0, 0]))] for p in (0.0, 0.5, 1.0)]
        assert peaks[0] > peaks[1] > peaks[2]
        with pytest.raises(InputError, match="position 2000 mm of axis x is outside 0 to 1000 mm"):
            machine.at(position=2.0)
        with pytest.raises(InputError, match="depends on the position of axis x; give one"):
            machine.at()

    def test_joints_add_their_small_signal_stiffness(self) -> None:
        bare = two_mass_axes({"x": Drive(23.1, 11.3, 1.0e6, 104.0)})
        across = np.array([1.0, -1.0])
        joints = [MountedJoint(Iwan(0.5e6, 200.0), across), MountedJoint(CubicSpring(0.18e6, 1e14), across)]
        joints.append(MountedJoint(Gap(1e9, 1e-6), across))
        axis = {"x": FeedAxis(K2, Viscous(168.0))}
        jointed, stiff = Machine(bare, axis, joints), Machine(two_mass_axes({"x": BENCH}), axis)
        np.testing.assert_allclose(jointed.at().matrix(F), stiff.at().matrix(F), rtol=1e-6)


class TestLinearisedFriction:
    LUGRE = LuGre(2e7, 800.0, 44.2, 84.0, 6.457e-3, 168.0)
    GMS = GeneralisedMaxwellSlip((1e7, 1e7), (0.4, 0.6), 44.2, 84.0, 6.457e-3, 168.0, 5e3)

    @pytest.mark.parametrize("law", [LUGRE, GMS])
    def test_slow_vibration_in_motion_has_the_slope_of_the_steady_curve(self, law) -> None:  # type: ignore[no-untyped-def]
        v, h = 4e-3, 1e-7
        slope = (law.steady_force(v + h) - law.steady_force(v - h)) / (2.0 * h)
        assert float((linearised(law, v)(1e-4j) / 1e-4j).real) == pytest.approx(float(slope), rel=1e-4)

    @pytest.mark.parametrize("law", [LUGRE, GMS])
    @pytest.mark.parametrize("frequency", [5.0, 60.0, 300.0])
    def test_equals_the_response_of_the_law_itself_to_a_small_vibration(self, law, frequency: float) -> None:  # type: ignore[no-untyped-def]
        v0, small, step = 4e-3, 2e-6, 2e-6
        periods = 6 + round(0.05 * frequency)
        t = np.arange(round((periods + 4) / frequency / step)) * step
        force = law.history(v0 + small * np.cos(2 * np.pi * frequency * (t - 0.5 * step)), step)
        tail = t >= t[-1] - 4.0 / frequency
        basis = np.exp(2j * np.pi * frequency * t[tail])
        design = np.stack([basis.real, -basis.imag, np.ones(basis.size)], axis=1)
        real, imaginary, _ = np.linalg.lstsq(design, force[tail], rcond=None)[0]
        s = 2j * np.pi * frequency
        expected = complex(linearised(law, v0)(s) / s)
        assert abs((real + 1j * imaginary) / small - expected) < 0.02 * abs(expected)

    def test_a_contact_at_rest_is_a_spring(self) -> None:
        for law, k in ((self.LUGRE, 2e7), (self.GMS, 2e7)):
            s = 2j * np.pi * 1e-3
            assert linearised(law, 0.0)(s) == pytest.approx(k, rel=1e-3)
        machine = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(K2, self.LUGRE)})
        poles = machine.at(0.0).poles()
        assert poles.size == 5
        assert np.all(poles.real < 0.0)

    def test_a_jump_at_rest_has_no_slope(self) -> None:
        with pytest.raises(InputError, match="jumps at rest"):
            linearised(CoulombViscous(44.0, 168.0), 0.0)
        assert linearised(CoulombViscous(44.0, 168.0), 0.01).direct == pytest.approx(168.0)


class TestStability:
    def test_a_machine_with_free_slides_is_not_unstable(self) -> None:
        free = Machine(two_mass_axes({"x": BENCH})).at()
        assert free.unstable_poles() == 0
        np.testing.assert_array_equal(free.compliance(F, ["x"], ["x"])["compliance"][:, 0, 0], free.matrix(F)[:, 0, 0])
        assert (
            Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(None, TABLE_1)}).at(50.0 * MM_MIN).unstable_poles() > 0
        )

    @pytest.mark.parametrize("delay", [0.0, 1e-3])
    def test_a_part_behind_a_play_is_not_unstable(self, delay: float) -> None:
        axis = FeedAxis(with_delay(K1, delay), Viscous(168.0))
        loose = two_mass_axes({"x": BENCH})
        loose = Structure(loose.mass, loose.damping, 0.0 * loose.stiffness, loose.tool, loose.slides)
        play = MountedJoint(Gap(BENCH.stiffness, 1e-9), [1.0, -1.0])
        machine = Machine(loose, {"x": axis}, [play])
        assert machine.at().unstable_poles() == 0
        # Against 1 um of motion a play of 1 nm is none.
        tight = Machine(two_mass_axes({"x": BENCH}), {"x": axis}).at().matrix([60.0, 80.0])[:, 0, 0]
        found = quasi_compliance(machine, [60.0, 80.0], 10.0, excitation=["x"], response=["x"])
        assert found.attrs["status"] == "ok"
        np.testing.assert_allclose(found["compliance"].values[:, 0, 0], tight, rtol=2e-3)

    def test_released_axes_may_be_some_and_in_any_order(self) -> None:
        drives = {"x": BENCH, "y": Drive(40.0, 11.3, 3e6, 300.0), "z": Drive(30.0, 11.3, 2e6, 300.0)}
        machine = Machine(two_mass_axes(drives), {a: FeedAxis(K1, Viscous(100.0)) for a in drives})
        axes = {a: machine.axes[a] for a in ("x", "z")}
        mass = {a: drives[a].moving_mass + 11.3 for a in ("x", "z")}
        idle = OperatingPoint(machine.structure_at().locked(), ()).compliance(F, ["z", "x"], ["z", "x"])
        released = released_compliance(idle, axes, mass, 11.3)["compliance"]
        for axis in ("x", "z"):
            exact = machine.at().matrix(F)[:, "xyz".index(axis), "xyz".index(axis)]
            np.testing.assert_allclose(released.sel(response=axis, excitation=axis), exact, rtol=1e-10)

    @pytest.mark.parametrize("feed", [{"y": 0.1}, {"x": np.nan}, np.inf])
    def test_a_feed_of_no_axis_and_one_that_is_no_number_are_refused(self, feed: object) -> None:
        idle = RAM.compliance(F)
        with pytest.raises(InputError, match="finite numbers"):
            released_compliance(idle, {"x": FeedAxis(K1)}, MASS, 600.0, feed)  # type: ignore[arg-type]
        with pytest.raises(InputError, match="feed"):
            Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(K1)}).at(feed)  # type: ignore[arg-type]

    def test_an_endless_mass_is_refused(self) -> None:
        with pytest.raises(InputError, match="moving mass inf kg"):
            released_compliance(RAM.compliance(F), {"x": FeedAxis(K1)}, {"x": np.inf}, 600.0)


def test_the_cause_of_an_unstable_loop_is_not_falling_friction() -> None:
    structure = two_mass_axes({"x": BENCH})
    machine = Machine(structure, {"x": FeedAxis(Servo(2e5, 1e-3, 200.0, 2e-3), TABLE_1)})
    with pytest.raises(InputError, match="Lower Kp or Kv"):
        machine.at(100 * MM_MIN).compliance(F)
