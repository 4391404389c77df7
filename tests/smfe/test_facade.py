"""What `import smfe` offers: every command by its name, and each public name documented."""

import inspect
from pathlib import Path

import typer

import smfe
from smfe import cli
from smfe.commands import run as one_command

FORMER = {
    "load_campaign": "read_campaign",
    "identify_hammer": "hammer_compliance",
    "identify_actuator": "actuator_compliance",
    "identify_sweep": "sweep_compliance",
}
"""Former name -> name of today."""


def commands() -> set[str]:
    """Return the commands that `smfe --help` lists."""
    return set(typer.main.get_command(cli.app).commands)


def test_each_command_is_a_file_and_a_function_of_that_name() -> None:
    folder = inspect.getsourcefile(one_command)
    assert folder is not None
    files = {path.stem for path in Path(folder).parent.glob("*.py")} - {"__init__"}
    assert files == commands()
    for name in files:
        function = getattr(smfe, name)
        assert inspect.isfunction(function), name
        assert function.__module__ == f"smfe.commands.{name}"
        assert name in smfe.__all__


def test_every_public_name_is_there_and_says_what_it_is() -> None:
    assert len(set(smfe.__all__)) == len(smfe.__all__)
    for name in smfe.__all__:
        assert getattr(smfe, name).__doc__, name


def test_former_names_are_the_same_functions() -> None:
    for former, name in FORMER.items():
        assert getattr(smfe, former) is getattr(smfe, name)
