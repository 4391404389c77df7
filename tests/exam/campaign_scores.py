"""What is right of what was said about a campaign, counted, as a page of the documentation."""

from __future__ import annotations

import json
import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import stats

NOTHING_SAID = ("refused", "crashed", "no answer")
"""Verdicts of the exam itself."""

PARTS = ("null", "effect", "unknown", "two", "outside", "sizes")


@dataclass(frozen=True)
class Case:
    """One campaign: family, what is hidden, part of the exam, seed, size over that which must be found."""

    family: str
    what: str
    part: str
    seed: int
    size: float = 1.0


@dataclass(frozen=True)
class Said:
    """What was said about a campaign, and what was hidden in it."""

    case: Case
    verdict: str
    causes: tuple[tuple[str, int], ...] = ()
    """Id of each cause, and the number of the set in which it stands (-1: none)."""
    alternatives: tuple[tuple[str, ...], ...] = ()
    wanted: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Each hidden effect, and the ids of which any is right."""
    sizes: tuple[tuple[str, float], ...] = ()
    cost: float = 0.0
    gain_db: float | None = None
    seconds: float = 0.0
    audit: tuple[tuple[str, str], ...] = ()
    immaterial: tuple[str, ...] = ()
    estimates: tuple[tuple[str, float, float | None, float | None], ...] = ()
    truths: tuple[tuple[str, float], ...] = ()
    reason: str = ""
    code: str = ""
    """Which state of the code said so."""

    @staticmethod
    def read(line: str) -> Said:
        """Return what was kept as a line of JSON."""
        raw = json.loads(line)

        def frozen(x: object) -> object:
            return tuple(frozen(y) for y in x) if isinstance(x, list) else x

        case = Case(**raw.pop("case"))
        return Said(case, **{key: frozen(value) for key, value in raw.items()})

    @property
    def detected(self) -> bool:
        """Whether anything is said to be wrong."""
        return self.verdict not in ("consistent", *NOTHING_SAID)

    @property
    def sets(self) -> list[tuple[str, ...]]:
        """The ids that stand for one cause each."""
        out: dict[int, list[str]] = {}
        for k, (cause, number) in enumerate(self.causes):
            out.setdefault(number if number >= 0 else -2 - k, []).append(cause)
        return [tuple(s) for s in out.values()]

    @property
    def faults(self) -> set[str]:
        """Ids of the faults that the audit is sure of."""
        return {cause for level, cause in self.audit if level == "fault"}

    @property
    def right(self) -> bool:
        """Whether what was hidden is named, and nothing else; a fault of the measurement may be named by the audit."""
        return self._matches(self.verdict == "named", self.sets)

    def _matches(self, named: bool, sets: Sequence[tuple[str, ...]]) -> bool:
        effects = [ids for _, ids in self.wanted]
        if not effects:
            return self.verdict == "consistent"
        heard = [ids for ids in effects if not set(ids) & self.faults]
        if not named and not (heard == [] and self.verdict == "consistent"):
            return False
        # What the audit is sure of may be named by the diagnosis as well.
        audited = {i for ids in effects if ids not in heard for i in ids}
        sets = [s for s in sets if not set(s) & audited]
        merged = _merged(heard, sets)
        if len(sets) != len(merged):
            return False
        return any(all(set(ids) & set(s) for ids, s in zip(merged, order, strict=True)) for order in permutations(sets))

    @property
    def covered(self) -> bool:
        """Whether the truth is named or among what remains open."""
        if self.right or not self.wanted:
            return self.right
        said = {c for c, _ in self.causes} | {c for s in self.alternatives for c in s} | self.faults
        return self.verdict in ("named", "ambiguous") and all(set(ids) & said for _, ids in self.wanted)

    @property
    def wrong(self) -> bool:
        """Whether something is named that was not hidden."""
        if self.verdict != "named":
            return False
        true = {i for _, ids in self.wanted for i in ids}
        return any(not set(s) & true for s in self.sets)

    @property
    def words(self) -> str:
        """What was said, in a few words."""
        if self.verdict == "named":
            return " + ".join("/".join(s) for s in self.sets) or "named: nothing"
        more = " (truth in the set)" if self.verdict == "ambiguous" and self.covered else ""
        more += f" (audit: {', '.join(sorted(self.faults))})" if self.faults else ""
        return {"consistent": "nothing"}.get(self.verdict, self.verdict.replace("_", " ")) + more

    @property
    def line(self) -> str:
        """One line for who follows the exam."""
        hidden = "+".join(f"{n} {s:.3g}" for n, s in self.sizes) or self.case.what
        mark = "" if self.right else "  WRONG" if self.case.part in ("null", "effect", "two") else ""
        return f"{self.case.family} {self.case.part} {self.case.seed} {hidden}: {self.words} {self.seconds:.0f} s{mark}"


def _merged(effects: Sequence[tuple[str, ...]], sets: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Effects of which one cause stands for several (sticking and sliding friction) count once where it was said so."""
    out = list(effects)
    while len(out) > len(sets):
        pair = next(
            ((a, b) for i, a in enumerate(out) for b in out[i + 1 :] if set(a) & set(b)),
            None,
        )
        if pair is None:
            break
        out.remove(pair[0])
        out.remove(pair[1])
        out.append(tuple(set(pair[0]) & set(pair[1])))
    return out


