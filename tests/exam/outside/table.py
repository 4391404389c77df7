"""The table of the outside exams: what was asked beside what was measured.

``python -m exam.outside.table docs/outside_table.md``; `make outside` calls it. An exam whose records are absent keeps
what the page says of it, and says why it was not sat.
"""

import argparse
import re
from pathlib import Path

from exam.outside import bouc_wen, brake_reuss, f16
from exam.outside.places import AbsentError

EXAMS = {
    "Brake-Reuss beam": brake_reuss.rows,
    "F-16, lowest level": f16.rows,
    "Bouc-Wen oscillator": bouc_wen.rows,
}
"""Title -> rows and what else is said."""


def section(title, rows):
    """Return a section of the page."""
    table, said = rows()
    marks = {True: "yes", False: "no"}
    lines = [f"| {item} | {asked} | {measured} | {marks.get(met, '')} |" for item, asked, measured, met in table]
    head = ["| item | asked | measured | met |", "| --- | --- | --- | --- |"]
    return "\n".join([f"### {title}", "", *head, *lines, "", said]).strip() + "\n"


def page(before, wanted=tuple(EXAMS)):
    """Return the page with the exams that can be sat, the others as they were before."""
    kept = {m[1]: m[0].strip() + "\n" for m in re.finditer(r"^### (.*?)\n.*?(?=^### |\Z)", before, re.S | re.M)}
    out = []
    for title, rows in EXAMS.items():
        text = kept.get(title, "")
        if title in wanted:
            try:
                text = section(title, rows)
            except AbsentError as absent:
                print(f"{title}: not sat: {absent}")
        if text:
            out.append(text)
    return "\n".join(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("page", type=Path)
    parser.add_argument("--only", action="append", choices=list(EXAMS), help="sit this exam, repeatable; default: all")
    arguments = parser.parse_args()
    before = arguments.page.read_text(encoding="utf-8") if arguments.page.is_file() else ""
    arguments.page.write_text(page(before, tuple(arguments.only or EXAMS)), encoding="utf-8")
