"""Optimal measurement times for particle filtering, computed in parallel."""

import ast
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

__version__ = version("pfdist")
_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_IMPORTS = [each for each in _STUB.body if isinstance(each, ast.ImportFrom)]
_MODULES = {alias.name: each.module for each in _IMPORTS for alias in each.names}
__all__ = list(_MODULES)


def __getattr__(name: str) -> object:
    """A name of the stub, loaded when it is used: a worker does not wait for what it lacks."""
    if name not in _MODULES:
        raise AttributeError(f"module 'pfdist' has no attribute {name!r}")
    module = import_module(f"pfdist.{_MODULES[name] or name}")
    found = globals()[name] = getattr(module, name) if _MODULES[name] else module
    return found


def __dir__() -> list[str]:
    return __all__
