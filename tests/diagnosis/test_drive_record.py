"""Drive records of an axis that is simulated here by its own means: bristle friction, a sampled controller, an encoder.

The simulation uses nothing of the packages: Runge-Kutta of fourth order with ten steps a sample, a controller that sees
a quantised, noisy encoder, a force that is held for a sample and comes late by any fraction of one.
"""

from dataclasses import dataclass

import numba
import numpy as np
import pytest

from process.errors import InputError
from process.labels import make_record
from smfe.diagnosis.drive_control_law import Gains, fit_control_law, unlogged_command
from smfe.diagnosis.drive_ladder import force_ladder
from smfe.diagnosis.drive_record import DriveRecordFamily
from smfe.diagnosis.drive_signals import Motion, Resampler, filtered, kernel, motion
from smfe.diagnosis.drive_terms import presliding
from smfe.diagnosis.engine import diagnose

STEP = 1e-3
POSITION_GAIN, VELOCITY_GAIN = 160.0, 8500.0
MASS, VISCOUS, OFFSET = 95.0, 240.0, -3.0
QUANTUM = 5e-8


@dataclass(frozen=True)
class Truth:
    """What is planted (SI)."""

    coulomb: float = 0.0
    static: float = 0.0
    stribeck_speed: float = 0.02
    asymmetry: float = 0.0
    delay: float = 0.0
    ripple: float = 0.0
    lead: float = 2.5e-3
    pulses: float = 0.0


def reference(seconds: float) -> np.ndarray:
    """Strokes of four moves at 40, 80, 120 and 40 mm/s, forth and back, each from rest to rest at 1.2 m/s2."""
    velocity: list[np.ndarray] = []
    way, total = 1.0, 0
    while total < seconds / STEP:
        for speed, time in ((0.04, 0.45), (0.08, 0.7), (0.12, 0.9), (0.04, 0.45)):
            t = np.arange(round(time / STEP)) * STEP
            velocity.append(way * np.clip(1.2 * np.minimum(t, time - t), 0.0, speed))
            total += t.size
        way = -way
    smooth = np.convolve(np.concatenate(velocity), np.ones(12) / 12.0, mode="same")
    return np.cumsum(smooth)[: round(seconds / STEP)] * STEP


def pulse_train(samples: int) -> np.ndarray:
    """Ones for 50 ms every 0.9 s."""
    k = np.arange(samples)
    return np.where((k % 900 >= 300) & (k % 900 < 350), 1.0, 0.0)


@numba.njit
def _slope(x, v, z, force, p):
    speed = abs(v)
    level = p[0] + (p[1] - p[0]) * np.exp(-speed / p[2])
    if level > 0.0:
        rate = v - 4e6 * speed * z / level
        bristle = 4e6 * z + 600.0 * rate
    else:
        rate, bristle = 0.0, 0.0
    friction = bristle + p[6] * v + p[3] * speed + p[7]
    wave = p[4] * np.sin(2.0 * np.pi * x / p[5])
    return v, (force - friction - wave) / p[8], rate


@numba.njit
def _run(target, added, noise, disturbance, delay, p):
    n, fine = target.size, 10
    h = 1e-3 / fine
    q, u = np.zeros(n), np.zeros(n)
    x, v, z = target[0], 0.0, 0.0
    for k in range(n):
        q[k] = np.round((x + noise[k]) / 5e-8) * 5e-8
        before = q[k - 1] if k > 0 else q[k]
        u[k] = 8500.0 * (160.0 * (target[k] - q[k]) - (q[k] - before) / 1e-3) + added[k]
        for j in range(fine):
            at = k + (j + 0.5) / fine - delay / 1e-3
            i = int(np.floor(at))
            force = (u[i] if i >= 0 else 0.0) + disturbance[k]
            a1, b1, c1 = _slope(x, v, z, force, p)
            a2, b2, c2 = _slope(x + 0.5 * h * a1, v + 0.5 * h * b1, z + 0.5 * h * c1, force, p)
            a3, b3, c3 = _slope(x + 0.5 * h * a2, v + 0.5 * h * b2, z + 0.5 * h * c2, force, p)
            a4, b4, c4 = _slope(x + h * a3, v + h * b3, z + h * c3, force, p)
            x += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
            v += h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0
            z += h * (c1 + 2.0 * c2 + 2.0 * c3 + c4) / 6.0
    return q, u


