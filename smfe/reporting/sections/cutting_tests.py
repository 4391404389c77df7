"""Cutting tests: verdicts, spectra and spectrograms."""

from __future__ import annotations

from typing import Any

import pandas as pd

from smfe.reporting.content import tables
from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.results import Results
from smfe.reporting.figures import figure_data, spectrograms
from smfe.reporting.figures.plotly_spectra import spectrum_figure
from smfe.reporting.sections.draft import Draft
from smfe.results import FAILED

_NO_TEST: dict[str, Any] = {
    "file": "cutting test",
    "spindle_speed_rpm": float("nan"),
    "depth_of_cut_mm": float("nan"),
    "verdict": "undecided",
    "ratio": float("nan"),
    "chatter_frequency_Hz": float("nan"),
    "reason": "",
}


def section(draft: Draft) -> dict[str, Any]:
    """Return verdicts, spectra and spectrograms."""
    results, tests = draft.results, []
    end = figure_data.common_end(list(results.spectra.values()))
    for position, (key, dataset) in enumerate(results.spectra.items(), 1):
        name = f"plot-spectrum-{position}"
        draft.plots[name] = spectrum_figure(dataset, end)
        # A test that failed has a row in chatter.csv and no spectrum; the number says which row is meant.
        number_of = key.rpartition("_")[2]
        observed = _observed(results.chatter, int(number_of) - 1 if number_of.isdigit() else position - 1)
        picture = spectrograms.embedded(dataset, end) if spectrograms.pictured([dataset]) else ""
        tests.append({"plot": name, "picture": picture, "attrs": {**_NO_TEST, **dataset.attrs}, "observed": observed})
    found = []
    if results.chatter is not None:
        # Each reason stands below its spectrum.
        found = tables.cutting_tests(results.chatter.drop(columns="reason" if results.spectra else [], errors="ignore"))
    return {
        "tests": tests,
        "tables": found,
        "outside": _outside(results),
        "disagree": _disagreeing(results.chatter),
        "failures": draft.failures("cutting_tests"),
    }


def _observed(chatter: pd.DataFrame | None, row: int) -> str:
    """Return what the engineer observed in the test of a row of chatter.csv."""
    if chatter is None or "observed" not in chatter or row >= len(chatter):
        return ""
    value = chatter["observed"].iloc[row]
    return value if isinstance(value, str) else ""


def _outside(results: Results) -> int:
    """Return the number of cutting tests that stand on no diagram."""
    if results.chatter is None or not results.requests:
        return 0
    shown = [figure_data.tests_of(results.chatter, request) for request in results.requests]
    return len(results.chatter) - sum(len(t) for t in shown if t is not None)


def _disagreeing(chatter: pd.DataFrame | None) -> list[str]:
    """Return the files of tests in which the engineer observed something else than the criterion says."""
    if chatter is None:
        return []
    happened = outcomes(chatter)
    other = (happened != chatter["verdict"]) & ~chatter["verdict"].isin(["undecided", FAILED])
    return [str(f) for f in chatter["file"][other]]
