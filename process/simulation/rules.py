"""Numbers of the time simulation in one place: steps, accuracy, sampling of forces, verdict on how a record ends."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SimulationRules:
    """Steps and limits of the time simulation."""

    steps_per_event: int = 8
    """Steps in the shortest event of an excitation, at least."""

    steps_per_pole: int = 24
    """Steps in the period of the fastest linear pole, at least."""

    steps_per_period: int = 60
    """Steps in the shortest natural period, at least, in a cut, whose force is linear over a step."""

    steps_per_tooth: int = 120
    """Steps in the shortest tooth period, at least."""

    coarsest_per_pole: int = 20
    """Steps in the period of the fastest pole below which a step that is given is refused."""

    coarsest_per_period: int = 4
    """Steps in the shortest natural period below which a step of a `ModalModel` is refused: halving it changed stable
    cuts by a tenth."""

    coarsest_per_tooth: int = 10
    """Steps in the shortest tooth period below which one is refused: halving it changed stable cuts by a third
    to all."""

    accuracy: float = 2e-3
    """Largest error of a friction or joint force, over the largest so far, in a step that only poles and events limit.

    It goes with the fourth power of the step: 1.25e-4 at half of it.
    """

    largest_accuracy: float = 1e-2
    """The same, however long the step."""

    least_force: float = 1e-3
    """Force [N] that errors are compared with where nothing has acted yet: in the air before a cut, rounding is all
    that a sliding guideway shows."""

    halvings: int = 8
    """How often a step may be halved where friction or a joint does not follow a parabola."""

    parts: int = 8
    """Parts of a step at which forces over time are sampled, for their moments over the step."""

    settling: float = 1e3
    """Time [s] over which a law with memory moves to its steady state before t = 0."""

    fast: float = 10.0
    """Speed [m/s] at which friction is past everything that depends on slow motion."""

    path_points: int = 33
    """Structures along the path of an axis that a posture depends on."""

    at_rest: float = 1e-12
    """Share of the largest states and forces below which a machine without excitation is at rest."""

    margin: int = 10
    """Samples to each side that the low-pass of a record spans."""

    window: float = 0.25
    """Time [s] at the end of a record that decides how it ends."""

    standstill: float = 0.1
    """Share of the feed below which a slide counts as standing still."""

    quiet: float = 1e-3
    """Share of the largest speed below which the end of a record is quiet."""

    decaying: float = 0.97
    """Scatter of the last quarter over that of the third, above which a motion does not decay."""


RULES = SimulationRules()
