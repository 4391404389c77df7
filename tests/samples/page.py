"""What a page of the report holds, read back: figures, tables, text."""

from __future__ import annotations

import base64
import json
import re
from html import unescape
from typing import Any

import numpy as np

from smfe.reporting.figures.thinning import STEPS


def decoded(part: dict[str, Any]) -> np.ndarray:
    """Return the values of an array of 16 bits as arrays.js reads them."""
    codes = np.frombuffer(base64.b64decode(part["codes"]), dtype="<u2").astype(float)
    place, low, high = (codes - 1.0) / STEPS, part["low"], part["high"]
    values = low * (high / low) ** place if part["log"] else low + (high - low) * place
    return np.where(codes > 0.0, values, np.nan)


def plots(page: str) -> dict[str, Any]:
    """Return the figures of a page with their arrays in place."""
    found = re.search(r'<script type="application/json" id="plots">(.*?)</script>', page, flags=re.S)
    assert found is not None
    content = json.loads(found[1])

    def resolved(part: object) -> Any:
        if isinstance(part, list):
            return [resolved(value) for value in part]
        if not isinstance(part, dict):
            return part
        if isinstance(part.get("array"), int):
            return resolved(content["arrays"][part["array"]])
        return {key: resolved(value) for key, value in part.items()}

    return {name: resolved(figure) for name, figure in content["plots"].items()}


def late_tables(page: str) -> list[dict[str, Any]]:
    """Return the tables that a page makes when they are opened."""
    found = re.search(r'<script type="application/json" id="tables">(.*?)</script>', page, flags=re.S)
    assert found is not None
    return json.loads(found[1])


def section(page: str, name: str) -> str:
    """Return the text of a section as a person reads it, opened parts as well; "" without it."""
    found = re.search(rf'<section id="{name}".*?</section>', page, flags=re.S)
    return read(found[0]) if found else ""


def read(text: str) -> str:
    """Return HTML without its tags and scripts."""
    text = re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.S)
    text = re.sub(r"</?(strong|span|sub|small|code|a|button)\b[^>]*>", "", text)
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))).strip()
