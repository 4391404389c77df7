"""Check of records that are the same data under two names: a file copied, or named twice in the campaign file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import xarray as xr

from process.labels import RECORD_VECTORS, axis_present
from smfe.diagnosis.checks.suspect import Part, Suspect, fault, warning


@dataclass(frozen=True)
class Seen:
    """One record, and what it is said to be."""

    part: Part  # what it belongs to
    file: str  # where it was read
    said: tuple[object, ...]  # what the campaign says of it: conditions, axis, cut
    digest: str  # the same for the same samples


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
    if "sound" in record:  # the cut that a phone has recorded holds nothing else
        digest.update(b"sound" + record["sound"].values.astype("float32").tobytes())
    return Seen(part, str(record.attrs.get("source", "record")), tuple(map(repr, said)), digest.hexdigest())


def same_suspects(records: Sequence[Seen]) -> Iterator[Suspect]:
    """Yield a fault for each group of records that are the same data and are said to be different things.

    One file in two measurements under the same conditions is a comparison of methods; of two files with the same
    samples the agreement proves nothing, and a warning says so. What only one of them states contradicts nothing.
    """
    groups: dict[str, list[Seen]] = {}
    for record in records:
        groups.setdefault(record.digest, []).append(record)
    for group in groups.values():
        parts, files = list(dict.fromkeys(r.part for r in group)), {r.file for r in group}
        twice = len(parts) < len(group)
        stated = [[r.said for r in group if r.part[0] == kind] for kind in {p[0] for p in parts}]
        # Two values of the same thing; `None` states nothing.
        differ = any(len(set(values) - {repr(None)}) > 1 for said in stated for values in zip(*said, strict=True))
        if len(group) < 2 or not (twice or differ or len(files) > 1):
            continue
        evidence = f"{group[0].file} is named {len(group)} times"
        if len(files) > 1 or len(parts) > 1:
            evidence = " and ".join(dict.fromkeys(f"{r.part[1]} ({r.file})" for r in group)) + " hold the same samples"
        what = "are different things" if differ else "count as if they were independent"
        said = "which the campaign says" if differ else "which"
        excludes = parts if twice or differ else []
        yield (fault if excludes else warning)(
            "same_data",
            " and ".join(dict.fromkeys(name for _, name in parts)),
            f"{evidence}, {said} {what}",
            "name the right file, or take one of them out",
            *excludes,
        )
