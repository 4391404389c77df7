"""The campaign as the rest of the package sees it: files found, quantities in SI, channels merged."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from pydantic import ValidationError

from process import units
from process.cut.engagement import (
    CUTS,
    AnyEngagement,
    Engagement,
    engagement,
    engagement_of_offset,
    engagement_of_strips,
    width_of,
)
from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import FrictionLaw, MemoryLaw
from process.labels import RECORD_SCALARS
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.notebook import html_table
from process.types import Real
from smfe.campaign import schema
from smfe.campaign.checks import channel_complaints, check, complaints, merge, path
from smfe.campaign.datasets import Show
from smfe.campaign.machine import MACHINE, GivenAxis
from smfe.campaign.places import Loc, line_of, lines_of, place, syntax_advice
from smfe.campaign.schema import PlanTable
from smfe.campaign.tolerances import Tolerances, TolerancesTable
from smfe.campaign.tune import TuneTable
from smfe.records.dynamometer import Dynamometer
from smfe.records.formats.channels import COMPLIANCE_CHANNELS, RECORD_CHANNELS, Channel, did_you_mean
from stability import SpindleRange, Spread

COEFFICIENT_SPREAD = 0.1
"""Relative standard deviation of cutting coefficients where ``[material]`` states none.

Forces predicted with coefficients that were fitted over speeds and immersions lie within 20 % of the nominal ones for
aluminium, carbon steel and stainless steel, at a level of 95 % (ASME Manufacturing Science and Engineering Conference
2009, MSEC2009-43628, page 137): two standard deviations. Coefficients of a handbook are known worse.
"""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What a measurement or a record was made under; None where the campaign does not say.

    Parameters
    ----------
    controller : str, optional
        Name of the controller setting.
    feed : mapping of str to float, optional
        Axis -> feed [m/s], all three axes.
    force_level : float, optional
        Amplitude of the excitation [N].
    depth_of_cut, feed_per_tooth : float, optional
        [m].
    position : str, optional
        Name of the posture of the machine.
    added_mass : float, optional
        Mass of what was attached to measure [kg].
    temperature : float, optional
        [degC].
    started : datetime or date, optional
        When it was made.
    repeat : int, optional
        Number of the repetition.
    """

    controller: str | None = None
    feed: Mapping[str, float] | None = None
    force_level: float | None = None
    depth_of_cut: float | None = None
    feed_per_tooth: float | None = None
    position: str | None = None
    added_mass: float | None = None
    temperature: float | None = None
    started: datetime | date | None = None
    repeat: int | None = None


@dataclass(frozen=True)
class OtherRecorder:
    """One entry of ``with``: what a second recorder wrote meanwhile, on a clock of its own.

    Parameters
    ----------
    file : Path
        Its file.
    channels : mapping of str to Channel
        Channels of it; nothing is inherited.
    shared : str or None
        The channel that both recorders have, by which the clocks are aligned. None: they share a clock.
    offset : float
        Time of its clock less that of the first file [s], where they share one.
    """

    file: Path
    channels: Mapping[str, Channel]
    shared: str | None
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RecordEntry(Conditions):
    """One entry of ``records``: files that belong together, with conditions inherited from their measurement.

    Parameters
    ----------
    files : tuple of Path
        Sorted; each is read with ``read_records(file, channels)``, or with `read_frf` where the method is "frf".
    channels : mapping of str to Channel
        Campaign's, measurement's and the record's own declarations merged.
    excitation, response : str, optional
        Axes at the tool tip (hammer, actuator, frf; response: frf), or places "NODE:axis" (frf).
    cut : str, optional
        "down", "up" or "central" (sweep).
    width_of_cut : float, optional
        [m] (sweep).
    spindle_speed : (float, float), optional
        Stated where the cut begins and ends [rad/s] (sweep).
    others : tuple of OtherRecorder
        Files of other recorders that belong to the one file of the entry; often empty.
    held : tuple of xarray.Dataset
        Records in memory instead of files.
    """

    files: tuple[Path, ...]
    channels: Mapping[str, Channel]
    excitation: str | None = None
    response: str | None = None
    cut: str | None = None
    width_of_cut: float | None = None
    spindle_speed: tuple[float, float] | None = None
    others: tuple[OtherRecorder, ...] = ()
    held: tuple[xr.Dataset, ...] = field(default=(), repr=False, compare=False)

    @property
    def all_files(self) -> tuple[Path, ...]:
        """The files of all recorders."""
        return (*self.files, *(other.file for other in self.others))


