"""Modules whose names are those of a stub beside them, each loaded when it is used."""

import ast
from collections.abc import Callable, MutableMapping
from importlib import import_module
from pathlib import Path
from typing import Any


def names_of_stub(space: MutableMapping[str, Any]) -> tuple[Callable[[str], object], list[str]]:
    """The ``__getattr__`` and the ``__all__`` of a module, from its globals and its stub.

    The stub imports each name from a module below the package of the module.
    """
    stub = ast.parse(Path(space["__file__"]).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [each for each in stub.body if isinstance(each, ast.ImportFrom)]
    modules = {
        alias.name: (f"{'.' * each.level}{each.module or ''}", not each.module)
        for each in imports
        for alias in each.names
    }

    def load(name: str) -> object:
        """A name of the stub, loaded when it is used: a worker does not wait for what it lacks."""
        if name not in modules:
            raise AttributeError(f"module {space['__name__']!r} has no attribute {name!r}")
        place, is_module = modules[name]
        if is_module:
            found = import_module(f"{place}{name}", space["__package__"])
        else:
            found = getattr(import_module(place, space["__package__"]), name)
        space[name] = found
        return found

    return load, [*modules]
