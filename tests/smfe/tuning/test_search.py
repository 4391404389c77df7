"""The search for gains: against a dumb grid, against limits checked in plain numpy, and what it refuses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import smfe
from process import Andersson, Drive, FeedAxis, Machine, ModalModel, Servo, Tool, Viscous, released_modes, tune
from process.errors import InputError
from process.labels import make_compliance
from process.types import Complex, Real
from smfe.reporting.tuning import draw_tuning
from smfe.tuning import judge, result
from smfe.tuning.result import Tuning
from stability import semi_discretization

TOOL = {"diameter": "50.8 mm", "teeth": 4}
ALUMINIUM = {"Ktc": "780 N/mm^2", "Krc": "351 N/mm^2"}
ASKED: dict[str, Any] = {"goal": "least_depth", "spindle_speed": (800.0, 2500.0), "cut": "up", "width_of_cut": 0.0508}
PRESENT = {f"K{i}": tune(f, 34.4) for i, f in enumerate((15.0, 29.0, 49.0, 87.0), 1)}
MASS, TIP, STIFFNESS, DAMPING = 23.1, 11.3, 1.68e6, 104.0
FREQUENCY = np.concatenate(
    [np.geomspace(0.05, 15.0, 300), np.linspace(15.1, 250.0, 3000), np.geomspace(251.0, 5e3, 300)]
)


def bench(delay: float = 0.0) -> Machine:
    servos = {name: Servo(v.Kp, v.Ti, v.Kv, delay) for name, v in PRESENT.items()}
    drive = Drive(MASS, TIP, STIFFNESS, DAMPING)
    machine = Machine.of_axis(drive)
    return Machine(machine.structure, {"x": FeedAxis(servos, Viscous(0.0))})


def by_hand(kp: float, ti: float, kv: float, delay: float, f: Real = FREQUENCY) -> tuple[Complex, Complex, Complex]:
    """Closed velocity loop, closed position loop without feed-forward, and compliance of the tip: Eqs. (2) to (4)."""
    s = 2j * np.pi * f
    joint = DAMPING * s + STIFFNESS
    tip = TIP * s**2 + joint
    free = tip / ((MASS * s**2 + joint) * tip - joint**2)
    c = kp * (1.0 + 1.0 / (ti * s)) * np.exp(-s * delay)
    velocity = c * s * free / (1.0 + c * s * free)
    position = kv * c * free / (1.0 + (s + kv) * c * free)
    g = (s + kv) * c
    return velocity, position, (MASS * s**2 + joint + g) / (tip * (MASS * s**2 + joint + g) - joint**2)


def least_by_hand(phi: Complex, f: Real = FREQUENCY) -> float:
    """Least depth [mm] over 800 to 2500 rpm in a slot with four teeth: ``-1/(2 Krc Re Phi)``, lobe by lobe."""
    inside = phi.real < 0.0
    depth, theta = -500.0 / (351e6 * phi.real[inside]), np.pi + 2.0 * np.angle(-phi[inside])
    best = np.inf
    for lobe in range(12):
        speed = 60.0 * 2.0 * np.pi * f[inside] / (4.0 * (theta + 2.0 * np.pi * lobe))
        within = (speed >= 800.0) & (speed <= 2500.0)
        best = min(best, float(depth[within].min(initial=np.inf)))
    return best


@pytest.fixture(scope="module", params=[0.0, 0.75e-3])
def found(request: pytest.FixtureRequest) -> tuple[Tuning, float]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result, "FRONTIER", 2)
        return smfe.tune(bench(request.param), tool=TOOL, material=ALUMINIUM, robust=0.0, **ASKED), request.param


@pytest.mark.slow
def test_the_bench_is_tuned_beyond_its_rule_and_its_controllers(found: tuple[Tuning, float]) -> None:
    """2.10 mm without and 2.60 mm with dead time; the rule gives 1.801 mm; the paper's sets lack 15 to 65 %."""
    answer, delay = found
    if delay:
        assert 1e3 * answer.best.goal >= 2.60
    else:
        assert 1e3 * answer.best.goal >= 2.10
        assert answer.rule is not None
        assert 1e3 * answer.rule.goal == pytest.approx(1.801, abs=0.002)
        short = [round(100.0 * answer.shortfall(one)) for one in answer.present]
        np.testing.assert_allclose(short, [49, 26, 15, 65], atol=1)
    assert not answer.warnings
    assert answer.confirmed is None
    assert any("exact" in note for note in answer.notes)


