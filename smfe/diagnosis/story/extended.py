"""The extended model as a campaign: the file of the campaign with what was found in place of what was given.

Modes, coefficients, run-out, masses, gains and friction have tables of their own; all other causes stand under
``known`` of ``[baseline]``. The records are those of the campaign, so that the file can be diagnosed, and lobes
computed from it, as it stands; and each table can be pasted into the campaign.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import linalg

from process import units
from process.errors import InputError
from process.friction.laws import LuGre
from process.machine.modes import HIGHEST_DAMPING, ModalModel
from process.types import Real
from smfe.campaign import Campaign
from smfe.campaign.datasets import PREFIX
from smfe.campaign.toml import document
from smfe.diagnosis.cases.known import written
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits, Limit, material_of
from smfe.diagnosis.cutting.rigid import tooth_radii
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.evidence.family import AxisEvidence
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import Side
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.inference.problem import Condition, Family, Values
from smfe.diagnosis.judgement.finding import Finding
from smfe.diagnosis.machine.axes import key as key_of
from smfe.diagnosis.machine.dynamics import bounded
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.story.channels import mended
from smfe.diagnosis.story.millimetres import coefficients_found

NAME = "extended"
"""What a model is called that a measurement gave before."""

HEAD = "# The extended model of a diagnosis, as a campaign: what was found in place of what was given."
"""First line of the file."""

_STIFF, _STIFF_DAMPING = 20.0, 0.02
"""Frequency over the highest of the band, and damping, of a mode that stands for what is above the band."""

_STEEP = "600000 s/m"


@dataclass(frozen=True)
class Extended:
    """The extended model as a campaign file."""

    text: str  # of the file
    left_out: tuple[str, ...] = ()  # what it cannot hold, a sentence each


@dataclass
class _Draft:
    """Tables that change, and the causes that have a table of their own."""

    tables: dict[str, Any]
    held: set[str] = field(default_factory=set)  # keys of causes
    left_out: list[str] = field(default_factory=list)


def extended_campaign(campaign: Campaign, family: Family, finding: Finding, folder: Path) -> Extended:
    """Return the extended model as a campaign file that stands in a folder.

    Parameters
    ----------
    campaign : Campaign
        What was diagnosed.
    family : Family
        What was tested.
    finding : Finding
        With the parameters of the best model.
    folder : Path
        Where the file will stand: names of records are relative to it.

    Returns
    -------
    Extended
        Text that `smfe.read_campaign` reads, and what it cannot hold.
    """
    draft = _Draft(_tables(campaign, folder))
    if finding.values:
        for kind, write in _WRITERS.items():
            if isinstance(family, kind):
                whole = _Draft(dict(draft.tables), set(draft.held), list(draft.left_out))
                try:
                    write(whole, campaign, family, finding.values)
                    draft = whole
                except InputError as refused:  # a fit that ended where no machine and no material is
                    draft.left_out.append(f"What was found is no model, and what was declared stands here: {refused}.")
        _write_channels(draft, campaign, family, finding)
        _write_known(draft, campaign, family, finding)
    lines = [HEAD, *(f"# {text}" for text in draft.left_out)]
    return Extended("\n".join(lines) + "\n\n" + document(draft.tables), tuple(draft.left_out))


def _write_channels(draft: _Draft, campaign: Campaign, family: Family, finding: Finding) -> None:
    """Put what is wrong with a sensor right in its channel."""
    tables, held, said = mended(draft.tables, family, finding, campaign.tolerances)
    draft.tables |= tables
    draft.held |= held
    draft.left_out += [said] if said else []


def _write_known(draft: _Draft, campaign: Campaign, family: Family, finding: Finding) -> None:
    """Put what has no table of its own under ``known``, and what was known before as it was."""
    known = {key: dict(given) for key, given in campaign.known.items()}
    found = {(c.id, c.variant) for c in finding.causes}
    for cause in family.causes:
        if (cause.id, cause.variant) in found and cause.key not in draft.held:
            known[cause.key] = {p.name: written(finding.values[p.name], p) for p in cause.parameters}
            if cause.kind == "physics":
                draft.left_out.append(f"Lobes do not know of {cause.title}; a diagnosis does (known).")
    if known and "baseline" in draft.tables:
        draft.tables["baseline"] = {**draft.tables["baseline"], "known": known}


# --- What stays as it is.


def _tables(campaign: Campaign, folder: Path) -> dict[str, Any]:
    """Return the tables of a campaign, with the names of its records relative to another folder."""
    raw: dict[str, Any] = {"campaign": {"name": campaign.name}}
    with suppress(OSError, ValueError):
        raw = tomllib.loads(campaign.path.read_text(encoding="utf-8-sig"))
    away = os.path.relpath(campaign.path.parent, folder)

    def moved(name: Any) -> Any:
        if isinstance(name, list):
            return [moved(n) for n in name]
        if not isinstance(name, str) or Path(name).is_absolute() or away == "." or name.startswith(PREFIX):
            return name
        return Path(away, name).as_posix()

    def walked(value: Any, key: str = "") -> Any:
        if isinstance(value, Mapping):
            return {k: moved(v) if k in ("file", "background") else walked(v, k) for k, v in value.items()}
        return [walked(v) for v in value] if isinstance(value, list) else value

    for key in ("measurement", "cutting_test"):
        if key in raw:
            raw[key] = walked(raw[key])
    return raw


# --- Each family.


def _write_axis(draft: _Draft, campaign: Campaign, family: MachineFrfs, values: Values) -> None:
    """Masses, stiffness, damping, servo and friction; joints, sensors, what changes with place and time are known."""
    baseline = family.baseline
    alone = {name: 0.0 for name in ("stiffness_per_metre", "stiffness_over_session", "sensor_mass")}
    found = baseline.effective({**values, **alone}, {}, 0.0)
    table = dict(draft.tables.get("baseline", {"axis": baseline.axis}))
    table |= {
        "moving_mass": _text(found.masses[0], "kg"),
        "tip_mass": _text(found.masses[1], "kg"),
        "stiffness": _text(1e-6 * found.stiffness, "N/um"),
        "damping": _text(found.damping, "N s/m"),
        "friction": _friction(found.friction),
    }
    as_set = baseline.effective({**values, "period": 0.0}, {}, 0.0).servos
    # The period of the samples stands beside the gains that are set; a servo without samples has those that act.
    told, acts = (
        {
            name: {"Kp": _text(s.Kp, "N s/m"), "Ti": _text(1e3 * s.Ti, "ms"), "Kv": _text(s.Kv, "1/s")}
            | ({"delay": _text(1e3 * s.delay, "ms")} if s.delay else {})
            for name, s in zip(baseline.servos, servos, strict=True)
        }
        for servos in (as_set, found.servos)
    )
    if any(s.delay for s in as_set):
        table["period"] = _text(1e3 * values.get("period", baseline.period or 0.0), "ms")
    if set(told) == {""}:
        table |= told[""]
    elif told:
        table["controllers"] = told
    draft.tables["baseline"] = table
    law = baseline.machine(found).axes[baseline.axis].friction
    friction = _bristles(law) if isinstance(law, LuGre) else table["friction"]
    _put_axis(draft, baseline.axis, {**table, "friction": friction}, acts)
    held = ("guideway_friction", "friction_asymmetry", "servo_gains", "loop_delay")
    draft.held |= {c.key for c in family.causes if c.id in held}
    if isinstance(family, AxisEvidence) and family.cuts is not None:
        _put_material(draft, material_of(family.cuts.coefficients, values))


_OF_LOBES = (
    *("cut", "width_of_cut", "offset", "entry_angle", "exit_angle", "strips"),
    *("feed_per_tooth", "spindle_speed", "maximum_depth", "controller"),
)
"""Keys of ``[[lobes]]`` that those of the machine of the extended model share with what was asked for."""


def _put_axis(draft: _Draft, axis: str, table: Mapping[str, Any], controllers: Mapping[str, Any]) -> None:
    """Write an axis as ``[machine.axis]`` too, and ask for the lobes of that machine beside those of measurements.

    A machine that the campaign gives already has this axis in place of its own, or stays what it is.
    """
    machine = dict(draft.tables.get("machine", {}))
    axes = dict(machine.get("axis", {}))
    if machine and (axis not in axes or "modes" in machine):
        return
    own = {key: table[key] for key in ("moving_mass", "tip_mass", "stiffness", "damping", "friction")}
    named = {name or "control": gains for name, gains in controllers.items()}
    axes[axis] = own | ({"controllers": named} if named else {})
    draft.tables["machine"] = {**machine, "axis": axes}
    _ask_for_machine(draft)


def _ask_for_machine(draft: _Draft) -> None:
    """Ask for the lobes of the machine at the cuts whose lobes are asked for."""
    asked = draft.tables.get("lobes", [])
    if asked and not any("machine" in lobes.get("measurements", []) for lobes in asked):
        draft.tables["lobes"] = [
            *asked,
            *(
                {
                    **{key: lobes[key] for key in _OF_LOBES if key in lobes},
                    "measurements": ["machine"],
                    # Harmonic balance knows no friction with memory; linearised at the feed of the cut it is known.
                    "method": "zero_order" if lobes["method"] == "operating_point" else lobes["method"],
                }
                for lobes in asked
            ),
        ]


def _friction(sides: tuple[Side, Side]) -> dict[str, Any]:
    """Return the friction of both directions as a campaign has it."""
    forth, back = sides
    if max(forth.static, back.static) <= 0.0:
        if forth.viscous == back.viscous:
            return {"law": "viscous", "sigma": _text(forth.viscous, "N s/m")}
        forth, back = (s._replace(coulomb=0.0, static=0.0, speed=1.0) for s in sides)
    if forth == back and forth.static <= forth.coulomb:
        return {"law": "coulomb_viscous", "coulomb": _text(forth.coulomb, "N"), "sigma": _text(forth.viscous, "N s/m")}
    law = {"law": "andersson", **_side(forth), "kt": _STEEP}
    return law if forth == back else {**law, "negative": _side(back)}


def _bristles(law: LuGre) -> dict[str, Any]:
    """Return friction with what the guideway gives way before it slides, on which small vibration depends."""

    def side(one: LuGre) -> dict[str, str]:
        return {
            "coulomb": _text(one.coulomb, "N"),
            "static": _text(one.static, "N"),
            "stribeck_speed": _text(6e4 * one.stribeck_speed, "mm/min"),
            "sigma": _text(one.sigma, "N s/m"),
        }

    stiff = {"bristle_stiffness": _text(1e-6 * law.bristle_stiffness, "N/um")}
    forth = {"law": "lugre", **side(law), **stiff, "bristle_damping": _text(law.bristle_damping, "N s/m")}
    return forth if law.negative is None else {**forth, "negative": side(law.negative)}


def _side(s: Side) -> dict[str, str]:
    return {
        "coulomb": _text(s.coulomb, "N"),
        "static": _text(max(s.static, s.coulomb), "N"),
        "stribeck_speed": _text(6e4 * (s.speed or 6e-3), "mm/min"),
        "sigma": _text(s.viscous, "N s/m"),
    }


def _write_modes(draft: _Draft, campaign: Campaign, family: ModalFrfs, values: Values) -> None:
    """Modes as found, with those that were missing; what changes with place, time, speed or level is known."""
    draft.held |= {c.key for c in family.causes if c.id in ("modal_scale", "modal_mass", "missing_mode")}
    draft.held |= {c.key for c in family.causes if c.id == "cross_axis_coupling"}
    own = {n: v for n, v in values.items() if not n.startswith(_BESIDE)}
    model = found_modes(family, own)
    name = getattr(campaign.baseline, "source", NAME)
    _put_model(draft, name, model)


_BESIDE = ("posture", "curved", "drift", "bearings", "gyroscopic", "also_", "joint_", "sensor_mass", "gain_", "turned_")
"""Beginnings of the parameters that are no part of the modes themselves."""


def found_modes(family: ModalFrfs, values: Values) -> ModalModel:
    """Return the modes of a set of values, further modes among them.

    Springs between the axes turn and shift the modes: those of ``(I + S) q = lambda M q`` in coordinates that are
    scaled to unit stiffness, with the damping that each then has on the diagonal.
    """
    return _modes_and_turn(family, values)[0]


def momentum_of(family: MachineOfAxes, values: Values) -> Real:
    """Return the momentum of each of `found_modes` along each axis for a unit of its velocity [kg], (axes, modes).

    Those that stand for what is missing in the band or lies above it ride on no slide.
    """
    model, turn = _modes_and_turn(family, values)
    free = [[values.get(f"momentum_{a}_{r + 1}", 0.0) for r in range(len(turn))] for a in family.axes]
    mass = np.array([values[f"moving_mass_{a}"] for a in family.axes])
    own = family.changed(_somewhere(family), values).frequency
    along = bounded(np.array(free)) * np.sqrt(mass)[:, None] / (2.0 * np.pi * np.array(own)) @ turn
    return np.pad(along, ((0, 0), (0, model.frequency.size - turn.shape[1])))


def _somewhere(family: ModalFrfs) -> Condition:
    """Return how the machine stands in the extended model: where it was first measured, at the session's begin."""
    settings: dict[str, float | str] = {"sensor": "laser", "order": 0.0}
    place = next((float(c.settings["position"]) for c in family.conditions if "position" in c.settings), None)
    return Condition("modes", settings if place is None else {**settings, "position": place})


