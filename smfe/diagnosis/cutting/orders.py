"""Steady cuts as spindle orders: what is left of a record, and what a rigid mechanistic model gives.

A record at constant speed becomes the Fourier coefficients of its three forces at the orders 0, 1, 2, ... of the
spindle (the number of teeth is tooth passing), with their scatter from revolution to revolution, and the strength of
the lines of the mains where no order covers them.

Five slots at 0.025 to 0.125 mm per tooth departed from the best straight line over the feed, of whatever slope and
intercept at each order and axis, by 5 % (x), 4 % (y) of the alternating force: no mechanistic model linear in the chip
does better, which is `RULES.force_floor`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import special

from process.cut.engagement import Engagement
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, sample_interval
from process.types import Complex, Real
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.cutting.rules import RULES

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


@dataclass(frozen=True)
class SteadyCut:
    """Setting of one cut."""

    rotation: float  # spindle speed [rad/s]; the nominal one will do
    feed_per_tooth: float  # [m]
    depth: float  # axial depth [m]; zero: the spindle turns in air
    arc: Engagement  # arc of engagement

    def __post_init__(self) -> None:
        """Refuse what is no cut."""
        if not (self.rotation > 0.0 and self.feed_per_tooth > 0.0 and self.depth >= 0.0):
            raise InputError(
                f"a cut with {self.rotation:g} rad/s, {self.feed_per_tooth * 1e3:g} mm per tooth and a depth of "
                f"{self.depth * 1e3:g} mm; speed and feed must be positive, the depth not negative"
            )


@dataclass(frozen=True)
class CuttingOrders:
    """Orders of one record."""

    cut: SteadyCut  # its setting, with the speed found in the record
    value: Complex  # shape (orders, 3): peak values [N] of orders 0, 1, ...; order 0 is the mean
    std: Real
    """Shape (orders, 3): root mean square of the complex error [N]; infinite where a line of the mains hides the
    order."""
    lines: Mapping[float, Real]
    """Frequency of the mains [Hz] -> amplitude [N] along x, y, z and its power over that of the noise beside it, shape
    (2, 3), where no order covers it."""

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which orders count, shape (orders, 3)."""
        return np.isfinite(self.std)

    def whitened(self, orders: Complex) -> Real:
        """Orders in units of their standard deviation: means, real parts, imaginary parts."""
        used = self.used
        scaled = (math.sqrt(2.0) * orders[1:] / self.std[1:])[used[1:]]
        return np.concatenate([(orders[0].real / self.std[0])[used[0]], scaled.real, scaled.imag])


def cutting_orders(
    record: xr.Dataset, tool: Tool, cut: SteadyCut, floor: float = RULES.force_floor, crosstalk: float = RULES.crosstalk
) -> CuttingOrders:
    """Return the spindle orders of a record of a steady cut.

    The standard deviation is that of the mean over blocks of four revolutions, with their correlation, and what a model
    is not expected to reach: shares of the alternating force along the axis and in all. `InputError` when the record
    has not three forces, or less than forty revolutions.
    """
    if "force" not in record or set(map(str, record["axis"].values)) != set(AXES):
        raise InputError("the forces along x, y and z are needed; declare the channels force_x, force_y and force_z")
    dt = sample_interval(record)
    force = record["force"].sel(axis=list(AXES)).transpose("axis", "time").values
    if cut.depth > 0.0:
        cut = replace(cut, rotation=find_rotation(force, dt, cut.rotation, tool.teeth))
    turns = force.shape[1] * dt * cut.rotation / (2.0 * math.pi)
    per_block = round(RULES.block * 2.0 * math.pi / (cut.rotation * dt))
    blocks = force.shape[1] // per_block
    if turns < RULES.least_revolutions or per_block < 4 * RULES.block * RULES.tooth_orders * tool.teeth:
        raise InputError(
            f"{turns:.3g} revolutions of {per_block / RULES.block:.3g} samples; at least {RULES.least_revolutions} of "
            f"{4 * RULES.tooth_orders * tool.teeth} are needed: record longer or faster"
        )
    each = _by_block(force[:, : blocks * per_block], dt * cut.rotation, blocks, RULES.tooth_orders * tool.teeth + 1)
    value = each.mean(axis=0)
    away = each - value
    alike = np.sum((away[1:] * away[:-1].conj()).real) / np.sum(np.abs(away) ** 2)
    grown = (1.0 + max(alike, 0.0)) / (1.0 - min(max(alike, 0.0), 0.9))
    noise = grown * np.mean(np.abs(away) ** 2, axis=0) / (blocks - 1)
    power = 0.5 * np.sum(np.abs(value[1:]) ** 2, axis=0) * (cut.depth > 0.0)
    std = np.sqrt(noise + floor**2 * power + crosstalk**2 * power.sum())
    return CuttingOrders(cut, value, std, _lines(force, dt, cut))


