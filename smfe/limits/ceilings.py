"""What else than chatter limits a cut: the length of the edges, the request itself, power, torque and feed.

Mean torque of a cut with straight edges, over a turn, per depth of cut (`process.cut.force`)::

    M / a_p = D/2 N/(2 pi) (K_tc f_z (cos phi_st - cos phi_ex) + K_te (phi_ex - phi_st) / sin k)

and the power ``P = M 2 pi n``. Both are held against what the spindle gives all day, which is a mean as well: its
inertia carries the peaks of single teeth. Deflection and surface error are those of the periodic vibration of the
stable cut (`stability.vibration_maps`). A length of edge L reaches ``a_p = L sin k`` deep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.cut.force import mean_torque
from process.types import Real
from smfe.campaign import Campaign, LobeRequest
from stability import SpindleRange


@dataclass(frozen=True)
class DepthCeiling:
    """One thing that limits the depth of cut.

    Parameters
    ----------
    what : str
        In words, after "limited by".
    depth : float
        Greatest depth [m] at 1 rpm, or at any speed.
    per_speed : bool
        Whether the depth goes down as one over the spindle speed.
    allowed : (float, str), optional
        What must not be exceeded, and its unit; it goes as the depth.
    over : (ndarray, ndarray), optional
        Spindle speeds [rpm] and the greatest depth [m] at each, in place of `depth`.
    accuracy : float
        Share of the speed by which the spindle may turn beside it: the smallest depth of `over` there counts.
    """

    what: str
    depth: float = math.inf
    per_speed: bool = False
    allowed: tuple[float, str] | None = None
    over: tuple[Real, Real] | None = None
    accuracy: float = 0.0

    def at(self, speed: Real) -> Real:
        """Return the greatest depth [m] at spindle speeds [rpm]."""
        if self.over is None:
            return self.depth / speed if self.per_speed else np.full(np.shape(speed), self.depth)
        known, depth = self.over
        low = np.searchsorted(known, speed * (1.0 - self.accuracy) * (1.0 + 1e-12), side="right") - 1
        high = np.searchsorted(known, speed * (1.0 + self.accuracy) * (1.0 - 1e-12), side="left")
        pairs = zip(np.atleast_1d(np.maximum(low, 0)), np.atleast_1d(high), strict=True)
        return np.array([depth[a : b + 1].min() for a, b in pairs]).reshape(np.shape(speed))

    def said(self, depth: float, speed: float) -> str:
        """Return what limits a depth [m], with how much of what is allowed it takes: "the power ...: 9.8 of 10 kW"."""
        if self.allowed is None:
            return self.what
        value, unit = self.allowed
        share = depth / float(self.at(np.array([speed]))[0])
        return f"{self.what}: {share * value:.3g} of {value:.4g} {unit}"


_OF_VIBRATION = {
    "deflection_depth": ("deflection", "the deflection of the tool"),
    "surface_depth": ("surface_error", "the error of the wall"),
}


def ceilings_of(campaign: Campaign, request: LobeRequest, reach: xr.Dataset | None = None) -> tuple[DepthCeiling, ...]:
    """Return what limits the depth of a request beside chatter, as far as the campaign says it.

    Parameters
    ----------
    campaign : Campaign
        Tool, work material, and what tool and machine can do.
    request : LobeRequest
        Cut, width and feed, and what else it allows.
    reach : xarray.Dataset, optional
        Depths that deflection and surface error allow over the speeds [mm], `smfe.limits.cut_maps.REACH`.
    """
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    tool, can, out = campaign.tool, campaign.machine_limits, []
    if request.maximum_depth is not None:
        out.append(DepthCeiling("the greatest depth that is asked for", request.maximum_depth))
    if can.edge_length is not None:
        out.append(DepthCeiling("the length of the cutting edges", can.edge_length * math.sin(tool.approach_angle)))
    arc = request.arc(tool.diameter)
    torque = mean_torque(tool, arc, campaign.coefficients, request.feed_per_tooth)
    most = min((v for v in (can.torque, request.spindle_torque) if v is not None), default=None)
    if most is not None and torque > 0.0:
        out.append(DepthCeiling("the torque of the spindle", most / torque, allowed=(most, "N m")))
    most = min((v for v in (can.power, request.spindle_power) if v is not None), default=None)
    if most is not None and torque > 0.0:
        depth = most / (torque * 2.0 * math.pi / 60.0)
        out.append(DepthCeiling("the power of the spindle", depth, True, (1e-3 * most, "kW")))
    for name, (key, what) in _OF_VIBRATION.items():
        if reach is not None and name in reach:
            over = reach["spindle_speed"].values.astype(float), 1e-3 * reach[name].values.astype(float)
            # With unequal pitch the vibration does not go as the depth: nothing is said of its share.
            allowed = (1e6 * getattr(request, key), "um") if tool.equal_pitch else None
            out.append(DepthCeiling(what, allowed=allowed, over=over, accuracy=campaign.spindle.accuracy))
    return tuple(out)


def deepest(ceilings: Sequence[DepthCeiling], speed: Real) -> Real:
    """Return the greatest depth [m] that all ceilings allow at spindle speeds [rpm]; inf without one."""
    return np.asarray(np.min([np.full(np.shape(speed), math.inf), *(c.at(speed) for c in ceilings)], axis=0))


def fastest(campaign: Campaign, request: LobeRequest) -> SpindleRange | None:
    """Return the spindle speeds at which the table feeds fast enough; None where there is none.

    ``n = v_f / (f_z N)``.
    """
    assert campaign.tool is not None
    spindle, feed = campaign.spindle, campaign.machine_limits.feed
    if feed is None:
        return spindle
    top = 60.0 * feed / (request.feed_per_tooth * campaign.tool.teeth)
    return replace(spindle, maximum=min(top, spindle.maximum)) if top > spindle.minimum else None
