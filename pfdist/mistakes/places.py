"""Finds the line of a model's source from which an error came."""

import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numba
import numpy as np

_PACKAGE = Path(__file__).parents[1]
_STANDARD_LIBRARY = Path(sysconfig.get_path("stdlib"))
_NOT_MODELS = (
    "__init__.py",
    "base.py",
    "beside.py",
    "loader.py",
    "parameters.py",
    "trial_calls.py",
)


def frames_of(error: BaseException) -> Iterator[tuple[FrameType, int]]:
    """Frames and lines of an error's traceback in a model's source, the outermost first."""
    trace = error.__traceback__
    while trace is not None:
        if is_a_models(trace.tb_frame.f_code.co_filename):
            yield trace.tb_frame, trace.tb_lineno
        trace = trace.tb_next


def place_of(error: BaseException) -> str:
    """Give an error's innermost place in a model as `` (file:line)``; empty if there is none."""
    places = [f" ({frame.f_code.co_filename}:{line})" for frame, line in frames_of(error)]
    return places[-1] if places else ""


def place_of_function(function: Any) -> str:
    """Give the place where a function is defined, as `` (file:line)``; empty without a source."""
    code = getattr(function, "__code__", None)
    return f" ({code.co_filename}:{code.co_firstlineno})" if code else ""


def is_a_models(file: str) -> bool:
    """Whether a source file belongs to a model: neither to pfdist nor to a library."""
    path = Path(file)
    if file.startswith("<"):
        return False
    if path.is_relative_to(_PACKAGE):
        return path.parent.name == "models" and path.name not in _NOT_MODELS
    if path.is_relative_to(_STANDARD_LIBRARY):
        return "site-packages" in path.parts and not any(map(path.is_relative_to, _LIBRARIES))
    return not any(map(path.is_relative_to, _LIBRARIES))


_LIBRARIES = [Path(str(package.__file__)).parent for package in (numba, np)]
