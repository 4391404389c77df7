"""Cutting tests against what the lobes of each source had predicted."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd


@dataclass(frozen=True)
class Score:
    """Cutting tests against the lobes of one source.

    Parameters
    ----------
    right, of : int
        Tests predicted rightly, and tests with an outcome and a prediction.
    unsafe : int
        Predicted stable, but chattered.
    """

    right: int
    of: int
    unsafe: int


def outcomes(chatter: pd.DataFrame) -> pd.Series[str]:
    """Return what happened in each cutting test: what the engineer observed, else the criterion's verdict."""
    verdict = chatter["verdict"].fillna("undecided").astype(str)
    if "observed" not in chatter:
        return verdict
    observed = chatter["observed"].fillna("").astype(str)
    return verdict.where(observed == "", observed)


def score(chatter: pd.DataFrame | None, request: str, source: str) -> Score | None:
    """Count the cutting tests of a request that a source predicted rightly; undecided tests do not count."""
    column = f"predicted_{source}"
    if chatter is None or column not in chatter:
        return None
    happened, predicted = outcomes(chatter), chatter[column].astype(str)
    counted = happened.isin(["stable", "chatter"]) & predicted.isin(["stable", "chatter"])
    if "lobes" in chatter and request:
        counted &= chatter["lobes"].fillna("") == request
    if not counted.any():
        return None
    right = int((counted & (happened == predicted)).sum())
    unsafe = int((counted & (happened == "chatter") & (predicted == "stable")).sum())
    return Score(right, int(counted.sum()), unsafe)
