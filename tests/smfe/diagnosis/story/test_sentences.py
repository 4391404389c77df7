"""Claims: the first sentence says what is wrong and what is gained; then numbers, millimetres, what to do next."""

from dataclasses import replace

import numpy as np
import pytest

from smfe.diagnosis.checks.suspect import fault, warning
from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.thresholds import Detectable
from smfe.diagnosis.judgement.finding import (
    Estimate,
    Finding,
    ForetoldCut,
    FoundCause,
    GivenParameter,
    ModelError,
    Pocket,
    Remainder,
    StableDepth,
)
from smfe.diagnosis.judgement.next_experiment import Proposal, Revealed
from smfe.diagnosis.story.causes import Friction, _one
from smfe.diagnosis.story.sentences import Setting, told
from smfe.diagnosis.story.to_do import action

RISE = (Estimate("stribeck_coulomb", 40.2, 37.4, 43.0, "N"), Estimate("static_rise", 45.6, 43.1, 48.1, "N"))
FRICTION = FoundCause("guideway_friction", "stribeck", "Stribeck friction", "physics", RISE, 900.0, 41.0, 1.0)
DELAY = FoundCause(
    "loop_delay", "", "a dead time", "physics", (Estimate("extra_delay", 0.82, 0.80, 0.85, "ms"),), 99.0, 7.6, 0.4
)
GAIN = FoundCause("sensor_gain", "", "gain of a sensor", "measurement", (), 99.0, None, None)
ERRORS = (
    ModelError("measurements", 2, "set aside", 0.31, 0.04),
    ModelError("measurements", 4, "left out in turn", 0.35, 0.05),
)
BARE = Setting()
BRAKED = Setting(Friction("x", 86.0, 500.0, 37.4))


def say(about: str, finding: Finding, setting: Setting = BARE) -> list[str]:
    return [p.text for p in told(finding, setting) if p.about == about]


def test_the_first_sentence_says_what_is_left_out_and_what_is_gained_on_what_no_fit_has_seen() -> None:
    found = Finding("named", "it is", (FRICTION,), errors=ERRORS)
    assert told(found, BRAKED)[0].text == (
        "The simulation leaves out guideway friction: it brakes the x axis 2.3 times more at rest (86 N) than at "
        "500 mm/min (37 N). With it the error on the two measurements set aside falls from 31 % as declared to 4.0 % "
        "(18 dB)."
    )


def test_a_force_that_the_measurements_leave_open_is_told_as_open() -> None:
    """Hits that do not push a slide off its guideway show that it is held, and not how hard."""
    found = Finding("named", "it is", (FRICTION,), errors=ERRORS)
    open_ = Friction("x", 190.0, 600.0, 180.0, (0.0, 900.0), (0.0, 880.0))
    first = told(found, Setting(open_))[0].text
    held = "it holds the x axis at rest, how hard these measurements do not tell (0 to 900 N would fit)"
    assert f"{held}." in first
    assert "180" not in first
    braked = replace(open_, moving_interval=(170.0, 190.0))
    assert f"{held}, and brakes it with 180 N at 600 mm/min." in told(found, Setting(braked))[0].text
    known = replace(open_, rest_interval=(170.0, 210.0))
    assert (
        "up to 190 N; what brakes it at 600 mm/min is open (0 to 880 N would fit)."
        in told(found, Setting(known))[0].text
    )


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            ERRORS[1],
            "the error on four measurements left out of the fit in turn falls from 35 % as declared to 5.0 % (17 dB).",
        ),
        (
            ModelError("cuts", 1, "fitted", 0.2, 0.1),
            "the error on the cut that was fitted falls from 20 % as declared to 10 % (6 dB); no measurement could be "
            "left out of the fit to prove it.",
        ),
        (ModelError("moves", 30, "set aside", 0.02, 0.04), "With it the error on the 30 moves set aside rises from"),
    ],
)
def test_the_gain_says_what_it_was_measured_on(error: ModelError, said: str) -> None:
    assert said in say("verdict", Finding("named", "it is", (DELAY,), errors=(error,)))[0]


