"""Plain values as TOML, for the campaign file that a scenario writes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date
from typing import Any


def inline(value: Any) -> str:
    """Return a value as it stands behind ``key =``: texts, numbers, truth values, lists, tables in one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date):  # a datetime is one, too
        return value.isoformat()
    # A TOML basic string escapes as JSON does.
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def table(head: str, values: Mapping[str, Any]) -> str:
    """Return a table under its head, ``[tool]`` or ``[[measurement]]``; lists of tables take a line an entry."""
    lines = [head]
    for key, value in values.items():
        if isinstance(value, list) and value and isinstance(value[0], Mapping):
            lines += [f"{_key(key)} = [", *(f"    {inline(entry)}," for entry in value), "]"]
        else:
            lines.append(f"{_key(key)} = {inline(value)}")
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    plain = name.replace("_", "").replace("-", "")
    return name if plain.isascii() and plain.isalnum() else json.dumps(name, ensure_ascii=False)


def document(tables: Mapping[str, Any]) -> str:
    """Return a whole file: each table under its head, lists of tables one by one."""
    parts = []
    for name, value in tables.items():
        if isinstance(value, Mapping):
            parts.append(table(f"[{_key(name)}]", value))
        elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            parts += [table(f"[[{_key(name)}]]", v) for v in value]
    return "\n".join(parts)
