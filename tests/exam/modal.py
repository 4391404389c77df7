"""From compliances of the independent ram to conditions that can be diagnosed: the linear modal baseline."""

from dataclasses import dataclass, replace

import numpy as np
from truth.modal_machine import (
    AXES,
    Hidden,
    Record,
    Setting,
    effect,
    full_design,
    measure,
    modes,
    nominal,
    wandered,
)
from truth.modal_workshop import measure_ordinarily

from process.machine.modes import ModalModel
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import Excited, degrees_of_freedom_of
from smfe.diagnosis.frf.workshop import apart
from smfe.diagnosis.inference.problem import Condition

SPREAD = {"frequency": 0.01, "damping": 0.2, "stiffness": 0.05}
FLOOR = 0.002
ALL = tuple((r, e) for r in AXES for e in AXES)

NAMES = {
    "posture": "posture",
    "posture_bend": "posture",
    "drift": "drift",
    "spindle_softening": "spindle_speed_dynamics",
    "gyroscopic": "spindle_speed_dynamics",
    "coupling": "cross_axis_coupling",
    "mass_loading": "accelerometer_mass",
    "micro_slip": "joint_micro_slip",
    "hardening": "joint_hardening",
    "missing_mode": "missing_mode",
    "residual": "missing_mode",
    "gain": "sensor_gain",
    "force_gain": "sensor_gain",
    "exchanged": "sensor_axis",
    "reversed": "sensor_gain",
    "turned": "sensor_axis",
    "skew": "time_skew",
    "scale": "modal_scale",
    "mass": "modal_mass",
}
"""Hidden effect -> cause that must be named."""


def settings_of(setting: Setting) -> dict[str, float | str]:
    """What the campaign says of a condition."""
    found: dict[str, float | str] = {"order": setting.order, "level": setting.level}
    if setting.free_mass:
        return found | {"free_mass": setting.free_mass}
    found |= {"position": setting.position, "spindle_speed": setting.speed, "sensor": setting.sensor}
    return found | {"added_mass": setting.added_mass}


def name_of(setting: Setting) -> str:
    """For people."""
    if setting.free_mass:
        return f"free mass of {setting.free_mass:g} kg, at {setting.order:.2f}"
    return (
        f"{setting.position:g} m, {setting.speed:g} rad/s, {setting.level:g} N, {setting.sensor or 'accelerometer'}, "
        f"+{setting.added_mass:g} kg, at {setting.order:.2f}"
    )


def excited_by(record: Record, entries=ALL, floor=FLOOR) -> tuple[Excited, np.ndarray]:
    """How a record was excited, with its noise: that of an accelerometer, its size from the repeats."""
    value, f = record.value, record.frequency
    count, mean = len(value), value.mean(axis=0)
    parted = [apart(value[:, :, :, e], f, mean, e) for e in range(3)]
    away = np.stack([noise for _, noise in parted], axis=3) * f[None, :, None, None]
    size = np.sqrt(np.sum(np.abs(away) ** 2, axis=(0, 1)) / ((count - 1) * f.size * count))
    pick = [(AXES.index(r), AXES.index(e)) for r, e in entries]
    std = np.stack([np.hypot(size[i, j] / f, floor * np.abs(mean[:, i, j])) for i, j in pick], axis=1)
    seen = np.stack([mean[:, i, j] for i, j in pick], axis=1)
    rows = [np.stack([x[:, :, i] * (j == e) for i, j in pick], axis=2) for e, (x, _) in enumerate(parted)]
    known = degrees_of_freedom_of(count, std.size)
    more = {"degrees_of_freedom": known, "repeats": count, "shared": np.concatenate(rows)}
    return Excited(f, tuple(entries), std, "actuator", record.setting.level, **more), seen


def condition_of(record: Record, entries=ALL, measured=True) -> Condition:
    """A condition of the exam."""
    excited, seen = excited_by(record, entries)
    observed = excited.whitened(seen) if measured else None
    return Condition(name_of(record.setting), settings_of(record.setting), observed, "", excited)


