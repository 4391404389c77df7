"""The exam must be able to fail: who answers without looking at the data does not pass."""

from dataclasses import replace

import pytest
from exam.sitting import Answer, always, cases, page, scores
from exam.subjects import SUBJECTS


def truthful(case):
    expected = SUBJECTS[case.subject].effects.get(case.hidden)
    if case.hidden is None:
        return Answer(case, None, "consistent")
    if case.part == "unknown":
        return Answer(case, expected, "unknown")
    return Answer(case, expected, "named", (expected,), gain_db=12.0)


def sit(subject, answer):
    return scores([replace(answer(case), seconds=1.0) for case in cases(subject, 40, 4)])


@pytest.mark.parametrize("subject", SUBJECTS)
def test_who_always_says_friction_or_always_unknown_fails_and_who_tells_the_truth_passes(subject):
    assert all(s.met for s in sit(subject, truthful))
    assert sum(not s.met for s in sit(subject, always("guideway_friction"))) >= 3
    assert sum(not s.met for s in sit(subject, always("unknown"))) >= 3


def test_every_effect_of_the_exam_stands_on_its_page_with_what_was_said():
    text = page([truthful(case) for s in SUBJECTS for case in cases(s, 3, 2)])
    for subject in SUBJECTS.values():
        assert subject.title in text
        assert all(f"| {name} | {cause} | {cause} 2 |" in text for name, cause in subject.effects.items())