def test_a_share_is_neither_higher_nor_lower_and_a_change_along_the_stroke_is() -> None:
    share = (Estimate("micro_slip_share", 6.0, 5.0, 7.0, "%"),)
    slip = FoundCause("joint_micro_slip", "", "micro-slip", "physics", share, 9.0, 3.0, 1.0)
    assert "share of the stiffness that slips 6.0 %. " in told(Finding("named", "", (slip,), errors=ERRORS))[0].text
    along = (Estimate("stiffness_per_metre", -6.0, -7.0, -5.0, "%/m"),)
    posture = FoundCause("posture", "", "posture", "physics", along, 9.0, 3.0, 1.0)
    assert ": stiffness 6.0 % lower a metre further. " in told(Finding("named", "", (posture,), errors=ERRORS))[0].text
    insert = FoundCause(
        "runout", "inserts", "inserts", "physics", (Estimate("radius_2", 15.0, 14.0, 16.0, "um"),), 9.0, 3.0, 1.0
    )
    assert "radius of tooth 2: 15 µm" in told(Finding("named", "", (insert,), errors=ERRORS))[0].text


def test_what_the_measurement_holds_besides_is_no_fault_of_it() -> None:
    size = (Estimate("unbalance", 1.28, 1.13, 1.44, "g mm"),)
    found = FoundCause("background_tone", "unbalance", "unbalance", "measurement", size, 9.0, 12.7, 1.0)
    assert say("verdict", Finding("named", "", (found,)))[0].startswith(
        "The measurement holds something else: the spindle or tool is out of balance: 1.3 g mm."
    )
    assert (
        "Besides, the measurement holds something else: the" in say("verdict", Finding("named", "", (DELAY, found)))[0]
    )


def test_a_sensor_of_the_wrong_sign_is_the_one_that_its_parameter_names() -> None:
    for name, said, do in (
        ("reversed_x", "the sign of the accelerometer along x is wrong", "sign = -1 on the sensor along x"),
        ("sign_x", "channel x of the force sensor has the wrong sign", "sign = -1 on force_x in"),
        (
            "sign",
            "all channels of the force sensor have the wrong sign",
            "sign = -1 on force_x, force_y and force_z in",
        ),
    ):
        variant = "sign" if name == "sign" else "sign_x"
        found = FoundCause(
            "sensor_gain", variant, "", "measurement", (Estimate(name, 1.0, 0.9, 1.1, "1"),), 9.0, 3.0, 1.0
        )
        assert f"The measurement is at fault: {said}." in say("verdict", Finding("named", "", (found,)))[0]
        assert do in action(found)


def test_the_gain_is_told_from_what_was_declared_and_the_best_without_the_cause_stands_beside_it() -> None:
    e = ModelError("measurements", 1, "set aside", 0.12, 0.004, 0.8)
    said = say("verdict", Finding("named", "it is", (DELAY,), errors=(e,)))[0]
    assert said.endswith(
        "With it the error on the measurement set aside falls from 12 % as declared to 0.40 % (30 dB); refitted "
        "without it the simulation is 80 % wrong there."
    )
    alike = replace(e, refitted=0.125)
    assert "refitted" not in say("verdict", Finding("named", "it is", (DELAY,), errors=(alike,)))[0]
    healthy = Finding("consistent", "it is", errors=(replace(e, before=0.08, after=0.02, refitted=0.02),))
    assert say("verdict", healthy)[0].endswith(
        "no more than noise (error 8.0 % as declared, 2.0 % with its values fitted within their tolerances)."
    )


def test_what_is_left_out_and_what_is_wrong_with_the_measurement_are_told_apart() -> None:
    both = Finding("named", "it is", (FRICTION, DELAY, GAIN), errors=ERRORS)
    assert say("verdict", both)[0].startswith(
        "The simulation leaves out guideway friction and a dead time in the control loop. Besides, the measurement is "
        "at fault: the gain of a sensor is off. With them"
    )
    alone = Finding("named", "it is", (GAIN,), errors=ERRORS)
    assert say("verdict", alone)[0].startswith("The measurement is at fault: the gain of a sensor is off. With it")


