"""Which method a measurement of the campaign asks for, and the files it needs -> compliance.

A result is kept under a key made of the files' hashes, the settings and the version, so that a second run continues
where the first stopped.
"""

from __future__ import annotations

import glob
import hashlib
import io
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.cut.engagement import Engagement, engagement
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe._version import __version__
from smfe.campaign import Campaign, Measurement, RecordEntry
from smfe.identification.actuator.excitation_kind import identify_shaken
from smfe.identification.errors.attached_mass import without_mass
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.background import Background
from smfe.identification.hammer.hammer import Averaging, identify_hammer
from smfe.identification.hammer.impacts import HitRules
from smfe.identification.levels import hammer_levels
from smfe.identification.responses import identify_averaged, rising_phase, turned_text
from smfe.identification.sweep.local_polynomial import BANDS, LocalPolynomial
from smfe.identification.sweep.order_tracking import Orders
from smfe.identification.sweep.passes import SweepPass
from smfe.identification.sweep.segments import Segments, SingleReference
from smfe.identification.sweep.sweep import Estimator, check_independent, identify_sweep
from smfe.kept import file_hash
from smfe.progress import Progress, silent
from smfe.records import put_on_clock, put_on_time, read_records, read_reduced, reduced
from smfe.records.dynamometer import compensate
from smfe.results import MEASUREMENT, Failures, attempt, keep_groups, kept_groups, pack_warnings, unpack_warnings

FORM = 7
"""Raised where an estimator, or what it writes, changes within a version: what was kept is then not read back."""


def identify_measurement(campaign: Campaign, measurement: Measurement, progress: Progress = silent) -> Identification:
    """Identify one measurement.

    Parameters
    ----------
    campaign : Campaign
        The campaign, for the tool.
    measurement : Measurement
        What was measured, how, and where the records are.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        With the measurement's name, when its records do not allow it.
    """
    try:
        found = IDENTIFY[measurement.method](campaign, measurement, progress)
        return replace(found, warnings=(*found.warnings, *sign_warnings(found.compliance)))
    except InputError as error:
        message = str(error)
        named = message if measurement.name in message else f"measurement '{measurement.name}': {message}"
        raise InputError(named) from error


def check_sweep(campaign: Campaign, measurement: Measurement) -> None:
    """Refuse a sweep whose passes are dependent by geometry, before any record is read.

    Raises
    ------
    InputError
        With the name of the measurement.
    """
    if measurement.method != "sweep" or campaign.tool is None:
        return
    try:
        check_independent([_pass_of(campaign.tool, entry) for entry in measurement.records])
    except InputError as error:
        raise InputError(f"measurement '{measurement.name}': {error}") from error


def _pass_of(tool: Tool, entry: RecordEntry) -> tuple[str, Engagement]:
    """Return what a pass is called and its arc of engagement."""
    assert entry.cut is not None
    assert entry.width_of_cut is not None
    return f"{entry.cut} {entry.width_of_cut * 1e3:g} mm", engagement(entry.cut, entry.width_of_cut, tool.diameter)


def sign_warnings(compliance: xr.Dataset) -> tuple[str, ...]:
    """Return a warning for each direct compliance that gives out energy.

    With ``exp(+j w t)`` a passive machine has ``Im Phi_ii < 0`` at its driving point. A force or a motion of the wrong
    sign turns it round; a dynamometer under the work, which measures the reaction, is the usual reason. Lines count
    where the imaginary part is above three standard deviations and a tenth of the magnitude, and of the other direct
    compliances, too: hits that lean and sensors that are turned bring so much of those along. More than half of them
    must turn round, and more than half of their energy as mobilities: below its modes a machine hardly moves, and
    integrated noise is large.
    """
    out = []
    array = compliance["compliance"]
    for axis in (a for a in array["response"].values if a in array["excitation"].values):
        phi = array.sel(response=axis, excitation=axis).values
        if compliance.attrs.get("method") == "frf" and rising_phase(compliance["frequency"].values, phi):
            out.append(turned_text([axis + axis]))
            continue
        largest = np.fmax.reduce([np.abs(phi), *_other_direct(array, axis)])  # NaN where none is known
        clear = np.abs(phi.imag) > 0.1 * largest
        if "compliance_std" in compliance:
            std = compliance["compliance_std"].sel(response=axis, excitation=axis).values
            clear &= ~(np.abs(phi.imag) <= 3.0 * np.nan_to_num(std))
        enough = clear.any() and int(clear.sum()) >= min(_FEWEST_CLEAR, 0.2 * phi.size)
        wrong = float(np.mean(phi.imag[clear] > 0.0)) if enough else 0.0
        energy = (compliance["frequency"].values * phi.imag)[clear] ** 2
        if wrong > 0.5 and float(energy[phi.imag[clear] > 0.0].sum()) > 0.5 * float(energy.sum()):
            out.append(
                f"the direct compliance {axis}{axis} gives out energy (positive imaginary part) at {100 * wrong:.0f} % "
                "of its clear lines: force or motion has the wrong sign, or they are not measured at the same point. "
                "Forces act on the tool; a dynamometer under the work measures the reaction: declare sign = -1 on its "
                "channels. Lobes from this measurement are wrong"
            )
    return tuple(out)


