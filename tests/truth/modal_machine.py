"""A ram on springs, written down as matrices of mass, damping and stiffness, and a campaign of compliances on it.

Nothing is modal here: every line is the inverse of ``K + j w C - w^2 M``, a loose joint is a row of Jenkins elements or
a cubic spring at a place in the structure, balanced at each line. A cable hangs on the tool whatever is hidden.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

AXES = "xyz"
NOMINAL_LEVEL = 100.0
TOP_SPEED = 300.0
LINES = np.geomspace(14.0, 150.0, 42)
FREE_MASSES = (12.0, 25.0)
REPEATS = 4
_ELEMENTS = 100


@dataclass(frozen=True)
class Ram:
    """Matrices of a machine whose first three coordinates are the tool's x, y, z, and where its main springs are."""

    mass: Real
    damping: Real
    stiffness: Real
    springs: tuple[tuple[Real, float], ...]

    def with_spring(self, vector: Real, stiffness: float) -> Ram:
        """Add a spring."""
        return replace(self, stiffness=self.stiffness + stiffness * np.outer(vector, vector))


def nominal(size: int, rng: np.random.Generator) -> Ram:
    """Draw the ram of a maker: three to five coordinates, springs along the axes and some that couple them."""
    e = np.eye(size)
    down = {3: {}, 4: {"x": 3}, 5: {"x": 3, "y": 4}}[size]
    places: list[tuple[Real, float]] = []
    for i, (axis, soft, stiff) in enumerate((("x", 1.3e7, 2.6e7), ("y", 2.4e7, 4.5e7), ("z", 1.5e7, 0.0))):
        if axis in down:
            places += [(e[down[axis]], soft), (e[i] - e[down[axis]], stiff)]
        else:
            places.append((e[i], soft))
    places += [(e[0] + 0.6 * e[2], 2.5e6), (e[0] - e[1], 2.0e6), (e[1] + 0.5 * e[2], 2.0e6)]
    springs = tuple((v, k * float(np.exp(0.1 * rng.standard_normal()))) for v, k in places)
    weights = np.array([90.0, 60.0, 130.0, 280.0, 320.0])[:size] * np.exp(0.05 * rng.standard_normal(size))
    stiffness = np.sum([k * np.outer(v, v) for v, k in springs], axis=0)
    mass = np.diag(weights)
    return Ram(mass, 9.0 * mass + 1.2e-4 * stiffness, stiffness, springs)


def modes(ram: Ram) -> tuple[Real, Real, Real, Real]:
    """Frequency [Hz], damping, stiffness [N/m] and unit vector at the tool of each mode."""
    root = np.sqrt(np.diag(ram.mass))
    squares, turned = np.linalg.eigh(ram.stiffness / np.outer(root, root))
    shapes = turned / root[:, None]
    w = np.sqrt(squares)
    damping = np.einsum("ir,ij,jr->r", shapes, ram.damping, shapes) / (2.0 * w)
    tool = shapes[:3].T
    length = np.linalg.norm(tool, axis=1)
    return w / (2.0 * np.pi), damping, squares / length**2, tool / length[:, None]


def wandered(ram: Ram, rng: np.random.Generator, spread: Mapping[str, float]) -> Ram:
    """Return the machine as built: its modes keep their shapes, and not quite frequency, damping and stiffness."""
    root = np.sqrt(np.diag(ram.mass))
    squares, turned = np.linalg.eigh(ram.stiffness / np.outer(root, root))
    shapes = turned / root[:, None]
    f, z, k = (
        np.exp(np.clip(spread[n] * rng.standard_normal(squares.size), -2.5 * spread[n], 2.5 * spread[n]))
        for n in ("frequency", "damping", "stiffness")
    )
    damping = np.einsum("ir,ij,jr->r", shapes, ram.damping, shapes) * z * f
    back = np.linalg.inv(shapes)
    parts = [back.T @ np.diag(d) @ back for d in (k / f**2, damping * k / f**2, squares * k)]
    return Ram(parts[0], parts[1], parts[2], ram.springs)