@pytest.mark.slow
def test_limits_and_depth_hold_when_worked_out_by_hand(found: tuple[Tuning, float]) -> None:
    answer, delay = found
    v = answer.servos["x"]
    velocity, position, phi = by_hand(v.Kp, v.Ti, v.Kv, delay)
    assert 20.0 * np.log10(np.abs(velocity).max()) <= 3.0
    assert 20.0 * np.log10(np.abs(position).max()) <= 0.0
    assert least_by_hand(phi) == pytest.approx(1e3 * answer.best.goal, rel=2e-3)
    machine = Machine.of_axis(Drive(MASS, TIP, STIFFNESS, DAMPING, v)).at()
    assert machine.unstable_poles() == 0
    speed = np.array([800.0, 1000.0, 1600.0, 2500.0])
    exact = semi_discretization(machine, Tool(0.0508, 4), answer.task.arc, answer.task.coefficients, speed)
    lobes = answer.lobes["limit_depth"].sel(gains="tuned")
    np.testing.assert_allclose(exact["limit_depth"], lobes.interp(spindle_speed=speed), rtol=3e-3)


@pytest.mark.slow
def test_no_point_of_a_fine_grid_is_better(found: tuple[Tuning, float]) -> None:
    """Every set of a grid of 20 x 20 x 20 that keeps the limits, and of one about the best of it, a tenth as wide."""
    answer, delay = found
    f = FREQUENCY[::6]
    box = np.log([(3e3, 3e4), (1.5e-3, 6e-2), (15.0, 400.0)])
    best, at = 0.0, np.zeros(3)
    for _ in range(2):
        kps, tis, kvs = (np.exp(np.linspace(low, high, 20)) for low, high in box)
        for kp in kps:
            for ti in tis:
                velocity, position, phi = by_hand(kp, ti, kvs[:, None], delay, f)
                good = (np.abs(position).max(axis=1) <= 1.0) & (np.abs(velocity).max() <= 10.0**0.15)
                for kv, one in zip(kvs[good], phi[good], strict=True):
                    depth = least_by_hand(one, f)
                    stable = Drive(MASS, TIP, STIFFNESS, DAMPING, Servo(kp, ti, kv, delay)).unstable_poles
                    if depth > best and stable() == 0:
                        best, at = depth, np.log([kp, ti, kv])
        box = at[:, None] + 0.05 * (box - box.mean(axis=1, keepdims=True)) * 2.0
    assert best > 1.95
    assert 1e3 * answer.best.goal >= best * 0.999


@pytest.mark.slow
def test_a_compromise_is_what_a_search_with_its_tracking_error_as_a_limit_finds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(result, "FRONTIER", 3)
    answer = smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, robust=0.0, **ASKED)
    middle = answer.frontier[1]
    monkeypatch.setattr(result, "FRONTIER", 1)
    asked = {"robust": 0.0, "tracking_error": middle.tracking_error}
    limited = smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, **ASKED, **asked)
    assert limited.best.tracking_error <= middle.tracking_error * (1.0 + 1e-9)
    assert middle.goal == pytest.approx(limited.best.goal, rel=0.01)


# --- What is quick: a search that ends early must say the truth about what it has.


