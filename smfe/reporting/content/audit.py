"""What was measured, how, and what the audit of the records says of it; what was left out, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from smfe.reporting.content.merging import Said, merged, sentence
from smfe.reporting.content.results import Measurement, Results
from smfe.reporting.content.style import METHODS, listed, number, spoken
from smfe.reporting.content.tables import conditions_text, true
from smfe.results import MEASUREMENT


@dataclass(frozen=True)
class Row:
    """One measurement.

    Parameters
    ----------
    name : str
        As in the campaign file.
    method, conditions, band, entries, used : str
        In words; "–" where it does not apply.
    coherence : float
        Median of all entries and frequencies [1], NaN where none is known.
    failed : bool
        Whether it gave no result.
    said : tuple of str
        Warnings that concern it alone.
    """

    name: str
    method: str
    conditions: str
    band: str
    entries: str
    used: str
    coherence: float
    failed: bool
    said: tuple[str, ...]


@dataclass(frozen=True)
class Audit:
    """Everything that is said of the records.

    Parameters
    ----------
    rows : tuple of Row
        One a measurement.
    left_out : tuple of str
        What was left out, and why.
    shared : tuple of Said
        Warnings that several measurements have in common.
    said : tuple of Said
        All warnings: of measurements, lobes, cutting tests, the campaign.
    notes : tuple of Said
        What the audit noticed besides, worth knowing.
    made : bool
        Whether the records were audited.
    """

    rows: tuple[Row, ...]
    left_out: tuple[str, ...]
    shared: tuple[Said, ...]
    said: tuple[Said, ...]
    notes: tuple[Said, ...]
    made: bool


def audit(results: Results) -> Audit:
    """Return what was measured and what is said of it."""
    settings = results.provenance.get("settings", {})
    settings = settings if isinstance(settings, dict) else {}
    measured = {m.name: m for m in results.measurements if not m.is_model}
    failed = {f.name: f.reason for f in results.failures if f.part == MEASUREMENT}
    names = list(dict.fromkeys([*measured, *settings, *failed]))
    pairs = [_placed(where, text, names) for where, text in results.warnings]
    own = merged([(where, text) for where, text in pairs if where in names])
    alone: dict[str, list[str]] = {}
    for said in own:
        if len(said.where) == 1:
            alone.setdefault(said.where[0], []).append(said.whole)
    check = results.provenance.get("check")
    found = [r for r in check if isinstance(r, dict)] if isinstance(check, list) else []
    noted = [(str(r.get("where", "")), f"{r.get('evidence', '')}; {r.get('advice', '')}") for r in found if _is_note(r)]
    rows = [_row(n, measured.get(n), settings.get(n, {}), results.tables, n in failed, alone.get(n, ())) for n in names]
    return Audit(
        tuple(rows),
        (*_excluded(failed), *_rejected(results.tables)),
        tuple(said for said in own if len(said.where) > 1),
        tuple(merged(pairs)),
        tuple(merged(_placed("", f"{where}: {text}", names) for where, text in noted)),
        isinstance(check, list),
    )


def _is_note(row: Mapping[str, object]) -> bool:
    return row.get("level") == "note"


def _placed(where: str, text: str, names: Sequence[str]) -> tuple[str, str]:
    """Return a warning with the measurement that it names at its beginning."""
    if not where:
        for name in sorted(names, key=len, reverse=True):
            for mark in (": ", ", "):
                if text.startswith(f"{name}{mark}"):
                    return name, text[len(name) + len(mark) :]
    return where, text


def _row(
    name: str,
    m: Measurement | None,
    setting: object,
    tables: Mapping[tuple[str, str], pd.DataFrame],
    failed: bool,
    said: Sequence[str],
) -> Row:
    stated = setting if isinstance(setting, dict) else {}
    method = str(m.method if m is not None else stated.get("method", ""))
    base = (name, METHODS.get(method, spoken(method)) or "–")
    if m is None:
        return Row(*base, "–", "–", "–", "–", float("nan"), failed, tuple(said))
    claimed = m.frequency[m.claimed()]
    coherence = [v[np.isfinite(v)] for r in "xyz" for _, v in m.coherences(r)]
    return Row(
        *base,
        conditions_text(m.conditions) or "–",
        f"{number(claimed[0], 3)} to {number(claimed[-1], 3)}" if claimed.size else "–",
        _entries_text(m),
        _used(name, tables),
        float(np.median(np.concatenate(coherence))) if coherence else float("nan"),
        failed,
        tuple(said),
    )


def _entries_text(m: Measurement) -> str:
    names = [r + e for r, e in m.entries]
    if len(names) > 3 and len(names) == m.data.sizes["response"] * m.data.sizes["excitation"]:
        return f"all {len(names)}"
    return " ".join(names) or "none"


def _used(name: str, tables: Mapping[tuple[str, str], pd.DataFrame]) -> str:
    """Return "15 of 15 hits", "3 passes"."""
    parts = []
    for (own, kind), frame in tables.items():
        if own == name and kind in ("hits", "steps", "passes"):
            count = len(frame)
            used = int(sum(true(v) for v in frame["used"])) if "used" in frame else None
            word = kind if count != 1 else kind.removesuffix("es" if kind == "passes" else "s")
            parts.append(f"{count} {word}" if used is None else f"{used} of {count} {word}")
    return ", ".join(parts) or "–"


def _excluded(failed: Mapping[str, str]) -> list[str]:
    """Return what failed, measurements of the same reason together."""
    reasons: dict[str, list[str]] = {}
    for name, reason in failed.items():
        reasons.setdefault(reason, []).append(name)
    return [f"{listed(map(spoken, names))} was left out: {sentence(reason)}" for reason, names in reasons.items()]


def _rejected(tables: Mapping[tuple[str, str], pd.DataFrame]) -> list[str]:
    """Return how many hits, steps and passes were not used, and why."""
    out = []
    for (name, kind), frame in tables.items():
        if "used" not in frame:
            continue
        gone = frame[[not true(v) for v in frame["used"]]]
        if gone.empty:
            continue
        reasons = Counter(str(r) for r in gone["reason"] if isinstance(r, str)) if "reason" in gone else Counter()
        why = ", ".join(f"{reason} ({count})" if count > 1 else reason for reason, count in reasons.most_common(4))
        rest = f", and {len(reasons) - 4} other reasons" if len(reasons) > 4 else ""
        verb = "was" if len(gone) == 1 else "were"
        said = f": {why}{rest}" if why else ""
        out.append(f"{len(gone)} of {len(frame)} {kind} of {spoken(name)} {verb} left out{said}.")
    return out
