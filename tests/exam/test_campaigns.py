"""The exam through campaign files must be able to fail, and reads nothing but the file."""

import sys
import time
from dataclasses import replace
from pathlib import Path
from types import FrameType, SimpleNamespace

import pytest
from truth.imperfect.bench import Answer
from truth.imperfect.families import FAMILIES

import smfe
from exam.campaign_scores import Case, Said, page, scores
from exam.campaigns import DECIDES, OutOfPatienceError, cases, code, diagnosing, examine, meaning, patient, sit
from exam.campaigns import _said as kept_of
from exam.subjects import Without
from smfe.diagnosis.inference.problem import Cause, Parameter
from smfe.diagnosis.judgement.materiality import Worth


def wanted(case: Case) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """What the generator would say is right."""
    module = FAMILIES[case.family]
    known = {**module.EFFECTS, **module.OUTSIDE}
    return () if case.what == "healthy" else tuple((name, known[name].causes) for name in case.what.split("+"))


def truthful(case: Case) -> Said:
    asked = Said(case, "consistent", wanted=wanted(case), seconds=1.0)
    if case.part == "null":
        return asked
    if case.part in ("unknown", "outside"):
        return replace(asked, verdict="unknown")
    named = tuple((ids[0], -1) for _, ids in asked.wanted)
    return replace(asked, verdict="named", causes=named, gain_db=12.0)


def always(word: str):
    """Return who answers without looking."""

    def answer(case: Case) -> Said:
        asked = Said(case, "unknown", wanted=wanted(case), seconds=1.0)
        return asked if word == "unknown" else replace(asked, verdict="named", causes=((word, -1),))

    return answer


@pytest.mark.parametrize("family", FAMILIES)
def test_who_always_says_friction_or_always_unknown_fails_and_who_tells_the_truth_passes(family: str) -> None:
    every = cases(family, 40, 4, fresh=False)
    assert all(s.met for s in scores([truthful(c) for c in every]))
    assert sum(not s.met for s in scores([always("guideway_friction")(c) for c in every])) >= 4
    assert sum(not s.met for s in scores([always("unknown")(c) for c in every])) >= 4


def test_causes_that_the_data_do_not_separate_stand_for_one() -> None:
    case = Case("cutting", "force_gain", "effect", 1)
    both = (("force_coefficients", 1), ("sensor_gain", 1))
    said = Said(case, "named", both, wanted=wanted(case))
    assert said.right
    assert not said.wrong
    apart = replace(said, causes=tuple((name, -1) for name, _ in both))
    assert not apart.right
    assert apart.wrong
    other = replace(said, causes=(("runout", -1),))
    assert other.wrong
    audited = replace(said, verdict="consistent", causes=(), audit=(("fault", "sensor_gain"),))
    assert audited.right
    assert replace(audited, verdict="named", causes=(("sensor_gain", -1),)).right
    assert not replace(audited, verdict="named", causes=(("sensor_gain", -1), ("posture", -1))).right
    assert not replace(audited, audit=(("warning", "sensor_gain"),)).right


def test_what_stands_in_a_set_with_the_truth_has_no_interval_to_hold() -> None:
    """A gain 13 % off is as well a coefficient 13 % off: that one would have its value, and has another."""
    case, hidden = Case("cutting", "force_gain", "effect", 1), Answer("cutting", 1, {}, {}, 0.1, {"Ktc": 1000.0})
    would = [{"name": "Ktc", "value": 870.0, "low": 850.0, "high": 890.0}]
    both = [{"id": "sensor_gain", "set": 1, "parameters": []}, {"id": "force_coefficients", "set": 1}]
    both[1]["parameters"] = would
    for found, count in ((both, 0), ([both[1] | {"set": None}], 1)):
        answer = {"verdict": "named", "causes": found}
        said = kept_of(case, hidden, wanted(case), "", "", 1.0, answer)
        assert len(said.estimates) == count


def test_the_page_has_a_row_for_every_effect_of_every_family() -> None:
    every = [c for family in FAMILIES for c in cases(family, 3, 2, fresh=False, sizes=1)]
    text = page([truthful(c) for c in every])
    for module in FAMILIES.values():
        for name, what in module.EFFECTS.items():
            assert f"| {name} | " in text
            assert what.causes[0] in text
    assert f"{len(every)} campaigns were sat" in text


def test_the_page_says_how_many_answers_an_earlier_state_of_the_code_gave() -> None:
    every = [replace(truthful(c), code="new") for c in cases("cutting", 3, 1, fresh=False)]
    assert "earlier" not in page(every, code=lambda family: "new")
    every[:2] = [replace(a, code="old") for a in every[:2]]
    assert " 2 of the answers were given by an earlier state of the code." in page(every, code=lambda family: "new")