@pytest.mark.usefixtures("hurried")
def test_robust_gains_are_worth_their_worst_case() -> None:
    """The worst of three machines, each worked out by hand; the largest feed-forward lies on the position limit."""
    answer = smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, robust=0.1, feed_forward="largest", **ASKED)
    v, depths = answer.servos["x"], []
    for share in (0.9, 1.0, 1.1):
        spring, damper = share**2 * STIFFNESS, share * DAMPING
        phi = Drive(MASS, TIP, spring, damper, Servo(v.Kp, v.Ti, v.Kv)).tip_transfer(2j * np.pi * FREQUENCY)
        depths.append(least_by_hand(phi))
    assert 1e3 * answer.best.goal == pytest.approx(min(depths), rel=5e-3)
    assert 1e3 * answer.best.nominal == pytest.approx(depths[1], rel=5e-3)
    assert 0.0 < v.feed_forward < 1.0
    assert answer.best.tracking_error == pytest.approx((1.0 - v.feed_forward) / 60.0 / v.Kv)
    velocity, position, lobes, compromise = draw_tuning(answer).axes
    for panel, limit in ((velocity, 3.0), (position, 0.0)):
        assert any(np.array_equal(line.get_ydata(), [limit, limit]) for line in panel.lines), "the limit is drawn"
        assert len(panel.lines) == 1 + len(answer.sets)
    assert lobes.lines[0].get_ydata().min() == pytest.approx(1e3 * answer.best.nominal, rel=0.01)
    assert len(compromise.lines[0].get_xdata()) == len(answer.frontier) + 1


@pytest.mark.usefixtures("hurried")
def test_depths_at_given_speeds_are_those_of_the_lobes() -> None:
    asked = {**ASKED, "goal": "depths", "spindle_speed": {"speeds": [900.0, 1500.0]}}
    helix = {**TOOL, "helix_angle": "30 deg"}
    at = smfe.tune(bench(), tool=helix, material=ALUMINIUM, robust=0.0, **asked)
    assert at.confirmed is not None
    assert at.confirmed["spindle_speed"].values.tolist() == [900.0, 1500.0]
    lobes = at.lobes["limit_depth"].sel(gains="tuned")
    assert float(lobes.sel(spindle_speed=[900.0, 1500.0]).min()) == pytest.approx(1e3 * at.best.goal, rel=5e-3)


@pytest.mark.usefixtures("hurried")
def test_a_limit_more_costs_depth_and_is_kept() -> None:
    free = smfe.tune(bench(0.75e-3), tool=TOOL, material=ALUMINIUM, robust=0.0, **ASKED)
    asked: dict[str, Any] = {"phase_margin": "60 deg", "gain_margin": 12.0, "tracking_error": 400e-6}
    asked["position_bandwidth"] = 10.0
    held = smfe.tune(bench(0.75e-3), tool=TOOL, material=ALUMINIUM, robust=0.0, **ASKED, **asked)
    assert held.best.goal < free.best.goal
    v = held.servos["x"]
    drive = Drive(MASS, TIP, STIFFNESS, DAMPING, v)
    both = [loop.margins() for loop in (drive.velocity_loop(), drive.position_loop())]
    assert min(np.degrees(m.phase) for m in both) >= 59.9
    assert min(20.0 * np.log10(m.gain) for m in both) >= 11.95
    assert held.best.tracking_error <= 401e-6
    assert not held.best.misses


@pytest.mark.usefixtures("hurried")
def test_a_removal_rate_counts_no_deeper_than_the_edges_and_says_so_where_they_are_not_known() -> None:
    asked = {**ASKED, "goal": "removal_rate", "feed_per_tooth": 2e-4, "robust": 0.0}
    edges = {**TOOL, "edge_length": "2 mm"}
    held = smfe.tune(bench(), tool=edges, material=ALUMINIUM, **asked)
    assert held.best.goal == pytest.approx(2e-3 * 0.0508 * 2e-4 * 4 * 2500.0 / 60.0, rel=1e-6)
    with pytest.warns(smfe.SmfeWarning, match="no largest depth is stated"):
        free = smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, **asked)
    assert free.best.goal > held.best.goal


