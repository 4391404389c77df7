"""Constants and tuples of arrays of the numba loop that integrates a machine in time.

Plain arrays only, made in Python by `process.simulation.packing` and `process.simulation.step_maps`.
"""

from typing import Any, NamedTuple

# Kinds of elements: a force for a slide's velocity (the first two), or for a displacement.
FRICTION, MEMORY, CUBIC, FLANKS, SLIDERS = 0, 1, 2, 3, 4

# First value that `integrate` returns.
DONE, RAN_AWAY, NOT_SOLVED = 0, 1, 2

FARTHEST = 1e6
"""Coordinate at which a run is given up."""

# Places in work.tally, work.mode and, after the three forces, in work.cutting.
ENERGY, WORST, LARGEST, SCALE = 0, 1, 2, 3
LEVEL, GUESSED, STALE, STILL = 0, 1, 2, 3
INSIDE, ENTRY_TIME, ENTRY_ANGLE, LOST, THICKEST = 3, 4, 5, 6, 7


class Linear(NamedTuple):
    """The linear part: n coordinates, N states (q, q', integrals), u inputs, e elements.

    maps (p, l, N + 3 u, 2 N + 3 e): at path point p, for a step halved l times: from the state and the three values of
    each input to the state in the middle, at the end, and the motion of the elements at a quarter, half and end of it.
    places (steps,): path point of each step, a share between two. power (n, N), mass, stiffness (n, n): energy flow
    ``q' . power z`` of the linear part. reach (u, n): participation of each input. tool (p, 3, n).
    """

    maps: Any
    places: Any
    power: Any
    mass: Any
    stiffness: Any
    reach: Any
    tool: Any


class Elements(NamedTuple):
    """Friction and joints, e of them: kind, input that they push on, law, parameters, what is subtracted.

    Their motion is ``rows z``, (e, N); the force is ``f(feed + motion) - steady - slope motion``, as the slope is in
    the linear part. Parameters and states of element i are those from start[i] to start[i + 1], and first[i] to
    first[i + 1].
    """

    kind: Any
    target: Any
    law: Any
    parameters: Any
    start: Any
    feed: Any
    steady: Any
    slope: Any
    first: Any
    rows: Any


class Servos(NamedTuple):
    """Servos outside the linear part: input of each, rows (s, N) that give the force now, on a ring every half step.

    The force at the three nodes of step i is the sum of four entries from 2 i + first (s, 3), with share (s, 3, 4); the
    length of the ring is a power of two. Sampled ones (every > 0 steps a sample, lag + 1 on the ring): rows give x, v
    in turn (2 s, N); gains (s, 3): K_p, 1/T_i, K_v; resolution [m]; ramp (s, 2): speed [m/s], start [m] of the encoder.
    """

    target: Any
    rows: Any
    first: Any
    share: Any
    every: int
    gains: Any
    resolution: float
    ramp: Any


class Given(NamedTuple):
    """Forces over time: input of each, values (given, steps, 3) at the three nodes, later none; the largest [N]."""

    target: Any
    values: Any
    peak: float


class Cut(NamedTuple):
    """The cut (`process.cut._kernels`), entry and exit [s] (equal: none), velocities from the impulse (n,)."""

    motion: Any
    teeth: Any
    surfaces: Any
    entry: float
    leave: float
    kick: Any


class Work(NamedTuple):
    """Scratch arrays; `z`, states[0], force, motion, the rings and the last three carry over from step to step.

    states (4, .): of the elements now, in the middle, at the end, and for trial. part (2 e,), slope (2 e, 2): force of
    each element in the middle, then at the end, and its slope for its motion in the middle and at the end.
    """

    z: Any
    base: Any
    known: Any
    piece: Any
    part: Any
    force: Any
    motion: Any
    slope: Any
    system: Any
    change: Any
    states: Any
    ring: Any
    integral: Any
    largest: Any
    recent: Any
    blended: Any
    fresh: Any
    tally: Any
    mode: Any
    cutting: Any
