"""A portal with three feed axes, written down as bodies and springs, and hammer sets on it as a workshop records them.

Column on the x slide, headstock on the y slide of the column, ram on the z slide of the headstock. Guideways are
bristles with a Stribeck curve for each direction, servos sample an encoder, a joint of the ram may slip (Jenkins). Hits
lean, sensors are a little off, the machine is not quite what its maker says. Shares no code with the packages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import io, signal

from truth import three_axes_kernel as kernel
from truth.imperfect.bench import raised

Real = NDArray[np.float64]
AXES = "xyz"
BAND = (3.0, 140.0)
"""What campaigns compare [Hz]."""
STEP = 1.25e-4
RATE = 2000.0
LENGTH = 2.0
MM_MIN = 1.0 / 6e4


@dataclass(frozen=True)
class Guideway:
    """Friction of one slide (forth, back where two): Coulomb, static [N], Stribeck speed [m/s], viscous [N s/m]."""

    coulomb: tuple[float, float]
    static: tuple[float, float]
    speed: float
    viscous: tuple[float, float]
    contact: float
    contact_damping: float

    def row(self) -> Real:
        sides = [(c, s, self.speed, v) for c, s, v in zip(self.coulomb, self.static, self.viscous, strict=True)]
        return np.array([self.contact, self.contact_damping, *sides[0], *sides[1]])

    def scaled(self, forth: float, back: float) -> Guideway:
        """Multiply all of it, by direction."""
        sides = (
            tuple(f * x for f, x in zip((forth, back), given, strict=True))
            for given in (self.coulomb, self.static, self.viscous)
        )
        coulomb, static, viscous = sides
        return replace(self, coulomb=coulomb, static=static, viscous=viscous)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Portal:
    """Masses [kg], springs (row, N/m) and slides; 0 to 2 of each body are x, y, z: column, headstock, ram."""

    mass: Real
    damping: Real
    stiffness: Real
    slides: Real
    tool: Real
    joint: Real
    guideways: Mapping[str, Guideway]
    servos: Mapping[str, tuple[float, float, float, float]]
    elements: Real = field(default_factory=lambda: np.zeros((0, 2)))
    resolution: float = 2e-9

    def moving_mass(self, axis: str) -> float:
        """All that moves with a slide [kg]."""
        return {"x": 1.0, "y": 1.0, "z": 1.0}[axis] * float(self._carried(axis))

    def _carried(self, axis: str) -> float:
        i = AXES.index(axis)
        bodies = {"x": (0, 1, 4, 7), "y": (5, 8), "z": (9,)}[axis]
        del i
        return float(sum(self.mass[b, b] for b in bodies))


# Coordinates: 0 base x; 1 2 3 column top x y z; 4 5 6 headstock x y z; 7 8 9 ram x y z.
_NAMES = ("base", "cx", "cy", "cz", "hx", "hy", "hz", "rx", "ry", "rz")


def portal(rng: np.random.Generator) -> Portal:
    """Draw the machine of a maker."""

    def about(value: float, spread: float = 0.06) -> float:
        return float(value * np.exp(spread * np.clip(rng.standard_normal(), -2.0, 2.0)))

    base, column, head, ram = about(1500.0), about(700.0), about(550.0), about(380.0)
    mass = np.diag([base, column, column, column, head, head, head, ram, ram, ram])
    e = np.eye(10)
    places = [
        (e[1] - e[0], about(6.5e7)),  # the column bends along x
        (e[2], about(1.6e8)),  # ... and along y
        (e[3], about(9e8)),
        (e[4] - e[1], about(3.2e8)),  # headstock on the column
        (e[6] - e[3], about(9e7)),
        (e[7] - e[4] + 0.35 * (e[8] - e[5]), about(7.5e7)),  # the ram bends, not quite along the axes
        (e[8] - e[5] - 0.25 * (e[7] - e[4]), about(5.0e7)),
        (e[1] - e[0] + 0.5 * e[2], about(1.2e7)),
        (e[6] - e[3] + 0.4 * (e[4] - e[1]), about(2.0e7)),
    ]
    stiffness = np.sum([k * np.outer(v, v) for v, k in places], axis=0)
    damping = 2.2e-4 * stiffness + 1.5 * np.diag([0.0, column, column, column, 0, 0, 0, 0, 0, 0])
    slides = np.array([e[0], e[5] - e[2], e[9] - e[6]])
    guideways = {
        "x": Guideway((about(2000.0),) * 2, (about(2600.0),) * 2, about(8e-3), (about(1.0e4),) * 2, about(9e8), 3e5),
        "y": Guideway((about(1200.0),) * 2, (about(1450.0),) * 2, about(8e-3), (about(5.0e3),) * 2, about(5e8), 2e5),
        "z": Guideway((about(800.0),) * 2, (about(950.0),) * 2, about(8e-3), (about(3.0e3),) * 2, about(4e8), 1e5),
    }
    for a, g in guideways.items():
        if g.static[0] < 1.1 * g.coulomb[0]:
            guideways[a] = replace(g, static=(1.15 * g.coulomb[0],) * 2)
    total = {"x": base + column + head + ram, "y": head + ram, "z": ram}
    servos = {}
    for a, width in (("x", about(13.0)), ("y", about(18.0)), ("z", about(24.0))):
        w = 2.0 * math.pi * width
        servos[a] = (w * total[a], 2.5 / w, w / 5.0, 3.0)
    return Portal(mass, damping, stiffness, slides, np.eye(10)[7:], e[7] - e[4], guideways, servos)


def delay_of(portal: Portal, axis: str) -> float:
    """Dead time that the sampled loop amounts to [s]: its lag, half a period of holding, half a one of differencing."""
    return (portal.servos[axis][3] + 1.0) * STEP * kernel.SUBSTEPS


@dataclass(frozen=True)
class Set:
    """A hammer set: hits along x, y, z in one state."""

    name: str
    feed: float  # of all axes [mm/min]
    level: float  # impulse [N s]
    hits: int = 4


def design() -> list[Set]:
    """At rest and at four feeds, at two levels.

    Both directions at both speeds: with one feed in two directions the others say less than a ten-thousandth of what
    all say of a friction curve together with its difference between the directions, so that no feed left out tests it.
    """
    found = []
    for level, word in ((0.3, "light"), (1.0, "hard")):
        for feed in (0.0, 200.0, -200.0, 600.0, -600.0):
            way = "idle" if feed == 0.0 else f"{'m' if feed < 0 else 'p'}{abs(feed):.0f}"
            found.append(Set(f"hammer_{way}_{word}", feed, level))
    return found


@dataclass(frozen=True)
class Chain:
    """What sensors and hands do: gains, degrees, noise of the accelerometer [m/s2] and the hammer [N]."""

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    lean: float = 0.0
    noise: float = 2e-3
    force_noise: float = 0.1


def simulate(portal: Portal, feed: Sequence[float], way: Real, force: Real, joint: bool = True) -> Real:
    """Acceleration of the tool (3, n) under a force at the steps of the integrator, `way` of it along x, y, z."""
    friction = np.array([portal.guideways[a].row() for a in AXES])
    servo = np.array([portal.servos[a] for a in AXES])
    elements = portal.elements if joint else np.zeros((0, 2))
    stiffness = portal.stiffness - np.sum(elements[:, 0]) * np.outer(portal.joint, portal.joint)
    return kernel.run(
        np.linalg.inv(portal.mass),
        portal.damping,
        stiffness,
        portal.slides,
        portal.tool,
        friction,
        np.array(feed, dtype=float),
        servo,
        portal.resolution,
        portal.joint,
        np.ascontiguousarray(elements),
        force,
        way,
        STEP,
    )[0]


def hit(rng: np.random.Generator, impulse: float, count: int) -> Real:
    """Force of one blow [N] at the steps of the integrator."""
    width, start = rng.uniform(3.2e-3, 4.2e-3), 0.1 + rng.uniform(0.0, 2e-3)
    s = (np.arange(count) * STEP - start) / width
    shape = np.where((s > 0.0) & (s < 1.0), np.sin(np.pi * np.clip(s, 0.0, 1.0)) ** 1.3, 0.0)
    return np.asarray(impulse * rng.uniform(0.9, 1.1) * shape / (np.sum(shape) * STEP))


def measured(portal: Portal, one: Set, axis: str, chain: Chain, rng: np.random.Generator) -> dict[str, Real]:
    """Record of one set along one axis: time, force, accelerations."""
    filtered = signal.butter(6, 0.38 * RATE, fs=1.0 / STEP, output="sos")
    parts: dict[str, list[Real]] = {name: [] for name in ("force", *AXES)}
    count, every = round(LENGTH / STEP), round(1.0 / STEP / RATE)
    for _ in range(one.hits):
        force = hit(rng, one.level, count)
        # One motion, of all that a hit does: where guideways stick, motions of its parts do not add up to it.
        way = np.insert(math.radians(chain.lean) * rng.standard_normal(2), AXES.index(axis), 1.0)
        moved = simulate(portal, [one.feed * MM_MIN] * 3, way, force)
        for name, x in zip(("force", *AXES), (force, *moved), strict=True):
            parts[name].append(signal.sosfilt(filtered, x)[::every])
    out = {name: np.concatenate(x) for name, x in parts.items()}
    out["force"] = out["force"] + chain.force_noise * rng.standard_normal(out["force"].size)
    for a, g in zip(AXES, chain.gain, strict=True):
        out[a] = g * out[a] + chain.noise * rng.standard_normal(out[a].size)
    return {"time": np.arange(out["force"].size) / RATE, **out}


# --- What may be hidden.


def with_slip(portal: Portal, share: float, travel: float = 12e-6, count: int = 12) -> Portal:
    """Let a share of the ram's joint slip, its elements from small to large deformations."""
    own = portal.joint
    stiffness = float(own @ portal.stiffness @ own) / float(own @ own) ** 2
    each = share * stiffness / count
    limits = each * travel * (np.arange(count) + 0.5) / count
    return replace(portal, elements=np.column_stack([np.full(count, each), limits]))