@pytest.mark.slow
@pytest.mark.usefixtures("hurried")
def test_two_axes_are_tuned_together_and_confirmed_by_semi_discretisation() -> None:
    modes = ModalModel([24.0, 33.0], [0.04, 0.05], [3e7, 3.5e7], [(0.2, 1.0, 0.1), (1.0, -0.3, 0.1)])
    mass = {"x": 9000.0, "y": 6000.0}
    servos = {a: {"now": tune(8.0, m, 1e-3)} for a, m in mass.items()}
    machine = Machine(released_modes(modes, mass), {a: FeedAxis(v, Viscous(2e4)) for a, v in servos.items()})
    steel = {"Ktc": "1900 N/mm^2", "Krc": "700 N/mm^2", "Kac": "300 N/mm^2"}
    tool = {"diameter": "125 mm", "teeth": 8, "approach_angle": "45 deg"}
    asked: dict[str, Any] = {
        "goal": "removal_rate",
        "spindle_speed": (300.0, 700.0),
        "cut": "down",
        "width_of_cut": 0.06,
    }
    answer = smfe.tune(machine, tool=tool, material=steel, robust=0.0, feed_per_tooth=2e-4, maximum_depth=5e-3, **asked)
    assert set(answer.servos) == {"x", "y"}
    assert all(v.delay == 1e-3 for v in answer.servos.values())
    assert answer.best.goal >= answer.present[0].goal
    held = Machine(machine.structure, {a: FeedAxis(v, Viscous(2e4)) for a, v in answer.servos.items()}).at()
    assert held.unstable_poles() == 0
    lobes = answer.lobes["limit_depth"].sel(gains="tuned")
    rate = (lobes.clip(max=5.0) * 1e-3 * lobes["spindle_speed"] / 60.0 * 0.06 * 2e-4 * 8).max()
    assert answer.best.goal == pytest.approx(float(rate), rel=0.01)
    assert answer.confirmed is not None
    assert any("semi-discretisation gives a least depth" in note for note in answer.notes)


@pytest.mark.usefixtures("hurried")
def test_measured_open_loops_are_tuned_as_the_machine_that_they_come_from() -> None:
    f = np.linspace(0.5, 600.0, 5000)
    s = 2j * np.pi * f
    phi = np.asarray(1.0 / (TIP * s**2 + DAMPING * s + STIFFNESS), dtype=complex)
    at_rest = make_compliance(f, phi[:, None, None], ["x"], ["x"])
    response = Drive(MASS, TIP, STIFFNESS, DAMPING).open_loop(f, 0.75e-3)
    loop = at_rest.drop_vars("compliance").assign(response=("frequency", response))
    found = smfe.tune(
        {"x": loop},
        tool=TOOL,
        material=ALUMINIUM,
        at_rest=at_rest,
        moving_mass={"x": MASS + TIP},
        tip_mass=TIP,
        dead_time=0.75e-3,
        controllers={"x": PRESENT},
        robust=0.0,
        **ASKED,
    )
    v = found.servos["x"]
    velocity, position, phi = by_hand(v.Kp, v.Ti, v.Kv, 0.75e-3)
    assert 20.0 * np.log10(np.abs(velocity).max()) <= 3.01
    assert 20.0 * np.log10(np.abs(position).max()) <= 0.01
    assert least_by_hand(phi) == pytest.approx(1e3 * found.best.goal, rel=5e-3)
    assert [one.name for one in found.present] == list(PRESENT)
    with pytest.raises(InputError, match="moving_mass, tip_mass missing"):
        smfe.tune({"x": loop}, tool=TOOL, material=ALUMINIUM, at_rest=at_rest, **ASKED)


# --- What is refused.


@pytest.mark.usefixtures("hurried")
def test_limits_that_no_gains_keep_are_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"no gains keep all limits together; the nearest .* miss: .*at least 300 Hz"):
        smfe.tune(bench(0.75e-3), tool=TOOL, material=ALUMINIUM, robust=0.0, position_bandwidth=300.0, **ASKED)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"goal": None}, "has no goal; say what the gains are for"),
        ({"spindle_speed": None}, "has no spindle_speed"),
        ({"goal": "depth"}, "goal 'depth' is not known"),
        ({"spindle_speed": "1000 rpm"}, "least_depth needs a range of speeds"),
        ({"goal": "depths"}, "depths needs the speeds themselves"),
        ({"axes": ["y"]}, "axis y is none of the machine's, x"),
        ({"axes": ["x", "x"]}, "names axes x, x; name each axis once"),
        ({"feed_forward": 2.0}, "2.0 is no feed-forward"),
        ({"velocity_peak": "3"}, "'3' is no level"),
        ({"width_of_cut": "80 mm"}, "is wider than the tool"),
        ({"move": {"kind": "circle"}}, "a circle needs its radius"),
        ({"robust": 0.6}, "from 0 to below 50 %"),
    ],
)
def test_a_task_that_says_too_little_is_refused(change: dict[str, Any], said: str) -> None:
    asked = {key: value for key, value in {**ASKED, **change}.items() if value is not None}
    with pytest.raises(InputError, match=said):
        smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, **asked)


