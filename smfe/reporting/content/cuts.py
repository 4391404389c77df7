"""Cutting tests in rows: what happened, what each source of lobes had said of it, and where the two disagree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.style import listed, number, spoken
from smfe.results import FAILED

_ORDER = ("chatter", "undecided", FAILED, "stable")
"""What the reader looks for comes first."""

RIGHT, WRONG = "✓", "✗"


@dataclass(frozen=True)
class Prediction:
    """What one source of lobes said of a cut: outcome, limit depth [mm], chatter frequency [Hz]; right or wrong."""

    source: str
    outcome: str
    limit: float
    frequency: float
    mark: str

    @property
    def said(self) -> str:
        """E.g. "stable", "chatter, 58.6 Hz"."""
        at = f", {number(self.frequency, 3)} Hz" if self.outcome == "chatter" and np.isfinite(self.frequency) else ""
        return f"{self.outcome}{at}"

    @property
    def depth(self) -> str:
        """E.g. "limit 3.93 mm", "" where none is known."""
        if np.isnan(self.limit):
            return ""
        return "no limit" if np.isinf(self.limit) else f"limit {number(self.limit, 3)} mm"


@dataclass(frozen=True)
class Cut:
    """One cutting test.

    Parameters
    ----------
    place : int
        Row of chatter.csv, from 0.
    file, verdict, observed, outcome, reason : str
        The criterion's verdict, what the engineer observed ("" when not said), what counts of the two, and why.
    speed, depth, frequency : float
        Spindle speed [rpm], depth of cut [mm], chatter frequency [Hz].
    where : str
        Controller and position, where they are said.
    notes : str
        What else the criterion noticed.
    predictions : tuple of Prediction
        One a source.
    """

    place: int
    file: str
    verdict: str
    observed: str
    outcome: str
    reason: str
    speed: float
    depth: float
    frequency: float
    where: str
    notes: str
    predictions: tuple[Prediction, ...]

    @property
    def disagrees(self) -> bool:
        """Whether the engineer observed something else than the criterion found."""
        return bool(self.observed) and self.verdict in ("stable", "chatter") and self.observed != self.verdict

    @property
    def title(self) -> str:
        """E.g. "700 rpm, 5 mm: chatter"."""
        return f"{number(self.speed)} rpm, {number(self.depth)} mm: {self.outcome}"


def cuts(chatter: pd.DataFrame | None) -> list[Cut]:
    """Return the cutting tests, chatter and undecided ones first, each group by speed and depth."""
    if chatter is None or chatter.empty:
        return []
    happened = outcomes(chatter)
    sources = [str(c).removeprefix("predicted_") for c in chatter.columns if str(c).startswith("predicted_")]
    found = [
        _cut(place, row, outcome, sources)
        for place, (row, outcome) in enumerate(zip(chatter.to_dict("records"), happened, strict=True))
    ]
    rank = {outcome: place for place, outcome in enumerate(_ORDER)}
    return sorted(found, key=lambda cut: (rank.get(cut.outcome, len(rank)), cut.speed, cut.depth, cut.place))


def _cut(place: int, row: dict[object, object], outcome: str, sources: Sequence[str]) -> Cut:
    said = [_text(row.get(key)) for key in ("controller", "position")]
    return Cut(
        place,
        _text(row["file"]),
        _text(row["verdict"]) or "undecided",
        _text(row.get("observed")),
        outcome,
        _text(row.get("reason")),
        _number(row["spindle_speed_rpm"]),
        _number(row["depth_of_cut_mm"]),
        _number(row.get("chatter_frequency_Hz")),
        ", ".join(text for text in said if text),
        _text(row.get("notes")),
        tuple(_prediction(row, source, outcome) for source in sources),
    )


def _prediction(row: dict[object, object], source: str, outcome: str) -> Prediction:
    predicted = _text(row[f"predicted_{source}"])
    mark = ""
    if {outcome, predicted} <= {"stable", "chatter"}:
        mark = RIGHT if outcome == predicted else WRONG
    limit, frequency = (_number(row.get(key)) for key in (f"limit_{source}_mm", f"frequency_{source}_Hz"))
    return Prediction(source, predicted, limit, frequency, mark)


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float | np.integer | np.floating) else float("nan")


def counted(found: Sequence[Cut]) -> str:
    """Return e.g. "6 cutting tests: 3 chatter, 1 undecided, 2 stable."."""
    counts = [(outcome, sum(cut.outcome == outcome for cut in found)) for outcome in _ORDER]
    parts = [f"{count} {outcome}" for outcome, count in counts if count]
    return f"{len(found)} cutting test{'s' if len(found) > 1 else ''}: {', '.join(parts)}."


def scores(found: Sequence[Cut]) -> list[str]:
    """Return a sentence a source: how many it predicted rightly, and which cuts that chattered it called stable."""
    out = []
    for source in dict.fromkeys(p.source for cut in found for p in cut.predictions):
        own = [(cut, p) for cut in found for p in cut.predictions if p.source == source and p.mark]
        if not own:
            continue
        right = sum(p.mark == RIGHT for _, p in own)
        text = f"{right} of {len(own)} predicted rightly"
        unsafe = [_short(cut) for cut, p in own if p.mark == WRONG and p.outcome == "stable"]
        timid = [_short(cut) for cut, p in own if p.mark == WRONG and p.outcome == "chatter"]
        if unsafe:
            text += f"; called stable, but chattered: {_few(unsafe)}"
        if timid:
            text += f"; called chatter, but stable: {_few(timid)}"
        out.append((spoken(source), f"{text}."))
    return [f"{source}: {text}" for source, text in out]


def _short(cut: Cut) -> str:
    return f"{number(cut.speed)} rpm with {number(cut.depth)} mm"


def _few(parts: Sequence[str], most: int = 4) -> str:
    return listed(parts) if len(parts) <= most else f"{', '.join(parts[:most])} and {len(parts) - most} more"