def simulate(truth: Truth, seed: int, seconds: float = 24.0) -> dict[str, np.ndarray]:
    """Return time, encoder position, drive force (command, without the lag of the hold) and reference."""
    rng = np.random.default_rng(seed)
    target = reference(seconds)
    n = target.size
    white = rng.standard_normal(n)
    slow = np.zeros(n)
    for k in range(1, n):
        slow[k] = 0.8 * slow[k - 1] + white[k]
    p = np.array(
        [
            truth.coulomb,
            max(truth.static, truth.coulomb),
            truth.stribeck_speed,
            truth.asymmetry,
            truth.ripple,
            truth.lead,
            VISCOUS,
            OFFSET,
            MASS,
        ]
    )
    added = truth.pulses * pulse_train(n)
    q, u = _run(target, added, 2e-8 * rng.standard_normal(n), 0.5 * slow, truth.delay, p)
    return {"time": np.arange(n) * STEP, "encoder": q, "force": u, "reference": target, "pulses": added}


def family(truth: Truth, seed: int = 1, seconds: float = 24.0, **options: object) -> DriveRecordFamily:
    s = simulate(truth, seed, seconds)
    record = make_record(
        s["time"],
        {
            "encoder_position": {"x": s["encoder"]},
            "drive_force": {"x": s["force"]},
            "reference_position": {"x": s["reference"]},
        },
    )
    return DriveRecordFamily.from_record(record, **options)


def null_values(family: DriveRecordFamily) -> dict[str, float]:
    every = [*family.nuisances, *(p for c in family.causes for p in c.parameters)]
    return {p.name: p.start for p in every}


@pytest.fixture(scope="module")
def full() -> DriveRecordFamily:
    """A record with friction, a direction, a delay, a ripple; with mass and gains known."""
    truth = Truth(coulomb=20.0, asymmetry=-37.0, delay=0.25e-3, ripple=1.0)
    return family(truth, mass=(MASS, 1.0), gains=Gains(POSITION_GAIN, VELOCITY_GAIN))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_sine_in_the_band_is_differentiated_as_in_closed_form(order: int) -> None:
    """Derivatives of sin(w t) at half the cutoff, to 1e-5 of their size."""
    t, w, cutoff = np.arange(2000) * STEP, 2.0 * np.pi * 50.0, 100.0
    exact = [np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)][order]
    inside = slice(200, -200)
    assert filtered(np.sin(w * t), STEP, cutoff, order)[inside] == pytest.approx(exact[inside], abs=1e-5 * w**order)


def test_the_kernel_is_one_half_at_its_cutoff_and_its_derivatives_are_its_slopes() -> None:
    t = np.arange(-400, 401) * 2.5e-4
    assert 2.5e-4 * float(kernel(t, 100.0) @ np.cos(2.0 * np.pi * 100.0 * t)) == pytest.approx(0.5, abs=1e-6)
    h = 1e-6
    for order in (1, 2):
        slope = (kernel(t + h, 100.0, order - 1) - kernel(t - h, 100.0, order - 1)) / (2.0 * h)
        assert kernel(t, 100.0, order) == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("advance", [0.0, 0.37e-3, 0.75e-3, 2.2e-3])
def test_a_delay_of_any_fraction_of_a_sample_is_a_linear_phase(advance: float) -> None:
    filter_ = Resampler(STEP, 45.0, 11, 5)
    t, w = np.arange(3000) * STEP, 2.0 * np.pi * 20.0
    seen = t[filter_.margin : t.size - filter_.margin : 11]
    assert filter_(np.sin(w * t), advance) == pytest.approx(np.sin(w * (seen + advance)), abs=2e-5)


def test_presliding_is_the_integral_of_its_differential_equation() -> None:
    """dz/dx = (1 - z sign v)/d by small explicit steps, over two reversals; the axis that stops short does not slip."""
    t = np.arange(20_001) * 1e-4
    x, v = 1e-4 * np.sin(2.0 * np.pi * t), 1e-4 * 2.0 * np.pi * np.cos(2.0 * np.pi * t)
    z, slow = presliding(x, v, 2e-5), [1.0]
    for step, way in zip(np.diff(x), np.sign(v[1:]), strict=True):
        slow.append(slow[-1] + (1.0 - slow[-1] * way) / 2e-5 * step)
    assert z == pytest.approx(np.array(slow), abs=0.01)
    assert presliding(x[:2000], np.abs(v[:2000]), 2e-5) == pytest.approx(1.0)


