"""The loader of models: finds a model by its name, and imports its file.

A name is that of a built-in model, of an installed entry point of the group ``pfdist.models``, or
``path/file.py:object``.
"""

import ast
import contextlib
import dataclasses
import hashlib
import importlib
import importlib.util
import pkgutil
import sys
import threading
import types
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, NamedTuple

from pfdist.common.arguments import address_fault
from pfdist.common.nearest import did_you_mean, must_be
from pfdist.common.parsing import read_text
from pfdist.errors import ModelError, shown
from pfdist.models.base import StateSpaceModel
from pfdist.models.mistakes import error_line, is_interrupt, place_of

PYTHON: Final = "python:"
"""The beginning of a model's name in a job if the model was given as a Python object."""
_GROUP = "pfdist.models"
_LIBRARY = "pfdist.models.library"
_FIRST = sys.stdlib_module_names | {"numpy", "pfdist"}
"""Modules that a file beside a model must not hide."""
_OWN = Path(__file__).parents[1]  # may lie below the model's folder, as in a clone beside it
_importing = threading.RLock()  # the path and the table of modules belong to all threads


class NamedModel(NamedTuple):
    """A model given as a Python object, with its name in a job."""

    name: str
    model: StateSpaceModel


def load_model(name: str, folder: Path = Path()) -> StateSpaceModel:
    """The model with this name.

    Parameters
    ----------
    name : str
        A built-in model, an installed entry point of the group ``pfdist.models``, or
        ``path/file.py:object``.
    folder : Path
        Folder to which a path in the name is relative. By default the working folder.

    Returns
    -------
    StateSpaceModel

    Raises
    ------
    ModelError
        There is no such model, or it cannot be loaded.
    """
    home, attribute = _located(name, folder)
    if isinstance(home, Path):
        return _model_of(_imported(home), attribute, home)
    with _errors_in_one_line(f"importing the module {home!r} of the model {name!r} failed"):
        module = importlib.import_module(home)
    return _model_of(module, attribute, Path(module.__file__ or home))


def check_name(name: str) -> None:
    """Raise `ModelError` if no model or file has this name; the file is not imported."""
    _located(name, Path())


def installed_name(model: StateSpaceModel) -> str | None:
    """The name of the installed model that has the same formulas as an object; else None."""
    home, attribute = installed_models().get(model.name, ("", ""))
    other = getattr(importlib.import_module(home), attribute, None) if home else None
    if not isinstance(other, StateSpaceModel) or other.parameters.keys() != model.parameters.keys():
        return None
    same = dataclasses.replace(other, parameters=model.parameters) == model
    return model.name if same else None


@cache
def installed_models() -> Mapping[str, tuple[str, str]]:
    """Module and attribute of every built-in model and entry point, by name."""
    shipped = {
        module.name: (f"{_LIBRARY}.{module.name}", "model")
        for module in pkgutil.iter_modules(importlib.import_module(_LIBRARY).__path__)
    }
    plugged = {entry.name: (entry.module, entry.attr) for entry in entry_points(group=_GROUP)}
    return plugged | shipped


def _located(name: str, folder: Path) -> tuple[Path | str, str]:
    """The file or the installed module of a model, and the model's name in it."""
    if not isinstance(name, str):
        raise ModelError(f"the name of a model must be a text, got {shown(name)}")
    if name.startswith(PYTHON):
        raise ModelError(
            f"the model {name!r} was given as an object in Python, and no file holds it: give the "
            "folder of its run, or resume in Python, as in pfdist.run(problem)"
        )
    if fault := address_fault(name):
        raise ModelError(f"the model {fault}")
    if ".py:" in name:
        path, _, attribute = name.rpartition(":")
        return _readable((folder / path).absolute(), name), attribute
    if name.endswith(".py"):
        raise ModelError(f"a model in a file must be FILE:NAME, as {name}:model, got {shown(name)}")
    if name.endswith(".toml"):
        raise ModelError(
            f"a model must be a name or FILE.py:NAME, got the job file {shown(name)}: give the "
            "name of its model; pfdist.Filter and pfdist.Planner take a job"
        )
    installed = installed_models()
    if name not in installed:
        rule = f"one of {', '.join(sorted(installed))} or 'path/file.py:object'"
        raise ModelError(must_be("the model", rule, name, installed))
    return installed[name]


