"""Claims about the chatter criterion, on synthetic signals whose lines are known, and on a simulated cut."""

import math

import numpy as np
import pytest

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_record
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from stability import chatter_verdict, zero_order

TEETH = 4
RPM = 1500.0  # spindle order 25 Hz, tooth passing 100 Hz


def line(t, frequency, amplitude, phase=0.3):
    return amplitude * np.cos(2 * np.pi * frequency * t + phase)


def cut_record(
    chatter=(),
    tooth=(10.0, 4.0, 2.0),
    runout=(0.5, 0.3),
    rpm=RPM,
    teeth=TEETH,
    duration=8.0,
    air=0.5,
    noise=0.02,
    seed=0,
    channel="acceleration",
    growth=None,
    rate=1024.0,
):
    """Air, a cut with tooth harmonics, run-out on orders 1, 2, ... and chatter lines (Hz, amplitude), air."""
    t = np.arange(0.0, duration + 2 * air, 1.0 / rate)
    n = rpm / 60.0
    x = sum((line(t, (h + 1) * teeth * n, a, h) for h, a in enumerate(tooth)), np.zeros_like(t))
    x += sum((line(t, (o + 1) * n, a, 2 * o) for o, a in enumerate(runout)), np.zeros_like(t))
    rise = 1.0 if growth is None else np.exp((t - air - duration) / growth)
    x += sum((rise * line(t, f, a) for f, a in chatter), np.zeros_like(t))
    x *= (t >= air) & (t < air + duration)
    noises = np.random.default_rng(seed).standard_normal((2, t.size)) * noise
    return make_record(t, {channel: {"x": x + noises[0], "y": 0.5 * x + noises[1]}})


def judge(record, rpm=RPM, teeth=TEETH, **choices):
    return chatter_verdict(record, rpm * math.pi / 30.0, teeth, **choices)


# --- the paper's rule ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("amplitude", "verdict"),
    [
        (4.5, "stable"),
        (5.5, "chatter"),
        *(pytest.param(*v, marks=pytest.mark.slow) for v in ((0.37, "stable"), (41.0, "chatter"))),
    ],
)
def test_half_of_the_highest_tooth_harmonic_decides(amplitude, verdict):
    found = judge(cut_record([(63.07, amplitude)]))
    assert found.verdict == verdict
    assert found.ratio == pytest.approx(amplitude / 10.0, rel=0.02)
    assert found.tooth_passing_harmonic_Hz == pytest.approx(100.0, abs=0.05)
    if verdict == "chatter":
        assert found.chatter_frequency_Hz == pytest.approx(63.07, abs=0.1)
        assert "63.0" in found.reason
    else:
        assert math.isnan(found.chatter_frequency_Hz)


def test_the_threshold_can_be_chosen():
    record = cut_record([(63.07, 3.0)])
    assert judge(record).verdict == "stable"
    assert judge(record, threshold=0.2).verdict == "chatter"


def test_the_highest_harmonic_counts_even_when_it_is_not_the_first():
    found = judge(cut_record([(63.07, 3.0)], tooth=(1.0, 10.0)))
    assert found.tooth_passing_harmonic_Hz == pytest.approx(200.0, abs=0.1)
    assert found.ratio == pytest.approx(0.3, rel=0.12)


def test_run_out_is_no_chatter():
    # Reference: with 40 um of run-out, orders 1 and 3 pass half of the tooth line
    found = judge(cut_record(runout=(9.0, 0.0, 7.0)))
    assert found.verdict == "stable"
    assert found.ratio < 0.05


def test_each_axis_is_judged_by_itself_and_a_turned_sensor_says_the_same():
    record = cut_record([(63.07, 9.0)])
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    both = turn @ record.acceleration.values
    turned = make_record(record.time.values, {"acceleration": dict(zip("xy", both, strict=True))})
    assert judge(turned).ratio == pytest.approx(judge(record).ratio, rel=0.02)
    assert judge(record, axes=["y"]).axes == ("y",)


