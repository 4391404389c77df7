"""The exam: hidden effects, what was said about them, and the table of targets beside what was measured.

``python tests/exam/sitting.py docs/exam.md`` writes the table; `make exam` calls it. Answers are kept in
``.cache/exam`` as they come, so that an exam that was interrupted goes on and can be sat subject by subject; the table
has all of them. ``--afresh`` forgets them: after every change of the diagnosis.
"""

import argparse
import json
import os
import statistics
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))
    import conftest  # noqa: F401

from exam.subjects import SUBJECTS, Without
from scipy import stats

from smfe.diagnosis.engine import diagnose

SEEDS = {"null": 150_000, "effect": 160_000, "unknown": 170_000, "noisy": 180_000}
"""First seed of each part; none of them was used while the diagnosis was tuned."""

NULLS, EACH = 300, 40
"""A full exam: how often nothing is hidden, and seeds of each effect."""

LOUD, NOISY = 40.0, 20.0
"""Signal over noise [dB]."""


@dataclass(frozen=True)
class Case:
    """One sitting: subject, hidden effect (None: nothing), part of the exam, seed, signal over noise [dB]."""

    subject: str
    hidden: str | None
    part: str
    seed: int
    snr: float


@dataclass(frozen=True)
class Answer:
    """What was hidden, what should be said, and what was said."""

    case: Case
    expected: str | None
    verdict: str
    causes: tuple[str, ...] = ()
    sets: tuple[tuple[str, ...], ...] = ()
    gain_db: float | None = None
    seconds: float = 0.0

    @property
    def detected(self):
        """Whether anything is said to be wrong."""
        return self.verdict != "consistent"

    @property
    def right(self):
        """Whether the true cause, and no other, is named."""
        return self.verdict == "named" and self.causes == (self.expected,)

    @property
    def covered(self):
        """Whether the truth is named or among what remains open."""
        return self.right or any(self.expected in s for s in self.sets)

    @property
    def said(self):
        """A few words for the confusion matrix."""
        if self.verdict == "named":
            return " + ".join(self.causes)
        if self.verdict == "ambiguous":
            return "set with the truth" if self.covered else "set without the truth"
        return {"consistent": "nothing"}.get(self.verdict, self.verdict.replace("_", " "))


def examine(case):
    """Hide an effect, diagnose, compare."""
    subject = SUBJECTS[case.subject]
    expected = subject.effects.get(case.hidden)
    family = subject.hide(case.hidden, case.seed, case.snr)
    if case.part == "unknown":
        family = Without(family, expected)
    start = time.process_time()
    found = diagnose(family)
    return Answer(
        case,
        expected,
        found.verdict,
        tuple(c.id for c in found.causes),
        tuple(tuple(c.id for c in s) for s in found.alternatives),
        None if found.gain is None else found.gain.db,
        time.process_time() - start,
    )


def always(word):
    """A cheat: the same answer whatever the data."""

    def answer(case):
        expected = SUBJECTS[case.subject].effects.get(case.hidden)
        return Answer(case, expected, *(("unknown",) if word == "unknown" else ("named", (word,))))

    return answer


def upper(count, of):
    """Clopper-Pearson 95 % upper bound of a rate."""
    return 1.0 if of == count else float(stats.beta.ppf(0.95, count + 1, of - count))


@dataclass(frozen=True)
class Score:
    """A target, what was measured, and whether it was met."""

    item: str
    target: str
    measured: str
    met: bool


def scores(answers):
    """Hold answers against the targets that they allow to be tested."""
    by = {part: [a for a in answers if a.case.part == part] for part in SEEDS}
    found = [*_nulls(by["null"]), *_effects(by["effect"])]
    if by["noisy"]:
        found.append(_share("Named right at 20 dB", by["noisy"], lambda a: a.right, 0.80))
    if by["unknown"]:
        text = "Unknown when the true cause is left out"
        found.append(_share(text, by["unknown"], lambda a: a.verdict in ("unknown", "insufficient_data"), 0.90))
    return found


def _nulls(nulls):
    if not nulls:
        return []
    alarms, named = sum(a.detected for a in nulls), sum(a.verdict in ("named", "ambiguous") for a in nulls)
    # With fewer nulls than 149 not even none would show 2 %.
    allowed = max(0.02, upper(0, len(nulls)))
    found = []
    for item, count in (("Not consistent where nothing is wrong", alarms), ("A cause blamed there", named)):
        bound = upper(count, len(nulls))
        text = f"{count} of {len(nulls)}, upper bound {100 * bound:.1f} %"
        text += " (too few to show 2 %)" if allowed > 0.02 else ""
        found.append(Score(item, "upper bound <= 2 %", text, bound <= allowed))
    return found


def _effects(effects):
    if not effects:
        return []
    seen = [a for a in effects if a.detected]
    false = sum(a.verdict == "unknown" for a in effects) / len(effects)
    wrong = sum(a.verdict == "named" and not a.right for a in effects) / len(effects)
    found = [
        _share("Detected at size X", effects, lambda a: a.detected, 0.95),
        _share("Named right, given detection", seen, lambda a: a.right, 0.95),
        _share("Truth named or in the set", seen, lambda a: a.covered, 0.95),
        Score("A wrong cause named", "<= 5 %", f"{100 * wrong:.1f} % of {len(effects)}", wrong <= 0.05),
        Score("False unknown", "<= 5 %", f"{100 * false:.1f} % of {len(effects)}", false <= 0.05),
    ]
    gains = [a.gain_db for a in effects if a.right and a.gain_db is not None]
    if gains:
        middle = statistics.median(gains)
        found.append(Score("Held-out gain, median", ">= 6 dB", f"{middle:.1f} dB", middle >= 6.0))
    times = [a.seconds for a in effects]
    if max(times) > 0.0:
        text = f"median {statistics.median(times):.1f} s, longest {max(times):.1f} s"
        found.append(Score("CPU time of a diagnosis", "<= 60 s", text, max(times) <= 60.0))
    return found