_FEWEST_CLEAR = 10
"""Lines of a direct compliance that must be clear before its sign is judged: of a few noise makes any sign."""


def _other_direct(array: xr.DataArray, axis: str) -> Iterator[Real]:
    """Yield the magnitudes of the other direct compliances."""
    for other in array["response"].values:
        if other != axis and other in array["excitation"].values:
            yield np.abs(array.sel(response=other, excitation=other).values)


def records_of(entry: RecordEntry, only_force: str | None = None) -> list[xr.Dataset]:
    """Read the records of an entry; of the force channels only the one that excites, where that is known."""
    if entry.held:
        return [record if only_force is None else _with_force(record, only_force) for record in entry.held]
    channels = {
        name: channel
        for name, channel in entry.channels.items()
        if only_force is None or not name.startswith("force_") or name == f"force_{only_force}"
    }
    found = [record for file in entry.files for record in read_records(file, channels)]
    for other in entry.others:
        added = read_records(other.file, other.channels)
        if len(found) != 1 or len(added) != 1:
            raise InputError(f"{other.file.name} is added to {entry.files[0].name}: both must have one segment")
        if other.shared is None:
            found = [put_on_time(found[0], added[0], other.offset)]
        else:
            found = [put_on_clock(found[0], added[0], other.shared)]
    return found


def _with_force(record: xr.Dataset, axis: str) -> xr.Dataset:
    """Return a record in memory with the force that excites alone."""
    if axis_present(record, "force") in ([], [axis]):
        return record
    return record.assign(force=record["force"].where(record["axis"] == axis))


def _hammer(campaign: Campaign, measurement: Measurement, progress: Progress) -> Identification:
    records = _records_by_axis(measurement)
    found = identify_hammer(measurement.name, records, **hammer_settings(measurement))
    return replace(found, warnings=(*found.warnings, *_notes(r for same in records.values() for r in same)))


def _notes(records: Iterable[xr.Dataset]) -> tuple[str, ...]:
    """Return what was noticed while records were read."""
    return tuple(line for record in records for line in record.attrs.get("notes", "").splitlines())


def _records_by_axis(measurement: Measurement) -> dict[str, list[xr.Dataset]]:
    records: dict[str, list[xr.Dataset]] = {}
    for entry in measurement.records:
        assert entry.excitation is not None
        records.setdefault(entry.excitation, []).extend(records_of(entry, entry.excitation))
    return records


def hammer_settings(m: Measurement) -> dict[str, Any]:
    """Return what a hammer measurement of a campaign says to `smfe.identification.hammer.hammer.identify_hammer`."""
    moves = m.feed is not None and any(v != 0.0 for v in m.feed.values())
    remove = moves if m.remove_background is None else m.remove_background
    return {
        "frequency_range": m.frequency_range,
        "resolution": m.resolution,
        "gate_force": bool(m.force_window),
        "rules": HitRules(full_scale=m.full_scale),
        "averaging": Averaging(m.estimator or "H1", exponential_window=m.exponential_window),
        "background": Background() if remove else None,
        "accelerometer_mass": m.accelerometer_mass or 0.0,
    }


def split_levels(
    campaign: Campaign, folder: Path | None = None, failures: Failures | None = None
) -> dict[str, xr.Dataset]:
    """Identify the hammer measurements that ask for it once more, each force level for itself.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    folder : path, optional
        Where results are kept, and found again while neither records nor settings have changed.
    failures : list of Failure, optional
        Collects measurements for which it fails, by their level; those that have failed already are left out.

    Returns
    -------
    dict
        "NAME, by level" -> compliance with the dimension ``force_level`` [N].

    Raises
    ------
    InputError
        With the measurement's name and the level.
    """
    failed = {f.name for f in failures or () if f.part == MEASUREMENT}
    out = {}
    for m in campaign.measurements:
        if m.method == "hammer" and m.split_levels and m.name not in failed:
            name = f"{m.name}, by level"
            with attempt(failures, MEASUREMENT, name):
                out[name] = _by_level(campaign, m, folder)
    return out


