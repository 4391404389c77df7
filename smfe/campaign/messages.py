"""From what pydantic found to sentences: where, what was given, what is needed, what to do."""

from __future__ import annotations

import types
import typing
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from smfe.campaign.checks import Complaint, Loc
from smfe.campaign.schema import CampaignFile
from smfe.records.formats.channels import did_you_mean


def complaints(error: ValidationError, root: type[BaseModel] = CampaignFile) -> list[Complaint]:
    """Return every error of the validation of a file whose tables begin at `root`, as (place, sentence)."""
    return [complaint(details, root) for details in error.errors()]


def complaint(details: ErrorDetails, root: type[BaseModel]) -> Complaint:
    """Return one error as (place, sentence)."""
    # A key of a table that is itself wrong is marked by pydantic with "[key]" behind it.
    where: Loc = tuple(part for part in details["loc"] if part != "[key]")
    cause = details.get("ctx", {}).get("error")
    if cause is not None:
        return where, str(cause)
    if details["type"] == "extra_forbidden":
        known = keys_at(where[:-1], root)
        near = did_you_mean(str(where[-1]), known)
        return where, f"this key is not known{near}; known here: {', '.join(sorted(known))}"
    if details["type"] == "missing":
        return where, "is missing; add it"
    message = details["msg"].replace("Input should be", "must be")
    shown = repr(details["input"])
    return where, f"{shown if len(shown) < 60 else shown[:57] + '...'}: {message}"


def keys_at(where: Loc, root: type[BaseModel] = CampaignFile) -> list[str]:
    """Return the keys that the table at a place of the file may have."""
    annotation: Any = root
    for part in where:
        annotation = _below(_table(annotation), part)
    table = _table(annotation)
    if not (isinstance(table, type) and issubclass(table, BaseModel)):
        return []
    return [field.alias or name for name, field in table.model_fields.items()]


def _below(annotation: Any, part: str | int) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        # A key that is a word of Python ("from", "with") is a field of another name.
        return next(
            field.annotation for name, field in annotation.model_fields.items() if (field.alias or name) == part
        )
    arguments = typing.get_args(annotation)
    return arguments[-1] if typing.get_origin(annotation) is dict else arguments[0]


def _table(annotation: Any) -> Any:
    """Strip ``Annotated`` and ``| None``."""
    while True:
        origin = typing.get_origin(annotation)
        if origin is typing.Annotated or origin in (types.UnionType, typing.Union):
            annotation = typing.get_args(annotation)[0]
        else:
            return annotation