def hidden(name: str, portal: Portal, sign: float, axis: str, size: float = 1.0) -> Portal:
    """Return the machine as it is where the maker's description lacks something."""
    if name == "friction_asymmetry":
        sides = {a: g.scaled(1.0 + 0.25 * sign * size, 1.0 - 0.25 * sign * size) for a, g in portal.guideways.items()}
        return replace(portal, guideways=sides)
    if name == "joint_micro_slip":
        return with_slip(portal, 0.25 * size)
    if name == "servo_gains":
        kp, ti, kv, lag = portal.servos[axis]
        return replace(portal, servos={**portal.servos, axis: (kp * (1.0 + 0.3 * sign * size), ti, kv, lag)})
    return portal


def real_parts(portal: Portal) -> Iterator[Real]:
    """Yield the real part of each direct compliance [m/N] that hard hits of the design find."""
    count = round(LENGTH / STEP)
    f = np.fft.rfftfreq(count, STEP)
    band = (f >= BAND[0]) & (f <= BAND[1])
    for one in (s for s in design() if s.level == 1.0):
        force = hit(np.random.default_rng(0), one.level, count)
        under = np.fft.rfft(force)[band] * -((2.0 * np.pi * f[band]) ** 2)
        for k, way in enumerate(np.eye(3)):
            yield (np.fft.rfft(simulate(portal, [one.feed * MM_MIN] * 3, way, force)[k])[band] / under).real


