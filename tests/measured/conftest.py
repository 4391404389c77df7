"""Makes `tests/truth` and `tests/accuracy` importable as ``truth`` and ``accuracy``, whatever mode and path."""

import sys
import types
from pathlib import Path

for name in ("truth", "accuracy"):
    package = types.ModuleType(name)
    package.__path__ = [str(Path(__file__).parents[1] / name)]
    sys.modules.setdefault(name, package)
