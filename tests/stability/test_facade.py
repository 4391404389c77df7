"""The package's face: what it exports, and what it says when a user's own file shadows `process`."""

import os
import subprocess
import sys
from pathlib import Path

import stability

ROOT = Path(stability.__file__).parents[1]


def run_in(folder, code="import stability"):
    """Run Python in a folder, the folder itself first on the path as for a user's script."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_everything_exported_is_there():
    assert set(stability.__all__) <= set(dir(stability))
    for name in stability.__all__:
        assert getattr(stability, name).__doc__ or name.isupper()


def test_a_users_process_py_is_named_and_not_run(tmp_path):
    (tmp_path / "process.py").write_text("print('side effect')\nraise RuntimeError('a script of the user')\n")
    result = run_in(tmp_path)
    assert result.returncode == 1
    assert f"ImportError: 'import process' finds {tmp_path / 'process.py'}" in result.stderr
    assert "rename that file" in result.stderr
    assert "side effect" not in result.stdout


def test_a_foreign_package_is_named(tmp_path):
    (tmp_path / "process").mkdir()
    (tmp_path / "process" / "__init__.py").write_text("")
    result = run_in(tmp_path)
    assert f"finds {tmp_path / 'process' / '__init__.py'}" in result.stderr


def test_a_foreign_module_already_loaded_is_named(tmp_path):
    code = "import sys, types; sys.modules['process'] = types.ModuleType('process'); import stability"
    assert "a foreign module named 'process' is loaded" in run_in(tmp_path, code).stderr


def test_our_own_passes_and_draws_nothing(tmp_path):
    code = "import stability, sys; print('matplotlib' in sys.modules, 'smfe' in sys.modules)"
    result = run_in(tmp_path, code)
    assert (result.returncode, result.stdout.split()) == (0, ["False", "False"])