def test_each_cause_has_a_sentence_with_its_numbers_and_what_it_is_worth() -> None:
    friction, delay, gain = say("cause", Finding("named", "it is", (FRICTION, DELAY, GAIN), errors=ERRORS), BRAKED)
    assert "friction at rest beyond sliding 45.6 N (43.1 to 48.1)" in friction
    assert delay == (
        "A dead time in the control loop: 0.820 ms (0.800 to 0.850); without it the error that repeats is 2.4 times as "
        "large (8 dB), on values left out of the fit."
    )
    assert gain.endswith("not proven on values that it was not fitted to.")


def test_declared_values_of_a_set_are_proven_by_what_they_gain_on_conditions_left_out() -> None:
    alike = [replace(GAIN, variant="declared", set=1), replace(DELAY, variant="declared", gain_db=None, set=1)]
    found = Finding("named", "it is", tuple(alike), errors=ERRORS, gain=Gain(23.0, 1.0, 23.0, 0.99, 20.0))
    assert "not proven" not in " ".join(say("cause", found))
    assert "not proven" in " ".join(say("cause", replace(found, gain=Gain(0.2, 1.0, 0.2, 0.05, -1.0))))


def test_of_a_set_each_declared_value_stands_with_what_it_would_be_alone() -> None:
    """Where the coefficients are released in the fit the gain stays as declared: that is not what it would be."""
    gain = GivenParameter("gain", "gain", "sensor_gain", 0.0, 1.0, 0.1, -1.9, 2.0, "%", True)
    alone = replace(GAIN, variant="declared", parameters=(Estimate("gain", 22.5, 13.3, 31.7, "%"),), set=1)
    other = FoundCause("force_coefficients", "declared", "Ktc", "declared", (), 9.0, None, None, 1)
    found = Finding("named", "it is", (other, alone), errors=ERRORS, given=(KTC, gain))
    assert say("given", found)[2] == "Gain: given 0 %, found 22.5 % (13.3 to 31.7), if it is this one."


def test_what_remains_is_said_beside_the_gain() -> None:
    left = Remainder(3.0, 1e-9, 0.3, 0.12, ("a move",))
    found = Finding("unknown", "it is", (DELAY,), errors=ERRORS, remainder=left)
    assert say("verdict", found)[0].endswith("Of the error that repeats, 12 % remain unexplained.")
    little = replace(found, remainder=replace(left, share=0.00037))
    assert say("verdict", little)[0].endswith("more than noise, but only 0.037 % of the error that repeats.")
    nothing = replace(found, causes=(), reason="no cause of the catalogue explains it")
    assert say("verdict", nothing)[0].startswith("The simulation is wrong, and no known cause explains it (error 31 %)")
    healthy = Finding("consistent", "it is", errors=(ModelError("measurements", 3, "fitted", 0.021, 0.021),))
    assert say("verdict", healthy) == [
        "The measurements bear the simulation out: what it leaves is no more than noise (error 2.1 %)."
    ]


def test_what_the_data_do_not_separate_is_a_question_and_the_experiment_answers_it() -> None:
    n = Proposal("as a, but b", 9.0, 0.97, "", 5.0, "friction and a dead time", 12.0, do="Hit the tool along x at rest")
    found = Finding("ambiguous", "it is", (DELAY,), alternatives=((DELAY, FRICTION),), next_experiment=n)
    assert "do not tell which: a dead time or stribeck friction" in say("verdict", found)[0]
    assert say("next", found) == [
        "Next: Hit the tool along x at rest (about 5 min). With it the predictions of friction and a dead time differ "
        "by 3.0 standard deviations of the noise; it settles the question with a probability of 97 %."
    ]
    shows = replace(n, reveals=(Revealed("play in a joint", "gap", 1.2, np.inf, "um"),), between="")
    assert say("next", replace(found, next_experiment=shows))[0].endswith(
        "It would show what the measurements so far hide: play in a joint from 1.2 µm on."
    )


