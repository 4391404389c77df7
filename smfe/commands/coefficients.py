"""Cutting coefficients from measured cuts: average forces over the feed, and the forces at all spindle orders.

Mean force of N teeth over a revolution, linear in the six coefficients (`process.cut.force`)::

    F = N/(2 pi) a_p (f_z P(K_c) Gram(:, 0) + P(K_e) Gram(:, 2)/sin k)

A helix does not change it. Source: Altintas, Manufacturing Automation, 2.8 (average-force identification).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy import optimize, stats

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients, force_projection, gram_matrix
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, axis_present
from process.notebook import html_table
from process.types import Real
from process.units import RANGES, Range, implausible
from smfe.arrays.tables import tool_of
from smfe.campaign import Campaign, load_campaign
from smfe.campaign.datasets import Show
from smfe.diagnosis.cutting.forces import CuttingForces, cutting_family
from smfe.diagnosis.cutting.orders import SteadyCut, cutting_orders
from smfe.progress import Progress, silent, warn
from smfe.records import read_records
from smfe.results import write_atomically
from stability.chatter.cut_interval import in_the_cut

CUTTING = ("Ktc", "Krc", "Kac")
EDGE = ("Kte", "Kre", "Kae")
_LEVEL = 0.95
_SHOWN = {
    "runout": Range(0.0, 5e-4, 1e6, "µm", "bound of the fit"),
    "helix": Range(0.0, 1.2, 180.0 / math.pi, "deg", "bound of the fit"),
}
_POOR = 0.2
"""Residual of the mechanistic fit above which its values are not to be used."""


@dataclass(frozen=True)
class Coefficients:
    """Cutting coefficients with their 95 % intervals, SI.

    Parameters
    ----------
    method : str
        "average force" or "mechanistic".
    values : mapping of str to float
        Ktc, Krc, Kac [N/m2], Kte, Kre, Kae [N/m]; the mechanistic fit also runout [m] and helix [rad].
    intervals : mapping of str to (float, float)
        95 % interval of each (Student's t).
    residual : float
        Root mean square of what the fit leaves, over that of the forces.
    warnings : tuple of str
        What speaks against it.
    """

    method: str
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    residual: float
    warnings: tuple[str, ...] = ()

    @property
    def cutting_coefficients(self) -> CuttingCoefficients:
        """The coefficients alone, for `smfe.lobes`; edge coefficients that were not found are zero."""
        return CuttingCoefficients(**{key: self.values.get(key, 0.0) for key in (*CUTTING, *EDGE)})

    def _repr_html_(self) -> str:
        """Return a table for a notebook: each value with its 95 % interval."""
        rows = []
        for key in self.values:
            known = RANGES.get(key, _SHOWN.get(key))
            factor, unit = (1.0, "rad") if known is None else (known.shown, known.unit)
            low, high = self.intervals.get(key, (math.nan, math.nan))
            rows.append((key, *(f"{factor * v:.5g}" for v in (self.values[key], low, high)), unit))
        notes = [f"residual {100.0 * self.residual:.3g} % of the forces", *self.warnings]
        head = ("coefficient", "value", "95 % from", "to", "unit")
        return html_table(f"Cutting coefficients, {self.method}", rows, head, notes)

    def material(self, name: str) -> str:
        """Return a table ``[material]`` for a campaign file."""
        lines = [f"# {self.method} fit; behind each value its 95 % interval", "[material]", f'name = "{name}"']
        for key in (*CUTTING, *EDGE):
            if key in self.values:
                known = RANGES[key]
                low, high = (known.shown * end for end in self.intervals[key])
                text = f'{key} = "{known.shown * self.values[key]:.5g} {known.unit}"'
                lines.append(f"{text}  # {low:.5g} to {high:.5g}")
        return "\n".join(lines) + "\n"


def mean_force_design(tool: Tool, cut: SteadyCut) -> Real:
    """Return the mean force on the tool for each coefficient alone, shape (3, 6): x, y, z by Ktc ... Kae, SI."""
    gram = gram_matrix(cut.arc, 0).real
    share = tool.teeth / (2.0 * math.pi) * cut.depth
    columns = []
    for unit in np.eye(3):
        columns.append(share * cut.feed_per_tooth * force_projection(unit, tool.approach_angle) @ gram[:, 0])
    for unit in np.eye(3):
        edge = force_projection(unit, tool.approach_angle) @ gram[:, 2] / math.sin(tool.approach_angle)
        columns.append(share * edge)
    return np.column_stack(columns)


def average_force(tool: Tool, cuts: list[tuple[SteadyCut, Real]]) -> Coefficients:
    """Fit the coefficients to mean forces.

    Parameters
    ----------
    tool : Tool
        Teeth of equal pitch.
    cuts : list of (SteadyCut, ndarray of shape (3,))
        Setting and mean force on the tool along x, y, z [N].

    Raises
    ------
    InputError
        With fewer than two feeds per tooth, which do not separate cutting from edge forces, or with fewer than three
        cuts, which leave no residual for an interval.
    """
    feeds = {round(cut.feed_per_tooth, 9) for cut, _ in cuts}
    if len(feeds) < 2 or len(cuts) < 3:
        raise InputError(
            f"{len(cuts)} cuts at {len(feeds)} feeds per tooth; at least three cuts at two feeds or more are needed to "
            "part cutting from edge coefficients and to state intervals: cut three to five feeds at one depth"
        )
    design = np.concatenate([mean_force_design(tool, cut) for cut, _ in cuts])
    force = np.concatenate([mean for _, mean in cuts])
    # Columns differ by the chip thickness; scaled, they are of one size.
    size = np.linalg.norm(design, axis=0)
    if np.linalg.matrix_rank(design / size, 1e-6) < 6:
        raise InputError("these cuts do not determine all six coefficients; add another feed per tooth or engagement")
    solution, *_ = np.linalg.lstsq(design / size, force, rcond=None)
    left = force - design @ (solution / size)
    freedom = force.size - 6
    covariance = np.linalg.inv((design / size).T @ (design / size)) * float(left @ left) / freedom
    reach = float(stats.t.ppf(0.5 + 0.5 * _LEVEL, freedom)) * np.sqrt(np.diag(covariance)) / size
    values = dict(zip((*CUTTING, *EDGE), map(float, solution / size), strict=True))
    intervals = {n: (v - float(r), v + float(r)) for (n, v), r in zip(values.items(), reach, strict=True)}
    residual = float(np.linalg.norm(left) / np.linalg.norm(force))
    return Coefficients("average force", values, intervals, residual, tuple(_warned(values)))


def _warned(values: Mapping[str, float]) -> list[str]:
    """Say what no work material has, and a negative coefficient, which a wrong axis or sign gives."""
    out = implausible(values)
    if values["Ktc"] <= 0.0 or values["Krc"] < 0.0:
        out.append(
            f"Ktc {values['Ktc'] / 1e6:.4g} and Krc {values['Krc'] / 1e6:.4g} N/mm^2: a force channel has the wrong "
            "sign or axis. Forces act on the tool, x is the feed direction; a dynamometer under the work measures the "
            "reaction (sign = -1), and its axes may be exchanged"
        )
    return out


def mechanistic(family: CuttingForces, start: Mapping[str, float]) -> Coefficients:
    """Fit the coefficients to the forces at all spindle orders, with run-out and helix, from the average-force fit.

    Raises
    ------
    InputError
        When the fit does not converge.
    """
    scale = {**{n: 1e8 for n in CUTTING}, **{n: 1e4 for n in EDGE}, "runout": 1e-5, "runout_angle": 1.0, "helix": 0.3}
    names = [*CUTTING, *EDGE, "helix"] + (["runout"] if family.tool.teeth > 1 else [])
    names += ["runout_angle"] if family.tool.teeth > 2 else []
    first = {**start, "helix": max(min(family.tool.helix_angle, 1.2), 0.05), "runout": 5e-6, "runout_angle": 0.5}
    observed = [np.asarray(c.observed) for c in family.conditions if c.observed is not None]
    conditions = [c for c in family.conditions if c.observed is not None]

    def residual(u: Real) -> Real:
        values = {n: float(x) * scale[n] for n, x in zip(names, u, strict=True)}
        return np.concatenate([family.predict(c, values) - y for c, y in zip(conditions, observed, strict=True)])

    low = np.array([{"helix": 0.0, "runout": 0.0}.get(n, -np.inf) / scale[n] for n in names])
    high = np.array([{"helix": 1.2, "runout": 5e-4}.get(n, np.inf) / scale[n] for n in names])
    begin = np.array([first[n] / scale[n] for n in names])
    fit = optimize.least_squares(residual, np.clip(begin, low + 1e-6, high - 1e-6), bounds=(low, high), x_scale="jac")
    if not fit.success:
        raise InputError(f"the mechanistic fit does not converge ({fit.message}); use the average forces")
    freedom = max(fit.fun.size - len(names), 1)
    spread = max(2.0 * fit.cost / freedom, 1.0)
    jacobian = np.asarray(fit.jac, dtype=np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * spread
    reach = float(stats.t.ppf(0.5 + 0.5 * _LEVEL, freedom)) * np.sqrt(np.diag(covariance))
    values = {n: float(x) * scale[n] for n, x in zip(names, fit.x, strict=True)}
    intervals = {
        n: ((float(x) - float(r)) * scale[n], (float(x) + float(r)) * scale[n])
        for n, x, r in zip(names, fit.x, reach, strict=True)
    }
    whole = math.sqrt(sum(float(y @ y) for y in observed))
    residual_share, warnings = math.sqrt(2.0 * float(fit.cost)) / whole, _warned(values)
    if residual_share > _POOR:
        warnings.append(
            f"the forces of rigid teeth leave {100.0 * residual_share:.0f} % of the measured orders: resonances of the "
            "dynamometer or vibration of the tool amplify them; prefer the average forces, which these do not reach"
        )
    return Coefficients("mechanistic", values, intervals, residual_share, tuple(warnings))


def coefficients(
    campaign: str | Path | Campaign | Sequence[xr.Dataset],
    output: str | Path | None = None,
    progress: Progress = silent,
    licence: Show | None = None,
    *,
    tool: Tool | Mapping[str, Any] | None = None,
) -> list[Coefficients]:
    """Find the cutting coefficients from the cutting tests of a campaign, or from records, by both methods.

    Parameters
    ----------
    campaign : path, Campaign, or sequence of xarray.Dataset
        Campaign with ``[tool]`` and ``[[cutting_test]]`` that record all three forces and state ``feed_per_tooth``;
        ``[material]`` is not needed. Or records of such cuts that say their cut, width, depth, feed per tooth and
        spindle speed: ``smfe.record(..., cut="down", width_of_cut="40 mm", depth_of_cut="2 mm",
        feed_per_tooth="0.1 mm", spindle_speed="950 rpm")``.
    output : path, optional
        File for ``[material]`` of both, to paste. None: nothing is written.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched.
    tool : Tool or mapping, optional
        With records: the tool, or the keys of ``[tool]``.

    Returns
    -------
    list of Coefficients
        Average force first, then the mechanistic fit where it converges.

    Raises
    ------
    InputError
        When the campaign or a record is wrong, or the cuts do not determine the coefficients.

    Warns
    -----
    SmfeWarning
        What speaks against the values (``Coefficients.warnings``).
    """
    if isinstance(campaign, str | Path | Campaign):
        name, cutter, cuts = _of_campaign(campaign, progress, licence)
    else:
        name, cutter, cuts = _of_records(campaign, tool)
    means: list[tuple[SteadyCut, Real]] = []
    for record, cut in cuts.values():
        mean = cutting_orders(record, cutter, cut).value[0].real
        means.append((cut, np.asarray(mean, dtype=np.float64)))
    results = [average_force(cutter, means)]
    progress("fitting the forces at all orders", len(cuts), len(cuts) + 1)
    start = results[0].values
    if start["Ktc"] > 0.0:
        handbook = (start["Ktc"], start["Krc"], start["Kac"])
        results.append(mechanistic(cutting_family(cuts, cutter, handbook), start))
    if output is not None:
        text = "\n".join(r.material(name) for r in results[:1])
        extra = [f"# {line.removeprefix('# ')}" for r in results[1:] for line in r.material(name).splitlines()]
        notes = [f"# warning, {r.method}: {w}" for r in results for w in r.warnings]
        whole = "\n".join([*notes, text, *extra]) + "\n"
        write_atomically(Path(output), lambda p: p.write_text(whole, encoding="utf-8"))
    warn(f"{r.method}: {w}" for r in results for w in r.warnings)
    return results


Cuts = dict[str, tuple[xr.Dataset, SteadyCut]]


def _of_campaign(campaign: str | Path | Campaign, progress: Progress, licence: Show | None) -> tuple[str, Tool, Cuts]:
    """Return name of the material, tool and cuts of a campaign."""
    loaded = load_campaign(campaign, licence)
    if loaded.tool is None or not loaded.cutting_tests:
        raise InputError(
            f"{loaded.path.name}: coefficients need [tool] and [[cutting_test]]s with their forces; add them"
        )
    cuts: Cuts = {}
    for number, test in enumerate(loaded.cutting_tests):
        progress(f"reading {test.file.name}", number, len(loaded.cutting_tests) + 1)
        record = read_records(test.file, test.channels)[0]
        _check_forces(record, test.file.name)
        arc = engagement(test.cut, test.width_of_cut, loaded.tool.diameter)
        speed = test.spindle_speed * math.pi / 30.0
        cut = SteadyCut(speed, test.stated_feed_per_tooth, test.depth_of_cut, arc)
        cuts[f"cut {number + 1}, {test.file.name}"] = (in_the_cut(record, speed, test.interval), cut)
    return loaded.material or loaded.name, loaded.tool, cuts


def _of_records(records: Sequence[xr.Dataset], tool: Tool | Mapping[str, Any] | None) -> tuple[str, Tool, Cuts]:
    """Return what records in memory say of their cuts."""
    if tool is None:
        raise InputError('coefficients of records need their tool, e.g. tool=smfe.Tool("80 mm", 2)')
    cutter = tool_of(tool)
    cuts: Cuts = {}
    for number, record in enumerate(records, 1):
        name = str(record.attrs.get("source", f"record {number}"))
        _check_forces(record, name)
        keys = ("width_of_cut", "depth_of_cut", "feed_per_tooth")
        missing = [k for k in ("cut",) if k not in record.attrs] + [k for k in keys if f"{k}_mm" not in record.attrs]
        missing += [] if "spindle_speed" in record else ["spindle_speed"]
        if missing:
            raise InputError(f'{name}: {", ".join(missing)} is missing; say it to smfe.record, e.g. cut="down"')
        width, depth, feed = (1e-3 * float(record.attrs[f"{k}_mm"]) for k in keys)
        arc = engagement(record.attrs["cut"], width, cutter.diameter)
        speed = float(np.median(record["spindle_speed"].values)) * math.pi / 30.0
        cuts[f"cut {number}, {name}"] = (in_the_cut(record, speed), SteadyCut(speed, feed, depth, arc))
    return "work material", cutter, cuts


def _check_forces(record: xr.Dataset, name: str) -> None:
    present = axis_present(record, "force")
    if len(present) < 3:
        missing = ", ".join(f"force_{a}" for a in AXES if a not in present)
        raise InputError(f"{name}: {missing} is missing; all three forces are needed for the coefficients")
