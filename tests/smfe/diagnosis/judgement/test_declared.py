"""Claims about what was declared and what matters, on linear families whose answers are closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.fit import Target, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.judgement import diagnose as judgement
from smfe.diagnosis.judgement.declared import Declared, Released, as_known, contradicted, masking
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.materiality import Worth, predicted_size
from smfe.progress import silent

N = 40
X = np.linspace(0.0, 1.0, N)
SHAPES = np.array([np.cos(k * np.pi * X) for k in range(6)])
WORTH = Worth(0.05)


def declared(name, given, prior=0.1, **more):
    return Parameter(name, "1", 0.0, 0.1, prior=prior, given=given, said=name, **more)


@dataclass(frozen=True)
class Scaled(Abilities):
    """What is measured is ``100 (1 + coefficients + gain) shape``, an own shape for each speed, and a cause beside it.

    Coefficients and gain do the same; a reference of known size, where there is one, sees the gain alone.
    """

    conditions: tuple
    nuisances: tuple = (declared("coefficients", "force_coefficients"), declared("gain", "sensor_gain", 0.01))
    causes: tuple = (Cause("ripple", "a ripple", (Parameter("ripple", "1", 0.0, 1.0),)),)
    proposals: tuple = ()

    def predict(self, condition, values):
        cut = 0.0 if condition.settings.get("reference") else values["coefficients"]
        k = int(condition.settings["speed"])
        return 100.0 * (1.0 + cut + values["gain"]) * SHAPES[k % 2] + values.get("ripple", 0.0) * SHAPES[4]


def measured(truth, seed=0, reference=False, kind=None, **more):
    places = [{"speed": float(k), "feed": float(k % 3)} for k in range(6)]
    if reference:
        places += [{"speed": 0.0, "feed": 0.0, "reference": 1.0}]
    family = (kind or Scaled)(tuple(Condition(f"cut {n}", p) for n, p in enumerate(places)), **more)
    rng = np.random.default_rng(seed)
    values = {p.name: p.start for p in family.nuisances} | truth
    exact = [family.predict(c, values) for c in family.conditions]
    seen = zip(family.conditions, exact, strict=True)
    return replace(family, conditions=tuple(replace(c, observed=x + rng.standard_normal(x.size)) for c, x in seen))


def ids(finding):
    return {c.id: c.set for c in finding.causes}


def test_coefficients_a_third_wrong_are_named_and_the_gain_that_could_as_well_be_is_in_their_set():
    found = diagnose(measured({"coefficients": 0.35}), worth=WORTH)
    assert (found.verdict, ids(found)) == ("named", {"force_coefficients": 1, "sensor_gain": 1})
    for cause in found.causes:
        (estimate,) = cause.parameters
        assert estimate.low <= 0.35 <= estimate.high
        # Of what was measured; the other of the two keeps a part within its prior.
        assert cause.size == pytest.approx(0.35 / 1.35, rel=0.05)
    assert found.gain.db > 20.0


def test_what_the_data_contradict_is_not_consistent_though_conditions_left_out_do_not_bear_it_out(monkeypatch):
    """Coefficients 35 % off are neither named nor called right where nothing can prove them on data no fit has seen."""
    monkeypatch.setattr(judgement, "_borne_out", lambda *_: False)
    found = diagnose(measured({"coefficients": 0.35}), worth=WORTH)
    assert (found.verdict, found.causes) == ("insufficient_data", ())
    assert "contradict what was declared (coefficients or gain)" in found.reason
    assert diagnose(measured({"coefficients": 0.05}), worth=WORTH).verdict == "consistent"


class Faint(Scaled):
    """Forces of the size of the noise, and parameters that can look like much else."""

    supple = True

    def predict(self, condition, values):
        return 0.01 * super().predict(condition, values)


@pytest.mark.parametrize(("coefficients", "db", "named"), [(1.2, -0.3, True), (1.2, -1.0, False), (0.65, -0.3, False)])
def test_where_blocks_of_noise_show_nothing_a_likelihood_ratio_beyond_100_decides(monkeypatch, coefficients, db, named):
    """The ratio is 190 times the square: 274 and 80, of which blocks of values say -0.3 or -1.0 dB within 0.4."""
    monkeypatch.setattr(judgement, "usable", lambda *_: ())
    monkeypatch.setattr(judgement, "within", lambda *_: object())
    monkeypatch.setattr(judgement, "compare", lambda *_: Gain(db, 0.4, 0.0, 0.0, db - 1.2))
    found = diagnose(measured({"coefficients": coefficients}, kind=Faint), worth=WORTH)
    assert (found.verdict == "named") is named
    # The same where both would predict the same.
    monkeypatch.setattr(judgement, "alike", lambda *_: True)
    assert diagnose(measured({"coefficients": coefficients}, kind=Faint), worth=WORTH).verdict == found.verdict


def test_a_declared_value_is_not_right_because_something_without_a_name_can_imitate_it():
    """35 % of the force, of which the gain could do any part: at 5 % trusted of each that is five deviations of both.

    A model that keeps the coefficients as declared predicts what is left out as well, with a gain that nobody trusts.
    """
    nameless = declared("gain", "sensor_gain", 0.05, nameless=True)
    both = declared("coefficients", "force_coefficients", 0.05), nameless
    found = diagnose(measured({"coefficients": 0.35}, nuisances=both), worth=WORTH)
    assert (found.verdict, ids(found)) == ("named", {"force_coefficients": None})
    assert {g.name: g.beyond for g in found.given} == {"coefficients": True, "gain": False}


def test_something_without_a_name_that_is_far_off_is_no_cause():
    nameless = declared("gain", "sensor_gain", 0.05, nameless=True)
    alone = declared("coefficients", "force_coefficients", 0.001), nameless
    found = diagnose(measured({"gain": 0.35}, nuisances=alone, reference=True), worth=WORTH)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert "gain beyond what is trusted" in found.reason


def test_what_is_found_of_a_declared_value_is_one_number_whatever_else_is_fitted_beside_it():
    found = diagnose(measured({"coefficients": 0.35, "ripple": 3.0}, reference=True), worth=WORTH)
    (cause,) = found.causes
    given = next(g for g in found.given if g.cause == cause.id)
    assert [c.id for c in found.immaterial] == ["ripple"]
    assert cause.parameters[0].value == pytest.approx(given.found, rel=1e-9)
    assert given.low <= 0.35 <= given.high


def test_a_reference_of_known_size_tells_the_gain_from_the_coefficients():
    assert ids(diagnose(measured({"coefficients": 0.35}, reference=True), worth=WORTH)) == {"force_coefficients": None}
    assert ids(diagnose(measured({"gain": -0.13}, reference=True), worth=WORTH)) == {"sensor_gain": None}


def test_of_the_experiments_that_could_be_done_next_the_one_that_tells_a_set_apart_is_proposed():
    cut = Condition("another cut", {"speed": 1.0, "feed": 0.0})
    reference = Condition("a reference", {"speed": 0.0, "feed": 0.0, "reference": 1.0})
    found = diagnose(measured({"coefficients": 0.35}, proposals=(cut, reference)), worth=WORTH)
    assert ids(found) == {"force_coefficients": 1, "sensor_gain": 1}
    n = found.next_experiment
    assert (n.name, n.between) == ("a reference", "coefficients and gain")
    # The gain that a reference refutes leaves 0.35 to the coefficients, 3.5 standard deviations of what was declared.
    assert n.discrimination == pytest.approx(3.5**2, rel=0.02)
    alone = diagnose(measured({"coefficients": 0.35}, proposals=(cut,)), worth=WORTH).next_experiment
    assert alone is None or not alone.between


def test_before_is_what_was_declared_and_refitted_is_the_best_that_it_can_do():
    """Coefficients 8 % off, within their tolerance: as declared the error is 8 %, refitted it is noise."""
    found = diagnose(measured({"coefficients": 0.08, "gain": 0.01}), worth=WORTH)
    assert (found.values_before["coefficients"], found.values_before["gain"]) == (0.0, 0.0)
    assert sum(found.values_refitted[n] for n in ("coefficients", "gain")) == pytest.approx(0.09, abs=0.01)
    # 9 of 100 on shapes with a mean square of a half, or of one, over noise of one.
    assert found.misfit_before_db == pytest.approx(10.0 * np.log10(1.0 + 9.0**2 * 0.75), abs=0.6)
    assert found.misfit_refitted_db == pytest.approx(found.misfit_after_db) == pytest.approx(0.0, abs=0.6)
    for c, told in zip(found.compared, found.conditions, strict=True):
        assert np.allclose(c.before.whitened, 100.0 * SHAPES[int(c.condition.settings["speed"]) % 2])
        assert told.before_db > told.refitted_db


def test_what_is_declared_within_its_uncertainty_is_consistent_and_stands_beside_what_was_found():
    found = diagnose(measured({"coefficients": 0.08}), worth=WORTH)
    assert (found.verdict, found.causes) == ("consistent", ())
    coefficients, gain = found.given
    assert coefficients.low <= 0.08 <= coefficients.high
    assert not any(p.beyond for p in (coefficients, gain))


def test_what_is_a_little_off_beyond_its_uncertainty_is_listed_and_convicts_nothing():
    known = (declared("coefficients", "force_coefficients", 0.005), declared("gain", "sensor_gain", 0.001))
    found = diagnose(measured({"coefficients": 0.03}, nuisances=known), worth=WORTH)
    assert (found.verdict, {c.id: c.set for c in found.immaterial}) == (
        "consistent",
        {"force_coefficients": 1, "sensor_gain": 1},
    )
    assert found.immaterial[0].size == pytest.approx(0.03, rel=0.05)


def test_without_a_stated_uncertainty_what_matters_is_a_finding_within_the_prior_too():
    loose = (declared("coefficients", "force_coefficients", stated=False), declared("gain", "sensor_gain", 0.01))
    assert ids(diagnose(measured({"coefficients": -0.13}, nuisances=loose), worth=WORTH)) == {
        "force_coefficients": 1,
        "sensor_gain": 1,
    }
    assert diagnose(measured({"coefficients": -0.13}), worth=WORTH).verdict == "consistent"
    assert diagnose(measured({"coefficients": -0.04}, nuisances=loose), worth=WORTH).verdict == "consistent"


def test_what_has_no_name_and_must_be_beyond_what_is_trusted_of_it_is_unknown():
    """Without their names coefficients half as large again fit as well, by 4.5 standard deviations of both."""
    nameless = (declared("coefficients", ""), declared("gain", "", 0.01))
    found = diagnose(measured({"coefficients": 0.45}, nuisances=nameless), worth=WORTH)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert "coefficients beyond what is trusted of it" in found.reason
    assert diagnose(measured({"coefficients": 0.15}, nuisances=nameless), worth=WORTH).verdict == "consistent"
    exact = (declared("coefficients", "", 0.005), declared("gain", "", 0.001))
    assert diagnose(measured({"coefficients": 0.03}, nuisances=exact), worth=WORTH).verdict == "consistent"


def test_a_cause_that_changes_less_than_what_has_no_name_and_is_strained_is_not_what_is_wrong():
    nameless = (declared("coefficients", ""), declared("gain", "", 0.01))
    truth = {"coefficients": 0.45, "ripple": 12.0}
    found = diagnose(measured(truth, nuisances=nameless), worth=WORTH)
    assert found.verdict == "unknown"
    assert "coefficients beyond what is trusted of it" in found.reason
    assert ids(diagnose(measured(truth | {"ripple": 90.0}, nuisances=nameless), worth=WORTH)) == {"ripple": None}


def test_a_cause_is_not_held_against_what_was_found_with_it_at_work():
    """Modes fitted to hits on a loose joint are not those of the machine; what else has no name counts as before."""
    nameless, truth = (declared("coefficients", ""), declared("gain", "", 0.01)), {"coefficients": 0.45, "ripple": 12.0}
    family = measured(truth, nuisances=nameless)
    for unsettled, verdict in (({"coefficients", "gain"}, "named"), ({"gain"}, "unknown")):
        causes = tuple(replace(c, unsettles=frozenset(unsettled)) for c in family.causes)
        assert diagnose(replace(family, causes=causes), worth=WORTH).verdict == verdict


@dataclass(frozen=True)
class Once(Scaled):
    """A ripple at one speed alone, which no other condition can prove."""

    def predict(self, condition, values):
        here = condition.settings["speed"] == 0.0
        return super().predict(condition, values if here else {**values, "ripple": 0.0})


@pytest.mark.parametrize(("known", "verdict"), [({}, "insufficient_data"), ({"ripple": 50.0}, "consistent")])
def test_what_everybody_knows_to_be_a_little_off_needs_no_proof_and_is_no_fault(known, verdict):
    family = measured({"ripple": 40.0}, kind=Once)
    causes = tuple(replace(c, known=known) for c in family.causes)
    assert diagnose(replace(family, causes=causes), worth=WORTH).verdict == verdict


@dataclass(frozen=True)
class Twice(Once):
    """With a bend beside it, at that speed alone."""

    causes: tuple = (
        Cause("ripple", "a ripple", (Parameter("ripple", "1", 0.0, 1.0),), known={"ripple": 50.0}),
        Cause("bend", "a bend", (Parameter("bend", "1", 0.0, 1.0),)),
    )

    def predict(self, condition, values):
        here = condition.settings["speed"] == 0.0
        return super().predict(condition, values) + (values.get("bend", 0.0) * SHAPES[5] if here else 0.0)


@pytest.mark.parametrize(("bend", "verdict"), [(0.0, "consistent"), (3.0, "insufficient_data")])
def test_what_nothing_proves_is_no_more_right_beside_what_everybody_knows_to_be_a_little_off(bend, verdict):
    """Noise is half as large as it was counted, so that all together leave no more than noise with the bend, too."""
    exact, truth = measured({}, kind=Twice), {"coefficients": 0.0, "gain": 0.0, "ripple": 40.0, "bend": bend}
    half = np.random.default_rng(3).normal(scale=0.5, size=(6, N))
    each = [(c, exact.predict(c, truth) + x) for c, x in zip(exact.conditions, half, strict=True)]
    found = diagnose(replace(exact, conditions=tuple(replace(c, observed=y) for c, y in each)), worth=Worth(0.005))
    assert (found.verdict, [c.id for c in found.immaterial]) == (verdict, ["ripple"])
    assert "a bend, is refused" in found.reason or not bend


@dataclass(frozen=True)
class Leaning(Scaled):
    """A direction of each cut, known within 2 %, does what a gain does that is known within 0.5 %."""

    nuisances: tuple = (declared("coefficients", "", 1e-4), declared("gain", "sensor_gain", 0.005))
    causes: tuple = (
        Cause(
            "directions",
            "directions",
            tuple(Parameter(f"lean_{k}", "1", 0.0, 0.1) for k in range(6)),
            known={f"lean_{k}": 0.02 for k in range(6)},
        ),
    )

    def predict(self, condition, values):
        k = int(condition.settings["speed"])
        return super().predict(condition, values) + 100.0 * values.get(f"lean_{k}", 0.0) * SHAPES[k % 2]


@pytest.mark.parametrize(("all_of_them", "trusted"), [(0.038, True), (0.02, True), (0.038, False)])
def test_a_gain_is_not_right_because_all_directions_could_lean_alike(all_of_them, trusted):
    """3.8 % of six directions is 21.7 of 22.5 (a chi-square of six), of their mean with the gain 4.0 deviations."""
    family = measured({f"lean_{k}": all_of_them for k in range(6)}, kind=Leaning)
    if not trusted:
        family = replace(family, causes=tuple(replace(c, known={}) for c in family.causes))
    model = Model(family, family.conditions)
    target = Target({r: np.asarray(c.observed) for r, c in enumerate(family.conditions)}, model.null())
    at = fit(model, target, (0,), model.null())
    assert as_known(model, target, at, 0) is trusted
    wrong = contradicted(model, target, at, lambda *_: 1.0, 0.05)
    assert [r.given for r in wrong] == ([("sensor_gain",)] if trusted and all_of_them > 0.03 else [])


@dataclass(frozen=True)
class Edged(Scaled):
    """With forces of the edge, the same at all speeds."""

    nuisances: tuple = (
        declared("coefficients", ""),
        declared("gain", "", 0.01),
        declared("edge", "edge_forces", 0.03),
    )

    def predict(self, condition, values):
        return super().predict(condition, values) + 100.0 * values["edge"] * SHAPES[2]


def test_a_declared_value_that_changes_less_than_what_has_no_name_and_is_strained_is_not_what_is_wrong():
    truth = {"coefficients": 0.45, "edge": 0.2}
    found = diagnose(measured(truth, kind=Edged), worth=WORTH)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert "coefficients beyond what is trusted of it" in found.reason
    for right in ({"edge": 0.2}, {"coefficients": 0.45, "edge": 0.8}):
        assert ids(diagnose(measured(right, kind=Edged), worth=WORTH)) == {"edge_forces": None}


def test_a_sensor_without_a_name_that_is_strained_counts_by_what_it_shows():
    """It changes no depth of the machine, but what is measured, and every depth that is reckoned from that."""
    nameless = (declared("coefficients", "force_coefficients", 0.001), declared("gain", "", 0.01))
    worth = Worth(0.05, lambda before, after: 0.1 * abs(after["coefficients"] - before["coefficients"]))
    found = diagnose(measured({"gain": 0.3}, nuisances=nameless), worth=worth)
    assert found.verdict == "unknown"
    assert "gain beyond what is trusted of it" in found.reason
    assert diagnose(measured({"gain": 0.02}, nuisances=nameless), worth=worth).verdict == "consistent"


@dataclass(frozen=True)
class Limited(Scaled):
    """Whitened by the most that the model may miss, of which the noise that was measured is a tenth."""

    def measured_noise(self, condition):
        return np.full(N, 0.1)


@dataclass(frozen=True)
class Two(Scaled):
    """Two sensors show each force, of which nobody knows how large it is."""

    nuisances: tuple = (
        *(declared(n, "sensor_gain", 0.01) for n in ("gain", "other")),
        *(Parameter(f"force_{k}", "1", 0.0, 0.1) for k in range(6)),
    )

    def predict(self, condition, values):
        force = 100.0 * (1.0 + values[f"force_{int(condition.settings['speed'])}"])
        seen = (1.0 + values["gain"]) * SHAPES[0] + (1.0 + values["other"]) * SHAPES[1]
        return np.tile(force * seen + values.get("ripple", 0.0) * SHAPES[4], 2)


@pytest.mark.parametrize("seed", range(3))
def test_two_sensors_that_differ_by_more_than_either_may_be_wrong_are_named_though_both_fit_as_they_are(seed):
    """One shows 15 % more than the other: calibrated within 1 % they differ by 1.4 %.

    Strained gains predict what released ones do, so that nothing left out could tell between them.
    """
    found = diagnose(measured({"gain": 0.15}, seed, kind=Two), worth=WORTH)
    assert (found.verdict, ids(found)) == ("named", {"sensor_gain": None})
    assert diagnose(measured({"gain": 0.02}, seed, kind=Two), worth=WORTH).verdict == "consistent"


@dataclass(frozen=True)
class Turned(Scaled):
    """What is measured goes with the cosine of an angle in one direction and with its sine in another."""

    nuisances: tuple = (declared("gain", "sensor_gain", 0.01), declared("angle", "sensor_axis", 0.02))

    def predict(self, condition, values):
        angle = values["angle"]
        along, across = SHAPES[int(condition.settings["speed"]) % 2], SHAPES[2]
        there = 100.0 * (1.0 + values["gain"]) * (np.cos(angle) * along + np.sin(angle) * across)
        return there + values.get("ripple", 0.0) * SHAPES[4]


@pytest.mark.parametrize(("gain", "wrong"), [(0.0, {"sensor_axis"}), (0.13, {"sensor_axis", "sensor_gain"})])
def test_a_sensor_that_is_turned_far_has_no_wrong_gain_for_the_cosine_of_its_angle(gain, wrong):
    """By 22 degrees it shows 7 % less, which no straight line in the angle does."""
    found = diagnose(measured({"angle": 0.38, "gain": gain}, kind=Turned), worth=WORTH)
    assert (found.verdict, set(ids(found))) == ("named", wrong)


def test_what_no_fit_with_other_values_shows_convicts_no_declared_value(monkeypatch):
    """Where the fit with a value released does not end there are slopes alone: neither wrong nor right."""
    true = judgement._one_by_one

    def unended(*arguments):
        declared_, again = true(*arguments)
        again.fits[()] = replace(again.null(), converged=False)
        return declared_, again

    monkeypatch.setattr(judgement, "_one_by_one", unended)
    found = diagnose(measured({"coefficients": 0.35}), worth=WORTH)
    assert found.verdict in ("unknown", "insufficient_data")
    assert not found.causes
    assert "no fit with other values converged" in found.reason


def test_what_stood_in_for_another_value_is_taken_back_once_that_is_found(monkeypatch):
    """The gain comes first and is right: with the coefficients released it fits as it was declared."""
    true = judgement._contradicted

    def gain_first(bench, at, worth):
        found = true(bench, at, worth)
        gain = Released(("sensor_gain",), 50.0, ({1: 0.35},), ({1: 0.01},))
        return [gain, *found] if bench.model.weight[1] > 0.0 and len(found) == 1 else found

    monkeypatch.setattr(judgement, "_contradicted", gain_first)
    found = diagnose(measured({"coefficients": 0.35}, reference=True), worth=WORTH)
    assert (found.verdict, set(ids(found))) == ("named", {"force_coefficients"})


class Bent(Scaled):
    """A ripple that is partly what the coefficients do."""

    def predict(self, condition, values):
        return super().predict(condition, values) + values.get("ripple", 0.0) * SHAPES[0]


@pytest.mark.parametrize(("gain", "wrong"), [(0.0, {"ripple"}), (0.35, {"ripple", "sensor_gain"})])
def test_a_declared_value_that_stood_in_for_a_cause_is_right_once_that_is_found(monkeypatch, gain, wrong):
    """A search that finds the ripple only where the gain is free, which was moved for want of it."""
    true = judgement.search

    def blind(bench, *args, **more):
        lost = bench.model.weight[1] > 0.0 and not more
        return (bench.null(), []) if lost else true(bench, *args, **more)

    monkeypatch.setattr(judgement, "search", blind)
    truth = {"gain": gain, "ripple": 60.0}
    found = diagnose(measured(truth, reference=True, kind=Bent), worth=WORTH)
    assert found.verdict == "named"
    assert set(ids(found)) == wrong


@dataclass(frozen=True)
class Carried(Scaled):
    """Two readings in every condition: both declared by themselves, or moved by one mass, the second twice as far."""

    nuisances: tuple = (declared("first", "modal_frequency", 0.01), declared("second", "modal_frequency", 0.01))
    causes: tuple = (Cause("mass", "a mass", (Parameter("mass", "1", 0.0, 0.01, low=0.0),)),)

    def predict(self, condition, values):
        mass = values.get("mass", 0.0)
        return 100.0 * ((1.0 + values["first"] - mass) * SHAPES[0] + (1.0 + values["second"] - 2.0 * mass) * SHAPES[1])


def test_what_only_slopes_promise_convicts_no_declared_value(monkeypatch):
    """A release whose fit gains a hundredth of what it promised to first order has shown nothing."""
    family = measured({"coefficients": 0.35})
    assert diagnose(family, worth=WORTH).verdict == "named"
    true = judgement._contradicted
    monkeypatch.setattr(judgement, "_contradicted", lambda *a: [replace(r, ratio=100.0 * r.ratio) for r in true(*a)])
    found = diagnose(family, worth=WORTH)
    assert found.verdict != "named"
    assert not found.causes


def test_one_cause_that_does_what_several_wrong_values_do_is_named_in_their_place():
    """In every condition alike: none left out tests the cause, nor the values."""
    assert ids(diagnose(measured({"mass": 0.06}, kind=Carried), worth=WORTH)) == {"mass": None}
    other = diagnose(measured({"first": -0.12, "second": 0.02}, kind=Carried), worth=WORTH)
    assert ids(other) == {"modal_frequency": None}


@pytest.mark.parametrize(("missed", "pulled"), [(0.1, True), (1.0, False)])
def test_what_a_model_may_miss_counts_as_far_as_it_is_left(missed, pulled):
    """Of two things that differ in their shape alone the data tell as much as what is left lets them."""

    @dataclass(frozen=True)
    class Apart(Limited):
        nuisances: tuple = (declared("coefficients", "force_coefficients", 0.001),)

        def predict(self, condition, values):
            return 10.0 * (1.0 + values["coefficients"]) * SHAPES[int(condition.settings["speed"]) % 2]

    family = Apart(tuple(Condition(f"cut {n}", {"speed": float(n)}) for n in range(6)))
    rng = np.random.default_rng(1)
    seen = [family.predict(c, {"coefficients": 0.02}) + missed * rng.standard_normal(N) for c in family.conditions]
    family = replace(
        family, conditions=tuple(replace(c, observed=y) for c, y in zip(family.conditions, seen, strict=True))
    )
    model = Model(family, family.conditions)
    target = Target({r: np.asarray(c.observed) for r, c in enumerate(family.conditions)}, model.null())
    linear = Declared.of(model, target, fit(model, target, (), model.null()))
    assert (linear.pull(linear.weight, "force_coefficients")[0] < 0.001) == pulled


def test_the_size_of_a_misfit_is_all_of_it_but_the_noise_that_was_measured():
    family = measured({})
    limited = Limited(family.conditions)
    residual = {r: np.full(N, 1.0) for r in range(6)}
    rng = np.random.default_rng(0)
    known, limit = (WORTH.left(Model(f, f.conditions), residual, rng) for f in (family, limited))
    of = np.sqrt(np.mean([100.0**2 * np.mean(SHAPES[n % 2] ** 2) for n in range(6)]))
    assert known < 0.3 / of
    assert limit == pytest.approx(1.0 / of, rel=0.2)


def test_a_condition_that_noise_drowns_says_what_is_left_only_where_all_of_it_is_more_than_noise():
    """Two of its values decide its size, and noise is hardly normal far out: four deviations of both are no misfit."""

    class Drowned(Scaled):
        each_counts = True

        def squared_size(self, condition, misfit):
            noisy = int(condition.settings["speed"]) == 5
            return (0.3 if noisy else 0.01) ** 2 * float(np.mean(misfit[:2] ** 2))

    one = Drowned(measured({}).conditions)
    model, rng = Model(one, one.conditions), np.random.default_rng(0)
    quiet = {r: rng.standard_normal(N) for r in range(6)}
    two = np.where(np.arange(N) < 2, 4.0, 0.7 * quiet[5])
    assert WORTH.left(model, quiet | {5: two}, rng) == 0.0
    assert WORTH.left(model, quiet | {4: two}, rng) == pytest.approx(0.01 * np.sqrt(15.0), rel=0.1)
    assert WORTH.left(model, quiet | {5: np.full(N, 4.0)}, rng) == pytest.approx(0.3 * np.sqrt(15.0), rel=0.1)
    # Where all are so noisy that is all that there is.
    assert WORTH.left(Model(one, one.conditions[5:]), {0: two}, rng) == pytest.approx(0.3 * np.sqrt(15.0), rel=0.1)


def test_a_declared_value_that_has_to_be_impossible_is_not_named():
    bounded = replace(declared("coefficients", "force_coefficients"), high=0.5), declared("gain", "sensor_gain", 0.01)
    far, near = (
        diagnose(measured({"coefficients": x}, nuisances=bounded, reference=True), worth=WORTH) for x in (0.55, 0.45)
    )
    assert (far.verdict, far.causes) == ("unknown", ())
    assert ids(near) == {"force_coefficients": None}


@pytest.mark.parametrize(("material", "verdict"), [(0.005, "unknown"), (0.05, "consistent")])
def test_what_drifts_from_test_to_test_is_unknown_where_it_matters_though_all_together_look_like_noise(
    material, verdict
):
    """From -0.9 to 0.9 %, a likelihood ratio of 45 among 240 values that scatter by less than was allowed for."""
    family = measured({})
    rng, conditions = np.random.default_rng(5), []
    for n, c in enumerate(family.conditions):
        shown = family.predict(c, {"coefficients": 0.0036 * (n - 2.5), "gain": 0.0}) + 0.2 * rng.standard_normal(N)
        conditions.append(replace(c, settings={"speed": c.settings["speed"], "order": float(n)}, observed=shown))
    found = diagnose(replace(family, conditions=tuple(conditions)), worth=Worth(material))
    assert (found.verdict, found.causes) == (verdict, ())
    assert ("changes from test to test" in found.reason) == (verdict == "unknown")


def test_a_cause_is_named_if_it_matters_and_listed_if_it_does_not():
    large, small = (diagnose(measured({"ripple": size}), worth=WORTH) for size in (15.0, 3.0))
    assert (large.verdict, [c.id for c in large.causes], large.immaterial) == ("named", ["ripple"], ())
    assert (small.verdict, small.causes, [c.id for c in small.immaterial]) == ("consistent", (), ["ripple"])
    # 3 of 100 in the same shape, rms over rms.
    assert small.immaterial[0].size == pytest.approx(0.03, rel=0.2)
    assert diagnose(measured({"ripple": 3.0})).verdict == "named"  # where everything matters


@pytest.mark.parametrize(("rest", "verdict"), [(0.5, "named"), (30.0, "named"), (80.0, "unknown")])
def test_a_remainder_is_none_if_it_is_small_and_is_stated_if_nine_tenths_are_explained(rest, verdict):
    family = measured({"ripple": 100.0})
    odd = tuple(
        replace(c, observed=c.observed + rest * (-1.0) ** n * SHAPES[5]) for n, c in enumerate(family.conditions)
    )
    found = diagnose(replace(family, conditions=odd), worth=WORTH)
    assert (found.verdict, [c.id for c in found.causes]) == (verdict, ["ripple"])
    if rest > 1.0:
        # rms over rms: both shapes have the mean square 1/2, the main one and the ripple are 100 each.
        assert found.remainder.size == pytest.approx(rest / np.hypot(np.hypot(100.0, 100.0), rest), rel=0.15)
    else:
        assert found.remainder is None or found.remainder.size < 0.05


def test_the_pull_of_declared_values_that_scatter_as_stated_is_a_chi_square():
    """Three hundred machines whose coefficients and gains are drawn from their priors."""
    rng, p_values = np.random.default_rng(1), []
    for seed in range(300):
        truth = {"coefficients": 0.1 * rng.standard_normal(), "gain": 0.01 * rng.standard_normal()}
        family = measured(truth, seed)
        model = Model(family, family.conditions)
        target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
        linear = Declared.of(model, target, fit(model, target, (), model.null()))
        p_values.append(linear.pull(linear.weight, "force_coefficients")[0])
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_releasing_a_group_is_the_fit_without_its_prior():
    family = measured({"coefficients": 0.35}, reference=True)
    model = Model(family, family.conditions)
    target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    at = fit(model, target, (), model.null())
    (released,) = contradicted(model, target, at, lambda a, b, _: predicted_size(model, [0], a, b), 0.05)
    loose = Model(family, family.conditions, released={"coefficients"})
    again = fit(loose, target, (), loose.null())
    assert released.ratio == pytest.approx(at.chi2 - again.chi2, rel=1e-3)
    assert model.scale[0] * released.values[0][0] == pytest.approx(loose.values(again.u)["coefficients"], rel=1e-6)


GAINS = ("gain_common", "gain_x", "gain_y", "gain_z")


@dataclass(frozen=True)
class Channels(Scaled):
    """Three channels of one sensor, each with a gain of its own beside the one that they have in common."""

    nuisances: tuple = (
        declared("coefficients", "force_coefficients", 0.05),
        *(declared(name, "sensor_gain", 0.01) for name in GAINS),
    )

    def predict(self, condition, values):
        whole = 1.0 + values["coefficients"] + values["gain_common"]
        each = [(whole + values[f"gain_{a}"]) * shape for a, shape in zip("xyz", SHAPES, strict=False)]
        return 100.0 * np.concatenate(each) + values.get("ripple", 0.0)


@pytest.mark.parametrize("id_", ["sensor_gain", "servo_gains"])
@pytest.mark.parametrize("wrong", ["gain_y", "gain_common"])
def test_one_gain_that_does_what_all_of_them_do_is_the_one_that_is_wrong(wrong, id_):
    """Gains of all channels, and what they have in common, trade with each other: free together they say +-50 % each.

    One channel that reads 30 % too much is told from coefficients known within 5 %, and so is the whole sensor; of the
    gains of a control it is the same.
    """
    family = measured({wrong: 0.3}, kind=Channels)
    family = replace(family, nuisances=tuple(replace(p, given=id_) if p.name in GAINS else p for p in family.nuisances))
    found = diagnose(family, worth=WORTH)
    (gain,) = (c for c in found.causes if c.id == id_)
    assert found.verdict == "named"
    assert [p.name for p in gain.parameters] == [wrong]
    assert gain.parameters[0].low <= 0.3 <= gain.parameters[0].high < gain.parameters[0].low + 0.25
    assert {g.name for g in found.given if g.beyond and g.cause == id_} == {wrong}


def test_a_parameter_that_only_shapes_a_cause_may_end_on_its_bound():
    """The shape lies beyond the bound of its parameter, and what remains is a tenth of what the cause explains."""

    @dataclass(frozen=True)
    class Shaped(Scaled):
        def predict(self, condition, values):
            plain = Scaled.predict(self, condition, {**values, "ripple": 0.0})
            return plain + values.get("ripple", 0.0) * np.exp(-X / values.get("length", 0.1))

    def found(secondary):
        length = Parameter("length", "1", 0.1, 0.05, 0.02, 0.3, secondary=secondary)
        ripple = Parameter("ripple", "1", 0.0, 5.0)
        family = replace(measured({}), causes=(Cause("ripple", "a ripple", (ripple, length)),))
        shaped = Shaped(**family.__dict__)
        truth = {"coefficients": 0.0, "gain": 0.0, "ripple": 60.0, "length": 0.33}
        rng = np.random.default_rng(3)
        data = [replace(c, observed=shaped.predict(c, truth) + rng.standard_normal(N)) for c in shaped.conditions]
        return diagnose(replace(shaped, conditions=tuple(data)), worth=WORTH)

    assert [c.id for c in found(True).causes] == ["ripple"]
    assert found(False).verdict == "unknown"


def test_what_only_shapes_an_effect_that_is_known_refuses_nothing_on_its_bound():
    """Friction is declared a third too low, and the travel before it slides is another than anybody trusts."""

    @dataclass(frozen=True)
    class Shaped(Scaled):
        def predict(self, condition, values):
            return 100.0 * (1.0 + values["coefficients"] + np.exp(-X / values["length"])) * SHAPES[0]

    def found(secondary):
        length = Parameter("length", "1", 0.1, 0.02, 0.05, 0.2, prior=0.01, secondary=secondary)
        known = Shaped((), (declared("coefficients", "force_coefficients"), length), ())
        places = [Condition(f"cut {n}", {"speed": float(n)}) for n in range(6)]
        rng, truth = np.random.default_rng(5), {"coefficients": 0.6, "length": 0.21}
        data = [replace(c, observed=known.predict(c, truth) + rng.standard_normal(N)) for c in places]
        return diagnose(replace(known, conditions=tuple(data)), worth=WORTH)

    assert ids(found(True)) == {"force_coefficients": None}
    assert found(False).verdict == "unknown"


def test_what_is_left_besides_makes_no_prior_wider():
    """Half of the force at a tenth trusted is five deviations, however much is left besides that nothing explains.

    The data know it to a hundredth. What they know no better than the prior does is another matter: five times the
    noise in everything says of a value that is two deviations off that it may be right.
    """

    def released(truth, prior, rough):
        family = measured(
            truth, nuisances=(declared("coefficients", "force_coefficients", prior), declared("gain", ""))
        )
        rng = np.random.default_rng(8)
        family = replace(
            family,
            conditions=tuple(
                replace(c, observed=c.observed + rough * rng.standard_normal(N)) for c in family.conditions
            ),
        )
        fixed = replace(family, nuisances=(family.nuisances[0], replace(family.nuisances[1], prior=1e-6)))
        model = Model(fixed, fixed.conditions)
        target = Target({r: c.observed for r, c in enumerate(fixed.conditions)}, model.null())
        at = fit(model, target, (), model.null())
        return contradicted(model, target, at, lambda *_: 1.0, 0.05)

    assert released({"coefficients": 0.5}, 0.1, 0.0)
    assert released({"coefficients": 0.5}, 0.1, 5.0)
    assert released({"coefficients": 0.06}, 0.01, 0.0)
    assert not released({"coefficients": 0.06}, 0.01, 30.0)


@dataclass(frozen=True)
class Few(Abilities):
    """Seven limits of two values each, of a machine with twelve numbers of its own that are known within a prior."""

    conditions: tuple
    nuisances: tuple = (
        declared("coefficients", "force_coefficients"),
        *(declared(f"own {k}", "modes", nameless=True) for k in range(12)),
    )
    causes: tuple = ()
    proposals: tuple = ()

    def predict(self, condition, values):
        n = int(condition.settings["speed"])
        own = [values.get(f"own {2 * n + i}", 0.0) for i in (0, 1)]
        return 20.0 * (values["coefficients"] + np.array(own))


def test_nuisances_that_keep_their_priors_use_up_no_values():
    """Fourteen values and thirteen parameters: what is declared 50 % too low is as far off as the values say.

    The deviation of their mean is that of noise over twenty, and of a tenth in twelve of fourteen. If parameters with a
    prior counted as values less, one value would have to answer for the noise of all fourteen.
    """
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = {f"own {k}": 0.1 * x for k, x in enumerate(rng.standard_normal(12))} | {"coefficients": 0.5}
        family = Few(tuple(Condition(f"limit {n}", {"speed": float(n)}) for n in range(7)))
        seen = [family.predict(c, truth) + rng.standard_normal(2) for c in family.conditions]
        family = replace(
            family, conditions=tuple(replace(c, observed=y) for c, y in zip(family.conditions, seen, strict=True))
        )
        model = Model(family, family.conditions)
        target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
        linear = Declared.of(model, target, fit(model, target, (), model.null()))
        pulls.append(linear.pull(linear.weight, "force_coefficients")[0])
    variance = 1.0 / (12.0 / (0.1**2 + 0.05**2) + 2.0 / 0.05**2)
    expected = 2.0 * stats.norm.sf(0.5 / np.hypot(np.sqrt(variance), 0.1))
    assert max(pulls) < 0.001
    assert np.exp(np.median(np.log(pulls))) == pytest.approx(expected, rel=0.5)


@dataclass(frozen=True)
class Levels(Abilities):
    """Limits at twelve speeds: a harder material lowers all, a flank raises those at low speed and no other."""

    conditions: tuple
    nuisances: tuple = (declared("hardness", "force_coefficients", 0.03, stated=True),)
    causes: tuple = (Cause("worn", "a worn flank", (Parameter("worn", "1", 0.0, 0.1, 0.0, 10.0),)),)
    proposals: tuple = ()
    masks: bool = True

    def predict(self, condition, values):
        return np.array([(values.get("worn", 0.0) / condition.settings["speed"] - values["hardness"]) / 0.02])


def test_what_is_left_hides_a_declared_value_unless_it_is_laid_to_causes():
    """A material 15 % too hard, where every other limit is 15 % higher: no cause explains that, and nothing is named.

    With what is left counted as noise the data do not contradict the material; with it laid to a cause they do.
    """
    places = tuple(Condition(f"{n} rpm", {"speed": 1.0 + 0.25 * n}) for n in range(12))
    noise = np.random.default_rng(1).standard_normal(12)
    true = [Levels(places).predict(c, {"hardness": 0.15})[0] for c in places]
    observed = np.array(true) + noise + 7.5 * (-1.0) ** np.arange(12)
    family = Levels(tuple(replace(c, observed=np.array([y])) for c, y in zip(places, observed, strict=True)))
    model = Model(family, family.conditions)
    target = Target({n: np.array([y]) for n, y in enumerate(observed)}, model.null())
    at = fit(model, target, (), model.null())
    assert contradicted(model, target, at, lambda *_: 1.0, 0.05) == []
    (released,) = masking(model, target, at, lambda *_: 1.0, 0.05)
    assert released.given == ("force_coefficients",)
    found = diagnose(family, worth=WORTH)
    assert (found.verdict, found.causes) == ("unknown", ())


def test_no_further_cause_stands_for_a_declared_value_that_the_first_was_hiding(monkeypatch):
    """Something that lowers all limits, and might do more, is the material that is too hard, which asks for less."""
    places = tuple(Condition(f"{n} rpm", {"speed": 1.0 + 0.25 * n}) for n in range(12))

    class Several(Levels):
        def predict(self, condition, values):
            more = values.get("lower", 0.0) + 0.3 * values.get("wave", 0.0) * np.cos(3.0 * condition.settings["speed"])
            return super().predict(condition, values) - more / 0.02

    both = (Parameter("lower", "1", 0.0, 0.1), Parameter("wave", "1", 0.0, 0.1))
    causes = (*Levels.causes, Cause("lowering", "what lowers all limits", both))
    noise = np.random.default_rng(1).standard_normal(12)
    true = [Several(places).predict(c, {"hardness": 0.3, "worn": 1.2}) for c in places]
    seen = tuple(replace(c, observed=y + e) for c, y, e in zip(places, true, noise, strict=True))
    found = diagnose(Several(seen, causes=causes), worth=WORTH)
    assert (found.verdict, set(ids(found))) == ("named", {"force_coefficients", "worn"})
    monkeypatch.setattr(judgement, "_in_place", lambda bench, at, *_: (bench, at, []))
    assert set(ids(diagnose(Several(seen, causes=causes), worth=WORTH))) == {"lowering", "worn"}


def test_a_declared_value_and_a_cause_are_both_named():
    """A material a quarter too hard and a flank that lifts the limits at low speed."""
    places = tuple(Condition(f"{n} rpm", {"speed": 1.0 + 0.25 * n}) for n in range(12))
    noise = np.random.default_rng(1).standard_normal(12)
    true = [Levels(places).predict(c, {"hardness": 0.25, "worn": 0.4}) for c in places]
    seen = tuple(replace(c, observed=y + e) for c, y, e in zip(places, true, noise, strict=True))
    found = diagnose(Levels(seen), worth=WORTH)
    assert (found.verdict, set(ids(found))) == ("named", {"force_coefficients", "worn"})
    healthy = tuple(replace(c, observed=np.array([e])) for c, e in zip(places, noise, strict=True))
    assert diagnose(Levels(healthy), worth=WORTH).verdict == "consistent"


@dataclass(frozen=True)
class Curved(Scaled):
    """A curve of two parameters, and a difference between directions that one of them takes up all but a little of."""

    causes: tuple = (
        Cause("curve", "a curve", (Parameter("level", "1", 0.0, 1.0), Parameter("slope", "1", 0.0, 1.0))),
        Cause("difference", "a difference between the directions", (Parameter("difference", "1", 0.0, 1.0),)),
    )

    @property
    def supple(self):
        return True

    def predict(self, condition, values):
        sign = 1.0 if condition.settings["feed"] > 0.5 else -1.0
        curve = values.get("level", 0.0) * SHAPES[2] + values.get("slope", 0.0) * SHAPES[3]
        apart = values.get("difference", 0.0) * (SHAPES[3] + 0.04 * sign * SHAPES[4])
        return super().predict(condition, values) + curve + apart


def test_a_cause_that_another_hides_is_found_if_it_matters_however_little_the_other_leaves():
    """A fifth of what is measured, of which all but 0.8 % looks like twice the slope: a likelihood ratio of 80."""
    truth = {"level": 40.0, "slope": 20.0, "difference": 20.0}
    found = diagnose(measured(truth, kind=Curved), worth=WORTH)
    assert (found.verdict, {c.id for c in found.causes}) == ("named", {"curve", "difference"})
    slope = next(p for c in found.causes for p in c.parameters if p.name == "slope")
    assert abs(slope.value - 20.0) < 1.5 * (slope.high - slope.low)
    assert slope.high < 35.0
    # A fault of the measurement that as little speaks for is not looked for.
    fault = tuple(replace(c, kind="measurement") if c.id == "difference" else c for c in Curved.causes)
    assert [c.id for c in diagnose(replace(measured(truth, kind=Curved), causes=fault), worth=WORTH).causes] == [
        "curve"
    ]
    # One that would change less than matters is not looked for.
    little = diagnose(measured(truth | {"difference": 4.0}, kind=Curved), worth=WORTH)
    assert [c.id for c in little.causes] == ["curve"]


def test_what_no_value_of_a_declared_one_explains_is_a_remainder_beside_a_cause_that_explains_nearly_all():
    """A ripple of 100 %, and coefficients 0.65 % off of which nobody believes more than 0.5 %."""
    bounded = (
        replace(declared("coefficients", "force_coefficients", 3e-4), high=0.005),
        declared("gain", "sensor_gain", 1e-5),
    )
    both, alone = (
        diagnose(measured({"coefficients": 0.0065, "ripple": ripple}, nuisances=bounded), worth=Worth(0.003))
        for ripple in (100.0, 0.0)
    )
    assert (both.verdict, ids(both)) == ("named", {"ripple": None})
    # What is left of it where its prior holds it, of what the ripple makes more by a half.
    assert 0.003 < both.remainder.size < 0.0065
    assert (alone.verdict, alone.causes) == ("unknown", ())


def test_a_cause_that_one_condition_shows_hinders_no_other_condition_from_being_left_out(monkeypatch):
    """Coefficients a third off in six cuts, of which the first has a ripple besides."""

    class Once(Scaled):
        def predict(self, condition, values):
            first = condition.settings["speed"] == 0.0
            return np.tile(super().predict(condition, values if first else values | {"ripple": 0.0}), 2)

    measured_twice = measured({"coefficients": 0.35, "ripple": 40.0}, kind=Once)
    monkeypatch.setattr(judgement, "within", lambda *_: pytest.fail("only blocks of values are left out"))
    found = diagnose(measured_twice, worth=WORTH)
    assert set(ids(found)) == {"force_coefficients", "sensor_gain", "ripple"}


def test_an_experiment_that_shows_a_little_of_each_of_many_is_not_proposed_for_nothing():
    """A seventh cut like the others shows each of twelve shapes 8 % smaller: 150 % in all, and nothing to be said."""

    class Many(Scaled):
        def predict(self, condition, values):
            more = sum(values.get(f"shape_{k}", 0.0) * np.cos(k * np.pi * X) for k in range(2, 14))
            return super().predict(condition, values) + more

    causes = tuple(Cause(f"shape_{k}", f"shape {k}", (Parameter(f"shape_{k}", "1", 0.0, 0.1),)) for k in range(2, 14))
    again = Condition("as cut 1, once more", {"speed": 1.0, "feed": 1.0, "minutes": 5.0})
    found = diagnose(measured({}, kind=Many, causes=causes, proposals=(again,)), worth=WORTH)
    assert found.verdict == "consistent"
    assert found.next_experiment is None or found.next_experiment.reveals


def test_a_diagnosis_is_the_same_where_divide_and_conquer_gives_up(monkeypatch):
    def gives_up(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    family = measured({"coefficients": 0.35, "ripple": 15.0})
    expected = diagnose(family, worth=WORTH)
    monkeypatch.setattr(np.linalg, "svd", gives_up)
    found = diagnose(family, worth=WORTH)
    assert (found.verdict, ids(found)) == (expected.verdict, ids(expected))
    for one, other in zip(found.causes, expected.causes, strict=True):
        assert one.parameters[0].high == pytest.approx(other.parameters[0].high, rel=1e-6)


@pytest.mark.parametrize(
    ("true", "given", "small"),
    [
        ({"coefficients": 0.02}, "force_coefficients", True),
        ({"coefficients": 0.2}, "force_coefficients", False),
        # A sensor that alone is at fault is named whatever it changes along its own axis.
        ({"gain": 0.02}, "sensor_gain", False),
    ],
)
def test_what_a_release_changes_less_than_matters_is_as_declared(true, given, small):
    family = measured(true, reference=True)
    target = Target({n: c.observed for n, c in enumerate(family.conditions)}, np.zeros(3))
    benches = [
        Bench(Model(family, family.conditions, released=names), target, 0, silent) for names in ((), tuple(true))
    ]
    at, found = (b.null() for b in benches)
    (j,) = (family.nuisances.index(p) for p in family.nuisances if p.given == given)
    released = [Released((given,), 30.0, ({j: float(found.u[j])},), ({j: 0.1},))]
    assert judgement._too_small(benches[1], at, found, released, WORTH) is small
    assert not judgement._too_small(benches[1], at, found, released, replace(WORTH, material=0.0))
