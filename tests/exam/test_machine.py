"""The exam of the machine of three axes must be able to fail, and goes on where it was interrupted."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from truth import three_axes

from exam import machine
from exam.campaign_scores import Case, Said, scores
from exam.campaigns import forget_stale, sit
from exam.machine import EFFECTS, FRESH, PAIRS, cases, tables


@pytest.fixture(autouse=True)
def now(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hashing all of the code takes seconds."""
    monkeypatch.setattr(machine, "state", lambda family="machine": "now")


def said(case: Case, *named: str) -> Said:
    hidden = () if case.what == "healthy" else tuple((name, (name,)) for name in case.what.split("+"))
    verdict = "named" if named else "consistent"
    return Said(case, verdict, tuple((name, -1) for name in named), wanted=hidden, seconds=1.0, gain_db=12.0)


def truthful(case: Case, patience: float = 0.0) -> Said:
    return replace(said(case, *(() if case.what == "healthy" else case.what.split("+"))), code="now")


def test_who_always_says_friction_or_nothing_fails_and_who_tells_the_truth_passes() -> None:
    every = cases(20, 2, 2, fresh=False)
    assert all(s.met for s in scores([truthful(c) for c in every]))
    assert sum(not s.met for s in scores([said(c, "guideway_friction") for c in every])) >= 4
    assert sum(not s.met for s in scores([said(c) for c in every])) >= 3


def test_seeds_of_the_trial_and_of_the_exam_that_counts_are_told_by_their_numbers() -> None:
    every = [*cases(1, 1, 1, fresh=False), *cases(1, 1, 1, fresh=True)]
    assert len({c.seed for c in every}) == 2 * (1 + len(EFFECTS) + len(PAIRS))
    assert sum(c.seed >= FRESH for c in every) == len(every) // 2
    trial, both = (tables([truthful(c) for c in some]) for some in (every[: len(every) // 2], every))
    assert trial.count("campaigns were sat") == trial.count("seeds that were looked at") == 1
    assert both.count("campaigns were sat") == 2
    assert both.index("(a trial") > both.index("campaigns were sat")


def test_answers_are_kept_and_those_of_an_earlier_code_may_be_asked_again(tmp_path: Path) -> None:
    kept, every = tmp_path / "machine.jsonl", cases(2, 1, 0, fresh=False)
    first = sit(every[:3], kept, 1, 1.0, ask=truthful)
    asked: list[Case] = []

    def ask(case: Case, patience: float) -> Said:
        asked.append(case)
        return truthful(case)

    assert len(sit(every, kept, 1, 1.0, ask=ask)) == len(every)
    assert not set(asked) & {a.case for a in first}
    old = [json.dumps(asdict(replace(truthful(c), code="old"))) for c in every[:1]]
    kept.write_text("\n".join([*old, *kept.read_text().splitlines()[1:]]) + "\n")
    forget_stale(kept, lambda family: "now")
    assert len(kept.read_text().splitlines()) == len(every) - 1


def test_answers_outlast_a_file_that_is_replaced_while_an_exam_is_sat(tmp_path: Path) -> None:
    kept, every = tmp_path / "machine.jsonl", cases(3, 0, 0, fresh=False)

    def ask(case: Case, patience: float) -> Said:
        if case == every[1]:  # as git does: another file of the same name
            (tmp_path / "other").write_text(kept.read_text())
            (tmp_path / "other").replace(kept)
        return truthful(case)

    sit(every, kept, 1, 1.0, ask=ask)
    assert len(kept.read_text().splitlines()) == len(every)


@pytest.mark.slow
def test_a_hit_that_leans_is_one_motion() -> None:
    """Where all is linear it is the sum of its parts, along both axes."""
    machine = three_axes.portal(np.random.default_rng(1))
    none = {a: replace(g.scaled(1e-9, 1e-9), contact=1.0, contact_damping=0.0) for a, g in machine.guideways.items()}
    machine = replace(machine, guideways=none, resolution=0.0)
    force = three_axes.hit(np.random.default_rng(2), 0.3, 1600)
    whole, x, y = (
        three_axes.simulate(machine, (0.0, 0.0, 0.0), np.array(way), force)
        for way in ((1.0, 0.1, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    )
    assert np.allclose(whole, x + 0.1 * y, atol=1e-6 * np.abs(whole).max())
