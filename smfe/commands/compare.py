"""`smfe compare`: the measurements of a compliance file beside each other, peak by peak, and beside declared models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.labels import AXES, full_matrix, make_compliance, not_measured
from smfe.arrays.compliances import Compliance, compliances_of
from smfe.campaign import Model
from smfe.comparison.compare import compare as compare_compliances
from smfe.comparison.explained import explain
from smfe.comparison.peaks import Peaks, all_peaks
from smfe.identification.errors.result import Identification
from smfe.results import (
    read_groups,
    write_csv,
)


def compare(
    frf: Path | str | Mapping[str, Compliance] | Sequence[Identification], output: Path | str | None = None
) -> pd.DataFrame:
    """Compare the measurements of a compliance file, or compliances in memory, peak by peak.

    Beside it, `explained.csv` says what feed, level, controller and method explain of the differences. Of a sweep at
    several depths of cut these are compared, and not the estimate of all its passes together.

    Parameters
    ----------
    frf : path, mapping of str to (xarray.Dataset or Identification), or sequence of Identification
        Compliance file, or the compliances by name.
    output : path, optional
        CSV file. None: nothing is written.

    Returns
    -------
    pandas.DataFrame
        A row for each peak of each entry and pair of measurements; columns end in their unit.

    Raises
    ------
    InputError
        When the file cannot be read, or something given is no compliance.

    Examples
    --------
    >>> table = smfe.compare({"at rest": hammer, "sweep": sweep})
    """
    given = read_groups(Path(frf)) if isinstance(frf, Path | str) else compliances_of(frf)
    groups = single_levels({n: d for n, d in given.items() if d.attrs.get("method") != "model"})
    peaks = all_peaks(groups)
    table = compare_compliances(groups, peaks=peaks)
    if output is not None:
        write_csv(Path(output), table)
        write_csv(Path(output).with_name("explained.csv"), explain(groups, peaks))
    return table


def single_levels(compliances: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Leave out estimates of several levels together, whose passes are in those of the single levels."""
    return {name: dataset for name, dataset in compliances.items() if "levels" not in dataset.attrs}


def compared(measured: Mapping[str, xr.Dataset], peaks: Peaks | None = None) -> pd.DataFrame:
    """Compare; without any measurement the table has its columns and no rows, as it has with a single one."""
    nothing = make_compliance([0.0], np.full((1, 1, 1), complex(math.nan)), AXES[:1], AXES[:1])
    return compare_compliances(measured, peaks=peaks) if measured else compare_compliances({"": nothing})


def model_errors(found: Mapping[str, Identification], models: Sequence[Model]) -> pd.DataFrame:
    """Return how far each measured entry is from each declared model.

    ``error = sqrt(mean |measured - model|^2 / mean |model|^2)`` over the frequencies where the entry was measured. An
    entry that the model says is zero has no such error, and no row.

    Parameters
    ----------
    found : mapping of str to Identification
        Measurements.
    models : sequence of Model
        Declared modal models.

    Returns
    -------
    pandas.DataFrame
        measurement, model, response, excitation, from_Hz, to_Hz, error_percent.
    """
    rows: list[dict[str, Any]] = []
    for model in models:
        for name, item in found.items():
            array = item.compliance["compliance"]
            truth = model.modal.matrix(item.compliance["frequency"].values)
            measured = full_matrix(item.compliance)
            missing = not_measured(item.compliance)
            for i, r in enumerate(AXES):
                for j, e in enumerate(AXES):
                    if r not in array["response"].values or e not in array["excitation"].values:
                        continue
                    if missing.sel(response=r, excitation=e):
                        continue
                    valid = np.isfinite(measured[:, i, j])
                    size = np.mean(np.abs(truth[valid, i, j]) ** 2)
                    if size == 0.0:
                        continue
                    f = item.compliance["frequency"].values[valid]
                    error = np.mean(np.abs(measured[valid, i, j] - truth[valid, i, j]) ** 2)
                    rows.append(
                        {
                            "measurement": name,
                            "model": model.name,
                            "response": r,
                            "excitation": e,
                            "from_Hz": f[0],
                            "to_Hz": f[-1],
                            "error_percent": 100.0 * math.sqrt(error / size),
                        }
                    )
    columns = ["measurement", "model", "response", "excitation", "from_Hz", "to_Hz", "error_percent"]
    return pd.DataFrame(rows, columns=columns)
