"""Records of cuts drawn at random over what workshops do, with their limits found by force. Imports no package.

A cut: 2 to 8 teeth, one to three modes, arcs from a narrow side cut to a slot, run-out and single inserts that stand
proud, helix or straight inserts, entry and exit, a speed that drifts, sags and waves, modes that drift.
A record: accelerometers on the structure (modes through unknown shapes, resonances of the housing, noise, hum) or a
microphone (room, narrow band, clipping, noise, hum, tones of the machine). The limit: the depth at which a small push
neither grows nor dies (`chatter_kernel.push`); a cut that as a whole, teeth leaving it, does otherwise is drawn again
(`clear`). One that is labelled chatter has had time to grow e^8 times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy import fft, signal

from truth.chatter_kernel import integrate, push, speed_at

STEPS_A_WAVE = 36
FEED = 1e-4


@dataclass(frozen=True)
class Cut:
    """A cut without its depth; SI. steps: of the angle a turn; lags: of the teeth; runout (Z, slices)."""

    teeth: int
    speed: float
    arc: tuple[float, float]
    steps: int
    lags: np.ndarray
    runout: np.ndarray
    lag: int
    kt: float
    kr: float
    w: np.ndarray
    zeta: np.ndarray
    mass: np.ndarray
    shape: np.ndarray
    bend: np.ndarray
    drift: float
    sag: float
    wave: float

    def speed_at(self, at: float) -> float:
        """Speed [rad/s] at a place in the record, -0.5 to 0.5."""
        return self.speed * math.pi / 30.0 * (1.0 + at * self.drift - self.sag)


@dataclass(frozen=True)
class Drawn:
    """A record and what is true of it. classes: what it was drawn with."""

    time: np.ndarray
    channels: dict[str, np.ndarray]
    rpm: float
    stated_rpm: float
    teeth: int
    share: float
    frequency: float
    cut_from: float
    cut_to: float
    classes: tuple[str, ...]
    tacho: np.ndarray | None = None
    notes: dict[str, float] = field(default_factory=dict)


def growth(cut: Cut, depth: float, at: float = 0.0, waves: float = 90.0) -> tuple[float, float]:
    """Return how a push grows [1/s] and its frequency [Hz] at a depth [m]; at: -0.5 to 0.5 through all that drifts."""
    bend, omega = at, cut.speed_at(at)
    w = cut.w * (1.0 + bend * cut.bend)
    turns = max(14, math.ceil(waves * omega / w.min()))
    out = np.zeros((turns * cut.steps, 2))
    slices = cut.runout.shape[1]
    arc = np.array([*cut.arc, cut.steps])
    push(omega, arc, cut.lags, slices, cut.lag, depth / slices, cut.kt, cut.kr, w, cut.zeta, cut.mass, cut.shape, out)
    size = np.sqrt((out.reshape(turns, cut.steps, 2) ** 2).mean(axis=(1, 2))) + 1e-300
    late = np.arange(turns // 2, turns)
    turn = 2.0 * math.pi / omega
    rate = float(np.polyfit(late * turn, np.log(size[late]), 1)[0])
    piece = out[(turns // 2) * cut.steps :]
    piece = piece * np.exp(-rate * turn / cut.steps * np.arange(piece.shape[0]))[:, None]
    length = 4 * piece.shape[0]
    power = (np.abs(np.fft.rfft(piece * np.hanning(piece.shape[0])[:, None], length, axis=0)) ** 2).sum(axis=1)
    return rate, float(np.fft.rfftfreq(length, turn / cut.steps)[np.argmax(power[1:]) + 1])


def limit(cut: Cut) -> float:
    """Return the depth [m] at which a push neither grows nor dies, within 1 %; inf where there is none."""
    low = 0.02 / (cut.kt * np.max((cut.shape**2).sum(axis=1) / (cut.mass * cut.w**2)))
    if growth(cut, low)[0] > 0.0:
        return math.nan
    high = low
    for _ in range(24):
        high *= 1.5
        if growth(cut, high)[0] > 0.0:
            break
        low = high
    else:
        return math.inf
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if growth(cut, middle)[0] < 0.0 else (low, middle)
    return math.sqrt(low * high)


def repeats(cut: Cut, depth: float, runout: bool, at: float, span: float) -> float:
    """Return by how much the motion differs from that a period before, over its largest value, in the whole cut.

    Without run-out the period is that of a tooth, with it that of a turn. Constant speed, no noise: what is left after
    `span` [s] decides whether a cut chatters where its forced motion makes teeth leave the cut,
    and a small push does not.
    """
    bend, omega = at, cut.speed_at(at)
    count = int(span * omega / (2.0 * math.pi) * cut.steps)
    out, clock = np.zeros((count, cut.w.size + 2)), np.zeros(count)
    arc, ramps = np.array([*cut.arc, cut.steps]), np.array([0.0, 0.1 * span, 2.0 * span, 3.0 * span])
    steady = np.array([span, omega, 0.0, 0.0, 1.0, 0.0, 1.0])
    still, w = np.zeros(cut.w.size), cut.w * (1.0 + bend * cut.bend)
    e = cut.runout if runout else 0.0 * cut.runout
    law = _law(cut, depth)
    integrate(
        steady, arc, ramps, cut.lags, e, cut.lag, law, w, cut.zeta, cut.mass, cut.shape, still, 0.0, 1, 1, out, clock
    )
    back = cut.steps if runout else cut.steps // cut.teeth
    last = out[-3 * cut.steps :, : cut.w.size].sum(axis=1)
    return float(np.abs(last[back:] - last[:-back]).max() / np.abs(last).max())


def _law(cut: Cut, depth: float) -> np.ndarray:
    feed = FEED * cut.teeth * cut.speed / 60.0
    return np.array([depth / cut.runout.shape[1], cut.kt, cut.kr, 0.02 * cut.kt * FEED, feed])


def clear(cut: Cut, depth: float, chatters: bool, doubling: bool, span: float) -> bool:
    """Whether the whole cut does what the small push does, at both ends of what drifts."""
    for at in (-0.5, 0.5):
        tooth = repeats(cut, depth, False, at, span)
        turn = repeats(cut, depth, True, at, span)
        if not chatters and max(tooth, turn) > 0.02:
            return False
        if chatters and (tooth < 0.2 or (turn < 0.2 and not doubling)):
            return False
    return True


def _cut(rng: np.random.Generator, teeth: int, flip: bool) -> tuple[Cut, list[str]]:
    classes = []
    main = math.exp(rng.uniform(math.log(35.0), math.log(1300.0)))
    # Waves a tooth: deep in the lobes, or up to the first; period doubling lives above the first.
    waves = rng.uniform(0.4, 0.75) if flip else math.exp(rng.uniform(math.log(0.6), math.log(9.0)))
    speed = 60.0 * main / waves / teeth
    modes = int(rng.integers(1, 4))
    w = main * np.concatenate([[1.0], rng.uniform(0.6, 3.0, modes - 1)])
    turn = rng.uniform(0.0, math.pi, modes)
    stiffness = 1e7 * np.concatenate([[1.0], rng.uniform(1.5, 6.0, modes - 1)])
    slot = rng.uniform() < 0.15 and not flip
    width = math.pi if slot else math.acos(1.0 - 2.0 * (rng.uniform(0.04, 0.15) if flip else rng.uniform(0.08, 0.8)))
    down = rng.uniform() < 0.6
    arc = (math.pi - width, math.pi) if down else (0.0, width)
    slices = int(rng.choice([1, 1, 4]))
    steps = max(60, math.ceil(STEPS_A_WAVE * w.max() / (speed / 60.0)))
    steps = teeth * math.ceil(steps / teeth)
    lags = np.arange(teeth) * (steps // teeth)
    lag = 0 if slices == 1 else max(1, round(steps * rng.uniform(0.005, 0.03)))
    # What a tooth cuts at most; run-out leaves every tooth some of it.
    chip = FEED * (1.0 if arc[0] < 0.5 * math.pi < arc[1] else math.sin(width))
    size = chip * math.exp(rng.uniform(math.log(0.01), math.log(0.4)))
    classes += ["run-out"] if size > 0.1 * chip else []
    runout = size * np.cos(2.0 * np.pi * np.arange(teeth) / teeth + rng.uniform(0.0, 6.28))
    if rng.uniform() < 0.4:
        runout = runout + size * rng.uniform(0.2, 0.8) * rng.standard_normal(teeth)
        runout *= min(1.0, 0.4 * chip / np.abs(runout).max())
    bend = np.zeros(modes)
    if rng.uniform() < 0.3:
        bend[:] = rng.choice([-1.0, 1.0]) * rng.uniform(0.015, 0.08)
        classes.append("drifting modes")
    drift = 0.0
    if rng.uniform() < 0.6:
        drift = rng.uniform(-0.01, 0.01)
        classes.append("speed drift")
    cut = Cut(
        teeth=teeth,
        speed=speed,
        arc=arc,
        steps=steps,
        lags=lags,
        runout=np.repeat(runout[:, None], slices, axis=1),
        lag=lag,
        kt=rng.uniform(7e8, 2.5e9),
        kr=0.0,
        w=2.0 * np.pi * w,
        zeta=np.exp(rng.uniform(math.log(0.01), math.log(0.06), modes)),
        mass=stiffness / (2.0 * np.pi * w) ** 2,
        shape=np.stack([np.cos(turn), np.sin(turn)], axis=1),
        bend=bend,
        drift=drift,
        sag=rng.uniform(0.0, 0.003),
        wave=rng.uniform(0.0, 3e-4),
    )
    return Cut(**{**cut.__dict__, "kr": cut.kt * rng.uniform(0.2, 0.5)}), classes


def draw(seed: int, share: tuple[float, float]) -> Drawn:
    """Draw a cut at a share of its limit (from, to), and a record of it."""
    rng = np.random.default_rng(seed)
    teeth = int(rng.integers(2, 9))
    flip = bool(rng.uniform() < 0.2)
    at = rng.uniform(*share)
    while True:
        cut, classes = _cut(rng, teeth, flip)
        depth = at * limit(cut)
        if not math.isfinite(depth):
            continue
        rates = [growth(cut, depth, place) for place in (-0.5, 0.0, 0.5)]
        shortest = max(1.2, 40.0 * 60.0 / cut.speed)
        if (at < 1.0 and max(r for r, _ in rates) > 0.0) or shortest > 8.0:
            continue
        if at >= 1.0:
            rate = min(r for r, _ in rates)
            if rate <= 0.0 or 8.0 / rate > 4.0:
                continue
            shortest = max(shortest, 8.0 / rate)
        doubling = at > 1.0 and abs(rates[1][1] / (cut.teeth * cut.speed / 60.0) % 1.0 - 0.5) < 0.01
        if clear(cut, depth, at > 1.0, doubling, shortest):
            break
    classes += ["period doubling"] if doubling else []
    long = shortest * rng.uniform(1.0, 1.8)
    return _record(rng, cut, depth, at, rates[1][1], long, classes) or draw(seed + 10**9, share)


def _record(rng, cut: Cut, depth, share, frequency, long, classes: list[str]) -> Drawn | None:
    """Make the record; none where a cut above the limit, as integrated with its entry, stays periodic all the same."""
    lead, tail = rng.uniform(0.15, 1.0, 2) * (rng.uniform(size=2) < 0.7)
    enter, leave = np.maximum(rng.uniform(0.02, 0.5, 2), 120.0 / cut.speed)
    classes += ["entry" if lead > 0.0 else "no entry", "exit" if tail > 0.0 else "no exit"]
    span = lead + enter + long + leave + tail
    ramps = np.array([lead, lead + enter, lead + enter + long, lead + enter + long + leave])
    if lead == 0.0:
        ramps[:2] = -enter, 0.0
    if tail == 0.0:
        ramps[2:] = span + 1.0, span + 2.0
    omega = cut.speed * math.pi / 30.0
    count = int(span * omega * 1.012 / (2.0 * math.pi) * cut.steps)
    out, clock = np.zeros((count, cut.w.size + 2)), np.zeros(count)
    spindle = np.array([span, omega, cut.drift, cut.sag, rng.uniform(0.1, 0.4), cut.wave, rng.uniform(0.3, 3.0)])
    law = _law(cut, depth)
    noise, hold = rng.uniform(0.005, 0.04), max(1, cut.steps // 150)
    arc = np.array([*cut.arc, cut.steps])
    integrate(
        spindle,
        arc,
        ramps,
        cut.lags,
        cut.runout,
        cut.lag,
        law,
        cut.w,
        cut.zeta,
        cut.mass,
        cut.shape,
        cut.bend,
        noise,
        hold,
        int(rng.integers(2**31)),
        out,
        clock,
    )
    if share > 1.0 and not ("period doubling" in classes and cut.teeth % 2 == 0):
        late = np.flatnonzero((clock > ramps[1] + 0.6 * long) & (clock < min(ramps[2], clock[-1])))
        motion = out[:, : cut.w.size].sum(axis=1)
        change = motion[late] - motion[late - cut.steps]
        power = np.sort(np.abs(np.fft.rfft(change * np.hanning(change.size))) ** 2)[::-1]
        # Chatter is few lines; what noise makes differ from turn to turn is many.
        if (
            np.sqrt((change**2).mean()) < 0.2 * np.sqrt((motion[late] ** 2).mean())
            or power[:60].sum() < 0.5 * power.sum()
        ):
            return None
    end = min(span, float(clock[-1]))
    rate = float(np.clip(8.0 * cut.w.max() / (2.0 * math.pi), 2000.0, 12000.0)) * rng.uniform(1.0, 1.3)
    time, source = _uniform(clock, out, end, rate)
    sound = bool(rng.uniform() < 0.5)
    classes.append("sound" if sound else "acceleration")
    turns = np.concatenate([[0.0], np.cumsum([speed_at(t, *spindle) for t in time[:-1]])]) * (time[1] - time[0])
    channels = _microphone(rng, time, source, turns) if sound else _sensors(rng, time, source, turns, cut)
    mean_rpm = 60.0 / (2.0 * math.pi) * float(turns[-1] / time[-1])
    stated = mean_rpm * (1.0 + rng.uniform(-0.004, 0.004))
    pulses = (np.mod(turns + rng.uniform(0.0, 6.28), 2.0 * math.pi) < 0.5).astype(float)
    return Drawn(
        time=time,
        channels=channels,
        rpm=mean_rpm,
        stated_rpm=stated,
        teeth=cut.teeth,
        share=share,
        frequency=frequency,
        cut_from=max(0.0, float(ramps[1])),
        cut_to=min(float(ramps[2]), end),
        classes=tuple(classes),
        tacho=pulses,
        notes={"depth": depth, "noise": noise, "drift": cut.drift},
    )


def _uniform(clock, values, end, rate):
    """Return the cut at a constant rate, low-passed before."""
    fine = rate * max(1, math.ceil(1.0 / np.diff(clock[:64]).mean() / rate))
    time = np.arange(0.0, end, 1.0 / fine)
    rows = np.array([np.interp(time, clock, column) for column in values.T])
    keep = round(fine / rate)
    if keep > 1:
        taps = signal.firwin(16 * keep + 1, 0.85 / keep)
        rows = signal.oaconvolve(rows, taps[None], mode="same", axes=1)[:, ::keep]
        time = time[::keep]
    return time, rows


def _colour(rng, n: int, power: float) -> np.ndarray:
    """Noise whose spectral density falls with f^-power; rms 1."""
    lines = fft.rfft(rng.standard_normal(n))
    f = np.maximum(np.arange(lines.size) / lines.size, 1e-3)
    found = fft.irfft(lines * f ** (-0.5 * power), n)
    return found / found.std()


def _ring(rng, time, x):
    """Pass a row through two resonances that the structure has elsewhere."""
    dt, y = time[1] - time[0], x.copy()
    for _ in range(2):
        f, z, gain = rng.uniform(0.03, 0.4) / dt, rng.uniform(0.02, 0.15), rng.uniform(-1.5, 1.5)
        r, angle = math.exp(-2.0 * math.pi * f * z * dt), 2.0 * math.pi * f * dt
        y += gain * signal.lfilter([1.0 - r, 0.0, -(1.0 - r)], [1.0, -2.0 * r * math.cos(angle), r * r], x)
    return y


def _tones(rng, time, turns, size):
    """Hum with harmonics, a pump or fan or two, a gear (an order), a belt (none): in air as well."""
    f = rng.choice([50.0, 60.0])
    found = np.zeros_like(time)
    for k in (1, 2, 3, 5):
        found += rng.uniform(0.0, 1.0) / k * np.cos(2.0 * math.pi * k * f * time + rng.uniform(0.0, 6.28))
    for _ in range(int(rng.integers(0, 4))):
        tone = rng.uniform(30.0, 0.4 / (time[1] - time[0]))
        found += rng.uniform(0.0, 1.0) * np.cos(2.0 * math.pi * tone * time + rng.uniform(0.0, 6.28))
    found += rng.uniform(0.0, 0.7) * np.cos(int(rng.integers(5, 30)) * turns)
    found += rng.uniform(0.0, 0.7) * np.cos(rng.uniform(0.3, 3.0) * turns)
    return size * found


def _level(time, x) -> float:
    return float(np.std(x[(time > 0.35 * time[-1]) & (time < 0.7 * time[-1])]))


def _sensors(rng, time, source, turns, cut: Cut) -> dict[str, np.ndarray]:
    """Two or three accelerometers of the structure [m/s2]."""
    modes = cut.w.size
    quiet = math.exp(rng.uniform(math.log(0.002), math.log(0.1)))
    hum = math.exp(rng.uniform(math.log(1e-3), math.log(0.05)))
    found = {}
    for axis in "xyz"[: int(rng.integers(2, 4))]:
        weights = rng.standard_normal(modes) * (0.2 if axis == "z" else 1.0)
        own = cut.shape[:, "xy".index(axis)] if axis != "z" else 0.2 * np.ones(modes)
        row = (0.7 * own + 0.3 * weights) @ source[:modes]
        force = rng.standard_normal(2) @ source[modes:]
        row = row + rng.uniform(0.0, 1.0) * row.std() / max(force.std(), 1e-12) * _ring(rng, time, force - force.mean())
        size = _level(time, row)
        row = row + quiet * size * _colour(rng, time.size, rng.uniform(0.0, 1.0))
        found[f"acceleration_{axis}"] = row + _tones(rng, time, turns, hum * size)
    return found


def _microphone(rng, time, source, turns) -> dict[str, np.ndarray]:
    """A microphone in a workshop [shares of full scale]: room, band of a telephone, noise, tones, clipping."""
    dt = time[1] - time[0]
    row = rng.standard_normal(source.shape[0]) @ (source / np.maximum(source.std(axis=1, keepdims=True), 1e-12))
    row = _ring(rng, time, row - row.mean())
    tail = np.exp(-np.arange(int(0.35 / dt)) * dt * 6.9 / rng.uniform(0.1, 0.6)) * rng.standard_normal(int(0.35 / dt))
    tail *= rng.uniform(0.0, 1.0) / np.sqrt((tail**2).sum())
    tail[0] += 1.0
    row = signal.oaconvolve(row, tail)[: row.size]
    row = signal.sosfilt(signal.butter(2, rng.uniform(30.0, 150.0), "high", fs=1.0 / dt, output="sos"), row)
    size = _level(time, row)
    row = row + math.exp(rng.uniform(math.log(0.02), math.log(0.6))) * size * _colour(
        rng, time.size, rng.uniform(0.0, 1.5)
    )
    row = row + _tones(rng, time, turns, math.exp(rng.uniform(math.log(0.005), math.log(0.15))) * size)
    full = size * rng.uniform(1.2, 12.0)
    return {"sound": np.round(np.clip(row / full, -1.0, 1.0) * 32767.0) / 32767.0}