# --- Counting.


def interval(count: int, of: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % interval of a rate."""
    if of == 0:
        return 0.0, 1.0
    low = 0.0 if count == 0 else float(stats.beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(stats.beta.ppf(0.975, count + 1, of - count))
    return low, high


def upper(count: int, of: int) -> float:
    """Clopper and Pearson's 95 % upper bound of a rate."""
    return 1.0 if of == count else float(stats.beta.ppf(0.95, count + 1, of - count))


@dataclass(frozen=True)
class Score:
    """A target, what was measured, and whether it was met."""

    item: str
    target: str
    measured: str
    met: bool


def _share(item: str, answers: Sequence[Said], ok: Callable[[Said], bool], least: float) -> Score:
    count, of = sum(ok(a) for a in answers), len(answers)
    low, high = interval(count, of)
    text = f"{count} of {of}, {100 * low:.0f} to {100 * high:.0f} %"
    return Score(item, f">= {100 * least:.0f} %", text, of > 0 and count >= least * of)


def _rare(item: str, answers: Sequence[Said], bad: Callable[[Said], bool], most: float, bound: bool = False) -> Score:
    count, of = sum(bad(a) for a in answers), len(answers)
    low, high = interval(count, of)
    if bound:
        top = upper(count, of)
        # With fewer than 149 not even none would prove 2 %.
        few = " (too few to prove it)" if upper(0, of) > most else ""
        text = f"{count} of {of}, upper bound {100 * top:.1f} %{few}"
        return Score(item, f"upper bound <= {100 * most:g} %", text, of > 0 and top <= max(most, upper(0, of)))
    text = f"{count} of {of}, {100 * low:.0f} to {100 * high:.0f} %"
    return Score(item, f"<= {100 * most:g} %", text, of > 0 and count <= most * of)


def scores(answers: Sequence[Said]) -> list[Score]:
    """Hold answers against the targets."""
    by = {part: [a for a in answers if a.case.part == part] for part in PARTS}
    found: list[Score] = []
    if nulls := by["null"]:
        found.append(_rare("Healthy, not consistent", nulls, lambda a: a.verdict != "consistent", 0.02, True))
        found.append(_rare("Healthy, a cause named", nulls, lambda a: a.verdict in ("named", "ambiguous"), 0.02, True))
        loud = ("warning", "fault")
        found.append(_rare("Healthy, a warning of the audit", nulls, lambda a: any(x[0] in loud for x in a.audit), 0.0))
    if effects := by["effect"]:
        seen = [a for a in effects if a.detected or a.right]
        found.append(_share("Hidden effect detected", effects, lambda a: a.detected or a.right, 0.95))
        found.append(_share("Named right, given detection", seen, lambda a: a.right, 0.95))
        found.append(_share("Truth named or in the set", seen, lambda a: a.covered, 0.95))
        found.append(_rare("A wrong cause named", effects, lambda a: a.wrong, 0.02))
        gains = [a.gain_db for a in effects if a.right and a.gain_db is not None]
        if gains:
            middle = statistics.median(gains)
            found.append(Score("Held-out gain, median", ">= 6 dB", f"{middle:.1f} dB of {len(gains)}", middle >= 6.0))
        found += _estimates(effects)
    if by["two"]:
        found.append(_share("Both of two effects named", by["two"], lambda a: a.right, 0.80))
    if by["unknown"]:
        open_ = ("unknown", "insufficient_data")
        # An effect that goes unseen without its cause as with it is a matter of detection.
        found.append(_share("Unknown when left out", by["unknown"], lambda a: a.verdict in open_, 0.90))
    if by["outside"]:
        found.append(_rare("A cause named for what none explains", by["outside"], lambda a: a.verdict == "named", 0.10))
    asked = [*by["null"], *by["effect"], *by["two"]]
    if times := [a.seconds for a in asked if a.seconds > 0.0]:
        text = f"median {statistics.median(times):.0f} s, 95 % within {np.quantile(times, 0.95):.0f} s"
        text += f", longest {max(times):.0f} s of {len(times)}"
        found.append(Score("CPU time of a diagnosis", "<= 120 s (60 s on two cores)", text, max(times) <= 120.0))
        found.append(_rare("No answer, refused or crashed", asked, lambda a: a.verdict in NOTHING_SAID, 0.0))
    return found


def _estimates(effects: Sequence[Said]) -> list[Score]:
    held = []
    for a in effects:
        true = dict(a.truths)
        if a.right:
            held += [lo <= true[n] <= hi for n, _, lo, hi in a.estimates if lo is not None and hi is not None]
    if not held:
        return []
    low, high = interval(sum(held), len(held))
    text = f"{sum(held)} of {len(held)}, {100 * low:.0f} to {100 * high:.0f} %"
    return [Score("95 % interval holds the truth", "92 to 98 %", text, low <= 0.98 and high >= 0.92)]


# --- The page.

TITLES = {
    "modal": "Compliances against modes",
    "axis": "A feed axis at rest and in motion",
    "drive": "Records of a moving axis",
    "cutting": "Cutting forces",
    "limits": "Limits found by cutting",
    "machine": "A machine of three axes",
}


def page(answers: Sequence[Said], trial: bool = False, code: Callable[[str], str] = lambda family: "") -> str:
    """The table for the documentation; `code`: the state of the code of a family as it is."""
    families = [f for f in TITLES if any(a.case.family == f for a in answers)]
    lines = [f"{len(answers)} campaigns were sat" + (" (a trial: seeds that were looked at)" if trial else "") + "."]
    if older := sum(a.code != code(a.case.family) for a in answers):
        lines[0] += f" {older} of the answers were given by an earlier state of the code."
    if len(families) > 1:
        lines += ["", "### All families", "", *_table(answers)]
    for family in families:
        mine = [a for a in answers if a.case.family == family]
        counts = Counter(a.case.part for a in mine)
        sat = ", ".join(f"{part} {counts[part]}" for part in PARTS if counts[part])
        lines += ["", f"### {TITLES[family]}", "", f"Sat: {sat}.", "", *_table(mine), "", *_confusion(mine)]
        lines += _ladder(mine)
        wrong = [a for a in mine if a.case.part in ("null", "effect", "two") and not a.right]
        lines += ["", "Not right (what, seed: said): " + ("; ".join(map(_short, wrong[:40])) or "none") + "."]
    return "\n".join(lines) + "\n"


def _short(a: Said) -> str:
    return f"{a.case.what} {a.case.seed}: {a.words}"


def _table(answers: Sequence[Said]) -> list[str]:
    rows = [f"| {s.item} | {s.target} | {s.measured} | {_word(s)} |" for s in scores(answers)]
    return ["| item | target | measured | met |", "| --- | --- | --- | --- |", *rows]


def _word(score: Score) -> str:
    return "open" if "too few" in score.measured and score.met else "yes" if score.met else "no"


def _confusion(answers: Sequence[Said]) -> list[str]:
    lines = ["| hidden | size | costs | right is | said |", "| --- | --- | --- | --- | --- |"]
    for part, what in dict.fromkeys((a.case.part, a.case.what) for a in answers if a.case.part != "sizes"):
        mine = [a for a in answers if a.case.part == part and a.case.what == what]
        said = ", ".join(f"{word} {n}" for word, n in Counter(a.words for a in mine).most_common())
        name = what + {"unknown": ", its cause left out", "outside": " (no cause)"}.get(part, "")
        sizes = [abs(s) for a in mine for n, s in a.sizes if n == what]
        size = f"{min(sizes):.2g} to {max(sizes):.2g}" if sizes else ""
        costs = f"{100 * min(a.cost for a in mine):.0f} to {100 * max(a.cost for a in mine):.0f} %" if sizes else ""
        ids = "unknown" if part in ("unknown", "outside") else " + ".join("/".join(i) for _, i in mine[0].wanted)
        lines.append(f"| {name} | {size} | {costs} | {ids or 'nothing'} | {said} |")
    return lines


def _ladder(answers: Sequence[Said]) -> list[str]:
    rows = [a for a in answers if a.case.part == "sizes"]
    if not rows:
        return []
    lines = ["", "| hidden | size over that which must be found | sat | detected | named right |", "| --- " * 5 + "|"]
    for what, size in sorted({(a.case.what, a.case.size) for a in rows}):
        mine = [a for a in rows if (a.case.what, a.case.size) == (what, size)]
        seen, right = sum(a.detected for a in mine), sum(a.right for a in mine)
        lines.append(f"| {what} | {size:g} | {len(mine)} | {seen} | {right} |")
    return lines