def test_a_small_axis_that_chatters_does_not_drown_in_a_larger_one():
    high, low = cut_record(tooth=(40.0, 16.0)), cut_record([(63.07, 9.0)], seed=1)
    record = make_record(
        high.time.values, {"acceleration": {"x": high.acceleration.values[0], "y": low.acceleration.values[0]}}
    )
    found = judge(record)
    assert [(a.axis, a.verdict) for a in found.by_axis] == [("x", "stable"), ("y", "chatter")]
    assert found.verdict == "chatter"
    assert found.reason.startswith("y: the non-harmonic peak at 63.")
    assert "(x stable)" in found.reason


# --- the part of the record ------------------------------------------------------------------------------------------


def test_the_entry_is_left_out():
    """A transient of twice the tooth line with a time constant of 1 s leaves no trace."""
    record = cut_record(duration=8.0)
    t = record.time.values - 0.5
    record["acceleration"] += np.where(t > 0, 20 * np.exp(-np.maximum(t, 0)), 0) * np.cos(2 * np.pi * 61.4 * t)
    assert judge(record).verdict == "stable"
    # Where it is asked for, it is seen, and not taken for chatter: it dies away.
    assert judge(record, interval=(0.5, 3.5)).verdict == "undecided"


def test_air_before_and_after_is_found():
    low, high = judge(cut_record(duration=6.0, air=3.0)).interval_s
    assert 5.5 < low < 6.5
    assert 8.5 < high <= 9.05


def test_the_cut_is_where_the_mean_cutting_force_is():
    record = cut_record(tooth=(), runout=(), duration=6.0, air=2.0, noise=1e-3)
    t = record.time.values
    force = np.where((t > 2) & (t < 8), 200.0, 0.0) + np.random.default_rng(1).standard_normal(t.size)
    both = make_record(t, {"acceleration": {"x": record.acceleration.values[0]}, "force": {"x": force}})
    low, high = judge(both).interval_s
    assert 4.5 < low < 5.5
    assert 7.5 < high < 8.1


# --- the speed -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "chatter"),
    [
        (0.0049, ()),
        (-0.003, ((63.07, 20.0),)),
        *(
            pytest.param(error, chatter, marks=pytest.mark.slow)
            for error in (-0.0049, -0.003, 0.001, 0.003, 0.0049)
            for chatter in ((), ((63.07, 20.0),))
        ),
    ],
)
def test_the_speed_is_found_in_the_record(error, chatter):
    found = judge(cut_record(chatter, rpm=RPM * (1 + error)))
    assert found.spindle_speed_rpm == pytest.approx(RPM * (1 + error), rel=2e-4)
    assert found.verdict == ("chatter" if chatter else "stable")


def test_without_that_a_wrong_speed_is_no_chatter_but_an_open_question():
    # Reference: 0.3 % over 4 s would be a ratio of 0.5 and more
    found = judge(cut_record(rpm=RPM * 1.003), speed_tolerance=0.0)
    assert found.verdict == "undecided"
    assert "a speed that varies" in found.reason


def test_a_machine_that_does_not_cut_does_not_chatter():
    # a fan beside a machine that runs idle: one line, and no order of a spindle
    idle = cut_record([(537.1, 3.0)], tooth=(), runout=(), air=0.0, noise=0.3, rate=2048.0)
    found = judge(idle)
    assert found.verdict == "undecided"
    assert "no order of a spindle" in found.reason
    # the same line in a cut, its teeth as quiet as the noise lets them be seen
    assert (
        judge(cut_record([(537.1, 3.0)], tooth=(0.2,), runout=(), air=0.0, noise=0.3, rate=2048.0)).verdict == "chatter"
    )


def test_the_spindle_angle_is_believed_where_it_is_recorded():
    record = cut_record(rpm=RPM * 1.008)
    record["spindle_angle"] = ("time", RPM * 1.008 * math.pi / 30 * record.time.values, {"units": "rad"})
    found = judge(record)
    assert found.spindle_speed_rpm == pytest.approx(RPM * 1.008, rel=1e-9)
    assert found.verdict == "stable"
    with pytest.raises(InputError, match=r"turns at 1512 rpm, 1600 rpm were given"):
        judge(record, rpm=1600.0)


def with_speed(record, rpm, noise=0.0):
    values = rpm * (1.0 + noise * np.random.default_rng(5).standard_normal(record.time.size))
    return record.assign(spindle_speed=("time", values, {"units": "rpm"}))