@dataclass(frozen=True, kw_only=True)
class Processing:
    """How the records of a measurement become a compliance; None: the usual way.

    Parameters
    ----------
    estimator : str, optional
        "H1", "H2" or "Hv" (hammer).
    force_window : bool, optional
        Whether the force is set to zero outside contact (hammer).
    exponential_window : float, optional
        Time constant of a window that is taken off again [s] (hammer).
    remove_background : bool, optional
        Whether motion between hits is removed (hammer). None: where the campaign declares a feed.
    split_levels : bool, optional
        Whether each force level is also identified for itself (hammer), or each depth of cut (sweep). None: hammer no,
        sweep yes.
    full_scale : float, optional
        Range of the force channel [N] (hammer).
    accelerometer_mass : float, optional
        At the driving point, taken off [kg] (hammer, actuator).
    frame_mass : float, optional
        Between force sensor and tool, taken off [kg] (actuator).
    period : float, optional
        Of a force or setpoint that repeats itself [s] (actuator, loop, open_loop). None: a stepped sine; found
        (loop, open_loop).
    settling : float, optional
        Dropped at the beginning of each step, or of a periodic record [s] (actuator, loop, open_loop).
    hold : float, optional
        Time for which a value of the recorded drive force acts unchanged [s] (open_loop). None: it is measured.
    averages : int, optional
        Independent averages behind a response and its coherence (frf).
    conjugate : bool, optional
        Whether the response was written with ``exp(-j w t)`` (frf).
    moving_mass : tuple of (float, str), optional
        What a drive moves, where it is known: a "mass" [kg] or an "inertia" [kg m^2] (drive).
    spindle_speed : float, optional
        Of the spindle that turns in air [rad/s] (hammer, actuator).
    sensor : str, optional
        "accelerometer", "laser" or "two" accelerometers (hammer, actuator).
    free_mass : float, optional
        On soft springs in the machine's place, to calibrate [kg] (hammer, actuator).
    """

    estimator: str | None = None
    force_window: bool | None = None
    exponential_window: float | None = None
    remove_background: bool | None = None
    split_levels: bool | None = None
    full_scale: float | None = None
    accelerometer_mass: float | None = None
    frame_mass: float | None = None
    period: float | None = None
    settling: float | None = None
    hold: float | None = None
    averages: int | None = None
    conjugate: bool | None = None
    moving_mass: tuple[float, str] | None = None
    spindle_speed: float | None = None
    sensor: str | None = None
    free_mass: float | None = None


@dataclass(frozen=True, kw_only=True)
class Measurement(Conditions, Processing):
    """One ``[[measurement]]``.

    Parameters
    ----------
    name : str
        Unique among measurements and models.
    method : str
        "hammer", "actuator", "sweep", "frf", "drive", "open_loop", "loop" or "silent".
    records : tuple of RecordEntry
        At least one.
    channels : mapping of str to Channel
        Campaign's and measurement's declarations merged; those for `background`.
    background : tuple of Path
        Records of the spindle without a cut (sweep); often empty.
    frequency_range : (float, float), optional
        [Hz].
    resolution : float, optional
        [Hz].
    references : str
        "all"; "spindle" with the passing of the teeth as instrument; "x" for a single reference (sweep).
    axes : tuple of str
        Axes of the forces that are references (sweep).
    reciprocal, position_dependent : bool
        Constrain the compliance to be symmetric; let it change along the pass (sweep).
    dynamometer : Dynamometer, optional
        Force sensor whose inertia and resonance are compensated (sweep).
    held_out : bool
        Held out by a diagnosis, and compared once at its very end.
    """

    name: str
    method: str
    records: tuple[RecordEntry, ...]
    channels: Mapping[str, Channel]
    background: tuple[Path, ...] = ()
    frequency_range: tuple[float, float] | None = None
    resolution: float | None = None
    references: str = "all"
    axes: tuple[str, ...] = ("x", "y", "z")
    reciprocal: bool = False
    position_dependent: bool = False
    dynamometer: Dynamometer | None = None
    held_out: bool = False

    def settings(self) -> dict[str, Any]:
        """Return method, conditions and processing as plain values for a protocol, without what is not given."""
        names = ["method", *(f.name for part in (Conditions, Processing) for f in fields(part))]
        names += ["frequency_range", "resolution", "references"]
        values = {name: getattr(self, name) for name in names}
        values["started"] = self.started.isoformat() if self.started else None
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class Model:
    """One ``[[model]]``: a compliance given as modes; `spread` is None where its uncertainty is not stated."""

    name: str
    modal: ModalModel
    spread: Spread | None = None


