"""What a library does on a damaged file, done on purpose: functions of a path for the process that reads files."""

import os
import time
from pathlib import Path

import numpy as np


def breaks_down(path: Path) -> None:
    os.abort()


def never_returns(path: Path) -> None:
    while True:
        time.sleep(1.0)


def asks_for_memory(path: Path) -> int:
    return int(np.ones(1 << 32).size)  # 32 GB


def unpacks(path: Path, size: int) -> np.ndarray:
    return np.zeros(size)


def writes_to_the_terminal(path: Path) -> str:
    print("warning: what a library prints is no answer")
    os.write(1, b'{"value": "nor is this", "arrays": []}\n')
    return "read"


def raises(path: Path) -> None:
    raise RuntimeError("an exception\nof two lines")


def counts(path: Path, last: int) -> object:
    return iter(range(last))


def several(path: Path) -> list:
    """Arrays of many kinds, some longer than a slot, some empty."""
    return [
        np.arange(300_001.0),
        np.zeros((0, 3)),
        np.arange(12, dtype=">i2").reshape(3, 4),
        np.full(400_000, 1 - 2j),
        np.array(["a", "bc"]),
        np.float32(1.5),
        {"notes": ("x", None, True), "n": 3},
    ]
