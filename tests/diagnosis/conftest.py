"""Makes `tests/truth` and `tests/exam` importable as ``truth`` and ``exam``, whatever the import mode and the path."""

import sys
import types
from pathlib import Path

for name in ("truth", "exam"):
    package = types.ModuleType(name)
    package.__path__ = [str(Path(__file__).parents[1] / name)]
    sys.modules.setdefault(name, package)
