"""What a reader may do with a file that is damaged: give a record that is one, or refuse it in one sentence."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.records import Channel, read_records


def fault_of_record(record: xr.Dataset) -> str:
    """Return what makes a record none: nothing in it, a clock that stands still, values that are no numbers."""
    if not record.sizes.get("time") or not record.data_vars:
        return f"no samples: {dict(record.sizes)}"
    time = record["time"].values.astype(float)
    if not (np.isfinite(time).all() and (np.diff(time) > 0.0).all()):
        return "the time does not rise"
    broken = [str(name) for name, value in record.items() if not np.isfinite(value.values.astype(float)).all()]
    return f"no finite numbers: {', '.join(broken)}" if broken else ""


def fault_of_refusal(text: str, path: Path) -> str:
    """Return what makes a refusal none: no name of the file in it, or more than a line."""
    if path.name not in text:
        return f"the file is not named: {text}"
    return f"more than a line: {text}" if "\n" in text else ""


def fault_of_reading(path: Path, channels: Mapping[str, Channel]) -> str:
    """Return what is wrong with what comes out of reading a file, "" for a record or a refusal as they should be."""
    try:
        records = read_records(path, dict(channels))
    except InputError as error:
        return fault_of_refusal(str(error), path)
    except Exception as error:  # a traceback of any kind is the fault that is looked for
        return f"{type(error).__name__}: {error}"
    if not records:
        return "no record"
    return next((fault for record in records if (fault := fault_of_record(record))), "")