def _by_block(force: Real, step: float, blocks: int, count: int) -> Complex:
    """Orders of each block, shape (blocks, orders, 3), for an angle `step` [rad] from sample to sample."""
    order = np.arange(count)
    one = np.exp(-1j * step * np.arange(force.shape[1]))
    turn = one ** order[:, None]
    each = np.einsum("obt,abt->boa", turn.reshape(count, blocks, -1), force.reshape(3, blocks, -1), optimize=True)
    each *= blocks / force.shape[1]
    each[:, 1:] *= 2.0
    return np.asarray(each)


def find_rotation(force: Real, dt: float, nominal: float, teeth: int, reach: float = 0.01) -> float:
    """Return the spindle speed [rad/s] near a nominal one that puts most power into the spindle orders.

    Forces (3, n) [N] at an interval dt [s]; deviations of 1 % from the nominal speed [rad/s] are searched.
    """
    turn = max(1, round(2.0 * math.pi / (nominal * dt)))
    blocks = force.shape[1] // turn
    each = _by_block(force[:, : blocks * turn], nominal * dt, blocks, 2 * teeth + 1)[:, 1:]
    each *= np.hanning(blocks + 2)[1:-1, None, None]
    angle = nominal * dt * turn * np.arange(blocks)
    order = np.arange(1, 2 * teeth + 1)

    def best(around: float, half: float, count: int) -> float:
        tried = around + np.linspace(-half, half, count)
        turned = np.exp(-1j * tried[:, None, None] * order[:, None] * angle)
        power = np.sum(np.abs(np.einsum("rob,boa->roa", turned, each, optimize=True)) ** 2, axis=(1, 2))
        return float(tried[int(np.argmax(power))])

    width = 0.25 / (2.0 * teeth * blocks)
    coarse = best(0.0, reach, 2 * math.ceil(reach / width) + 1)
    return nominal * (1.0 + best(coarse, width, 41))


def _lines(force: Real, dt: float, cut: SteadyCut) -> dict[float, Real]:
    """Amplitudes of the lines of the mains, and their power over that beside them, where no order is near."""
    n = force.shape[1]
    window = np.hanning(n)
    tapered = (force - force.mean(axis=1, keepdims=True)) * (2.0 * window / window.sum())
    found: dict[float, Real] = {}
    turn, span = cut.rotation / (2.0 * math.pi), 1.0 / (n * dt)

    def clear(f: Real) -> NDArray[np.bool_]:
        order = np.rint(f / turn)
        cutting = (order <= 1.0) | (cut.depth > 0.0)
        return np.asarray((np.abs(f - order * turn) > 4.0 * span) | ~cutting)

    for f in RULES.mains:
        beside = f + span * np.concatenate([np.arange(-14.0, -3.0), np.arange(4.0, 15.0)])
        beside = beside[clear(beside)]
        if not clear(np.array([f]))[0] or beside.size < 2 * RULES.beside:
            continue
        spectrum = tapered @ np.exp(-2j * np.pi * dt * np.outer(np.arange(n), np.append(beside, f)))
        power = np.abs(spectrum) ** 2
        found[f] = np.stack([np.sqrt(power[:, -1]), power[:, -1] / power[:, :-1].mean(axis=1)])
    return found


def line_score(ratio: Real) -> Real:
    """Return the normal score of a line: of noise alone it is standard normal.

    A power over the mean of m powers of noise beside it has the survival function ``(1 + ratio/m)^-m`` (F distribution
    with 2 and 2 m degrees of freedom).
    """
    return np.asarray(-special.ndtri_exp(-RULES.beside * np.log1p(ratio / RULES.beside)))


def hidden_orders(found: Mapping[str, CuttingOrders]) -> tuple[dict[str, CuttingOrders], tuple[Suspect, ...]]:
    """Leave out the orders that a line of the mains hides where it was found beside the orders of any record."""
    suspects: list[Suspect] = []
    seen = set()
    for name, orders in found.items():
        for f, line in orders.lines.items():
            score = line_score(line[1])
            if score.max() > RULES.line_found:
                seen.add(f)
                size = ", ".join(f"{a:.2g}" for a in line[0])
                suspects.append(
                    Suspect(
                        "background_tone",
                        "warning",
                        name,
                        f"a line at {f:g} Hz of {size} N along x, y, z, {float(score.max()):.0f} standard deviations "
                        "above the noise beside it (the mains)",
                        "spindle orders within 2 % of it are left out of all records; find the source",
                    )
                )
    return {name: _without(orders, seen) for name, orders in found.items()}, tuple(suspects)


