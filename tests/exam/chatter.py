"""Exam of the chatter verdict: cuts of an independent simulator, judged blind; writes a table for the documentation.

python tests/exam/chatter.py docs/chatter_table.md --jobs 2 [--draws 200] [--between 60]
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from scipy.stats import beta
from truth.chatter import draw

from process.errors import InputError
from process.labels import make_record
from stability import chatter_verdict

RANGES = {"stable": (0.3, 0.9), "chatter": (1.1, 2.0), "between": (0.9, 1.1)}
FIRST = {"stable": 4_000_000, "chatter": 5_000_000, "between": 6_000_000}
CLASSES = (
    "sound",
    "acceleration",
    "run-out",
    "speed drift",
    "drifting modes",
    "period doubling",
    "entry",
    "no entry",
    "exit",
    "no exit",
)


def judge(job: tuple[str, int]) -> dict[str, object]:
    """Draw and judge one cut; the same cut again with another number of teeth declared, and from its tacho alone."""
    kind, seed = job
    d = draw(seed, RANGES[kind])
    vectors = {"acceleration": {k[-1]: v for k, v in d.channels.items() if k != "sound"}}
    scalars = {k: v for k, v in d.channels.items() if k == "sound"}
    record = make_record(d.time, vectors if vectors["acceleration"] else {}, scalars)
    found = chatter_verdict(record, d.stated_rpm * math.pi / 30.0, d.teeth)
    out = {"kind": kind, "verdict": found.verdict, "teeth": d.teeth, "classes": d.classes, "planted": "", "tacho": ""}
    out["speed"] = ""
    if kind == "stable" and seed % 2:
        wrong = d.teeth + (1 if d.teeth < 8 else -1)
        again = chatter_verdict(record, d.stated_rpm * math.pi / 30.0, wrong)
        said = f"{wrong} teeth are declared, but {d.teeth} fit" in again.reason
        out["planted"] = "said" if said else again.verdict
    if kind != "between" and seed % 8 == 1:
        wrong_speed = (1.04 if seed % 16 == 1 else 0.96) * d.stated_rpm * math.pi / 30.0
        again = chatter_verdict(record, wrong_speed, d.teeth)
        out["speed"] = "said" if "check the speed" in again.reason else f"{kind} called {again.verdict}"
    if seed % 4 == 0:
        record["tacho"] = ("time", d.tacho, {"units": "1", "pulses_per_revolution": 1.0})
        try:
            out["tacho"] = chatter_verdict(record, None, d.teeth).verdict
        except InputError as error:
            out["tacho"] = f"refused: {error}"
    return out


def interval(hits: int, of: int) -> str:
    """Return a share with its Clopper-Pearson interval of 95 %, in per cent."""
    if of == 0:
        return "-"
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, of - hits + 1))
    high = 1.0 if hits == of else float(beta.ppf(0.975, hits + 1, of - hits))
    return f"{100 * hits / of:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def table(rows: list[dict[str, object]]) -> str:
    """Return the outcomes as Markdown."""
    lines = [
        "| cuts | false chatter, % of stable | missed, % of chatter | undecided, % of both |",
        "| --- | --- | --- | --- |",
    ]

    def line(name: str, some: list[dict[str, object]]) -> str:
        stable, chatter = ([r for r in some if r["kind"] == k] for k in ("stable", "chatter"))
        false = sum(r["verdict"] == "chatter" for r in stable)
        missed = sum(r["verdict"] == "stable" for r in chatter)
        open_ = sum(r["verdict"] == "undecided" for r in stable + chatter)
        return (
            f"| {name} ({len(stable)} + {len(chatter)}) | {interval(false, len(stable))} | "
            f"{interval(missed, len(chatter))} | {interval(open_, len(stable) + len(chatter))} |"
        )

    scored = [r for r in rows if r["kind"] != "between"]
    lines.append(line("all", scored))
    lines += [line(name, [r for r in scored if name in r["classes"]]) for name in CLASSES]
    lines += [line(f"{z} teeth", [r for r in scored if r["teeth"] == z]) for z in range(2, 9)]
    middle = Counter(str(r["verdict"]) for r in rows if r["kind"] == "between")
    planted = Counter(str(r["planted"]) for r in rows if r["planted"])
    speed = Counter(str(r["speed"]) for r in rows if r["speed"])
    tacho = Counter(
        "right" if r["tacho"] == r["kind"] else "undecided" if r["tacho"] == "undecided" else "wrong"
        for r in scored
        if r["tacho"]
    )
    said = (
        ("Between 0.9 and 1.1 times the limit", middle, ""),
        ("A tooth too many or too few declared for stable cuts", planted, " (said: the right number is named)"),
        ("Speed stated 4 % wrong", speed, " (said: check the speed)"),
        ("From the tacho, no speed stated", tacho, ""),
    )
    lines.append("")
    for what, counts, more in said:
        if counts:
            found = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
            lines.append(f"{what} ({sum(counts.values())} cuts): {found}{more}.")
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    """Run the exam."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--between", type=int, default=60)
    choices = parser.parse_args()
    counts = {"stable": choices.draws, "chatter": choices.draws, "between": choices.between}
    jobs = [(kind, FIRST[kind] + i) for kind, count in counts.items() for i in range(count)]
    with ProcessPoolExecutor(choices.jobs) as pool:
        rows = list(pool.map(judge, jobs, chunksize=4))
    choices.output.write_text(table(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
