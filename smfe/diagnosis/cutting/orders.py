"""Steady cuts as spindle orders: what is left of a record, and what a rigid mechanistic model gives.

A record at constant speed becomes the Fourier coefficients of its three forces at the orders 0, 1, 2, ... of the
spindle (the number of teeth is tooth passing), with their scatter from revolution to revolution, and the strength of
the lines of the mains where no order covers them. What is known of a cut within tolerances of its own is part of its
uncertainty: its depth, which scales all its orders together, and hum on orders that the mains cover.

Five slots at 0.025 to 0.125 mm per tooth departed from the best straight line over the feed, of whatever slope and
intercept at each order and axis, by 5 % (x), 4 % (y) of the alternating force: no mechanistic model linear in the chip
does better, which is `RULES.force_floor`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
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
    depth_std: float = 0.0  # relative: by which all orders together may be off, with the depth of the cut
    resolution: float = 0.0  # one over the length of the record [Hz]
    reach: Real | None = None  # shape (orders, 3): mean square of what a model is not expected to reach, in `std` [N^2]

    @property
    def rms(self) -> Real:
        """Root mean square of the force along x, y, z, (3,) [N]."""
        return np.asarray(np.sqrt(np.abs(self.value[0]) ** 2 + 0.5 * np.sum(np.abs(self.value[1:]) ** 2, axis=0)))

    @property
    def measured(self) -> Real | None:
        """Standard deviation of whitened values by what was measured alone; None where it is not known."""
        if self.reach is None:
            return None
        share = np.sqrt(np.clip(1.0 - self.reach / self.std**2, 0.0, 1.0))
        return np.concatenate([share[0][self.used[0]], np.tile(share[1:][self.used[1:]], 2)])

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which orders count, shape (orders, 3)."""
        return np.isfinite(self.std)

    @property
    def order_of_values(self) -> NDArray[np.int64]:
        """Order of each whitened value."""
        order = np.nonzero(self.used)[0]
        return np.concatenate([order, order[order > 0]])

    @functools.cached_property
    def weighted(self) -> Complex:
        """Orders over their variance, (orders, 3)."""
        return np.asarray(self.value / self.std**2)

    def whitened(self, orders: Complex) -> Real:
        """Orders with errors of unit variance: means, real parts, imaginary parts.

        The error that they share through the depth has the covariance ``u u^T`` beside the unit matrix, with u what was
        measured in units of its standard deviation times the relative error of the depth; ``(I + u u^T)^(-1/2)``
        shortens what is along u by ``sqrt(1 + |u|^2)``.
        """
        return self._along(self._scaled(orders), 1.0 / self._stretch)

    def squared_force(self, whitened: Real) -> float:
        """Mean square over time and sum over the axes of a force that is given whitened [N^2]."""
        used, each = self.used, self._along(whitened, self._stretch)
        # Half of the square of an order is its mean square; its real and imaginary part have half its variance each.
        size = np.concatenate([self.std[0][used[0]] ** 2, np.tile(0.25 * self.std[1:][used[1:]] ** 2, 2)])
        return float(np.sum(size * each**2))

    def _scaled(self, orders: Complex) -> Real:
        used = self.used
        scaled = (math.sqrt(2.0) * orders[1:] / self.std[1:])[used[1:]]
        return np.concatenate([(orders[0].real / self.std[0])[used[0]], scaled.real, scaled.imag])

    @functools.cached_property
    def _shared(self) -> tuple[Real, float]:
        """Direction of the error that all orders share, and its size."""
        shared = self.depth_std * self._scaled(self.value)
        size = float(np.linalg.norm(shared))
        return shared / max(size, 1e-300), size

    @property
    def _stretch(self) -> float:
        return math.hypot(1.0, self._shared[1])

    def _along(self, values: Real, factor: float) -> Real:
        """Values, stretched along the error that all orders share."""
        along = self._shared[0]
        return np.asarray(values + (factor - 1.0) * float(along @ values) * along)


