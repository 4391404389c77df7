"""The pages that remake the paper: every number of the column "ours" is checked against what the page computes.

A page of `docs/paper` holds one table ``| what | paper | ours | why different |``. Its last cell calls `check` with a
value, or several, for each row by the words of its first column, in the order in which the column "ours" shows them. A
number that is written with d decimals must be the computed one to half of the last of them. A row without a number is
checked against no number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

PAPER = Path(__file__).resolve().parents[1] / "paper"
COLUMNS = ("what", "paper", "ours", "why different")
NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?:e[-−]?\d+)?(?![\w.]*\d)")

Values = float | Sequence[float] | None


def rows(page: str) -> dict[str, tuple[str, str, str]]:
    """Return the rows of a page's table: what -> (paper, ours, why different).

    Parameters
    ----------
    page : str
        Text of the page.
    """
    out: dict[str, tuple[str, str, str]] = {}
    inside = False  # other tables of the page are its own
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if tuple(cells) == COLUMNS or not line.startswith("|"):
            inside = tuple(cells) == COLUMNS
            continue
        if not inside or len(cells) != len(COLUMNS) or set("".join(cells)) <= set("-: "):
            continue
        if cells[0] in out:
            raise ValueError(f"two rows are called {cells[0]!r}; a row is found by its first column")
        out[cells[0]] = (cells[1], cells[2], cells[3])
    return out


def numbers(cell: str) -> list[tuple[float, float]]:
    """Return the numbers of a cell, each with half a unit of its last digit; what stands in `code` is none."""
    out = []
    for text in NUMBER.findall(re.sub(r"`[^`]*`", "", cell)):
        plain = text.replace("−", "-")
        digits, _, power = plain.partition("e")
        decimals = len(digits.partition(".")[2])
        out.append((float(plain), 0.5 * 10.0 ** (int(power or 0) - decimals)))
    return out


def check(name: str, computed: Mapping[str, Values]) -> None:
    """Compare the table of a page with what it computes, and say how many numbers agree.

    Parameters
    ----------
    name : str
        Name of the page in `docs/paper`.
    computed : mapping
        What -> value or values of its column "ours"; None for a row without a number.

    Raises
    ------
    ValueError
        For a row that is missing or not computed, and for every number that differs: all are said at once.
    """
    table = rows((PAPER / f"{name}.md").read_text(encoding="utf-8"))
    wrong = [f"{what!r} is computed, but no row of the table" for what in computed if what not in table]
    wrong += [f"{what!r} is a row of the table, but not computed" for what in table if what not in computed]
    agreed = 0
    for what, (_, ours, _) in table.items():
        given = computed.get(what)
        values = [] if given is None else [float(v) for v in (given if isinstance(given, Sequence) else [given])]
        shown = numbers(ours)
        if what in computed and len(values) != len(shown):
            wrong.append(f"{what!r} shows {len(shown)} numbers ({ours}), and {len(values)} are computed: {values}")
            continue
        for value, (number, half) in zip(values, shown, strict=False):
            if not abs(value - number) <= 1.001 * half:
                wrong.append(f"{what!r} shows {number:g}, and {value:.6g} is computed")
            agreed += 1
    if wrong:
        raise ValueError(f"{name}.md: " + "; ".join(wrong))
    print(f"{len(table)} rows, {agreed} numbers: all as computed")