def test_a_recorded_speed_that_contradicts_the_given_one_is_refused():
    with pytest.raises(InputError, match="the recorded spindle speed is 700 rpm, 720 rpm were given: correct one"):
        judge(with_speed(cut_record(rpm=700.0), 700.0), rpm=720.0)


def test_the_search_starts_from_the_recorded_speed():
    # 0.8 % off the given speed: outside of what is searched around that
    found = judge(with_speed(cut_record(rpm=RPM * 1.008), RPM * 1.007))
    assert found.spindle_speed_rpm == pytest.approx(RPM * 1.008, rel=2e-4)
    assert found.verdict == "stable"


@pytest.mark.parametrize("rpm", [pytest.param(RPM, marks=pytest.mark.slow), 12000.0])
def test_noise_on_a_recorded_speed_is_no_sweep(rpm):
    teeth = 2
    record = with_speed(cut_record(rpm=rpm, teeth=teeth, tooth=(10.0,), rate=2048.0), rpm, noise=0.004)
    assert np.ptp(record.spindle_speed.values) > 0.02 * rpm
    assert judge(record, rpm=rpm, teeth=teeth).verdict == "stable"


def test_a_sweep_is_refused():
    record = cut_record()
    record["spindle_speed"] = ("time", np.linspace(1400, 1600, record.time.size), {"units": "rpm"})
    with pytest.raises(InputError, match="needs a constant speed"):
        judge(record)


def drifting_cut(drift, chatter=(), teeth=TEETH, **more):
    """A cut whose spindle slows by `drift` from begin to end: the record of a steady one, its time stretched."""
    steady = cut_record(chatter, teeth=teeth, **more)
    t = steady.time.values
    span = t[-1]
    warped = t + drift * (t * t / (2.0 * span) - 0.5 * t)
    rows = {a: np.interp(warped, t, steady.acceleration.sel(axis=a).values) for a in "xy"}
    return make_record(t, {"acceleration": rows}), 1.0 + drift * (t / span - 0.5)


@pytest.mark.parametrize("drift", [pytest.param(0.002, marks=pytest.mark.slow), -0.01])
def test_a_spindle_that_slows_is_no_chatter(drift):
    # Order 12 moves by 1.5 bins at 0.2 %, by 7 at 1 %.
    record, _ = drifting_cut(drift, tooth=(4.0, 2.0, 9.0))
    assert judge(record).verdict == "stable"
    chattering, _ = drifting_cut(drift, ((63.07, 9.0),), tooth=(4.0, 2.0, 9.0))
    assert judge(chattering).verdict == "chatter"


def test_a_tacho_goes_before_a_stated_speed_and_before_the_lines():
    record = cut_record()
    pulses = (np.mod(record.time.values * RPM / 60.0 * 2.0, 1.0) < 0.3).astype(float)
    record["tacho"] = ("time", pulses, {"units": "1", "pulses_per_revolution": 2.0})
    found = judge_without_speed(record)
    assert found.spindle_speed_rpm == pytest.approx(RPM, rel=2e-4)
    with pytest.raises(InputError, match="correct one of them"):
        judge(record, rpm=1600.0)


def test_another_number_of_teeth_that_fits_is_said_and_judged_with():
    found = judge(cut_record(teeth=3, tooth=(30.0, 9.0, 4.0), runout=(1.0, 0.8)), teeth=4)
    assert found.verdict == "stable"
    assert found.reason.startswith("4 teeth are declared, but 3 fit")
    assert found.tooth_passing_harmonic_Hz == pytest.approx(75.0, rel=1e-3)
    assert not judge(cut_record(runout=(9.0, 8.0))).notes


# --- lines that drift, families, noise, air --------------------------------------------------------------------------


def test_chatter_lines_that_drift_are_read_in_short_windows():
    # Four lines one spindle order apart, each moving by 4 Hz: over the whole record each is smeared to less than half.
    record = cut_record(tooth=(10.0, 8.0), duration=10.0, rpm=4020.0, teeth=3, rate=2048.0)
    t = record.time.values
    sweep = 2 * np.pi * (-2.0 * t + 0.5 * 4.0 / 11.0 * t * t)
    lines = sum(6.0 * np.cos(2 * np.pi * f * t + sweep + f) for f in (364.0, 431.0, 498.0, 565.0))
    record["acceleration"][0] += np.where((t > 0.5) & (t < 10.5), lines, 0.0)
    found = judge(record, rpm=4020.0, teeth=3)
    assert found.verdict == "chatter"
    assert found.chatter_frequency_Hz % 67.0 == pytest.approx(29.0, abs=3.0)


