"""The independent simulation shares no code with the packages, obeys the same equations and states its own scatter.

The equations in the limit without friction are solved here, not taken from either program.
"""

import ast
import json
import math
import re
import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from places import CHECKOUT

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import Andersson, FrictionLaw, Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Excitation
from process.simulation.machine import simulate_machine
from process.simulation.problem import SampledControl
from truth.axis import MM_MIN, RATE, SERVOS, Appendage, Friction, Setting, Truth, response_at_rest, simulate
from truth.blind import draw, seed_of
from truth.campaign import BAND, LENGTH, STEPS, Condition, Design, actuator, full, measure, reduce
from truth.chain import SAMPLE_RATE, Chain, butterworth, density, late, noise
from truth.cutting import CUT_EFFECTS, CUT_OUTSIDE, Cut, Mill, chip, draw_cuts, forces, measure_cuts
from truth.effects import EFFECTS, OUTSIDE, apply

HERE = CHECKOUT / "tests" / "truth"
SLOW = pytest.mark.slow
NO_TONES = np.zeros((0, 5))
IMPACT = (0.1, 25.0, 1.7e-3, 3.0)
SMOOTH = replace(Friction(), kind="none")
EXACT = replace(Truth().control, resolution=0.0, exact_velocity=True)


def spectra(force: np.ndarray, acceleration: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequency 10 to 150 Hz and compliance of a whole record."""
    f = np.fft.rfftfreq(force.size, 1.0 / rate)
    band = (f >= 10.0) & (f <= 150.0)
    x = -np.fft.rfft(acceleration)[band] / (2.0 * np.pi * f[band]) ** 2
    return f[band], x / np.fft.rfft(force)[band]


def impact_response(
    truth: Truth, setting: Setting, peak: float = 25.0, seconds: float = 4.0
) -> tuple[np.ndarray, np.ndarray]:
    impact = np.array([IMPACT[0], peak, *IMPACT[2:]])
    raw = simulate(truth, setting, impact, NO_TONES, seconds)
    return spectra(raw[3], raw[0], RATE)


def away(h: np.ndarray, reference: np.ndarray) -> float:
    """Error over the whole band, relative."""
    return float(np.linalg.norm(h - reference) / np.linalg.norm(reference))


class TestIndependence:
    def test_it_imports_nothing_of_the_packages(self) -> None:
        allowed = {*sys.stdlib_module_names, "h5py", "numba", "numpy", "scipy", "truth"}
        files = sorted(set(HERE.rglob("*.py")) - set(HERE.rglob("test_*.py")))
        assert len(files) >= 6
        for file in files:
            for node in ast.walk(ast.parse(file.read_text())):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
                assert {n.split(".")[0] for n in names} <= allowed, f"{file.name}, line {node.lineno}"

    def test_no_package_imports_it(self) -> None:
        root = HERE.parents[1]
        for file in (f for package in ("process", "stability", "smfe") for f in (root / package).rglob("*.py")):
            imports = re.findall(r"^\s*(?:from|import)\s.*\b(?:truth|tests)\b.*", file.read_text(), re.MULTILINE)
            assert not imports, f"{file.name}: {imports[0]}"


def closed_loop(truth: Truth, f: np.ndarray, servo: str, dead_time: float = 0.0) -> np.ndarray:
    """Tip compliance of two masses under ``F = Kp [e + int e/Ti]``, ``e = -(v + Kv x)``: 2 x 2 equations per line."""
    s, j, gains = 2j * np.pi * f, truth.joint, truth.servos[servo]
    joint = j.damping * s + j.stiffness
    loop = gains.kp * (1.0 + 1.0 / (gains.ti * s)) * (s + gains.kv) * np.exp(-s * dead_time)
    matrix = np.empty((f.size, 2, 2), complex)
    matrix[:, 0, 0] = truth.tip_mass * s**2 + joint
    matrix[:, 0, 1] = matrix[:, 1, 0] = -joint
    matrix[:, 1, 1] = truth.moving_mass * s**2 + truth.friction.viscous[0] * s + joint + loop
    return np.linalg.solve(matrix, np.array([1.0, 0.0])[:, None])[:, 0, 0]


class TestLinearLimit:
    @pytest.mark.parametrize("servo", ["K1", "K3", pytest.param("K2", marks=SLOW), pytest.param("K4", marks=SLOW)])
    def test_without_friction_and_sampling_it_is_the_corrected_equation_4(self, servo: str) -> None:
        truth = Truth(friction=SMOOTH, control=replace(EXACT, period=0.0))
        f, h = impact_response(truth, Setting(500.0 * MM_MIN, servo))
        assert away(h, closed_loop(truth, f, servo)) < 1e-3

    def test_with_friction_that_never_yields_it_is_one_mass(self) -> None:
        truth = Truth(friction=replace(Friction(), kind="stick", static=(1e9, 1e9)))
        f, h = impact_response(truth, Setting())
        s = 2j * np.pi * f
        assert away(h, 1.0 / (truth.tip_mass * s**2 + truth.joint.damping * s + truth.joint.stiffness)) < 1e-3

    def test_sampling_tends_to_a_dead_time_of_lag_and_a_half(self) -> None:
        found = []
        for lag in (1, 4, 13):
            period = 0.75e-3 / (lag + 0.5)
            truth = Truth(friction=SMOOTH, control=replace(EXACT, period=period, lag=lag, extra=0.0))
            f, h = impact_response(truth, Setting(500.0 * MM_MIN, "K3"))
            found.append(h)
        limit = closed_loop(truth, f, "K3", 0.75e-3)
        errors = [away(h, limit) for h in found]
        assert errors[1] == pytest.approx(errors[0] / 3.0, rel=0.2)  # the integral is a sum: first order in the period
        assert errors[2] == pytest.approx(errors[1] / 3.0, rel=0.2)
        assert away(1.5 * found[2] - 0.5 * found[1], limit) < 1e-3

    def test_host_and_cable_dent_the_compliance_at_their_frequencies(self) -> None:
        for part, at in (({"cable": Appendage(0.014, 48.0)}, 48.0), ({"host": Appendage(18750.0, 45.0)}, 45.0)):
            bare = Truth(friction=SMOOTH)
            f, h = impact_response(bare, Setting(500.0 * MM_MIN))
            change = np.abs(impact_response(replace(bare, **part), Setting(500.0 * MM_MIN))[1] / h - 1.0)
            assert f[change.argmax()] == pytest.approx(at, abs=1.0)
            assert 0.01 < change.max() < 0.06


class TestSlowMotion:
    """A tip that is pushed slowly measures the friction itself."""

    @staticmethod
    def steady(kind: str, feed: float) -> float:
        truth = Truth(friction=replace(Friction(), kind=kind))
        raw = simulate(truth, Setting(feed * MM_MIN, "K3"), np.zeros((0, 4)), NO_TONES, 1.0)
        return float(raw[2, -2000:].mean())

    @pytest.mark.parametrize("kind", ["lugre", "gms", "stick"])
    @pytest.mark.parametrize("feed", [600.0, -1500.0])
    def test_the_drive_bears_the_friction_curve(self, kind: str, feed: float) -> None:
        side = 0 if feed > 0.0 else 1
        coulomb, static = ((44.2, 38.7)[side], (84.0, 88.0)[side])
        dry = coulomb + (static - coulomb) * math.exp(-abs(feed) / (387.4, 421.0)[side])
        expected = math.copysign(dry + (168.0, 150.0)[side] * abs(feed) * MM_MIN, feed)
        assert self.steady(kind, feed) == pytest.approx(expected, rel=2e-3)

    def test_before_it_breaks_away_the_guideway_is_a_spring(self) -> None:
        soft = replace(Friction(), bristle_stiffness=3.4e7, bristle_damping=1e3)
        idle = replace(EXACT, period=0.0)
        still = {name: replace(servo, kp=0.0) for name, servo in SERVOS.items()}
        for friction in (soft, replace(soft, kind="gms")):
            truth = Truth(friction=friction, control=idle, servos=still)
            tone = np.array([[0.0, 3.0, 4.0, 5.0, 0.0]])
            raw = simulate(truth, Setting(), np.zeros((0, 4)), tone, 3.0)
            tip = raw[4, -int(RATE) :]
            swing = 0.5 * (tip.max() - tip.min())
            assert swing == pytest.approx(4.0 * (1.0 / 1.68e6 + 1.0 / 3.4e7), rel=0.03)

    def test_self_excited_motion_does_not_rest(self) -> None:
        assert not response_at_rest(Truth(), Setting(100.0 * MM_MIN, "K1"))[0]
        assert response_at_rest(Truth(), Setting(500.0 * MM_MIN, "K3"))[0]


@dataclass(frozen=True)
class SmoothImpact(Excitation):
    """The same impact, for the program under test."""

    peak: float

    def force(self, time: np.ndarray) -> np.ndarray:
        s = np.clip((np.asarray(time) - IMPACT[0]) / IMPACT[2], 1e-12, None)
        return self.peak * np.exp(IMPACT[3] * (np.log(s) + 1.0 - s))

    shortest = 4e-3
    end = 0.15


def of_package(
    law: FrictionLaw, servo: str, feed: float, peak: float, step: float = 20e-9
) -> tuple[np.ndarray, np.ndarray]:
    """Compliance by `process.simulation.machine`, sampled servo with differenced readings."""
    nominal, gains = Truth(), SERVOS[servo]
    drive = Drive(nominal.moving_mass, nominal.tip_mass, nominal.joint.stiffness, nominal.joint.damping)
    machine = Machine(two_mass_axes({"x": drive}), {"x": FeedAxis(Servo(gains.kp, gains.ti, gains.kv), law)})
    control = SampledControl(0.25e-3, 2, step)
    record = simulate_machine(
        machine, duration=2.0, feed=feed, forces={"x": SmoothImpact(peak)}, control=control, sample_rate=SAMPLE_RATE
    )
    return spectra(record["force"].values[0], record["acceleration"].values[0], SAMPLE_RATE)


def sides(kt: float = 15000.0) -> Andersson:
    back = Andersson(38.7, 88.0, 421.0 * MM_MIN, 150.0, kt)
    return Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, kt, negative=back)


class TestAgainstProduction:
    """Two programs that agree to the last digit share their errors; two that disagree by per cents have a bug."""

    def test_both_solve_the_same_equations_where_nothing_is_a_matter_of_taste(self) -> None:
        truth = Truth(friction=SMOOTH, control=replace(Truth().control, resolution=1e-13))
        _, h = impact_response(truth, Setting(500.0 * MM_MIN, phase=0.0), 25.0, 2.0)
        assert away(h, of_package(Viscous(168.0), "K2", 500.0 * MM_MIN, 25.0, 1e-13)[1]) < 1e-4

    @pytest.mark.parametrize(("servo", "feed"), [("K2", 500.0), pytest.param("K3", -1000.0, marks=SLOW)])
    def test_sliding_they_differ_a_little(self, servo: str, feed: float) -> None:
        _, h = impact_response(Truth(), Setting(feed * MM_MIN, servo), 50.0, 2.0)
        assert 2e-3 < away(h, of_package(sides(), servo, feed * MM_MIN, 50.0)[1]) < 2e-2

    def test_at_rest_they_differ_by_what_a_smooth_law_loses(self) -> None:
        _, h = impact_response(Truth(), Setting(), 25.0, 2.0)
        assert 2e-3 < away(h, of_package(sides(), "K2", 0.0, 25.0)[1]) < 0.5


class TestInstruments:
    def test_the_filter_is_a_butterworth(self) -> None:
        from scipy import signal

        f, h = signal.sosfreqz(butterworth(6, 700.0, RATE), worN=2000, fs=RATE)
        warped = np.tan(np.pi * f / RATE) / math.tan(math.pi * 700.0 / RATE)
        np.testing.assert_allclose(np.abs(h), 1.0 / np.sqrt(1.0 + warped**12), atol=1e-9)

    def test_the_noise_has_unit_variance_and_its_colour(self) -> None:
        x = noise(np.random.default_rng(1), 1 << 18)
        assert x.std() == pytest.approx(1.0, rel=0.02)
        blocks = np.fft.rfft(x.reshape(256, -1)) / math.sqrt(1024.0)
        f = np.fft.rfftfreq(1024, 1.0 / SAMPLE_RATE)[5:-5]
        measured = 2.0 / SAMPLE_RATE * (np.abs(blocks) ** 2).mean(axis=0)[5:-5]
        assert np.median(np.abs(measured / density(f) - 1.0)) < 0.1

    def test_a_late_channel_turns_the_phase_only(self) -> None:
        raw = simulate(Truth(), Setting(), np.array(IMPACT), NO_TONES, 2.0)
        f, h = spectra(raw[3], raw[0], RATE)
        _, turned = spectra(raw[3], late(raw[0], 50e-6), RATE)
        np.testing.assert_allclose(turned, h * np.exp(-2j * np.pi * f * 50e-6), rtol=2e-3)


@cache
def small() -> Design:
    return Design("small", (Condition(feed=1000.0, level=50.0, controller="K3"), Condition(level=25.0, order=1.0)))


class TestMeasuring:
    # Four repetitions know their scatter to 30 %, eight to 20 %, at each of many lines that are not independent.
    @pytest.mark.parametrize(("count", "median", "mean"), [(4, 0.5, 0.25), pytest.param(8, 0.3, 0.15, marks=SLOW)])
    def test_reported_scatter_is_the_scatter_over_repetitions(self, count: int, median: float, mean: float) -> None:
        reports = [[reduce(r) for r in measure(Truth(), small(), seed)] for seed in range(count)]
        for i in range(2):
            h = np.array([r[i]["compliance"] for r in reports])
            seen = np.sqrt((np.abs(h - h.mean(axis=0)) ** 2).sum(axis=0) / (h.shape[0] - 1))
            stated = np.sqrt(np.mean([r[i]["std"] ** 2 for r in reports], axis=0))
            band = reports[0][i]["frequency"] < 120.0
            assert np.median(stated[band] ** 2 / seen[band] ** 2) == pytest.approx(1.0, abs=median)
            ratio = np.sqrt((stated[band] ** 2 / np.abs(h[:, band].mean(axis=0)) ** 2).mean())
            ratio /= np.sqrt((seen[band] ** 2 / np.abs(h[:, band].mean(axis=0)) ** 2).mean())
            assert ratio == pytest.approx(1.0, abs=mean)

    def test_impacts_and_stepped_sines_measure_the_same_compliance(self) -> None:
        truth, chain = Truth(friction=SMOOTH, control=EXACT), Chain(snr=80.0, double=0.0)
        impacts = Condition(feed=500.0, controller="K3")
        by_hand, by_sine = (
            reduce(measure(truth, Design("one", (c,)), 3, chain)[0])
            for c in (impacts, replace(impacts, method="actuator", repeats=1))
        )
        np.testing.assert_array_equal(by_sine["frequency"], STEPS)
        at = np.interp(STEPS, by_hand["frequency"], by_hand["compliance"].real)
        at = at + 1j * np.interp(STEPS, by_hand["frequency"], by_hand["compliance"].imag)
        np.testing.assert_allclose(by_sine["compliance"], at, rtol=0.02)

    def test_a_seed_decides_everything(self) -> None:
        design = Design("one", (Condition(feed=500.0, repeats=1),))
        one, same, other = (measure(Truth(), design, seed) for seed in (1, 1, 2))
        np.testing.assert_array_equal(one[0]["acceleration"], same[0]["acceleration"])
        assert np.any(one[0]["acceleration"] != other[0]["acceleration"])

    def test_the_full_design_holds_every_contrast(self) -> None:
        plan = full(4).conditions
        assert plan[0].settings() | {"order": 0} == plan[-1].settings() | {"order": 0}
        assert {c.level for c in plan if c.method == "hammer" and c.feed == 0.0} == {25.0, 100.0, 400.0}
        moving = {(c.feed, c.level, c.controller) for c in plan if c.feed != 0.0}
        assert len(moving) == 16
        assert len({c.position for c in plan}) == 3
        assert sum(c.added_mass > 0.0 for c in plan) == 1
        assert [c.order for c in plan] == sorted(c.order for c in plan)
        assert full(4) == full(4)
        assert full(4) != full(5)
        assert len(actuator().conditions) == 6

    def test_a_silent_record_holds_the_tone_that_was_planted(self) -> None:
        design = Design("silent", (Condition("silent", level=0.0, repeats=1), Condition(level=100.0)))
        record = measure(Truth(), design, 5, Chain(tone=20.0))[0]
        x = record["acceleration"][0]
        power = np.abs(np.fft.rfft(x * np.hanning(x.size))) ** 2
        f = np.fft.rfftfreq(x.size, 1.0 / SAMPLE_RATE)
        floor = power[(f > 35.0) & (f < 65.0) & (np.abs(f - 50.0) > 3.0 / LENGTH)].mean()
        assert 10.0 * math.log10(power[f == 50.0][0] / floor) == pytest.approx(20.0, abs=4.0)


class TestEffects:
    @pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
    def test_at_size_zero_nothing_changes(self, name: str) -> None:
        assert apply({name: 0.0}, Truth(), Chain()) == (Truth(), Chain())

    def test_micro_slip_and_cubic_have_the_size_they_claim(self) -> None:
        locked = Truth(friction=replace(Friction(), kind="stick", static=(1e9, 1e9)))

        def peak(truth: Truth, level: float) -> tuple[float, float]:
            impact = np.array([IMPACT[0], level, *IMPACT[2:]])
            raw = simulate(truth, Setting(), impact, NO_TONES, 4.0)
            n = 8 * raw.shape[1]
            f = np.fft.rfftfreq(n, 1.0 / RATE)
            band = (f > 40.0) & (f < 90.0)
            h = np.abs(np.fft.rfft(raw[0], n)[band] / np.fft.rfft(raw[3], n)[band] / f[band] ** 2)
            return f[band][h.argmax()], h.max()

        slipping, hard = (apply({n: EFFECTS[n].size}, locked, Chain())[0] for n in ("micro_slip", "cubic"))
        assert 1.0 - peak(slipping, 200.0)[1] / peak(slipping, 50.0)[1] == pytest.approx(0.05, abs=0.005)
        assert peak(hard, 200.0)[0] / peak(hard, 50.0)[0] - 1.0 == pytest.approx(0.03, abs=0.003)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", [*EFFECTS, *OUTSIDE])
    def test_every_effect_is_there_to_be_found(self, name: str) -> None:
        effect = (EFFECTS | OUTSIDE)[name]
        assert contrast(*apply({name: effect.size}, Truth(), Chain())) > 1.0


CONTRASTS = Design(
    "contrasts",
    (
        Condition("silent", level=0.0, repeats=1),
        Condition(level=25.0),
        Condition(level=100.0, order=0.2),
        Condition(feed=500.0, level=50.0, order=0.4),
        Condition(feed=-500.0, level=200.0, order=0.6),
        Condition(feed=1000.0, level=200.0, controller="K3", order=0.8),
        Condition(level=100.0, position=1.0, order=1.0),
    ),
)


def contrast(truth: Truth, chain: Chain) -> float:
    """Change against the nominal machine under the same noise: chi-square per line, worst condition."""
    worst = 0.0
    for r, b in zip(measure(truth, CONTRASTS, 1, chain), bare(), strict=True):
        if r["condition"].method == "silent":
            with_tone = np.abs(np.fft.rfft(r["acceleration"] * np.hanning(r["time"].size))) ** 2
            quiet = np.abs(np.fft.rfft(b["acceleration"] * np.hanning(r["time"].size))) ** 2
            worst = max(worst, float((with_tone / quiet)[0, 10:400].max() / 10.0))
            continue
        h, h0 = reduce(r), reduce(b)
        worst = max(worst, float(np.mean(np.abs((h["compliance"] - h0["compliance"]) / np.median(h0["std"])) ** 2)))
    return worst


@cache
def bare() -> list[dict]:
    return measure(Truth(), CONTRASTS, 1)


class TestBlind:
    def test_the_answer_can_be_read_after_the_finding_only(self) -> None:
        exam = draw("0f3a", effects=["gain"], design="hammer only")
        assert "gain" not in repr(exam)
        with pytest.raises(TypeError, match="hand in the finding"):
            exam.reveal("")
        answer = exam.reveal(json.dumps({"cause": "gain"}))
        assert abs(answer.effects["gain"]) == pytest.approx(0.05)
        assert not answer.outside
        with pytest.raises(ValueError, match="another finding"):
            exam.reveal("skew")
        with pytest.raises(AssertionError, match=f"seed {seed_of('0f3a')}"):
            exam.require(False, json.dumps({"cause": "gain"}))

    def test_nuisances_stay_within_their_priors_and_an_exam_can_be_repeated(self) -> None:
        nominal = Truth()
        for seed in range(50):
            truth = nominal.with_nuisances(np.random.default_rng(seed))
            assert abs(truth.tip_mass / nominal.tip_mass - 1.0) <= 0.05
            assert abs(truth.joint.stiffness / nominal.joint.stiffness - 1.0) <= 0.05
            assert abs(truth.joint.damping / nominal.joint.damping - 1.0) <= 0.2
            assert truth.friction.coulomb == nominal.friction.coulomb
        one, two = (draw(7, effects=[None], design="hammer only") for _ in range(2))
        assert one.commitment == two.commitment
        assert one.reveal("nothing").effects == {}
        f = one.reduced[0]["frequency"]
        assert f[0] >= BAND[0]
        assert f[-1] <= BAND[1]


TURN = np.arange(7200) * 2.0 * math.pi / 7200


def lines(force: np.ndarray, orders: list[int]) -> np.ndarray:
    """Peak values at orders of the spindle, shape (orders, 3)."""
    return 2.0 * np.fft.rfft(force, axis=1)[:, orders].T / force.shape[1]


class TestCutting:
    def test_the_mean_force_of_a_slot_is_that_of_the_textbook(self) -> None:
        mill = replace(Mill(), edge=(1e4, 2e4, 3e3))
        (t, r, a), (te, re, ae) = mill.cutting, mill.edge
        n, b, f = mill.teeth, 1e-3, 0.1e-3
        expected = [-n * b / 4 * f * r - n * b / math.pi * re, n * b / 4 * f * t + n * b / math.pi * te]
        expected.append(-n * b / math.pi * f * a - n * b / 2 * ae)
        np.testing.assert_allclose(forces(mill, Cut(), TURN).mean(axis=1), expected, rtol=5e-3)

    def test_the_chip_of_a_trochoid_is_nearly_that_of_a_circle(self) -> None:
        phi = np.linspace(0.05, 3.09, 100)
        error = np.abs(chip(Mill(), 1, phi, 0.1e-3) - 0.1e-3 * np.sin(phi)).max() / 0.1e-3
        assert 1e-4 < error < 1e-2

    def test_the_two_programs_differ_a_little(self) -> None:
        arc = engagement("down", 0.5 * 50.8e-3, 50.8e-3)
        for approach in (math.pi / 2.0, math.pi / 4.0):
            mill = replace(Mill(), teeth=4, entry=arc.entry, exit=arc.exit, edge=(1e4, 2e4, 3e3), approach=approach)
            coefficients = CuttingCoefficients(*mill.cutting, *mill.edge)
            tool = Tool(mill.diameter, mill.teeth, approach)
            theirs = force_harmonics(tool, arc, coefficients, 1e-3, 0.1e-3, [1, 2])
            ours = lines(forces(mill, Cut(), TURN), [4, 8])
            assert 2e-4 < away(ours, theirs) < 2e-2

    def test_run_out_speaks_at_the_spindle_order_in_proportion(self) -> None:
        still, small, double = (
            np.abs(lines(forces(replace(Mill(), runout=r), Cut(), TURN), [1])[0]) for r in (0.0, 5e-6, 10e-6)
        )
        assert still.max() < 1e-3 * small.max()
        np.testing.assert_allclose(double, 2.0 * small, rtol=0.08)

    def test_a_dynamometer_magnifies_below_its_resonance(self) -> None:
        quiet = replace(Mill(), noise=0.0, wander=0.0)
        shaken = replace(quiet, dynamometer=(400.0, 400.0, 600.0))
        bare, seen = (measure_cuts(m, [Cut(speed=3000.0, revolutions=100)], 1)[0]["force"][1] for m in (quiet, shaken))
        window = np.hanning(bare.size)
        before, after = (np.abs(np.fft.rfft(window * (x - x.mean()))) for x in (bare, seen))
        top = int(before.argmax())
        assert top * 8192.0 / bare.size == pytest.approx(100.0, rel=0.02)
        assert after[top] / before[top] == pytest.approx(1.0 / (1.0 - 0.25**2), rel=5e-3)

    @pytest.mark.parametrize("name", [*CUT_EFFECTS, *CUT_OUTSIDE])
    def test_at_size_zero_nothing_changes_and_at_full_size_something_does(self, name: str) -> None:
        effect = (CUT_EFFECTS | CUT_OUTSIDE)[name]
        assert effect.plant(Mill(), 0.0) == Mill()
        cuts = [Cut(revolutions=20), Cut(revolutions=20, air=True)]
        bare, changed = (measure_cuts(m, cuts, 2) for m in (Mill(), effect.plant(Mill(), effect.size)))
        assert max(np.std(c["force"] - b["force"]) for b, c in zip(bare, changed, strict=True)) > 1.0

    def test_an_examination_in_cutting_is_sealed_too(self) -> None:
        exam = draw_cuts("0f3a", effects=["runout"], design="feeds")
        assert exam.reveal("run-out").effects == {"runout": 0.2}
        assert len(exam.records) == 4
