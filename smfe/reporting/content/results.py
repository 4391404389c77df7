"""What a folder of results holds, read and checked once; an absent file is None or empty, never an error."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import UNITS, check_compliance
from process.types import Complex, Real
from smfe.results import Failures, as_named, of_file, read_groups, unpack, unpack_warnings

BAD_CONDITION = 30.0
"""Above this condition number of the forces a frequency counts as badly conditioned."""

_TEXT_COLUMNS = (
    *("source", "request", "lobes", "measurement", "model", "measurement_a", "measurement_b", "a", "b"),
    *("lowest", "highest", "categories", "aliased_with"),
    *("response", "excitation", "entry", "file", "verdict", "observed", "reason"),
    *("controller", "position", "not_compared", "method", "method_a", "method_b"),
)
"""Columns that are names: a source called "1" stays text."""


@dataclass(frozen=True)
class Measurement:
    """One compliance, measured or modelled.

    Parameters
    ----------
    name, method : str
        Name of the group and how it came about: hammer, actuator, sweep, frf, model.
    data : xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N] and what belongs to it.
    conditions : mapping of str to str
        E.g. controller -> K2.
    warnings : tuple of str
        Sentences of the identification.
    """

    name: str
    method: str
    data: xr.Dataset = field(repr=False)
    conditions: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def is_model(self) -> bool:
        """Whether it was declared instead of measured."""
        return self.method == "model"

    @property
    def frequency(self) -> Real:
        """Frequency [Hz]."""
        return np.asarray(self.data["frequency"].values, dtype=float)

    @property
    def entries(self) -> list[tuple[str, str]]:
        """(response, excitation) of every entry that is claimed at one frequency at least."""
        pairs = ((str(r), str(e)) for r in self.data["response"].values for e in self.data["excitation"].values)
        return [pair for pair in pairs if np.isfinite(self.entry(*pair)).any()]

    def entry(self, response: str, excitation: str) -> Complex:
        """Return one compliance [m/N] over frequency."""
        values = self.data["compliance"].sel(response=response, excitation=excitation).values
        return np.asarray(values, dtype=np.complex128)

    def std(self, response: str, excitation: str) -> Real | None:
        """Return the standard deviation [m/N] of one entry, None where nothing is known of it."""
        if "compliance_std" not in self.data:
            return None
        array = self.data["compliance_std"].sel(response=response, excitation=excitation)
        values = np.asarray(array.values, dtype=float)
        return values if np.isfinite(values).any() else None

    def claimed(self) -> NDArray[np.bool_]:
        """Return the frequencies at which any entry is claimed."""
        array = self.data["compliance"].transpose("frequency", ...).values
        return np.asarray(np.isfinite(array).any(axis=(1, 2)))

    def coherences(self, response: str) -> list[tuple[str, Real]]:
        """Return (excitation or "", coherence over frequency) of one response."""
        if "coherence" not in self.data or response not in self.data["response"].values:
            return []
        array = self.data["coherence"].sel(response=response)
        if "excitation" in array.dims:
            pairs = [(str(e), array.sel(excitation=e).values) for e in array["excitation"].values]
        else:
            pairs = [("", array.values)]
        return [(e, np.asarray(v, dtype=float)) for e, v in pairs if np.isfinite(v).any()]

    def condition(self) -> Real | None:
        """Return the condition number of the forces over frequency, for a sweep."""
        if "force_condition" not in self.data:
            return None
        return np.asarray(self.data["force_condition"].values, dtype=float)

    def bad_bands(self) -> list[tuple[float, float]]:
        """Return the bands [Hz] in which the condition number of the forces exceeds `BAD_CONDITION`."""
        condition = self.condition()
        return [] if condition is None else bands(self.frequency, ~(condition <= BAD_CONDITION))


@dataclass(frozen=True)
class Lobes:
    """Stability lobes of one request from one source.

    Parameters
    ----------
    request, source : str
        E.g. lobes_1 and the name of the measurement.
    data : xarray.Dataset
        ``limit_depth(spindle_speed)`` [mm] and what belongs to it, speeds rising.
    table : pandas.DataFrame
        Its rows of the lobe table.
    warnings : tuple of str
        Sentences for the report.
    """

    request: str
    source: str
    data: xr.Dataset = field(repr=False)
    table: pd.DataFrame = field(repr=False)
    warnings: tuple[str, ...] = ()

    def values(self, name: str) -> Real:
        """Return a variable over the spindle speeds."""
        return np.asarray(self.data[name].values, dtype=float)

    def band(self) -> tuple[Real, Real, str] | None:
        """Return lowest and highest quantile of the limit depth [mm] and what they are called."""
        if "limit_depth_quantile" not in self.data:
            return None
        array = self.data["limit_depth_quantile"].sortby("quantile").transpose("quantile", "spindle_speed")
        levels = np.asarray(array["quantile"].values, dtype=float)
        label = f"{100 * levels[0]:.3g} % to {100 * levels[-1]:.3g} %"
        return np.asarray(array.values[0], dtype=float), np.asarray(array.values[-1], dtype=float), label

    def lower(self) -> Real | None:
        """Return the limit depth after a kick [mm], NaN where it is not known; None where it is nowhere lower."""
        if "lower_limit_depth" not in self.data:
            return None
        lower = self.values("lower_limit_depth")
        return np.where(np.isfinite(lower), lower, np.nan) if np.any(lower < self.values("limit_depth")) else None

    def curves(self) -> tuple[Real, Real, Real] | None:
        """Return speed [rpm], depth [mm], chatter frequency [Hz] of the single lobes, NaN between two."""
        names = ("curve_spindle_speed", "curve_limit_depth", "curve_chatter_frequency")
        if any(name not in self.data for name in names):
            return None
        speed, depth, frequency = (self.values(name) for name in names)
        step = np.abs(np.diff(frequency))
        moved = step[step > 0.0]
        # A gap in the data is a jump of the chatter frequency within one lobe.
        new = step > 4.0 * (np.median(moved) if moved.size else np.inf)
        for name in ("curve_lobe", "curve_branch"):
            if name in self.data:
                new |= np.diff(self.values(name)) != 0.0
        at = np.flatnonzero(new) + 1
        return np.insert(speed, at, np.nan), np.insert(depth, at, np.nan), np.insert(frequency, at, np.nan)


@dataclass(frozen=True)
class Results:
    """Everything that the report holds.

    Parameters
    ----------
    folder : Path
        Where it was read from.
    measurements, lobes : tuple
        In the order in which they are drawn.
    spectra : mapping of str to xarray.Dataset
        Cutting test -> its spectrum.
    tables : mapping of (str, str) to pandas.DataFrame
        (measurement, table) -> hits, steps, passes.
    chatter, comparison, explained, model_error : pandas.DataFrame or None
        None when the file is absent.
    provenance : mapping
        Content of provenance.json, empty when absent.
    finding : mapping
        Content of finding.json, empty when absent.
    presets : mapping
        Content of presets.json, empty when absent.
    pockets, depths : pandas.DataFrame or None
        Rows of pockets.csv; of depth_table.csv, depth over speed and width of cut.
    ranking, differences : pandas.DataFrame or None
        Rows of ranking.csv and ranking_differences.csv: methods by what they predict.
    maps : mapping of str to xarray.Dataset
        "lobes_1/SOURCE" -> vibration, wall, force and power over speed and depth, of maps.nc.
    widths : mapping of str to xarray.Dataset
        The same -> limits over width of cut and speed, of widths.nc.
    curves : xarray.Dataset or None
        What a diagnosis compared, of finding.nc; None when it is absent.
    """

    folder: Path
    measurements: tuple[Measurement, ...]
    lobes: tuple[Lobes, ...]
    spectra: Mapping[str, xr.Dataset]
    tables: Mapping[tuple[str, str], pd.DataFrame]
    chatter: pd.DataFrame | None
    comparison: pd.DataFrame | None
    explained: pd.DataFrame | None
    model_error: pd.DataFrame | None
    provenance: Mapping[str, Any]
    finding: Mapping[str, Any]
    conditions: Mapping[str, xr.Dataset] = field(default_factory=dict)
    loops: Mapping[str, xr.Dataset] = field(default_factory=dict)
    drives: pd.DataFrame | None = None
    presets: Mapping[str, Any] = field(default_factory=dict)
    pockets: pd.DataFrame | None = None
    curves: xr.Dataset | None = None
    depths: pd.DataFrame | None = None
    ranking: pd.DataFrame | None = None
    differences: pd.DataFrame | None = None
    open_loops: Mapping[str, xr.Dataset] = field(default_factory=dict)
    maps: Mapping[str, xr.Dataset] = field(default_factory=dict)
    widths: Mapping[str, xr.Dataset] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name of the campaign, else of the folder."""
        known = self.provenance.get("campaign") or self.finding.get("campaign")
        return str(known or self.folder.resolve().name)

    @property
    def diagnosis_alone(self) -> bool:
        """Whether the folder holds a finding and nothing else: then nothing is known of the rest of the campaign."""
        frames = (self.chatter, self.comparison, self.explained, self.model_error, self.drives)
        others = (
            self.measurements,
            self.lobes,
            self.spectra,
            self.tables,
            self.provenance,
            self.conditions,
            self.loops,
            self.open_loops,
        )
        return bool(self.finding) and not any(others) and all(frame is None for frame in frames)

    @property
    def failures(self) -> Failures:
        """What failed, as provenance.json says; without it as the files of compliances and lobes say."""
        if self.provenance:
            return unpack(self.provenance)
        return [f for name in ("frf.nc", "lobes.nc") for f in of_file(self.folder / name)]

    @property
    def advice(self) -> Mapping[str, Mapping[str, Any]]:
        """The recommendation of each request, as presets.json says it."""
        return {str(r["lobes"]): r for r in self.presets.get("recommendations", ())}

    @property
    def best(self) -> Mapping[str, Any]:
        """The one recommendation over all requests, empty where there is none."""
        found: Mapping[str, Any] = self.presets.get("recommendation") or {}
        return found

    @property
    def requests(self) -> dict[str, list[Lobes]]:
        """Lobes by request."""
        out: dict[str, list[Lobes]] = {}
        for item in self.lobes:
            out.setdefault(item.request, []).append(item)
        return out

    @property
    def warnings(self) -> list[tuple[str, str]]:
        """(where, sentence) of every warning, once each."""
        own = [(m.name, w) for m in self.measurements for w in m.warnings]
        of_lobes = [(f"{item.request}, {item.source}", w) for item in self.lobes for w in item.warnings]
        known = {sentence for where, w in own + of_lobes for sentence in (w, f"{where}: {w}")}
        if len(self.requests) == 1:
            of_lobes = [(f"lobes of {item.source}", w) for item in self.lobes for w in item.warnings]
        own += of_lobes
        general = [("", str(w)) for w in self.provenance.get("warnings", []) if str(w) not in known]
        return list(dict.fromkeys(own + general))


