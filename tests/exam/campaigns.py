"""The exam through campaign files: what is said of a folder that an independent generator wrote.

``python tests/exam/campaigns.py docs/exam_campaigns_table.md`` sits it and writes the table; `make exam-campaigns`
calls it. Answers are kept as they come, each with the state of the code that gave it, so that an exam that was
interrupted goes on, and the table says how many are of the code as it is; ``--afresh`` forgets them, ``--stale``
asks those of an earlier code again. A diagnosis is timed by the CPU time of its one process, and given up after
``--patience`` seconds of it.

In the part "unknown" the true cause is taken out of the catalogue, of what was declared too, with those that do the
same to what is measured (`Hiding.alike`): there alone anything else than the file is touched.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from truth.imperfect import bench
from truth.imperfect.bench import Answer
from truth.imperfect.families import FAMILIES, draw

import smfe
from exam.campaign_scores import Case, Said, page
from exam.subjects import Without
from process.errors import InputError
from smfe.commands import diagnose as command

SEEDS = {"null": 1_000, "effect": 20_000, "unknown": 40_000, "two": 60_000, "outside": 80_000, "sizes": 90_000}
"""First seed of each part of a trial exam, whose failures are looked at and repaired."""

FRESH = 25_000_000
"""What is added for the exam that counts: seeds that nothing was tuned on."""

KEPT = Path("tests/exam/answers/campaigns.jsonl")
"""Answers of the exam that counts: it takes longer than one day's work, so they go with the repository."""

LADDER = {
    "cutting": ("runout", "coefficients"),
    "drive": ("friction", "delay"),
    "modal": ("gain", "posture"),
    "limits": (),
    "axis": (),
}
"""Effects of which a ladder of sizes is sat."""

EACH = {"modal": 8, "axis": 8}
"""Campaigns of an effect where a diagnosis takes a minute; 20 in the other families. By the times measured so
far the exam would take a day of CPU time with 20 everywhere, and takes about twelve hours with these."""

SIZES = (0.25, 0.5, 0.75, 1.5, 2.0)

LARGEST = {"delay": 0.75}
"""Largest size of an effect, over that which must be found: with a longer dead time most drives are unstable."""

_SIMULATED = ("process/simulation", "process/harmonic_balance")
_IN_MOTION = ("process/friction", *_SIMULATED)
_MACHINES = ("diagnosis/machine", "diagnosis/evidence")
_LIMITS = tuple(f"diagnosis/cutting/{name}.py" for name in ("limits", "chatter_line", "converged"))
NEVER_RUN: dict[str, tuple[str, ...]] = {
    "cutting": (
        *_LIMITS,
        "diagnosis/drive",
        "diagnosis/frf",
        "process/machine",
        "stability/methods",
        *_MACHINES,
        *_IN_MOTION,
    ),
    "drive": ("diagnosis/cutting", "diagnosis/frf", "process/cut", "stability/methods", *_MACHINES, *_SIMULATED),
    "limits": ("diagnosis/drive", "diagnosis/frf", *_MACHINES, *_IN_MOTION),
    "modal": ("diagnosis/cutting", "diagnosis/drive", *_MACHINES),
    "axis": ("diagnosis/cutting", "diagnosis/drive", *_MACHINES),
}
"""Folders and files of which a diagnosis of a family runs no function: what changes there leaves its answers as they
are."""

DECIDES = ("millimetres.py",)
"""Files of `diagnosis/story` that have a say in what is found: it counts by the depths that it costs. The others put
what was found into words and figures."""

AGAIN = 0.2
"""CPU seconds after which who has not given up is told so again."""


class OutOfPatienceError(BaseException):
    """A diagnosis took longer than anybody waits; no error of the diagnosis, which may catch its own."""


def examine(case: Case, patience: float) -> Said:
    """Write the campaign, have it diagnosed from its file, and keep what was said."""
    state = code(case.family)
    return asked(case, lambda folder: draw(case.family, case.seed, case.what, folder, case.size), patience, state)


