"""What a data audit finds: a suspicion about the measurement, with its evidence and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

LEVELS = ("fault", "warning", "note")
"""A fault spoils a result unless what it concerns is left out or corrected; a warning may; a note is worth knowing."""


@dataclass(frozen=True)
class Suspect:
    """One suspicion.

    Parameters
    ----------
    cause : str
        Cause id (``"saturation"``, ``"double_hit"``, ``"unit_error"``, ...).
    level : {"fault", "warning", "note"}
        How much it matters.
    where : str
        Measurement, file, channel, hit.
    evidence : str
        What was seen, with numbers.
    advice : str
        What to do, or what was done.
    excludes : tuple of (str, str), optional
        Kind and name ("measurement", "hammer"; "cutting test", "cut.csv") of what a fault leaves out of a run.
    """

    cause: str
    level: str
    where: str
    evidence: str
    advice: str
    excludes: tuple[tuple[str, str], ...] = ()


def as_rows(suspects: Sequence[Suspect]) -> list[dict[str, str]]:
    """Return the suspicions for JSON, faults first."""
    return [
        {"cause": s.cause, "level": s.level, "where": s.where, "evidence": s.evidence, "advice": s.advice}
        for s in sorted(suspects, key=lambda s: LEVELS.index(s.level))
    ]


def suspect_table(suspects: Sequence[Suspect]) -> pd.DataFrame:
    """Return the suspicions as a table, faults first; channels of which the same is said share a row."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for s in sorted(suspects, key=lambda s: LEVELS.index(s.level)):
        record, _, channel = s.where.rpartition(", ")
        rows.setdefault((s.cause, s.level, record, s.evidence, s.advice), []).append(channel)
    table = [
        (cause, level, ", ".join([record, *channels] if record else channels), evidence, advice)
        for (cause, level, record, evidence, advice), channels in rows.items()
    ]
    return pd.DataFrame(table, columns=["cause", "level", "where", "evidence", "advice"])