def test_a_mode_that_noise_excites_is_left_open():
    from scipy import signal

    record = cut_record(tooth=(2.0,), runout=(0.5,), duration=10.0)
    t, w = record.time.values, 2 * math.pi * 63.3
    mode = signal.cont2discrete(([1.0], [1.0, 2 * 0.02 * w, w * w]), 1 / 1024.0)
    shaken = signal.lfilter(np.ravel(mode[0]), mode[1], np.random.default_rng(3).standard_normal(t.size))
    record["acceleration"] += 4.0 * shaken / shaken.std() * ((t > 0.5) & (t < 10.5))
    found = judge(record)
    assert found.verdict == "undecided"
    assert "mode that noise excites" in found.reason or "does not stand out" in found.reason


def test_what_is_there_in_air_is_no_chatter():
    harmonics = {"tooth": (10.0, 9.0, 9.0, 8.0), "air": 2.0}
    record = cut_record(**harmonics)
    record["acceleration"] += line(record.time.values, 63.07, 6.0)
    assert judge(record).verdict == "stable"
    assert judge(cut_record(((63.07, 6.0),), **harmonics)).verdict == "chatter"


@pytest.mark.parametrize(("swells", "depth"), [(0.2, 1.0), (0.3, 0.9)])
def test_no_part_of_a_cut_is_taken_for_air_because_it_chatters_less(swells, depth):
    # The teeth cut all along: the line that swells and fades is the chatter, and not its foot 1 to 2 Hz beside.
    record = cut_record(tooth=(2.0, 1.0, 0.5, 0.5), air=0.0)
    t = record.time.values
    envelope = np.sqrt(0.5 * (1.0 + depth * np.cos(2.0 * np.pi * swells * t)))
    record["acceleration"] += line(t, 63.07, 30.0) * envelope
    found = judge(record)
    assert found.verdict == "chatter"
    assert found.chatter_frequency_Hz == pytest.approx(63.07, abs=0.1)


def test_chatter_comes_with_the_speeds_to_try():
    found = judge(cut_record(((63.07, 20.0),)))
    assert found.try_rpm == pytest.approx([60 * 63.07 / 4], rel=0.01)
    assert judge(cut_record()).try_rpm == ()


# --- a speed that is not given ----------------------------------------------------------------------------------


def judge_without_speed(record, teeth=TEETH, **choices):
    return chatter_verdict(record, None, teeth, **choices)


@pytest.mark.parametrize(
    ("rpm", "runout", "chatter"),
    [
        (1500.0, (0.5, 0.3), False),
        (420.0, (), True),
        (3120.0, (0.5, 0.3), True),
        *(
            pytest.param(rpm, runout, chatter, marks=pytest.mark.slow)
            for rpm in (420.0, 1500.0, 3120.0)
            for runout in ((0.5, 0.3), ())
            for chatter in (False, True)
        ),
    ],
)
def test_the_spacing_of_the_lines_gives_the_speed_away(rpm, runout, chatter):
    # Chatter between two orders near 63 Hz, with the sideband that regeneration puts one tooth passing frequency above.
    n = rpm / 60.0
    line_at = (round(63.0 / n) + 0.4) * n
    lines = ((line_at, 30.0), (line_at + TEETH * n, 8.0)) if chatter else ()
    found = judge_without_speed(cut_record(lines, rpm=rpm, runout=runout, seed=int(rpm), rate=2048.0))
    assert found.spindle_speed_rpm == pytest.approx(rpm, rel=1e-3)
    assert found.verdict == ("chatter" if chatter else "stable")


def test_a_recorded_speed_goes_before_the_lines():
    found = judge_without_speed(with_speed(cut_record(), RPM * 1.001))
    assert found.spindle_speed_rpm == pytest.approx(RPM, rel=2e-4)


