"""A model that was given as an object in Python, as it travels to the workers: by value.

The object's formulas may lie in a notebook, in a script or in a module beside it, which no worker
can import. So their code travels with all that they use from modules that are not installed. The
driver uses what travels, too: what cannot travel is found before any worker has a task.
"""

import io
import pickle
import sys
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cache
from inspect import getclosurevars
from typing import Any

import cloudpickle

from pfdist.errors import ModelError
from pfdist.jitted import names_in, reached
from pfdist.kernels.uses import imports_in
from pfdist.meaning.origins import is_installed
from pfdist.models import PYTHON, StateSpaceModel
from pfdist.models.beside import own_name

_BY_NAME = sys.stdlib_module_names | {"pfdist"}


@dataclass(frozen=True)
class ModelValue:
    """A model by value; it has the attributes of a `pfdist.models.ModelSource` that others read.

    Parameters
    ----------
    name : str
        The name in the job: "python:" and the name of the model.
    content : bytes
        The fields of the model, pickled. They are sent to workers, and never stored.
    """

    name: str
    content: bytes = field(repr=False)

    package = ""  # the model belongs to the user

    @property
    def path(self) -> str:
        """The name, in the place of a file."""
        return self.name

    @property
    def sha256(self) -> dict[str, str]:
        """No file is known: the content of data files travels in the constants of formulas."""
        return {}

    def load(self) -> StateSpaceModel:
        """Make the model. The same content gives the same object.

        Raises
        ------
        ModelError
            It cannot be made from what travels.
        """
        try:
            return _made(self.content)
        except ModelError:
            raise
        except Exception as error:  # an object of the user may raise any exception
            raise ModelError(
                f"{self.name} cannot be made again from what travels to the workers: {_told(error)}"
            ) from error


def value_of(model: StateSpaceModel) -> ModelValue:
    """Give a model by value.

    Raises
    ------
    ModelError
        A formula uses an object that cannot be sent to workers, or imports a module of the user.
    """
    everything = reached(*model.formulas.values())
    functions = [value for value in everything if isinstance(value, types.FunctionType)]
    for function in functions:
        _check_imports(model, function)
    names = frozenset().union(*(names_in(function.__code__) for function in functions))
    about = {each.name: getattr(model, each.name) for each in fields(model)}
    plain = {name: dict(value) for name, value in about.items() if isinstance(value, Mapping)}
    with _sent_by_value():
        for name, formula in model.formulas.items():
            if reason := _refusal(formula, names):
                raise ModelError(
                    f"model {model.name}: {_blamed(formula, names, name)}, which cannot be sent to "
                    f"workers: {reason}; formulas may use numbers, text, arrays, functions, or "
                    "objects made of these"
                )
        value = ModelValue(f"{PYTHON}{model.name}", _pickled(about | plain, names))
    value.load()
    return value


@cache
def _made(content: bytes) -> StateSpaceModel:
    return StateSpaceModel(**pickle.loads(content))  # noqa: S301  the driver made it


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc,unused-ignore]
    """Pickles a module of the user as far as formulas name its variables.

    Parameters
    ----------
    file : BytesIO
    names : set of str
        Names in the formulas, and in all functions that they reach.
    """

    def __init__(self, file: io.BytesIO, names: frozenset[str]) -> None:
        super().__init__(file)
        self._names = names

    def reducer_override(self, value: Any) -> Any:
        if not isinstance(value, types.ModuleType) or not _is_users(value.__name__):
            return super().reducer_override(value)
        used = {name: each for name, each in vars(value).items() if name in self._names}
        return types.ModuleType, (own_name(value.__name__),), used


def _pickled(value: Any, names: frozenset[str]) -> bytes:
    file = io.BytesIO()
    _Pickler(file, names).dump(value)
    return file.getvalue()


@contextmanager
def _sent_by_value() -> Iterator[None]:
    """Have functions and classes of the user's modules pickled by value, not by their names."""
    known = cloudpickle.list_registry_pickle_by_value()
    modules = [
        module
        for name, module in list(sys.modules.items())
        if isinstance(module, types.ModuleType)
        and module.__name__ == name
        and name not in known
        and _is_users(name)
    ]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def _is_users(module: str) -> bool:
    """Whether a module is the user's own: no worker may be able to import it."""
    top = module.partition(".")[0]
    return top not in _BY_NAME and not is_installed(top) and not is_installed(module)


def _refusal(value: Any, names: frozenset[str]) -> str:
    """Say why a value cannot be pickled; empty if it can."""
    try:
        _pickled(value, names)
    except Exception as error:  # an object of the user may raise any exception
        return _told(error)
    return ""


def _blamed(formula: Callable[..., Any], names: frozenset[str], where: str) -> str:
    """Name the variable that cannot be pickled, and how a formula reaches it."""
    waiting, met = list[tuple[str, Any]]([(where, formula)]), set[int]()
    for place, value in waiting:  # the list grows
        for name, each in _variables(value, names).items():
            if id(each) in met or not _refusal(each, names):
                continue
            if not isinstance(each, types.FunctionType | types.ModuleType):
                return f"{place} uses {name}, an object of the type {type(each).__qualname__!r}"
            met.add(id(each))
            waiting.append((f"{place} uses {name}, which", each))
    return f"{where} holds an object"


def _variables(value: Any, names: frozenset[str]) -> dict[str, Any]:
    """The variables that a function uses, or those of a module that formulas name."""
    if isinstance(value, types.ModuleType):
        return {name: each for name, each in vars(value).items() if name in names}
    used = getclosurevars(value)
    return {**used.nonlocals, **used.globals}


def _check_imports(model: StateSpaceModel, function: types.FunctionType) -> None:
    for statement in imports_in(function.__code__):
        top = statement.name.partition(".")[0]
        if statement.level or (top in sys.modules and _is_users(top)):
            raise ModelError(
                f"model {model.name}: {function.__qualname__} imports {statement.name} when it is "
                "called, which workers cannot: import the module outside the function"
            )


def _told(error: Exception) -> str:
    return (f"{type(error).__name__}: {error}".splitlines() or [""])[0][:200]
