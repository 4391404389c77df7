"""What a machine does when nothing excites it: whether it was recorded, and whether it is at rest then."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from process.labels import sample_interval
from smfe.campaign import Campaign, Measurement
from smfe.diagnosis.channel_checks import channels_of, tones
from smfe.diagnosis.suspect import Suspect
from smfe.identification.measurement import records_of

LOUDER, TONAL = 3.0, 0.5
"""Times the root mean square at rest, and share of the power in lines, above which an axis vibrates by itself."""


def silence_suspects(campaign: Campaign) -> Iterator[Suspect]:
    """Compare the records without excitation in motion with those at rest.

    An axis may vibrate by itself where friction falls with the speed, with a period and its harmonics; a compliance
    measured there means nothing. Noise of drives and guideways is no such thing.
    """
    silent = [m for m in campaign.measurements if m.method == "silent"]
    if not silent:
        if any(m.method in ("hammer", "actuator") for m in campaign.measurements) and campaign.baseline is not None:
            yield Suspect(
                "background_tone",
                "note",
                "campaign",
                "no record without excitation: tones and vibration by itself cannot be told from the response",
                "record ten seconds at rest and ten at each feed without any hit (method = 'silent'); about 2 min",
            )
        return
    rest: dict[str, float] = {}
    for m in silent:
        if not _moves(m):
            for name, (level, _) in _levels(m).items():
                rest[name] = min(level, rest.get(name, level))
    for m in silent:
        if _moves(m):
            for name, (level, tonal) in _levels(m).items():
                if level > LOUDER * rest.get(name, np.inf) and tonal > TONAL:
                    yield _loud(m, name, level, rest[name])


def _loud(measurement: Measurement, channel: str, level: float, rest: float) -> Suspect:
    return Suspect(
        "limit_cycle",
        "warning",
        f"{measurement.name}, {channel}",
        f"{level:.3g} m/s^2 rms in motion without excitation, {level / rest:.2g} times that at rest",
        "a compliance measured at this feed is none of a machine at rest: measure at another feed, or find the cause",
    )


def _moves(measurement: Measurement) -> bool:
    return any((measurement.feed or {}).values())


def _levels(measurement: Measurement) -> dict[str, tuple[float, float]]:
    """Root mean square of each accelerometer about its mean [m/s2] and share of its lines, of the loudest record."""
    found: dict[str, tuple[float, float]] = {}
    for entry in measurement.records:
        for record in records_of(entry):
            for name, samples in channels_of(record):
                level = float(np.std(samples))
                if name.startswith("acceleration") and level > found.get(name, (0.0, 0.0))[0]:
                    lines = sum(0.5 * a**2 for _, a, _ in tones(samples, sample_interval(record)))
                    found[name] = level, lines / level**2
    return found