@dataclass(frozen=True)
class AxisModel:
    """``[baseline]`` that predicts compliances: one feed axis of two masses.

    Parameters
    ----------
    axis : str
        Its name.
    drive : Drive
        Masses, stiffness, damping; no servo, no friction.
    servos : mapping of str to Servo
        Controller name -> servo; a single one has the empty name.
    friction : FrictionLaw or MemoryLaw
        What the simulation takes for friction.
    evidence : tuple of str, optional
        What it is compared with besides compliances: "drive" records, "limits" that the cutting tests bracket.
    period : float, optional
        Of the samples of its control [s]; zero: its gains are those that act; None: not known.
    """

    axis: str
    drive: Drive
    servos: Mapping[str, Servo]
    friction: FrictionLaw | MemoryLaw
    evidence: tuple[str, ...] = ()
    period: float | None = None


@dataclass(frozen=True)
class RigidDrive:
    """``[baseline]`` that predicts the drive force of a moving axis: rigid, with viscous friction.

    Parameters
    ----------
    axis : str
        Its name.
    moving_mass : float, optional
        [kg]; None: found from the records alone.
    Kp, Kv : float, optional
        Velocity gain [N s/m] and position gain [1/s]; None: the control law is not tested.
    delay : float
        Known delay from the logged to the acting force [s].
    friction : FrictionLaw, optional
        What is known of the friction of the guideways; its viscous part is found from the records.
    """

    axis: str
    moving_mass: float | None = None
    Kp: float | None = None
    Kv: float | None = None
    delay: float = 0.0
    friction: FrictionLaw | None = None


@dataclass(frozen=True)
class MechanisticForces:
    """``[baseline]`` that predicts the forces of the cutting tests from ``[tool]`` and ``[material]``."""


@dataclass(frozen=True)
class ModesOf:
    """``[baseline]`` that predicts compliances from those of one measurement or model.

    Parameters
    ----------
    source : str
        Name of the measurement or model.
    axes : mapping of str to GivenAxis, optional
        Feed axes that carry these modes, as ``[machine.axis.x]`` describes them; none: the modes alone.
    """

    source: str
    axes: Mapping[str, GivenAxis] = field(default_factory=dict)


@dataclass(frozen=True)
class LimitsOf:
    """``[baseline]`` that predicts the limits which cutting tests found, from the modes of one model.

    Parameters
    ----------
    source : str
        Name of the model.
    """

    source: str


Baseline = AxisModel | RigidDrive | MechanisticForces | ModesOf | LimitsOf
"""The simulation that a diagnosis questions."""


@dataclass(frozen=True)
class LobeRequest:
    """One ``[[lobes]]`` at one width of cut.

    Parameters
    ----------
    measurements : tuple of str
        Names of measurements or models.
    method : str
        "zero_order", "multi_frequency", "semi_discretization" or "operating_point".
    cut : str
        "down", "up", "central", or "offset", "angles", "strips", of which `engaged` holds the arcs.
    width_of_cut, feed_per_tooth : float
        [m]; the width of all strips together.
    spindle_speed : ndarray
        Spindle speeds [rpm].
    maximum_depth : float or None
        Greatest depth that can be cut [m].
    feed_direction : float
        Direction in which the cut is fed [rad], from +x of the measurements towards +y.
    feed : float or None
        Feed of an operating point [m/s]; None: feed per tooth times teeth times speed.
    controller, position : str or None
        Of an operating point: the only ones that are asked for; None: each by itself.
    process_damping : ProcessDamping
        Of the worn flank; a sharp edge by default.
    bands_up_to : float or None
        Depth up to which all bands of depth are asked for, islands included [m]; None: the limit alone.
    maps_up_to : float or None
        Depth up to which vibration, surface error, force, torque and power are asked for as maps [m].
    spindle_power, spindle_torque : float or None
        Mean power and torque that the cut may take [W, N m].
    deflection, surface_error : float or None
        Largest deflection of the tool, and error of the wall, that are allowed [m].
    name, table : str
        What it is called in every output, "lobes_1", or "lobes_1_20mm" where its table has several widths; and what
        all widths of the table are called together, "lobes_1".
    listed : bool
        The speeds were named one by one, and each is a candidate; else they are steps of a range.
    engaged : Engagement, Engagements or None
        Where the teeth are in the work, where `cut` is not one of the three kinds.
    """

    measurements: tuple[str, ...]
    method: str
    cut: str
    width_of_cut: float
    feed_per_tooth: float
    spindle_speed: Real = field(repr=False)
    maximum_depth: float | None = None
    feed_direction: float = 0.0
    feed: float | None = None
    controller: str | None = None
    position: str | None = None
    process_damping: ProcessDamping = NO_DAMPING
    bands_up_to: float | None = None
    maps_up_to: float | None = None
    spindle_power: float | None = None
    spindle_torque: float | None = None
    deflection: float | None = None
    surface_error: float | None = None
    name: str = "lobes_1"
    table: str = "lobes_1"
    listed: bool = False
    engaged: AnyEngagement | None = None

    def arc(self, diameter: float) -> AnyEngagement:
        """Return where the teeth of a tool [m] are in the work."""
        if self.cut in CUTS:
            return engagement(self.cut, self.width_of_cut, diameter)
        assert self.engaged is not None
        return self.engaged


