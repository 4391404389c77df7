"""The electro-mechanical positioning system (EMPS, Janot, Gautier and Brunot 2019): a real ball-screw axis.

Everything is learnt from the first record. The second, with pulses added to the command, is only ever predicted. The
rule, fixed before it is read, is the one of the engine: a cause enters when its likelihood ratio passes the threshold
calibrated over the catalogue and it gains 1 dB on moves that the fit did not see, all of the first record; the search
ends where none does; the pulse record is predicted once with what was accepted and has no say in it.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from places import DATA
from samples.drive_steps import ForceStep, Repeats, force_steps
from scipy import io

from process.labels import make_record
from smfe.diagnosis.drive.control_law import Gains, fit_control_law, unlogged_command
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.drive.terms import Term
from smfe.diagnosis.inference.problem import Cause, Parameter
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.materiality import Worth

STEP, DRIVE_GAIN = 1e-3, 35.15065188
GAINS = Gains(160.18, 243.45 * DRIVE_GAIN)
NAMED = ("guideway_friction/coulomb", "loop_delay", "low_speed_friction/shear", "friction_asymmetry")


def content(name: str) -> dict[str, np.ndarray]:
    path = DATA / "emps" / name
    if not path.is_file():
        pytest.skip(f"{path} is not here; set SMFE_DATA to the folder of public data")
    return {k: v.ravel().astype(float) for k, v in io.loadmat(path).items() if isinstance(v, np.ndarray)}


def record(name: str) -> xr.Dataset:
    """The drive signal is in volts, whatever its documentation says."""
    found = content(name)
    channels = {
        "encoder_position": {"x": found["qm"]},
        "drive_force": {"x": DRIVE_GAIN * found["vir"]},
        "reference_position": {"x": found["qg"]},
    }
    return make_record(np.arange(found["qm"].size) * STEP, channels)


@pytest.fixture(scope="module")
def first() -> DriveRecordFamily:
    return DriveRecordFamily.from_record(record("DATA_EMPS.mat"))


@pytest.fixture(scope="module")
def pulses(first: DriveRecordFamily) -> DriveRecordFamily:
    return DriveRecordFamily.from_record(record("DATA_EMPS_PULSES.mat"), like=first, name="pulses,")


@pytest.fixture(scope="module")
def steps(first: DriveRecordFamily, pulses: DriveRecordFamily) -> tuple[ForceStep, ...]:
    return force_steps(first, [*NAMED, "position_ripple", "position_friction"], [pulses])


@pytest.mark.slow
def test_the_force_error_falls_on_the_record_that_was_not_fitted(steps: tuple[ForceStep, ...]) -> None:
    """Below 30 Hz from 19 % to 3.0 % and better; the mass agrees with 95.15 kg of the authors within 1 %."""
    baseline, named = steps[0], steps[len(NAMED)]
    assert 0.16 < baseline.held_out[0] < 0.20
    assert named.held_out[0] <= 0.030
    assert named.error <= 0.020
    assert steps[-1].error <= 0.016
    assert steps[-1].held_out[0] <= 0.030
    assert named.values["mass"] == pytest.approx(95.15, rel=0.01)


@pytest.mark.slow
def test_the_loop_is_late_and_not_flexible(first: DriveRecordFamily, steps: tuple[ForceStep, ...]) -> None:
    """0.65 to 0.85 ms; a flexible mode gains nothing at all. The screw has its lead of 2.5 mm."""
    values = steps[-1].values
    assert 0.65e-3 <= values["loop_delay.delay"] <= 0.85e-3
    assert values["ripple.lead"] == pytest.approx(2.5e-3, rel=0.005)
    assert values["asymmetry.viscous"] == pytest.approx(-0.5 * (240.42 - 166.71), rel=0.08)
    flexible = force_steps(first, [*NAMED, "position_ripple", "position_friction", "missing_mode"])[-1]
    assert flexible.chi2 == pytest.approx(steps[-1].chi2, abs=0.1)
    assert flexible.values["mode.compliance"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_friction_near_rest_hides_behind_the_delay(first: DriveRecordFamily) -> None:
    """Without the delay it gains less than 1 dB of misfit, with it more than 3 dB; it falls towards rest."""
    before = force_steps(first, ["guideway_friction/coulomb", "friction_asymmetry", "low_speed_friction/shear"])
    after = force_steps(
        first, ["guideway_friction/coulomb", "friction_asymmetry", "loop_delay", "low_speed_friction/shear"]
    )
    assert 10.0 * np.log10(before[-2].chi2 / before[-1].chi2) < 1.0
    assert 10.0 * np.log10(after[-2].chi2 / after[-1].chi2) > 3.0
    boost = force_steps(first, ["guideway_friction/coulomb", "loop_delay", "low_speed_friction/stribeck"])[-1]
    assert boost.values["stribeck.boost"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_a_term_without_physics_gains_nothing_on_the_other_record(
    first: DriveRecordFamily, pulses: DriveRecordFamily, steps: tuple[ForceStep, ...]
) -> None:
    """a |a| makes the first record 0.3 dB better, and the second by less than a tenth of what has to be gained."""
    factor = Parameter("factor", "N s4/m2", 0.0, 0.1)
    term = Term(
        Cause("no_physics", "a |a|", (factor,)), lambda m, p: p["factor"] * m.acceleration * np.abs(m.acceleration)
    )
    more = first.with_terms([term])
    other = DriveRecordFamily.from_record(record("DATA_EMPS_PULSES.mat"), like=more)
    found = force_steps(more, [*NAMED, "position_ripple", "position_friction", "no_physics"], [other])[-1]
    assert 20.0 * math.log10(steps[-1].error / found.error) > 0.2
    assert 20.0 * math.log10(steps[-1].held_out[0] / found.held_out[0]) < 0.1


@pytest.mark.slow
def test_the_hidden_command_is_named() -> None:
    """With the gains, without the channel of the pulses: 5 V, in the control law; nothing of it in the first record."""
    law = {"gains": GAINS}
    made = DriveRecordFamily.from_record(record("DATA_EMPS_PULSES.mat"), **law)
    assert "hidden_input/command" in [c.key for c in made.causes]
    assert "hidden_input/command" not in [
        c.key for c in DriveRecordFamily.from_record(record("DATA_EMPS.mat"), **law).causes
    ]
    finding = diagnose(replace(made, conditions=tuple(c for c in made.conditions if c.name.startswith("control"))))
    (cause,) = (c for c in finding.causes if c.id == "hidden_input")
    assert cause.parameters[0].value == pytest.approx(5.0 * DRIVE_GAIN, rel=0.02)


def test_the_control_law_finds_the_pulses_that_were_added() -> None:
    """25 pulses of 5 V: within 2 %, correlation 0.999, edges within 2 ms; the first record has none."""
    channels = [
        (d["qg"], d["qm"], DRIVE_GAIN * d["vir"]) for d in map(content, ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"))
    ]
    law = fit_control_law(*channels[0], STEP, GAINS)
    assert unlogged_command(law, *channels[0], STEP)[1] == ()
    assert law.lag(STEP) == pytest.approx(STEP, abs=1e-4)
    left, found = unlogged_command(law, *channels[1], STEP)
    truth = content("DATA_EMPS_PULSES.mat")["pulses_N"]
    starts = np.flatnonzero(np.diff(truth) > 0.0) + 1
    assert np.corrcoef(left, truth)[0, 1] >= 0.999
    assert [p.height / DRIVE_GAIN for p in found] == pytest.approx([5.0] * 25, rel=0.02)
    assert [p.begin for p in found] == pytest.approx((starts * STEP).tolist(), abs=2e-3)


@pytest.mark.slow
def test_the_engine_finds_the_causes_and_says_what_remains(first: DriveRecordFamily, pulses: DriveRecordFamily) -> None:
    """Accepted by the rule of the engine from the first record alone; the second is predicted once, at the end.

    Friction and its direction, the delay as what was given wrongly, the screw as too small to matter; no flexibility
    and no drift, and a remainder of 1.4 % of the force. What others have published of the second record was known.
    """
    both = replace(first, conditions=(*first.conditions, *pulses.conditions))
    finding = diagnose(both, held_out=[c.name for c in pulses.conditions], worth=Worth(0.05))
    assert {c.id for c in finding.causes} == {"guideway_friction", "friction_asymmetry", "low_speed_friction"}
    assert "position_ripple" in [c.id for c in finding.immaterial]
    assert finding.verdict == "named"
    assert finding.alternatives == ()
    assert finding.remainder is not None
    assert finding.remainder.misfit_db < 4.0
    assert finding.remainder.share < 0.015
    assert finding.remainder.size < 0.02
    (delay,) = (g for g in finding.given if g.cause == "loop_delay")
    assert delay.low >= 0.65
    assert delay.high <= 0.85
    assert finding.held_out_gain.share > 0.9
    accepted = [f"{c.id}/{c.variant}" if c.variant else c.id for c in finding.causes]
    values = force_steps(first, ["loop_delay", *accepted, "position_ripple"], [pulses])[-1]
    assert values.held_out[0] <= 0.029
    assert all(c.gain_db > 2.0 for c in finding.causes)


def free_run(name: str, values: Mapping[str, float], centre: float) -> float:
    """Rms error [mm] of the position simulated from the drive signal alone after 20 samples of the record.

    That is how nonlinearbenchmark.org ranks models of this axis. Quarter samples, symplectic Euler, bristles exactly.
    """
    found = content(name)
    q, n = found["qm"], found["qm"].size
    fine = np.arange(4 * n) * STEP / 4.0 - values["loop_delay.delay"]
    force = np.interp(fine, np.arange(n) * STEP, DRIVE_GAIN * found["vir"])
    known = {k: values.get(k, 0.0) for k in ("coulomb.force", "coulomb.damping", "shear.force", "asymmetry.viscous")}
    slide, slow = values.get("coulomb.slide", 1e-6), values.get("shear.speed", 1.0)
    wave, h, z, x, v = 2.0 * math.pi / values["ripple.lead"], STEP / 4.0, 0.0, q[19], (q[19] - q[9]) / (10.0 * STEP)
    out = q.copy()
    for i in range(4 * 19, 4 * n):
        if i % 4 == 0:
            out[i // 4] = x
        way = math.copysign(1.0, v)
        after = way + (z - way) * math.exp(-abs(v) * h / slide)
        dry = known["coulomb.force"] * (after + known["coulomb.damping"] * (after - z) / h)
        dry += known["shear.force"] * -math.expm1(-abs(v) / slow) * after
        z, angle = after, wave * (x - centre)
        other = values["viscous"] * v + known["asymmetry.viscous"] * abs(v) + values["offset"]
        other += values["ripple.cosine"] * math.cos(angle) + values["ripple.sine"] * math.sin(angle)
        v += h * (force[i] - dry - other) / values["mass"]
        x += h * v
    return 1e3 * float(np.sqrt(np.mean(np.square(out[20:] - q[20:]))))


@pytest.mark.slow
def test_the_position_follows_from_the_drive_signal_alone(steps: tuple[ForceStep, ...]) -> None:
    """Free run over 24.8 s: some millimetres of 83 mm (rms), the baseline several times as many.

    What drifts in a free run is 0.1 N of friction that changed between the records, and of the baseline 10 N s/m of a
    viscous friction that stands for another law (26 or 43 mm); it ranks no models.
    """
    centre = float(np.mean(content("DATA_EMPS.mat")["qm"]))
    for name, most in (("DATA_EMPS.mat", 6.0), ("DATA_EMPS_PULSES.mat", 9.0)):
        before, after = (free_run(name, s.values, centre) for s in (steps[0], steps[len(NAMED) + 1]))
        assert after < most
        assert before > 3.0 * after


@pytest.mark.slow
def test_what_the_model_leaves_comes_again(first: DriveRecordFamily, steps: tuple[ForceStep, ...]) -> None:
    """The moves repeat after 6.24 s, to less than 0.3 N; the model leaves three times as much, each time the same.

    That is why the verdict on the whole record is "unknown": 2 % of the force are no noise, and no cause explains them.
    """
    period, scatter, remainder = Repeats(record("DATA_EMPS.mat"), "x", first, steps[-1].values).repeatability()
    assert period == pytest.approx(6.24, abs=1e-9)
    assert 0.15 < scatter < 0.35
    assert 2.0 * scatter < remainder < 5.0 * scatter


@pytest.mark.slow
def test_nothing_has_changed_between_the_halves(first: DriveRecordFamily) -> None:
    """The model of the first half, with what it left there, against the second, with the scatter between repeats."""
    causes = [*(c for c in NAMED if c != "loop_delay"), "position_ripple"]  # the dead time is of the baseline
    half = first.settled([], {p.name: p.start for p in first.nuisances}, "first half")
    values = force_steps(half, causes)[-1].values
    later = Repeats(record("DATA_EMPS.mat"), "x", first.settled(causes, values), values).since_first_half()
    finding = diagnose(later)
    assert finding.causes == ()
    assert finding.verdict == "consistent"
    # An offset of 0.4 N over the half stroke, 1 % of the force, would have been seen.
    (slope,) = (p.size for p in finding.detectable if p.parameter == "bend.offset_slope")
    assert slope < 0.5