def cutting_orders(
    record: xr.Dataset, tool: Tool, cut: SteadyCut, floor: float = RULES.force_floor, leak: float = RULES.leak
) -> CuttingOrders:
    """Return the spindle orders of a record of a steady cut.

    The standard deviation is that of the mean over blocks of four revolutions, with their correlation, and of what a
    model is not expected to reach (`out_of_reach`): shares of the order itself (`floor`) and of the force in all
    (`leak`).
    `InputError` when the record has not three forces, or less than forty revolutions.
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
    least = 4 * RULES.tooth_orders * tool.teeth
    if turns < RULES.least_revolutions:
        raise InputError(
            f"{turns:.3g} revolutions of the spindle in what counts as steady; at least {RULES.least_revolutions} are "
            "needed: record longer, or give the steady part as `interval` of the cutting test"
        )
    if per_block < RULES.block * least:
        raise InputError(
            f"{per_block / RULES.block:.3g} samples a revolution; at least {least} are needed for {RULES.tooth_orders} "
            f"orders of {tool.teeth} teeth: record faster"
        )
    each = _by_block(force[:, : blocks * per_block], dt * cut.rotation, blocks, RULES.tooth_orders * tool.teeth + 1)
    if cut.depth > 0.0:
        each = _aligned(each)
    value = each.mean(axis=0)
    away = each - value
    alike = np.sum((away[1:] * away[:-1].conj()).real) / np.sum(np.abs(away) ** 2)
    grown = (1.0 + max(alike, 0.0)) / (1.0 - min(max(alike, 0.0), 0.9))
    noise = grown * np.mean(np.abs(away) ** 2, axis=0) / (blocks - 1)
    depth_std = RULES.depth / cut.depth if cut.depth > 0.0 else 0.0
    reach = (cut.depth > 0.0) * out_of_reach(value, tool.teeth, floor, leak)
    std = np.sqrt(noise + reach)
    return CuttingOrders(cut, value, std, _lines(force, dt, cut), depth_std, 1.0 / (force.shape[1] * dt), reach)


def out_of_reach(value: Complex, teeth: int, floor: float, leak: float) -> Real:
    """Return the mean square of what a model is not expected to reach of orders (n, 3), likewise (n, 3) [N^2].

    Each order may be off by the share `floor` of itself, and by what a dynamometer adds whose first resonance is just
    high enough (`RULES.resonance_from`): ``r^2/(1 - r^2)`` at r of that. The mean may be off by `floor` of the
    alternating force, and every order by the share `leak` of the rms along all axes, the mean included: a run-out of
    some hundredths of the feed lets every tooth cut that much more or less of it, and amplifiers drift by as much.
    """
    power = 0.5 * np.sum(np.abs(value[1:]) ** 2, axis=0)
    square = (np.arange(value.shape[0]) / (RULES.resonance_from * teeth)) ** 2
    share = np.hypot(floor, square / (1.0 - square))[:, None]
    own = (share * np.abs(value)) ** 2
    own[0] = floor**2 * power
    return np.asarray(own + leak**2 * (power.sum() + float(np.sum(np.abs(value[0]) ** 2))))


def _aligned(each: Complex) -> Complex:
    """Turn the orders of each block, (blocks, orders, 3), by the spindle angle that brings it nearest to their mean.

    A spindle that wanders turns the high orders of a long record against each other; what they scatter by is then no
    noise of the force. Steps of Newton, the low orders first: what turns them little may turn the high ones round.
    """
    n = np.arange(each.shape[1])
    for share in (0.2, 0.4, 0.7, 1.0, 1.0):
        product = np.sum(each * each.mean(axis=0).conj(), axis=2) * (n <= share * n[-1])
        bend = product.real @ (n * n)
        angle = np.where(bend > 0.0, product.imag @ n / np.where(bend > 0.0, bend, 1.0), 0.0)
        each = each * np.exp(-1j * np.outer(np.clip(angle, -0.1, 0.1), n))[:, :, None]
    return each


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


def beside_mains(
    found: Mapping[str, CuttingOrders], hum: float, material: float
) -> tuple[dict[str, CuttingOrders], tuple[Suspect, ...]]:
    """Make the orders that the mains cover as uncertain as hum makes them; leave out what a strong line hides.

    Orders on a harmonic of the mains are uncertain by `hum` over the largest rms of their channel in any cut, over the
    number of the harmonic: nothing shows there what is hum and what the cut. A line that was found beside the orders of
    any record is known, and orders within 2 % of it are as uncertain as it is large. One that moves a force by more
    than `material` over the rms of its channel hides them in all records.
    """
    rms = np.max([c.rms for c in found.values()], axis=0)
    suspects: list[Suspect] = []
    known: dict[float, Real] = {}
    for name, orders in found.items():
        for f, line in orders.lines.items():
            score = line_score(line[1])
            if score.max() > RULES.line_found:
                share = float(np.max(np.sqrt(0.5) * line[0] / rms))
                matters = share > material
                known[f] = np.maximum(known.get(f, np.zeros(3)), np.full(3, math.inf) if matters else line[0])
                size = ", ".join(f"{a:.2g}" for a in line[0])
                suspects.append(
                    Suspect(
                        "background_tone",
                        "warning" if matters else "note",
                        name,
                        f"a line at {f:g} Hz of {size} N along x, y, z, {float(score.max()):.0f} standard deviations "
                        f"above the noise beside it (the mains), {100.0 * share:.2g} % of the force of a channel",
                        "spindle orders within 2 % of it are left out of all records; find the source"
                        if matters
                        else "spindle orders within 2 % of it count as uncertain by it",
                    )
                )
    return {name: _in_mains(orders, hum * rms, known) for name, orders in found.items()}, tuple(suspects)


def _in_mains(orders: CuttingOrders, level: Real, known: Mapping[float, Real]) -> CuttingOrders:
    """Add hum of a level (3,) (rms) [N] and known lines (amplitudes) [N] to the uncertainty of the orders."""
    frequency = np.arange(orders.std.shape[0]) * orders.cut.rotation / (2.0 * math.pi)
    harmonic = np.arange(1, RULES.harmonics + 1)
    lines = np.outer(RULES.mains, harmonic)
    near = np.abs(frequency[:, None, None] - lines) < 1.5 * orders.resolution
    variance = 2.0 * np.max(near / harmonic, axis=(1, 2))[:, None] ** 2 * level**2
    for f, amplitude in known.items():
        covered = np.abs(frequency - f) < 0.02 * f
        variance[covered] = np.maximum(variance[covered], amplitude**2)
    return replace(orders, std=np.sqrt(orders.std**2 + variance))