@dataclass(frozen=True)
class CuttingTest:
    """One ``[[cutting_test]]``.

    Parameters
    ----------
    file : Path
        Its record.
    channels : mapping of str to Channel
        Campaign's and the test's declarations merged.
    spindle_speed : float
        [rpm].
    depth_of_cut, width_of_cut : float
        [m].
    feed_per_tooth : float, optional
        [m]; None where only a verdict is asked.
    cut : str
        "down", "up" or "central".
    observed : str, optional
        "stable" or "chatter": the engineer's own verdict.
    controller : str, optional
        Tuning of the controller during the cut.
    position : str, optional
        Posture of the machine during the cut.
    feed : mapping of str to float, optional
        Axis -> feed [m/s].
    quantity : str, optional
        What is judged: "acceleration", "displacement", "force", "sound". None: the first of them that was recorded.
    interval : (float, float), optional
        Part of the record to judge [s]. None: the cut that is found in it.
    axes : tuple of str, optional
        Axes to judge. None: all that were recorded.
    frequency_range : (float, float), optional
        Band that is judged [Hz].
    floor : (float, str), optional
        Least amplitude that counts (SI), and the quantity it is one of.
    half_order_reference : float, optional
        ``half_order_ratio`` of a stable cut with the same tool.
    held_out : bool
        Held out by a diagnosis, and compared once at its very end.
    """

    file: Path
    channels: Mapping[str, Channel]
    spindle_speed: float
    depth_of_cut: float
    cut: str
    width_of_cut: float
    feed_per_tooth: float | None = None
    observed: str | None = None
    controller: str | None = None
    position: str | None = None
    feed: Mapping[str, float] | None = None
    quantity: str | None = None
    interval: tuple[float, float] | None = None
    axes: tuple[str, ...] | None = None
    frequency_range: tuple[float, float] | None = None
    floor: tuple[float, str] | None = None
    half_order_reference: float | None = None
    held_out: bool = False

    @property
    def stated_feed_per_tooth(self) -> float:
        """The feed per tooth [m], where it is needed."""
        if self.feed_per_tooth is None:
            raise InputError(f"cutting test '{self.file.name}' has no feed_per_tooth; add feed_per_tooth = \"0.1 mm\"")
        return self.feed_per_tooth


@dataclass(frozen=True)
class MachineLimits:
    """What tool and machine can do, each None where the campaign does not say; SI.

    Parameters
    ----------
    edge_length : float, optional
        Usable length of the cutting edges [m], along the edge.
    power, torque : float, optional
        That the spindle gives all day [W, N m].
    feed : float, optional
        Greatest feed of the table [m/s].
    """

    edge_length: float | None = None
    power: float | None = None
    torque: float | None = None
    feed: float | None = None


