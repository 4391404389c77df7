"""Whether the prediction of a plan is right: simulate the sweep, identify it, compare the errors entry by entry."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import AXES
from process.types import Complex, Real
from smfe.campaign import load_campaign
from smfe.identification.measurement import identify_measurement
from smfe.planning.errors import error_interval
from smfe.planning.recommend import Plan
from smfe.planning.rules import RULES
from smfe.planning.sweep_files import scenario_text
from smfe.progress import Progress, silent
from smfe.results import write_csv
from smfe.scenario import load_scenario
from smfe.scenario.run import campaign_text, standing_axes, truths, write_records

ESTIMATORS = {"local_polynomial": ("relative_error", ""), "bands": ("bands_relative_error", "bands_")}
"""Estimators that are compared: variable of the prediction, and what their columns begin with."""


@dataclass(frozen=True)
class Verification:
    """Measured errors beside predicted ones.

    Parameters
    ----------
    table : pandas.DataFrame
        entry, predicted_percent, measured_percent (root mean square over seeds) and ratio of the default estimator, the
        interval of the ratio (ratio_low, ratio_high), the same with ``bands_`` before it of narrow bands alone, and one
        column a seed of the default.
    condition_ratio : float
        Median over frequency of the condition number found over the one predicted, first seed.
    seeds : tuple of int
        Seeds of the sensor noise.
    """

    table: pd.DataFrame
    condition_ratio: float
    seeds: tuple[int, ...]

    @property
    def median_ratio(self) -> float:
        """Median over the entries of measured over predicted error."""
        return float(self.table["ratio"].median())

    @property
    def off(self) -> pd.DataFrame:
        """The entries whose ratio lies outside its interval, or is none, the farthest first."""
        ratio = self.table["ratio"].to_numpy()
        low, high = (self.table[f"ratio_{end}"].to_numpy() for end in ("low", "high"))
        far = np.maximum(ratio / high, low / ratio)
        far[~np.isfinite(far)] = np.inf
        order = np.argsort(-far, kind="stable")
        missed: pd.DataFrame = self.table.iloc[order[far[order] > 1.0]]
        return missed

    @property
    def confirmed(self) -> bool:
        """Whether each entry lies in its interval."""
        return self.off.empty


def verify(
    found: Plan, out: Path | str | None = None, seeds: tuple[int, ...] = (1, 2, 3), progress: Progress = silent
) -> Verification:
    """Simulate and identify the recommended sweep; compare the errors with those predicted.

    Parameters
    ----------
    found : Plan
        The plan.
    out : path, optional
        Folder for ``verification.csv``. The records are not kept: ``scenario.toml`` makes them again.
    seeds : tuple of int, optional
        Seeds of the sensor noise.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        When the machine cannot be simulated, or there is no seed.
    """
    if not seeds:
        raise InputError("no seed to verify with; give at least one")
    scale = _scale(found)
    errors: dict[str, list[Real]] = {name: [] for name in ESTIMATORS}
    condition = np.nan
    for done, seed in enumerate(seeds):
        progress("simulating and identifying the plan", done, len(seeds))
        compliances, truth = _identified(found, seed)
        if done == 0:
            seen = compliances["local_polynomial"]["force_condition"] / found.prediction["force_condition"]
            condition = float(np.median(seen))
        for name, compliance in compliances.items():
            difference = compliance["compliance"].transpose("frequency", "response", "excitation").values - truth
            errors[name].append(np.sqrt(np.nanmean(np.abs(difference) ** 2, axis=0)) / scale)
    table = pd.DataFrame({"entry": [r + e for r in AXES for e in AXES]})
    # Each of the nine at such a level that all hold together (Bonferroni).
    each = 1.0 - (1.0 - RULES.confirmed) / len(table)
    interval = error_interval(found.prediction["error_freedom"].values.ravel(), each, len(seeds))
    table["ratio_low"], table["ratio_high"] = interval
    for name, (variable, prefix) in ESTIMATORS.items():
        predicted = found.prediction[variable].values.ravel()
        measured = np.sqrt(np.mean(np.square(errors[name]), axis=0)).ravel()
        table[f"{prefix}predicted_percent"] = 100.0 * predicted
        table[f"{prefix}measured_percent"] = 100.0 * measured
        table[f"{prefix}ratio"] = measured / predicted
    for seed, error in zip(seeds, errors["local_polynomial"], strict=True):
        table[f"seed_{seed}_percent"] = 100.0 * error.ravel()
    if out is not None:
        write_csv(Path(out) / "verification.csv", table)
    return Verification(table, condition, tuple(seeds))


def explain(result: Verification) -> str:
    """Return the verification in words, a line each."""
    lines = [
        f"{row.entry}: expected {row.predicted_percent:.2g} %, found {row.measured_percent:.2g} % ({row.ratio:.2f}, "
        f"{row.ratio_low:.2f} to {row.ratio_high:.2f} is in the stated interval); "
        f"bands alone {row.bands_predicted_percent:.2g} %, {row.bands_measured_percent:.2g} % ({row.bands_ratio:.2f})"
        for row in result.table.itertuples()
    ]
    if result.confirmed:
        verdict = f"the prediction is confirmed: all {len(result.table)} entries lie in their intervals"
    else:
        missed = [
            f"{row.entry} {row.ratio:.2f} times the expected ({row.ratio_low:.2f} to {row.ratio_high:.2f})"
            for row in result.off.itertuples()
        ]
        verdict = f"the prediction is NOT confirmed: found was {', '.join(missed)}"
    seeds = ", ".join(map(str, result.seeds))
    tail = (
        f"{verdict}; median ratio {result.median_ratio:.2f}, condition number found over expected "
        f"{result.condition_ratio:.2f}, seeds {seeds}"
    )
    return "\n".join([*lines, tail])


def _scale(found: Plan) -> Real:
    return found.task.estimate.scale(found.task.frequency)


def _identified(found: Plan, seed: int) -> tuple[dict[str, xr.Dataset], Complex]:
    """Return what each estimator finds from simulated records, and the truth on its frequencies."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenario.toml").write_text(scenario_text(found.task, found.sweep, seed), encoding="utf-8")
        scenario = load_scenario(folder / "scenario.toml")
        text = campaign_text(scenario, write_records(scenario, folder, 1, silent), standing_axes(scenario))
        campaign, compliances = folder / "campaign.toml", {}
        for estimator in ESTIMATORS:
            wanted = text.replace('method = "sweep"', f'method = "sweep"\nestimator = "{estimator}"')
            campaign.write_text(wanted, encoding="utf-8")
            loaded = load_campaign(campaign)
            compliances[estimator] = identify_measurement(loaded, loaded.measurements[0]).compliance
        truth = truths(scenario)["sweep"]["compliance"]
        at = compliances["bands"]["frequency"].values
        exact = found.task.estimate.matrix(at)
        if found.task.estimate.machine is not None and "axis" in found.task.estimate.machine:
            exact = truth.interp(frequency=at).transpose("frequency", "response", "excitation").values
        # The force that acted, over its samples.
        return compliances, exact * np.sinc(at / found.task.limits.sample_rate)[:, None, None] ** 2
