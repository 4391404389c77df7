"""Excitations: what the closed forms say of their spectra, their periods, their correlation and their ends."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from process.errors import InputError
from process.simulation.excitation import (
    Chirp,
    Excitation,
    HalfSine,
    HammerHits,
    LogarithmicChirp,
    Multisine,
    PseudoRandom,
    SteppedSine,
    Sum,
    all_harmonics,
    odd_harmonics,
    odd_random_harmonics,
)

HIT = HalfSine(0.1, 4e-3, 0.05)
LINES = Multisine(2.0, all_harmonics(3, 60), 20.0, periods=3, seed=4, start=0.1)
ALL: list[Excitation] = [
    HIT,
    SteppedSine((20.0, 33.0), 10.0, 0.2, 0.05),
    HammerHits(0.1, (0.05, 0.3, 0.31)),
    Sum((HIT, SteppedSine((20.0,), 10.0, 0.2, 0.3))),
    Chirp(5.0, 50.0, 10.0, 0.5, 0.1),
    LogarithmicChirp(50.0, 5.0, 10.0, 0.5, 0.1),
    LINES,
    PseudoRandom(15.0, 500.0, 6, 2, 0.05),
]


@pytest.mark.parametrize("excitation", ALL, ids=lambda e: type(e).__name__)
def test_there_is_no_force_before_the_start_and_after_the_end(excitation: Excitation) -> None:
    t = np.arange(0.0, excitation.end + 0.5, 1e-4)
    force = excitation.force(t)
    assert np.abs(force).max() > 0.0
    assert not force[t > excitation.end + 1e-9].any()
    assert not force[t < 0.02 - 1e-9].any()
    # The end is no later than one shortest event after the last force.
    assert excitation.end - t[np.flatnonzero(force)[-1]] <= excitation.shortest + 2e-4


@pytest.mark.parametrize("excitation", ALL, ids=lambda e: type(e).__name__)
def test_the_force_at_a_time_does_not_depend_on_the_other_times(excitation: Excitation) -> None:
    t = np.sort(np.random.default_rng(3).uniform(0.0, excitation.end, 30))
    alone = np.array([excitation.force(np.array([x]))[0] for x in t])
    np.testing.assert_allclose(excitation.force(t), alone, atol=1e-9)


def test_a_train_of_hits_has_the_impulse_of_all() -> None:
    train = HammerHits(0.1, (0.05, 0.3, 0.31))
    t = np.arange(0.0, 0.5, 1e-6)
    assert np.sum(train.force(t)) * 1e-6 == pytest.approx(0.3, rel=1e-6)
    one = sum(HalfSine(0.1, 4e-3, s).force(t) for s in train.times)
    np.testing.assert_array_equal(train.force(t), one)


def test_a_sum_is_the_superposition() -> None:
    t = np.arange(0.0, 1.0, 1e-3)
    tones = [SteppedSine((f,), a, 1.0) for f, a in ((11.0, 3.0), (17.0, 5.0))]
    total = Sum(tuple(tones))
    np.testing.assert_allclose(total.force(t), tones[0].force(t) + tones[1].force(t))
    assert total.shortest == 0.5 / 17.0
    nested = Sum((total, HIT))
    np.testing.assert_allclose(nested.force(t) - total.force(t), HIT.force(t), atol=1e-12)


@pytest.mark.parametrize("chirp", [Chirp(5.0, 80.0, 10.0, 2.0), LogarithmicChirp(5.0, 80.0, 10.0, 2.0)])
def test_the_phase_of_a_chirp_is_the_integral_of_its_frequency(chirp: Chirp) -> None:
    t = np.linspace(chirp.start, chirp.end, 400001)
    f = chirp.frequency(t)
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * np.diff(t))])
    np.testing.assert_allclose(chirp.force(t)[1:-1], 10.0 * np.sin(2.0 * np.pi * turns)[1:-1], atol=1e-4)
    assert (f[0], f[-1]) == (pytest.approx(5.0), pytest.approx(80.0))


def test_a_logarithmic_chirp_takes_the_same_time_for_each_octave() -> None:
    chirp = LogarithmicChirp(5.0, 80.0, 10.0, 2.0, start=0.0)
    np.testing.assert_allclose(chirp.frequency(np.array([0.0, 0.5, 1.0, 1.5, 2.0])), [5.0, 10.0, 20.0, 40.0, 80.0])
    # And is the linear one where the frequency hardly changes.
    t = np.linspace(0.0, 2.0, 1001)
    near = [sweep(40.0, 40.0 * (1 + 1e-7), 10.0, 2.0, start=0.0).force(t) for sweep in (Chirp, LogarithmicChirp)]
    np.testing.assert_allclose(*near, atol=1e-6)
    np.testing.assert_allclose(
        LogarithmicChirp(40.0, 40.0, 10.0, 2.0).force(t), Chirp(40.0, 40.0, 10.0, 2.0).force(t), atol=1e-9
    )


def test_the_taper_lowers_what_leaks_out_of_the_band() -> None:
    t = np.arange(0.0, 4.0, 1e-3)
    leaks = []
    for taper in (0.0, 0.5):
        spectrum = np.abs(np.fft.rfft(Chirp(40.0, 80.0, 10.0, 3.0, taper, 0.5).force(t)))
        f = np.fft.rfftfreq(t.size, 1e-3)
        leaks.append(np.sqrt(np.sum(spectrum[f > 150.0] ** 2) / np.sum(spectrum**2)))
    assert leaks[1] < 1e-2 * leaks[0]


def test_a_multisine_has_equal_lines_on_its_grid_and_nothing_else() -> None:
    t = LINES.start + np.arange(1000) * (0.5 / 1000)
    force = LINES.force(t)
    lines = np.abs(np.fft.rfft(force)) * 2.0 / 1000
    amplitude = 20.0 * math.sqrt(2.0 / 58.0)
    np.testing.assert_allclose(lines[3:61], amplitude, rtol=1e-10)
    assert max(lines[:3].max(), lines[61:].max()) < 1e-10 * amplitude
    assert math.sqrt(np.mean(force**2)) == pytest.approx(20.0, rel=1e-12)
    assert np.abs(force).max() / 20.0 == pytest.approx(LINES.crest_factor, rel=0.02)
    assert LINES.crest_factor >= math.sqrt(2.0)


def test_a_multisine_is_periodic_to_rounding_and_its_seed_changes_phases_alone() -> None:
    t = LINES.start + np.random.default_rng(1).uniform(0.0, 0.49, 200)
    np.testing.assert_allclose(LINES.force(t + 2 * LINES.period), LINES.force(t), atol=1e-9)
    other = Multisine(2.0, LINES.harmonics, 20.0, periods=3, seed=5, start=0.1)
    grid = LINES.start + np.arange(500) * 1e-3
    a, b = (np.fft.rfft(m.force(grid)) for m in (LINES, other))
    np.testing.assert_allclose(np.abs(a), np.abs(b), atol=1e-8)
    assert np.abs(a - b).max() > 1.0


def test_a_multisine_of_one_line_is_a_cosine() -> None:
    m = Multisine(7.0, (1,), 3.0, start=0.0)
    t = np.linspace(0.0, m.end, 100, endpoint=False)
    np.testing.assert_allclose(m.force(t), 3.0 * math.sqrt(2.0) * np.cos(14.0 * np.pi * t + m.phases[0]), atol=1e-12)
    assert m.crest_factor == pytest.approx(math.sqrt(2.0), rel=0.02)


def test_an_odd_multisine_separates_even_from_odd_distortion() -> None:
    m = Multisine(1.0, odd_random_harmonics(1, 99, 4, seed=2), 1.0, start=0.0)
    k = np.array(m.harmonics)
    assert np.all(k % 2 == 1)
    odd = np.array(odd_harmonics(1, 99))
    # One in each whole group of four is missing.
    groups = [set(odd[i : i + 4]) - set(k) for i in range(0, 48, 4)]
    assert [len(g) for g in groups] == [1] * 12
    f = np.arange(1000) / 1000
    force = m.force(f)
    silent = m.detection_lines.astype(int)
    for power, parity in ((2, 0), (3, 1)):
        lines = np.abs(np.fft.rfft(force**power))[silent]
        assert lines[silent % 2 == parity].max() > 1.0
        assert lines[silent % 2 != parity].max() < 1e-9


@pytest.mark.parametrize("register", [2, 5, 9, 11])
def test_the_autocorrelation_of_a_binary_sequence_is_1_and_minus_1_over_n(register: int) -> None:
    prbs = PseudoRandom(15.0, 500.0, register, 3, 0.05)
    n = 2**register - 1
    ticks = prbs.force(prbs.start + (np.arange(n) + 0.5) / 500.0)
    correlation = np.array([ticks @ np.roll(ticks, lag) for lag in range(n)]) / (n * 15.0**2)
    np.testing.assert_allclose(correlation, np.where(np.arange(n) == 0, 1.0, -1.0 / n), atol=1e-12)
    assert prbs.period == pytest.approx(n / 500.0)


def test_the_lines_of_a_held_binary_sequence_follow_the_closed_form() -> None:
    prbs, n, fine = PseudoRandom(15.0, 500.0, 7, 2, 0.0), 127, 64
    t = np.arange(n * fine) / (500.0 * fine)
    force = prbs.force(t)
    k = np.arange(1, 3 * n)
    # Samples held for a 64th of a tick are the signal itself.
    power = 2.0 * np.abs(np.fft.rfft(force)[k] / force.size * np.sinc(k / (n * fine))) ** 2
    expected = 2.0 * 15.0**2 * (n + 1) / n**2 * np.sinc(k / n) ** 2
    np.testing.assert_allclose(power, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(prbs.force(t), prbs.force(t + prbs.period))


def test_a_tick_begins_at_its_time_however_that_is_rounded() -> None:
    prbs = PseudoRandom(1.0, 1000.0, 8, 1, 0.02)
    t = np.arange(275) / 1000.0
    np.testing.assert_array_equal(prbs.force(t)[20:], prbs.sequence()[:255])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: HalfSine(0.1, 0.0), "duration must be positive"),
        (lambda: SteppedSine((), 1.0), "all must be positive"),
        (lambda: SteppedSine((10.0,), math.nan), "force must be finite"),
        (lambda: HammerHits(0.1, ()), "at least one"),
        (lambda: HammerHits(0.1, (-1.0,)), "start not negative"),
        (lambda: Sum(()), "at least one"),
        (lambda: Chirp(0.0, 10.0, 1.0, 1.0), "first is 0 Hz"),
        (lambda: Chirp(1.0, 10.0, 1.0, 1.0, 0.6), "zero to half of it"),
        (lambda: Chirp(1.0, 10.0, 1.0, -1.0), "duration is -1 s"),
        (lambda: all_harmonics(0, 3), "1 <= lowest"),
        (lambda: HalfSine(1.0, math.inf), "inf s long"),
        (lambda: HalfSine(1.0, start=math.inf), "at inf s"),
        (lambda: SteppedSine((10.0, math.inf), 1.0), "all must be positive and finite"),
        (lambda: SteppedSine((10.0, math.nan), 1.0), "all must be positive and finite"),
        (lambda: odd_harmonics(2, 2), "no odd harmonic"),
        (lambda: odd_random_harmonics(1, 9, 9), "groups of 9 among 5"),
        (lambda: Multisine(0.0, (1,), 1.0), "fundamental is 0 Hz"),
        (lambda: Multisine(1.0, (3, 2), 1.0), "rising, each once"),
        (lambda: Multisine(1.0, (), 1.0), "rising, each once"),
        (lambda: Multisine(1.0, (1,), 1.0, periods=0), "0 periods"),
        (lambda: PseudoRandom(1.0, 100.0, 1), "1 bits"),
        (lambda: PseudoRandom(1.0, -5.0), "clock is -5 Hz"),
        (lambda: PseudoRandom(1.0, 5.0, start=-1.0), "start not negative"),
    ],
)
def test_what_is_no_excitation_is_refused(wrong: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        wrong()
