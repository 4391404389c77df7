"""What a small vibration feels of a friction law at a feed: ``F/V = direct + residue/(s + rate)``."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.errors import InputError
from process.friction import FrictionLaw, GeneralisedMaxwellSlip, LuGre, MemoryLaw


@dataclass(frozen=True)
class FrictionImpedance:
    """Force over velocity of a linearised friction law.

    Attributes
    ----------
    direct : float
        [N s/m].
    residue : float
        [N/m]; zero for a law without memory.
    rate : float
        [1/s]; zero for a contact that sticks (a spring).
    """

    direct: float
    residue: float = 0.0
    rate: float = 0.0

    def __call__(self, s: ArrayLike) -> NDArray[np.complex128]:
        """Return ``s`` times the impedance [N/m], a dynamic stiffness, at complex s [rad/s]."""
        s = np.asarray(s, dtype=np.complex128)
        if self.residue == 0.0:
            return np.asarray(self.direct * s)
        memory = self.residue * (s / (s + self.rate) if self.rate > 0.0 else np.ones_like(s))
        return np.asarray(self.direct * s + memory)


def linearised(law: FrictionLaw | MemoryLaw, feed: float) -> FrictionImpedance:
    """Return the impedance of a friction law at a feed [m/s]; zero is a relaxed contact at rest.

    Without memory it is the slope f'(v0). LuGre in motion, from ``z' = v - k |v| z/s(v)``:
    ``sigma + (k + d s) b/(s + p)``, ``b = |v0| s'/s(v0)``, ``p = k |v0|/s(v0)``; at rest ``sigma + d + k/s``.
    Generalised Maxwell slip in motion: ``sigma + (C s'/s)/(s + C/s(v0))``; at rest ``sigma + sum k/s``. At rest sigma
    and d are the mean of both directions, which is what the fundamental of a vibration feels.
    """
    if isinstance(law, FrictionLaw):
        slope = float(law.slope(feed))
        if not math.isfinite(slope):
            raise InputError(
                "the friction force jumps at rest (kt is infinite): it has no slope there; give a finite kt, e.g. "
                "15000 s/m, or a feed"
            )
        return FrictionImpedance(slope)
    if feed == 0.0:
        sides = [law.towards(v) for v in (1.0, -1.0)]
        damping = sum(v.sigma + (v.bristle_damping if isinstance(v, LuGre) else 0.0) for v in sides)
        return FrictionImpedance(0.5 * damping, law.stiffness)
    law, speed = law.towards(feed), abs(feed)
    fall = math.exp(-((speed / law.stribeck_speed) ** law.delta)) * (law.static - law.coulomb)
    curve = law.coulomb + fall
    change = -fall * law.delta / speed * (speed / law.stribeck_speed) ** law.delta
    if isinstance(law, LuGre):
        share, rate = speed * change / curve, law.bristle_stiffness * speed / curve
        direct = law.sigma + law.bristle_damping * share
        return FrictionImpedance(direct, share * (law.bristle_stiffness - law.bristle_damping * rate), rate)
    if isinstance(law, GeneralisedMaxwellSlip):
        return FrictionImpedance(law.sigma, law.attraction * change / curve, law.attraction / curve)
    raise InputError(f"{type(law).__name__} is not a friction law that can be linearised")
