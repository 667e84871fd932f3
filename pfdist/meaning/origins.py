"""Where things come from: the module, and the installed distribution, that a value belongs to."""

import sys
import types
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

import numpy as np

_INSTALLED = {"site-packages", "dist-packages"}  # folders of these names
_SLOTS = (types.WrapperDescriptorType, types.MethodDescriptorType, types.MemberDescriptorType)
"""What Python has in a class for a function or field written in C."""


_COMPILED = ("_ArrayFunctionDispatcher", "cython_function_or_method", "fused_cython_function")
_OF_UFUNCS = ("numpy", "scipy.special")  # which do not know their modules


def home_of(value: Any) -> str | None:
    """Name of the module that a module, class or function belongs to; None of any other value."""
    if isinstance(value, types.ModuleType):
        return value.__name__
    if isinstance(value, types.FunctionType):  # a decorator may copy another's __module__
        return str(value.__globals__.get("__name__"))
    if isinstance(value, types.BuiltinFunctionType):
        owner = value.__self__
        bound = owner is not None and not isinstance(owner, types.ModuleType | type)
        return None if bound else value.__module__ or "builtins"
    if isinstance(value, np.ufunc):
        return next((home for home in _OF_UFUNCS if _has(home, value)), None)
    owner = value.__objclass__ if isinstance(value, _SLOTS) else value
    compiled = type(owner).__name__ in _COMPILED
    return str(owner.__module__) if compiled or isinstance(owner, type) else None


def is_installed(module: str) -> bool:
    """Whether a module is an installed distribution's, and not one that is being developed."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return file is not None and not _INSTALLED.isdisjoint(Path(file).parts)


@cache
def version_of(top: str) -> str:
    """Version of the distribution that installed a top-level module."""
    try:
        return version(top)
    except PackageNotFoundError:
        names = packages_distributions().get(top, [])
        return ", ".join(f"{name} {version(name)}" for name in sorted(names))


def _has(home: str, function: np.ufunc) -> bool:
    return getattr(sys.modules.get(home), function.__name__, None) is function
