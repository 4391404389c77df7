"""Which line of a record is that of the vibration that chatters.

Teeth that leave the work in part of each vibration give it, beside the lines ``f_c + k f_T`` that the linear limit has
too, those at ``m f_c + k f_T``. The criterion judges by the highest that no spindle order masks and that is not there
before: where f_c stands beside an order, or the cut was chattering when it began, that is one of the small ones, which
no linear limit has. The vibration itself is the highest line that does not repeat with the spindle.
"""

from __future__ import annotations

import numpy as np

from smfe.diagnosis.cutting.rules import RULES
from stability import ChatterVerdict


def vibrating_line(verdict: ChatterVerdict, teeth: int) -> float:
    """Return the frequency [Hz] of the highest line of the chatter whose line a verdict gives; that one if it is.

    Parameters
    ----------
    verdict : ChatterVerdict
        Of a cut that chatters, with its spectrum.
    teeth : int
        Number of teeth.
    """
    found = verdict.chatter_frequency_Hz
    frequency, height = (np.asarray(verdict.spectrum[name].values) for name in ("frequency", "vector_amplitude"))
    if not np.isfinite(found) or frequency.size < 3:
        return found
    turn, resolved = verdict.spindle_speed_rpm / 60.0, verdict.resolution_Hz
    peaks = np.flatnonzero((height[1:-1] >= height[:-2]) & (height[1:-1] >= height[2:])) + 1
    # What repeats with the spindle is run-out, or the mean force.
    order = frequency[peaks] / turn
    peaks = peaks[np.abs(order - np.round(order)) * turn > resolved]
    if not peaks.size:
        return found
    peak = peaks[np.argmax(height[peaks])]
    highest = float(frequency[peak])
    # What was judged repeats no order, however near it stands to one.
    if np.interp(found, frequency, height) >= height[peak]:
        return found
    around = np.arange(-RULES.passings_away, RULES.passings_away + 1)
    lines = np.abs(found + turn * teeth * around)[:, None] / np.array(RULES.harmonics_of_chatter)
    same = RULES.same_line * resolved
    related = np.abs(lines - highest).min() < same <= abs(found - highest)
    return highest if related else found