def _modes_and_turn(family: ModalFrfs, values: Values) -> tuple[ModalModel, Real]:
    """Return the modes, and what a unit of each is in coordinates of unit stiffness, (own modes, modes in the band)."""
    m = family.changed(_somewhere(family), values)
    count = len(m.frequency)
    f, z, k = (np.array(x) for x in (m.frequency, m.damping, m.stiffness))
    u = np.array(m.direction).reshape(count, 3)
    turn = np.diag(np.sqrt(k))
    if m.springs:
        shape, w = u / np.sqrt(k)[:, None], 2.0 * np.pi * f
        square, q = linalg.eigh(np.eye(count) + np.array(m.springs).reshape(count, count), np.diag(1.0 / w**2))
        # Columns of unit modal mass: stiffness w^2, damping 2 z w on the diagonal.
        turns = np.sqrt(square)
        z = np.einsum("ir,i,ir->r", q, 2.0 * z / w, q) / (2.0 * turns)
        f, k, u = turns / (2.0 * np.pi), square, q.T @ shape
        size = np.linalg.norm(u, axis=1)
        u, k = u / size[:, None], k / size**2
        turn = q / size
    if m.mode:
        along = np.array(m.mode[:3])
        size = float(np.linalg.norm(along))
        f, z = np.append(f, m.mode[3]), np.append(z, m.mode[4])
        k, u = np.append(k, 1.0 / size**2), np.vstack([u, along / size])
    if m.residual:
        xx, yy, zz, xy, yz, zx = m.residual
        size_of, direction = np.linalg.eigh(np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]))
        for s, v in zip(size_of, direction.T, strict=True):
            if s > 0.0:
                f, z = np.append(f, _STIFF * float(f.max())), np.append(z, _STIFF_DAMPING)
                k, u = np.append(k, 1.0 / s), np.vstack([u, v])
    return ModalModel(f, np.minimum(z, HIGHEST_DAMPING), k, u), turn


