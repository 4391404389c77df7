"""What `import smfe` offers: every command by its name, and each public name documented."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import typer

import process
import smfe
import stability
from smfe import cli
from smfe.commands import run as one_command

FORMER = {
    "load_campaign": "read_campaign",
    "identify_hammer": "hammer_compliance",
    "identify_actuator": "actuator_compliance",
    "identify_sweep": "sweep_compliance",
}
"""Former name -> name of today."""


PARTS = {"folders", "places", "tasks"}
"""Modules beside the commands that are parts of one: a run of many campaigns."""


def commands() -> set[str]:
    """Return the commands that `smfe --help` lists."""
    return set(typer.main.get_command(cli.app).commands)


def test_each_command_is_a_file_and_a_function_of_that_name() -> None:
    folder = inspect.getsourcefile(one_command)
    assert folder is not None
    files = {path for path in Path(folder).parent.rglob("*.py") if path.stem != "__init__"}
    assert {path.stem for path in files} - PARTS == commands()
    for name in commands():
        function = getattr(smfe, name)
        assert inspect.isfunction(function), name
        source = Path(str(inspect.getsourcefile(function)))
        assert source in files
        assert source.stem == name
        assert name in smfe.__all__


def test_every_public_name_is_there_and_says_what_it_is() -> None:
    assert len(set(smfe.__all__)) == len(smfe.__all__)
    for name in smfe.__all__:
        assert getattr(smfe, name).__doc__, name


def test_former_names_are_the_same_functions() -> None:
    for former, name in FORMER.items():
        assert getattr(smfe, former) is getattr(smfe, name)


HEAVY = ("numpy", "scipy", "pandas", "xarray", "numba", "matplotlib")
"""Packages whose import takes more than a tenth of a second."""


def imported_by(code: str) -> set[str]:
    """Return which of the heavy packages a fresh interpreter has imported after some code."""
    shown = f"{code}\nimport sys\nprint(*({HEAVY!r} & sys.modules.keys()), file=sys.stderr)"
    shown = shown.replace(repr(HEAVY), f"set({HEAVY!r})")
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=True, timeout=60)
    return set(done.stderr.split())


def test_what_answers_at_once_imports_no_numerics() -> None:
    """Help, version and completion wait for nothing; one interpreter asks for all of them in turn."""
    code = """
import os, smfe, process, stability
from smfe.cli import app, app_entry
for words in ([], ["--version"], ["--help"], ["run", "--help"], ["chatter", "--help"]):
    try:
        app(words, prog_name="smfe")
    except SystemExit:
        pass
os.environ.update(_SMFE_COMPLETE="complete_bash", COMP_WORDS="smfe ru", COMP_CWORD="1")
try:
    app([], prog_name="smfe")
except SystemExit:
    pass
"""
    assert imported_by(code) == set()
    assert imported_by("import process; process.parse") == {"numpy"}


@pytest.mark.parametrize("package", [process, stability, smfe])
def test_a_lazy_package_says_to_all_readers_the_same(package: ModuleType) -> None:
    """The type checker reads the imports, users the list of names, Python the table: each has every name."""
    tree = ast.parse(Path(str(package.__file__)).read_text(encoding="utf-8"))
    (typed,) = (n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    seen = {(i.module, a.name, a.asname or a.name) for i in typed.body for a in i.names}  # type: ignore[attr-defined]
    table = set()
    for module, names in package._HOMES.items():
        for entry in names.split(", "):
            there, _, here = entry.partition(" as ")
            table.add((module, there, here or there))
    assert table == seen
    assert {here for _, _, here in table} | {"__version__"} >= set(package.__all__)
    assert set(package.__all__) <= set(dir(package))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018
