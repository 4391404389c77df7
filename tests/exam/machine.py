"""Exam of the machine of three axes: what was hidden in a simulated portal, named or not; writes a table.

Every portal has guideways that stick and hammer sets at rest and at four feeds and two levels, hits that lean by 0.5
degrees and sensors calibrated within 0.3 %. Answers are kept as those of `exam.campaigns` are, each with the state of
the code that gave it: an exam that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import os
import time
from functools import partial
from pathlib import Path

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from truth import three_axes
from truth.imperfect.bench import Answer

from exam.campaign_scores import Case, Said, page
from exam.campaigns import SEEDS, asked, code, forget_stale, sit

EFFECTS = three_axes.EFFECTS
PAIRS = tuple(f"{a}+{b}" for n, a in enumerate(EFFECTS) for b in EFFECTS[n + 1 :])

FRESH = 16_000_000
"""What is added for the exam that counts."""

KEPT = Path("tests/exam/answers/machine.jsonl")
"""Answers, trial ones too: what a seed is for its number says."""


def cases(healthy: int, seeds: int, pairs: int, fresh: bool) -> list[Case]:
    """Every case: healthy machines, each effect alone, each pair; all mixed, so that some of each come first."""
    more = FRESH if fresh else 0
    found = [
        (i / max(healthy, 1), Case("machine", "healthy", "null", SEEDS["null"] + more + i)) for i in range(healthy)
    ]
    for part, names, count in (("effect", EFFECTS, seeds), ("two", PAIRS, pairs)):
        for k, name in enumerate(names):
            first = SEEDS[part] + more + 100 * k
            found += [(i / count, Case("machine", name, part, first + i)) for i in range(count)]
    return [case for _, case in sorted(found, key=lambda x: x[0])]


def examine(case: Case, patience: float) -> Said:
    """Simulate, write and diagnose one campaign."""
    return asked(case, partial(written, case), patience, state())


def written(case: Case, folder: Path) -> Answer:
    """Write a campaign; return what is hidden in it."""
    effects = () if case.what == "healthy" else tuple(case.what.split("+"))
    made = three_axes.hidden_campaign(case.seed, effects, folder)
    return Answer("machine", case.seed, made.sizes, {name: (name,) for name in effects}, made.cost, made.truths)


def state(family: str = "machine") -> str:
    """Return what tells this state of diagnosis and portal from any other."""
    return code(family, tuple(sorted(Path(three_axes.__file__).parent.glob("three_axes*.py"))))


def main() -> None:
    """Sit the exam and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--healthy", type=int, default=20, help="healthy machines")
    parser.add_argument("--seeds", type=int, default=20, help="of each effect")
    parser.add_argument("--pairs", type=int, default=20, help="seeds of each pair of effects")
    parser.add_argument("--only", default="", help="what is hidden, separated by commas; default: all")
    parser.add_argument("--trial", action="store_true", help="seeds on which the diagnosis may be tuned")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--patience", type=float, default=300.0, help="CPU seconds of one diagnosis")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin nothing new after so many")
    parser.add_argument("--stale", action="store_true", help="forget the answers of an earlier state of the code")
    given = parser.parse_args()
    if given.stale:
        forget_stale(KEPT, state)
    only, end = given.only.split(","), time.monotonic() + 60.0 * given.minutes
    every = [
        c for c in cases(given.healthy, given.seeds, given.pairs, not given.trial) if not given.only or c.what in only
    ]
    answers = sit(every, KEPT, given.jobs, given.patience, lambda: time.monotonic() > end, examine)
    given.out.write_text(tables(answers), encoding="utf-8")


def tables(answers: list[Said]) -> str:
    """Return the page: the exam that counts, and apart from it the trial."""
    counts = [a for a in answers if a.case.seed >= FRESH]
    trial = [a for a in answers if a.case.seed < FRESH]
    return "\n".join(page(some, some is trial, state) for some in (counts, trial) if some)


if __name__ == "__main__":
    main()