def read_results(folder: Path) -> Results:
    """Read a folder of results.

    Raises
    ------
    InputError
        When the folder does not exist or a file in it cannot be read or lacks what it must hold.
    """
    if not folder.is_dir():
        raise InputError(f"'{folder}' is not a folder of results; `smfe run CAMPAIGN --out {folder}` makes one")
    table = _read_csv(folder / "lobe_table.csv", ("source", "spindle_speed_rpm", "limit_depth_mm"))
    return Results(
        folder,
        _read_measurements(folder / "frf.nc"),
        _read_lobes(folder / "lobes.nc", table),
        _read_spectra(folder / "spectra.nc"),
        _read_tables(folder / "tables"),
        _read_csv(folder / "chatter.csv", ("file", "spindle_speed_rpm", "depth_of_cut_mm", "verdict")),
        _read_csv(folder / "comparison.csv", ()),
        _read_csv(folder / "explained.csv", ("quantity", "factor", "explained_percent", "p_family", "significant")),
        _read_csv(folder / "model_error.csv", ("measurement", "model", "response", "excitation", "error_percent")),
        _read_json(folder / "provenance.json"),
        _read_json(folder / "finding.json"),
        _read_conditions(folder / "conditions.nc"),
        _read_loops(folder / "loops.nc"),
        _read_csv(folder / "drives.csv", ("measurement", "parameter", "direction", "value", "low", "high", "unit")),
        _read_json(folder / "presets.json"),
        _read_csv(folder / "pockets.csv", ("source", "spindle_speed_rpm", "limit_depth_mm")),
        _groups(folder / "finding.nc").get("curves") if (folder / "finding.json").is_file() else None,
        _read_csv(folder / "depth_table.csv", ("lobes", "source", "spindle_speed_rpm")),
        _read_csv(folder / "ranking.csv", ("method", "controller", "spindle_speed_rpm", "tests", "right")),
        _read_csv(folder / "ranking_differences.csv", ("method_a", "method_b", "controller", "tests", "significant")),
        _read_open_loops(folder / "open_loops.nc"),
        _groups(folder / "maps.nc"),
        _groups(folder / "widths.nc"),
    )