def _by_level(campaign: Campaign, m: Measurement, folder: Path | None) -> xr.Dataset:
    path = None if folder is None else folder / f"{m.name}, by level-{_key(campaign, m)}.nc"
    if path is not None and path.is_file():
        try:
            return kept_groups(path)["by_level"]
        except (InputError, KeyError):
            path.unlink()
    found = hammer_levels(m.name, _records_by_axis(m), **hammer_settings(m)).compliance
    if path is not None and folder is not None:
        _forget(folder, f"{m.name}, by level")
        keep_groups(path, {"by_level": found})
    return found


def _actuator(campaign: Campaign, m: Measurement, progress: Progress) -> Identification:
    records = _records_by_axis(m)
    found = identify_shaken(
        m.name,
        records,
        period=m.period,
        settling=m.settling,
        frequency_range=m.frequency_range,
        resolution=m.resolution,
        estimator=m.estimator,
    )
    compliance, notes = without_mass(found.compliance, (m.frame_mass or 0.0) + (m.accelerometer_mass or 0.0))
    noticed = _notes(r for same in records.values() for r in same)
    return replace(found, compliance=compliance, warnings=(*found.warnings, *notes, *noticed))


def passes_and_band(campaign: Campaign, measurement: Measurement) -> tuple[list[SweepPass], tuple[float, float]]:
    """Return the passes of a sweep measurement with their arcs, and the band [Hz] that is identified.

    Raises
    ------
    InputError
        When a record cannot be read, or nothing says which band the sweeps cover.
    """
    assert campaign.tool is not None
    passes = []
    for entry in measurement.records:
        name, arc = _pass_of(campaign.tool, entry)
        for number, record in enumerate(_sweep_records(measurement, entry)):
            force = _compensated(measurement, record)
            label = name + (f" ({number + 1})" if number else "")
            passes.append(SweepPass(force, label, arc, entry.spindle_speed))
    return passes, measurement.frequency_range or tooth_passing_band(passes, campaign.tool.teeth)


def _sweep_records(measurement: Measurement, entry: RecordEntry) -> list[xr.Dataset]:
    """Read the records of a pass, at a lower sample rate where the band is known and needs no more."""
    band, follows = (
        measurement.frequency_range,
        measurement.references == "spindle" or measurement.estimator == "orders",
    )
    if band is None or entry.others or follows or measurement.background:
        return records_of(entry)
    highest = band[1] + 2.0 * max(LocalPolynomial().half_widths)  # the band that the widest fit reaches to
    if entry.held:
        return [reduced(record, highest) for record in entry.held]
    channels = {name: channel for name, channel in entry.channels.items() if name != "tacho"}
    return [record for file in entry.files for record in read_reduced(file, channels, highest)]


def _compensated(measurement: Measurement, record: xr.Dataset) -> xr.Dataset:
    return record if measurement.dynamometer is None else compensate(record, measurement.dynamometer)


def sweep_estimator(campaign: Campaign, measurement: Measurement) -> Estimator | Orders:
    """Return the estimator that a sweep measurement asks for."""
    assert campaign.tool is not None
    teeth = campaign.tool.teeth
    fine, coarse = measurement.resolution or 0.25, measurement.resolution or 0.5
    single = measurement.references == "x"
    match measurement.estimator or ("single_reference" if single else "local_polynomial"):
        case "single_reference":
            return SingleReference(resolution=fine)
        case "bands":
            return replace(BANDS, resolution=fine)
        case "segments":
            return Segments(coarse)
        case "orders":
            return Orders(teeth, resolution=fine)
    return LocalPolynomial(
        fine,
        instrument_teeth=teeth if measurement.references == "spindle" else None,
        position_dependent=measurement.position_dependent,
    )


def _sweep(campaign: Campaign, measurement: Measurement, progress: Progress) -> Identification:
    passes, band = passes_and_band(campaign, measurement)
    background = [
        SweepPass(_compensated(measurement, record), f"background {path.name}")
        for path in measurement.background
        for record in read_records(path, measurement.channels)
    ]
    estimator = sweep_estimator(campaign, measurement)
    subtracted = background if isinstance(estimator, LocalPolynomial) else []
    what = f"identifying {measurement.name}"
    found = identify_sweep(
        measurement.name,
        passes,
        band,
        estimator,
        lambda done, of: progress(what, done, of),
        axes=measurement.axes,
        background=subtracted,
        reciprocal=measurement.reciprocal,
        teeth=campaign.tool.teeth if campaign.tool else None,
    )
    if len(subtracted) == len(background):
        return found
    text = "the background record is not subtracted: only the estimator 'local_polynomial' does"
    return replace(found, warnings=(*found.warnings, text))


