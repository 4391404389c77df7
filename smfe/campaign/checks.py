"""What concerns several tables at once.

Works on the raw file, so that these errors are found together with those of the single fields.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from process import units
from process.cut.engagement import CUTS, Engagement, engagement_of_offset, engagement_of_strips
from process.errors import InputError
from process.labels import AXES
from smfe.campaign.machine import MACHINE, is_model
from smfe.campaign.methods import METHODS, needed_by, readers_of
from smfe.campaign.quantities import OTHER_CUTS
from smfe.campaign.schema import CampaignFile
from smfe.records.formats.channels import (
    CHANNELS,
    COMPLIANCE_CHANNELS,
    RECORD_CHANNELS,
    did_you_mean,
    listed,
    unit_factor,
)

Loc = tuple[str | int, ...]
Complaint = tuple[Loc, str]
Raw = Mapping[str, Any]

_EXAMPLES = {
    "excitation": 'the axis that was excited, excitation = "x"',
    "response": 'the axis of the motion, response = "x"',
    "cut": 'cut = "down", "up" or "central"',
    "width_of_cut": 'the radial width, width_of_cut = "40 mm"',
}

_ADVISED_PASSES = {"down": 0.30, "up": 0.50, "central": 0.85}
"""Well-conditioned trio: cut -> width over tool diameter."""


def check(raw: Raw) -> list[Complaint]:
    """Return every error that concerns more than one field."""
    rules: tuple[Callable[[Raw], Iterator[Complaint]], ...] = (
        _something_to_do,
        _names,
        _methods,
        _sweeps,
        _lobes,
        _cutting_tests,
        _baseline,
        _held_out,
        _plan,
        _tune,
        _channels,
    )
    return [complaint for rule in rules for complaint in rule(raw)]


def _tables(raw: Raw, key: str) -> list[tuple[Loc, Raw]]:
    """Return the tables of a list that are tables, with their places."""
    entries = raw.get(key)
    if not isinstance(entries, list):
        return []
    return [((key, i), entry) for i, entry in enumerate(entries) if isinstance(entry, dict)]


def _quantity(table: Any, key: str, dimension: str) -> float | None:
    """Return a quantity where it is one; what is wrong with it the field says itself."""
    try:
        return units.parse(table[key], dimension)
    except (InputError, KeyError, TypeError):
        return None


def _names_of(raw: Raw) -> list[tuple[Loc, str]]:
    found = [(where, table.get("name")) for key in ("measurement", "model") for where, table in _tables(raw, key)]
    own = [(("machine",), MACHINE)] if _machine(raw) else []
    return own + [(where, name) for where, name in found if isinstance(name, str)]


def _machine(raw: Raw) -> Raw | None:
    """Return ``[machine]`` where it says what the machine is made of."""
    table = raw.get("machine")
    return table if isinstance(table, dict) and is_model(table) else None


def _something_to_do(raw: Raw) -> Iterator[Complaint]:
    if not any(key in raw for key in ("measurement", "model", "cutting_test", "plan", "tune")) and not _machine(raw):
        yield (), "nothing to work with; add a [[measurement]], a [[model]] or a [[cutting_test]]"


def _names(raw: Raw) -> Iterator[Complaint]:
    first: dict[str, Loc] = {}
    for where, name in _names_of(raw):
        if name in first:
            own = "[machine]" if first[name] == ("machine",) else path(first[name])
            yield (*where, "name"), f"'{name}' is already the name of {own}; give each its own"
        first.setdefault(name, where)
    for name in _level_names(raw):
        if name in first:
            yield (*first[name], "name"), f"'{name}' is what a depth of cut of a sweep is called; give another name"


def _records(table: Raw) -> list[tuple[Loc, Raw]]:
    return _tables(table, "records")


def _methods(raw: Raw) -> Iterator[Complaint]:
    """Keys that a method needs in its records, and keys that it does not read."""
    for where, table in _tables(raw, "measurement"):
        method = table.get("method")
        if not isinstance(method, str) or method not in METHODS:
            continue
        for key in table:
            readers = readers_of(key)
            if readers and method not in readers:
                only = " or ".join(f"{'an' if r[0] in 'aeiou' else 'a'} {r}" for r in readers)
                yield (*where, key), f"method '{method}' does not read it; only {only} does, take it out"
        names = METHODS[method].estimators
        known = {e for m in METHODS.values() for e in m.estimators}  # what is not even known is said by the schema
        if names and table.get("estimator", names[0]) in known.difference(names):
            article = "an" if method[0] in "aeiou" else "a"
            text = f"'{table['estimator']}' is no estimator of {article} {method}; take {listed(names)}"
            yield (*where, "estimator"), text
        for key in ("period", "settling"):
            if method == "actuator" and "estimator" in table and key in table:
                yield (*where, key), "an estimator is for a force that does not repeat itself; take one of both out"
        if "period" in table and "resolution" in table:
            yield (*where, "resolution"), "a periodic force has lines 1/period apart; take one of both out"
        for place, record in _records(table):
            yield from _keys(method, (*where, *place), record)


def _keys(method: str, where: Loc, record: Raw) -> Iterator[Complaint]:
    for key in _EXAMPLES:
        readers = needed_by(key)
        if method in readers and key not in record:
            yield (*where, key), f"is missing; a record of method '{method}' needs {_EXAMPLES[key]}"
        if method not in readers and key in record:
            yield (*where, key), f"method '{method}' does not read it ({', '.join(readers)} does); take it out"
        named = isinstance(record.get(key), str) and (":" in record[key] or record[key].strip().startswith("-"))
        if key == "excitation" and method in ("hammer", "actuator") and named:
            yield (*where, key), f"{record[key]!r} is no axis ({', '.join(AXES)}); only method 'frf' knows other places"
    if "spindle_speed" in record and method != "sweep":
        yield (*where, "spindle_speed"), f"method '{method}' does not read it (sweep does); take it out"


def _sweeps(raw: Raw) -> Iterator[Complaint]:
    diameter = _quantity(raw.get("tool"), "diameter", "length")
    for where, table in _tables(raw, "measurement"):
        if table.get("method") != "sweep":
            continue
        yield from _needs(raw, where, ("tool",), "a sweep")
        passes = set()
        for place, record in _records(table):
            width = _quantity(record, "width_of_cut", "length")
            passes.add((str(record.get("cut")), width))
            yield from _fits(diameter, (*where, *place), width, record)
        # The estimator with a single reference is fed the same passes, so that the two can be compared.
        axes = table.get("axes")
        needed = len(set(axes)) if isinstance(axes, list) and axes else 3
        if len(passes) < needed:
            yield (*where, "records"), _too_few(passes, diameter, needed)
        else:
            records = [record for _, record in _records(table)]
            missing = partial(_too_few, diameter=diameter, needed=needed)
            yield from (((*where, "records"), text) for text in depth_complaints(table, records, needed, missing))
        yield from _estimator(where, table)


def _estimator(where: Loc, table: Raw) -> Iterator[Complaint]:
    """What goes with which estimator."""
    references, estimator = table.get("references", "all"), table.get("estimator")
    single = "single_reference" if references == "x" else "local_polynomial"
    if estimator is not None and references != "all" and estimator != single:
        yield (
            (*where, "estimator"),
            f"references = '{references}' is that of estimator '{single}'; take one of them out",
        )
    local = references != "x" and estimator in (None, "local_polynomial")
    if table.get("position_dependent") and not local:
        yield (*where, "position_dependent"), "only the estimator 'local_polynomial' reads it; take one of them out"


def _too_few(passes: set[tuple[str, float | None]], diameter: float | None, needed: int) -> str:
    cuts = {cut for cut, _ in passes}
    missing = [cut for cut in _ADVISED_PASSES if cut not in cuts] or list(_ADVISED_PASSES)
    advised = []
    for cut in missing[: needed - len(passes)]:
        ratio = _ADVISED_PASSES[cut]
        width = f"{ratio:g} of the tool diameter" if diameter is None else units.show(ratio * diameter, "mm", "length")
        advised.append(f"a pass with cut = '{cut}' and a width of {width}")
    directions, entries = {1: ("one", "one"), 2: ("two", "four")}.get(needed, ("three", "nine"))
    return (
        f"{len(passes)} passes that differ in cut or width; {directions} independent force directions are needed to "
        f"solve for {entries} compliances; add {' and '.join(advised)}"
    )


def _needs(raw: Raw, where: Loc, tables: tuple[str, ...], what: str) -> Iterator[Complaint]:
    for name in tables:
        if name not in raw:
            yield where, f"{what} needs the table [{name}]; add it"


def _fits(diameter: float | None, where: Loc, width: float | None, table: Raw) -> Iterator[Complaint]:
    if diameter is not None and width is not None and width > diameter * (1.0 + 1e-12):
        yield (
            (*where, "width_of_cut"),
            f"'{table['width_of_cut']}' is wider than the tool of {units.show(diameter, 'mm', 'length')}; "
            "the radial width of cut is at most the diameter",
        )


def _lobes(raw: Raw) -> Iterator[Complaint]:
    diameter = _quantity(raw.get("tool"), "diameter", "length")
    for where, table in _tables(raw, "lobes"):
        yield from _needs(raw, where, ("tool", "material"), "a stability limit")
        yield from _engaged(where, table, diameter)
        for wanted in (k for k in ("maps_up_to", "deflection", "surface_error") if k in table):
            for thing in _not_round(raw.get("tool")):
                yield (*where, wanted), f"needs straight teeth on one circle, and [tool] gives a {thing}; take one out"
        widths = table.get("width_of_cut")
        for i, width in enumerate(widths if isinstance(widths, list) else []):
            one = {"width_of_cut": width}
            for (*_, key), text in _fits(diameter, where, _quantity(one, "width_of_cut", "length"), one):
                yield (*where, key, i), text
        yield from _fits(diameter, where, _quantity(table, "width_of_cut", "length"), table)
        names = table.get("measurements")
        for i, name in enumerate(names if isinstance(names, list) else []):
            yield from _named(raw, (*where, "measurements", i), name, anywhere=True)


def _not_round(tool: Any) -> Iterator[str]:
    """Yield what keeps the teeth of a tool from being straight and on one circle."""
    if _quantity(tool, "helix_angle", "angle"):
        yield "helix_angle"
    radii = tool.get("runout") if isinstance(tool, dict) else None
    if isinstance(radii, list) and any(_quantity({"r": r}, "r", "length") for r in radii):
        yield "runout"


def _engaged(where: Loc, table: Raw, diameter: float | None) -> Iterator[Complaint]:
    """What says where the teeth of a [[lobes]] are in the work: other keys for each kind of cut."""
    cut = table.get("cut")
    if not isinstance(cut, str) or cut not in (*CUTS, *OTHER_CUTS):
        return  # said by the schema
    needed = OTHER_CUTS.get(cut, ("width_of_cut",))
    every = dict.fromkeys(["width_of_cut", *(key for keys in OTHER_CUTS.values() for key in keys)])
    missing = [key for key in needed if key not in table]
    for key in every:
        if key in missing:
            yield (*where, key), f'is missing; cut = "{cut}" needs {listed(needed)}, add it'
        elif key in table and key not in needed:
            yield (*where, key), f'cut = "{cut}" is said by {listed(needed)}; take it out'
    if missing or diameter is None:
        return
    try:
        if cut == "offset":
            widths, offset = table["width_of_cut"], units.parse(table["offset"], "length")
            for width in widths if isinstance(widths, list) else [widths]:
                engagement_of_offset(units.parse(width, "length"), offset, diameter)
        elif cut == "angles":
            Engagement(units.parse(table["entry_angle"], "angle"), units.parse(table["exit_angle"], "angle"))
        elif cut == "strips":
            strips = [[units.parse(edge, "length") for edge in strip] for strip in table["strips"]]
            engagement_of_strips([(low, high) for low, high in strips], diameter)
    except InputError as error:
        yield (*where, needed[-1]), str(error)
    except (TypeError, ValueError):
        return  # said by the schema


def _cutting_tests(raw: Raw) -> Iterator[Complaint]:
    diameter = _quantity(raw.get("tool"), "diameter", "length")
    for where, table in _tables(raw, "cutting_test"):
        yield from _needs(raw, where, ("tool",), "a cutting test")
        if "feed_per_tooth" not in table and (what := _feed_needed(raw)):
            yield (*where, "feed_per_tooth"), f'is missing; {what} need the feed per tooth, feed_per_tooth = "0.1 mm"'
        if _quantity(table, "depth_of_cut", "length") == 0.0 and not _tests_forces(raw):
            yield (
                (*where, "depth_of_cut"),
                f"'{table['depth_of_cut']}' cuts nothing; only a [baseline] with forces reads the spindle in air: give "
                "a depth above zero",
            )
        yield from _fits(diameter, where, _quantity(table, "width_of_cut", "length"), table)


def _tests_forces(raw: Raw) -> bool:
    return isinstance(raw.get("baseline"), dict) and "forces" in raw["baseline"]


def _feed_needed(raw: Raw) -> str:
    """Return for what the feed of a cutting test is needed; nothing where only a verdict is asked."""
    baseline = raw.get("baseline")
    evidence = baseline.get("evidence") if isinstance(baseline, dict) else None
    if isinstance(baseline, dict) and ({"forces", "limits"} & set(baseline) or "limits" in (evidence or ())):
        return "the forces and limits of a [baseline]"
    return "the predictions of [[lobes]]" if "lobes" in raw else ""


def _baseline(raw: Raw) -> Iterator[Complaint]:
    """What a baseline of each kind is compared with, and what it is made of."""
    table = raw.get("baseline")
    if not isinstance(table, dict):
        return
    kinds = [key for key in ("from", "drive", "forces", "limits") if key in table]
    if len(kinds) > 1:
        yield ("baseline",), f"gives {' and '.join(kinds)}; one simulation is tested at a time, give one of them"
    elif "drive" in table:
        yield from _compared(raw, "measurement", "a measurement with method = 'drive'", ("drive",))
    elif "forces" in table:
        yield from _needs(raw, ("baseline",), ("tool", "material"), "a mechanistic force")
        yield from _compared(raw, "cutting_test", "a [[cutting_test]] with the forces of a cut")
    elif "limits" in table:
        yield from _needs(raw, ("baseline",), ("tool", "material"), "a limit depth")
        yield from _compared(raw, "cutting_test", "[[cutting_test]]s that bracket the limit")
        yield from _named(raw, ("baseline", "limits"), table["limits"])
    elif "from" in table:
        yield from _named(raw, ("baseline", "from"), table["from"])
    elif not {"tip_mass", "stiffness", "damping"} & set(table):
        yield (
            ("baseline",),
            "is taken for an axis of two masses, which these keys do not make; for another simulation give "
            'drive = "rigid", forces = "mechanistic", or a name with from or limits',
        )
    evidence = table.get("evidence")
    if isinstance(evidence, list) and "drive" in evidence:
        yield from _compared(raw, "measurement", "a measurement with method = 'drive'", ("drive",))
    if isinstance(evidence, list) and "limits" in evidence:
        yield from _needs(raw, ("baseline", "evidence"), ("tool", "material"), "a limit depth")
        yield from _compared(raw, "cutting_test", "[[cutting_test]]s that bracket the limit")


def _compared(raw: Raw, key: str, what: str, methods: Sequence[str] = ()) -> Iterator[Complaint]:
    tables = [t for _, t in _tables(raw, key) if not methods or t.get("method") in methods]
    if not any(t.get("held_out") is not True for t in tables):
        held = "; all of them are held out" if tables else ""
        yield ("baseline",), f"has nothing to be compared with{held}; add {what}"


def _held_out(raw: Raw) -> Iterator[Complaint]:
    for key in ("measurement", "cutting_test"):
        for where, table in _tables(raw, key):
            if "held_out" in table and "baseline" not in raw:
                yield (*where, "held_out"), "only a diagnosis reads it, and there is no [baseline]; take it out"


def _plan(raw: Raw) -> Iterator[Complaint]:
    table = raw.get("plan")
    if not isinstance(table, dict):
        return
    yield from _needs(raw, ("plan",), ("tool", "material"), "a plan")
    if "machine" in table:
        yield from _named(raw, ("plan", "machine"), table["machine"])
    elif "scenario" not in table and not _names_of(raw):
        yield ("plan",), "has no machine; add a [[model]], a [[measurement]], or scenario = the name of a scenario file"
    if "passes" in table and "width_of_cut" in table:
        yield ("plan", "width_of_cut"), "the passes have their widths; leave it out, or leave passes out"
    diameter = _quantity(raw.get("tool"), "diameter", "length")
    for place, entry in _tables(table, "passes"):
        yield from _fits(diameter, ("plan", *place), _quantity(entry, "width_of_cut", "length"), entry)


def _tune(raw: Raw) -> Iterator[Complaint]:
    table = raw.get("tune")
    if not isinstance(table, dict):
        return
    yield from _needs(raw, ("tune",), ("tool", "material"), "a search for gains")
    width = _quantity(table, "width_of_cut", "length")
    yield from _fits(_quantity(raw.get("tool"), "diameter", "length"), ("tune",), width, table)
    measured = table.get("measured")
    if isinstance(measured, dict) and "at_rest" in measured:
        yield from _named(raw, ("tune", "measured", "at_rest"), measured["at_rest"])


def _named(raw: Raw, where: Loc, name: Any, anywhere: bool = False) -> Iterator[Complaint]:
    """Refuse a name that nothing has; `anywhere` allows a machine whose compliance depends on feed and controller."""
    known = [known for _, known in _names_of(raw)]
    if name not in [*known, *_level_names(raw)]:
        near = did_you_mean(str(name), known)
        yield where, f"'{name}' is neither a measurement nor a model{near}; there are {listed(known)}"
    elif name == MACHINE and not anywhere and set(_machine(raw) or ()) & {"axis", "joint", "posture"}:
        yield (
            where,
            "the machine of [machine] has a compliance for each feed, controller and position, of which [[lobes]] "
            f"take that of the cut; name a measurement or a [[model]]: {listed([k for k in known if k != MACHINE])}",
        )


def _level_names(raw: Raw) -> Iterator[str]:
    """Yield what the depths of cut of sweeps are called."""
    for _, table in _tables(raw, "measurement"):
        if table.get("method") == "sweep" and table.get("split_levels") is not False:
            depths = {d for d in depths_of(table, [r for _, r in _records(table)]) if d is not None}
            yield from (level_name(str(table.get("name")), d) for d in sorted(depths) if len(depths) > 1)


def channel_complaints(raw: Raw) -> list[Complaint]:
    """Return the errors of the channels that a file declares."""
    return list(_channels(raw))


def _channels(raw: Raw) -> Iterator[Complaint]:
    base = _inherit({}, raw)
    yield from _channel_tables((), raw, base)
    for where, table in _tables(raw, "measurement"):
        inner = _inherit(base, table)
        yield from _channel_tables(where, table, inner)
        for place, record in _records(table):
            merged = _inherit(inner, record)
            yield from _channel_tables((*where, *place), record, merged)
            for other_place, other in _tables(record, "with"):
                yield from _other_recorder((*where, *place, *other_place), other, merged)
    for where, table in _tables(raw, "cutting_test"):
        yield from _channel_tables(where, table, _inherit(base, table))


def _other_recorder(where: Loc, other: Raw, merged: Mapping[str, Raw]) -> Iterator[Complaint]:
    own, shared = _inherit({}, other), other.get("shared")
    yield from _channel_tables(where, other, own)
    for known, what in ((own, "this file"), (merged, "the file it is added to")):
        if isinstance(shared, str) and shared in RECORD_CHANNELS and shared not in known:
            yield (*where, "shared"), f"'{shared}' is not declared for {what}; both need it in their channels"


def _own(table: Raw) -> dict[str, Raw]:
    channels = table.get("channels")
    if not isinstance(channels, dict):
        return {}
    return {name: entry for name, entry in channels.items() if name in CHANNELS and isinstance(entry, dict)}


def _inherit(base: Mapping[str, Raw], table: Raw) -> dict[str, Raw]:
    return merge(base, _own(table))


def merge(base: Mapping[str, Raw], own: Mapping[str, Raw]) -> dict[str, Raw]:
    """Merge declarations of channels key by key; a sample rate takes the place of a column and the other way round."""
    merged = dict(base)
    for name, entry in own.items():
        excluded = {"sample_rate": ("column",), "spacing": ("column",), "column": ("sample_rate", "spacing")}
        lost = {other for key in entry for other in excluded.get(key, ())} - set(entry)
        merged[name] = {**{key: value for key, value in merged.get(name, {}).items() if key not in lost}, **entry}
    return merged


def _channel_tables(where: Loc, table: Raw, merged: Mapping[str, Raw]) -> Iterator[Complaint]:
    for name, entry in _own(table).items():
        for key, text in _channel_entry(name, entry, merged[name]):
            yield (*where, "channels", name, *key), text


def _channel_entry(name: str, entry: Raw, merged: Raw) -> Iterator[Complaint]:
    if "column" in entry and "sample_rate" in entry:
        yield (), "gives a column and a sample_rate; a clock comes from one of them"
    if "column" in entry and "spacing" in entry:
        yield (), "gives a column and a spacing; the frequencies come from one of them"
    owners = (("sample_rate", "time"), ("pulses_per_revolution", "tacho"), ("spacing", "frequency"))
    for key, owner in (*owners, ("start", "frequency")):
        if key in entry and name != owner:
            yield (key,), f"belongs to the channel {owner} only; take it out"
    if "delay" in entry and (name == "time" or name in COMPLIANCE_CHANNELS):
        yield ("delay",), "this channel has no delay; give the delays of the channels that come late"
    unit = merged.get("unit")
    if "column" in merged and (unit is None or isinstance(unit, str)):
        try:
            unit_factor(name, unit)
        except InputError as error:
            yield ("unit",), str(error)


def path(where: Loc) -> str:
    """Return a place in the file as text: ``measurement[1].records[0].file``."""
    text = ""
    for part in where:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.lstrip(".")


# --- Depths of cut as the force levels of a sweep: how they are called, and what each of them needs.

TooFew = Callable[[set[tuple[str, float | None]]], str]

SAME_DEPTH = 1e-7
"""Depths of cut that differ by less are one [m]."""


def level_name(name: str, depth: float) -> str:
    """Return what the passes of one depth of cut [m] of a measurement are called."""
    return f"{name}, {units.show(depth, 'mm', 'length')}"


def rounded(depth: float | None) -> float | None:
    """Return a depth of cut [m] as it counts as a level."""
    return None if depth is None else round(depth / SAME_DEPTH) * SAME_DEPTH


def depths_of(table: Raw, records: Sequence[Raw]) -> list[float | None]:
    """Return the depth of cut of each record of a measurement [m]; None where neither of them states one."""
    return [rounded(_length(record, "depth_of_cut") or _length(table, "depth_of_cut")) for record in records]


def depth_complaints(table: Raw, records: Sequence[Raw], needed: int, too_few: TooFew) -> Iterator[str]:
    """Yield what keeps the depths of cut of a sweep from being force levels.

    Parameters
    ----------
    table : mapping
        The measurement.
    records : sequence of mapping
        Its records.
    needed : int
        Passes that differ in cut or width which an estimate needs.
    too_few : callable
        Says of (cut, width) pairs what is missing.
    """
    wish, depths = table.get("split_levels"), depths_of(table, records)
    known = sorted({d for d in depths if d is not None})
    if wish is False:
        return
    if len(known) < 2:
        if wish is True:
            yield "split_levels = true separates depths of cut, and its records do not state several; take it out"
        return
    said = ", ".join(units.show(d, "mm", "length") for d in known)
    if None in depths:
        yield (
            f"some passes state a depth of cut ({said}) and others none, so their force level is not known; give each "
            "its depth_of_cut, or split_levels = false for one estimate of all"
        )
        return
    for depth in known:
        here = [r for r, d in zip(records, depths, strict=True) if d == depth]
        passes = {(str(r.get("cut")), _length(r, "width_of_cut")) for r in here}
        if len(passes) < needed:
            cuts = " and ".join(_pass(cut, width) for cut, width in sorted(passes, key=str))
            yield (
                f"at a depth of cut of {units.show(depth, 'mm', 'length')} there is only {cuts}: {too_few(passes)} at "
                f"this depth, or give split_levels = false for one estimate of all depths ({said})"
            )


def _pass(cut: str, width: float | None) -> str:
    return cut if width is None else f"{cut} {units.show(width, 'mm', 'length')}"


def _length(table: Raw, key: str) -> float | None:
    """Return a length where it is one; what is wrong with it the field says itself."""
    try:
        return units.parse(table[key], "length")
    except (InputError, KeyError, TypeError):
        return None


# --- From what pydantic found to sentences: where, what was given, what is needed, what to do.


def complaints(error: ValidationError, root: type[BaseModel] = CampaignFile) -> list[Complaint]:
    """Return every error of the validation of a file whose tables begin at `root`, as (place, sentence)."""
    return [complaint(details, root) for details in error.errors()]


def complaint(details: ErrorDetails, root: type[BaseModel]) -> Complaint:
    """Return one error as (place, sentence)."""
    # A key of a table that is itself wrong is marked by pydantic with "[key]" behind it.
    where: Loc = tuple(part for part in details["loc"] if part != "[key]")
    cause = details.get("ctx", {}).get("error")
    if cause is not None:
        return where, str(cause)
    if details["type"] == "extra_forbidden":
        known = keys_at(where[:-1], root)
        near = did_you_mean(str(where[-1]), known)
        return where, f"this key is not known{near}; known here: {', '.join(sorted(known))}"
    if details["type"] == "missing":
        return where, "is missing; add it"
    message = _NEEDED.get(details["type"]) or details["msg"].replace("Input should be", "must be")
    shown = repr(details["input"])
    return where, f"{shown if len(shown) < 60 else shown[:57] + '...'}: {message}"


_TABLE = "must be a table, { key = ... } or [key] on a line of its own"

_NEEDED = {
    "model_type": _TABLE,
    "model_attributes_type": _TABLE,
    "dict_type": _TABLE,
    "list_type": "must be a list, [ ... ], and of tables [[ ... ]] on a line of its own",
    "tuple_type": "must be a list, [ ... ]",
    "string_type": 'must be a text in quotes, "..."',
    "int_type": "must be a whole number without quotes",
    "int_parsing": "must be a whole number without quotes",
    "int_from_float": "must be a whole number",
    "finite_number": "must be a finite number",
    "float_type": "must be a number without quotes",
    "float_parsing": "must be a number without quotes",
    "bool_type": "must be true or false, without quotes",
    "bool_parsing": "must be true or false, without quotes",
}
"""Kind of an error, as pydantic calls it -> what the file must hold, in the words of TOML."""


def keys_at(where: Loc, root: type[BaseModel] = CampaignFile) -> list[str]:
    """Return the keys that the table at a place of the file may have."""
    annotation: Any = root
    for part in where:
        annotation = _below(_table(annotation), part)
    table = _table(annotation)
    if not (isinstance(table, type) and issubclass(table, BaseModel)):
        return []
    return [field.alias or name for name, field in table.model_fields.items()]


def _below(annotation: Any, part: str | int) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        # A key that is a word of Python ("from", "with") is a field of another name.
        return next(
            field.annotation for name, field in annotation.model_fields.items() if (field.alias or name) == part
        )
    arguments = typing.get_args(annotation)
    return arguments[-1] if typing.get_origin(annotation) is dict else arguments[0]


def _table(annotation: Any) -> Any:
    """Strip ``Annotated`` and ``| None``."""
    while True:
        origin = typing.get_origin(annotation)
        if origin is typing.Annotated or origin in (types.UnionType, typing.Union):
            annotation = typing.get_args(annotation)[0]
        else:
            return annotation
