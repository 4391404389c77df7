"""What is wrong with a sensor, put right in ``[channels]`` of the extended campaign: scale, sign, delay, axes.

A channel that shows ``(1 + g) x`` is mended by a scale of ``1/(1 + g)``. Channels that a measurement declares for
itself are mended alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from process import units
from process.labels import AXES
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.inference.problem import Family, Values
from smfe.diagnosis.judgement.finding import Finding

MOTIONS = ("acceleration", "velocity", "displacement")
"""Channels that a motion at the tool may come from."""

SENSORS = ("sensor_gain", "sensor_axis", "time_skew")
"""Ids of causes that stand in a sensor."""

Channels = dict[str, dict[str, Any]]


def mended(
    tables: Mapping[str, Any], family: Family, finding: Finding, tolerances: Tolerances
) -> tuple[dict[str, Any], set[str], str]:
    """Return the tables of a campaign with its channels put right.

    Parameters
    ----------
    tables : mapping
        Of the campaign.
    family : Family
        What was tested.
    finding : Finding
        With the causes that it names.
    tolerances : Tolerances
        Gains and clocks within them stay as they are.

    Returns
    -------
    dict, set of str, str
        The tables that change; keys of the causes that they hold; what they cannot hold, a sentence or "".
    """
    own = [c for c in finding.causes if c.id in SENSORS]
    sure = [c for c in own if c.set is None]
    said = ""
    if len(sure) < len(own):
        said = "[channels] is as it was: the data do not say whether a sensor is wrong, or what it was compared with."
    ids = {c.id for c in sure}
    values: dict[str, Any] = {}
    for name, what in _of_channels(family, finding.values, ids, tolerances):
        values[name] = values[name] * what if isinstance(what, float) and name in values else what
    if not values or "channels" not in tables:
        return {}, set(), said
    changed: dict[str, Any] = {"channels": _put_right(tables["channels"], values)}
    for key in ("measurement", "cutting_test"):
        if any("channels" in table for table in tables.get(key, ())):
            changed[key] = [
                {**t, "channels": _put_right(t["channels"], values)} if "channels" in t else t for t in tables[key]
            ]
    held = {
        c.key
        for c in family.causes
        if c.id in ids
        and any(p.name.startswith(("sign", "reversed_", "exchange", "quarter_", "turned_over")) for p in c.parameters)
    }
    return changed, held, said


def _of_channels(family: Family, values: Values, ids: set[str], t: Tolerances) -> Iterator[tuple[str, Any]]:
    """Yield channel -> scale, channel -> delay [s] as ``"NAME delay"``, and ``"exchange"`` -> two channels."""
    forces = tuple(f"force_{a}" for a in AXES)
    if "sensor_gain" in ids:
        if isinstance(family, CuttingForces):
            common = (1.0 + _beyond(values, "gain_common", t)) * _sign(values, "sign")
            for a, name in zip(AXES, forces, strict=True):
                yield name, common * (1.0 + _beyond(values, f"gain_{a}", t)) * _sign(values, f"sign_{a}")
        elif isinstance(family, DriveRecordFamily):
            for a in AXES:
                yield f"drive_force_{a}", 1.0 + _beyond(values, "force_gain.error", t)
        else:
            force = (1.0 + _beyond(values, "gain_force", t)) * _sign(values, "reversed_force")
            for name in forces:
                yield name, force
            for a in AXES:
                # Of one axis only the ratio of motion and force is known: it is put into the motion.
                shown = 1.0 + _beyond(values, f"gain_{a}", t) + _beyond(values, "gain_error", t)
                for motion in MOTIONS:
                    yield f"{motion}_{a}", shown * _sign(values, f"reversed_{a}")
    if "time_skew" in ids and abs(late := values.get("skew", 0.0)) > t.clock:
        for name in [f"{m}_{a}" for m in MOTIONS for a in AXES] if late > 0.0 else forces:
            yield f"{name} delay", abs(late)
    if "sensor_axis" in ids:
        over = values.get("turned_over", 0.0) > 0.5
        if over or values.get("exchange", 0.0) > 0.5:
            yield "exchange force", ("force_x", "force_y")
        if over:
            yield "force_z", -1.0
        for a, b in ("xy", "yz", "zx"):
            if max(values.get(f"exchanged_{a}{b}", 0.0), values.get(f"exchanged_{b}{a}", 0.0)) > 0.5:
                for motion in MOTIONS:
                    yield f"exchange {motion}", (f"{motion}_{a}", f"{motion}_{b}")
            if abs(quarter := values.get(f"quarter_{a}{b}", 0.0)) > 0.5:
                for motion in MOTIONS:
                    yield f"exchange {motion}", (f"{motion}_{a}", f"{motion}_{b}")
                    yield f"{motion}_{b if quarter > 0.0 else a}", -1.0


def _beyond(values: Values, name: str, t: Tolerances) -> float:
    """Return a gain where it is beyond what a workshop holds to, else zero."""
    value = values.get(name, 0.0)
    return value if abs(value) > t.sensor_gain else 0.0


def _sign(values: Values, name: str) -> float:
    return -1.0 if values.get(name, 0.0) > 0.5 else 1.0


def _put_right(channels: Mapping[str, Any], values: Mapping[str, Any]) -> Channels:
    """Return channels with what is wrong with them taken off, then with two exchanged that stand for each other."""
    out: Channels = {name: dict(table) if isinstance(table, Mapping) else table for name, table in channels.items()}
    for name, table in out.items():
        if not isinstance(table, dict):
            continue
        gain, late = values.get(name, 1.0), values.get(f"{name} delay", 0.0)
        if gain < 0.0:
            table["sign"] = -int(table.get("sign", 1))
        if abs(gain) != 1.0:
            table["scale"] = float(f"{table.get('scale', 1.0) / abs(gain):.8g}")
        if late:
            before = units.parse(table["delay"], "time") if "delay" in table else 0.0
            table["delay"] = f"{1e6 * (before + late):.8g} us"
    for what, pair in values.items():
        if what.startswith("exchange ") and set(pair) <= set(out):
            a, b = pair
            out[a], out[b] = out[b], out[a]
    return out
