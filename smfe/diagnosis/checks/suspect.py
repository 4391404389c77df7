"""What a check returns: a suspicion about the data, with its evidence and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd

LEVELS = ("fault", "warning", "note")
"""A fault spoils a result unless what it concerns is left out or corrected; a warning may; a note is worth knowing."""

Part = tuple[str, str]
"""Kind and name of what a record belongs to, as in `smfe.results.Failure`: ("measurement", "hammer")."""


@dataclass(frozen=True)
class Suspect:
    """One suspicion."""

    cause: str  # cause id (``"saturation"``, ``"double_hit"``, ``"unit_error"``, ...)
    level: str  # how much it matters: "fault" or "warning" or "note"
    where: str  # measurement, file, channel, hit
    evidence: str  # what was seen, with numbers
    advice: str  # what to do, or what was done
    excludes: tuple[Part, ...] = ()
    """Kind and name ("measurement", "hammer"; "cutting test", "cut.csv") of what a fault leaves out of a run."""


def _of_level(level: str, cause: str, where: str, evidence: str, advice: str, *excludes: Part) -> Suspect:
    return Suspect(cause, level, where, evidence, advice, excludes)


fault, warning, note = (partial(_of_level, level) for level in LEVELS)


def as_rows(suspects: Sequence[Suspect]) -> list[dict[str, str]]:
    """Return the suspicions for JSON, faults first."""
    return [
        {"cause": s.cause, "level": s.level, "where": s.where, "evidence": s.evidence, "advice": s.advice}
        for s in sorted(suspects, key=lambda s: LEVELS.index(s.level))
    ]


def suspect_table(suspects: Sequence[Suspect]) -> pd.DataFrame:
    """Return the suspicions as a table, faults first; channels with the same evidence and advice share a row."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for row in as_rows(suspects):
        record, _, channel = row["where"].rpartition(", ")
        rows.setdefault((row["cause"], row["level"], record, row["evidence"], row["advice"]), []).append(channel)
    table = [
        (cause, level, ", ".join([record, *channels] if record else channels), evidence, advice)
        for (cause, level, record, evidence, advice), channels in rows.items()
    ]
    return pd.DataFrame(table, columns=["cause", "level", "where", "evidence", "advice"])