@dataclass(frozen=True)
class Hidden:
    """What is not in anybody's model (SI); none of it by default but the cable."""

    posture: float = 0.0
    bend: float = 0.0
    drift: float = 0.0
    softening: float = 0.0
    gyroscopic: float = 0.0
    coupling: float = 0.0
    sensor_mass: float = 0.0
    slip: float = 0.0
    cubic: float = 0.0
    mode: float = 0.0
    mode_frequency: float = 70.0
    mode_direction: tuple[float, float, float] = (0.6, 0.64, 0.48)
    flexible: float = 0.0
    gain: Mapping[str, float] = field(default_factory=dict)
    exchanged: str = ""
    reversed: str = ""
    turned: float = 0.0
    skew: float = 0.0
    cable: float = 0.003
    cable_frequency: float = 47.0
    dashpot: float = 0.0
    scale: float = 0.0
    mass: float = 0.0


@dataclass(frozen=True)
class Setting:
    """Where and how a compliance is measured; `free_mass` [kg] hangs in the machine's place."""

    position: float = 0.0
    order: float = 0.0
    speed: float = 0.0
    level: float = NOMINAL_LEVEL
    sensor: str = ""
    added_mass: float = 0.0
    free_mass: float = 0.0


def cubic_share(a: Real) -> Complex:
    """First harmonic of ``x^3`` over x."""
    return 0.75 * a**2 + 0j


def jenkins_share(a: Real, limits: Real) -> Complex:
    """First harmonic of springs of equal stiffness that slip at `limits`, over that of springs that do not."""
    ratio = np.clip(limits / np.maximum(a[..., None], 1e-300), 0.0, 1.0)
    angle = np.arccos(1.0 - 2.0 * ratio)
    real = (angle - 0.5 * np.sin(2.0 * angle)) / math.pi
    lost = 4.0 / math.pi * ratio * (1.0 - ratio)
    return np.mean(real + 1j * lost, axis=-1)


def dynamic_stiffness(ram: Ram, hidden: Hidden, setting: Setting, frequency: Real) -> Complex:
    """``K + j w C - w^2 M`` of one setting, shape (f, n, n)."""
    size = ram.mass.shape[0]
    w = 2.0 * np.pi * frequency[:, None, None]
    (support, k), (other, k_other) = ram.springs[0], ram.springs[1]
    change = hidden.posture * setting.position + hidden.bend * setting.position**2 + hidden.drift * setting.order
    turning = setting.speed / TOP_SPEED
    stiffness = ram.stiffness + change * k * np.outer(support, support)
    stiffness = stiffness - hidden.softening * turning**2 * k_other * np.outer(other, other)
    cross = np.zeros((size, size))
    cross[0, 1] = 1.0
    stiffness = stiffness + hidden.coupling * math.sqrt(stiffness[0, 0] * stiffness[1, 1]) * (cross + cross.T)
    stiffness = stiffness * (1.0 + hidden.scale)
    carried = setting.added_mass + hidden.sensor_mass * {"laser": 0.0, "two": 2.0}.get(setting.sensor, 1.0)
    mass = ram.mass * (1.0 + hidden.scale) * (1.0 + hidden.mass) + np.diag([carried] * 3 + [0.0] * (size - 3))
    gyro = hidden.gyroscopic * turning * math.sqrt(stiffness[0, 0] * stiffness[1, 1]) / (2.0 * np.pi * 60.0)
    damping = ram.damping * (1.0 + hidden.scale) + gyro * (cross - cross.T)
    dash = np.zeros(size)
    dash[:2] = 1.0, 0.7
    damping = damping + hidden.dashpot * np.outer(dash, dash)
    out = stiffness + 1j * w * damping - w**2 * mass
    # A cable: a small mass that swings at the tool.
    weight, own = hidden.cable, (2.0 * np.pi * hidden.cable_frequency) ** 2
    swing = own + 0.1j * w[:, 0, 0] * math.sqrt(own)
    for i in range(3):
        out[:, i, i] -= weight * w[:, 0, 0] ** 2 * swing / (swing - w[:, 0, 0] ** 2)
    return out


