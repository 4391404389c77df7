"""Claims of the synthetic experiment on estimators of sweep milling, with the figures it was first done with."""

import numpy as np
import pytest
from accuracy.synthetic import (
    TRIOS,
    WINDOWS,
    condition,
    error,
    experiment,
    harmonic,
    noisy,
    orders,
    own_lines,
    ram,
    whole_pass,
)
from accuracy.theory_table import FIRST, RATES, TAIL, labelled, package

from process.errors import InputError
from smfe import LocalPolynomial, SweepPass, identify_sweep


@pytest.mark.parametrize("trio", "ABCE")
def test_condition_numbers_are_those_of_the_closed_form(trio: str) -> None:
    assert condition(trio) == pytest.approx(FIRST[trio][0], rel=0.01)


def test_two_halves_and_the_slot_are_dependent_at_every_harmonic() -> None:
    for h in (1, 2, 3):
        down, up, slot = (harmonic(c, w, h) for c, w in zip(("down", "up", "central"), TRIOS["D"], strict=True))
        assert np.linalg.norm(down + up - slot) < 1e-9 * np.linalg.norm(slot)


@pytest.mark.slow
def test_the_bias_of_order_tracking_falls_only_with_the_sweep_rate() -> None:
    found = {s: [error(orders(experiment(s, TAIL), w)) for w in WINDOWS[1:]] for s in (10.0, 20.0, 40.0)}
    best = {s: min(e) for s, e in found.items()}
    for seconds, value in best.items():
        assert value == pytest.approx(RATES[seconds][3] / 100.0, rel=0.1)
    # No window takes it away, and half of the rate leaves more than half of it.
    assert min(found[20.0]) > 0.6 * max(found[20.0])
    assert all(best[2.0 * s] > 0.5 * best[s] for s in (10.0, 20.0))


@pytest.mark.parametrize("seconds", [5.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_whole_record_is_exact_at_any_rate_with_the_free_decay_and_not_without(seconds: float) -> None:
    whole, bare = experiment(seconds, TAIL), experiment(seconds, 0.0)
    exact, cut = ((error(whole_pass(p, 1e-6, at=own_lines(p)), at=own_lines(p))) for p in (whole, bare))
    # The force is linear between samples: 1e-4 at 46 Hz.
    assert exact < 2e-4
    assert cut > 0.04


@pytest.mark.slow
def test_the_local_polynomial_stays_below_a_per_cent_where_plain_lines_do_not() -> None:
    for seconds in (10.0, 20.0, 40.0):
        whole = experiment(seconds, TAIL)
        bent, plain = error(whole_pass(whole, 0.5, 2)), error(whole_pass(whole, 0.25))
        assert bent < 0.01 < plain
        assert bent == pytest.approx(RATES[seconds][4] / 100.0, rel=0.2)
        assert plain == pytest.approx(RATES[seconds][2] / 100.0, rel=0.3)


def test_without_free_decay_a_slow_sweep_is_saved_by_polynomials_for_the_transient_and_a_fast_one_is_not() -> None:
    slow, fast = (error(whole_pass(experiment(s, 0.0), 0.5, 2, True)) for s in (20.0, 5.0))
    assert slow < 0.01
    assert fast > 0.2


@pytest.mark.slow
def test_the_package_does_what_is_written_out_here() -> None:
    whole = experiment(20.0, TAIL)
    same = LocalPolynomial(half_widths=(0.5,), rational=False)
    # The package bins the lines by 1/16 Hz, so that its bands end elsewhere.
    assert package(whole, "A", estimator=same) == pytest.approx(error(whole_pass(whole, 0.5, 2)), rel=0.2)
    bare = experiment(20.0, 0.0)
    assert package(bare, "A", estimator=same) == pytest.approx(error(whole_pass(bare, 0.5, 2, True)), rel=0.3)


@pytest.mark.slow
def test_the_default_beats_the_fixed_bands_with_noise() -> None:
    passes = noisy(experiment(40.0, TAIL, "A", 1.5e-3, 4.0), 0.02, 10.0, 1)
    bands = (error(whole_pass(passes, half, order), 4.0) for half, order in ((0.25, 0), (0.5, 2)))
    assert package(passes, "A", 4.0) < 0.6 * min(bands)


@pytest.mark.slow
def test_noise_costs_in_the_order_of_the_smallest_singular_value() -> None:
    found = {}
    for trio in "ABE":
        passes = experiment(40.0, TAIL, trio, 1.5e-3, 4.0)
        found[trio] = error(whole_pass(noisy(passes, 0.02, 10.0, 1), 0.25), 4.0)
    assert found["A"] == pytest.approx(FIRST["A"][1][2][0] / 100.0, rel=0.25)
    assert found["A"] < 0.6 * found["B"] < found["B"] < found["E"]


def test_the_singular_trio_is_refused_by_its_arcs() -> None:
    passes = labelled(experiment(5.0, TAIL, "D", 1.5e-3, 4.0), "D")
    with pytest.raises(InputError, match="add up to the slot"):
        identify_sweep("s", passes, (22.0, 46.0))


@pytest.mark.slow
def test_without_its_arcs_the_singular_trio_is_called_badly_conditioned_and_its_error_is_stated() -> None:
    # Other harmonics, and the ends of the cut, push along a third direction, a little: no longer exactly singular.
    passes = labelled(noisy(experiment(40.0, TAIL, "D", 1.5e-3, 4.0), 0.02, 10.0, 1), "D")
    bare = [SweepPass(p.record, p.label) for p in passes]
    found = identify_sweep("s", bare, (22.0, 46.0), LocalPolynomial(1.0, rational=False))
    assert any("badly conditioned (above 30) in 22-46 Hz" in w for w in found.warnings)
    truth = ram(4.0).compliance(found.compliance["frequency"].values)
    wrong = np.abs(found.compliance["compliance"].values - truth)
    std = found.compliance["compliance_std"].values
    assert np.sqrt(np.mean(std**2) / np.mean(np.abs(truth) ** 2)) > 0.15
    assert np.sqrt(np.mean((wrong / std) ** 2)) == pytest.approx(1.0, abs=0.4)