def test_depths_are_those_of_the_speeds_of_the_shop_and_of_its_cutting_tests() -> None:
    rows = tuple(StableDepth("lobes_1", n, n, b, a) for n, b, a in ((400.0, 3.0, 2.9), (800.0, 9.0, 1.5)))
    tests = (
        ForetoldCut("a.csv", 860.0, 6.0, "chatter", 17.6, 4.8),
        ForetoldCut("b.csv", 700.0, 2.0, "stable", 9.0, 3.0),
    )
    of_tests = tuple(StableDepth(t.file, t.spindle_speed_rpm, 1.0, t.before_mm, t.after_mm) for t in tests)
    found = Finding("named", "it is", (DELAY,), stable_depth=(*rows, *of_tests), tested_depth=tests)
    assert say("depth", found) == [
        "Of two cutting tests the simulation foretells one rightly, the extended model two. At 860 rpm a cut of 6 mm "
        "chattered: the simulation allows 17.6 mm, the extended model 4.80 mm.",
        "From 400 to 800 rpm the smallest stable depth is 1.50 mm (at 800 rpm) with the extended model, 3.00 mm (at "
        "400 rpm) with the simulation. The largest change is at 800 rpm: 1.50 mm where the simulation gives 9.00 mm.",
    ]


def test_a_depth_says_where_on_the_stroke_it_stands_and_the_worst_comes_first() -> None:
    here, there = "at 0 mm of the stroke", "at 800 mm of the stroke"
    rows = [StableDepth("lobes_1", n, n, 3.0, a, here) for n, a in ((400.0, 3.1), (800.0, 3.2))]
    rows += [StableDepth("lobes_1", n, n, 3.0, a, there) for n, a in ((400.0, 1.9), (800.0, 1.7))]
    said = say("depth", Finding("named", "it is", (DELAY,), stable_depth=tuple(rows)))
    assert said[0].startswith(
        "At 800 mm of the stroke, from 400 to 800 rpm the smallest stable depth is 1.70 mm (at 800 rpm)"
    )
    assert said[1] == (
        "The smallest stable depth with the extended model is 3.10 mm at 0 mm of the stroke and 1.70 mm at 800 mm of "
        "the stroke; the simulation gives 3.00 mm throughout."
    )


def test_power_names_the_size_that_would_have_been_seen_of_causes_that_were_not_found() -> None:
    power = (
        Detectable("loop_delay", "a dead time", "extra_delay", 0.05, 0.1, "ms", True),
        Detectable("backlash", "play in a joint", "gap", 1.5, 3.0, "um", True),
        Detectable("drift", "stiffness that drifts", "stiffness_over_session", np.inf, np.inf, "%", False),
    )
    assert say("power", Finding("named", "it is", (DELAY,), errors=ERRORS, detectable=power)) == [
        "Would have been seen with a probability of 95 %: play in a joint from 1.5 µm on.",
        "Would not have been seen in these conditions: stiffness that drifts.",
    ]


# --- Is what was given right?

KTC = GivenParameter("Ktc", "", "force_coefficients", 2000.0, 200.0, 2700.0, 2650.0, 2750.0, "N/mm^2", True, 0.26, -1.2)
KRC = GivenParameter("Krc", "", "force_coefficients", 600.0, 60.0, 612.0, 580.0, 644.0, "N/mm^2", False, 0.01, 0.02)
MASS = GivenParameter("mass", "", "declared_mass", 95.0, 9.5, 95.1, 76.9, 113.3, "kg", False)