def test_lines_that_may_be_orders_or_tooth_harmonics_are_not_guessed_at():
    # Orders 1, 2, 3 as high as the tooth line: the spacing may be that of the spindle or that of the teeth.
    record = cut_record(tooth=(10.0, 5.0), runout=(9.0, 8.0, 9.5, 0.0, 4.0))
    with pytest.raises(InputError, match="the lines of the record do not give it away: give the speed"):
        judge_without_speed(record)
    with pytest.raises(InputError, match="give the speed"):
        judge_without_speed(cut_record(tooth=(), runout=()))


# --- sound -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("amplitude", "verdict"), [(0.03, "stable"), (0.08, "chatter")])
def test_the_sound_of_chatter_is_judged_alike(amplitude, verdict):
    record = cut_record([(63.07, 100.0 * amplitude)])
    sound = make_record(record.time.values, {}, {"sound": 1e-2 * record.acceleration.sel(axis="x").values})
    found = judge(sound)
    assert (found.quantity, found.axes) == ("sound", ("sound",))
    assert found.verdict == verdict
    assert found.ratio == pytest.approx(amplitude / 0.1, rel=0.02)


# --- what the rule does not foresee ----------------------------------------------------------------------------------


def test_a_cut_without_tooth_line_is_measured_against_the_floor():
    """The ideal slot: without the floor, a trace of free vibration is a ratio of 1000."""
    quiet = cut_record([(62.0, 0.02)], tooth=(), runout=(0.3,), noise=1e-5)
    found = judge(quiet)
    assert found.verdict == "stable"
    assert "of the highest spindle order at 25" in found.reason
    assert math.isnan(found.tooth_passing_harmonic_Hz)
    still = cut_record([(62.0, 0.12)], tooth=(), runout=(1e-3,), noise=1e-5)
    assert judge(still, floor=0.3).verdict == "undecided"
    assert judge(still, floor=1e-6).verdict == "chatter"


def scaled(record, factor):
    record["acceleration"] *= factor
    return record


@pytest.mark.parametrize(
    "record",
    [
        cut_record([(63.07, 20.0)], tooth=(), runout=(), noise=1e-6).pipe(scaled, 0.0),
        cut_record(tooth=(), runout=(), noise=1e-6),
        cut_record([(63.07, 20.0)]).pipe(scaled, 1e-3),
        cut_record(tooth=(), runout=(), noise=0.05),
    ],
    ids=["all zero", "dead", "unit off by 1000", "air only"],
)
def test_a_record_without_a_cut_is_not_called_stable(record):
    found = judge(record)
    assert found.verdict == "undecided"
    assert "nothing reaches the floor of 0.1 m/s^2" in found.reason
    assert "check sensor, unit and interval" in found.reason
    assert math.isnan(found.chatter_frequency_Hz)


def test_period_doubling_of_an_even_number_of_teeth_that_grows_is_chatter():
    found = judge(cut_record([(50.0, 30.0)], growth=2.0))
    assert found.verdict == "chatter"
    assert found.chatter_frequency_Hz == pytest.approx(50.0, abs=0.05)
    assert "period doubling" in found.reason


def test_steady_order_half_z_is_undecided_until_a_stable_cut_is_given():
    reference = judge(cut_record())
    record = cut_record([(50.0, 8.0)])
    found = judge(record)
    assert found.verdict == "undecided"
    assert "run-out or period doubling" in found.reason
    assert reference.half_order_ratio == pytest.approx(0.03, rel=0.05)
    again = judge(record, half_order_reference=reference.half_order_ratio)
    assert again.verdict == "chatter"
    assert judge(record, half_order_reference=found.half_order_ratio).verdict == "stable"


def test_period_doubling_of_an_odd_number_of_teeth_is_no_order_and_simply_seen():
    # 3 teeth: tooth passing 75 Hz, half of it 37.5 Hz, orders 25 and 50 Hz
    found = judge(cut_record([(37.5, 8.0)], teeth=3), teeth=3)
    assert found.verdict == "chatter"
    assert math.isnan(found.half_order_ratio)


