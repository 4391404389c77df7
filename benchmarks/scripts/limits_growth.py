"""How the cost of stability limits grows with modes, teeth, speeds and frequencies: prints a table of docs/growth.md.

Warm CPU seconds, the least of three runs: 200 speeds from 5000 to 25,000 rpm, down milling at half immersion with two
teeth, two modes of 2 % damping between 300 and 3000 Hz in directions of their own, limits to 0.1 %; one of these is
varied at a time. Lines are those of a measured compliance, from 100 to 4000 Hz; a model has none.
"""

import math
import time
from collections.abc import Callable, Iterator

import numpy as np

from process import CuttingCoefficients, MillingCut, ModalModel, Spindle, Tool, engagement, simulate_milling
from stability import multi_frequency, semi_discretization, zero_order

MATERIAL = CuttingCoefficients(6e8, 2e8, 0.0)
ARC = engagement("down", 5e-3, 10e-3)
MODES, TEETH, SPEEDS, LINES = 2, 2, 200, 10_000


def machine(modes: int) -> ModalModel:
    """Return modes between 300 and 3000 Hz in directions of their own."""
    turned = np.arange(modes)
    return ModalModel(
        np.geomspace(300.0, 3000.0, modes + 2)[1:-1],
        np.full(modes, 0.02),
        np.full(modes, 2e7),
        np.stack([np.cos(turned), np.sin(turned), np.zeros(modes)], axis=1),
    )


def zero(modes: int, teeth: int, speeds: int, lines: int) -> Callable[[], object]:
    """Zero order, of a compliance at lines."""
    compliance = machine(modes).compliance(np.linspace(100.0, 4000.0, lines))
    at = np.linspace(5000.0, 25000.0, speeds)
    return lambda: zero_order(compliance, Tool(10e-3, teeth), ARC, MATERIAL, at)


def multi(modes: int, teeth: int, speeds: int, lines: int) -> Callable[[], object]:
    """Multi-frequency, of the model."""
    at = np.linspace(5000.0, 25000.0, speeds)
    return lambda: multi_frequency(machine(modes), Tool(10e-3, teeth), ARC, MATERIAL, at, tolerance=1e-3)


def semi(modes: int, teeth: int, speeds: int, lines: int) -> Callable[[], object]:
    """Semi-discretisation, of the model."""
    at = np.linspace(5000.0, 25000.0, speeds)
    return lambda: semi_discretization(machine(modes), Tool(10e-3, teeth), ARC, MATERIAL, at, tolerance=1e-3)


def milling(modes: int, teeth: int, speeds: int, lines: int) -> Callable[[], object]:
    """One cut in time: 2 s at 6000 rpm, 20,000 steps a second."""
    cut = MillingCut(Tool(10e-3, teeth), ARC, MATERIAL, 1e-4, feed_per_tooth=5e-5)
    return lambda: simulate_milling(machine(modes), cut, Spindle(100.0), 2.0, 20e3)


def seconds(call: Callable[[], object]) -> float:
    """Return the least CPU seconds of three calls after one that warms up."""
    call()
    spent = []
    for _ in range(3):
        start = time.process_time()
        call()
        spent.append(time.process_time() - start)
    return min(spent)


def rows() -> Iterator[tuple[str, str, list[int], list[float]]]:
    """Yield what is computed, what grows, its sizes and the CPU seconds of each."""
    each = {"modes": [1, 2, 4, 8, 16], "teeth": [1, 2, 4, 8], "speeds": [50, 200, 800], "lines": [2500, 10_000, 40_000]}
    none = {"multi-frequency": ("lines",), "semi-discretisation": ("lines",), "milling in time": ("lines", "speeds")}
    methods = {"zero order": zero, "multi-frequency": multi, "semi-discretisation": semi, "milling in time": milling}
    base = {"modes": MODES, "teeth": TEETH, "speeds": SPEEDS, "lines": LINES}
    for name, method in methods.items():
        for grows, sizes in each.items():
            if grows not in none.get(name, ()):
                yield name, grows, sizes, [seconds(method(**(base | {grows: n}))) for n in sizes]


def main() -> None:
    """Print the table."""
    print("| method | what grows | sizes | CPU seconds | exponent |\n" + "| --- " * 5 + "|")
    for name, grows, sizes, spent in rows():
        power = math.log(spent[-1] / spent[0]) / math.log(sizes[-1] / sizes[0])
        shown = ", ".join(f"{s:.2g}" for s in spent)
        print(f"| {name} | {grows} | {', '.join(f'{n:,}' for n in sizes)} | {shown} | {power:.2f} |", flush=True)


if __name__ == "__main__":
    main()