def test_machines_without_axes_or_with_unknown_feed_are_refused() -> None:
    with pytest.raises(InputError, match="gains need tool and material"):
        smfe.tune(bench())
    with pytest.raises(InputError, match="a ModalModel is neither a campaign nor a machine"):
        smfe.tune(ModalModel([60.0], [0.01], [1e6], [(1, 0, 0)]), tool=TOOL, material=ALUMINIUM, **ASKED)  # type: ignore[arg-type]
    law = Andersson(44.2, 84.0, 6.457e-3, 168.0, 15000.0)
    dry = Machine(bench().structure, {"x": FeedAxis(PRESENT["K2"], law)})
    with pytest.raises(InputError, match="the friction of axis x depends on speed; say at which feed"):
        smfe.tune(dry, tool=TOOL, material=ALUMINIUM, **ASKED)
    pitch = {**TOOL, "pitch_angles": ["80 deg", "100 deg", "80 deg", "100 deg"]}
    with pytest.raises(InputError, match="unequal pitch"):
        smfe.tune(bench(), tool=pitch, material=ALUMINIUM, **ASKED)


def test_speeds_that_the_spindle_cannot_turn_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(
        """
        [campaign]
        name = "Bench"
        [tool]
        diameter = "50.8 mm"
        teeth = 4
        [material]
        Ktc = "780 N/mm^2"
        Krc = "351 N/mm^2"
        [spindle]
        minimum = "200 rpm"
        maximum = "6000 rpm"
        [machine.axis.x]
        moving_mass = "23.1 kg"
        tip_mass = "11.3 kg"
        stiffness = "1.68 N/um"
        damping = "104 N s/m"
        [tune]
        goal = "depths"
        spindle_speed = { speeds = ["50 rpm", "900 rpm", "9000 rpm"] }
        cut = "up"
        width_of_cut = "50.8 mm"
        """
    )
    with pytest.raises(
        InputError, match=r"asks for 50, 9000 rpm, which the \[spindle\] cannot turn: it has 200 to 6000"
    ):
        smfe.tune(file)


@pytest.mark.usefixtures("hurried")
def test_at_one_speed_the_answer_is_worth_its_worst_between_the_moved_modes_too() -> None:
    """At 325 rpm a lobe passes while the modes move: the three machines of the search are 1 to 2 % too good."""
    asked = {**ASKED, "goal": "depths", "spindle_speed": {"speeds": [325.0]}}
    answer = smfe.tune(bench(), tool=TOOL, material=ALUMINIUM, robust=0.1, **asked)
    v = answer.servos["x"]
    gains = np.array([[[v.Kp, v.Ti, v.Kv]]])
    moved = np.linspace(-0.1, 0.1, 21)
    worst = [judge.Judge(answer.task, 1600, changes=(float(c),))(gains).goal.item() for c in moved]
    assert answer.best.goal == pytest.approx(min(worst), rel=4e-3)
    assert answer.best.goal <= answer.best.nominal


@pytest.mark.usefixtures("hurried")
def test_a_machine_without_damping_is_tuned() -> None:
    """Its compliance has no value at its modes; a damping of 0.3 % of the critical is no other machine."""
    found = []
    for damping in (0.0, 25.0):
        structure = Machine.of_axis(Drive(MASS, TIP, STIFFNESS, damping)).structure
        machine = Machine(structure, {"x": FeedAxis(None, Viscous(0.0))})
        found.append(smfe.tune(machine, tool=TOOL, material=ALUMINIUM, robust=0.0, **ASKED).best.goal)
    assert 0.7 * found[1] < found[0] < found[1]