def test_chatter_within_a_mask_is_seen_where_the_speed_has_been_followed():
    # Reference: 1200 rpm, 62 Hz against order 3 at 60 Hz
    short = judge(cut_record([(62.0, 20.0)], rpm=1200, duration=1.6), rpm=1200)
    assert short.verdict == "chatter"
    assert "order 3" in short.reason
    open_ = judge(cut_record([(62.0, 20.0)], rpm=1200, duration=1.6), rpm=1200, speed_tolerance=0.0)
    assert open_.verdict == "undecided"
    long = judge(cut_record([(62.0, 20.0)], rpm=1200, duration=6.0), rpm=1200)
    assert long.verdict == "chatter"
    assert long.chatter_frequency_Hz == pytest.approx(62.0, abs=0.1)


def test_a_short_stable_record_is_undecided_and_says_how_long_it_should_be():
    found = judge(cut_record(duration=0.7))
    assert found.verdict == "undecided"
    assert "hide more than 25 % of the spectrum" in found.reason
    few = judge(cut_record(duration=0.25))
    assert few.verdict == "undecided"
    assert "at least 6 turns" in few.reason


def test_clear_chatter_in_a_short_record_is_still_chatter():
    assert judge(cut_record([(62.5, 50.0)], duration=1.2)).verdict == "chatter"


def test_a_ratio_near_the_threshold_is_left_open_within_the_noise():
    found = judge(cut_record([(63.07, 5.0)], noise=2.0))
    assert found.verdict == "undecided"
    assert abs(found.ratio - 0.5) <= found.guard_band
    assert found.guard_band < 0.1
    assert "noise leaves open" in found.reason


def test_noise_alone_is_neither():
    found = judge(cut_record(tooth=(0.05,), runout=(), noise=3.0, air=0.0))
    assert found.verdict == "undecided"
    assert "does not stand out of the noise" in found.reason


def test_the_quantity_matters_and_is_stated():
    # Displacement over acceleration changes the ratio by (f_T/f_c)^2
    record = cut_record([(63.07, 3.0)])
    acceleration = judge(record)
    displacement = judge(record, quantity="displacement")
    assert (acceleration.quantity, displacement.quantity) == ("acceleration", "displacement from acceleration")
    assert displacement.ratio / acceleration.ratio == pytest.approx((100 / 63.07) ** 2, rel=0.02)
    assert (acceleration.verdict, displacement.verdict) == ("stable", "chatter")


def test_a_line_below_the_frequency_range_does_not_count():
    record = cut_record([(17.0, 20.0)])
    assert judge(record).verdict == "chatter"
    assert judge(record, frequency_range=(20.0, None)).verdict == "stable"


def test_the_spectrum_is_there_to_be_drawn():
    found = judge(cut_record([(63.07, 6.0)]))
    spectrum = found.spectrum
    assert spectrum.amplitude.dims == ("axis", "frequency")
    assert spectrum.amplitude.attrs["units"] == "m/s^2"
    assert spectrum.frequency.attrs["units"] == "Hz"
    nearest = spectrum.sel(frequency=[25.0, 63.07, 100.0], method="nearest")
    np.testing.assert_array_equal(nearest.harmonic, [True, False, True])
    np.testing.assert_allclose(nearest.amplitude.sel(axis="x"), [0.5, 6.0, 10.0], rtol=0.05)
    assert found.resolution_Hz == pytest.approx(0.25, rel=0.03)  # whole turns of the second half of the cut


# --- a cut, not a signal ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "verdict"),
    [
        (0.8, "undecided"),
        (1.03, "chatter"),
        *(pytest.param(*v, marks=pytest.mark.slow) for v in ((0.5, "undecided"), (1.1, "chatter"))),
    ],
)
@pytest.mark.parametrize("runout", [pytest.param(0.0, marks=pytest.mark.slow), 20e-6])
def test_verdict_of_a_simulated_cut_changes_at_the_limit(lab_slot, share, verdict, runout):
    # 1500 rpm: limit 0.1604 mm, chatter at 63.07 Hz. Below it the ideal slot has no tooth line and the
    # table nearly rests: 0.06 m/s^2 of run-out is less than the floor, so that no more can be said than that.
    tool = Tool(50.8e-3, 4, runout=tuple(runout * np.cos(np.arange(4) * np.pi / 2 + 0.3)))
    cut = MillingCut(
        tool, lab_slot.arc, CuttingCoefficients(780e6, 351e6, 0.0), share * 0.1604e-3, feed_per_tooth=0.2e-3
    )
    record = simulate_milling(lab_slot.machine, cut, Spindle(RPM * math.pi / 30), 16.0, 2048.0, lead=0.5, tail=0.5)
    found = judge(record, axes=["x"])
    assert found.verdict == verdict
    if verdict == "chatter":
        assert found.chatter_frequency_Hz == pytest.approx(63.07, abs=0.3)
    else:
        assert "nothing reaches the floor" in found.reason