def cost_of(portal: Portal, before: Sequence[Real]) -> float:
    """Return by what a machine differs from one of other real parts, where that limits the depth of cut [1].

    The rms of the change of the real part, over its most negative value, on the lines within half of that; the largest
    of all sets and directions.
    """
    worst = 0.0
    for was, now in zip(before, real_parts(portal), strict=True):
        near = was < 0.5 * was.min()
        worst = max(worst, float(np.sqrt(np.mean((now - was)[near] ** 2)) / -was.min()))
    return worst


# --- A campaign of it.

COLUMNS = """[channels]
time = { column = "time", unit = "s" }
force_x = { column = "force", unit = "N" }
force_y = { column = "force", unit = "N" }
force_z = { column = "force", unit = "N" }
acceleration_x = { column = "x", unit = "m/s^2" }
acceleration_y = { column = "y", unit = "m/s^2" }
acceleration_z = { column = "z", unit = "m/s^2" }
"""


def axis_tables(portal: Portal, friction: str, rng: np.random.Generator) -> str:
    """Return what the maker says of the axes: gains as they are, masses within 5 %, friction as it is or viscous."""
    out = []
    for a in AXES:
        kp, ti, kv, _ = portal.servos[a]
        g = portal.guideways[a]
        out.append(f"[machine.axis.{a}]")
        out.append(f'moving_mass = "{portal.moving_mass(a) * (1.0 + 0.05 * rng.uniform(-1.0, 1.0)):.6g} kg"')
        out.append(
            f'controllers.K1 = {{ Kp = "{kp:.8g} N s/m", Ti = "{1e3 * ti:.8g} ms", Kv = "{kv:.8g} 1/s", '
            f'delay = "{1e3 * delay_of(portal, a):.6g} ms" }}'
        )
        sigma = f'sigma = "{float(np.mean(g.viscous)):.6g} N s/m"'
        if friction == "viscous":
            out.append(f'friction = {{ law = "viscous", {sigma} }}')
        elif friction:
            out.append(
                f'friction = {{ law = "andersson", coulomb = "{np.mean(g.coulomb):.6g} N", static = '
                f'"{np.mean(g.static):.6g} N", stribeck_speed = "{1e3 * g.speed:.6g} mm/s", {sigma}, '
                'kt = "30000 s/m" }'
            )
    return "\n".join(out)