def _write_axes(draft: _Draft, campaign: Campaign, family: MachineOfAxes, values: Values) -> None:
    """Masses, gains, dead times and friction of the axes that the modes ride on, beside the modes themselves.

    With the momentum of the modes along them that is a machine, whose lobes stand beside those of measurements.
    """
    machine = dict(draft.tables.get("machine", {}))
    axes = dict(machine.get("axis", {}))
    momentum = dict(zip(family.axes, momentum_of(family, values), strict=True))
    for a, declared in family.axes.items():
        own = dict(axes.get(a, {})) | {"moving_mass": _text(values[f"moving_mass_{a}"], "kg")}
        own["coupling"] = [_text(x, "kg") for x in momentum[a]]
        own["controllers"] = {
            name: {
                "Kp": _text(values[key_of("Kp", a, name)], "N s/m"),
                "Ti": _text(1e3 * values[key_of("Ti", a, name)], "ms"),
                "Kv": _text(values[key_of("Kv", a, name)], "1/s"),
                "delay": _text(1e3 * values[key_of("delay", a, name)], "ms"),
            }
            for name in declared.controllers
        }
        if not own["controllers"]:
            del own["controllers"]
        if declared.friction is None:
            own["friction"] = {"law": "viscous", "sigma": _text(values[f"viscous_{a}"], "N s/m")}
        else:
            apart, grown = values.get(f"friction_asymmetry_{a}", 0.0), 1.0 + values.get(f"friction_{a}", 0.0)
            mean = 0.5 * (declared.friction[0].viscous + declared.friction[1].viscous)
            sides = [
                Side(
                    grown * (1.0 + sign * apart) * side.coulomb,
                    grown * (1.0 + sign * apart) * side.static,
                    side.speed,
                    values[f"viscous_{a}"] * (1.0 + sign * apart) * (side.viscous / mean if mean > 0.0 else 1.0),
                )
                for sign, side in zip((1.0, -1.0), declared.friction, strict=True)
            ]
            # A law with a contact of its own keeps it: what it does at rest was measured with it.
            if own.get("friction", {}).get("law") in ("viscous", "coulomb", "coulomb_viscous", "andersson"):
                own["friction"] = _friction((sides[0], sides[1]))
                draft.held |= {c.key for c in family.causes if c.id == "friction_asymmetry"}
        axes[a] = own
    draft.tables["machine"] = {**machine, "axis": axes}
    _ask_for_machine(draft)