@dataclass(frozen=True)
class Campaign:
    """A campaign file, read and checked.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Title for the report.
    tool : Tool or None
        None only where nothing needs it.
    coefficients : CuttingCoefficients or None
        None only where nothing needs them.
    material : str or None
        Name of the work material.
    coefficient_spread : float or None
        Relative standard deviation of the cutting coefficients, which move together, as the file states it; None: it
        does not, and `COEFFICIENT_SPREAD` is taken.
    missing_coefficients : tuple of str
        Cutting coefficients that ``[material]`` does not give and that are taken as zero: Krc, Kac.
    spindle : SpindleRange
        What it can be set to.
    channels : mapping of str to Channel
        Channels of a record as the whole campaign declares them.
    measurements, models, lobes, cutting_tests : tuple
        In the order of the file.
    baseline : Baseline or None
        The simulation to be tested, where the campaign gives one.
    plan : PlanTable or None
        What a sweep may use, for `smfe plan`.
    tune : TuneTable or None
        Which gains `smfe tune` is to find.
    tool_name, machine : str
        As the shop calls them; where it does not say, by diameter and teeth, and by the name of the campaign.
    machine_limits : MachineLimits
        What tool and machine can do.
    machine_spread : mapping of str to float, optional
        Relative standard deviations of the machine of ``[machine]``: friction, mass, damping, stiffness.
    machine_model : Machine, ModalModel or None
        What ``[machine]`` is made of, where the campaign says it: with axes, joints or postures a machine that
        `Machine.at` linearises at a feed, controller and position; of modes alone also one of `models`, "machine".
    tolerances : Tolerances
        How well it was measured and declared, and what is too small to matter.
    known : mapping
        Causes that belong to the baseline: key -> parameter -> value with its unit, as ``finding.json`` has them.
    """

    path: Path
    name: str
    tool: Tool | None = None
    coefficients: CuttingCoefficients | None = None
    material: str | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    measurements: tuple[Measurement, ...] = ()
    models: tuple[Model, ...] = ()
    lobes: tuple[LobeRequest, ...] = ()
    cutting_tests: tuple[CuttingTest, ...] = ()
    baseline: Baseline | None = None
    coefficient_spread: float | None = None
    missing_coefficients: tuple[str, ...] = ()
    spindle: SpindleRange = field(default_factory=SpindleRange)
    plan: PlanTable | None = None
    tune: TuneTable | None = None
    tool_name: str = ""
    machine: str = ""
    machine_limits: MachineLimits = field(default_factory=MachineLimits)
    machine_model: Machine | ModalModel | None = None
    machine_spread: Mapping[str, float] | None = None
    tolerances: Tolerances = field(default_factory=Tolerances)
    known: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def coefficients_known_within(self) -> float:
        """Relative standard deviation of the cutting coefficients: as stated, else `COEFFICIENT_SPREAD`."""
        return COEFFICIENT_SPREAD if self.coefficient_spread is None else self.coefficient_spread

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the campaign reads, sorted, each once."""
        found = {file for m in self.measurements for record in m.records for file in record.all_files}
        found |= {file for m in self.measurements for file in m.background}
        return tuple(sorted(found | {test.file for test in self.cutting_tests}))

    def _repr_html_(self) -> str:
        """Return a table for a notebook: what was measured, with what, and what is asked for."""
        rows: list[tuple[object, ...]] = []
        if self.tool is not None:
            size = f"{1e3 * self.tool.diameter:g} mm, {self.tool.teeth} teeth"
            rows.append(("tool", self.tool_name or size, f"{size}, {np.degrees(self.tool.approach_angle):g}°"))
        if self.coefficients is not None:
            said = f"Ktc {1e-6 * self.coefficients.Ktc:.4g} N/mm²"
            rows.append(("material", self.material or "", said))
        for m in self.measurements:
            count = sum(len(r.files) + len(r.held) for r in m.records)
            rows.append(("measurement", m.name, f"{m.method}, {count} {'record' if count == 1 else 'records'}"))
        rows += [("model", m.name, f"{m.modal.frequency.size} modes") for m in self.models]
        if isinstance(self.machine_model, Machine):
            rows.append(("machine", self.machine, f"axes {', '.join(self.machine_model.axes) or 'none'}"))
        for number, r in enumerate(self.lobes, 1):
            speeds = f"{r.spindle_speed[0]:g} to {r.spindle_speed[-1]:g} rpm"
            rows.append((f"lobes_{number}", ", ".join(r.measurements), f"{r.cut}, {r.method}, {speeds}"))
        if self.cutting_tests:
            rows.append(("cutting tests", len(self.cutting_tests), ""))
        if self.baseline is not None:
            rows.append(("baseline", type(self.baseline).__name__, ""))
        return html_table(self.name, rows)


def load_campaign(path: str | Path | Campaign, show: Show | None = None) -> Campaign:
    """Read a campaign file.

    Parameters
    ----------
    path : str, Path or Campaign
        TOML file; names of files in it are relative to its folder. A campaign that was read is returned as it is.
    show : callable, optional
        Called with the licence before a public data set is fetched. None: nothing is fetched.

    Returns
    -------
    Campaign
        Files found, quantities in SI (spindle speeds in rpm), channels merged.

    Raises
    ------
    InputError
        With every error of the file at once, each with its place.
    """
    if isinstance(path, Campaign):
        return path
    if not isinstance(path, Path | str):
        raise InputError(
            f"{type(path).__name__} is no campaign; give the path of its file, or what smfe.read_campaign returns"
        )
    path = Path(path).absolute()
    raw = read_toml(path)
    if "scenario" in raw and "campaign" not in raw:
        raise InputError(f"{path.name}: this is a scenario; smfe simulate {path.name} makes a campaign of it")
    found, table = check(raw), schema.file_table(raw)
    try:
        file = table.model_validate(raw, context={"path": path, "show": show})
    except ValidationError as error:
        found = complaints(error, table) + found
    if found:
        raise InputError(report(path, found))
    return _build(path, file)


def campaign_of_tables(
    tables: Mapping[str, Any], held: Mapping[str, Sequence[xr.Dataset]] | None = None, name: str = "campaign"
) -> Campaign:
    """Build a campaign from tables as a file holds them: what a file would be refused for is refused here, too.

    Parameters
    ----------
    tables : mapping
        ``tool``, ``material``, ``measurement``, ``lobes``, ... with plain values. Numbers are SI, texts have units.
    held : mapping of str to sequence of xarray.Dataset, optional
        Name that an entry of ``records`` gives as its file -> records in memory.
    name : str, optional
        What the campaign is called.

    Returns
    -------
    Campaign
        Its path names no file.

    Raises
    ------
    InputError
        With every error at once, each with its key.
    """
    raw: dict[str, Any] = {"campaign": {"name": name}, **{key: _plain(value) for key, value in tables.items()}}
    here = Path.cwd() / name
    with units.numbers_are_si():
        found, table = check(raw), schema.file_table(raw)
        try:
            file = table.model_validate(raw, context={"path": here, "show": None, "held": set(held or ())})
        except ValidationError as error:
            found = complaints(error, table) + found
    if found:
        raise InputError("; ".join(f"{_key(where)}: {text}" if where else text for where, text in found))
    campaign = _build(here, file)
    return replace(campaign, measurements=tuple(_holding(m, held or {}) for m in campaign.measurements))


def _plain(value: Any) -> Any:
    """Return a value as TOML would hold it: NumPy's numbers, tuples and arrays become plain ones."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return _plain(value.tolist()) if isinstance(value, np.ndarray | np.generic) else value


