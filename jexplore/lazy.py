"""Names of a module that are loaded when they are first used: written once, in a stub that type checkers read as well.

A line of the stub is `from jexplore.config import Lidar as Lidar`; `# extra` at its end says that it needs a package
that may be missing.
"""

import importlib
import os
import sys
from collections.abc import Callable
from typing import Any, NamedTuple


class Lazy(NamedTuple):
    """The names that a module takes from its stub: see `read_stub`."""

    module_of: dict[str, str]
    """Name -> module that has it, without the package's name."""
    extras: tuple[str, ...]
    """Those names that need a package that may be missing."""
    get: Callable[[str], Any]
    """The module's `__getattr__`."""


def read_stub(module: str, stub: str) -> Lazy:
    """Read a stub; `module` is the name of the module that is given the names, such as `jexplore`.

    `Lazy.get` raises `AttributeError` for other names, and for those of extras that cannot be loaded.
    """
    with open(os.path.join(os.path.dirname(__file__), stub), encoding="utf-8") as file:
        words = [line.split() for line in file if line.startswith("from jexplore")]
    home = {name: (source, own) for _, source, _, own, _, name, *_ in words}
    extras = tuple(line[5] for line in words if line[6:] == ["#", "extra"])

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        source, own = home[name]
        there = vars(sys.modules[module])
        try:
            found = importlib.import_module(f"{source}.{own}" if source == module else source)
        except ImportError as error:
            if name not in extras:
                raise
            raise AttributeError(f"module {module!r} has no attribute {name!r} here: {error}") from None
        if name not in there:  # a folder is there once it has been imported
            there[name] = getattr(found, own)
        return there[name]

    return Lazy({name: source.removeprefix("jexplore.") for name, (source, _) in home.items()}, extras, get)