def _put_model(draft: _Draft, name: str, model: ModalModel) -> None:
    """Replace the modes of a ``[[model]]``, or of ``[machine]``; those of a measurement become a model of their own."""
    modes = [
        {
            "frequency": _text(f, "Hz"),
            "damping": float(f"{z:.8g}"),
            "stiffness": _text(1e-6 * k, "N/um"),
            "direction": [float(f"{c:.8g}") for c in u],
        }
        for f, z, k, u in zip(model.frequency, model.damping, model.stiffness, model.direction, strict=True)
    ]
    models = list(draft.tables.get("model", []))
    for number, table in enumerate(models):
        if table.get("name") == name:
            models[number] = {**table, "modes": modes}
            draft.tables["model"] = models
            return
    machine = draft.tables.get("machine", {})
    if name == "machine" and "modes" in machine:
        draft.tables["machine"] = {**machine, "modes": modes}
        return
    draft.tables["model"] = [*models, {"name": NAME, "modes": modes}]
    baseline = dict(draft.tables.get("baseline", {}))
    for key in ("from", "limits"):
        if key in baseline:
            baseline[key] = NAME
    draft.tables["baseline"] = baseline
    draft.tables["lobes"] = [
        {**lobes, "measurements": [*lobes.get("measurements", []), NAME]} for lobes in draft.tables.get("lobes", [])
    ]
    if not draft.tables["lobes"]:
        del draft.tables["lobes"]