def _key(where: tuple[str | int, ...]) -> str:
    """Return the place of an error without the number of a table: there is one of each."""
    return path(where[2:] if len(where) > 2 and where[1] == 0 else where)


def _holding(measurement: Measurement, held: Mapping[str, Sequence[xr.Dataset]]) -> Measurement:
    entries = [
        replace(entry, files=(), held=tuple(held[entry.files[0].name])) if entry.files[0].name in held else entry
        for entry in measurement.records
    ]
    return replace(measurement, records=tuple(entries))


def load_channels(path: str | Path) -> dict[str, Channel]:
    """Read the ``[channels]`` of a campaign file, which may hold nothing else yet.

    Parameters
    ----------
    path : str or Path
        TOML file.

    Returns
    -------
    dict of str to Channel
        As a record sees them; empty where the file declares none.

    Raises
    ------
    InputError
        With every error of the file at once, each with its place; where it asks for more than channels, also with
        those of the rest.
    """
    path = Path(path).absolute()
    raw = read_toml(path)
    if set(raw) - {"channels", "campaign"}:
        return dict(load_campaign(path).channels)
    whole: dict[str, Any] = {"campaign": {"name": path.stem}, **raw}
    found, table = channel_complaints(whole), schema.file_table(whole)
    try:
        file = table.model_validate(whole, context={"path": path, "show": None})
    except ValidationError as error:
        found = complaints(error, table) + found
    if found:
        raise InputError(report(path, found))
    return _channels("cutting", _declared(file.channels))


def read_toml(file: Path, kind: str = "campaign") -> dict[str, object]:
    """Read a TOML file; `kind` names what it should have been."""
    text = ""
    try:
        text = file.read_text(encoding="utf-8-sig")  # some editors begin a file with a mark
        found = tomllib.loads(text)
        if digits := max(_digits(found), default=0):
            raise InputError(f"{file}: a whole number of {digits} digits; TOML has 19 at most")
        return found
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}){_nearest(file)}; name a {kind} file") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not UTF-8 text; save it as UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        line, advice = syntax_advice(text, error)
        raise InputError(f"{file}{'' if line is None else f', line {line}'}: {advice}") from error
    except RecursionError as error:
        raise InputError(f"{file}: lists or tables stand within one another too often; no {kind} needs that") from error
    except InputError:
        raise
    except ValueError as error:  # a whole number of thousands of digits
        raise InputError(f"{file}: cannot be read ({str(error).partition(';')[0]})") from error


def _digits(value: object) -> Iterator[int]:
    """Yield the digits of the whole numbers that have more than 64 bits."""
    if isinstance(value, int) and value.bit_length() > 63:
        yield len(str(value))
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _digits(inner)


def _nearest(file: Path) -> str:
    """Return which TOML file of the folder may be meant."""
    try:
        near = did_you_mean(file.name, [p.name for p in file.parent.iterdir() if p.suffix == ".toml"])
    except OSError:
        return f"; there is no folder '{file.parent}'"
    return near


