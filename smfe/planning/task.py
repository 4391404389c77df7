"""What a sweep is planned for: tool, material, limits, and an estimate of the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, full_matrix, make_compliance
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.campaign import Campaign, load_campaign
from smfe.campaign.campaign import read_toml
from smfe.campaign.datasets import Show
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.campaign.schema import PlanTable
from smfe.identification.levels import with_levels
from smfe.identification.measurement import identify_measurement
from smfe.identification.sweep.least_squares import Equations
from smfe.identification.sweep.local_polynomial import LocalPolynomial
from smfe.identification.sweep.rational import fit_rational
from smfe.planning.rules import RULES
from smfe.progress import Progress, silent
from smfe.scenario import load_scenario
from stability import SpindleRange


@dataclass(frozen=True)
class Estimate:
    """What is believed of the machine before the sweep.

    Parameters
    ----------
    name : str
        Where it comes from.
    source : ModalModel or xarray.Dataset
        Modes, or a labelled compliance.
    machine : mapping or None
        The table ``[machine]`` of a scenario that simulates it; None where that cannot be done.
    warnings : tuple of str
        What the user must know of it.
    smooth : xarray.Dataset or None
        A measured source without its noise (`smfe.planning.task`), for the errors; limits are asked of the source.
    """

    name: str
    source: ModalModel | xr.Dataset
    machine: Mapping[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    smooth: xr.Dataset | None = None

    def matrix(self, frequency: ArrayLike, beyond: bool = False) -> Complex:
        """Return the compliance [m/N] at frequencies [Hz], shape (..., 3, 3); a measured one is interpolated.

        With `beyond` a measured one ends in what it holds last.

        Raises
        ------
        InputError
            When a measured compliance does not reach that far.
        """
        f = np.asarray(frequency, dtype=float)
        if isinstance(self.source, ModalModel):
            return self.source.matrix(f.ravel()).reshape(*f.shape, 3, 3)
        held = self.source if self.smooth is None else self.smooth
        full = full_matrix(held)
        known = np.isfinite(full).all(axis=(1, 2))
        at = held["frequency"].values[known]
        if at.size < 2 or (not beyond and (f.min() < at[0] - 1e-9 or f.max() > at[-1] + 1e-9)):
            reach = f"{at[0]:g} to {at[-1]:g} Hz" if at.size else "nothing"
            raise InputError(
                f"the estimate '{self.name}' holds {reach}; {f.min():g} to {f.max():g} Hz are needed, the band of the "
                "plan and 1 Hz beyond: measure a wider band, narrow frequency_range, or give a [[model]]"
            )
        flat = full[known].reshape(at.size, 9)
        columns = [
            np.interp(f.ravel(), at, flat[:, k].real) + 1j * np.interp(f.ravel(), at, flat[:, k].imag) for k in range(9)
        ]
        return np.stack(columns, axis=1).reshape(*f.shape, 3, 3)

    def scale(self, frequency: Real) -> Real:
        """Return what an error is a fraction of [m/N], shape (3, 3): ``sqrt(rms Phi_ii rms Phi_jj)`` over frequencies.

        It does not vanish where a cross compliance does. An axis counts with at least a tenth of the softest.
        """
        direct = np.sqrt(np.mean(np.abs(np.diagonal(self.matrix(frequency), axis1=1, axis2=2)) ** 2, axis=0))
        if not direct.max() > 0.0:
            raise InputError(f"the estimate '{self.name}' does not move in the band; name one that does")
        direct = np.maximum(direct, RULES.rigid * direct.max())
        return np.asarray(np.sqrt(np.outer(direct, direct)))


# --- a measured estimate without its noise --------------------------------------------------------------------------


def without_noise(source: xr.Dataset, band: tuple[float, float]) -> xr.Dataset | None:
    """Return a measured compliance as a rational model has it.

    Parameters
    ----------
    source : xarray.Dataset
        With ``compliance`` and, where it is known, ``compliance_std``; else the scatter between lines counts.
    band : (float, float)
        That is planned for [Hz].

    Returns
    -------
    xarray.Dataset or None
        On a fine frequency axis, what was not measured as zero; None where fewer than 16 lines were measured in the
        band.
    """
    full = full_matrix(source)
    known = np.isfinite(full).all(axis=(1, 2))
    known &= np.abs(source["frequency"].values - 0.5 * sum(band)) <= 0.5 * (band[1] - band[0]) + RULES.margin
    at, compliance = source["frequency"].values[known], full[known]
    if at.size < 16:
        return None
    step = float(np.median(np.diff(at)))
    lines = _one_line_each(at, compliance, step)
    weight = 1.0 / _variance(source, known, compliance)[:, None, :]
    fine = np.arange(at[0], at[-1] + 0.5 * RULES.bin_width, RULES.bin_width)
    fine[-1] = at[-1]
    fit = fit_rational(lines, lines, weight, (at[0] - 0.5 * step, at[-1] + 0.5 * step), fine, 3)
    return make_compliance(fine, fit.value, AXES, attrs={"poles": fit.poles.size})


def _one_line_each(at: Real, compliance: Complex, step: float) -> Equations:
    """Return bins that hold one line each, at the centre; four terms let the fit expand about the edge of a bin."""
    terms = 4
    gram = np.zeros((at.size, 1, terms, 3, terms, 3), dtype=complex)
    gram[:, 0, 0, :, 0, :] = np.eye(3)
    cross = np.zeros((at.size, 1, terms, 3, 3), dtype=complex)
    cross[:, 0, 0] = compliance.swapaxes(1, 2)
    joint = (compliance @ compliance.conj().swapaxes(1, 2))[:, None]
    moment = np.zeros((at.size, 1, terms, terms))
    moment[:, 0, 0, 0] = 3.0
    return Equations(at, step, gram, cross, joint, moment)


def _variance(source: xr.Dataset, known: NDArray[np.bool_], compliance: Complex) -> Real:
    """Return the mean square error of each row, shape (lines, 3)."""
    size = np.mean(np.abs(compliance) ** 2, axis=(0, 2))
    least = np.maximum(RULES.least_error**2 * size, 1e-8 * size.max())
    if "compliance_std" in source:
        std = full_matrix(source.assign(compliance=source["compliance_std"].astype(complex))).real[known]
        variance = np.mean(np.nan_to_num(std) ** 2, axis=2)
    else:
        # Of white noise the second difference has six times the variance; a median passes over the resonances.
        bend = np.abs(np.diff(compliance, 2, axis=0)) ** 2 / 6.0 / np.log(2.0)
        variance = np.broadcast_to(np.median(bend, axis=0).mean(axis=1), (compliance.shape[0], 3))
    return np.asarray(np.maximum(variance, least))


# --- the task --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """What a sweep is planned for.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Title.
    tool : Tool
        With all pockets filled.
    coefficients : CuttingCoefficients
        Work material.
    estimate : Estimate
        The machine.
    spindle : SpindleRange
        What it can be set to [rpm].
    limits : PlanTable
        ``[plan]``, in SI.
    raw : mapping
        The file as it was written.
    """

    path: Path
    name: str
    tool: Tool
    coefficients: CuttingCoefficients
    estimate: Estimate
    spindle: SpindleRange
    limits: PlanTable
    raw: Mapping[str, Any] = field(repr=False)

    @property
    def frequency(self) -> Real:
        """Frequencies at which the sweep will be evaluated [Hz]."""
        return LocalPolynomial().axis(self.limits.frequency_range, ())


def load_task(path: Path | str | Campaign, progress: Progress = silent, show: Show | None = None) -> Task:
    """Read a plan or campaign file; identify the measurement that the plan starts from.

    Parameters
    ----------
    path : path or Campaign
        Campaign file, usually with a table ``[plan]``, or what was read of one.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.

    Raises
    ------
    InputError
        When the file is wrong, names no machine, or its tool cannot be planned for.
    """
    campaign = load_campaign(path, show)
    raw = read_toml(campaign.path)
    return task_of(campaign, raw, lambda limits: _estimate(campaign, limits, raw, progress))


def task_of(campaign: Campaign, raw: Mapping[str, Any], estimate: Callable[[PlanTable], Estimate]) -> Task:
    """Return the task of a campaign whose estimate of the machine is asked for once all else is right.

    Raises
    ------
    InputError
        When tool or material are missing, or the tool cannot be planned for.
    """
    limits = campaign.plan or PlanTable()
    missing = [
        f"[{name}]" for name, value in (("tool", campaign.tool), ("material", campaign.coefficients)) if not value
    ]
    if campaign.tool is None or campaign.coefficients is None:
        raise InputError(f"{campaign.path.name}: a plan needs {' and '.join(missing)}; add it")
    _check_tool(campaign.path, campaign.tool)
    return Task(
        campaign.path,
        campaign.name,
        campaign.tool,
        campaign.coefficients,
        estimate(limits),
        campaign.spindle,
        limits,
        raw,
    )


def _check_tool(path: Path, tool: Tool) -> None:
    unequal = [] if tool.equal_pitch else ["unequal pitch"]
    unequal += [] if tool.equal_radius else ["run-out"]
    if unequal:
        raise InputError(
            f"{path.name}: the tool has {' and '.join(unequal)}; a plan is made for equally spaced teeth on one "
            "circle: leave pitch_angles and runout out"
        )


def _estimate(campaign: Campaign, limits: PlanTable, raw: Mapping[str, Any], progress: Progress) -> Estimate:
    if limits.scenario is not None:
        return _of_scenario(campaign.path, limits)
    models = {m.name: m.modal for m in campaign.models}
    measured = {m.name: m for m in with_levels(campaign).measurements if m.method in COMPLIANCE_METHODS}
    name = limits.machine or next(iter([*models, *measured]), None)
    if name in models:
        table = next((t for t in raw.get("model", ()) if t["name"] == name), raw.get("machine", {}))
        return Estimate(name, models[name], {"modes": table["modes"]})
    if name is None or name not in measured:
        wanted = "no machine" if name is None else f"'{name}', which gives no compliance"
        raise InputError(
            f"{campaign.path.name}: the plan has {wanted}; name a [[model]], or a measurement by hammer, actuator, "
            "sweep or frf"
        )
    return estimate_of(name, identify_measurement(campaign, measured[name], progress).compliance, limits)


def estimate_of(name: str, found: xr.Dataset, limits: PlanTable) -> Estimate:
    """Return a measured compliance as the estimate of a machine."""
    array = found["compliance"]
    lacking = [a for a in AXES if a not in array["response"].values or a not in array["excitation"].values]
    warning = (f"'{name}' has no {', '.join(lacking)}; what was not measured is taken as rigid",) if lacking else ()
    return Estimate(name, found, None, warning, without_noise(found, limits.frequency_range))


def _of_scenario(path: Path, limits: PlanTable) -> Estimate:
    assert limits.scenario is not None
    scenario = load_scenario(path.parent / limits.scenario)
    table = scenario.raw["machine"]
    if isinstance(scenario.machine, ModalModel):
        return Estimate(limits.scenario, scenario.machine, table)
    low, high = limits.feed or (0.0, 0.0)
    feed = {"x": 0.5 * (low + high)} if "x" in scenario.machine.axes else {}
    point = scenario.machine.at(feed, limits.controller)
    grid = np.arange(1.0, 3.0 * limits.frequency_range[1], RULES.axis_step)
    warning = (
        f"the machine is taken for small vibration at a feed of {6e4 * feed.get('x', 0.0):g} mm/min in x; friction "
        "makes its compliance depend on feed and force",
    )
    return Estimate(limits.scenario, point.compliance(grid), table, warning)