def test_what_was_given_comes_first_with_what_the_data_say_and_its_millimetres() -> None:
    size = FoundCause("force_coefficients", "", "coefficients", "physics", (), 9.0, 3.0, 1.0)
    found = Finding("named", "it is", (size,), errors=ERRORS, given=(KRC, KTC, MASS))
    assert [p.about for p in told(found)][:2] == ["given", "given"]
    assert say("given", found) == [
        "Is what you gave right? Not cutting coefficient Ktc.",
        "Cutting coefficient Ktc: given 2000 N/mm², found 2700 N/mm² (2650 to 2750); with it the stable depth is "
        "1.2 mm less (26 %).",
        "As declared: cutting coefficient Krc 600 (found 612 N/mm², 580 to 644).",
    ]
    # What the data do not narrow down is neither right nor wrong.
    assert "mass" not in " ".join(say("given", found))
    assert say("given", replace(found, given=(KRC,)))[0].endswith("As far as these measurements tell, yes.")
    assert "yes" not in say("given", replace(found, verdict="unknown", given=(KRC,)))[0]
    far = replace(KTC, beyond=False, found=8000.0, low=7900.0, high=8100.0)
    assert say("given", replace(found, verdict="unknown", given=(KRC, far))) == [
        "Is what you gave right? That is not known: the fit moves cutting coefficient Ktc from 2000 to 8000 N/mm² "
        "(7900 to 8100), but what is not understood may be the reason.",
        "As declared: cutting coefficient Krc 600 (found 612 N/mm², 580 to 644).",
    ]
    # Within its tolerance nothing is wrong, and yet the measurements may know better what matters.
    near = replace(MASS, found=104.0, low=103.0, high=105.0, cost=0.07)
    consistent = replace(found, verdict="consistent", causes=(), given=(KRC, near), material=0.05)
    assert say("given", consistent) == [
        "Is what you gave right? As far as these measurements tell, yes.",
        "Within tolerance, but worth 5.0 % or more, so take what was found: moving mass 104.0 kg (103.0 to 105.0) in "
        "place of 95.0 (worth 7.0 %).",
        "As declared: cutting coefficient Krc 600 (found 612 N/mm², 580 to 644).",
    ]
    for alike in (replace(near, low=94.0), replace(near, cost=0.04), replace(near, cost=None)):
        assert not any("take" in line for line in say("given", replace(consistent, given=(KRC, alike))))
    assert say("given", replace(found, given=(MASS,))) == [
        "Is what you gave right? These measurements say nothing of it."
    ]


def test_of_values_that_the_data_do_not_separate_one_is_wrong_not_all() -> None:
    gain = GivenParameter("gain_force", "gain of the force", "sensor_gain", 1.0, 0.02, 1.35, 1.3, 1.4, "", True)
    alike = [FoundCause(i, "declared", i, "declared", (), 9.0, None, None, set=0) for i in (KTC.cause, gain.cause)]
    found = Finding("named", "it is", tuple(alike), errors=ERRORS, given=(KTC, gain, replace(MASS, beyond=True)))
    first, ktc, of_gain, mass = say("given", found)
    assert first.endswith("? Not moving mass; either cutting coefficient Ktc or gain of the force is wrong.")
    assert say("given", replace(found, given=(KTC, gain)))[0].endswith(
        "? Either cutting coefficient Ktc or gain of the force is wrong."
    )
    assert ktc.endswith("less (26 %), if it is this one.")
    assert of_gain.endswith("(1.300 to 1.400), if it is this one.")
    assert not mass.endswith("this one.")


def test_what_was_given_wrongly_is_told_once_with_its_numbers() -> None:
    value = (Estimate("Ktc", 2700.0, 2650.0, 2750.0, "N/mm^2"),)
    size = FoundCause("force_coefficients", "declared", "coefficient Ktc", "declared", value, 9.0, None, None)
    found = Finding("named", "it is", (size,), errors=ERRORS, given=(KTC, KRC))
    assert say("verdict", found)[0].startswith("The simulation is wrong about the cutting coefficients. With it the")
    assert say("cause", found) == []
    assert " ".join(p.text for p in told(found)).count("2700") == 1