def test_every_cause_nests_the_baseline(full: DriveRecordFamily) -> None:
    """At the null of what acts the prediction is the baseline's, wherever the shapes are; beyond the null it is not."""
    null = null_values(full)
    for condition in (full.conditions[3], full.conditions[-3]):
        baseline = full.predict(condition, null)
        for cause in full.causes:
            for start in cause.starts or (tuple(p.start for p in cause.parameters),):
                values = {**null, **{p.name: s for p, s in zip(cause.parameters, start, strict=True)}}
                assert np.max(np.abs(full.predict(condition, values) - baseline)) < 1e-10
    for cause in full.causes:
        moved = {**null, cause.parameters[0].name: cause.parameters[0].start + cause.parameters[0].scale}
        assert any(np.any(full.predict(c, moved) != full.predict(c, null)) for c in full.conditions)


def test_admissible_friction_never_drives_the_axis(full: DriveRecordFamily) -> None:
    """Coulomb, Stribeck and lubricant friction against the motion, at every admissible corner; inertia is positive."""
    v = np.concatenate([np.linspace(-0.1, 0.1, 4001)])
    m = Motion(v * 0.0, np.cumsum(v) * 1e-3, v, v * 0.0, v * 0.0, v * 0.0)
    for term in full.model.terms:
        if term.cause.id == "low_speed_friction":
            low, (speed_low, speed_high) = term.cause.parameters[0].low, (1e-3, 0.1)
            assert low == 0.0
            for speed in (speed_low, speed_high):
                names = [p.name for p in term.cause.parameters]
                assert np.all(term.force(m, dict(zip(names, (5.0, speed), strict=True))) * v >= 0.0)
        if term.cause.id in ("guideway_friction", "missing_mode"):
            assert term.cause.parameters[0].low == 0.0
    assert full.nuisances[0].low == 0.0
    assert full.nuisances[1].low == 0.0


def test_planted_values_are_found(full: DriveRecordFamily) -> None:
    """Friction 20 N, asymmetry -37 N s/m, 0.5 ms of the hold and 0.25 ms, ripple of 1 N at 2.5 mm, mass 95 kg."""
    causes = ["guideway_friction/coulomb", "friction_asymmetry", "loop_delay", "position_ripple"]
    rungs = force_ladder(full, causes)
    found = rungs[-1].values
    assert found["mass"] == pytest.approx(MASS, rel=0.01)
    assert found["coulomb.force"] == pytest.approx(20.0, rel=0.03)
    assert found["asymmetry.viscous"] == pytest.approx(-37.0, rel=0.05)
    assert found["loop_delay.delay"] == pytest.approx(0.75e-3, abs=0.06e-3)
    assert np.hypot(found["ripple.cosine"], found["ripple.sine"]) == pytest.approx(1.0, rel=0.1)
    assert found["ripple.lead"] == pytest.approx(2.5e-3, rel=2e-3)
    errors = [r.error for r in rungs]
    assert errors == sorted(errors, reverse=True)


def test_the_control_law_tells_a_command_that_was_not_logged() -> None:
    """Pulses of 150 N in the drive force: height within 2 %, correlation 0.999, velocity half a sample late."""
    s = simulate(Truth(coulomb=20.0, delay=0.25e-3, pulses=150.0), 2, 12.0)
    gains = Gains(POSITION_GAIN, VELOCITY_GAIN)
    law = fit_control_law(s["reference"], s["encoder"], s["force"], STEP, gains)
    left, pulses = unlogged_command(law, s["reference"], s["encoder"], s["force"], STEP)
    assert law.lag(STEP) == pytest.approx(0.5 * STEP, abs=1e-6)
    assert np.corrcoef(left, s["pulses"])[0, 1] > 0.999
    assert [p.height for p in pulses] == pytest.approx([150.0] * 13, rel=0.02)
    assert [p.begin for p in pulses] == pytest.approx([0.3 + 0.9 * k for k in range(13)], abs=1e-9)