def _write_forces(draft: _Draft, campaign: Campaign, family: CuttingForces, values: Values) -> None:
    """Coefficients, edge forces, helix and the run-out of each tooth; what sensors do is known."""
    if campaign.coefficients is None or campaign.tool is None:
        return
    _put_material(draft, coefficients_found(family, campaign.coefficients, values))
    tool = dict(draft.tables.get("tool", {}))
    if "helix" in values and abs(values["helix"] - family.tool.helix_angle) > 1e-6:
        tool["helix_angle"] = _text(math.degrees(values["helix"]), "deg")
    radii = tooth_radii(family.tool, values)
    if float(np.ptp(radii - family.tool.tooth_offsets())) > 0.0:
        tool["runout"] = [_text(1e6 * r, "um") for r in radii]
    draft.tables["tool"] = tool
    draft.held |= {c.key for c in family.causes if c.id == "runout" or c.key == "edge_forces"}


def _put_material(draft: _Draft, found: Any) -> None:
    material = dict(draft.tables.get("material", {}))
    for name in ("Ktc", "Krc", "Kac"):
        material[name] = _text(1e-6 * getattr(found, name), "N/mm^2")
    for name in ("Kte", "Kre", "Kae"):
        if getattr(found, name) or name in material:
            material[name] = _text(1e-3 * getattr(found, name), "N/mm")
    draft.tables["material"] = material


