"""Verdicts: which rivals the data exclude."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.misfit import Misfit
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.judgement import diagnose, verdict
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.search import Step


@pytest.mark.parametrize(("strain", "excluded"), [(3000.0, True), (0.0, False)])
def test_a_rival_that_must_move_what_was_declared_is_excluded_though_it_leaves_less(monkeypatch, strain, excluded):
    """Modes that all turn by a right angle, with hits and sensors, leave less than a turned sensor by their number."""
    best = SimpleNamespace(causes=(0,), chi2=3 * 2000.0, residual={r: np.full(500, 2.0) for r in range(3)})
    left = {r: np.full(500, np.sqrt(3.0)) for r in range(3)}
    rival = SimpleNamespace(causes=(1,), chi2=3 * 1500.0 + strain, residual=left)
    monkeypatch.setattr(verdict, "lead", lambda *_: 1000.0)
    monkeypatch.setattr(verdict, "most_needed", lambda *_: 50.0)
    bench = SimpleNamespace(rng=lambda *_: np.random.default_rng(1))
    assert verdict.excluded(bench, best, rival, SimpleNamespace(p_value=0.0)) == excluded


@pytest.mark.parametrize(("causes", "said"), [((1,), "insufficient_data"), ((1, 2), "unknown")])
def test_what_explains_all_and_cannot_be_tested_asks_for_data_and_a_pair_does_not(monkeypatch, causes, said):
    """Bearings that one speed alone shows, beside a worse explanation that conditions left out could test."""
    misfits = {"null": 1e-6, "best": 0.5, "other": 1e-3}
    found = SimpleNamespace(causes=causes, name="best"), SimpleNamespace(causes=(3,), name="other")
    gain = Gain(1.6, 1.0, 1.0, 0.3, -3.0)
    steps = [
        Step(f.causes, "", ratio, 20.0, g, 10.0, False, "untested" if g is None else "refuted")
        for f, ratio, g in zip(found, (100.0, 60.0), (None, gain), strict=True)
    ]
    bench = SimpleNamespace(
        fits={f.causes: f for f in found},
        misfit=lambda f: Misfit(misfits[f.name], 1.0, 1.0, {0: 1.0}),
        words=str,
        model=None,
        convicts=lambda *_: True,
    )
    monkeypatch.setattr(verdict, "on_bound", lambda *_: "")
    monkeypatch.setattr(verdict, "changing", lambda *_: None)
    at = SimpleNamespace(converged=True, causes=(), name="null")
    assert verdict._of_baseline(bench, at, steps, []).verdict == said


@pytest.mark.parametrize(
    ("ratio", "left", "said"),
    [(53.0, 1.03, False), (115.0, 1.4, False), (115.0, 1.03, True), (53.0, 2.0, True)],
)
def test_what_a_model_of_a_machine_misses_convicts_nothing_that_conditions_left_out_do_not_bear_out(
    monkeypatch, ratio, left, said
):
    """A likelihood ratio of a hundred, over what is left, does; and where much is left nothing is put down to that."""
    family = SimpleNamespace(decisive=RULES.decisive, convicting=RULES.decisive)
    bench = SimpleNamespace(model=SimpleNamespace(family=family), misfit=lambda _: Misfit(1e-4, left, 1.0, {0: 1.0}))
    bench.words, bench.fits = str, {(1,): "curve"}
    bench._above, bench.least_gain = partial(Bench._above, bench), RULES.least_within
    bench.convicts = partial(Bench.convicts, bench)
    bench.proves = partial(Bench.proves, bench)
    monkeypatch.setattr(verdict, "on_bound", lambda *_: "")
    monkeypatch.setattr(verdict, "changing", lambda *_: None)
    refused = Step((1,), "", ratio, 22.0, Gain(2.5, 2.8, 0.1, 0.4, -6.0), 10.0, False, "refuted")
    at = SimpleNamespace(converged=True, causes=())
    reason = verdict._of_baseline(bench, at, [refused], []).reason
    assert ("is refused" in reason) == said
    proven = replace(refused, gain=Gain(13.0, 2.0, 1.0, 0.9, 7.0))
    assert "is refused" in verdict._of_baseline(bench, at, [proven], []).reason


@pytest.mark.parametrize(("size", "said"), [(0.01, "consistent"), (0.2, "insufficient_data")])
def test_what_is_not_proven_and_would_not_matter_leaves_a_baseline_consistent(monkeypatch, size, said):
    """A joint that hardens by a thousandth on a healthy portal, 1.7 dB better on conditions left out, of 3 asked."""
    best = SimpleNamespace(causes=(1,), converged=True, chi2=90.0)
    step = Step((1,), "", 60.0, 20.0, Gain(1.7, 0.8, 1.0, 0.3, 0.1), 90.0, False, "too little")
    bench = SimpleNamespace(fits={(1,): best}, words=str, rng=lambda *_: None, model=None)
    refused = verdict.Judgement("insufficient_data", "", {}, Misfit(0.5, 1.0, 1.0, {0: 1.0}))
    monkeypatch.setattr(verdict, "_of_baseline", lambda *_: refused)
    monkeypatch.setattr(verdict, "_beyond_baseline", lambda *_: size)
    at, worth = SimpleNamespace(causes=()), SimpleNamespace(material=0.05)
    assert verdict._without_cause(bench, at, [step], [], worth).verdict == said
    assert verdict._without_cause(bench, at, [], [], worth).verdict == "insufficient_data"


def test_an_experiment_decides_between_what_the_data_leave_open(monkeypatch):
    """Not between two laws of one cause, nor what is far behind or on the limit of what is physical."""
    names = ("bearings", "bearings", "slip", "mode", "turned")
    causes = [SimpleNamespace(id=n, parameters=(0,)) for n in names]
    fits = {
        (k,): SimpleNamespace(causes=(k,), chi2=x, converged=True) for k, x in enumerate((4.0, 5.0, 43.0, 3.0, 6.0))
    }
    steps = [Step(f.causes, "", 90.0, 20.0, None, f.chi2, False, "untested") for f in fits.values()]
    bench = SimpleNamespace(fits=fits, model=SimpleNamespace(causes=causes), misfit=lambda _: None, null=lambda: "null")
    monkeypatch.setattr(diagnose, "charge", lambda *_: 0.0)
    monkeypatch.setattr(diagnose, "on_bound", lambda _, f, __: "mode" if f.causes == (3,) else "")
    monkeypatch.setattr(diagnose, "excluded", lambda _, best, f, __: f.chi2 - best.chi2 > 30.0)
    assert [f.causes for f in diagnose._unproven(bench, steps)] == [(0,), (4,)]
    assert diagnose._unproven(bench, [s for s in steps if s.causes in ((0,), (2,), (3,))]) == [fits[0,], "null"]


@pytest.mark.parametrize(("chi2", "said"), [(32.0, "unknown"), (4.0, "named")])
def test_nothing_is_named_that_another_fault_without_a_name_outdoes(monkeypatch, chi2, said):
    """A mode inside the peak of a known one is a compliance or a force that is wrong there: coefficients, say."""
    causes = [
        SimpleNamespace(title="coupled axes", beyond=None),
        SimpleNamespace(title="a mode", beyond=lambda _: "in"),
    ]
    at, mode = (SimpleNamespace(causes=(k,), chi2=x, converged=True, u=None) for k, x in enumerate((chi2, 1.8)))
    model = SimpleNamespace(causes=causes, values=lambda _: {})
    bench = SimpleNamespace(fits={(1,): mode}, model=model, misfit=lambda _: None, words=str)
    monkeypatch.setattr(verdict, "_judged", lambda *_: verdict.Judgement("named", ""))
    monkeypatch.setattr(verdict, "excluded", lambda _, best, rival, __: rival.chi2 - best.chi2 > 7.0)
    steps = [Step((1,), "", 60.0, 20.0, None, 1.8, False, "inside a peak")]
    assert verdict.judge(bench, at, steps, []).verdict == said