def bands(frequency: Real, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] in which a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in pairs]


def natural(name: str) -> list[tuple[int, str]]:
    """Return a sorting key: lobes_2 before lobes_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def _groups(path: Path) -> dict[str, xr.Dataset]:
    return read_groups(path) if path.is_file() else {}


def _json_attr(path: Path, group: str, dataset: xr.Dataset, name: str) -> dict[str, str]:
    try:
        content = json.loads(dataset.attrs.get(name, "{}"))
        return {str(k): str(v) for k, v in content.items()}
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}, group '{group}': attribute '{name}' is not a JSON object; write it again") from error


def _warnings(path: Path, group: str, dataset: xr.Dataset) -> tuple[str, ...]:
    try:
        return tuple(str(w) for w in unpack_warnings(dataset))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}, group '{group}': attribute 'warnings' is not a JSON list; write it again") from error


def _require(path: Path, group: str, dataset: xr.Dataset, variables: Mapping[str, Sequence[str]]) -> None:
    """Raise unless every variable is there with its dimensions."""
    for name, dims in variables.items():
        if name not in dataset:
            raise InputError(f"{path}, group '{group}' has no variable '{name}'; write it again with `smfe run`")
        if set(dataset[name].dims) != set(dims):
            raise InputError(
                f"{path}, group '{group}': '{name}' has the dimensions {dataset[name].dims}; {tuple(dims)} are needed"
            )


def _read_measurements(path: Path) -> tuple[Measurement, ...]:
    """Read frf.nc; what was measured comes before the models."""
    out = []
    for name, dataset in _groups(path).items():
        _require(path, name, dataset, {"compliance": ("frequency", "response", "excitation")})
        try:
            check_compliance(dataset)
        except InputError as error:
            raise InputError(f"{path}, group '{name}': {error}") from error
        method = str(dataset.attrs.get("method", ""))
        conditions = _json_attr(path, name, dataset, "conditions")
        out.append(Measurement(name, method, dataset, conditions, _warnings(path, name, dataset)))
    return tuple(sorted(out, key=lambda m: m.is_model))


def _read_conditions(path: Path) -> dict[str, xr.Dataset]:
    """Read conditions.nc: compliances with further dimensions that the vocabulary knows."""
    groups = _groups(path)
    for name, dataset in groups.items():
        dims = dataset["compliance"].dims if "compliance" in dataset else ()
        further = [str(d) for d in dims if d not in ("frequency", "response", "excitation")]
        if not further or any(d not in UNITS for d in further):
            raise InputError(f"{path}, group '{name}' has no compliance over a force level or feed; write it again")
    return groups


def _read_open_loops(path: Path) -> dict[str, xr.Dataset]:
    """Read open_loops.nc: measurement and direction -> response of the carriage to the drive force."""
    groups = _groups(path)
    for name, dataset in groups.items():
        over = ("frequency",)
        _require(path, name, dataset, {"open_loop": over, "open_loop_std": over, "open_loop_fitted": over})
    return groups


def _read_loops(path: Path) -> dict[str, xr.Dataset]:
    """Read loops.nc: responses of drive loops over feed and frequency."""
    groups = _groups(path)
    for name, dataset in groups.items():
        _require(path, name, dataset, {"loop_response": ("feed", "frequency")})
    return groups


def _read_lobes(path: Path, table: pd.DataFrame | None) -> tuple[Lobes, ...]:
    blocks = _blocks(table)
    groups = _groups(path)
    out = []
    for name in sorted(groups, key=lambda n: natural(n.partition("/")[0])):
        dataset = groups[name]
        over = ("spindle_speed",)
        _require(path, name, dataset, {"limit_depth": over, "chatter_frequency": over, "lobe": over})
        request, _, rest = name.partition("/")
        source = str(dataset.attrs.get("source", rest or name))
        dataset = dataset.sortby("spindle_speed")
        rows = _take_block(blocks, request, source, dataset)
        out.append(Lobes(request, source, dataset, rows, _warnings(path, name, dataset)))
    if not groups:
        out = [Lobes("", str(b["source"].iloc[0]), _dataset_of(b), b) for b in blocks]
    return tuple(out)


def _blocks(table: pd.DataFrame | None) -> list[pd.DataFrame]:
    """Cut the lobe table where another source, cut or pass through the speeds begins."""
    if table is None or table.empty:
        return []
    filled = table.assign(limit_depth_mm=table["limit_depth_mm"].fillna(np.inf))
    said = filled["lobes"].fillna("") if "lobes" in filled else ""
    key = said + "\n" + filled["source"].astype(str)
    new = (key != key.shift()) | ~(filled["spindle_speed_rpm"].diff() > 0.0)
    return [block.reset_index(drop=True) for _, block in filled.groupby(new.cumsum())]


def _take_block(blocks: list[pd.DataFrame], request: str, source: str, dataset: xr.Dataset) -> pd.DataFrame:
    """Remove and return the rows that belong to these lobes; made from the lobes when there are none."""
    for position, block in enumerate(blocks):
        named = str(block["source"].iloc[0]) in (source, f"{request}/{source}")
        said = block["lobes"].iloc[0] if "lobes" in block else None
        asked = not isinstance(said, str) or said == request
        if named and asked and _same_cut(block, dataset):
            return blocks.pop(position)
    return _table_of(source, dataset)


def _same_cut(block: pd.DataFrame, dataset: xr.Dataset) -> bool:
    for name in ("width_of_cut_mm", "feed_per_tooth_mm"):
        given = dataset.attrs.get(name)
        if name in block and given is not None and not np.isclose(block[name].iloc[0], float(given), rtol=1e-6):
            return False
    return True


def _table_of(source: str, dataset: xr.Dataset) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "source": source,
            "spindle_speed_rpm": dataset["spindle_speed"].values.astype(float),
            "limit_depth_mm": dataset["limit_depth"].values.astype(float),
            "chatter_frequency_Hz": dataset["chatter_frequency"].values.astype(float),
        }
    )


def _dataset_of(block: pd.DataFrame) -> xr.Dataset:
    nothing = pd.Series(np.nan, index=block.index)
    columns = {
        "limit_depth": block["limit_depth_mm"],
        "chatter_frequency": block.get("chatter_frequency_Hz", nothing),
        "lobe": block.get("lobe", nothing),
    }
    attrs = {n: float(block[n].iloc[0]) for n in ("width_of_cut_mm", "feed_per_tooth_mm") if n in block}
    return xr.Dataset(
        {name: ("spindle_speed", values.to_numpy(dtype=float)) for name, values in columns.items()},
        coords={"spindle_speed": block["spindle_speed_rpm"].to_numpy(dtype=float)},
        attrs=attrs,
    )


def _read_spectra(path: Path) -> dict[str, xr.Dataset]:
    groups = _groups(path)
    for name, dataset in groups.items():
        _require(path, name, dataset, {"amplitude": ("axis", "frequency")})
    return {name: groups[name] for name in sorted(groups, key=natural)}


def _read_tables(folder: Path) -> dict[tuple[str, str], pd.DataFrame]:
    out = {}
    for path in sorted(folder.glob("*.csv"), key=lambda p: natural(p.name)):
        measurement, _, table = path.stem.rpartition(".")
        frame = _read_csv(path, ())
        if frame is not None:
            out[measurement or path.stem, table] = frame
    return out


def _read_csv(path: Path, columns: Sequence[str]) -> pd.DataFrame | None:
    """Read a table; None when the file is absent."""
    if not path.is_file():
        return None
    try:
        # Only an empty field is missing: a measurement may be called "NA".
        frame = as_named(
            pd.read_csv(path, dtype=dict.fromkeys(_TEXT_COLUMNS, str), keep_default_na=False, na_values=[""])
        )
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=list(columns))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not a readable CSV table ({error}); write it again with `smfe run`") from error
    missing = [c for c in columns if c not in frame.columns]
    if missing:
        raise InputError(f"{path} has no column '{missing[0]}'; write it again with `smfe run`")
    text = [c for c in columns if c.endswith(("_rpm", "_mm", "_percent")) and not _is_number(frame[c])]
    if text:
        raise InputError(f"{path}: column '{text[0]}' holds text instead of numbers; write it again with `smfe run`")
    return frame


def _is_number(column: pd.Series[Any]) -> bool:
    return bool(pd.api.types.is_numeric_dtype(column) or column.isna().all())


def _read_json(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is not readable JSON ({error}); write it again with `smfe run`") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} holds no JSON object; write it again with `smfe run`")
    return content
