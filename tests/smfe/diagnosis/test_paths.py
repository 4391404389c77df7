"""How many files of the packages the diagnosis of a drive record passes: what an engineer reads to follow it."""

import sys
from dataclasses import replace
from pathlib import Path
from types import FrameType

from exam.drive import axis_of, family_of

import process
import smfe
import stability
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.story.sentences import explain

PACKAGES = [Path(package.__file__).parent for package in (process, smfe, stability)]
MOST = 28


def test_a_drive_record_passes_at_most_28_files_from_its_channels_to_the_sentences_of_its_finding() -> None:
    """A command that was not logged: control law, force balance, search, held-out moves, size, verdict, intervals."""
    axis = replace(axis_of(("command",), 4), rest=0.0, seconds=11.0)
    executed: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            executed.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        family = family_of(axis, 4)
        law = tuple(c for c in family.conditions if c.name.startswith("control law"))
        text = explain(diagnose(replace(family, conditions=law), workers=1))
    finally:
        sys.setprofile(None)
    assert "command that was not logged" in text
    passed = sorted(name for name in executed if any(package in Path(name).parents for package in PACKAGES))
    assert any(name.endswith("control_law.py") for name in passed)
    assert len(passed) <= MOST, passed