def _share(item, answers, ok, least):
    count = sum(ok(a) for a in answers)
    measured = count / len(answers) if answers else float("nan")
    return Score(item, f">= {100 * least:.0f} %", f"{100 * measured:.1f} % of {len(answers)}", bool(measured >= least))


def confusion(answers):
    """Rows of the confusion matrix: what was hidden, what should be said, and how often each word was said."""
    rows = []
    asked = [a for a in answers if a.case.part in ("null", "effect")]
    for hidden in dict.fromkeys(a.case.hidden for a in asked):
        mine = [a for a in asked if a.case.hidden == hidden]
        said = ", ".join(f"{word} {n}" for word, n in Counter(a.said for a in mine).most_common())
        rows.append((hidden or "nothing", mine[0].expected or "nothing", said))
    return rows


def page(answers):
    """The page of the documentation."""
    lines = [
        "# The exam of the diagnosis",
        "",
        "`make exam` hides effects in measurements of simulations that share no code with the packages and holds what",
        "the diagnosis says against the targets. First seeds: "
        + ", ".join(f"{k} {v}" for k, v in SEEDS.items())
        + "; none of them was used while the diagnosis was built.",
        "",
    ]
    for key, subject in SUBJECTS.items():
        mine = [a for a in answers if a.case.subject == key]
        if mine:
            lines += _section(subject.title, mine)
    return "\n".join(lines) + "\n"


def _section(title, answers):
    nulls = sum(a.case.part == "null" for a in answers)
    seeds = max(Counter(a.case.hidden for a in answers if a.case.part == "effect").values(), default=0)
    lines = [f"## {title}", ""]
    if nulls < NULLS or seeds < EACH:
        lines += [f"Sat so far: {nulls} of {NULLS} nulls, {seeds} of {EACH} seeds of an effect.", ""]
    lines += ["| item | target | measured | met |", "| --- | --- | --- | --- |"]
    lines += [f"| {s.item} | {s.target} | {s.measured} | {'yes' if s.met else 'no'} |" for s in scores(answers)]
    lines += ["", "| hidden | cause | said |", "| --- | --- | --- |"]
    lines += [f"| {hidden} | {cause} | {said} |" for hidden, cause, said in confusion(answers)]
    wrong = [a for a in answers if (a.case.part == "effect" and not a.right) or (a.case.part == "null" and a.detected)]
    shown = "; ".join(f"{a.case.hidden or 'nothing'} {a.case.seed}: {a.said}" for a in wrong[:40])
    return [*lines, "", "Not right (hidden, seed: said): " + (shown or "none") + ".", ""]


def cases(subject, nulls, seeds):
    """Every case of a subject; nulls and effects mixed, so that an exam that is cut short has some of each."""
    levels = (40.0, 30.0, 20.0) if SUBJECTS[subject].noisy else (LOUD,) * 3
    found = [(i / max(nulls, 1), Case(subject, None, "null", SEEDS["null"] + i, levels[i % 3])) for i in range(nulls)]
    fewer = -(-seeds // 4)
    parts = [("effect", seeds, LOUD), ("unknown", fewer, LOUD)]
    if SUBJECTS[subject].noisy:
        parts.append(("noisy", fewer, NOISY))
    for k, name in enumerate(SUBJECTS[subject].effects):
        for part, count, snr in parts:
            found += [(i / count, Case(subject, name, part, SEEDS[part] + 100 * k + i, snr)) for i in range(count)]
    return [case for _, case in sorted(found, key=lambda x: x[0])]


def sit(every, kept, jobs):
    """Answer every case that has no answer yet, keeping each as it comes; return these and all that were kept."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    answers = [_read(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {a.case for a in answers}
    with ProcessPoolExecutor(jobs) as pool, kept.open("a") as out:
        running = [pool.submit(examine, case) for case in every if case not in done]
        for future in as_completed(running):
            if future.exception():
                pool.shutdown(cancel_futures=True)
            answer = future.result()
            answers.append(answer)
            print(json.dumps(asdict(answer)), file=out, flush=True)
            c = answer.case
            print(f"{len(answers)} {c.subject}: {c.hidden or 'nothing'}: {answer.said}", file=sys.stderr)
    return answers


def _read(line):
    found = json.loads(line)
    return Answer(
        Case(**found.pop("case")),
        causes=tuple(found.pop("causes")),
        sets=tuple(tuple(s) for s in found.pop("sets")),
        **found,
    )


def main():
    """Sit the exam and write its page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--nulls", type=int, default=NULLS)
    parser.add_argument("--seeds", type=int, default=EACH)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--subjects", default=",".join(SUBJECTS))
    parser.add_argument("--afresh", action="store_true")
    arguments = parser.parse_args()
    kept = Path(".cache/exam/answers.jsonl")
    if arguments.afresh:
        kept.unlink(missing_ok=True)
    every = [c for s in arguments.subjects.split(",") for c in cases(s, arguments.nulls, arguments.seeds)]
    arguments.out.write_text(page(sit(every, kept, arguments.jobs)))


if __name__ == "__main__":
    main()
