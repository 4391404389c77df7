"""Files that are read whole: refused in a sentence where the memory would not do, before the machine stands still."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from process.errors import InputError

ADVICE = "save it as HDF5, NetCDF, MAT 7.3, TDMS, Parquet or CSV, which are read in pieces, or in several shorter files"


def refuse_larger(path: Path, times: float, size: int | None = None) -> None:
    """Refuse a file that needs more memory than is free.

    Parameters
    ----------
    path : Path
        The file.
    times : float
        Peak of the memory that reading it needs, over its size (measured: docs/records.md).
    size : int, optional
        What is multiplied [bytes], where it is not that of the file: unpacked samples.

    Raises
    ------
    InputError
        When it does. Where the free memory is not known, nothing is refused.
    """
    held = path.stat().st_size if size is None else size
    need, free = times * held, available()
    if free is not None and need > free:
        raise InputError(
            f"{path.name}: a file of this format is read whole; {held / 1e9:.3g} GB need about {need / 1e9:.3g} GB of "
            f"memory and {free / 1e9:.3g} GB are free: {ADVICE}"
        )


def available() -> float | None:
    """Return the free memory [bytes]; None where the system does not say."""
    try:
        with Path("/proc/meminfo").open(encoding="ascii") as stream:
            free = next((line.split()[1] for line in stream if line.startswith("MemAvailable")), None)
        return None if free is None else 1024.0 * float(free)
    except OSError:
        pass
    if sys.platform == "win32":
        return _windows()
    try:  # all of it, where what is free is not told
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return None


def _windows() -> float | None:
    """Return ullAvailPhys of GlobalMemoryStatusEx: behind two numbers of 32 bits the second of seven of 64."""
    status = (ctypes.c_uint64 * 8)()
    ctypes.cast(status, ctypes.POINTER(ctypes.c_uint32))[0] = ctypes.sizeof(status)
    kernel = getattr(ctypes, "windll", None)
    if kernel is None or not kernel.kernel32.GlobalMemoryStatusEx(ctypes.byref(status)):
        return None
    return float(status[2])
