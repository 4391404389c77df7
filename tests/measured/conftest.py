"""Makes `tests/truth`, `tests/accuracy` and `tests/samples` importable as ``truth`` ..., whatever mode and path."""

import sys
import types
from pathlib import Path

for name in ("truth", "accuracy", "samples"):
    package = types.ModuleType(name)
    package.__path__ = [str(Path(__file__).parents[1] / name)]
    sys.modules.setdefault(name, package)
