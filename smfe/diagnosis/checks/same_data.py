"""Audit of records that are the same data under two names: a file copied, or named twice in the campaign file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import xarray as xr

from process.labels import RECORD_VECTORS, axis_present
from smfe.diagnosis.checks.suspect import Suspect

Part = tuple[str, str]
"""Kind and name of what a record belongs to, as in `smfe.results.Failure`."""


@dataclass(frozen=True)
class Seen:
    """One record, and what it is said to be.

    Parameters
    ----------
    part : (str, str)
        What it belongs to.
    file : str
        Where it was read.
    said : tuple
        What the campaign says of it: conditions, axis, cut.
    digest : str
        The same for the same samples.
    """

    part: Part
    file: str
    said: tuple[object, ...]
    digest: str


def seen(record: xr.Dataset, part: Part, said: Iterable[object], excitation: str | None = None) -> Seen:
    """Return the fingerprint of a record; of a hammer or actuator record the force along its excitation counts.

    One file with the forces of all axes is a legitimate record of each; a response alone may rest.
    """
    digest = hashlib.sha256()
    for name in RECORD_VECTORS:
        for axis in axis_present(record, name) if name in record else ():
            if excitation is None or name != "force" or axis == excitation:
                digest.update(f"{name}_{axis}".encode() if excitation is None else name.encode())
                digest.update(record[name].sel(axis=axis).values.astype("float32").tobytes())
    return Seen(part, str(record.attrs.get("source", "record")), tuple(map(repr, said)), digest.hexdigest())


def same_suspects(records: Sequence[Seen]) -> list[Suspect]:
    """Return a fault for each group of records that are the same data and are said to be different things.

    One file in two measurements under the same conditions is a comparison of methods; of two files with the same
    samples the agreement proves nothing, and a warning says so. What only one of them states contradicts nothing.
    """
    groups: dict[str, list[Seen]] = {}
    for record in records:
        groups.setdefault(record.digest, []).append(record)
    out = []
    for group in groups.values():
        parts = list(dict.fromkeys(r.part for r in group))
        twice = len(parts) < len(group)
        differ = _contradict(group)
        copies = len({r.file for r in group}) > 1
        if len(group) < 2 or not (twice or differ or copies):
            continue
        fault = twice or differ
        told = " and ".join(dict.fromkeys(f"{name} ({r.file})" for r in group for _, name in [r.part]))
        what = "which the campaign says are different things" if differ else "which count as if they were independent"
        out.append(
            Suspect(
                "same_data",
                "fault" if fault else "warning",
                " and ".join(dict.fromkeys(name for _, name in parts)),
                f"{told} hold the same samples, {what}" if len({r.file for r in group}) > 1 or len(parts) > 1
                else f"{group[0].file} is named {len(group)} times, {what}",
                "name the right file, or take one of them out",
                excludes=tuple(parts) if fault else (),
            )
        )  # fmt: skip
    return out


def _contradict(group: Sequence[Seen]) -> bool:
    """Whether two of a group state different values of the same thing; `None` states nothing."""
    for kind in {r.part[0] for r in group}:
        said = [r.said for r in group if r.part[0] == kind]
        if any(len(set(values) - {repr(None)}) > 1 for values in zip(*said, strict=True)):
            return True
    return False
