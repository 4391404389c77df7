"""`smfe modal`: from measured compliances to modes that a campaign file can hold, with a table and a diagram."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import overload

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import AXES
from process.units import show, si
from smfe.arrays.compliances import Compliance, compliances_of
from smfe.campaign import Campaign, load_campaign
from smfe.campaign.datasets import Show
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.campaign.toml import table as toml_table
from smfe.identification.errors.result import Identification
from smfe.identification.levels import with_levels
from smfe.identification.measurement import cached_identification
from smfe.kept import KEPT
from smfe.modes.fit_modes import ModalFit, fit_modes, uncertainty
from smfe.progress import Progress, part, silent, step, warn
from smfe.records import read_universal_frfs
from smfe.results import MEASUREMENT, Failures, attempt, read_groups, write_atomically, write_csv

Band = tuple[float | str, float | str]
"""From and to [Hz], or texts with units."""


@overload
def modal(
    source: Path | str | Campaign | Mapping[str, Compliance],
    output: Path | str | None = None,
    measurement: str | None = None,
    band: Band | None = None,
    progress: Progress = silent,
    licence: Show | None = None,
    failures: Failures | None = None,
) -> dict[str, ModalFit]: ...


@overload
def modal(
    source: Compliance,
    output: Path | str | None = None,
    measurement: None = None,
    band: Band | None = None,
    progress: Progress = silent,
) -> ModalFit: ...


def modal(
    source: Path | str | Campaign | Compliance | Mapping[str, Compliance],
    output: Path | str | None = None,
    measurement: str | None = None,
    band: Band | None = None,
    progress: Progress = silent,
    licence: Show | None = None,
    failures: Failures | None = None,
) -> dict[str, ModalFit] | ModalFit:
    """Fit modes to measured compliances; write ``[[model]]`` tables, intervals and a stabilisation diagram.

    Parameters
    ----------
    source : path, Campaign, xarray.Dataset, Identification, or mapping of str to the latter two
        Campaign, a compliance file (frf.nc), a universal file whose responses say what they are, or compliances in
        memory.
    output : path, optional
        ``.toml``: one ``[[model]]`` a measurement, to be pasted into a campaign file; ``.json``: the same as JSON with
        intervals and warnings. Beside it, under its name: a ``.csv`` with a row a mode, a ``.png`` a measurement.
        Default: of a path ``modal.toml``, else nothing is written.
    measurement : str, optional
        Only this one; else every measurement whose modes can be found.
    band : (float or str, float or str), optional
        Only these frequencies, e.g. ``("20 Hz", "80 Hz")``; numbers are Hz.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched.
    failures : list of Failure, optional
        Collects measurements that cannot be identified, or whose modes cannot be found; both stand in the file, too.

    Returns
    -------
    dict of str to ModalFit, or ModalFit
        Measurement -> modes; of one compliance its modes.

    Raises
    ------
    InputError
        When the source is wrong, the measurement is not in it, or no measurement can carry a fit.

    Warns
    -----
    SmfeWarning
        What must be known of the modes (``ModalFit.warnings``), and measurements that no modes could be fitted to.
    """
    if output is None and isinstance(source, Path | str):
        output = "modal.toml"
    path = None if output is None else Path(output)
    if path is not None and path.suffix not in (".toml", ".json"):
        raise InputError(f"the modes cannot be written to '{path.name}'; name a file that ends in .toml or .json")
    limits = None if band is None else (si(band[0], "frequency"), si(band[1], "frequency"))
    if limits is not None and not limits[0] < limits[1]:
        raise InputError(f"the band runs from {limits[0]:g} to {limits[1]:g} Hz; give the lower frequency first")
    refused: Failures = []
    if isinstance(source, Path | str | Campaign):
        kept = None if path is None else path.parent / KEPT
        compliances = _compliances(source, kept, measurement, part(progress, 0.0, 0.7), licence, refused)
    else:
        compliances = compliances_of(source)
        _require(measurement, list(compliances), "what is given")
        compliances = {n: d for n, d in compliances.items() if measurement in (None, n)}
    fits = {}
    for done, (name, compliance) in enumerate(compliances.items()):
        part(progress, 0.7, 1.0)(f"fitting modes to {name}", done, len(compliances))
        with attempt(refused, "modes of", name):
            fits[name] = fit_modes(compliance, band=limits)
    if not fits:
        reasons = "; ".join(f"{f.name}: {f.reason}" for f in refused)
        raise InputError(f"no modes could be fitted: {reasons}")
    if path is not None:
        _write(path, fits, {f.name: f.reason for f in refused})
    if failures is not None:
        failures += refused
    if isinstance(source, xr.Dataset | Identification):
        (fit,) = fits.values()
        warn(fit.warnings)
        return fit
    warn([*(f"{n}: {w}" for n, fit in fits.items() for w in fit.warnings), *(f.sentence for f in refused)])
    return fits


def _compliances(
    given: Path | str | Campaign,
    kept: Path | None,
    only: str | None,
    progress: Progress,
    licence: Show | None,
    failures: Failures,
) -> dict[str, xr.Dataset]:
    """Return the measured compliances of a campaign, of a compliance file or of a universal file."""
    source = given.path if isinstance(given, Campaign) else Path(given)
    if isinstance(given, Campaign) or source.suffix == ".toml":
        campaign = load_campaign(given, licence)
        wanted = {m.name: m for m in with_levels(campaign).measurements if m.method in COMPLIANCE_METHODS}
        _require(only, list(wanted), source.name)
        found = {}
        for done, (name, item) in enumerate(wanted.items()):
            if only in (None, name):
                progress(f"identifying {name}", done, len(wanted))
                with attempt(failures, MEASUREMENT, name):
                    within = step(progress, done, len(wanted))
                    found[name] = cached_identification(campaign, item, kept, within)[0].compliance
        return found
    if source.suffix.lower() in (".uff", ".unv"):
        _require(only, [source.stem], source.name)
        return {source.stem: read_universal_frfs(source)}
    groups = {n: d for n, d in read_groups(source).items() if d.attrs.get("method") != "model"}
    _require(only, list(groups), source.name)
    return {n: d for n, d in groups.items() if only in (None, n)}


def _require(only: str | None, names: list[str], source: str) -> None:
    if not names:
        raise InputError(f"{source} holds no measured compliance; `smfe modal` needs one")
    if only is not None and only not in names:
        raise InputError(f"{source} has no measurement '{only}' with a compliance; there are: {', '.join(names)}")


def model_name(measurement: str) -> str:
    """Return what the model of a measurement is called."""
    return f"{measurement}_modes"


def _write(path: Path, fits: Mapping[str, ModalFit], refused: Mapping[str, str]) -> None:
    # Drawing stays out of the numerics: only the composition imports it, and only where it is called.
    from smfe.reporting.modal import write_stabilisation

    frames = [fit.table().assign(measurement=name) for name, fit in fits.items()]
    table = pd.concat(frames, ignore_index=True)
    table = table[["measurement", *(c for c in table.columns if c != "measurement")]]
    if path.suffix == ".json":
        content = {name: _as_json(fit) for name, fit in fits.items()}
        text = json.dumps({"models": content, "refused": dict(refused)}, indent=2) + "\n"
    else:
        text = "\n".join([*(as_toml(name, fit) for name, fit in fits.items()), *_refusals(refused)])
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))
    write_csv(path.with_suffix(".csv"), table)
    for name, fit in fits.items():
        picture = path.with_suffix(".png") if len(fits) == 1 else path.with_name(f"{path.stem}_{name}.png")
        write_stabilisation(fit, picture, name)


def _refusals(refused: Mapping[str, str]) -> list[str]:
    return [f"# {name}: {reason}\n" for name, reason in refused.items()]


def as_toml(name: str, fit: ModalFit) -> str:
    """Return the ``[[model]]`` table of a measurement, with its warnings as comments.

    Where no shapes are known it is all comment: poles alone are no compliance.
    """
    head = [f"# modes of {name}, misfit {fit.free.misfit:.3g} (1: as good as the noise allows)"]
    head += [f"# {warning}" for warning in fit.warnings]
    if fit.shapes is None or not set(fit.curves.places) & set(AXES):
        head += [f"# {row.frequency_Hz:.6g} Hz, damping {row.damping:.4g}" for row in fit.table().itertuples()]
        return "\n".join(head) + "\n"
    model, band = fit.modal_model(), float(fit.curves.frequency[-1])
    modes = [
        {
            "frequency": show(f, "Hz", "frequency", 9),
            "damping": float(f"{z:.7g}"),
            "stiffness": show(k, "N/um", "stiffness", 9),
            "direction": [round(float(u), 9) for u in v],
        }
        for f, z, k, v in zip(model.frequency, model.damping, model.stiffness, model.direction, strict=True)
    ]
    if (model.frequency > band).any():
        head.append(f"# modes above {band:.6g} Hz stand for all modes above the band")
    values = {"name": model_name(name), "modes": modes, "uncertainty": uncertainty(fit)}
    return "\n".join(head) + "\n" + toml_table("[[model]]", values)


def _as_json(fit: ModalFit) -> dict[str, object]:
    rows = [{str(k): v for k, v in row.items()} for row in fit.table().to_dict("records")]
    perhaps = [float(f) for f, apart in zip(fit.free.poles[:, 0], fit.perhaps_two, strict=True) if np.isfinite(apart)]
    return {
        "modes": rows,
        "unexplained_Hz": list(fit.unexplained),
        "perhaps_two_Hz": perhaps,
        "misfit": fit.free.misfit,
        "warnings": list(fit.warnings),
    }