def test_an_answer_is_as_old_as_the_last_change_of_what_the_code_does_whatever_its_words() -> None:
    """A comment or a docstring that is put right does not make hours of answers those of an earlier code."""
    was = 'def f(x):\n    """Double."""\n    return 2 * x\n'
    assert meaning(was) == meaning('def f(x):\n    # Twice.\n    """Return twice."""\n    return 2 * x\n')
    assert meaning(was) != meaning(was.replace("2", "3"))


@pytest.mark.slow
@pytest.mark.parametrize("case", [Case("cutting", "coefficients", "effect", 1), Case("drive", "healthy", "null", 1)])
def test_an_answer_does_not_age_by_code_that_gives_none(case: Case) -> None:
    """Of the folders that are left out of the state of a family's code no function runs."""
    ran: set[str] = set()

    def note(frame: FrameType, event: str, argument: object) -> None:
        name = frame.f_code.co_name
        if event == "call" and name not in ("<module>", "<lambda>") and not name.startswith("__"):
            ran.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        assert examine(case, 600.0).verdict in ("named", "consistent")
    finally:
        sys.setprofile(None)
    root = Path(smfe.__file__).parents[1]
    mine = {str(p) for p in diagnosing(case.family)}
    every = {str(p) for place in ("process", "stability", "smfe/diagnosis") for p in (root / place).rglob("*.py")}
    told = {p for p in every if Path(p).parent.name == "story" and Path(p).name not in DECIDES}
    assert ran & mine
    assert ran & told
    assert sorted(ran & (every - mine - told)) == []


@pytest.mark.slow
def test_a_campaign_is_written_diagnosed_and_kept(tmp_path: Path) -> None:
    kept = tmp_path / "answers.jsonl"
    every = [Case("cutting", "exchanged", "effect", 3), Case("cutting", "healthy", "null", 1)]
    said = sit(every, kept, 1, 100.0)
    assert {a.case for a in said} == set(every)
    assert next(a for a in said if a.case.part == "effect").detected
    again = sit(every, kept, 1, 100.0)
    assert sorted(again, key=str) == sorted(said, key=str)
    assert len(kept.read_text().splitlines()) == 2
    assert {a.code for a in again} == {code("cutting")}


@pytest.mark.slow
def test_who_takes_too_long_is_given_up() -> None:
    assert examine(Case("cutting", "healthy", "null", 1), 0.005).verdict == "no answer"


@pytest.mark.parametrize(("caught", "times"), [(Exception, 0), (BaseException, 1)])
def test_nobody_who_catches_errors_goes_on_for_ever(caught: type[BaseException], times: int) -> None:
    """An `except` for any error, or a callback that loses what was raised in it, ends within a second of CPU time."""
    begin, lost = time.process_time(), []

    def busy() -> None:
        while time.process_time() < begin + 5.0:
            try:
                sum(range(1000))
            except caught:
                lost.append(1)
                if len(lost) > times:
                    raise

    with pytest.raises(OutOfPatienceError), patient(0.05):
        busy()
    assert len(lost) <= times + (caught is BaseException)
    assert time.process_time() - begin < 1.0


@pytest.mark.parametrize(("seconds", "said"), [(0.05, OutOfPatienceError), (60.0, SystemError)])
def test_what_compiled_code_makes_of_the_end_of_patience_is_no_crash(seconds: float, said: type[BaseException]) -> None:
    begin = time.process_time()

    def compiled() -> None:
        try:
            while time.process_time() < begin + 0.5:
                sum(range(1000))
        except OutOfPatienceError as lost:
            raise SystemError("returned a result with an exception set") from lost
        raise SystemError("of its own")

    with pytest.raises(said), patient(seconds):
        compiled()


def test_what_a_family_without_a_cause_changes_is_weighed_by_its_depths() -> None:
    """Its kind says whether there are any; what is left out of it has its null."""
    whole = SimpleNamespace(
        causes=tuple(Cause(n, n, (Parameter(n, "1", 0.5, 1.0),)) for n in ("slip", "gap")), nuisances=()
    )
    seen = []

    def weigh(family):
        seen.append(family)
        return Worth(0.05, cost=lambda before, after: after["slip"] + after["gap"] - before["slip"] - before["gap"])

    worth = Without(Without(whole, "slip"), "gap").worth(weigh)
    assert seen == [whole]
    assert worth.material == 0.05
    assert worth.cost({"gap": 0.5}, {"gap": 0.75}) == pytest.approx(0.25)