def tooth_passing_band(passes: list[SweepPass], teeth: int) -> tuple[float, float]:
    """Return the band [Hz] from the lowest tooth passing frequency to twice the highest, as all passes cover it.

    Raises
    ------
    InputError
        When a record carries no spindle speed or angle.
    """
    lows, highs = [], []
    for p in passes:
        if "spindle_speed" in p.record:
            speed = p.record["spindle_speed"].values / 60.0
        elif "spindle_angle" in p.record:
            angle = np.unwrap(p.record["spindle_angle"].values)
            speed = np.gradient(angle) / (2.0 * np.pi * sample_interval(p.record))
        else:
            raise InputError(
                f"pass '{p.label}' records no spindle speed, so the band it excites is not known; give the "
                'measurement frequency_range = ["20 Hz", "80 Hz"] or declare spindle_speed in [channels]'
            )
        # The spindle may spin up or stop in the air: only what is turned in the cut excites.
        force = np.sqrt(np.nansum(p.record["force"].values ** 2, axis=0))
        cutting = speed[force > 0.1 * force.max()]
        lows.append(teeth * float(np.percentile(cutting, 1.0)))
        highs.append(teeth * float(np.percentile(cutting, 99.0)))
    low, high = float(np.ceil(max(lows))), float(np.floor(2.0 * min(highs)))
    if not low < high:
        raise InputError(
            f"the passes have no band in common: the tooth passing frequency begins above {low:g} Hz in one and its "
            f"second harmonic ends below {high:g} Hz in another; sweep all passes over the same speeds"
        )
    return low, high


IDENTIFY: dict[str, Callable[[Campaign, Measurement, Progress], Identification]] = {
    "hammer": _hammer,
    "actuator": _actuator,
    "sweep": _sweep,
    "frf": lambda campaign, measurement, progress: identify_averaged(measurement),
}
"""Method of a measurement -> what identifies it; `smfe.campaign.methods` says what each reads of the campaign file."""


def cached_identification(
    campaign: Campaign, measurement: Measurement, folder: Path | None, progress: Progress = silent
) -> tuple[Identification, bool]:
    """Return the identification of a measurement, from `folder` when it is there, and whether it was.

    Without a folder, and of records in memory, nothing is kept.
    """
    if folder is None or any(entry.held for entry in measurement.records):
        return identify_measurement(campaign, measurement, progress), False
    path = folder / f"{measurement.name}-{_key(campaign, measurement)}.nc"
    if path.is_file():
        try:
            return _load(path, measurement), True
        except InputError:
            path.unlink()
    found = identify_measurement(campaign, measurement, progress)
    _forget(folder, measurement.name)
    tables = {name: frame.to_csv(index=False) for name, frame in found.tables.items()}
    dataset = pack_warnings(found.compliance, found.warnings).assign_attrs(tables=json.dumps(tables))
    keep_groups(path, {"identification": dataset, **{f"blows_{a}": hits for a, hits in found.hits.items()}})
    return found, False


def _forget(folder: Path, name: str) -> None:
    """Delete what was kept of a measurement, whatever its name is to a pattern."""
    for old in folder.glob(f"{glob.escape(name)}-{'[0-9a-f]' * 16}.nc"):
        old.unlink()


def _key(campaign: Campaign, measurement: Measurement) -> str:
    # Which depth of cut a measurement has follows from its records, and not every caller asks for it.
    settings = repr((__version__, FORM, campaign.tool, replace(measurement, depth_of_cut=None)))
    files = [f for entry in measurement.records for f in entry.all_files] + list(measurement.background)
    hashes = [file_hash(f) for f in files]
    return hashlib.sha256("\n".join([settings, *hashes]).encode()).hexdigest()[:16]


def _load(path: Path, measurement: Measurement) -> Identification:
    groups = kept_groups(path)
    dataset = groups["identification"]
    tables: Mapping[str, str] = json.loads(dataset.attrs.pop("tables"))
    frames = {
        name: pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=[""]) for name, text in tables.items()
    }
    warnings = tuple(unpack_warnings(dataset))
    del dataset.attrs["warnings"]
    single = {name[-1]: hits for name, hits in groups.items() if name.startswith("blows_")}
    return Identification(measurement.name, measurement.method, dataset, frames, warnings, single)
