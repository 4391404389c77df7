"""The ranking of the methods: a grid of method and controller over spindle speed, and which differences count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from smfe.reporting.content.style import number

ALL = "all"
"""Controller of the rows that count all."""

MARKS = {"right": "✓", "falsely_stable": "▼", "falsely_unstable": "▲", "undecided": "?"}
"""What stands in a cell for a test."""

WORDS = {
    "right": "predicted rightly",
    "falsely_stable": "falsely stable (it chattered)",
    "falsely_unstable": "falsely unstable (it did not)",
    "undecided": "undecided test",
}


@dataclass(frozen=True)
class GridRow:
    """One method under one controller.

    Parameters
    ----------
    method, controller : str
        The controller is "" where none is stated.
    cells : tuple of mapping
        One a spindle speed: outcome -> number of tests; empty where none was predicted.
    share : str
        E.g. "24 of 24 (86 to 100 %)".
    """

    method: str
    controller: str
    cells: tuple[dict[str, int], ...]
    share: str


def speeds(ranking: pd.DataFrame) -> list[float]:
    """Return the spindle speeds [rpm] of a ranking, rising."""
    return sorted(float(v) for v in ranking["spindle_speed_rpm"].dropna().unique())


def grid(ranking: pd.DataFrame | None) -> list[GridRow]:
    """Return the rows of the picture, best method first; none where there is a single method: nothing is ranked."""
    if ranking is None or ranking["method"].nunique() < 2:
        return []
    across, out = speeds(ranking), []
    frame = ranking.assign(controller=ranking["controller"].fillna("").astype(str))
    for method, own in frame.groupby("method", sort=False):
        for controller in sorted(set(own["controller"]) - {ALL}):
            under = own[own["controller"] == controller]
            at = {float(r["spindle_speed_rpm"]): r for r in under.to_dict("records")}
            cells = tuple({k: int(at[v][k]) for k in MARKS if at[v][k]} if v in at else {} for v in across)
            whole = under[under["spindle_speed_rpm"].isna()]
            total = (whole if len(whole) else own[own["controller"] == ALL]).iloc[0]
            out.append(GridRow(str(method), controller, cells, _share(total)))
    return out


def _share(row: pd.Series) -> str:
    decided = int(row["right"] + row["falsely_stable"] + row["falsely_unstable"])
    if not decided:
        return "none decided"
    low, high = 100.0 * float(row["share_low"]), 100.0 * float(row["share_high"])
    return f"{int(row['right'])} of {decided} ({low:.0f} to {high:.0f} %)"


def sentences(differences: pd.DataFrame | None) -> list[str]:
    """Return which differences between the methods are more than chance, else how many tests would tell."""
    if differences is None or differences.empty:
        return []
    frame = differences.assign(controller=differences["controller"].fillna("").astype(str))
    overall = frame[frame["controller"] == ALL]
    counted = frame[frame["significant"].astype(str) == "True"]
    out = [_difference(row) for row in counted.to_dict("records")]
    if out:
        return out
    apart = overall[overall["only_a_right"] != overall["only_b_right"]]
    if apart.empty:
        return ["The methods predicted the same tests rightly: nothing ranks one above another."]
    nearest = apart.sort_values("p_value").to_dict("records")[0]
    # With b tests that only one method has right, the two-sided p-value is 2/2^b at least.
    needed = math.ceil(1.0 + math.log2(20.0 * max(len(overall), 1)))
    return [
        f"No difference between the methods is more than chance: {nearest['method_a']} has "
        f"{_tests(nearest['only_a_right'])} right that {nearest['method_b']} has not, "
        f"{nearest['only_b_right']} the other way round. At least {needed} tests that only one of them "
        "predicts rightly are needed to tell."
    ]


def _begun(name: str) -> str:
    """Return a name as a sentence begins; the rest of it, e.g. the name of a model, stays as it is written."""
    return name[:1].upper() + name[1:]


def _tests(count: object) -> str:
    return f"{count} test{'' if count == 1 else 's'}"


def _difference(row: dict[object, object]) -> str:
    under = f" under {row['controller']}" if row["controller"] not in (ALL, "") else ""
    p, alone, other = float(str(row["p_value_of_all"])), row["only_a_right"], row["only_b_right"]
    said = "p below 0.001" if p < 1e-3 else f"p = {number(p, 2)}"
    return (
        f"{_begun(str(row['method_a']))} predicts better than {row['method_b']}{under}, and not by chance: of "
        f"{row['tests']} tests it alone has {alone} right, the other alone {other} ({said})."
    )


def in_cell(cell: dict[str, int], marks: Sequence[str] = tuple(MARKS)) -> str:
    """Return the marks of a cell, e.g. "✓✓▼", counted where there are many: "✓ 12 ▼ 1"."""
    if sum(cell.values()) > 6:
        return " ".join(f"{MARKS[k]} {cell[k]}" for k in marks if k in cell)
    return "".join(MARKS[k] * cell[k] for k in marks if k in cell)
