"""The origin of a value: the module that defines it, and the installed distribution of a module."""

import sys
import types
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

import numpy as np

_INSTALLED = {"site-packages", "dist-packages"}  # folders with installed distributions
_SLOTS = (types.WrapperDescriptorType, types.MethodDescriptorType, types.MemberDescriptorType)
"""Types by which a class holds functions and fields that are written in C."""


_COMPILED = ("_ArrayFunctionDispatcher", "cython_function_or_method", "fused_cython_function")
_UFUNC_MODULES = ("numpy", "scipy.special")  # a ufunc does not know its module


def home_of(value: Any) -> str | None:
    """Give the name of the module that defines a class or function; None for any other value."""
    if isinstance(value, types.ModuleType):
        return value.__name__
    if isinstance(value, types.FunctionType):  # __module__ may be a decorated function's
        return str(value.__globals__.get("__name__"))
    if isinstance(value, types.BuiltinFunctionType):
        owner = value.__self__
        bound = owner is not None and not isinstance(owner, types.ModuleType | type)
        return None if bound else value.__module__ or "builtins"
    if isinstance(value, np.ufunc):
        return next((home for home in _UFUNC_MODULES if _has(home, value)), None)
    owner = value.__objclass__ if isinstance(value, _SLOTS) else value
    compiled = type(owner).__name__ in _COMPILED
    return str(owner.__module__) if compiled or isinstance(owner, type) else None


def is_installed(module: str) -> bool:
    """Whether a module belongs to an installed distribution, and is not being developed."""
    if module == "__main__":  # a script or notebook, whatever program runs it
        return False
    file = getattr(sys.modules.get(module), "__file__", None)
    return file is not None and not _INSTALLED.isdisjoint(Path(file).parts)


@cache
def version_of(top: str) -> str:
    """Give the version of the distribution that installed a top-level module."""
    try:
        return version(top)
    except PackageNotFoundError:
        names = packages_distributions().get(top, [])
        return ", ".join(f"{name} {version(name)}" for name in sorted(names))


def _has(home: str, function: np.ufunc) -> bool:
    return getattr(sys.modules.get(home), function.__name__, None) is function