@pytest.mark.parametrize(
    ("share", "verdict"),
    [pytest.param(0.5, "stable", marks=pytest.mark.slow), (0.8, "stable"), (1.2, "chatter")],
)
def test_verdict_of_a_simulated_cut_with_a_tooth_line(lab_slot, share, verdict):
    # Three teeth in a slot: the force changes at the tooth passing frequency and the table follows.
    tool = Tool(50.8e-3, 3)
    limit = float(
        zero_order(lab_slot.compliance(20, 200, 0.1), tool, lab_slot.arc, lab_slot.coefficients, [RPM]).limit_depth[0]
    )
    cut = MillingCut(tool, lab_slot.arc, lab_slot.coefficients, share * limit * 1e-3, feed_per_tooth=0.2e-3)
    record = simulate_milling(lab_slot.machine, cut, Spindle(RPM * math.pi / 30), 16.0, 2048.0, lead=0.5, tail=0.5)
    assert judge(record, teeth=3, axes=["x"]).verdict == verdict


# --- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"rpm": 0.0}, "a positive speed"),
        ({"rpm": math.nan}, "a positive speed"),
        ({"teeth": 0}, "0 teeth"),
        ({"threshold": 0.0}, "threshold is 0"),
        ({"speed_tolerance": 0.5}, "speed tolerance"),
        ({"quantity": "velocity"}, "none of acceleration"),
        ({"quantity": "force"}, "has no force"),
        ({"axes": ["z"]}, "axis"),
        ({"axes": []}, "axis none"),
        ({"frequency_range": (200.0, 100.0)}, "it must rise"),
        ({"frequency_range": (5.0, 90.0)}, "tooth passing frequency of 100"),
        ({"interval": (20.0, 30.0)}, "holds 0 samples"),
    ],
)
def test_what_makes_no_sense_is_refused(choices, message):
    with pytest.raises(InputError, match=message):
        judge(cut_record(duration=2.0), **choices)


def test_unusable_records_are_refused():
    with pytest.raises(InputError, match="1 samples"):
        judge(cut_record().isel(time=slice(0, 1)))
    broken = cut_record(duration=2.0)
    broken["acceleration"][0, 100] = np.nan
    with pytest.raises(InputError, match="not finite"):
        judge(broken)
    encoder = make_record(np.arange(100) / 1e3, {"encoder_position": {"x": np.zeros(100)}})
    with pytest.raises(InputError, match="nothing to judge"):
        judge(encoder)


# --- a part of a cut, families, alternating teeth ---------------------------------------------------------------------


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.4), (0.35, 0.6)], ids=["first part", "middle"])
def test_chatter_that_comes_and_goes_within_a_cut_is_found(begin, end):
    record = cut_record(duration=8.0)
    t = record.time.values
    inside = (t > 0.5 + 8.0 * begin) & (t < 0.5 + 8.0 * end)
    record["acceleration"] += inside * line(t, 63.07, 20.0)
    found = judge(record)
    assert found.verdict == "chatter"
    assert found.chatter_frequency_Hz == pytest.approx(63.07, abs=0.3)
    assert 0.4 + 8.0 * begin < found.interval_s[0] < found.interval_s[1] < 0.6 + 8.0 * end + 2.0
    assert "alone" in found.reason