def machine(seed: int):
    """Nominal ram, ram as built, and the generator of all further draws."""
    rng = np.random.default_rng([seed, 77])
    ram = nominal(int(rng.integers(3, 6)), rng)
    return ram, wandered(ram, rng, SPREAD), rng


def draw(
    hidden, seed, design=full_design, proposals=(), snr=40.0, entries=ALL, without=(), size=1.0, more=(), ordinary=False
):
    """Family of a campaign with effects hidden (a name, or several), and what was hidden.

    Parameters
    ----------
    hidden : str, sequence of str or None
        What to hide.
    design : callable
        From a generator to the settings that are measured.
    proposals : sequence of (Setting, entries)
        What could be measured next.
    more : sequence of (Setting, entries)
        What is measured besides the design.
    ordinary : bool
        Whether hits lean and sensors are not exact, as in a workshop.
    """
    taken = measure_ordinarily if ordinary else measure
    ram, built, rng = machine(seed)
    chosen = (hidden,) if hidden is None or isinstance(hidden, str) else tuple(hidden)
    plain, true = Hidden(), Hidden()
    for name in chosen:
        one = effect(name, built, rng, size)
        true = replace(true, **{k: v for k, v in vars(one).items() if v != getattr(plain, k)})
    records = taken(built, true, design(rng), snr, rng)
    conditions = [condition_of(r, entries) for r in records]
    for setting, own in more:
        conditions.append(condition_of(measure(built, true, [setting], snr, rng)[0], own))
    proposed = [
        condition_of(measure(built, Hidden(), [s], snr, np.random.default_rng(0))[0], own, measured=False)
        for s, own in proposals
    ]
    model = ModalModel(*modes(ram))
    # The tool of this ram does not turn: an accelerometer beside its place shows what the point does.
    known = Tolerances(sensor_position=0.0)
    found = ModalFrfs(model, tuple(conditions), tuple(proposed), without, SPREAD, tuple(SPREAD), known)
    return found.with_errors(), true


def family(hidden: str | None, seed: int, snr: float = 40.0, without=(), size: float = 1.0):
    """Return the family of a campaign of the full design with an effect hidden, and the cause that must be named."""
    found, _ = draw(hidden, seed, snr=snr, without=without, size=size)
    return found, NAMES.get(hidden)


@dataclass(frozen=True)
class Pair:
    """Two effects that a design does not separate, and what separates them.

    `design` and `entries` are what is measured first, `separating` what settles it; the effects are hidden `size` times
    as large as they must be found.
    """

    effects: tuple[str, str]
    design: tuple[Setting, ...]
    separating: tuple[tuple[Setting, tuple], ...]
    entries: tuple = ALL
    sizes: tuple[float, float] = (1.0, 1.0)


ALONG_X = tuple((r, "x") for r in AXES)
PASS = tuple(Setting(position=p, order=p) for p in (0.0, 0.25, 0.5, 0.75, 1.0))
AT_HOME = tuple(Setting(level=v) for v in (50.0, 100.0, 200.0))
PAIRS = {
    "posture or drift": Pair(("posture", "drift"), PASS, ((Setting(order=1.0), ALL),)),
    "mass of the sensor or of the modes": Pair(
        ("mass_loading", "mass"),
        AT_HOME,
        tuple((Setting(sensor="laser", level=v), ALL) for v in (100.0, 200.0)),
        sizes=(4.0, 1.0),
    ),
    "turned sensor or turned modes": Pair(("turned", "coupling"), AT_HOME, ((Setting(order=1.0), ALL),), ALONG_X),
    "gain or scale": Pair(
        ("force_gain", "scale"), AT_HOME, tuple((Setting(free_mass=m), ALL) for m in (12.0, 25.0)), sizes=(8.0, 1.0)
    ),
}
"""What is known to be confounded."""


def pair(name, which, seed, settled):
    """Family of a pair's campaign with one of its effects hidden, before or after it is settled, and the truth."""
    p = PAIRS[name]
    more, proposed = (p.separating, ()) if settled else ((), p.separating[:1])
    hidden = p.effects[which]
    found, _ = draw(hidden, seed, lambda rng: p.design, proposed, entries=p.entries, size=p.sizes[which], more=more)
    return found, NAMES[hidden]
