"""Draw figures of a folder of results again, without the page: ``figure.py RESULTS [NAME]``."""

import sys
from pathlib import Path

from smfe.reporting.content.results import read_results
from smfe.reporting.content.style import palette
from smfe.reporting.figures.draw_matplotlib import pictures, save

if __name__ == "__main__":
    folder, wanted = Path(sys.argv[1]), (sys.argv[2:] or [""])[0]
    results = read_results(folder)
    found = {name: draw for name, draw in pictures(results, palette(results)).items() if name.startswith(wanted)}
    for name, draw in found.items():
        print(save(draw(), folder / "figures" / name))
    if not found:
        sys.exit(f"no figure of {folder} begins with '{wanted}'")
