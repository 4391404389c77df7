"""What the operator does: clamping, sensors, the steps of each pass with their times, and what goes wrong.

Seen from above, feed to the right (+x), spindle clockwise: in down milling the work lies to the right of the feed (at
-y), in up milling to the left, in central milling on both sides of the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from smfe.planning.forces import Pass, SweepPlan
from smfe.planning.recommend import Plan


@dataclass(frozen=True)
class Step:
    """One moment of a pass.

    Parameters
    ----------
    time : float
        Since the start of the record [s].
    position : float
        Of the tool centre along the feed [m]; zero where the tool first touches the work.
    speed : float
        Of the spindle [rad/s].
    text : str
        What happens.
    """

    time: float
    position: float
    speed: float
    text: str


def centre_offset(one: Pass, diameter: float) -> float:
    """Return how far [m] the tool centre runs outside the wall of the work; inside it where negative.

    ``D/2 - a_e`` for down and up milling; zero, the middle of the ridge, for central milling.
    """
    return 0.0 if one.cut == "central" else 0.5 * diameter - one.width


def strip(one: Pass, diameter: float) -> tuple[float, float]:
    """Return the work before a pass across the feed, from y to y [m], the tool centre at y = 0.

    Down milling: all to the right of the wall, up to infinity; up milling: all to its left; central: the ridge.
    """
    if one.cut == "central":
        return -0.5 * one.width, 0.5 * one.width
    wall = centre_offset(one, diameter)
    return (-math.inf, -wall) if one.cut == "down" else (wall, math.inf)


def steps(sweep: SweepPlan, one: Pass) -> list[Step]:
    """Return what happens in a pass, from the start of the record to its end.

    The tool enters at the lowest speed; the spindle accelerates at full width alone, so that every speed is cut with
    the immersion that the plan counts on, and leaves the work at the highest speed.
    """
    feed = sweep.feed_rate
    entry = one.entry_length(sweep.tool.diameter) / feed
    full, leaves = sweep.lead + entry, sweep.lead + sweep.stock / feed
    ramped = full + sweep.duration
    moments = [
        (0.0, sweep.start, "start recorder and feed in the air, spindle at constant speed; nothing touches"),
        (sweep.lead, sweep.start, "the tool touches the work"),
        (full, sweep.start, "full width of cut: start the ramp of the spindle"),
        (ramped, sweep.end, "end of the ramp: hold the speed"),
        (leaves, sweep.end, "the tool begins to leave the work"),
        (leaves + entry, sweep.end, "the tool has left the work; feed and spindle go on in the air"),
        (leaves + entry + sweep.tail, sweep.end, "stop the recorder: the machine has come to rest"),
    ]
    return [Step(t, feed * (t - sweep.lead), speed, text) for t, speed, text in moments]


def side_cuts(sweep: SweepPlan, one: Pass) -> list[str]:
    """Return what the work must look like before a pass, and what the pass leaves."""
    width, depth = 1e3 * one.width, 1e3 * sweep.depth
    offset = 1e3 * centre_offset(one, sweep.tool.diameter)
    if one.cut == "central":
        return [
            f"Before: a ridge {width:g} mm wide, {depth:g} mm high and straight, its middle under the tool centre. Cut "
            f"it with a side cut on either side, each {depth:g} mm deep or more and wider than "
            f"{0.5 * (1e3 * sweep.tool.diameter - width):.3g} mm.",
            "After: the ridge is gone.",
        ]
    side = "right" if one.cut == "down" else "left"
    where = f"{abs(offset):.3g} mm {'outside' if offset >= 0.0 else 'inside'} the wall"
    return [
        f"Before: a straight wall to the {side} of the feed, {depth:g} mm high or more, from a light side cut.",
        f"The tool centre runs {where}, so that the tool takes {width:g} mm.",
        f"After: a step {width:g} mm wide and {depth:g} mm deep with a new straight wall, from which the next pass can "
        "start.",
    ]


def before(found: Plan) -> list[str]:
    """Return what is done once, before the first pass."""
    sweep, limits = found.sweep, found.task.limits
    teeth = found.task.tool.teeth
    mounted = (
        f"Mount all {teeth} inserts."
        if sweep.tool.teeth == teeth
        else f"Mount {sweep.tool.teeth} of the {teeth} inserts, evenly spaced; leave the other pockets empty."
    )
    peak = float(found.prediction["peak_force"].sel(depth_of_cut=1e3 * sweep.depth, method="nearest").max())
    return [
        f"{mounted} Use new inserts of one batch, and write their run-out down.",
        f"The work is {1e3 * sweep.stock:.0f} mm long along the feed, or longer; the axis travels "
        f"{1e3 * sweep.travel:.0f} mm in a pass of {sweep.pass_time:.0f} s.",
        f"Clamp the work on the dynamometer so that nothing rocks: {peak:.0f} N act at most, upwards too. Clamps stay "
        f"{1e3 * sweep.tool.diameter:g} mm away from the path of the tool.",
        "Fix the accelerometer for x, y, z as near to the tool as is safe, on metal, screwed or glued; run the cable "
        "so that it neither hangs nor whips. Write down which way each axis points.",
        "The dynamometer under the work measures the force on the work: sign = -1 for its three channels.",
        f"Record spindle angle or speed (one pulse a turn will do), three forces and three accelerations with one "
        f"clock, {1e-3 * limits.sample_rate:g} kHz or more, anti-alias filters on, no high-pass filter.",
        "Lock spindle override and feed override at 100 %. Coolant off, or the same in all passes.",
        "Record ten seconds with everything at rest, and one pass in the air with the same ramp: they show hum and how "
        "the spindle shakes by itself. Name the pass in the air as background in plan.toml.",
        f"Try the ramp in the air: {_rpm(sweep.acceleration):.3g} rpm/s from {_rpm(sweep.start):.0f} to "
        f"{_rpm(sweep.end):.0f} rpm, without a step. A staircase of speeds is no sweep.",
    ]


def what_goes_wrong(found: Plan) -> list[tuple[str, str]]:
    """Return signs and what to do about them."""
    sweep = found.sweep
    least = float(found.prediction["limit_depth"].min())
    margin = f" The shallowest limit on the way is {least:.3g} mm." if math.isfinite(least) else ""
    return [
        (
            "It howls, or leaves a wave on the wall.",
            f"The machine chatters; the pass says nothing about its compliance.{margin} Lift, halve the "
            "depth, plan again.",
        ),
        ("The dynamometer or an accelerometer is overloaded.", "Choose the next range and repeat the pass."),
        (
            "The spindle does not follow the ramp.",
            f"Ramp more slowly: give spindle_acceleration less than {_rpm(sweep.acceleration):.3g} rpm/s and plan "
            "again; the pass becomes longer.",
        ),
        ("The record begins in the cut, or ends in it.", "Repeat it: the air before and after gives noise and decay."),
        ("An insert breaks or wears.", "Change all, repeat all passes: coefficients and run-out have changed."),
        ("The axis stops or reverses within the pass.", "Repeat it: friction at rest is another machine."),
        ("The width of cut is not what was planned.", "Measure it and write it into plan.toml."),
    ]


def _rpm(rotation: float) -> float:
    return rotation * 30.0 / math.pi