def write_campaign(
    folder: Path,
    nominal: Portal,
    true: Portal,
    rng: np.random.Generator,
    friction: str = "andersson",
    chain: Chain | None = None,
    sets: Sequence[Set] | None = None,
    extra: str = "",
) -> Path:
    """Measure a machine that its maker describes by another, write the records and the campaign file."""
    lines = ['[campaign]\nname = "portal"\n', COLUMNS, '[baseline]\nfrom = "hammer_idle_light"\n']
    lines += [axis_tables(nominal, friction, rng), extra]
    for one in sets or design():
        records = []
        for a in AXES:
            found = measured(true, one, a, chain or Chain(), rng)
            io.savemat(folder / f"{one.name}_{a}.mat", found)
            records.append(f'{{ file = "{one.name}_{a}.mat", excitation = "{a}" }}')
        feed = ", ".join(f'{a} = "{one.feed:g} mm/min"' for a in AXES)
        lines.append(
            f'[[measurement]]\nname = "{one.name}"\nmethod = "hammer"\ncontroller = "K1"\nfeed = {{ {feed} }}\n'
            f'frequency_range = ["{BAND[0]:g} Hz", "{BAND[1]:g} Hz"]\nrecords = [{", ".join(records)}]\n'
        )
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines))
    return path


EFFECTS = ("guideway_friction", "friction_asymmetry", "joint_micro_slip", "servo_gains")
LARGEST = 3.0
"""An effect is raised up to this many times its size until it is material: a quarter of the joint to three."""


@dataclass(frozen=True)
class Written:
    """What is hidden in a campaign: each effect over its size, what all of it costs, and what is true."""

    sizes: Mapping[str, float]
    cost: float
    truths: Mapping[str, float]
    """Gains [N s/m] and differences of the friction between the directions [%], as a finding has them."""


def hidden_campaign(seed: int, effects: Sequence[str], folder: Path, sets: Sequence[Set] | None = None) -> Written:
    """Write a campaign of a drawn machine whose maker leaves some effects out; without any it is a healthy one.

    Sensors are calibrated within 0.3 %, hits lean by 0.5 degrees. An effect that matters less is raised.
    """
    rng = np.random.default_rng([2200, seed])
    nominal = portal(rng)
    true, sizes, cost = nominal, {}, 0.0
    for name in effects:
        sign, axis = float(rng.choice([-1.0, 1.0])), AXES[int(rng.integers(3))]
        # What the maker says nothing of is there in full.
        if name != "guideway_friction":
            of = partial(hidden, name, true, sign, axis)
            before = list(real_parts(true))
            sizes[name], own = raised(1.0, lambda x, of=of, before=before: cost_of(of(x), before), largest=LARGEST)
            true, cost = of(sizes[name]), max(cost, own)
    gains = 1.0 + 3e-3 * rng.standard_normal(3)
    chain = Chain(gain=(float(gains[0]), float(gains[1]), float(gains[2])), lean=0.5)
    law = "viscous" if "guideway_friction" in effects else "andersson"
    write_campaign(folder, nominal, true, rng, law, chain, sets)
    apart = {a: g.coulomb[0] / (0.5 * sum(g.coulomb)) - 1.0 for a, g in true.guideways.items()}
    gain = {f"Kp_{a}_K1": servo[0] for a, servo in true.servos.items()}
    return Written(sizes, cost, {**gain, **{f"friction_asymmetry_{a}": 100.0 * x for a, x in apart.items()}})