def test_a_silent_control_law_has_no_pulses(full: DriveRecordFamily) -> None:
    assert full.pulses == ()
    assert "hidden_input/command" not in [c.key for c in full.causes]


def test_other_gains_are_found_from_the_control_law() -> None:
    """Gains documented 10 % too low and 5 % too high."""
    wrong = family(Truth(coulomb=20.0), seconds=12.0, gains=Gains(POSITION_GAIN / 1.1, VELOCITY_GAIN / 0.95))
    found = force_ladder(wrong, ["servo_gains"])[-1].values
    assert found["servo_gains.position"] == pytest.approx(0.1, abs=1e-3)
    assert found["servo_gains.velocity"] == pytest.approx(-0.05, abs=1e-3)


def test_what_a_record_needs_is_said() -> None:
    t = np.arange(30_000) * STEP
    channels = {"encoder_position": {"x": 0.01 * np.sin(t)}}
    with pytest.raises(InputError, match="has no drive_force_x"):
        DriveRecordFamily.from_record(make_record(t, channels))
    moving = 0.1 * np.sin(8.0 * t)
    force = 64.0 * moving + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    backwards = make_record(t, {"encoder_position": {"x": moving}, "drive_force": {"x": force}})
    with pytest.raises(InputError, match="check the sign"):
        DriveRecordFamily.from_record(backwards)
    with pytest.raises(InputError, match="four times the band"):
        family(Truth(), seconds=12.0, cutoff=300.0)
    with pytest.raises(InputError, match="known delay"):
        family(Truth(), seconds=12.0, delay=-1.0)


def test_motion_is_that_of_the_axis() -> None:
    """A parabola has its constant acceleration and neither jerk nor snap (within what rounding makes of them)."""
    t = np.arange(1000) * STEP
    m = motion(0.6 * t**2, STEP, 90.0)[400:600]
    assert m.velocity == pytest.approx(1.2 * t[400:600], rel=1e-6)
    assert m.acceleration == pytest.approx(1.2, rel=1e-4)
    assert np.abs(m.jerk).max() < 1e-2


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing() -> None:
    """Rigid, viscous axes; the half sample of the hold is known. Feedback makes no flexibility of the noise."""
    found = [diagnose(family(Truth(), seed, delay=0.5 * STEP)) for seed in (1, 3, 6)]
    assert all(f.causes == () and f.verdict != "unknown" for f in found)
    assert found[0].verdict == "consistent"


def test_each_kind_of_move_has_its_own_noise() -> None:
    """The noise that is added backwards only is three times as loud there, and the whitened residuals are not."""
    s = simulate(Truth(), 1)
    back = np.diff(s["reference"], append=s["reference"][-1]) < 0.0
    louder = s["force"] + np.where(back, 6.0, 0.5) * np.random.default_rng(0).standard_normal(back.size)
    channels = {"encoder_position": {"x": s["encoder"]}, "drive_force": {"x": louder}}
    made = DriveRecordFamily.from_record(make_record(s["time"], channels), delay=0.5 * STEP, cutoff=30.0)
    noise = made.model.noise
    assert all(noise["backward", v] > 2.0 * noise["forward", v] for v in (0.04, 0.08, 0.1))
    null = null_values(made)
    for way in ("forward", "backward"):
        moves = [c for c in made.conditions if c.settings["direction"] == way]
        left = np.concatenate([c.observed - made.predict(c, null) for c in moves])
        assert np.mean(left**2) == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_friction_and_delay_are_named() -> None:
    """Both and no other: lubricant friction looks nearly like Coulomb's, and fits worse by thousands."""
    finding = diagnose(family(Truth(coulomb=20.0)))
    assert finding.verdict == "named"
    assert [c.id for c in finding.causes] == ["guideway_friction", "loop_delay"]
    force, delay = finding.causes[0].parameters[0], finding.causes[1].parameters[0]
    assert force.low <= 20.0 <= force.high
    assert delay.value == pytest.approx(0.5, abs=0.03)


@pytest.mark.slow
def test_the_direction_is_named() -> None:
    finding = diagnose(family(Truth(asymmetry=-37.0), delay=0.5 * STEP))
    assert finding.verdict == "named"
    assert [c.id for c in finding.causes] == ["friction_asymmetry"]
