"""One whole, whose parts fill it one after the other."""

import pytest

from smfe.progress import STEPS, part, parts, silent, step


def test_parts_fill_the_whole_one_after_the_other_and_steps_their_part() -> None:
    said: list[tuple[str, float]] = []

    def whole(what: str, done: int, of: int) -> None:
        said.append((what, done / of))

    of = parts(whole, {"read": 1.0, "fit": 3.0, "never": 0.0})
    of["read"]("read a", 0, 2)
    of["read"]("read b", 1, 2)
    step(of["fit"], 0, 2)("fit a", 1, 4)
    step(of["fit"], 1, 2)("fit b", 4, 4)
    of["never"]("never", 1, 1)
    assert [what for what, _ in said] == ["read a", "read b", "fit a", "fit b", "never"]
    assert [share for _, share in said] == pytest.approx([0.0, 0.125, 0.25 + 0.75 / 8, 1.0, 1.0], abs=1.0 / STEPS)


def test_a_step_of_unknown_length_moves_nothing_and_none_leaves_its_part() -> None:
    said: list[int] = []
    half = part(lambda _, done, of: said.append(done), 0.25, 0.5)
    for done, of in ((3, 0), (7, 5), (-1, 5)):
        half("work", done, of)
    assert said == [STEPS // 4, STEPS // 2, STEPS // 4]
    silent("nothing", 0, 0)
    assert parts(silent, {}) == {}
