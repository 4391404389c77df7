"""Public names of a package that are imported when they are first used: ``import smfe`` costs no numerics."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping


def lazy(
    package: str, homes: Mapping[str, str], companions: Mapping[str, str] | None = None
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package (PEP 562).

    Parameters
    ----------
    package : str
        Name of the package.
    homes : mapping of str to str
        Module -> the names that it gives to the package, "one, two, three as public_name".
    companions : mapping of str to str, optional
        Library -> module of ours that extends it, imported once a public name has imported the library.
    """
    sources: dict[str, tuple[str, str]] = {}
    for module, names in homes.items():
        for entry in names.split(", "):
            there, _, here = entry.partition(" as ")
            sources[here or there] = (module, there)

    def get(name: str) -> object:
        if name not in sources:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, attribute = sources[name]
        value = getattr(importlib.import_module(module), attribute)
        setattr(sys.modules[package], name, value)
        for library, module in (companions or {}).items():
            if library in sys.modules:
                importlib.import_module(module)
        return value

    def public() -> list[str]:
        return sorted({*vars(sys.modules[package]), *sources})

    return get, public
