"""A machine in uniform motion that is struck again and again: all but the blow is made ready once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from process.excitation import Excitation, HalfSine
from process.machine import Machine
from process.machine_linear import fastest_pole, system_of
from process.machine_march import AT_REST, made_ready, march
from process.machine_packing import pack_blow
from process.machine_problem import problem
from process.machine_records import displacement_of
from process.machine_simulation import require_fine
from process.machine_stability import require_bounded

Real = NDArray[np.float64]

_ANY = HalfSine(1.0)


class Struck:
    """A machine that is struck along one axis; its samples are its steps, and nothing is low-passed.

    Parameters
    ----------
    machine : Machine
        At rest or in uniform motion.
    axis : str
        Axis of the blow.
    duration : float
        Time that is followed [s].
    feed, controller, position
        As of `process.machine_simulation.simulate_machine`.
    sample_rate : float, optional
        Samples and steps a second [Hz].
    accuracy : float
        Largest error of a friction or joint force in a step, over the largest force so far.

    Raises
    ------
    InputError
        When the servos are unstable when sliding fast, or the step is too large.
    """

    def __init__(
        self,
        machine: Machine,
        axis: str,
        *,
        duration: float,
        accuracy: float,
        feed: float | Mapping[str, float] = 0.0,
        controller: str | None = None,
        position: float | None = None,
        sample_rate: float = 2000.0,
    ) -> None:
        p = problem(
            machine, duration=duration, feed=feed, controller=controller, position=position, forces={axis: _ANY}
        )
        require_bounded(p)
        system, step = system_of(p), 1.0 / sample_rate
        require_fine(p, fastest_pole(p, system), step)
        self._ready = made_ready(p, system, step, round(p.total * sample_rate))
        self._accuracy = accuracy

    def displacement(self, blow: Excitation, rest: float = AT_REST) -> Real:
        """Return the displacement of the tool [m] from the ramp at each sample, shape (3, m), until it is at rest.

        Parameters
        ----------
        blow : Excitation
            Force on the tool; hashable: how it is sampled is kept.
        rest : float, optional
            Share of their largest below which states and forces are at rest once the blow is over. Then the record
            ends: the tool stays where it was before the blow.

        Raises
        ------
        InputError
            When friction and joints cannot be solved for, or the tool leaves the range of 1 m.
        """
        r = self._ready
        run = march(r, pack_blow(blow, r.step, r.steps), [], keep=1, accuracy=self._accuracy, rest=rest)
        return displacement_of(r.problem, run)