def asked(case: Case, write: Callable[[Path], Answer], patience: float, state: str) -> Said:
    """Have a campaign diagnosed that is written to a folder, by a `state` of the code, and keep what was said."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        hidden = write(folder)
        ids = tuple((name, tuple(causes)) for name, causes in hidden.causes.items())
        gone = {*hidden.alike, *(i for _, causes in ids for i in causes)} if case.part == "unknown" else set()
        start = _cpu()
        verdict, error = "", ""
        try:
            with warnings.catch_warnings(), patient(patience), _without(gone):
                warnings.simplefilter("ignore")
                command.diagnose(folder / "campaign.toml", folder / "finding.json", workers=1)
        except OutOfPatienceError:
            verdict, error = "no answer", f"none within {patience:g} s"
        except InputError as refused:
            verdict, error = "refused", str(refused)
        except Exception as broken:
            verdict, error = "crashed", f"{type(broken).__name__}: {broken}"
        seconds = _cpu() - start
        found = {} if verdict else json.loads((folder / "finding.json").read_text(encoding="utf-8"))
    return replace(_said(case, hidden, ids, verdict, error, seconds, found), code=state)


def _said(case, hidden, ids, verdict, error, seconds, found) -> Said:
    causes = found.get("causes", [])
    gain = found.get("opened") or found.get("gain") or {}
    # What stands in a set with the truth has values only in case that it were it.
    true = {i for _, right in ids for i in right}
    shown = [c for c in causes if c["id"] in true or c.get("set") is None]
    known = [[p["name"], p["value"], p["low"], p["high"]] for c in shown for p in c["parameters"]]
    known += [[g["name"], g["found"], g["low"], g["high"]] for g in found.get("given", [])]
    return Said(
        case,
        verdict or found["verdict"],
        tuple((c["id"], -1 if c.get("set") is None else int(c["set"])) for c in causes),
        tuple(tuple(c["id"] for c in s) for s in found.get("alternatives", [])),
        ids,
        tuple((name, float(size)) for name, size in hidden.hidden.items()),
        float(hidden.cost),
        gain.get("db"),
        round(seconds, 2),
        tuple((a["level"], a["cause"]) for a in found.get("data_audit", [])),
        tuple(c["id"] for c in found.get("immaterial", [])),
        tuple((n, *held) for n, *held in known if n in hidden.truths),
        tuple((n, float(v)) for n, v in hidden.truths.items()),
        error or (found.get("reason") or "")[:200],
    )


@cache
def code(family: str, generator: tuple[Path, ...] = ()) -> str:
    """Return what tells this state of a family's diagnosis and generator (default: its own) from any other.

    A hash of what they and the physics below them do: words of comments and docstrings are none of it.
    """
    found = hashlib.sha256()
    written = generator or tuple(Path(bench.__file__).with_name(f"{name}.py") for name in ("bench", family))
    for path in (*diagnosing(family), *written):
        found.update(f"{path.parent.name}/{path.name}\0{meaning(path.read_text())}\0".encode())
    return found.hexdigest()[:12]


def diagnosing(family: str) -> list[Path]:
    """Return the files of the diagnosis of a family and of the physics below it."""
    root = Path(smfe.__file__).parents[1]
    every = [p for place in ("process", "stability", "smfe/diagnosis") for p in sorted((root / place).rglob("*.py"))]
    never = [root / ("smfe" if n.startswith("diagnosis") else "") / n for n in NEVER_RUN.get(family, ())]
    return [
        p for p in every if not (set(never) & {p, *p.parents} or (p.parent.name == "story" and p.name not in DECIDES))
    ]


def meaning(source: str) -> str:
    """Return the syntax tree of a source without its docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
    return ast.dump(tree)


def _cpu() -> float:
    return time.process_time() + resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime


@contextmanager
def patient(seconds: float) -> Iterator[None]:
    """Give up after so many seconds of CPU time, and again and again: what is raised in a callback may get lost."""

    over = False

    def stop(number: int, frame: object) -> None:
        nonlocal over
        over = True
        raise OutOfPatienceError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, AGAIN)
    try:
        yield
    except Exception as lost:
        if over:  # compiled code makes a SystemError of what is raised while it returns
            raise OutOfPatienceError from lost
        raise
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@contextmanager
def _without(gone: set[str]) -> Iterator[None]:
    """Take causes out of the catalogue of whatever family is made meanwhile."""
    if not gone:
        yield
        return
    made, weigh = command.case_of, command.worth_of

    def lacking(*arguments: object, **more: object) -> object:
        case = made(*arguments, **more)
        family = case.family
        for cause in sorted(gone):
            family = Without(family, cause)
        return replace(case, family=family)

    def weighed(campaign: Any, family: Without) -> object:
        return family.worth(partial(weigh, campaign))

    with mock.patch.object(command, "case_of", lacking), mock.patch.object(command, "worth_of", weighed):
        yield


# --- Which campaigns, and in which order.


def cases(family: str, nulls: int, seeds: int, fresh: bool, sizes: int = 0) -> list[Case]:
    """Every case of a family; all parts mixed, so that an exam that is cut short has some of each."""
    module, more = FAMILIES[family], FRESH if fresh else 0
    first = {part: seed + more for part, seed in SEEDS.items()}
    found = [(i / max(nulls, 1), Case(family, "healthy", "null", first["null"] + i)) for i in range(nulls)]
    few = -(-seeds // 4)
    for k, name in enumerate(module.EFFECTS):
        for part, count in (("effect", seeds), ("unknown", few)):
            found += [(i / count, Case(family, name, part, first[part] + 100 * k + i)) for i in range(count)]
    for k, pair in enumerate(module.PAIRS):
        found += [(i / few, Case(family, "+".join(pair), "two", first["two"] + 100 * k + i)) for i in range(few)]
    for k, name in enumerate(module.OUTSIDE):
        found += [(i / few, Case(family, name, "outside", first["outside"] + 100 * k + i)) for i in range(few)]
    for k, (name, size) in enumerate((n, s) for n in LADDER[family] for s in SIZES):
        if size > LARGEST.get(name, size):
            continue
        found += [(i / sizes, Case(family, name, "sizes", first["sizes"] + 100 * k + i, size)) for i in range(sizes)]
    return [case for _, case in sorted(found, key=lambda x: x[0])]


def sit(
    every: Sequence[Case],
    kept: Path,
    jobs: int,
    patience: float,
    until: Callable[[], bool] = lambda: False,
    ask: Callable[[Case, float], Said] = examine,
) -> list[Said]:
    """Answer every case that has no answer yet, keeping each as it comes; return these and all that were kept."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    answers = [Said.read(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {a.case for a in answers}
    waiting = [case for case in every if case not in done]
    for answer in _answered(waiting, jobs, patience, until, ask):
        answers.append(answer)
        # Opened anew each time: a file that git has replaced meanwhile would take the rest with it.
        with kept.open("a") as out:
            print(json.dumps(asdict(answer)), file=out)
        print(f"{len(answers)} {answer.line}", file=sys.stderr, flush=True)
    return answers


def forget_stale(kept: Path, state: Callable[[str], str]) -> None:
    """Forget the answers of any other state of the code of their family."""
    if kept.exists():
        answers = [(line, Said.read(line)) for line in kept.read_text().splitlines()]
        lines = [line for line, answer in answers if answer.code == state(answer.case.family)]
        kept.write_text("".join(f"{line}\n" for line in lines))


def _answered(
    waiting: list[Case],
    jobs: int,
    patience: float,
    until: Callable[[], bool],
    ask: Callable[[Case, float], Said],
) -> Iterator[Said]:
    if jobs == 1:
        for case in waiting:
            if until():
                return
            yield ask(case, patience)
        return
    with ProcessPoolExecutor(jobs, max_tasks_per_child=20) as pool:
        left, asked_now = iter(waiting), set[Future[Said]]()
        while True:
            # One more than there are processes: none waits for the slowest of a batch, and little is begun in vain.
            while len(asked_now) <= jobs and not until() and (case := next(left, None)):
                asked_now.add(pool.submit(ask, case, patience))
            if not asked_now:
                return
            answered, asked_now = wait(asked_now, return_when=FIRST_COMPLETED)
            for future in answered:
                yield future.result()


def sizes(families: Sequence[str], seeds: int) -> str:
    """Return the table of the sizes to which effects are raised until they matter, over some campaigns each."""
    lines = ["| family | effect | must be found from | raised to | unit | costs | right is |", "| --- " * 7 + "|"]
    for family in families:
        for k, (name, what) in enumerate(FAMILIES[family].EFFECTS.items()):
            found = []
            for i in range(seeds):
                # No record is needed for what an effect costs.
                with (
                    tempfile.TemporaryDirectory() as place,
                    mock.patch.object(FAMILIES[family], "_write", return_value={}),
                ):
                    found.append(draw(family, SEEDS["effect"] + 100 * k + i, name, Path(place)))
            each = sorted(abs(a.hidden[name]) for a in found)
            cost = sorted(100.0 * a.cost for a in found)
            reached = "as it is" if what.switch else f"{each[0]:.2g} to {each[-1]:.2g}"
            words = f"{cost[0]:.0f} to {cost[-1]:.0f} %"
            ids = " or ".join(what.causes)
            lines.append(f"| {family} | {name} | {abs(what.size):.2g} | {reached} | {what.unit} | {words} | {ids} |")
    return "\n".join([*lines, "", f"{seeds} campaigns of each.", ""])


def main() -> None:
    """Sit the exam and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--families", default=",".join(FAMILIES))
    parser.add_argument("--parts", default=",".join(SEEDS))
    parser.add_argument("--nulls", type=int, default=60, help="healthy campaigns of each family")
    parser.add_argument("--seeds", type=int, default=0, help="of each effect; default: 20, or as in EACH")
    parser.add_argument("--sizes", type=int, default=10, help="seeds of each size of the ladder")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--patience", type=float, default=300.0, help="CPU seconds of one diagnosis")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin nothing new after so many")
    parser.add_argument("--trial", action="store_true", help="seeds on which the diagnosis may be tuned")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--afresh", action="store_true", help="forget every answer")
    again.add_argument("--stale", action="store_true", help="forget the answers of an earlier state of the code")
    parser.add_argument("--material", type=int, default=0, help="write the table of sizes, from so many campaigns each")
    given = parser.parse_args()
    if given.material:
        given.out.write_text(sizes(given.families.split(","), given.material), encoding="utf-8")
        return
    kept = Path(".cache/exam/campaigns_trial.jsonl") if given.trial else KEPT
    if given.afresh:
        kept.unlink(missing_ok=True)
    elif given.stale:
        forget_stale(kept, code)
    parts, end = given.parts.split(","), time.monotonic() + 60.0 * given.minutes
    families = given.families.split(",")
    count = {f: given.seeds or EACH.get(f, 20) for f in families}
    each = [cases(f, given.nulls, count[f], not given.trial, given.sizes) for f in families]
    mixed = [c for _, c in sorted(((i / len(own), c) for own in each for i, c in enumerate(own)), key=lambda x: x[0])]
    every = [case for case in mixed if case.part in parts]
    answers = sit(every, kept, given.jobs, given.patience, lambda: time.monotonic() > end)
    given.out.write_text(page(answers, given.trial, code), encoding="utf-8")


if __name__ == "__main__":
    main()
