"""Two methods for the limit depth, held against each other and against integration in time over cuts drawn at random.

``python tests/exam/limits_agree.py docs/limits_table.md`` writes the table; `make strangers` calls it. What has been
computed is kept in ``.cache/limits_agree`` and not computed again; ``--afresh`` forgets it: after every change of a
method. ``--first 812000 --cuts 300 --add`` writes more cuts below those that a table holds. A cut counts as a
disagreement where the two limits are more than 0.5 % apart. It is settled by the multipliers
of `truth.milling_map`, which shares nothing with either: stable below a limit and unstable above it, or not.
"""

import argparse
import json
import math
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from truth.milling_draws import Drawn, draw
from truth.milling_map import TurnMap

from process import CuttingCoefficients, InputError, ModalModel, Tool
from process.cut.engagement import Engagement
from stability import multi_frequency, semi_discretization

FIRST_SEED = 810_000
CUTS = 2000
CACHE = Path(".cache/limits_agree")
METHODS = ("multi_frequency", "semi_discretization")
APART = 0.005
"""Relative difference of two limits from which it is to be explained."""

NEAR = 0.005
"""An agreement is confirmed where the cut is stable so far below the lower limit, and unstable so far above."""

SHARES = np.concatenate([np.geomspace(0.05, 0.5, 6), np.linspace(0.55, 0.985, 18)])
"""Shares of the lower limit at which the cut must be stable."""


def limits(drawn: Drawn) -> dict:
    """Return limit [mm], its stated change, kind, effort, and seconds of each method, or why it refused."""
    cut = drawn.cut
    machine = ModalModel(cut.frequency, cut.damping, cut.stiffness, cut.direction)
    teeth = cut.pitch.size
    pitch = None if drawn.pitch == "equal" else tuple(cut.pitch)
    tool = Tool(0.02, teeth, cut.approach, pitch)
    arc = Engagement(*cut.arcs[0])
    out = {}
    for method, call in zip(METHODS, (multi_frequency, semi_discretization), strict=True):
        start = time.process_time()
        try:
            found = call(machine, tool, arc, CuttingCoefficients(*cut.k), [drawn.speed])
        except InputError as refusal:
            out[method] = {"refused": str(refusal)}
            continue
        effort = "harmonics" if method == METHODS[0] else "steps"
        out[method] = {
            "depth": float(found.limit_depth[0]),
            "error": float(found.limit_depth_error[0]),
            "kind": str(found.kind.values[0]),
            "line": float(found.chatter_frequency[0]),
            "effort": int(found[effort][0]),
            "warned": any("still move" in w for w in found.attrs["warnings"]),
            "seconds": time.process_time() - start,
        }
    return out


def _first_loss(drawn: Drawn, low: float, high: float) -> float:
    """Return the smallest depth [m] found at which the cut loses stability, by integration in time; inf beyond `high`.

    Searched at `BELOW` depths up to `low`, at 60 from there to a little above `high`, and at 60 within 1 % of each.
    """
    turn, fine = TurnMap(drawn.cut, drawn.speed), TurnMap(drawn.cut, drawn.speed, 3.0)
    top = high if math.isfinite(high) else 1.5 * low
    around = np.concatenate([d * np.linspace(1.0 - NEAR, 1.0 + NEAR, 61) for d in (low, top)])
    depths = np.sort(np.concatenate([low * SHARES, np.geomspace(low, top * (1.0 + NEAR), 60), around]))
    stable = 0.0
    for depth in depths:
        if turn.radius(depth) > 1.0 - 2e-3 and fine.radius(depth) > 1.0:
            return fine.limit(stable or 0.5 * depth, depth)
        stable = depth
    return math.inf


