"""What else than chatter limits a cut: the length of the edges, the request itself, power, torque and feed.

Mean torque of a cut with straight edges, over a turn, per depth of cut (`process.cut.force`)::

    M / a_p = D/2 N/(2 pi) (K_tc f_z (cos phi_st - cos phi_ex) + K_te (phi_ex - phi_st) / sin k)

and the power ``P = M 2 pi n``. Both are held against what the spindle gives all day, which is a mean as well: its
inertia carries the peaks of single teeth. A length of edge L reaches ``a_p = L sin k`` deep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

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
    """

    what: str
    depth: float
    per_speed: bool = False

    def at(self, speed: Real) -> Real:
        """Return the greatest depth [m] at spindle speeds [rpm]."""
        return self.depth / speed if self.per_speed else np.full(np.shape(speed), self.depth)


def ceilings_of(campaign: Campaign, request: LobeRequest) -> tuple[DepthCeiling, ...]:
    """Return what limits the depth of a request beside chatter, as far as the campaign says it.

    Parameters
    ----------
    campaign : Campaign
        Tool, work material, and what tool and machine can do.
    request : LobeRequest
        Cut, width and feed.
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
    if can.torque is not None and torque > 0.0:
        out.append(DepthCeiling("the torque of the spindle", can.torque / torque))
    if can.power is not None and torque > 0.0:
        out.append(
            DepthCeiling("the power of the spindle", can.power / (torque * 2.0 * math.pi / 60.0), per_speed=True)
        )
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
