"""Ctrl-C: one line that says how to go on, status 130, no traceback, no half-written file, no process left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from samples.campaigns import HAMMER

SLOW = """
import sys, time
from pathlib import Path
import smfe
from smfe.results import write_atomically

def run(campaign, folder, fresh, progress, *_):
    def write(path):
        path.write_text("half")
        print("ready", file=sys.stderr, flush=True)
        for _ in range(10 * 60):
            time.sleep(0.1)  # a signal just before a long one would wait for its end
    progress("working", 0, 1)
    write_atomically(Path(folder) / "report.html", write)

smfe.run = run
from smfe.cli import app_entry
sys.argv = ["smfe", *sys.argv[1:]]
app_entry()
"""
"""The command line with a run that writes for a minute: what is tested is how it ends."""


def interrupted(
    words: list[str], code: str, ready: str, folder: Path, group: list[int] | None = None
) -> tuple[int, str, str]:
    """Start the command line in a group of its own, press Ctrl-C as a terminal does, and return how it ends."""
    with subprocess.Popen(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell without a terminal starts what runs in the background with the signal ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        assert process.stderr is not None
        if group is not None:
            group.append(process.pid)
        said = ""
        while ready not in said:
            line = process.stderr.readline()
            assert line, said
            said += line
        os.killpg(process.pid, signal.SIGINT)
        out, rest = process.communicate(timeout=60)
    return process.returncode, out, said + rest


@pytest.mark.skipif(sys.platform == "win32", reason="no signals of a terminal")
@pytest.mark.parametrize("options", [[], ["--json"]])
def test_ctrl_c_says_how_to_go_on_and_leaves_nothing_half_written(options: list[str], tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(HAMMER)
    code, out, err = interrupted(["run", "campaign.toml", *options], SLOW, "ready", tmp_path)
    assert code == 130, err
    assert "Traceback" not in err
    assert err.count("interrupted") == 1
    (line,) = [text for text in err.splitlines() if "interrupted" in text]
    assert "kept" in line
    assert "the same command goes on" in line
    assert not [p for p in tmp_path.rglob("*") if p.name not in ("campaign.toml", "results")]
    assert ("error" in out) == bool(options)


DROPPED = """
import ctypes, sys, time
import smfe

def wait():
    print("ready", file=sys.stderr, flush=True)
    for _ in range(10 * 30):
        time.sleep(0.1)  # a signal just before a long one would wait for its end

def run(campaign, folder, fresh, progress, *_):
    if campaign.removesuffix(".toml") == "in_a_callback":
        ctypes.CFUNCTYPE(None)(wait)()
    else:
        try:
            wait()
        except BaseException:
            pass
        progress("next step", 1, 2)
    for _ in range(10 * 30):
        time.sleep(0.1)  # a signal just before a long one would wait for its end

smfe.run = run
from smfe.cli import app_entry
sys.argv = ["smfe", *sys.argv[1:]]
app_entry()
"""
"""The command line with a run that drops the first Ctrl-C, as a compiler's callback does, and works on."""


@pytest.mark.skipif(sys.platform == "win32", reason="no signals of a terminal")
@pytest.mark.parametrize("where", ["in_a_callback", "in_a_library"])
def test_a_ctrl_c_that_a_library_drops_is_not_lost(where: str, tmp_path: Path) -> None:
    (tmp_path / f"{where}.toml").write_text(HAMMER)
    code, _, err = interrupted(["run", f"{where}.toml"], DROPPED, "ready", tmp_path)
    assert code == 130, err
    assert err.count("interrupted") == 1
    assert "Traceback" not in err


EARLY = """
import sys, time
import smfe.cli
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            print("ready", file=sys.stderr, flush=True)
            for _ in range(10 * 60):
                time.sleep(0.1)  # a signal just before a long one would wait for its end
sys.meta_path.insert(0, Slow())
smfe.cli.app_entry()
"""
"""The command line while its own libraries are imported."""


@pytest.mark.skipif(sys.platform == "win32", reason="no signals of a terminal")
def test_ctrl_c_before_a_verb_begins_is_a_line_as_well(tmp_path: Path) -> None:
    code, _, err = interrupted(["--help"], EARLY, "ready", tmp_path)
    assert (code, err.splitlines()[-1]) == (130, "smfe: interrupted")
    assert "Traceback" not in err


HELPED = """
import sys, time
import numpy as np
import smfe
from smfe.diagnosis.inference.workers import Helpers

def ask(number, values):
    print("ready", file=sys.stderr, flush=True)
    for _ in range(10 * 60):
        time.sleep(0.1)  # a signal just before a long one would wait for its end

def run(campaign, folder, fresh, progress, *_):
    with Helpers(2) as helpers:
        helpers.answers(ask, [(0, np.zeros(1)), (1, np.ones(1))])

smfe.run = run
from smfe.cli import app_entry
sys.argv = ["smfe", *sys.argv[1:]]
app_entry()
"""
"""The command line with a run whose predictions are made by two processes for a minute."""


def alive(group: int) -> bool:
    """Return whether a process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="workers are processes on Linux alone")
def test_workers_end_with_the_command(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(HAMMER)
    group: list[int] = []
    code, _, err = interrupted(["run", "campaign.toml"], HELPED, "ready", tmp_path, group)
    assert code == 130, err
    assert "Traceback" not in err
    for _ in range(50):
        if not alive(group[0]):
            break
        time.sleep(0.1)
    assert not alive(group[0])
