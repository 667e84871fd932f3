"""What a model means: everything that its formulas reach, each thing with a hash.

Two models of one meaning give the same figures. A function counts by its syntax without docstrings
and comments, a constant by its value, through all of the user's modules and the formulas of other
models. NumPy and the standard library count by the names that are used; another installed
distribution by names and its version; `pfdist` itself has a version and a kernel version in a run's
identity already.
"""

import functools
import hashlib
import itertools
import sys
import types
from collections import deque
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.kernels.content import Content, Names, Parts, UnknownContentError, imports
from pfdist.kernels.fingerprint import bytecode
from pfdist.kernels.formulas import names_in
from pfdist.models import ModelSource, StateSpaceModel
from pfdist.models.beside import own_name
from pfdist.origins import home_of, is_installed, version_of
from pfdist.syntax import syntax_of

Meaning = dict[str, Any]
"""Hashes and parameters by the names of what they belong to: ``transition``, ``helper.f``."""

FORMULAS = (
    "initial", "transition", "measurement", "log_likelihood", "quantity_of_interest", "error",
)  # fmt: skip
_SETTINGS = ("initial_noise", "process_noise", "measurement_noise", "linear_gaussian")
_BY_NAME = sys.stdlib_module_names | {"numpy"}

# With these a function may use more than the names in it say.
_DYNAMIC = {"__dict__", "__import__", "eval", "exec", "getattr", "globals", "import_module", "vars"}
# What Python writes into a class, and what follows from the fields of a dataclass.
_OF_A_CLASS = {
    "__annotate__", "__annotate_func__", "__annotations__", "__annotations_cache__",
    "__dataclass_fields__", "__dataclass_params__", "__dict__", "__doc__", "__firstlineno__",
    "__match_args__", "__module__", "__orig_bases__", "__qualname__", "__static_attributes__",
    "__weakref__", "_abc_impl",
}  # fmt: skip


def meaning_of(model: StateSpaceModel, source: ModelSource) -> Meaning:
    """Give the meaning of a model that was just loaded.

    Parameters
    ----------
    model : StateSpaceModel
    source : ModelSource
        What it was loaded from, with its files.
    """
    walk = _Walk(model, source)
    settings = {name: _digest([repr(getattr(model, name)).encode()]) for name in _SETTINGS}
    data = {f"data_files.{name}": source.sha256[name][:16] for name in model.data_files}
    return {**walk.table(), **settings, **data, **parameters_of(model.p._asdict())}


def parameters_of(values: Mapping[str, float]) -> Meaning:
    """Give parameters as they stand in a meaning."""
    return {f"parameters.{name}": float(value) for name, value in values.items()}


