"""How a measurement is made: what each method reads of the campaign file, and what it gives.

A new way to excite a machine is a file in `smfe.identification`, a line here and a line in ``IDENTIFY`` of
`smfe.identification.measurement`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MeasuringMethod:
    """What a method of ``[[measurement]]`` reads and gives.

    Parameters
    ----------
    title : str
        What the report calls it.
    settings : tuple of str
        Keys of the measurement that it reads, besides those that every method reads; others are refused.
    record : tuple of str, optional
        Keys that each of its records needs; for other methods they are refused.
    estimators : tuple of str, optional
        What ``estimator`` may be, the default first; empty: it has none.
    compliance : bool, optional
        Whether it gives a compliance.
    """

    title: str
    settings: tuple[str, ...] = ()
    record: tuple[str, ...] = ()
    estimators: tuple[str, ...] = ()
    compliance: bool = True


AVERAGES = ("H1", "H2", "Hv")
"""Averages of spectra over hits or blocks."""

SWEEP_ESTIMATORS = ("local_polynomial", "bands", "segments", "orders", "single_reference")
"""How the records of a sweep become a compliance."""

SENSORS = ("accelerometer", "laser", "two")
"""What measures the motion of a tool that is hit or shaken; two accelerometers weigh twice as much."""

_SETTING = ("spindle_speed", "sensor", "free_mass")

METHODS = {
    "hammer": MeasuringMethod(
        "impact hammer",
        ("estimator", "force_window", "exponential_window", "remove_background", "split_levels", "full_scale",
         "accelerometer_mass", *_SETTING),
        ("excitation",),
        AVERAGES,
    ),
    "actuator": MeasuringMethod(
        "actuator",
        ("estimator", "accelerometer_mass", "frame_mass", "period", "settling", *_SETTING),
        ("excitation",),
        (*AVERAGES, "local_polynomial"),
    ),
    "sweep": MeasuringMethod(
        "sweep milling force excitation",
        ("estimator", "background", "references", "axes", "reciprocal", "position_dependent", "dynamometer",
         "split_levels"),
        ("cut", "width_of_cut"),
        SWEEP_ESTIMATORS,
    ),
    "frf": MeasuringMethod("compliance from a file", ("averages", "conjugate"), ("excitation", "response")),
    "drive": MeasuringMethod("axis in motion", ("moving_mass",), compliance=False),
    "open_loop": MeasuringMethod("force added to a drive", ("period", "settling", "hold"), compliance=False),
    "loop": MeasuringMethod("excited setpoint of a control", ("period", "settling"), compliance=False),
    "silent": MeasuringMethod("machine at rest", compliance=False),
}  # fmt: skip
"""Name in the campaign file -> method; "frf" is a response that another program has averaged."""

COMPLIANCE_METHODS = tuple(name for name, method in METHODS.items() if method.compliance)


def readers_of(key: str) -> tuple[str, ...]:
    """Return the methods that read a key of a measurement; empty where all do."""
    return tuple(name for name, method in METHODS.items() if key in method.settings)


def needed_by(key: str) -> tuple[str, ...]:
    """Return the methods whose records need a key."""
    return tuple(name for name, method in METHODS.items() if key in method.record)
