"""Cutting tests: what happened, what had been predicted, and the spectrum of each."""

from __future__ import annotations

from typing import Any

import pandas as pd

from smfe.reporting.content import ranking
from smfe.reporting.content.cuts import counted, cuts, scores
from smfe.reporting.content.results import Results
from smfe.reporting.figures import figure_data, spectrograms
from smfe.reporting.figures.plotly_spectra import spectrum_figure
from smfe.reporting.sections.draft import Draft

_SAID = ("file", "spindle_speed_rpm", "depth_of_cut_mm", "verdict", "ratio", "chatter_frequency_Hz", "reason")
"""What a spectrum says of its test."""


def section(draft: Draft) -> dict[str, Any]:
    """Return the tests in rows, and put their spectra and spectrograms aside for whoever opens them.

    Nothing without a test.
    """
    results = draft.results
    found, failures = cuts(_table(results)), draft.failures("cutting_tests")
    if not found and not failures:
        return {}
    end = figure_data.common_end(list(results.spectra.values()))
    pictures = {}
    for position, (key, dataset) in enumerate(results.spectra.items()):
        # A test that failed has a row in chatter.csv and no spectrum; the number says which row is meant.
        number_of = key.rpartition("_")[2]
        place = int(number_of) - 1 if number_of.isdigit() else position
        pictures[place] = {"spectrum": f"plot-spectrum-{place + 1}", "spectrogram": ""}
        draft.plots[pictures[place]["spectrum"]] = spectrum_figure(dataset, end)
        if spectrograms.pictured([dataset]):
            pictures[place]["spectrogram"] = f"plot-spectrogram-{place + 1}"
            draft.plots[pictures[place]["spectrogram"]] = spectrograms.spectrogram_figure(dataset, end)
    return {
        "cuts": found,
        "counted": counted(found) if found else "",
        "scores": scores(found),
        "ranking": ranking.grid(results.ranking),
        "ranking_speeds": [] if results.ranking is None else ranking.speeds(results.ranking),
        "differences": ranking.sentences(results.differences),
        "in_cell": ranking.in_cell,
        "marks": [f"{ranking.MARKS[kind]} {words}" for kind, words in ranking.WORDS.items()],
        "sources": [p.source for p in found[0].predictions] if found else [],
        "observed": any(cut.observed for cut in found),
        "frequency": any(cut.frequency > 0.0 for cut in found),
        "where": any(cut.where for cut in found),
        "pictures": pictures,
        "threshold": any("threshold_amplitude" in dataset.attrs for dataset in results.spectra.values()),
        "outside": _outside(results),
        "disagree": [cut for cut in found if cut.disagrees],
        "failures": failures,
    }


def _table(results: Results) -> pd.DataFrame | None:
    """Return chatter.csv, without it what the spectra say of their tests."""
    if results.chatter is not None or not results.spectra:
        return results.chatter
    rows = [{key: s.attrs.get(key) for key in _SAID} for s in results.spectra.values()]
    return pd.DataFrame(rows, columns=list(_SAID))


def _outside(results: Results) -> int:
    """Return the number of cutting tests that stand on no diagram."""
    if results.chatter is None or not results.requests:
        return 0
    shown = [figure_data.tests_of(results.chatter, request) for request in results.requests]
    return len(results.chatter) - sum(len(t) for t in shown if t is not None)
