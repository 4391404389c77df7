"""Half-sentences for messages about names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'column'?)"`` for a name near a known one, else nothing."""
    choices = list(known)
    near = difflib.get_close_matches(name, choices, n=1, cutoff=0.6)
    if not near:
        lower = {choice.lower(): choice for choice in choices}
        near = [lower[key] for key in difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.6)]
    return f" (did you mean '{near[0]}'?)" if near else ""


def listed(names: Iterable[object], most: int = 30) -> str:
    """Return names in quotes with commas between, shortened when there are many."""
    quoted = [f"'{name}'" for name in names]
    more = f", and {len(quoted) - most} more" if len(quoted) > most else ""
    return (", ".join(quoted[:most]) + more) or "none"