def _write_limits(draft: _Draft, campaign: Campaign, family: CuttingLimits, values: Values) -> None:
    """Modes and coefficients; process damping, joints and the spindle's speed are known."""
    _put_material(draft, family.material(values))
    beside = ("micro_slip_", "linear_", "square_")
    own = {n: v for n, v in values.items() if not n.startswith(beside)}
    _put_model(draft, getattr(campaign.baseline, "source", NAME), family.changed(own, Limit(1000.0)))
    held = ("force_coefficients", "cross_axis_coupling", "missing_mode")
    draft.held |= {c.key for c in family.causes if c.id in held}


def _write_drive(draft: _Draft, campaign: Campaign, family: DriveRecordFamily, values: Values) -> None:
    """Mass, dead time and gains; friction and the other forces are known, and are also those of ``[machine.axis]``."""
    table = dict(draft.tables.get("baseline", {}))
    if "moving_mass" in table and "mass" in values:
        table["moving_mass"] = _text(values["mass"], "kg")
    delay = values["loop_delay.delay"]
    later = delay - next(p.start for p in family.nuisances if p.name == "loop_delay.delay")
    if delay > 0.0:
        table["delay"] = _text(1e3 * delay, "ms")
    for key, name, unit in (("Kp", "velocity", "N s/m"), ("Kv", "position", "1/s")):
        given = getattr(campaign.baseline, key, None)
        if given is not None and key in table:
            table[key] = _text(given * (1.0 + values.get(f"servo_gains.{name}", 0.0)), unit)
    if "friction" in table:
        # What differs between the directions is a cause of its own, and stands under `known`.
        table["friction"] = _drive_friction({**values, "asymmetry.viscous": 0.0})
        draft.held |= {"guideway_friction/coulomb", "low_speed_friction/stribeck"}
    draft.tables["baseline"] = table
    draft.held |= {"loop_delay", "servo_gains"}
    axis = getattr(campaign.baseline, "axis", "x")
    machine = draft.tables.get("machine", {})
    if axis in machine.get("axis", {}):
        own = dict(machine["axis"][axis])
        own["friction"] = _drive_friction(values)
        own["controllers"] = {n: _later(c, later) for n, c in own.get("controllers", {}).items()}
        draft.tables["machine"] = {**machine, "axis": {**machine["axis"], axis: own}}


def _drive_friction(values: Values) -> dict[str, Any]:
    force, boost = values.get("coulomb.force", 0.0), values.get("stribeck.boost", 0.0)
    apart, speed = values.get("asymmetry.viscous", 0.0), values.get("stribeck.speed", 0.02)
    forth, back = (
        Side(force, force + boost, speed, max(values["viscous"] + sign * apart, 0.0)) for sign in (1.0, -1.0)
    )
    exponent = values.get("stribeck.exponent", 1.0)
    table = _friction((forth, back))
    return table if boost == 0.0 or exponent == 1.0 else {**table, "delta": float(f"{exponent:.6g}")}


def _later(controller: Mapping[str, Any], extra: float) -> dict[str, Any]:
    delay = units.parse(controller["delay"], "time") if "delay" in controller else 0.0
    return {**controller, "delay": _text(1e3 * max(delay + extra, 0.0), "ms")}


_WRITERS: Mapping[type, Callable[..., None]] = {
    MachineFrfs: _write_axis,
    ModalFrfs: _write_modes,
    MachineOfAxes: _write_axes,
    CuttingForces: _write_forces,
    CuttingLimits: _write_limits,
    DriveRecordFamily: _write_drive,
}


def _text(value: float | Real, unit: str) -> str:
    return f"{float(value):.8g} {unit}"