def test_causes_that_the_data_do_not_separate_are_told_as_one_or_the_other() -> None:
    numbers = (Estimate("gain_force", -13.0, -13.4, -12.6, "%"),)
    gain = FoundCause("sensor_gain", "force", "gain of the force sensor", "measurement", numbers, 9.0, None, None, 0)
    scale = replace(gain, id="modal_scale", title="scale of all modes", kind="physics", parameters=(), variant="")
    said = say("verdict", Finding("named", "it is", (gain, scale, DELAY), errors=ERRORS))[0]
    assert said.startswith(
        "The simulation leaves out a dead time in the control loop. Either the gain of a sensor is off (gain of the "
        "force sensor 13 % lower) or the simulation is wrong about the scale of all modes."
    ), said
    assert "do not tell which of them it is" in " ".join(say("cause", Finding("named", "", (gain, scale))))
    (open_,) = say("next", Finding("named", "", (gain, scale)))
    assert open_.startswith(
        "No experiment proposed here tells gain of the force sensor from scale of all modes: calibrate"
    )
    n = Proposal("a reference", 12.0, 0.8, "", 5.0, "gain and scale", 3.0, do="Hang up a free mass of 20 kg")
    settled = Finding("named", "", (gain, scale), next_experiment=n)
    assert say("cause", settled)[-1].endswith("The experiment proposed below separates them.")
    (said,) = say("next", settled)
    assert said.startswith("Next: Hang up a free mass of 20 kg (about 5 min).")


def test_what_is_too_small_to_matter_is_said_and_does_not_convict() -> None:
    small = replace(DELAY, size=0.011)
    found = Finding("consistent", "it is", immaterial=(small,), material=0.05, errors=ERRORS[:1])
    assert "what it leaves is noise, and what is too small to matter (error 31 %)" in say("verdict", found)[0]
    assert say("immaterial", found) == [
        "Seen, but too small to matter (less than 5.0 %): a dead time in the control loop (0.82 ms), which changes "
        "1.1 %."
    ]
    large = replace(found, immaterial=(small, replace(DELAY, size=0.17)))
    assert say("immaterial", large)[1:] == [
        "Seen, but what it does to the measurements other values do as well: a dead time in the control loop "
        "(0.82 ms), which changes 17 %."
    ]


def test_a_named_cause_with_a_remainder_says_how_much_is_left() -> None:
    left = Remainder(3.0, 1e-9, 0.06, 0.011, ())
    said = say("verdict", Finding("named", "it is", (DELAY,), errors=ERRORS, remainder=left))[0]
    assert said.endswith("Of the error that repeats, 1.1 % remain unexplained.")


def test_the_best_speed_is_told_before_and_after() -> None:
    pocket = Pocket("lobes_1", 980.0, 5.1, 2.2, 760.0, 3.4)
    assert say("depth", Finding("named", "it is", (DELAY,), pockets=(pocket,))) == [
        "The best speed by the simulation is 980 rpm with 5.10 mm; there the extended model allows 2.20 mm. Its own "
        "best is 760 rpm with 3.40 mm."
    ]


def test_a_fault_of_the_data_is_told_in_words_before_anything_is_blamed() -> None:
    left_out = fault("unit_error", "hammer_500, xx", "its stiffness is 3 N/m", "correct the unit", ("measurement", "h"))
    short = warning("no_orders", "cut 1", "28 revolutions", "left out of the comparison")
    setting = Setting(faults=(left_out, fault("sensor_axis", "idle", "two are exchanged", "exchange them"), short))
    passages = told(Finding("named", "it is", (DELAY,), errors=ERRORS), setting)
    assert [p.text for p in passages if p.about == "fault"] == [
        "A fault in the data, so that it was left out: hammer 500, xx: its stiffness is 3 N/m. Correct the unit.",
        "A fault in the data, so that it is compared as it is: idle: two are exchanged. Exchange them.",
        "Of the data: cut 1: 28 revolutions. Left out of the comparison.",
    ]
    assert passages[0].about == "fault"


def test_a_dynamometer_that_vibrates_has_a_frequency_in_hertz():
    """It is fitted by the inverse of its square: 1/(152.5 Hz)^2 is 43 1/kHz^2."""
    found = Estimate("dynamometer_x", 43.0, 37.8, 48.1, "1/kHz^2")
    assert _one(found, intervals=True) == "resonance of the dynamometer along x at 152.5 Hz (144.2 to 162.7)"
    assert _one(found, intervals=False) == "resonance of the dynamometer along x at 150 Hz"
    assert _one(replace(found, low=-1.0), intervals=True).endswith("at 144 Hz or above")
    assert _one(replace(found, low=-1.0, high=np.inf), intervals=True).endswith("at 150 Hz")