def compliance(ram: Ram, hidden: Hidden, setting: Setting, frequency: Real) -> Complex:
    """Compliance at the tool as the sensors show it, shape (f, 3, 3)."""
    if setting.free_mass:
        mass = setting.free_mass + hidden.sensor_mass * {"laser": 0.0, "two": 2.0}.get(setting.sensor, 1.0)
        phi = -np.eye(3) / (mass * (2.0 * np.pi * frequency[:, None, None]) ** 2) + 0j
    else:
        phi = at_tool(ram, hidden, setting, frequency)
    show = np.eye(3) if setting.sensor == "laser" else sensors(hidden)
    late = np.exp(-2j * np.pi * frequency * hidden.skew)[:, None, None]
    return show @ phi * late * (1.0 + hidden.gain.get("force", 0.0))


def at_tool(ram: Ram, hidden: Hidden, setting: Setting, frequency: Real) -> Complex:
    """Compliance at the tool, the loose joint balanced, shape (f, 3, 3)."""
    z = dynamic_stiffness(ram, hidden, setting, frequency)
    out = np.linalg.inv(z)[:, :3, :3]
    if hidden.slip or hidden.cubic:
        out = np.stack([_balanced(ram, hidden, setting, z, j) for j in range(3)], axis=2)
    if hidden.mode:
        d = np.array(hidden.mode_direction)
        ratio = frequency / hidden.mode_frequency
        out = out + hidden.mode * np.outer(d, d) / (1.0 - ratio**2 + 0.07j * ratio)[:, None, None]
    if hidden.flexible:
        d = np.array([0.8, 0.0, 0.6])
        out = out + hidden.flexible * np.outer(d, d) / (1.0 - (frequency / 600.0) ** 2)[:, None, None]
    return out


def _balanced(ram: Ram, hidden: Hidden, setting: Setting, z: Complex, axis: int) -> Complex:
    """Compliance under a sine along one axis, with the joint's first harmonic at the amplitude that it has, (f, 3)."""
    vector, k = ram.springs[0]
    own = np.linalg.inv(z)
    direct = own @ vector
    at_joint, to_tool = vector @ own[:, :, axis].T, direct[:, :3]
    through = direct @ vector
    typical = NOMINAL_LEVEL / k / 0.08
    limits = typical * 8.0 * (np.arange(_ELEMENTS) + 0.5) / _ELEMENTS
    extra = np.zeros(z.shape[0], dtype=complex)
    for _ in range(400):
        a = np.abs(at_joint / (1.0 + extra * through)) * setting.level
        fresh = hidden.cubic * k / typical**2 * cubic_share(a) + hidden.slip * k * (jenkins_share(a, limits) - 1.0)
        if np.all(np.abs(fresh - extra) < 1e-10 * k):
            break
        extra = 0.5 * (extra + fresh)
    answer = (extra * at_joint / (1.0 + extra * through))[:, None]
    return own[:, :3, axis] - to_tool * answer


def sensors(hidden: Hidden) -> Real:
    """What the accelerometer makes of a motion."""
    c, s = math.cos(hidden.turned), math.sin(hidden.turned)
    out = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    if hidden.exchanged:
        i, j = (AXES.index(a) for a in hidden.exchanged)
        out[[i, j]] = out[[j, i]]
    for a, g in hidden.gain.items():
        if a in AXES:
            out[AXES.index(a)] *= 1.0 + g
    for a in hidden.reversed:
        out[AXES.index(a)] *= -1.0
    return out


@dataclass(frozen=True)
class Record:
    """Repeated measurements of a compliance [m/N], shape (r, f, 3, 3)."""

    setting: Setting
    frequency: Real
    value: Complex


def measure(
    ram: Ram, hidden: Hidden, settings: Sequence[Setting], snr: float, rng: np.random.Generator
) -> list[Record]:
    """Measure every setting with an accelerometer, whose noise is `snr` [dB] below the response at 100 N."""
    plain = compliance(ram, Hidden(), Setting(), LINES)
    color = LINES[0] / LINES
    size = np.sqrt(REPEATS * np.mean(np.abs(plain) ** 2) / np.mean(color**2)) * 10.0 ** (-snr / 20.0)
    found = []
    for setting in settings:
        phi = compliance(ram, hidden, setting, LINES)
        shape = (REPEATS, *phi.shape)
        noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        noise *= (size * color / math.sqrt(2.0) * NOMINAL_LEVEL / setting.level)[None, :, None, None]
        found.append(Record(setting, LINES, phi + noise))
    return found


