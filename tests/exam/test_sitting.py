"""The exam must be able to fail: who answers without looking at the data does not pass."""

from dataclasses import replace

import pytest

from exam.sitting import Answer, always, cases, detected_sizes, page, scores
from exam.subjects import SUBJECTS


def truthful(case):
    if not case.hidden:
        return Answer(case, "consistent")
    if case.part == "unknown":
        return Answer(case, "unknown")
    if case.size < 0.6:
        return Answer(case, "consistent")
    return Answer(case, "named", case.expected, gain_db=12.0)


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


def test_the_table_of_sizes_has_the_size_at_which_half_is_seen():
    rows = detected_sizes([truthful(case) for case in cases("drive", 0, 4, 4)])
    assert [row[0] for row in rows] == list(SUBJECTS["drive"].effects)
    half, most = (float(x) for x in rows[0][2].split(", "))
    assert 0.5 < half < most < 0.76


@pytest.mark.parametrize("subject", [name for name, s in SUBJECTS.items() if s.several])
def test_two_effects_that_are_hidden_together_have_two_causes(subject):
    two = [case for case in cases(subject, 0, 20) if case.part == "two"]
    assert len(two) == 20
    assert all(len(set(case.expected)) == 2 for case in two)
    assert not any("mass_loading" in case.hidden for case in two if subject == "axis")


def test_times_by_the_clock_are_told_from_times_of_one_process():
    asked = [truthful(case) for case in cases("axis", 0, 2) if case.part == "effect"]
    busy = [replace(a, seconds=70.0) for a in asked]
    (score,) = (s for s in scores(busy) if "ime of a diagnosis" in s.item)
    assert (score.item, score.met) == ("CPU time of a diagnosis", False)
    clocked = [replace(a, seconds=40.0, cores=2) for a in asked[:5]] + busy[5:]
    (score,) = (s for s in scores(clocked) if "ime of a diagnosis" in s.item)
    assert (score.item, score.met) == ("Time of a diagnosis on 2 cores", True)
    assert "of 5" in score.measured
