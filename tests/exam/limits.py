"""Stability limits for the exam: a mill with something hidden, simulated in time, as a family that can be diagnosed."""

import functools
import math
from dataclasses import replace

import numpy as np
from truth.milling_limits import Mill, drawn, limit, search

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from smfe.diagnosis.cutting.limits import Limit, limit_family

SLOT = Mill(teeth=4, entry=0.0)
"""What was identified, and the cut."""

SPEEDS = (150.0, 180.0, 220.0, 270.0, 330.0, 450.0, 600.0, 850.0)
FEEDS = ((1e-4, SPEEDS), (3e-4, (180.0, 330.0, 600.0)))
"""Feed per tooth [m] -> spindle speeds [rpm] at which the limit is looked for."""

RATIO = 1.04
"""Of two depths that were cut one after the other."""

EXPECTED = {
    "process_damping": "process_damping",
    "coefficients": "force_coefficients",
    "bearings": "spindle_speed_dynamics",
    "micro_slip": "joint_micro_slip",
    "coupling": "cross_axis_coupling",
    "mode": "missing_mode",
}
"""Hidden effect -> cause that must be named."""


@functools.cache
def worn(gain=0.2, speed=SPEEDS[0]):
    """Flank resistance [N/m] that raises the limit by a share at a speed."""
    sharp = limit(SLOT, speed)[0]
    low, high = 0.0, 4e5
    while limit(replace(SLOT, flank=high), speed)[0] < (1.0 + gain) * sharp:
        low, high = high, 2.0 * high
    for _ in range(6):
        middle = 0.5 * (low + high)
        deep = limit(replace(SLOT, flank=middle), speed)[0]
        low, high = (middle, high) if deep < (1.0 + gain) * sharp else (low, middle)
    return 0.5 * (low + high)


def planted(effect, sign=1.0, mill=SLOT):
    """Return the mill with an effect at the size that must be found."""
    if effect is None:
        return mill
    return {
        "process_damping": lambda: replace(mill, flank=worn()),
        "coefficients": lambda: replace(mill, kt=mill.kt * (1.0 + 0.15 * sign), kr=mill.kr * (1.0 + 0.15 * sign)),
        "bearings": lambda: replace(mill, linear=-0.05, fastest=SPEEDS[-1]),
        "micro_slip": lambda: replace(mill, slip=0.12, level=3e-4 * 1.4e-3),
        "coupling": lambda: replace(mill, turn=sign * math.radians(25.0)),
        "mode": lambda: replace(mill, extra=(0.12 / mill.modes.stiffness[0], 74.0, 0.04)),
    }[effect]()


def known(mill=SLOT, found=(), proposals=None):
    """The family of limits that were found with a mill of which the modes, the tool and the material are known."""
    m = mill.modes
    machine = ModalModel(m.frequency, m.damping, m.stiffness, [(*d, 0.0) for d in m.direction])
    limits = [
        Limit(
            f.speed,
            math.sqrt(f.stable * f.chatter),
            math.log(f.chatter / f.stable) / math.sqrt(12.0),
            f.frequency,
            feed_per_tooth=f.feed,
        )
        for f in found
    ]
    tool, material = Tool(mill.diameter, mill.teeth), CuttingCoefficients(mill.kt, mill.kr, 0.0)
    return limit_family(limits, machine, tool, Engagement(mill.entry, mill.leave), material, proposals)


@functools.lru_cache(maxsize=64)
def campaign(effect, seed, feeds=FEEDS):
    """What a campaign finds: a machine a little other than identified, limits bracketed in steps of depth."""
    rng = np.random.default_rng([seed, 11])
    sign = float(rng.choice([-1.0, 1.0]))
    mill = planted(effect, sign, drawn(rng, SLOT))
    return tuple(f for feed, speeds in feeds for f in search(mill, speeds, rng, RATIO, (feed,)))


def family(effect, seed):
    """Return the family of a seed with an effect hidden, and the cause that must be named (None: nothing)."""
    return known(SLOT, campaign(effect, seed)), EXPECTED.get(effect)
