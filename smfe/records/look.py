"""What a file holds, what kind of record it seems to be, and a campaign file to start from."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import check_record, restarting_rate
from process.notebook import html_table
from process.types import Real
from process.units import factor, known
from smfe.records import names_itself, read_records
from smfe.records.contents import Contents, contents
from smfe.records.formats.table import Column
from smfe.records.guess import Guess, frequency_column, guess_channels, restarting_clock
from smfe.records.kind import Kind, kind_of
from smfe.records.write import OWN_COLUMNS


@dataclass(frozen=True)
class Look:
    """What `look` found.

    Parameters
    ----------
    path : Path
        The file.
    segments : int
        Segments (records) in it; what follows is of the first.
    columns : pandas.DataFrame
        One row a column: column, channel ("" where none was recognised), unit, least, greatest, rms, remark.
    size : int
        Samples.
    sample_rate : float
        [Hz]; NaN where the file has no clock, and of an FRF.
    kind : Kind
        What kind of record it seems to be, and why.
    channels : tuple of Guess
        Columns that were recognised.
    campaign : str
        A campaign file to start from, as TOML.
    notes : tuple of str
        What else was noticed.
    found : Contents
        The columns as they stand.
    """

    path: Path
    segments: int
    columns: pd.DataFrame
    size: int
    sample_rate: float
    kind: Kind
    channels: tuple[Guess, ...]
    campaign: str
    notes: tuple[str, ...]
    found: Contents

    def _repr_html_(self) -> str:
        """Return a table for a notebook: what was found in each column, and what kind of record it seems to be."""
        names = [name for name in self.columns.columns if name != "remark"]
        rows = [[row[name] for name in names] for row in self.columns.to_dict("records")]
        return html_table(f"{self.path.name}: {self.kind.name}", rows, names, [self.kind.reason, *self.notes])

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.size / self.sample_rate


def examine(path: str | Path | xr.Dataset | pd.DataFrame, folder: str | Path | None = None) -> Look:
    """Say what a file holds and what kind of record it seems to be.

    Parameters
    ----------
    path : path, xarray.Dataset or pandas.DataFrame
        Any file that `read_records` reads; a record, or a table of columns, in memory.
    folder : path, optional
        Where the campaign file is to stand, for the paths in it. None: beside the file.

    Returns
    -------
    Look

    Raises
    ------
    InputError
        When the file cannot be read or holds no column of numbers.
    """
    path, segments, own = _opened(path)
    found = segments[0]
    frf = _frf(found)
    guesses, left = (_of_frf(found, frf), {}) if frf else guess_channels(found)
    rate = math.nan if frf else _rate(found, guesses)
    if not frf and not own:
        guesses = _unnamed(found, guesses, rate)
    kind = _kind(found, guesses, frf, rate, path)
    notes = [*found.notes]
    if len(segments) > 1:
        notes.append(f"{len(segments)} segments; each is a record of its own, and what is said is of the first")
    if not frf and (blocks := restarting_clock(found)) is not None and math.isfinite(rate):
        notes.append(
            f"'{blocks}' begins anew with each block of a triggered recorder; the blocks are taken one after another, "
            "which is right for hits that have rung out by the end of their block"
        )
    if not frf and not math.isfinite(rate):
        notes.append("no clock: the file states no sample rate and no column rises in even steps")
    notes += [f"'{column}' is not read: {why}" for column, why in list(found.unread.items())[:6]]
    text = _campaign(path, path.parent if folder is None else Path(folder), found, guesses, frf, rate, kind, own)
    return Look(
        path,
        len(segments),
        _table(found, guesses, left),
        found.size,
        rate,
        kind,
        tuple(guesses),
        text,
        tuple(notes),
        found,
    )


def _opened(given: str | Path | xr.Dataset | pd.DataFrame) -> tuple[Path, list[Contents], bool]:
    """Return the name of what is looked at, its columns, and whether they name themselves."""
    if isinstance(given, xr.Dataset):
        path = Path(str(given.attrs.get("source", "record")))
        return path, _own([check_record(given)], path.name), True
    if isinstance(given, pd.DataFrame):
        numbers = given.select_dtypes("number")
        if numbers.empty:
            raise InputError("the table holds no column of numbers")
        columns: dict[Column, Real] = {str(n): numbers[n].to_numpy(dtype=float) for n in numbers.columns}
        unread: dict[Column, str] = {str(n): "it holds no numbers" for n in given.columns if n not in numbers}
        return Path("table"), [Contents("table", columns, unread=unread)], False
    path = Path(given)
    own = names_itself(path)
    return path, _own(read_records(path, {}), path.name) if own else contents(path), own


def _own(records: Sequence[xr.Dataset], name: str) -> list[Contents]:
    """Return records in our own layout as columns called after their channels."""
    out = []
    for record in records:
        columns: dict[Column, Real] = {"t": record["time"].values}
        units: dict[Column, str] = {"t": "s"}
        for own, channel in OWN_COLUMNS.items():
            variable, _, axis = own.rpartition("_")
            if own in record:
                values = record[own].values
            elif variable in record and axis in record["axis"].values:
                values = record[variable].sel(axis=axis).values
            else:
                continue
            if channel.column is not None and np.all(np.isfinite(values)):
                columns[channel.column] = values
                units[channel.column] = str(channel.unit)
        out.append(Contents(name, columns, units))
    return out


def _frf(found: Contents) -> tuple[Column, Column, Column] | None:
    """Return the columns of frequency, real and imaginary part, where the file holds a frequency response."""
    frequency = frequency_column(found)
    names = list(found.columns)
    halves = [(c, f"{str(c)[:-4]}imag") for c in names if str(c).lower().endswith("real")]
    pairs: list[tuple[Column, Column]] = [(a, b) for a, b in halves if b in found.columns]
    if frequency is None and names and _rises_in_hertz(found.columns[names[0]]):
        unnamed = all(isinstance(c, int) for c in names)
        if pairs or (unnamed and len(names) == 3):
            frequency = names[0]
    if frequency is None:
        return None
    rest = [c for c in names if c != frequency]
    if not pairs:
        real = [c for c in rest if str(c).lower().startswith(("re", "real"))]
        imag = [c for c in rest if str(c).lower().startswith(("im", "imag"))]
        pairs = list(zip(real, imag, strict=False)) or ([(rest[0], rest[1])] if len(rest) == 2 else [])
    return (frequency, *pairs[0]) if pairs else None


def _of_frf(found: Contents, columns: tuple[Column, Column, Column]) -> list[Guess]:
    """Return the channels of a response; without a unit in the file the motion is guessed from its phase.

    At its driving point a compliance has a negative imaginary part, a mobility a positive real part, an accelerance a
    positive imaginary part.
    """
    frequency, real, imag = columns
    unit = next((found.units[c] for c in (real, imag) if c in found.units), "")
    response = found.columns[real] + 1j * found.columns[imag]
    turned, along = (float(np.sum(p) / max(np.sum(np.abs(p)), 1e-300)) for p in (response.imag, response.real))
    usual = "m/s^2/N" if turned > 0.5 else "m/s/N" if along > 0.5 and turned > -0.5 else "m/N"
    return [
        Guess("frequency", frequency, "Hz", False),
        Guess("compliance_real", real, unit or usual, not unit),
        Guess("compliance_imag", imag, unit or usual, not unit),
    ]


def _rises_in_hertz(values: Real) -> bool:
    """Whether a column without a name counts in steps that no recorder samples in, as frequencies do."""
    steps = np.diff(values)
    return bool(steps.size > 2 and values[0] >= 0.0 and np.min(steps) > 0.02 and np.ptp(steps) < 0.01 * np.mean(steps))


def _rate(found: Contents, guesses: Sequence[Guess]) -> float:
    clock = next((g for g in guesses if g.channel == "time"), None)
    if clock is None:
        return found.sample_rate or _rate_of_blocks(found)
    values = found.columns[clock.column]
    span = float(values[-1] - values[0]) * factor(clock.unit, "time")
    return (values.size - 1) / span if span > 0.0 else math.nan


def _rate_of_blocks(found: Contents) -> float:
    """Return the rate of blocks that stand one after another [Hz]; NaN where there is no such clock."""
    column = restarting_clock(found)
    if column is None:
        return math.nan
    unit = found.units.get(column, "s")
    rate = restarting_rate(found.columns[column] * (factor(unit, "time") if known(unit, "time") else 1.0))
    return math.nan if rate is None else rate


def _unnamed(found: Contents, guesses: list[Guess], rate: float) -> list[Guess]:
    """Take columns without a name for a force and motions where one is a series of hits; other WAV files for sound."""
    if found.source.split(",")[0].lower().endswith(".xml") and len(found.columns) == 2 and not guesses:
        # The setpoint of a control's measurement is a sequence of few levels.
        setpoint, actual = sorted(found.columns, key=lambda c: np.unique(found.columns[c]).size)
        return [Guess("reference_speed_x", setpoint, "m/s", True), Guess("encoder_speed_x", actual, "m/s", True)]
    free = [c for c in found.columns if isinstance(c, int) and all(g.column != c for g in guesses)]
    if not free or not math.isfinite(rate) or any(g.channel != "time" for g in guesses):
        return guesses
    wav = _is_wav(found)
    hit = [c for c in free if kind_of({"force_x": found.columns[c]}, rate).name == "impact test"]
    if wav and (len(hit) != 1 or len(free) < 2):
        return [*guesses, Guess("sound", free[0], "Pa", True)]
    if len(hit) != 1:
        return guesses
    motions = [c for c in free if c != hit[0]][:3]
    taken = [Guess(f"acceleration_{a}", c, "m/s^2", True) for a, c in zip("xyz", motions, strict=False)]
    return [*guesses, Guess("force_x", hit[0], "N", True), *taken]


def _is_wav(found: Contents) -> bool:
    return found.source.split(",")[0].lower().endswith(".wav")


def _kind(
    found: Contents, guesses: Sequence[Guess], frf: tuple[Column, Column, Column] | None, rate: float, path: Path
) -> Kind:
    if frf is not None:
        return Kind("FRF", f"'{frf[0]}' rises as frequencies do, '{frf[1]}' and '{frf[2]}' are a complex response")
    if path.suffix.lower() == ".xml" and len(found.columns) == 2:
        return Kind("loop trace", "a frequency-response measurement of a Sinumerik control: two signals of one loop")
    if not math.isfinite(rate):
        return Kind("unknown", "it has neither a clock nor a column of frequencies")
    return kind_of({g.channel: found.columns[g.column] for g in guesses if g.channel != "time"}, rate)


def _table(found: Contents, guesses: Sequence[Guess], left: Mapping[Column, str]) -> pd.DataFrame:
    by_column = {g.column: g for g in guesses}
    rows = []
    for column, values in found.columns.items():
        guess = by_column.get(column)
        finite = values[np.isfinite(values)]
        missing = values.size - finite.size
        remark = [] if guess else [left.get(column, "")]
        if guess is not None and guess.assumed:
            remark.append(f"the file states no unit of {guess.channel.rsplit('_', 1)[0]}: {guess.unit} is assumed")
        if missing:
            remark.append(f"{missing} values are missing")
        if guess is not None and missing == values.size:
            remark = ["it is empty"]
        numbers = (finite.min(), finite.max(), np.sqrt(np.mean(finite**2))) if finite.size else (math.nan,) * 3
        unit = guess.unit if guess else found.units.get(column, "")
        rows.append(
            (column, guess.channel if guess else "", unit, *map(float, numbers), "; ".join(filter(None, remark)))
        )
    return pd.DataFrame(rows, columns=["column", "channel", "unit", "least", "greatest", "rms", "remark"])


# --- a campaign file to start from -----------------------------------------------------------------------------------

_CHANGE = "# CHANGE"


def _campaign(
    path: Path,
    folder: Path,
    found: Contents,
    guesses: Sequence[Guess],
    frf: tuple[Column, Column, Column] | None,
    rate: float,
    kind: Kind,
    own: bool,
) -> str:
    """Return the text of the campaign file."""
    file = _text(Path(os.path.relpath(path, folder)).as_posix())
    head = [
        f"# A start for {path.name}, which seems to be: {kind.name} ({kind.reason}).",
        f"# Lines with {_CHANGE[2:]} hold guesses. Then: smfe check, and smfe run.",
        "[campaign]",
        f"name = {_text(path.stem)}",
        "",
    ]
    used = [g for g in guesses if g.channel.rsplit("_", 1)[0] in _WANTED.get(kind.name, ()) or g.channel in _SCALARS]
    if not {g.channel for g in used} - {"time"} and kind.name != "FRF":
        used = [*used, *_unrecognised(found, used)]
    if kind.name == "FRF":
        body = _frf_tables(file, found, guesses)
    elif kind.name == "sweep milling":
        body = _sweep_tables(file)
    elif kind.name == "cut":
        body = _cut_tables(file, used, kind, found)
    else:
        body = _measurement_tables(file, used, kind, found)
    declared = kind.name != "FRF" and not own
    channels = ["[channels]", *_channel_lines(used, found, rate, kind)] if declared else []
    return "\n".join([*head, *channels, "", *body, ""])


_MOTION = ("acceleration", "displacement")
_WANTED: Mapping[str, Sequence[str]] = {
    "impact test": ("force", *_MOTION),
    "stepped sine": ("force", *_MOTION),
    "sine": ("force", *_MOTION),
    "sine sweep": ("force", *_MOTION),
    "periodic excitation": ("force", *_MOTION),
    "random excitation": ("force", *_MOTION),
    "cut": ("force", *_MOTION),
    "sweep milling": ("force", *_MOTION),
    "drive stroke": ("encoder_position", "drive_force", "reference_position"),
    "loop trace": ("reference_speed", "encoder_speed", "reference_position", "encoder_position"),
    "vibration without a force": _MOTION,
    "unknown": ("force", *_MOTION),
}
"""Kind of record -> channels that its measurement reads."""

_SCALARS = ("time", "spindle_speed", "tacho", "sound")


def _unrecognised(found: Contents, used: Sequence[Guess]) -> list[Guess]:
    """Return columns of which nothing is known as accelerations, to have channels that can be changed."""
    free = [c for c, v in found.columns.items() if all(g.column != c for g in used) and np.all(np.isfinite(v))]
    return [Guess(f"acceleration_{a}", c, "m/s^2", True) for a, c in zip("xyz", free, strict=False)]


def _text(value: object) -> str:
    """Return a text as TOML writes it."""
    return json.dumps(str(value), ensure_ascii=False)


def _column(column: Column) -> str:
    return str(column) if isinstance(column, int) else _text(column)


def _channel_lines(used: Sequence[Guess], found: Contents, rate: float, kind: Kind) -> list[str]:
    lines = []
    for guess in used:
        unit = "" if guess.channel == "tacho" else f", unit = {_text(guess.unit)}"
        stated = found.units.get(guess.column)
        remark = (
            f"  {_CHANGE}: the unit is assumed" + (f", the file says {stated}" if stated else "")
            if guess.assumed
            else ""
        )
        if guess.channel.startswith("drive_force") and guess.assumed:
            remark += "; scale = newtons for each of its units"
        if _is_wav(found) and guess.channel != "sound":
            remark += f"; scale = {guess.unit} at full scale"
        if kind.name in ("unknown", "vibration without a force") and guess.assumed:
            remark += ", and so is the channel"
        lines.append(f"{guess.channel} = {{ column = {_column(guess.column)}{unit} }}{remark}")
    if not any(g.channel == "time" for g in used) and found.sample_rate is None:
        hertz = rate if math.isfinite(rate) else 1000.0
        why = "the file has no clock" if restarting_clock(found) is None else "its clock begins anew with each block"
        lines.insert(0, f'time = {{ sample_rate = "{hertz:.10g} Hz" }}  {_CHANGE}: {why}')
    rest = [c for c in found.columns if all(g.column != c for g in used)]
    lines += [f"# not used: {_text(c)}" for c in rest[:20]]
    return lines


def _frf_tables(file: str, found: Contents, guesses: Sequence[Guess]) -> list[str]:
    frequency, real, imag = (g.column for g in guesses)
    unit = guesses[1].unit
    remark = (
        "" if not guesses[1].assumed else f"  {_CHANGE}: m/N compliance, m/s/N mobility, m/s^2/N or g/N accelerance"
    )
    low = found.columns[frequency]
    first = float(low[low > 0.0][0]) if np.any(low > 0.0) else 1.0
    return [
        "[[measurement]]",
        'name = "measured FRF"',
        'method = "frf"',
        f'frequency_range = ["{first:.6g} Hz", "{float(low[-1]):.6g} Hz"]',
        f'records = [{{ file = {file}, response = "x", excitation = "x" }}]  {_CHANGE}: the axes',
        "[measurement.channels]",
        f'frequency = {{ column = {_column(frequency)}, unit = "Hz" }}',
        f"compliance_real = {{ column = {_column(real)}, unit = {_text(unit)} }}{remark}",
        f"compliance_imag = {{ column = {_column(imag)}, unit = {_text(unit)} }}{remark}",
    ]


def _tool(teeth: int) -> list[str]:
    return ["[tool]", f'diameter = "10 mm"  {_CHANGE}', f"teeth = {teeth}  {_CHANGE}", ""]


def _sweep_tables(file: str) -> list[str]:
    """A silent record: nine compliances need passes that one file does not have, and a verdict a constant speed."""
    return [
        *_tool(2),
        "# A sweep needs passes that differ in cut or width, with all three forces and the accelerations:",
        "# [[measurement]]",
        '# name = "sweep"',
        '# method = "sweep"',
        "# records = [",
        f'#     {{ file = {file}, cut = "down", width_of_cut = "3 mm" }},',
        '#     { file = "second pass", cut = "up", width_of_cut = "5 mm" },',
        '#     { file = "third pass", cut = "central", width_of_cut = "8.5 mm" },',
        "# ]",
        "# Until they are there, the record is read and checked, and nothing is made of it:",
        "[[measurement]]",
        'name = "sweep milling"',
        'method = "silent"',
        f"records = [{{ file = {file} }}]",
    ]


def _cut_tables(file: str, used: Sequence[Guess], kind: Kind, found: Contents) -> list[str]:
    """One cutting test: a verdict needs no more."""
    speed = next((found.columns[g.column] for g in used if g.channel == "spindle_speed"), None)
    if speed is not None and np.median(np.abs(speed)) > 0.0:
        rpm, teeth, how = float(np.median(np.abs(speed))), 2, "the median of its column"
    else:
        # Without run-out the comb is that of the teeth, with it that of the spindle.
        teeth = kind.strongest if kind.strongest > 1 else 2
        rpm = 60.0 * kind.fundamental / (1 if kind.strongest > 1 else teeth)
        how = "from the lines, with the number of teeth above"
    return [
        *_tool(teeth),
        "[[cutting_test]]",
        f"file = {file}",
        f'spindle_speed = "{rpm:.6g} rpm"  {_CHANGE}: {how}',
        f'depth_of_cut = "1 mm"  {_CHANGE}',
        f'cut = "down"  {_CHANGE}: down, up or central',
        f'width_of_cut = "5 mm"  {_CHANGE}',
    ]


def _measurement_tables(file: str, used: Sequence[Guess], kind: Kind, found: Contents) -> list[str]:
    """One measurement of the method that the kind asks for; "silent" where no method reads it."""
    names = {g.channel for g in used}
    forces = [g for g in used if g.channel.startswith("force_")]
    axis = max(forces, key=lambda g: float(np.std(found.columns[g.column])), default=None)
    along = axis.channel[-1] if axis else "x"
    moved = any(n.startswith(_MOTION) for n in names)
    method = {
        "impact test": "hammer",
        "stepped sine": "actuator",
        "sine": "actuator",
        "sine sweep": "actuator",
        "periodic excitation": "actuator",
        "random excitation": "actuator",
        "drive stroke": "drive",
        "loop trace": "loop",
    }.get(kind.name, "silent")
    if method in ("hammer", "actuator") and not moved:
        method = "silent"
    lines = ["[[measurement]]", f"name = {_text(kind.name)}", f'method = "{method}"']
    if method in ("hammer", "actuator"):
        return [*lines, f'records = [{{ file = {file}, excitation = "{along}" }}]  {_CHANGE}: the axis']
    return [*lines, f"records = [{{ file = {file} }}]"]


def summary(result: Look) -> str:
    """Return what `look` found as sentences and a table."""
    if result.kind.name == "FRF":
        clock = f"{result.size} lines"
    elif math.isfinite(result.sample_rate):
        clock = f"{result.sample_rate:.6g} Hz, {result.duration:.4g} s, {result.size} samples"
    else:
        clock = f"{result.size} samples"
    lines = [f"{result.path.name}: {clock}", f"seems to be: {result.kind.name}; {result.kind.reason}"]
    for row in result.columns.to_dict("records")[:40]:
        unit, remark = (f" [{row['unit']}]" if row["unit"] else ""), (f" ({row['remark']})" if row["remark"] else "")
        numbers = f"{row['least']:.4g} to {row['greatest']:.4g}, rms {row['rms']:.4g}"
        lines.append(f"  {row['column']}: {row['channel'] or '-'}{unit}: {numbers}{remark}")
    if len(result.columns) > 40:
        lines.append(f"  and {len(result.columns) - 40} columns more")
    return "\n".join([*lines, *(f"note: {text}" for text in result.notes)])
