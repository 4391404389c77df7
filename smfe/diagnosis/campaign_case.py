"""What a campaign puts to the question: a family of models, and which of its conditions belong to which measurement."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from process.errors import InputError
from smfe.diagnosis.problem import Family
from smfe.diagnosis.suspect import Suspect
from smfe.records.formats.channels import did_you_mean, listed


@dataclass(frozen=True)
class Case:
    """A campaign as the engine takes it.

    Parameters
    ----------
    family : Family
        Baseline, causes, conditions and proposals.
    groups : mapping
        Name of a measurement, or file of a cutting test -> names of its conditions.
    held_out : tuple of str
        Those of the groups that the campaign sets aside.
    suspects : tuple of Suspect
        What was noticed about the data on the way.
    """

    family: Family
    groups: Mapping[str, tuple[str, ...]]
    held_out: tuple[str, ...] = ()
    suspects: tuple[Suspect, ...] = field(default=())

    def set_aside(self, more: Iterable[str] = ()) -> tuple[str, ...]:
        """Return the conditions that are opened at the end: those of the campaign, and of `more` measurements.

        Raises
        ------
        InputError
            For a measurement that is none of the campaign's, or when nothing is left to fit.
        """
        names = dict.fromkeys((*self.held_out, *more))
        for name in names:
            if name not in self.groups:
                near = did_you_mean(name, self.groups)
                raise InputError(f"'{name}' cannot be held out{near}; compared are {listed(self.groups)}")
        if len(names) == len(self.groups):
            raise InputError(f"{listed(names)}: everything is held out, nothing is left to be fitted; leave some in")
        return tuple(condition for name in names for condition in self.groups[name])
