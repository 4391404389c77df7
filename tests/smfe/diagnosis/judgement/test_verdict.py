"""Verdicts: which rivals the data exclude."""

from types import SimpleNamespace

import numpy as np
import pytest

from smfe.diagnosis.judgement import verdict


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