def report(file: Path, found: list[tuple[Loc, str]]) -> str:
    """Return all complaints about a file as one message, each with its line and the name of its table."""
    text = file.read_text(encoding="utf-8-sig")  # some editors begin a file with a mark
    raw, known = tomllib.loads(text), lines_of(text)
    lines = [(line_of(known, where), f"{place(where, raw)}: {said}" if where else said) for where, said in found]
    if len(lines) == 1:
        ((number, said),) = lines
        return f"{file.name}{'' if number is None else f', line {number}'}: {said}"
    lines.sort(key=lambda line: line[0] or 0)
    shown = [said if number is None else f"line {number}: {said}" for number, said in lines]
    return "\n  ".join([f"{file.name}: {len(lines)} errors (entries of lists count from 0)", *shown])


# --- from the tables of the file to the objects -------------------------------------------------------------


def _build(file_path: Path, file: schema.CampaignFile[Any]) -> Campaign:
    base = _declared(file.channels)
    machine = file.machine_model()
    own = (Model(MACHINE, machine),) if isinstance(machine, ModalModel) else ()
    return Campaign(
        path=file_path,
        name=file.campaign.name,
        tool=file.tool.build() if file.tool else None,
        coefficients=file.material.build() if file.material else None,
        material=file.material.name if file.material else None,
        channels=_channels("cutting", base),
        measurements=tuple(_measurement(table, base) for table in file.measurement),
        models=(*(_model(table) for table in file.model), *own),
        lobes=tuple(r for number, table in enumerate(file.lobes, 1) for r in _lobes(number, table, file.tool)),
        cutting_tests=tuple(_cutting_test(table, base) for table in file.cutting_test),
        baseline=_baseline(file.baseline, file.machine) if file.baseline else None,
        coefficient_spread=None if file.material is None else file.material.uncertainty,
        missing_coefficients=tuple(n for n in ("Krc", "Kac") if file.material and getattr(file.material, n) is None),
        spindle=file.spindle.build() if file.spindle else SpindleRange(),
        plan=file.plan,
        tune=file.tune,
        tool_name=_tool_name(file.tool) if file.tool else "",
        machine=(file.machine and file.machine.name) or file.campaign.name,
        machine_limits=MachineLimits(
            file.tool.edge_length if file.tool else None,
            file.spindle.power if file.spindle else None,
            file.spindle.torque if file.spindle else None,
            file.machine.maximum_feed if file.machine else None,
        ),
        machine_model=machine,
        machine_spread=file.machine.spread() if file.machine else None,
        tolerances=_tolerances(file),
        known=(file.baseline.known or {}) if file.baseline else {},
    )


def _tolerances(file: schema.CampaignFile[Any]) -> Tolerances:
    stated = None if file.material is None else file.material.uncertainty
    return (file.tolerances or TolerancesTable()).build(COEFFICIENT_SPREAD if stated is None else stated)


def _model(table: schema.ModelTable) -> Model:
    stated = table.uncertainty
    return Model(table.name, table.build(), None if stated is None else Spread(**dict(stated)))


def _tool_name(table: schema.ToolTable) -> str:
    return table.name or f"{1e3 * table.diameter:g} mm, {table.teeth} {'tooth' if table.teeth == 1 else 'teeth'}"


def _baseline(table: Any, machine: Any) -> Baseline:
    if isinstance(table, schema.AxisBaseline):
        drive = Drive(table.moving_mass, table.tip_mass, table.stiffness, table.damping)
        return AxisModel(table.axis, drive, table.servos(), table.friction.build(), table.evidence, table.period)
    if isinstance(table, schema.DriveBaseline):
        return RigidDrive(table.axis, table.moving_mass, table.Kp, table.Kv, table.delay, table.law())
    if isinstance(table, schema.LimitsBaseline):
        return LimitsOf(table.limits)
    if isinstance(table, schema.ModesBaseline):
        return ModesOf(table.source, machine.axes() if machine else {})
    return MechanisticForces()


Declared = dict[str, Mapping[str, Any]]


def _declared(channels: schema.Channels) -> Declared:
    """Return what the file says about each channel and nothing else, so that the rest can be inherited."""
    return {name: table.model_dump(exclude_unset=True) for name, table in channels.items()}


_OF_SWEEPS = ("axes", "reciprocal", "position_dependent")


