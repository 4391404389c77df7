"""Orders of the cutting force of a rigid system, by the mechanistic model: linear in its coefficients.

The force of each coefficient by itself depends on the tool, the cut and its geometry only, and is kept: a fit asks for
it again with other coefficients and another sensor.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from process.cut.tool import Tool
from process.types import Complex, Real
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.cutting.rules import RULES


@functools.cache
def _nodes(count: int) -> tuple[Real, Real]:
    """Nodes and weights of a Gauss quadrature over -1 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights


def rigid_orders(tool: Tool, cut: SteadyCut, count: int, values: Mapping[str, float]) -> Complex:
    """Orders of the force on the tool of a rigid system, shape (count, 3) [N].

    Each tooth is a Gauss quadrature over its own contact; that the helix smears it over an angle is a factor
    ``(1 - exp(-j n span))/(j n span)`` of order n.
    """
    if cut.depth == 0.0:
        return np.zeros((count, 3), dtype=complex)
    exponents = tuple(values.get(f"size_effect_{n}", 0.0) for n in "tra")
    offsets = tuple(tooth_radii(tool, values).tolist())
    coefficients = [values[f"K{n}c"] for n in "tra"] + [values.get(f"K{n}e", 0.0) for n in "tra"]
    straight = np.tensordot(coefficients, _straight_orders(tool, cut, count, offsets, exponents), 1)
    half = np.arange(count) * cut.depth * math.tan(values["helix"]) / tool.diameter
    return np.asarray(straight * (np.sinc(half / math.pi) * np.exp(-1j * half))[:, None])


@functools.lru_cache(maxsize=2048)
def _straight_orders(
    tool: Tool, cut: SteadyCut, count: int, offsets: tuple[float, ...], exponents: tuple[float, ...]
) -> Complex:
    """Orders for one of each coefficient and edge force, (6, count, 3), of straight edges."""
    order, total = np.arange(count), np.zeros((6, count, 3), dtype=complex)
    radius, power = np.array(offsets), np.array(exponents)
    if not tool.equal_pitch or float(np.ptp(radius)) > 0.0:
        for j, pitch in enumerate(tool.tooth_angles()):
            total += np.exp(-1j * order * pitch)[:, None] * _tooth_orders(tool, cut, order, radius, power, j)
    else:
        every = slice(None, None, tool.teeth)
        total[:, every] = tool.teeth * _tooth_orders(tool, cut, order[every], radius, power, 0)
    total[:, 1:] *= 2.0
    return total


def _tooth_orders(
    tool: Tool, cut: SteadyCut, order: NDArray[np.int64], offsets: Real, exponents: Real, j: int
) -> Complex:
    """Orders of one tooth, by its own angle: ``mean of force exp(-j n phi)``, the chip the least over earlier teeth."""
    sin_k = math.sin(tool.approach_angle)
    feeds = cut.feed_per_tooth * np.arange(1, tool.teeth + 1)
    gain = offsets[j] - offsets[j - np.arange(1, tool.teeth + 1)]
    first = math.asin(min(max(float(np.max(-gain / feeds)), 0.0), 1.0))
    low, high = max(cut.arc.entry, first), min(cut.arc.exit, math.pi - first)
    if high <= low:
        return np.zeros((6, order.size, 3), dtype=complex)
    # Twice the nodes must exceed the angle ``n (high - low)/2`` through which the highest order turns; 24 more do for
    # the force itself.
    nodes, weights = _nodes(24 + math.ceil(0.25 * (high - low) * int(order[-1])))
    phi = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    chip = np.min(feeds[:, None] * np.sin(phi) + gain[:, None], axis=0) * sin_k
    weight = 0.5 * (high - low) * weights / (2.0 * math.pi) * (cut.depth / sin_k)
    # Each coefficient acts along its own direction: (3 of them, n angles, 3 axes).
    force = weight[:, None] * _directions(phi, tool.approach_angle)
    h = np.maximum(chip, 1e-12)
    grown = h * (h / RULES.reference_chip) ** -exponents[:, None] if exponents.any() else np.tile(h, (3, 1))
    return np.asarray(np.exp(-1j * np.outer(order, phi)) @ np.concatenate([force * grown[:, :, None], force]))


def tooth_radii(tool: Tool, values: Mapping[str, float]) -> Real:
    """Return the radial position of each tooth [m], (teeth,): as declared, an axis that is off, single inserts."""
    where = values.get("runout_angle", 0.0)
    out = tool.tooth_offsets() + values.get("runout", 0.0) * np.cos(tool.tooth_angles() + where)
    out[0] += values.get("insert", 0.0)
    each = [(values.get(f"radius_{j}", 0.0), values.get(f"seat_{j}", 0.0)) for j in range(1, tool.teeth + 1)]
    return np.asarray(out + np.sum(each, axis=1))


def _directions(phi: Real, approach_angle: float) -> Real:
    """Tangential, radial and axial direction along x, y, z at angles (n,), (3, n, 3)."""
    s, c, none = np.sin(phi), np.cos(phi), np.zeros(phi.size)
    sk, ck = math.sin(approach_angle), math.cos(approach_angle)
    tangential, radial = [-c, s, none], [-sk * s, -sk * c, none + ck]
    return np.stack([np.stack(d, axis=1) for d in (tangential, radial, [-ck * s, -ck * c, none - sk])])
