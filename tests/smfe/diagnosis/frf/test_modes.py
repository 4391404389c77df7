"""The modal baseline: closed forms against matrices of a machine, hidden effects named, and only those."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from exam.modal import ALL, NAMES, PAIRS, draw, family, machine, pair
from samples.isolability import isolability
from scipy.integrate import solve_ivp
from truth.imperfect.modal import Machine as Loose
from truth.imperfect.modal import State, in_time
from truth.modal_machine import (
    LINES,
    NOMINAL_LEVEL,
    TOP_SPEED,
    Hidden,
    Ram,
    Setting,
    at_tool,
    compliance,
    effect,
    modes,
    peak_shift,
)

from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.diagnosis.cases.experiments import PROPOSALS, proposed_modal_experiments
from smfe.diagnosis.frf._joint_kernels import _held
from smfe.diagnosis.frf.causes import vector
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.joint_in_hits import _law
from smfe.diagnosis.frf.modal_dynamics import DECAYING, _spent, full_compliance, joints, unchanged
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.fit import Fit, Target
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.judgement.declared import Released
from smfe.diagnosis.judgement.diagnose import diagnose, mounted_otherwise
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.materiality import Worth
from smfe.progress import silent

BARE = Hidden(cable=0.0)
STILL = Shaken("actuator", NOMINAL_LEVEL, 1.0)


def shapes(ram: Ram) -> np.ndarray:
    """Mode shapes of unit modal stiffness, (n, M)."""
    root = np.sqrt(np.diag(ram.mass))
    squares, turned = np.linalg.eigh(ram.stiffness / np.outer(root, root))
    return turned / root[:, None] / np.sqrt(squares)


def plain(ram: Ram) -> Changed:
    return unchanged(ModalModel(*modes(ram)))


def signs(ram: Ram) -> np.ndarray:
    """Of the shapes against the vectors of `modes`."""
    return np.sign(np.sum(shapes(ram)[:3].T * modes(ram)[3], axis=1))


def away(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


@pytest.fixture(scope="module", params=[0, 1, 2])
def ram(request: pytest.FixtureRequest) -> Ram:
    """Rams of four, three and five coordinates."""
    return machine(request.param)[0]


class TestClosedForms:
    """The same machine written down twice: modes here, matrices of mass, damping and stiffness there."""

    def test_the_modes_are_the_machine(self, ram: Ram) -> None:
        truth = compliance(ram, BARE, Setting(), LINES)
        assert away(full_compliance(plain(ram), LINES, STILL), truth) < 1e-10
        assert 1e-7 < away(truth, compliance(ram, Hidden(), Setting(), LINES)) < 1e-3  # the cable that always hangs

    def test_a_spring_that_changes(self, ram: Ram) -> None:
        spring, k = ram.springs[0]
        x = shapes(ram) * signs(ram)
        change = x.T @ (0.2 * k * np.outer(spring, spring)) @ x
        truth = compliance(ram, replace(BARE, posture=0.2), Setting(position=1.0), LINES)
        assert away(full_compliance(plain(ram)._replace(springs=tuple(change.ravel())), LINES, STILL), truth) < 1e-10

    def test_a_mass_at_the_tool(self, ram: Ram) -> None:
        truth = compliance(ram, replace(BARE, sensor_mass=5.0), Setting(), LINES)
        assert away(full_compliance(plain(ram)._replace(mass=5.0), LINES, STILL), truth) < 1e-10

    def test_a_rotor(self, ram: Ram) -> None:
        z = math.sqrt(ram.stiffness[0, 0] * ram.stiffness[1, 1]) / 60.0
        x = shapes(ram) * signs(ram)
        skew = np.outer(x[0], x[1]) - np.outer(x[1], x[0])
        truth = compliance(ram, replace(BARE, gyroscopic=0.1), Setting(speed=TOP_SPEED), LINES)
        found = full_compliance(plain(ram)._replace(gyroscopic=tuple((0.1 * z * skew).ravel())), LINES, STILL)
        assert away(found, truth) < 1e-10
        assert away(found, found.transpose(0, 2, 1)) > 0.01

    @pytest.mark.parametrize("level", [50.0, 200.0])
    def test_a_joint_that_hardens(self, ram: Ram, level: float) -> None:
        spring, k = ram.springs[0]
        typical = NOMINAL_LEVEL / k / 0.08
        v = (shapes(ram) * signs(ram)).T @ spring
        length = float(np.linalg.norm(v))
        joint = (0.02 * 0.75 * k * length**2, *(v / length))
        shaken = Shaken("actuator", level, typical / length)
        truth = at_tool(ram, replace(BARE, cubic=0.02), Setting(level=level), LINES)
        assert away(full_compliance(plain(ram)._replace(hardening=joint), LINES, shaken), truth) < 1e-7

    def test_rayleighs_law_and_elements_that_slip_differ_a_little(self, ram: Ram) -> None:
        spring, k = ram.springs[0]
        typical = NOMINAL_LEVEL / k / 0.08
        v = (shapes(ram) * signs(ram)).T @ spring
        length = float(np.linalg.norm(v))
        # Limits even from 0 to 8: at the amplitude a the share a/16 of the stiffness is lost.
        joint = (0.5 * k * length**2 / 16.0, *(v / length))
        truth = at_tool(ram, replace(BARE, slip=0.5), Setting(), LINES)
        found = full_compliance(plain(ram)._replace(slip=joint), LINES, Shaken("actuator", 100.0, typical / length))
        linear = full_compliance(plain(ram), LINES, STILL)
        assert 1e-6 < away(found, truth) < 0.02
        assert away(found, truth) < 0.1 * away(linear, truth)

    @pytest.mark.parametrize("limit", [8.0, 0.7])
    def test_elements_that_all_slip_at_a_travel_are_those_of_the_ram(self, ram: Ram, limit: float) -> None:
        """A hundred Jenkins elements there, the closed form of infinitely many here; below their travel and beyond."""
        spring, k = ram.springs[0]
        typical = NOMINAL_LEVEL / k / 0.08
        v = (shapes(ram) * signs(ram)).T @ spring
        length = float(np.linalg.norm(v))
        level = NOMINAL_LEVEL * 8.0 / limit  # travels there are even up to eight times the typical amplitude
        truth = at_tool(ram, replace(BARE, slip=0.3), Setting(level=level), LINES)
        joint = (0.3 * k * length**2, 8.0, *(v / length))
        found = full_compliance(plain(ram)._replace(iwan=joint), LINES, Shaken("actuator", level, typical / length))
        linear = full_compliance(plain(ram), LINES, STILL)
        assert away(found, truth) < 1e-3 < 0.01 < away(linear, truth)

    def test_a_hit_is_a_decaying_vibration(self) -> None:
        f, z, k = 40.0, 0.02, 1e7
        w, level, strength = 2.0 * math.pi * f, 2.0, 0.1
        start = level * w / math.sqrt(k)  # amplitude after the hit in scaled coordinates

        def motion(hard: float, t: np.ndarray) -> np.ndarray:
            def rate(_: float, y: np.ndarray) -> list[float]:
                q = y[0] * math.sqrt(k) / start
                return [y[1], -(w**2) * y[0] * (1.0 + hard / 0.75 * q**2) - 2.0 * z * w * y[1]]

            begin = [0.0, level * w**2 / k]
            return np.asarray(solve_ivp(rate, (0.0, t[-1]), begin, t_eval=t, rtol=1e-8, atol=1e-14).y[0])

        t = np.arange(0.0, 2.0, 5e-4)
        lines = np.linspace(36.0, 46.0, 41)
        turn = np.exp(-2j * np.pi * np.outer(lines, t)) * 5e-4
        truth, linear = (turn @ motion(hard, t) / level for hard in (strength, 0.0))
        one = Changed((f,), (z,), (k,), (1.0, 0.0, 0.0), hardening=(strength, 1.0))
        found = full_compliance(one, lines, Shaken("hammer", level, start))[:, 0, 0]
        assert away(found, truth) < 0.5 * away(linear, truth)
        followed = full_compliance(one, lines, Shaken("hammer", level, start, duration=1e-4))[:, 0, 0]
        assert away(followed, truth) < 0.05 * away(linear, truth)
        decay = np.exp(-z * w * t)
        means = [float(np.sum(decay ** (2 + n)) / np.sum(decay**2)) for n in (1, 2)]
        assert means == pytest.approx(list(DECAYING), rel=0.01)

    @pytest.mark.parametrize("law", ["cubic", "elements"])
    def test_a_joint_is_followed_through_a_hit(self, law: str) -> None:
        """Matrices, Runge-Kutta and sixteen Jenkins elements there: one stiffness leaves a third of what they do."""
        built, rate, level = machine(1)[0], 8000.0, 2.0
        spring, k = built.springs[0]
        v = (shapes(built) * signs(built)).T @ spring
        length = float(np.linalg.norm(v))
        travel = 2.0 * level / math.sqrt(k * 90.0)
        loose = Loose(built, np.zeros((3, len(spring))), travel=travel)
        loose = replace(loose, **({"hard": 0.8 * k / travel**2} if law == "cubic" else {"loose": 0.3}))
        t = np.arange(round(1.5 * rate)) / rate
        force = np.zeros((len(spring), t.size))
        force[0] = np.where(t < 4e-3, np.sin(np.pi * t / 4e-3), 0.0)
        force[0] *= level * rate / force[0].sum()
        turn = np.exp(-2j * np.pi * np.outer(LINES, t))
        truth = (turn @ in_time(loose, State(), force, rate)[:3].T) / (turn @ force[0])[:, None]
        truth = truth / -((2.0 * np.pi * LINES[:, None]) ** 2)
        if law == "cubic":
            joint = {"hardening": (0.8 * 0.75 * k * length**2, *(v / length))}
        else:
            joint = {"iwan": (0.3 * k * length**2, 1.0, *(v / length))}
        changed = plain(built)._replace(**joint)  # type: ignore[arg-type]
        linear, one, found = (
            full_compliance(m, LINES, Shaken("hammer", level, travel / length, duration=d))[:, :, 0]
            for m, d in ((plain(built), 0.0), (changed, 0.0), (changed, 4e-3))
        )
        hits = Shaken("hammer", 3.0, travel / length, impulses=(level, 2.0, 3.0), duration=4e-3)
        assert away(full_compliance(changed, LINES, hits)[:, :, 0], found) < 1e-12  # each axis by its own hits
        assert away(linear, truth) > 0.1
        assert away(found, truth) < 0.06 * away(linear, truth)
        assert away(one, truth) > 0.2 * away(linear, truth)

    def test_what_is_not_a_machine_is_refused(self, ram: Ram) -> None:
        count = ram.mass.shape[0]
        with pytest.raises(InputError, match="does not stand"):
            full_compliance(plain(ram)._replace(springs=tuple((-1.1 * np.eye(count)).ravel())), LINES, STILL)

    def test_spherical_angles_give_unit_vectors(self) -> None:
        for angles in product((-1.0, 0.3, 2.0), repeat=3):
            assert np.linalg.norm(vector(angles)) == pytest.approx(1.0, abs=1e-14)
        assert vector(()) == (1.0,)


@pytest.fixture(scope="module")
def null() -> ModalFrfs:
    """A campaign of the full design with nothing hidden, three modes."""
    return family(None, 1)[0]


def start(fam: ModalFrfs) -> dict[str, float]:
    return {p.name: p.start for p in (*fam.nuisances, *(q for c in fam.causes for q in c.parameters))}


def prediction(fam: ModalFrfs, k: int, **more: float) -> np.ndarray:
    return fam.predict(fam.conditions[k], start(fam) | more)


class TestFamily:
    def test_every_cause_at_its_null_leaves_the_baseline(self, null: ModalFrfs) -> None:
        values = {p.name: p.start for p in null.nuisances}
        for c in (*null.conditions, *proposed_modal_experiments(null.conditions)):
            assert isinstance(c.data, Excited)
            alone = null.predict(c, values)
            for cause in null.causes:
                same = null.predict(c, values | {p.name: p.start for p in cause.parameters})
                np.testing.assert_allclose(same, alone, rtol=0.0, atol=1e-10)
            if "free_mass" not in c.settings:
                truth = c.data.whitened(
                    np.stack(
                        [null.model.matrix(c.data.frequency)[:, "xyz".index(r), "xyz".index(e)] for r, e in ALL], 1
                    )
                )
                np.testing.assert_allclose(alone, truth, rtol=0.0, atol=1e-9 * np.abs(truth).max())

    def test_every_parameter_of_a_cause_does_something_somewhere(self, null: ModalFrfs) -> None:
        """Shapes (angles, frequencies) only once there is a size."""
        for cause in null.causes:
            given = cause.starts[0] if cause.starts else [p.start + p.scale for p in cause.parameters]
            at = start(null) | {p.name: v for p, v in zip(cause.parameters, given, strict=True) if p.unit != "0/1"}
            for p in cause.parameters:
                moved = at | {p.name: at[p.name] + (1.0 if p.unit == "0/1" else 0.5 * p.scale)}
                assert any(np.abs(null.predict(c, moved) - null.predict(c, at)).max() > 1e-3 for c in null.conditions)

    def test_physics_is_reciprocal_but_for_rotors_and_sensors_are_not(self, null: ModalFrfs) -> None:
        fast = next(k for k, c in enumerate(null.conditions) if c.settings.get("spindle_speed") == TOP_SPEED)

        def broken(**more: float) -> float:
            data = null.conditions[fast].data
            assert isinstance(data, Excited)
            y = data.compliance_of(prediction(null, fast, **more)).reshape(-1, 3, 3)
            return float(np.abs(y - y.transpose(0, 2, 1)).max() / np.abs(y).max())

        for name in ("posture_12", "drift_12", "bearings_12", "sensor_mass", "turn_a_1", "residual_xy", "gain_force"):
            assert broken(**{name: 0.01}) < 1e-9
        for name in ("gyroscopic_12", "gain_x", "exchanged_xy", "turned_z", "talk_xy", "lean_yz", "reach_x"):
            assert broken(**{name: 1.0 if name == "exchanged_xy" else 0.05}) > 1e-4

    def test_a_free_mass_gives_its_mass_and_the_gains(self, null: ModalFrfs) -> None:
        k = next(k for k, c in enumerate(null.conditions) if "free_mass" in c.settings)
        data, mass = null.conditions[k].data, float(null.conditions[k].settings["free_mass"])
        assert isinstance(data, Excited)
        rigid = np.zeros((data.frequency.size, 3, 3), dtype=complex)
        rigid[:, [0, 1, 2], [0, 1, 2]] = (-1.0 / (mass * (2.0 * np.pi * data.frequency) ** 2))[:, None]
        np.testing.assert_allclose(prediction(null, k), data.whitened(rigid.reshape(-1, 9)), atol=1e-9)
        # A force sensor that shows a tenth too much makes the mass look a tenth heavier.
        np.testing.assert_allclose(prediction(null, k, gain_force=0.1), prediction(null, k) / 1.1, atol=1e-9)
        for name in ("posture_11", "scale_error", "mass_error", "turn_a_1"):
            np.testing.assert_array_equal(prediction(null, k, **{name: 0.1}), prediction(null, k))

    def test_a_laser_has_no_mass_and_no_axes(self, null: ModalFrfs) -> None:
        k = next(k for k, c in enumerate(null.conditions) if c.settings.get("sensor") == "laser")
        for name in ("sensor_mass", "gain_x", "exchanged_xy", "turned_z", "talk_xy", "reversed_x"):
            np.testing.assert_array_equal(prediction(null, k, **{name: 1.0}), prediction(null, k))
        two = replace(
            null, conditions=tuple(replace(c, settings=c.settings | {"sensor": "two"}) for c in null.conditions)
        )
        np.testing.assert_array_equal(prediction(two, 0, sensor_mass=0.5), prediction(null, 0, sensor_mass=1.0))

    @pytest.mark.parametrize("keys", [(), ("joint_micro_slip",), ("joint_micro_slip/iwan", "joint_hardening")])
    def test_slopes_in_closed_form_are_those_of_differences(self, null: ModalFrfs, keys: tuple[str, ...]) -> None:
        """With rotors, a mass, a further mode and sensors that are off; sizes at their null but for the joints."""
        hit = [replace(c, data=replace(c.data, method="hammer")) for c in null.conditions]  # type: ignore[type-var]
        fam, rng = replace(null, conditions=tuple(hit)), np.random.default_rng(1)
        model = Model(fam, fam.conditions)
        u = model.null()
        u[model.nuisance] = 0.3 * rng.standard_normal(model.nuisance.size)
        for k, cause in enumerate(model.causes):
            if cause.key in keys:
                given = (np.array(cause.starts[0]) - model.start[model.of_cause[k]]) / model.scale[model.of_cause[k]]
                u[model.of_cause[k]] = given + 0.2 * rng.uniform(size=given.size)
            elif cause.id in ("posture", "spindle_speed_dynamics", "accelerometer_mass") or (
                cause.key == "missing_mode/in band" and not keys
            ):
                u[model.of_cause[k]] = 0.2 * rng.uniform(size=len(cause.parameters))
        u = np.clip(u, model.low, model.high)
        found = fam.slopes(model.conditions, model.values(u), model.parameters)
        assert found is not None
        sign = [p for p in model.parameters if p.name == "reversed_x"]
        assert all(not np.any(x) for x in fam.slopes(model.conditions, model.values(u), sign) or [np.ones(1)])
        values, step = model.values(u), 1e-4
        for j, p in enumerate(model.parameters):
            # What is on its bound moves one way only, in proportion as far as it goes here.
            sides = [max(values[p.name] - step * p.scale, p.low), min(values[p.name] + step * p.scale, p.high)]
            for c, slope in zip(model.conditions, found, strict=True):
                below, above = (fam.predict(c, values | {p.name: x}) for x in sides)
                told = (above - below) * p.scale / (sides[1] - sides[0])
                far = np.linalg.norm(told)
                # Elements begin to slip one after another, which a travel moves and a size does not.
                near = 5e-2 if p.name == "joint_iwan_travel" else 2e-3
                assert np.linalg.norm(slope[:, j] - told) < near * far + 1e-5, (p.name, c.name)

    def test_elements_that_slip_are_never_more_than_the_stiffness_there_is(self, null: ModalFrfs) -> None:
        """A machine that loses more than it has pushes itself away: 8e10 m/N after a hit ten times as hard."""
        values = start(null) | {"joint_iwan_travel": 30.0}
        for lost in (0.01, 0.1, 1.0):
            machine = null.changed(null.conditions[0], values | {"joint_iwan": lost})
            (steady,) = joints(machine)
            assert steady.size <= 0.95
            # Small vibration loses as much as it did, in a hit as under a sine.
            assert steady.law(steady.size, np.array([0.3]), np.zeros(1)).real == pytest.approx(-0.3 * lost)
            _, count, each, apart = _law(machine, 1.0)
            assert 0.0 < count * each <= 0.95
            assert each / (2.0 * apart) == pytest.approx(min(lost, 0.95 / 1.5))

    def test_a_joint_that_a_sine_shakes_has_no_slopes_in_closed_form(self, null: ModalFrfs) -> None:
        joint = next(p for c in null.causes for p in c.parameters if p.name == "joint_micro_slip")
        sines = [c for c in null.conditions if isinstance(c.data, Excited) and c.data.method == "actuator"]
        assert sines
        assert null.slopes(sines, start(null), [joint]) is None
        assert null.slopes(sines, start(null), null.nuisances) is not None

    def test_bounds_exclude_what_is_not_physics(self, null: ModalFrfs) -> None:
        low = {p.name: p.low for c in null.causes for p in c.parameters} | {p.name: p.low for p in null.nuisances}
        for name in ("sensor_mass", "joint_micro_slip", "joint_hardening", "mode_compliance", "residual_xx"):
            assert low[name] == 0.0
        assert all(low[f"{n}_1"] > 0.0 for n in ("frequency", "damping", "stiffness"))
        with pytest.raises(InputError, match="not a compliance"):
            replace(null, conditions=(Condition("forces", {}, np.zeros(3)),))
        with pytest.raises(InputError, match="no compliance"):
            _ = replace(null, conditions=()).causes

    def test_what_could_be_measured_is_not_measured_already(self, null: ModalFrfs) -> None:
        names = [c.name for c in proposed_modal_experiments(null.conditions)]
        assert not any("laser" in n or "spindle" in n or "free mass" in n for n in names)
        bare = [replace(c, settings={}) for c in null.conditions[:1]]
        names = [c.name for c in proposed_modal_experiments(bare)]
        assert any("laser" in n for n in names)
        assert f"a free mass of {PROPOSALS.free_mass:g} kg in the machine's place" in names
        assert proposed_modal_experiments(()) == ()

    def test_a_mode_that_nobody_declared_is_found_between_those_declared_a_little_off(self) -> None:
        """Modes half a per cent off leave more than that mode: a fit without it leans the hits by tens of degrees.

        A fit with it finds it from what was declared, though it begins there with far more left than that fit leaves.
        """
        bench = tapped([0, 1, 3, 4], np.eye(3))
        null, found = with_cause(bench, "missing_mode/in band")
        assert found.converged
        assert found.chi2 < 1.1 * bench.values < 0.5 * null.chi2
        values = bench.model.values(found.u)
        assert values["mode_frequency"] == pytest.approx(83.0, abs=0.1)
        assert values["mode_damping"] == pytest.approx(0.018, rel=0.02)

    @pytest.mark.parametrize("way", [1.0, -1.0])
    @pytest.mark.slow
    def test_an_accelerometer_turned_by_a_right_angle_is_no_exchange(self, way: float) -> None:
        """About z by 90 degrees x shows y and y shows -x; of an exchange alone the sign of one is wrong."""
        bench = tapped([0, 1, 2, 3, 4], np.array([[0.0, way, 0.0], [-way, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        null, found = with_cause(bench, "sensor_axis/quarter_xy")
        assert found.converged
        assert found.chi2 < min(1.1 * bench.values, 0.1 * null.chi2)
        assert way * bench.model.values(found.u)["quarter_xy"] > 0.5
        exchanged = with_cause(bench, "sensor_axis/exchanged_xy")[1]
        assert exchanged.chi2 > 5.0 * found.chi2

    def test_exchanged_axes_stand_for_a_sensor_that_is_turned_further_than_any(self) -> None:
        """Hits along x and y alone do not tell both apart by what is left."""
        exchanged = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        bench = tapped([0, 1, 2], exchanged, THREE, [e for e in ALL if e[1] != "z"])
        turned = [Released(("sensor_axis",), 30.0, ({0: 45.0, 1: 45.0},), ({0: 1.0, 1: 1.0},))]
        as_well = replace(bench.null(), chi2=bench.values)
        found = mounted_otherwise(bench, as_well, turned, Worth(0.05))
        assert found is not None
        assert [bench.model.causes[k].variant for k in found.causes] == ["exchanged_xy"]
        assert found.chi2 < 1.1 * bench.values
        assert mounted_otherwise(bench, replace(as_well, chi2=0.8 * bench.values), turned, Worth(0.05)) is None
        assert mounted_otherwise(bench, as_well, [replace(turned[0], given=("modal_scale",))], Worth(0.05)) is None

    @pytest.mark.slow
    def test_a_design_without_contrast_does_not_separate_two_causes(self) -> None:
        """To first order, before any data."""
        both = {"posture", "drift"}
        before, after = (isolability(pair("posture or drift", 0, 1, settled)[0]).groups for settled in (False, True))
        assert any(both <= set(g) for g in before)
        assert not any(both <= set(g) for g in after)


FIVE = ModalModel(
    np.array([42.0, 58.5, 83.0, 121.0, 176.0]),
    np.array([0.022, 0.03, 0.018, 0.025, 0.02]),
    np.array([38e6, 52e6, 60e6, 85e6, 150e6]),
    np.array([[0.95, 0.2, 0.1], [-0.25, 0.92, 0.2], [0.6, -0.55, 0.35], [0.3, 0.75, -0.5], [0.5, 0.3, 0.8]]),
)
THREE = ModalModel(
    np.array([41.0, 63.0, 118.0]),
    np.array([0.03, 0.025, 0.03]),
    np.array([28e6, 35e6, 60e6]),
    np.array([[0.99, 0.15, 0.05], [-0.1, 0.98, 0.2], [0.74, 0.64, 0.21]]),
)


def tapped(
    declared: list[int], mounting: np.ndarray, true: ModalModel = FIVE, entries: Sequence[tuple[str, str]] = ALL
) -> Bench:
    """Three sets of hits, seen through a mounting; modes are declared half a per cent off, or not."""
    lines, rng = np.linspace(21.0, 350.0, 117), np.random.default_rng(3)
    phi = (mounting @ true.matrix(lines)).reshape(117, 9)[:, [ALL.index(e) for e in entries]]
    std = 0.01 * np.sqrt(np.mean(np.abs(phi) ** 2, axis=0)) * np.ones((117, 1))
    hit = Excited(lines, tuple(entries), std, "hammer", 1.0)
    noise = rng.standard_normal((2, 3, *phi.shape)) * std / math.sqrt(2.0)
    seen = [hit.whitened(phi + a + 1j * b) for a, b in zip(*noise, strict=True)]
    conditions = tuple(Condition(f"hits {n}", {}, y, "", hit) for n, y in enumerate(seen))
    off = np.array(true.frequency) * (1.0 + 0.005 * np.array([1.0, -1.0, 1.0, 1.0, -1.0]))[: len(true.frequency)]
    damping, stiffness, shape = (np.array(x)[declared] for x in (true.damping, true.stiffness, true.direction))
    said = ModalModel(off[declared], damping, stiffness, shape)
    fam = ModalFrfs(said, conditions, stated=("frequency", "damping", "stiffness")).with_errors()
    one = Model(fam, fam.conditions)
    target = Target({r: np.asarray(c.observed) for r, c in enumerate(fam.conditions)}, one.null())
    return Bench(one, target, 0, silent)


@pytest.mark.parametrize(("degrees", "verdict"), [(1.0, "consistent"), (6.0, "named")])
@pytest.mark.slow
def test_declared_directions_are_known_to_a_degree_or_two(degrees: float, verdict: str) -> None:
    """One degree changes the limits of depth by 8 %, and is what a workshop or a finite element model is off by."""
    fam = tapped([0, 1, 2, 3, 4], np.eye(3)).model.family
    assert isinstance(fam, ModalFrfs)
    true, rng = np.array(fam.model.direction), np.random.default_rng(4)
    length = np.linalg.norm(true, axis=1)[:, None]
    off = true / length + math.tan(math.radians(degrees)) * np.clip(rng.standard_normal(true.shape), -2.0, 2.0)
    off *= length / np.linalg.norm(off, axis=1)[:, None]
    found = diagnose(replace(fam, model=replace(fam.model, direction=off)), 0, worth=Worth(0.05))
    shown = found.immaterial if verdict == "consistent" else found.causes
    assert (found.verdict, [c.id for c in shown]) == (verdict, ["cross_axis_coupling"])
    assert shown[0].size > 0.05


def with_cause(bench: Bench, key: str) -> tuple[Fit, Fit]:
    """Fits of the baseline and of one cause."""
    null = bench.null()
    return null, bench.extend(null, (next(k for k, c in enumerate(bench.model.causes) if c.key == key),))


def named(fam: ModalFrfs, seed: int) -> tuple[str, set[str]]:
    found = diagnose(fam, seed)
    return found.verdict, {c.id for c in found.causes}


class TestHidden:
    @pytest.mark.slow
    def test_sizes_are_those_that_must_be_found(self) -> None:
        built, rng = machine(1)[1:]
        slip, hard = effect("micro_slip", built, rng), effect("hardening", built, rng)
        assert peak_shift(built, slip, (NOMINAL_LEVEL, 2.0 * NOMINAL_LEVEL))[0] == pytest.approx(-0.05, abs=0.002)
        assert peak_shift(built, hard, (0.5 * NOMINAL_LEVEL, 2.0 * NOMINAL_LEVEL))[1] == pytest.approx(0.03, abs=0.003)

    @pytest.mark.slow
    def test_nothing_is_wrong_where_nothing_is(self, null: ModalFrfs) -> None:
        assert named(null, 1) == ("consistent", set())

    @pytest.mark.slow
    @pytest.mark.parametrize(("hidden", "size"), [("posture", 1.0), ("gain", 1.6)])
    def test_an_effect_is_named(self, hidden: str, size: float) -> None:
        """Of a gain 8 %: 5 % are not borne out where two sensors and the place of hits are 1 % off each."""
        assert named(family(hidden, 1, size=size)[0], 1) == ("named", {NAMES[hidden]})

    @pytest.mark.exam
    def test_every_effect_is_named_or_at_least_no_other(self) -> None:
        """One in four; the exam has them all, seed by seed."""
        wrong, right, asked = [], 0, RELIABLE[1::4]
        for k, hidden in enumerate(asked):
            verdict, causes = named(family(hidden, 300 + k)[0], k)
            right += (verdict, causes) == ("named", {NAMES[hidden]})
            if verdict == "named" and causes != {NAMES[hidden]}:
                wrong.append((hidden, causes))
        assert not wrong
        assert right >= len(asked) - 1

    @pytest.mark.exam
    def test_no_false_alarms(self) -> None:
        """The exam has more; more than one of 4 would be less likely than 1 in 400 at 2 %."""
        alarms = sum(
            named(family(None, 5000 + s, (40.0, 30.0, 20.0)[s % 3])[0], s)[0] != "consistent" for s in range(4)
        )
        assert alarms <= 1

    @pytest.mark.exam
    @pytest.mark.parametrize("k", [0, 1])
    def test_without_the_true_cause_the_answer_is_unknown(self, k: int) -> None:
        hidden = RELIABLE[12 * k]
        verdict, _ = named(family(hidden, 400 + k, without=(NAMES[hidden],))[0], k)
        assert verdict in ("unknown", "insufficient_data")

    @pytest.mark.exam
    @pytest.mark.parametrize("both", [("posture", "gain"), ("drift", "skew")])
    def test_two_effects_are_both_named(self, both: tuple[str, str]) -> None:
        assert named(draw(both, 600)[0], 0) == ("named", {NAMES[b] for b in both})

    @pytest.mark.exam
    def test_motion_along_x_alone_makes_the_answer_vaguer_and_not_wrong(self) -> None:
        hidden = "turned"
        found = diagnose(draw(hidden, 700, entries=(("x", "x"),))[0], 0)
        assert found.verdict != "named" or {c.id for c in found.causes} == {NAMES[hidden]}


RELIABLE = [n for n in NAMES if n not in ("scale", "mass")]
"""A wrong scale or mass of all modes changes no contrast: it is only compared with the priors of the baseline."""


class TestConfounded:
    @pytest.mark.exam
    @pytest.mark.parametrize("which", [0, 1])
    def test_posture_and_drift_are_a_set_until_the_first_position_is_measured_again(self, which: int) -> None:
        fam, truth = pair("posture or drift", which, 2, False)
        before = diagnose(fam, 0)
        assert before.verdict == "ambiguous"
        assert {c.id for c in before.alternatives[0]} == {"posture", "drift"}
        assert before.next_experiment is not None
        assert before.next_experiment.probability > 0.9
        assert named(pair("posture or drift", which, 2, True)[0], 0) == ("named", {truth})

    @pytest.mark.exam
    @pytest.mark.parametrize(("name", "which"), [*product([n for n in PAIRS if n != "posture or drift"], (0, 1))])
    def test_the_others_are_never_taken_for_each_other(self, name: str, which: int) -> None:
        for settled in (False, True):
            fam, truth = pair(name, which, 3, settled)
            verdict, causes = named(fam, 0)
            # What was declared and the data do not separate is named as a set.
            assert verdict != "named" or truth in causes
            if settled and truth not in ("modal_mass", "modal_scale"):
                assert (verdict, causes) == ("named", {truth})

    @pytest.mark.exam
    def test_permuted_labels_give_no_gain(self) -> None:
        gains = []
        for seed in range(8):
            fam = draw(None, 800 + seed)[0]
            labels = np.random.default_rng(seed).permutation(len(fam.conditions))
            machine_only = [c for c in fam.conditions if "free_mass" not in c.settings]
            order = [j for j in labels if j < len(machine_only)]
            mixed = tuple(
                replace(c, settings=machine_only[j].settings) for c, j in zip(machine_only, order, strict=True)
            )
            fam = replace(fam, conditions=mixed)
            model = Model(fam, mixed)
            target = Target({r: np.asarray(c.observed) for r, c in enumerate(mixed)}, model.null())
            bench = Bench(model, target, seed, lambda *_: None)
            posture = next(k for k, c in enumerate(model.causes) if c.id == "posture")
            at = bench.extend(bench.null(), (posture,))
            gain = bench.gain(bench.null(), bench.confirmed(at))
            assert bench.null().chi2 - at.chi2 - RULES.penalty * 6 < 60.0
            gains.append(0.0 if gain is None else gain.db)
        assert np.median(gains) <= 0.3


def test_elements_of_a_joint_remember_the_reversals_of_its_motion():
    """Force by the reversals alone, of any motion, as of elements that stick and slip each by itself."""
    count, stiffness, travel = 40, 0.02, 0.05
    most = stiffness * travel * (np.arange(count) + 0.5)
    rng = np.random.default_rng(4)
    motion = np.cumsum(rng.standard_normal(3000)) * 0.15 * np.exp(-np.arange(3000) / 900.0)
    turned, there, held = np.zeros(3001), np.zeros(3001), np.zeros(count)
    before, force, depth = 0.0, 0.0, 0
    for now in motion:
        held = np.clip(held + stiffness * (now - before), -most, most)
        force, depth = _held(now, before, force, depth, turned, there, count, stiffness, travel)
        assert force == pytest.approx(held.sum(), abs=1e-12)
        before = now
    assert depth > 2


def test_a_joint_at_rest_has_lost_nothing_and_one_that_slides_loses_all():
    lost = _spent(1e-3, 0.3, np.array([0.0, 1e3]), np.zeros(2))
    assert abs(lost[0]) < 1e-12
    assert lost[1].real == pytest.approx(-0.3, rel=0.01)


def mode_sum(frequency: np.ndarray, found: list[tuple[float, float, float, tuple[float, float, float]]]) -> np.ndarray:
    """Compliance of modes (natural frequency, damping ratio, stiffness, direction), shape (f, 3, 3)."""
    out = np.zeros((frequency.size, 3, 3), dtype=complex)
    for natural, damping, stiffness, along in found:
        unit = np.array(along) / np.linalg.norm(along)
        ratio = frequency[:, None, None] / natural
        out += np.outer(unit, unit) / (stiffness * (1.0 - ratio**2 + 2j * damping * ratio))
    return out


@pytest.mark.slow
def test_a_mode_that_nobody_declared_is_found_however_far_the_fit_without_it_goes_astray() -> None:
    """Without it hits that lean by 50 degrees take up most of the mode, in a minimum from which no slope leads back."""
    true, gone = (
        [(41.0, 0.03, 28e6, (1, 0.15, 0.05)), (63.0, 0.025, 35e6, (-0.1, 1, 0.2))],
        (118.0, 0.03, 6e7, (0.7, 0.6, 0.2)),
    )
    rng = np.random.default_rng(5)
    lines = np.linspace(0.5 * true[0][0], 2.0 * true[-1][0], 110)
    entries = tuple(product("xy", "xy"))
    seen = np.stack([mode_sum(lines, [*true, gone])[:, "xyz".index(r), "xyz".index(e)] for r, e in entries], axis=1)
    noise = 0.02 * np.sqrt(np.mean(np.abs(seen) ** 2))
    conditions = []
    for k in range(3):
        std = np.hypot(noise * np.ones(seen.shape) / 5.0, 0.002 * np.abs(seen))
        excited = Excited(lines, entries, std, "hammer", 0.5 * (1.0 + k % 2), repeats=5)
        drawn = seen + std * (rng.standard_normal((2, *seen.shape)).T @ [1.0, 1j]).T / math.sqrt(2.0)
        conditions.append(Condition(f"set_{k}", {"level": excited.level}, excited.whitened(drawn), "", excited))
    off = rng.standard_normal((3, len(true)))
    declared = ModalModel(
        [f * (1.0 + 0.003 * x) for (f, *_), x in zip(true, off[0], strict=True)],
        [z * (1.0 + 0.05 * x) for (_, z, *_), x in zip(true, off[1], strict=True)],
        [k * (1.0 + 0.02 * x) for (_, _, k, _), x in zip(true, off[2], strict=True)],
        [np.array(d) / np.linalg.norm(d) for *_, d in true],
    )
    spread = {"frequency": 0.01, "damping": 0.15, "stiffness": 0.05}
    found = diagnose(
        ModalFrfs(declared, tuple(conditions), spread=spread, stated=tuple(spread)).with_errors(), workers=1
    )
    assert [c.id for c in found.causes] == ["missing_mode"]
    assert found.verdict == "named"
    (frequency,) = (p.value for p in found.causes[0].parameters if p.name == "mode_frequency")
    assert frequency == pytest.approx(gone[0], rel=0.005)
