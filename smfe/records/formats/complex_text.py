"""Complex numbers as programs write them in text: ``1.2e-6-3e-7j``, ``1.2e-6 - 3e-7i``, ``(1,2e-6-3e-7j)``, ``NaN``."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from process.types import Complex

_PART = r"(?:\d+\.?\d*(?:[eEdD][+-]?\d+)?|\.\d+(?:[eEdD][+-]?\d+)?|nan|inf)"
_BOTH = re.compile(
    rf"\(?\s*([+-]?{_PART})\s*([+-])\s*\*?\s*(?:[ij]\s*\*?\s*({_PART})|({_PART})\s*\*?\s*[ij])\s*\)?", re.I
)
_IMAGINARY = re.compile(rf"\(?\s*([+-]?{_PART})\s*\*?\s*[ij]\s*\)?", re.I)


def complex_of(field: str, decimal: str = ".") -> complex | None:
    """Return the complex number that a text is; None where it is none, or a real one.

    Parameters
    ----------
    field : str
        The text.
    decimal : {".", ","}, optional
        Sign of the decimals.
    """
    text = field.strip()
    if not text or (text[-1] not in "ijIJ)" and not re.search(r"[ij]\s*\*?\s*\d", text, re.I)):
        return None
    if decimal == ",":
        if "." in text:
            return None
        text = text.replace(",", ".")
    if found := _BOTH.fullmatch(text):
        real, sign, first, second = found.groups()
        return complex(_number(real), (-1.0 if sign == "-" else 1.0) * _number(first or second))
    if found := _IMAGINARY.fullmatch(text):
        return complex(0.0, _number(found.group(1)))
    return None


def _number(text: str) -> float:
    return float(text.lower().replace("d", "e"))


def complex_column(fields: Iterable[object], decimal: str) -> tuple[Complex, int | None]:
    """Return a column of texts as complex numbers, NaN where a field is empty, and the first row that is no number.

    Parameters
    ----------
    fields : iterable
        Texts; what is no text (an empty field) is NaN.
    decimal : {".", ","}
        Sign of the decimals.
    """
    out, wrong = [], None
    for row, field in enumerate(fields):
        if not isinstance(field, str) or not field.strip():
            out.append(complex(np.nan, np.nan))
            continue
        number = complex_of(field, decimal)
        if number is None:
            try:
                number = complex(float(field.replace(",", ".") if decimal == "," else field))
            except ValueError:
                wrong = row if wrong is None else wrong
                number = complex(np.nan, np.nan)
        out.append(number)
    return np.array(out, dtype=np.complex128), wrong