def _readable(file: Path, name: str) -> Path:
    """A model's file, after a check that it can be read and hides no module that it imports."""
    try:
        text = read_text(file)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ModelError(f"cannot read {file}: {reason} (got {name!r})") from error
    with contextlib.suppress(SyntaxError, ValueError):  # the import says what is wrong
        for module in _imported_by(text) & _FIRST:
            if (hides := file.with_name(f"{module}.py")).exists():
                raise ModelError(
                    f"{file} imports {module}, and {hides} hides the module of this name: rename "
                    "the file"
                )
    return file


def _imported_by(text: str) -> set[str]:
    """The top-level modules that a source imports; SyntaxError or ValueError if it is no source."""
    modules = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            modules.add(node.module.partition(".")[0])
    return modules


def _imported(file: Path) -> types.ModuleType:
    """Import a model's file by Python's own import system, under a name of its own.

    Python finds the modules beside it while it is imported. Then they leave Python's table of
    modules: two models may both have a ``helper``.
    """
    folder = file.resolve().parent
    own = f"pfdist_model_{hashlib.sha256(bytes(file.resolve())).hexdigest()[:16]}"
    spec = importlib.util.spec_from_file_location(own, file)
    if spec is None or spec.loader is None:
        raise ModelError(f"{file} must be a Python file")
    module = importlib.util.module_from_spec(spec)
    with _importing, _errors_in_one_line(f"loading {file} failed"), _beside(folder):
        sys.modules[own] = module
        try:
            spec.loader.exec_module(module)
        finally:
            del sys.modules[own]
    return module


@contextlib.contextmanager
def _beside(folder: Path) -> Iterator[None]:
    """Let Python find the modules of a folder before all others, and forget them again."""
    modules = {file.stem for file in folder.glob("*.py")} - {"__main__"}
    packages = {file.parent.name for file in folder.glob("*/__init__.py")}
    folders = {entry.name for entry in folder.iterdir() if entry.is_dir()}
    hidden = (modules | folders) & _FIRST
    aside = {
        name: module
        for name, module in list(sys.modules.items())
        if (top := name.partition(".")[0]) in (modules | packages) - hidden
        or (top in folders - hidden and not _is_installed(module))
    }
    # Modules of the same names from elsewhere are set aside, and come back at the end. Modules of
    # this folder leave the table, so the next model imports its own.
    path_before, writes_before = sys.path.copy(), sys.dont_write_bytecode
    for name in aside:
        del sys.modules[name]
    names_before = set(sys.modules)
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True  # bytecode a second old would hide an edit
    importlib.invalidate_caches()
    try:
        yield
        for name in sorted(set(sys.modules) - names_before):
            if name.partition(".")[0] in hidden and _lies_in(sys.modules[name], folder):
                raise ModelError(
                    f"{sys.modules[name].__file__} hides the module {name!r} of the same name: "
                    "rename the file"
                )
    finally:
        sys.path[:], sys.dont_write_bytecode = path_before, writes_before
        for name in set(sys.modules) - names_before:
            if _lies_in(sys.modules[name], folder):
                del sys.modules[name]
        sys.modules.update(aside)


def _lies_in(module: types.ModuleType, folder: Path) -> bool:
    file = vars(module).get("__file__") or next(iter(getattr(module, "__path__", ())), None)
    return file is not None and Path(file).is_relative_to(folder) and not _is_installed(module)


def _is_installed(module: types.ModuleType) -> bool:
    file = getattr(module, "__file__", None)
    if file is None:
        return False
    installed = {"site-packages", "dist-packages"}
    return Path(file).is_relative_to(_OWN) or not installed.isdisjoint(Path(file).parts)


@contextlib.contextmanager
def _errors_in_one_line(fails: str) -> Iterator[None]:
    """Turn what a model's code raises into one line."""
    try:
        yield
    except ModelError:
        raise
    except BaseException as error:  # a model may raise any exception
        if is_interrupt(error):
            raise
        relative = "attempted relative import" in error_line(error)
        remedy = "; write `import helper` instead of `from . import helper`" if relative else ""
        raise ModelError(f"{fails}: {error_line(error)}{remedy}{place_of(error)}") from error


def _model_of(module: types.ModuleType, attribute: str, file: Path) -> StateSpaceModel:
    model = vars(module).get(attribute)
    if not isinstance(model, StateSpaceModel):
        models = [
            name for name, value in vars(module).items() if isinstance(value, StateSpaceModel)
        ]
        raise ModelError(
            f"{file} must contain a StateSpaceModel named {attribute!r}, "
            f"got {'nothing' if model is None else type(model).__name__} of that name"
            f"{did_you_mean(attribute, models) or '.'} Models in this file: "
            f"{', '.join(models) or 'none'}"
        )
    return model