def full_design(rng: np.random.Generator) -> list[Setting]:
    """Contrasts of everything, in a random order between two visits to the first position."""
    home = Setting()
    middle = [
        *(replace(home, free_mass=m) for m in FREE_MASSES),
        *(replace(home, position=p) for p in (0.35, 0.7, 1.0)),
        *(replace(home, speed=s * TOP_SPEED) for s in (0.7, 1.0)),
        *(replace(home, level=s * NOMINAL_LEVEL) for s in (0.5, 2.0)),
        replace(home, sensor="laser"),
        home,
    ]
    ordered = [home, *(middle[i] for i in rng.permutation(len(middle))), home]
    return [replace(s, order=i / (len(ordered) - 1)) for i, s in enumerate(ordered)]


def peak_shift(ram: Ram, hidden: Hidden, levels: tuple[float, float]) -> tuple[float, float]:
    """Change of height and frequency of the highest direct peak along x from one level to another, relative."""
    coarse = np.arange(10.0, 150.0, 1.0)
    top = coarse[np.argmax(np.abs(at_tool(ram, replace(hidden, slip=0.0, cubic=0.0), Setting(), coarse)[:, 0, 0]))]
    f = np.arange(top - 4.0, top + 7.0, 0.05)
    tops = []
    for level in levels:
        setting = Setting(level=level)
        x = np.abs(_balanced(ram, hidden, setting, dynamic_stiffness(ram, hidden, setting, f), 0)[:, 0])
        tops.append((x.max(), f[np.argmax(x)]))
    return tops[1][0] / tops[0][0] - 1.0, tops[1][1] / tops[0][1] - 1.0


def sized(ram: Ram, what: str, target: float) -> Hidden:
    """Find the joint that changes the peak so much, from the level to twice it (slip), from half of it to twice."""
    low, high = 0.0, 1.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        levels = (NOMINAL_LEVEL if what == "slip" else 0.5 * NOMINAL_LEVEL, 2.0 * NOMINAL_LEVEL)
        height, shift = peak_shift(ram, Hidden(**{what: middle}), levels)
        reached = -height if what == "slip" else shift
        low, high = (low, middle) if reached > target else (middle, high)
    return Hidden(**{what: high})


def effect(name: str | None, ram: Ram, rng: np.random.Generator, size: float = 1.0) -> Hidden:
    """Hide an effect of the size that must be found, times `size`; signs and directions are drawn."""
    sign, axis = float(rng.choice([-1.0, 1.0])), AXES[int(rng.integers(3))]
    plane = ("xy", "yz", "zx")[int(rng.integers(3))]
    largest = float(np.abs(compliance(ram, Hidden(), Setting(), LINES)).max())
    if name in ("micro_slip", "hardening"):
        return sized(ram, *{"micro_slip": ("slip", 0.05 * size), "hardening": ("cubic", 0.03 * size)}[name])
    known = {
        None: {},
        "posture": {"posture": 0.05 * sign * size},
        "posture_bend": {"posture": 0.05 * sign * size, "bend": 0.03 * size},
        "drift": {"drift": 0.03 * sign * size},
        "spindle_softening": {"softening": 0.05 * size},
        "gyroscopic": {"gyroscopic": 0.05 * size},
        "coupling": {"coupling": 0.05 * sign * size},
        "mass_loading": {"sensor_mass": 0.02 * float(ram.mass[0, 0]) * size},
        "missing_mode": {"mode": 0.003 * largest * size, "mode_frequency": float(rng.uniform(35.0, 120.0))},
        "residual": {"flexible": 0.02 * largest * size},
        "gain": {"gain": {axis: 0.05 * sign * size}},
        "force_gain": {"gain": {"force": 0.05 * sign * size}},
        "exchanged": {"exchanged": plane},
        "reversed": {"reversed": axis},
        "turned": {"turned": math.radians(5.0) * sign * size},
        "skew": {"skew": 50e-6 * sign * size},
        "cable": {"cable": 1.5 * size},
        "dashpot": {"dashpot": 2500.0 * size},
        "scale": {"scale": 0.4 * sign * size},
        "mass": {"mass": 0.15 * size},
    }
    return Hidden(**known[name])