def judged(drawn: Drawn, found: dict) -> dict:
    """Return how far apart the methods are, and which of them the integration bears out."""
    depths = {m: found[m].get("depth", math.nan) for m in METHODS}
    if any(math.isnan(d) for d in depths.values()):
        return {"verdict": "refused by " + ", ".join(m for m in METHODS if "refused" in found[m])}
    low, high = min(depths.values()), max(depths.values())
    if not math.isfinite(low):
        return {"apart": 0.0, "verdict": "no limit in either"}
    said = {"apart": high / low - 1.0}
    turn = TurnMap(drawn.cut, drawn.speed)
    below = [turn.radius(1e-3 * low * share) for share in [*SHARES, 1.0 - NEAR]]
    if said["apart"] <= APART and max(below) < 1.0 < turn.radius(1e-3 * low * (1.0 + NEAR)):
        return said | {"verdict": "agree, confirmed"}
    true = 1e3 * _first_loss(drawn, 1e-3 * low, 1e-3 * high)
    said["true"] = true
    right = [m for m in METHODS if abs(depths[m] / true - 1.0) <= APART]
    if said["apart"] <= APART:
        return said | {"verdict": "agree, confirmed" if len(right) else "agree, not confirmed"}
    worse = [f"{m} {'too deep' if depths[m] > true else 'too shallow'}" for m in METHODS if m not in right]
    admits = [m for m in METHODS if m not in right and found[m]["error"] > abs(depths[m] - true)]
    if worse and len(admits) == len(worse):
        return said | {"verdict": f"{' and '.join(worse)}, as its stated error says"}
    return said | {"verdict": " and ".join(worse) or "between the two"}


def answer(seed: int) -> dict:
    """Return the answers to one cut, computed or kept."""
    kept = CACHE / f"{seed}.json"
    if kept.is_file():
        return json.loads(kept.read_text())
    drawn = draw(seed)
    found = limits(drawn)
    try:
        verdict = judged(drawn, found)
    except Exception as failure:  # The judge itself: shown in the table, never hidden.
        verdict = {"verdict": f"not judged: {type(failure).__name__}"}
    out = {"seed": seed, "pitch": drawn.pitch, "teeth": drawn.cut.pitch.size, "arc": drawn.arc, **found, **verdict}
    CACHE.mkdir(parents=True, exist_ok=True)
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(out))
    part.replace(kept)
    return out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("table", type=Path)
    parser.add_argument("--cuts", type=int, default=CUTS)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--afresh", action="store_true")
    parser.add_argument("--add", action="store_true", help="below what the table holds: more seeds of the same methods")
    told = parser.parse_args()
    if told.afresh and CACHE.is_dir():
        for file in CACHE.glob("*.json"):
            file.unlink()
    seeds = range(told.first, told.first + told.cuts)
    with ProcessPoolExecutor(told.jobs) as pool:
        answers = list(pool.map(answer, seeds, chunksize=10))
    earlier = told.table.read_text() + "\n" if told.add else ""
    told.table.write_text(earlier + table(answers))


def table(answers: list[dict]) -> str:
    """Return the verdicts over the kinds of pitch, how far the methods are apart, and the cases that differ."""
    kinds = sorted({a["pitch"] for a in answers})
    counts = Counter((a["verdict"], a["pitch"]) for a in answers)
    verdicts = [v for v, _ in Counter(a["verdict"] for a in answers).most_common()]
    lines = [
        f"{len(answers)} cuts, seeds {answers[0]['seed']} to {answers[-1]['seed']}.",
        "",
        f"| verdict | all | {' | '.join(kinds)} |",
        "| --- " * (len(kinds) + 2) + "|",
    ]
    for v in verdicts:
        each = [counts[v, k] for k in kinds]
        lines.append(f"| {v.replace('_', '-')} | {sum(each)} | {' | '.join(map(str, each))} |")
    apart = np.sort([a["apart"] for a in answers if math.isfinite(a.get("apart", math.inf))])
    shares = ", ".join(f"{100 * np.quantile(apart, q):.2g} %" for q in (0.5, 0.9, 0.99))
    lines += ["", f"Difference of the two limits: median, 90 % and 99 % quantile {shares}.", ""]
    for m in METHODS:
        spent = 1e3 * np.array([a[m]["seconds"] for a in answers if "seconds" in a[m]])
        lines.append(f"- {m.replace('_', '-')}: median {np.median(spent):.0f} ms a limit, mean {spent.mean():.0f} ms")
    odd = [a for a in answers if a["verdict"] not in ("agree, confirmed", "no limit in either") and "true" in a]
    if odd:
        lines += [
            "",
            "| seed | multi-frequency [mm] | semi-discretisation [mm] | in time [mm] | verdict |",
            "| --- " * 5 + "|",
        ]
        for a in odd:
            first, second = (f"{a[m]['depth']:.5g}" for m in METHODS)
            lines.append(f"| {a['seed']} | {first} | {second} | {a['true']:.5g} | {a['verdict'].replace('_', '-')} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
