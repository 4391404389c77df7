"""The report: one self-contained HTML file and PNG figures, made from the files of a result folder alone.

- `write_report`: write ``report.html`` and ``figures/*.png`` into a folder of results.
"""

from smfe.reporting.page import write_report

__all__ = ["write_report"]