def _measurement(table: schema.MeasurementTable, base: Declared) -> Measurement:
    own = _declared(table.channels)
    inherited = merge(_for_method(table.method, base), own)
    common: dict[str, Any] = {name: getattr(table, name) for name in schema.ConditionsTable.model_fields}
    rest = ["name", "method", "frequency_range", "resolution", "references", "held_out"]
    rest += [*_OF_SWEEPS, *(f.name for f in fields(Processing))]
    return Measurement(
        **common,
        **{name: getattr(table, name) for name in rest},
        background=table.background or (),
        dynamometer=None if table.dynamometer is None else table.dynamometer.build(),
        channels=_channels(table.method, inherited),
        records=tuple(_record(record, table.method, inherited, common) for record in table.records),
    )


def _record(table: schema.RecordTable, method: str, inherited: Declared, common: Mapping[str, Any]) -> RecordEntry:
    own: dict[str, Any] = {name: getattr(table, name) for name in common}
    conditions = {name: common[name] if value is None else value for name, value in own.items()}
    rest = ("excitation", "response", "cut", "width_of_cut", "spindle_speed")
    return RecordEntry(
        **conditions,
        **{name: getattr(table, name) for name in rest},
        files=table.file,
        channels=_channels(method, merge(inherited, _declared(table.channels))),
        others=tuple(
            OtherRecorder(other.file, _channels(method, _declared(other.channels)), other.shared, other.offset or 0.0)
            for other in table.others
        ),
    )


def _for_method(method: str, base: Declared) -> Declared:
    """Leave out what a whole campaign declares for its cuts and hits.

    Other records have no spindle channels, and none of the records that nothing excites has a force.
    """
    spindle = RECORD_SCALARS if method in ("hammer", "actuator", "drive", "open_loop", "loop", "silent") else ()
    quiet = method in ("drive", "open_loop", "loop", "silent")
    return {n: entry for n, entry in base.items() if n not in spindle and not (quiet and n.startswith("force_"))}


def _channels(method: str, declared: Declared) -> dict[str, Channel]:
    wanted = COMPLIANCE_CHANNELS if method == "frf" else RECORD_CHANNELS
    return {name: Channel(**entry) for name, entry in declared.items() if name in wanted}


def _lobes(number: int, table: schema.LobesTable, tool: schema.ToolTable | None) -> Iterator[LobeRequest]:
    """Yield the requests of one table, one a width."""
    assert tool is not None  # said by `check`
    name = f"lobes_{number}"
    widths = [(w, _engaged(table, w, tool.diameter)) for w in table.width_of_cut]
    if not widths:
        arcs = _engaged(table, 0.0, tool.diameter)
        assert arcs is not None
        widths = [(width_of(arcs, tool.diameter), arcs)]
    friction = {} if table.flank_friction is None else {"friction": table.flank_friction}
    for width, engaged in widths:
        yield LobeRequest(
            table.measurements,
            table.method,
            table.cut,
            width,
            table.feed_per_tooth,
            np.asarray(table.spindle_speed.values),
            table.maximum_depth,
            table.feed_direction,
            table.feed,
            table.controller,
            table.position,
            ProcessDamping(table.process_damping, **friction),
            table.bands_up_to,
            table.maps_up_to,
            table.spindle_power,
            table.spindle_torque,
            table.deflection,
            table.surface_error,
            name=name if len(widths) == 1 else f"{name}_{1e3 * width:.6g}mm",
            table=name,
            listed=table.spindle_speed.listed,
            engaged=engaged,
        )


def _engaged(table: schema.LobesTable, width: float, diameter: float) -> AnyEngagement | None:
    """Return where the teeth are in the work, where it is none of the three kinds of cut."""
    if table.cut == "offset":
        assert table.offset is not None
        return engagement_of_offset(width, table.offset, diameter)
    if table.cut == "angles":
        assert table.entry_angle is not None
        assert table.exit_angle is not None
        return Engagement(table.entry_angle, table.exit_angle)
    return engagement_of_strips(table.strips, diameter) if table.strips else None


def _cutting_test(table: schema.CuttingTestTable, base: Declared) -> CuttingTest:
    return CuttingTest(
        file=table.file,
        channels=_channels("cutting", merge(base, _declared(table.channels))),
        spindle_speed=table.spindle_speed * 30.0 / np.pi,
        depth_of_cut=table.depth_of_cut,
        cut=table.cut,
        width_of_cut=table.width_of_cut,
        feed_per_tooth=table.feed_per_tooth,
        observed=table.observed,
        controller=table.controller,
        position=table.position,
        feed=table.feed,
        quantity=table.quantity,
        interval=table.interval,
        axes=table.axes,
        frequency_range=table.frequency_range,
        floor=table.floor,
        half_order_reference=table.half_order_reference,
        held_out=table.held_out,
    )
