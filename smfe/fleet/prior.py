"""What is known of a machine before it is measured: mean and covariance of the modes of machines like it.

Of each mode that the machines have in common (`smfe.fleet.tracks` says which peaks are the same mode) the vector
``x = (ln f, ln zeta, ln k)`` is taken, with the natural frequency f, the damping ratio zeta and the modal stiffness k
from the height A of the peak of a single mode, ``A = 1/(2 k zeta sqrt(1 - zeta^2))``. Every machine weighs the same:

    mean = (1/M) sum_m x_m,    covariance = S_between + S_within,

with x_m the mean over the campaigns of machine m, S_between the sample covariance of the x_m (one machine: zero), and
S_within the covariance of the campaigns about the mean of their machine, pooled. It is the scatter to be expected of
one measurement of one more machine, the error of measuring included.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from process.errors import InputError
from process.types import Real
from process.units import show
from smfe.campaign.toml import table as toml_table
from smfe.fleet.tracks import Mode, over_machines

PARTS = ("ln frequency", "ln damping", "ln stiffness")
"""What the vector of a mode holds; frequency in Hz, stiffness in N/m."""

_DIRECTION = {"xx": [1.0, 0.0, 0.0], "yy": [0.0, 1.0, 0.0], "zz": [0.0, 0.0, 1.0]}


@dataclass(frozen=True)
class Prior:
    """Mean and covariance of the modes of machines.

    Parameters
    ----------
    machines : tuple of str
        Whose modes they are.
    measurements : int
        How many measurements there were.
    modes : tuple of (str, int)
        Entry and number of each mode.
    mean : ndarray, shape (3 n,)
        ``ln f, ln zeta, ln k`` of each mode, one after the other.
    covariance : ndarray, shape (3 n, 3 n)
        Of the same.
    left_out : tuple of str
        Modes that not all of these machines have.
    """

    machines: tuple[str, ...]
    measurements: int
    modes: tuple[tuple[str, int], ...]
    mean: Real
    covariance: Real
    left_out: tuple[str, ...] = ()

    @property
    def std(self) -> Real:
        """Relative standard deviations of frequency, damping and stiffness, shape (n, 3)."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 3)

    def as_json(self) -> str:
        """Return mean, covariance, and what they are of."""
        content = {
            "machines": list(self.machines),
            "measurements": self.measurements,
            "modes": [{"entry": entry, "mode": number} for entry, number in self.modes],
            "vector": [f"{entry} {number}: {part}" for entry, number in self.modes for part in PARTS],
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "left_out": list(self.left_out),
        }
        return json.dumps(content, indent=2) + "\n"

    def as_toml(self, name: str = "fleet") -> str:
        """Return ``[[model]]`` with the mean as modes and, as their uncertainty, the mean of the standard deviations.

        A campaign takes it as it stands: as a source of lobes, whose limits then have quantiles, as the estimate of
        ``[plan]`` or as a baseline. The uncertainty of a model is one for all its modes: root mean squares.
        """
        f, z, k = np.exp(self.mean.reshape(-1, 3)).T
        modes = [
            {
                "frequency": show(float(f[i]), "Hz", "frequency", 6),
                "damping": float(f"{z[i]:.5g}"),
                "stiffness": show(float(k[i]), "N/um", "stiffness", 6),
                "direction": _DIRECTION[entry],
            }
            for i, (entry, _) in enumerate(self.modes)
        ]
        rms = np.sqrt(np.mean(self.std**2, axis=0))
        spread = {n: float(f"{s:.4g}") for n, s in zip(("frequency", "damping", "stiffness"), rms, strict=True)}
        head = [
            f"# Modes to be expected of a machine like {', '.join(self.machines)};",
            f"# from {self.measurements} measurements.",
            "# Each mode moves along one axis: cross terms are not known.",
            "# Standard deviations of each mode, relative (frequency, damping, stiffness):",
        ]
        for (entry, number), row in zip(self.modes, self.std, strict=True):
            head.append(f"#   {entry} {number}: " + ", ".join(f"{100.0 * s:.2g} %" for s in row))
        head += [f"# left out: {text}" for text in self.left_out]
        return "\n".join(head) + "\n" + toml_table("[[model]]", {"name": name, "modes": modes, "uncertainty": spread})


def prior_of(modes: Sequence[Mode]) -> Prior:
    """Return the prior that the modes of machines give.

    Parameters
    ----------
    modes : sequence of Mode
        From `smfe.fleet.tracks.modes_of`.

    Raises
    ------
    InputError
        When they have no mode in common, or there is one measurement only, which has no scatter.
    """
    machines = tuple(sorted({mode.machine for mode in modes}))
    groups = over_machines(modes)
    whole = [(entry, number, same) for entry, number, same in groups if len(same) == len(machines)]
    if not whole:
        raise InputError("the chosen machines have no mode in common; choose fewer with --machine, or other rows")
    left_out = [
        f"{entry} mode {number}, which {len(same)} of {len(machines)} machines have"
        for entry, number, same in groups
        if len(same) < len(machines)
    ]
    by_machine = []
    for machine in machines:
        vectors: dict[tuple[str, str], list[float]] = {}
        for _, _, same in whole:
            (mode,) = (m for m in same if m.machine == machine)
            at = [(str(c), str(m)) for c, m in zip(mode.rows["campaign"], mode.rows["measurement"], strict=True)]
            for where, x in zip(at, _vectors(mode).tolist(), strict=True):
                vectors.setdefault(where, []).extend(x)
        # A campaign that misses one of the modes has no whole vector.
        rows = [v for where, v in sorted(vectors.items()) if len(v) == 3 * len(whole)]
        if not rows:
            raise InputError(f"no measurement of '{machine}' has all modes of the others; choose other machines")
        by_machine.append(np.array(rows))
    count = sum(len(rows) for rows in by_machine)
    if count < 2:
        raise InputError("one measurement has no scatter; a prior needs several campaigns of the chosen machines")
    means = np.array([rows.mean(axis=0) for rows in by_machine])
    between = np.cov(means, rowvar=False, ddof=1) if len(machines) > 1 else 0.0
    rest = np.concatenate([rows - rows.mean(axis=0) for rows in by_machine])
    within = rest.T @ rest / (count - len(machines)) if count > len(machines) else 0.0
    covariance = np.asarray(between + within, float)
    modes_said = tuple((entry, number) for entry, number, _ in whole)
    return Prior(machines, count, modes_said, means.mean(axis=0), covariance, tuple(left_out))


def _vectors(mode: Mode) -> Real:
    """Return ``ln f, ln zeta, ln k`` of each measurement, shape (n, 3); frequency in Hz, stiffness in N/m."""
    f, z, height = mode.values("frequency"), mode.values("damping"), 1e-6 * mode.values("amplitude")
    return np.log(np.stack([f, z, 1.0 / (2.0 * height * z * np.sqrt(1.0 - z**2))], axis=1))
