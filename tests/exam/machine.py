"""Exam of the machine of three axes: what was hidden in a simulated portal, named or not; writes a table.

``machine.py TABLE [--healthy 20] [--seeds 20] [--effects NAMES] [--trial] [--jobs N] [--minutes M]``. Every portal has
guideways that stick and hammer sets at rest and at four feeds and two levels, hits that lean by 0.5 degrees and sensors
calibrated within 0.3 %. Answers are kept in ``.cache/exam`` as they come, so that an exam that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from truth import three_axes

from smfe.commands import diagnose as command

EFFECTS = three_axes.EFFECTS
PAIRS = tuple(f"{a}+{b}" for n, a in enumerate(EFFECTS) for b in EFFECTS[n + 1 :])
TRIAL = 1000  # first seed of those that the diagnosis may be tuned on
Answer = dict[str, object]


def sit(job: tuple[str, int]) -> Answer:
    """Simulate, write and diagnose one campaign."""
    hidden, seed = job
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        path = three_axes.hidden_campaign(seed, () if hidden == "healthy" else hidden.split("+"), folder)
        start = time.process_time()
        finding = command.diagnose(path, folder / "finding.json", workers=1)
        seconds = time.process_time() - start
    said = sorted({c.id for c in finding.causes})
    return {"hidden": hidden, "seed": seed, "verdict": finding.verdict, "said": said, "seconds": seconds}


def right(answer: Answer) -> bool:
    """Whether all that was hidden was named, and nothing else."""
    hidden = [] if answer["hidden"] == "healthy" else str(answer["hidden"]).split("+")
    expected = "named" if hidden else "consistent"
    return answer["verdict"] == expected and answer["said"] == sorted(hidden)


def table(answers: Sequence[Answer]) -> str:
    """Return the outcomes as Markdown."""
    lines = [
        "| hidden | right | others | CPU time, median (largest) |",
        "| --- | --- | --- | --- |",
    ]
    for hidden in ("healthy", *EFFECTS, *PAIRS):
        own = sorted((a for a in answers if a["hidden"] == hidden), key=lambda a: int(str(a["seed"])))
        if own:
            others = [f"{a['seed']}: {a['verdict']} {', '.join(map(str, a['said']))}" for a in own if not right(a)]  # type: ignore[call-overload]
            seconds = sorted(float(str(a["seconds"])) for a in own)
            time_ = f"{seconds[len(seconds) // 2]:.0f} s ({seconds[-1]:.0f} s)"
            count = f"{len(own) - len(others)} of {len(own)}"
            lines.append(f"| {hidden.replace('+', ' + ')} | {count} | {'; '.join(others)} | {time_} |")
    return "\n".join(lines) + "\n"


def jobs_of(effects: Sequence[str], healthy: int, seeds: int, first: int) -> Iterator[tuple[str, int]]:
    """Yield what is asked: healthy machines first, then one seed of each effect after the other."""
    yield from (("healthy", first + n) for n in range(healthy))
    yield from ((effect, first + n) for n in range(seeds) for effect in effects)


def main() -> None:
    """Run the exam."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--effects", default=",".join((*EFFECTS, *PAIRS)))
    parser.add_argument("--trial", action="store_true")
    parser.add_argument("--minutes", type=float, default=600.0)
    given = parser.parse_args()
    kept = Path(f".cache/exam/machine{'_trial' if given.trial else ''}.jsonl")
    kept.parent.mkdir(parents=True, exist_ok=True)
    answers = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    known, end = {(a["hidden"], a["seed"]) for a in answers}, time.monotonic() + 60.0 * given.minutes
    asked = jobs_of(given.effects.split(","), given.healthy, given.seeds, TRIAL if given.trial else 0)
    waiting = [job for job in asked if job not in known]
    with ProcessPoolExecutor(given.jobs) as pool, kept.open("a") as out:
        running = {pool.submit(sit, job) for job in waiting[: given.jobs]}
        waiting = waiting[given.jobs :]
        while running:
            done = next(as_completed(running))
            running.remove(done)
            answers.append(done.result())
            print(json.dumps(answers[-1]), file=out, flush=True)
            given.output.write_text(table(answers), encoding="utf-8")
            if waiting and time.monotonic() < end:
                running.add(pool.submit(sit, waiting.pop(0)))


if __name__ == "__main__":
    main()
