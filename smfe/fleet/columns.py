"""Columns of a catalogue, and how a row of it is written and read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow as pa

KINDS = {
    "campaign": "one a campaign: verdict done, faults or refused, in text why it was refused",
    "peak": "a peak of one entry of a compliance: frequency, damping, amplitude, each with its standard deviation",
    "limit": "a limit depth of one source of lobes: lowest and highest over the speeds, and what is recommended",
    "cutting_test": "a cutting test: verdict, what was observed, chatter frequency",
    "finding": "the verdict of a diagnosis",
    "suspicion": "what the check of the data found: level fault or warning, cause, where and the evidence in text",
    "warning": "what must be known of the results",
    "failure": "a part that failed, with its reason",
    "input": "a file that was read, with its sha256",
}
"""Kind of a row -> what it is."""

COLUMNS: dict[str, tuple[str, str]] = {
    "campaign": ("text", "name of its folder of results: unique, and the same in every run"),
    "title": ("text", "name that the campaign file gives"),
    "machine": ("text", "machine, as `[machine]` names it, else the title"),
    "tool": ("text", "tool, by its name, else by diameter and teeth"),
    "material": ("text", "work material"),
    "date": ("date", "when it was measured, as `started` says: the measurement's, else the first of the campaign"),
    "kind": ("text", "what the row is, see below"),
    "measurement": ("text", "measurement or model; of a failure what failed; of a suspicion where"),
    "method": ("text", "how it was measured; of limits the method of the lobes"),
    "controller": ("text", "controller setting"),
    "position": ("text", "posture of the machine"),
    "response": ("text", "axis that moves"),
    "excitation": ("text", "axis that is excited"),
    "peak": ("number", "number of the peak in its entry, from 1 at the lowest frequency"),
    "frequency_Hz": ("number", "natural frequency"),
    "frequency_std_Hz": ("number", "its standard deviation"),
    "damping": ("number", "damping ratio"),
    "damping_std": ("number", "its standard deviation"),
    "amplitude_um_per_N": ("number", "largest compliance of the peak"),
    "amplitude_std_um_per_N": ("number", "its standard deviation"),
    "lobes": ("text", "which lobes: lobes_1, ..."),
    "at": ("text", "of a limit: lowest, highest or recommended"),
    "spindle_speed_rpm": ("number", "spindle speed"),
    "depth_of_cut_mm": ("number", "depth of cut: of a cutting test, or recommended"),
    "limit_depth_mm": ("number", "limit depth"),
    "limit_depth_p05_mm": ("number", "its 5 % quantile"),
    "limit_depth_p95_mm": ("number", "its 95 % quantile"),
    "safe_depth_mm": ("number", "depth that is safe"),
    "chatter_frequency_Hz": ("number", "chatter frequency"),
    "ratio": ("number", "of a cutting test: chatter line over spindle order"),
    "verdict": ("text", "of a campaign, a cutting test, a diagnosis"),
    "observed": ("text", "what the engineer saw"),
    "level": ("text", "of a suspicion: fault or warning"),
    "cause": ("text", "of a suspicion its cause; of a failure what kind of part failed"),
    "file": ("text", "record"),
    "sha256": ("text", "hash of the file"),
    "text": ("text", "the sentence"),
}
"""Column -> what it holds (text, number, date), and what it is."""


def schema() -> pa.Schema:
    """Return the types of the columns for a Parquet file."""
    import pyarrow as pa

    of = {"text": pa.string(), "number": pa.float64(), "date": pa.date32()}
    return pa.schema([(name, of[kind]) for name, (kind, _) in COLUMNS.items()])


Row = dict[str, Any]
"""A row by its columns; what is missing is null."""