@cache
def loaded_meaning(source: ModelSource) -> Meaning:
    """Give the meaning of the model that `source.load` gives in this process."""
    return meaning_of(source.load(), source)


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Names of what has not the same meaning in two models."""
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))


def check_is_constant(
    here: Mapping[str, Any], there: Mapping[str, Any], path: str, where: str
) -> None:
    """Raise an error if a model that was loaded twice has two meanings.

    Parameters
    ----------
    here, there : mapping
        The meanings of both loads.
    path : str
        Of the model's file.
    where : str
        What is said of it: "each time it is loaded".

    Raises
    ------
    ModelError
        With the first difference by its name.
    """
    found = differences(here, there)
    if found:
        # What a formula is comes of the constants: these first.
        module, _, name = max(found, key=lambda name: "." in name).rpartition(".")
        file = f"{module.replace('.', '/')}.py"
        thing = f"{name} of {file if module not in ('', 'parameters') else Path(path).name}"
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise ModelError(
            f"model.name: {thing} has another value {where}{more}; what formulas use must be the "
            f"same in every process: write the value down, or draw it with a fixed seed ({path})"
        )


class _Walk(Content):
    """A walk from a model's formulas through all that they reach, one entry for each thing."""

    def __init__(self, model: StateSpaceModel, source: ModelSource) -> None:
        super().__init__()
        self._own = source.package.partition(".")[0]
        self._labels: dict[int, str] = {}  # of functions and classes, by their ids
        self._values: dict[str, Any] = {}
        self._todo: deque[str] = deque()
        files = {name: text for name, text in source.sha256.items() if name.endswith(".py")}
        self._files = repr(sorted(files.items())).encode()
        for name in FORMULAS:
            self._enter(name, getattr(model, name))

    def table(self) -> Meaning:
        """Give a hash for everything that is reached."""
        found = {}
        while self._todo:
            label = self._todo.popleft()
            found[label] = self._hash(self._values[label])
        return found

    def _hash(self, value: Any) -> str:
        self.told, self._within = [], []
        try:
            return _digest(self.parts(value))
        except Exception:  # what cannot be told: then all that the user wrote counts
            return _digest([type(value).__name__.encode(), self._files])

    def _enter(self, label: str, value: Any) -> str:
        """Have a value told under a label; give the label that it has."""
        named = isinstance(value, types.FunctionType | type) or hasattr(value, "py_func")
        if named and id(value) in self._labels:
            return self._labels[id(value)]
        label = next(name for name in _numbered(label) if self._is_free(name, value))
        if named:
            self._labels[id(value)] = label
        if label not in self._values:
            self._values[label] = value
            self._todo.append(label)
        return label

    def _is_free(self, label: str, value: Any) -> bool:
        return label not in self._values or self._values[label] is value

    def variable(self, scope: Mapping[str, Any], name: str, names: Names) -> Parts:
        """Give a global variable's label, under which its content stands in the table."""
        home = str(scope.get("__name__"))
        # Which other modules of pfdist are in memory is a matter of the process.
        if name.startswith("__") or (home == "pfdist" and name != "models"):
            return
        value = scope[name]
        yield name.encode()
        if isinstance(value, types.ModuleType) or self.by_name(value) is not None:
            yield from self.parts(value, names)
            return
        function = getattr(value, "py_func", value)
        qualified = getattr(function, "__qualname__", "") if _has_home(function) else ""
        if qualified and "<" not in qualified:
            home, name = str(home_of(function)), qualified
        yield self._enter(f"{own_name(home)}.{name}", value).encode()

    def code(self, function: types.FunctionType) -> Parts:
        """Give a function's syntax, or its bytecode where there is no source."""
        syntax = syntax_of(function)
        if syntax is None:
            yield from bytecode(self, function.__code__)
        else:
            yield syntax
        if _DYNAMIC & names_in(function.__code__) or imports(function.__code__):
            yield self._files
        for name, value in sorted(vars(function).items()):
            if name != "__wrapped__":  # it stands in the closure
                yield name.encode()
                yield from self.parts(value)

    def by_name(self, value: Any) -> str | None:
        """Give the name of what is not the user's."""
        if value is np.random.mtrand._rand:  # its state is nobody's constant
            return "numpy.random"
        home = home_of(value)
        if home is None or own_name(home) != home:
            return None
        top = home.partition(".")[0]
        own = getattr(value, "__qualname__", "") or getattr(value, "__name__", "")
        name = f"{home}.{own}"
        if top in _BY_NAME:
            return name
        if top == "pfdist":
            formulas = home == "pfdist" or home.startswith("pfdist.models")
            return None if formulas and not isinstance(value, type) else name
        if top != self._own and is_installed(home):
            return f"{name} of {top} {version_of(top)}"
        return None

    def other(self, value: Any, names: Names) -> Parts:
        """Give the content of a value of any other kind, by how it would be copied."""
        if type(value) is dict:
            yield from self.entries(list(value.items()), names)
        elif type(value) in (set, frozenset):
            yield from sorted(_digest(self.parts(entry)).encode() for entry in value)
        elif isinstance(value, type):
            yield from self._class_parts(value)
        elif isinstance(value, types.MethodType):
            yield from self.parts((value.__self__, value.__func__))
        elif isinstance(value, property):
            yield from self.parts((value.fget, value.fset, value.fdel))
        elif isinstance(value, functools.cached_property):
            yield from self.parts(value.func)
        elif isinstance(value, staticmethod | classmethod) or hasattr(value, "__wrapped__"):
            yield from self.parts(value.__wrapped__)
        elif isinstance(function := _python_function(value), types.FunctionType):
            yield from self.parts(function)
        else:
            copied = value.__reduce_ex__(4)
            if isinstance(copied, str):
                raise UnknownContentError(repr(value))
            made_by, arguments, *rest = copied
            state, entries, items = (*rest, None, None, None)[:3]
            yield from self.parts((made_by, arguments, state), names)
            yield from self.parts((list(entries or ()), list(items or ())), names)

    def _class_parts(self, kind: type) -> Parts:
        fields = getattr(kind, "__dataclass_fields__", {})
        yield from self.parts(kind.__bases__)
        for name, field in fields.items():
            yield name.encode()
            yield from self.parts((field.default, field.default_factory))
        generated = bool(fields) or hasattr(kind, "_fields")
        for name, value in sorted(vars(kind).items()):
            if name in _OF_A_CLASS or isinstance(value, types.GetSetDescriptorType):
                continue
            made = isinstance(value, types.FunctionType) and syntax_of(value) is None
            if not (generated and made and name.startswith("__")):
                yield name.encode()
                yield from self.parts(value)


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()


def _numbered(label: str) -> Iterable[str]:
    yield label
    for number in itertools.count(2):
        yield f"{label}#{number}"


def _has_home(value: Any) -> bool:
    return isinstance(value, types.FunctionType | type)


def _python_function(value: Any) -> Any:
    """The function that Numba's compiled ones were made of; None of any other value."""
    return getattr(value, "py_func", None) or getattr(
        getattr(value, "_dispatcher", None), "py_func", None
    )
