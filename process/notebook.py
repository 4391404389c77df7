"""Small tables that a notebook shows of an object: name, value, unit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def html_table(
    title: str, rows: Iterable[Sequence[object]], head: Sequence[str] = (), notes: Iterable[str] = ()
) -> str:
    """Return a table as HTML, for ``_repr_html_``.

    Parameters
    ----------
    title : str
        What the object is, with its name.
    rows : iterable of sequences
        Texts, or numbers that are shown with six digits; the first entry of each heads its row.
    head : sequence of str, optional
        Heads of the columns.
    notes : iterable of str, optional
        Sentences below the table.
    """
    lines = ["<table>", f"<caption><strong>{escape(title)}</strong></caption>"]
    if head:
        heads = "".join(f'<th scope="col">{escape(h)}</th>' for h in head)
        lines.append(f"<thead><tr>{heads}</tr></thead>")
    lines.append("<tbody>")
    for first, *rest in rows:
        cells = "".join(f"<td>{_cell(value)}</td>" for value in rest)
        lines.append(f'<tr><th scope="row">{_cell(first)}</th>{cells}</tr>')
    said = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return "\n".join([*lines, "</tbody>", "</table>"]) + said


def _cell(value: object) -> str:
    return escape(f"{value:.6g}" if isinstance(value, float) else str(value))