@pytest.mark.parametrize(
    "interval", [(4.0, 4.5), *(pytest.param(v, marks=pytest.mark.slow) for v in ((2.0, 2.5), (6.3, 6.8)))]
)
@pytest.mark.parametrize("channel", ["acceleration", "sound"])
def test_half_a_second_out_of_a_cut_that_chatters_is_not_called_stable(interval, channel):
    # 12 turns of a line that goes on before and after the interval: it is not there in air
    record = cut_record([(63.07, 20.0)])
    if channel == "sound":
        record = make_record(record.time.values, {}, {"sound": record["acceleration"].values[0] * 1e-3})
    assert judge(record, interval=interval).verdict in ("chatter", "undecided")
    inside = (record.time.values >= interval[0]) & (record.time.values < interval[1])
    assert judge(record.isel(time=inside)).verdict in ("chatter", "undecided")


def test_a_steady_family_below_the_threshold_is_chatter_and_a_single_line_is_not():
    family = [(63.07 + 25.0 * k, 2.2 - 0.2 * k) for k in range(4)]
    assert judge(cut_record(family, noise=0.05)).verdict == "chatter"
    assert judge(cut_record(family[:1], noise=0.05)).verdict == "stable"


def test_a_line_half_way_between_two_orders_is_its_own_mirror_image():
    # f_c + k n and k n - f_c are the same lines: each counts once
    found = judge(cut_record([(62.5, 20.0), (87.5, 6.0), (112.5, 5.0)]))
    assert len(set(found.family_Hz)) == len(found.family_Hz)
    assert found.family_Hz == pytest.approx([87.5, 112.5], abs=0.1)


def test_alternating_teeth_are_period_doubling_and_an_eccentric_tool_is_not():
    # all odd multiples of order Z/2 = 2 and hardly another order, against run-out on all orders
    doubling = judge(cut_record([(50.0, 8.0), (150.0, 3.0), (250.0, 1.5)], runout=(0.2, 0.0, 0.1)))
    assert doubling.verdict == "chatter"
    assert "every other tooth cuts alike" in doubling.reason
    assert judge(cut_record(tooth=(10.0, 4.0), runout=(8.0, 6.0, 7.0, 0.0, 5.0))).verdict == "stable"


def test_chatter_on_an_order_is_no_other_number_of_teeth():
    # 5 teeth, one line on order 6 and nothing at its multiples: no tool of 2, 3 or 6 teeth
    found = judge(cut_record([(150.0, 200.0)], teeth=5), teeth=5)
    assert "teeth are declared" not in found.reason
    assert found.verdict != "stable"


def test_a_high_entry_does_not_hide_the_cut():
    record = cut_record(duration=6.0)
    t = record.time.values
    record["acceleration"] += 300.0 * np.exp(-np.abs(t - 0.6) / 0.04) * np.cos(2.0 * np.pi * 310.0 * t)
    found = judge(record)
    assert found.cut_s[3] - found.cut_s[0] > 5.0
    assert found.verdict == "stable"


def test_a_speed_stated_wrong_by_more_than_the_tolerance_is_not_called_chatter_in_silence():
    found = judge(cut_record(runout=(3.0, 2.0, 2.0), tooth=(10.0, 8.0, 7.0, 5.0, 4.0)), rpm=1.04 * RPM)
    assert found.verdict != "stable"
    assert found.verdict == "undecided" or "check the speed" in found.reason


def test_a_tooth_comb_at_another_speed_is_said_where_the_stated_one_has_no_line():
    # stated 10 % fast, run-out as high as half the teeth: the spacing leaves open whether spindle or teeth
    found = judge(cut_record(tooth=(10.0, 9.0, 8.0, 6.0, 5.0), runout=(7.0, 7.0, 7.0)), rpm=1.1 * RPM)
    assert "check the speed" in found.reason
    assert "at 1500 rpm" in found.reason


def test_the_picture_of_a_long_record_is_small():
    found = judge(cut_record([(63.07, 20.0)], duration=30.0))
    picture = found.spectrogram["amplitude"]
    assert picture.dims == ("axis", "time", "frequency")
    assert picture.shape[1] <= 161
    assert picture.shape[2] <= 300
    assert picture.nbytes < 1e6
    # the line is there while it cuts, not in air
    near = picture.sel(axis="x").sel(frequency=63.07, method="nearest")
    assert float(near.sel(time=10.0, method="nearest")) == pytest.approx(20.0, rel=0.2)
    assert float(near.isel(time=0)) < 1.0