def _without(orders: CuttingOrders, lines: Iterable[float]) -> CuttingOrders:
    turn = orders.cut.rotation / (2.0 * math.pi)
    std = orders.std.copy()
    for f in lines:
        std[np.abs(np.arange(std.shape[0]) * turn - f) < 0.02 * f] = math.inf
    return replace(orders, std=std)


def rigid_orders(tool: Tool, cut: SteadyCut, count: int, values: Mapping[str, float]) -> Complex:
    """Orders of the force on the tool of a rigid system, shape (count, 3).

    Each tooth is a Gauss quadrature over its own contact; that the helix smears it over an angle is a factor
    ``(1 - exp(-j n span))/(j n span)`` of order n.
    """
    order = np.arange(count)
    total = np.zeros((count, 3), dtype=complex)
    if cut.depth == 0.0:
        return total
    pitch, offsets = tool.tooth_angles(), _offsets(tool, values)
    if not tool.equal_pitch or float(np.ptp(offsets)) > 0.0:
        for j in range(tool.teeth):
            total += np.exp(-1j * order * pitch[j])[:, None] * _tooth_orders(tool, cut, order, values, offsets, j)
    else:
        total[:: tool.teeth] = tool.teeth * _tooth_orders(tool, cut, order[:: tool.teeth], values, offsets, 0)
    half = order * cut.depth * math.tan(values["helix"]) / tool.diameter
    total *= (np.sinc(half / math.pi) * np.exp(-1j * half))[:, None]
    total[1:] *= 2.0
    return total


def _tooth_orders(
    tool: Tool, cut: SteadyCut, order: NDArray[np.int64], values: Mapping[str, float], offsets: Real, j: int
) -> Complex:
    """Orders of one tooth, by its own angle: ``mean of force exp(-j n phi)``, the chip the least over earlier teeth."""
    sin_k = math.sin(tool.approach_angle)
    feeds = cut.feed_per_tooth * np.arange(1, tool.teeth + 1)
    gain = offsets[j] - offsets[j - np.arange(1, tool.teeth + 1)]
    first = math.asin(min(max(float(np.max(-gain / feeds)), 0.0), 1.0))
    low, high = max(cut.arc.entry, first), min(cut.arc.exit, math.pi - first)
    if high <= low:
        return np.zeros((order.size, 3), dtype=complex)
    phi = 0.5 * (low + high) + 0.5 * (high - low) * _NODES
    chip = np.min(feeds[:, None] * np.sin(phi) + gain[:, None], axis=0) * sin_k
    force = _to_axes(_local(chip, values), phi, tool.approach_angle)
    weight = 0.5 * (high - low) * _WEIGHTS / (2.0 * math.pi) * (cut.depth / sin_k)
    return np.asarray(np.exp(-1j * np.outer(order, phi)) @ (weight[:, None] * force))


def _local(chip: Real, values: Mapping[str, float]) -> Real:
    """Tangential, radial, axial force per length of edge [N/m], shape (n, 3)."""
    cutting = np.array([values[f"K{n}c"] + values.get(f"other_K{n}c", 0.0) for n in "tra"])
    exponent = np.array([values.get(f"size_effect_{n}", 0.0) for n in "tra"])
    edge = np.array([values.get(f"K{n}e", 0.0) for n in "tra"])
    h = np.maximum(chip, 1e-12)[:, None]
    grown = (h / RULES.reference_chip) ** -exponent if exponent.any() else 1.0
    return np.asarray(cutting * grown * h + edge * h / (h + RULES.edge_chip))


def _offsets(tool: Tool, values: Mapping[str, float]) -> Real:
    """Radial position of each tooth [m] for a tool axis that is off by the run-out."""
    where = values.get("runout_angle", 0.0)
    return tool.tooth_offsets() + values.get("runout", 0.0) * np.cos(tool.tooth_angles() + where)


def _to_axes(local: Real, phi: Real, approach_angle: float) -> Real:
    """Tangential, radial, axial force (n, 3) at angles (n,) -> force on the tool along x, y, z."""
    s, c = np.sin(phi), np.cos(phi)
    sk, ck = math.sin(approach_angle), math.cos(approach_angle)
    ft, fr, fa = local.T
    return np.stack(
        [-c * ft - sk * s * fr - ck * s * fa, s * ft - sk * c * fr - ck * c * fa, ck * fr - sk * fa], axis=1
    )
