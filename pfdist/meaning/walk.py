"""The walk from a model's formulas to everything that they reach, with a hash for each thing."""

import functools
import hashlib
import itertools
import sys
import types
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from pfdist.common.syntax import syntax_of
from pfdist.kernels.content import Content, Parts, UnknownContentError
from pfdist.kernels.fingerprint import bytecode
from pfdist.kernels.uses import Import, Uses, imports_in, uses_in
from pfdist.meaning.model_value import ModelValue
from pfdist.meaning.origins import home_of, is_installed, version_of
from pfdist.meaning.values import UntoldValueError, copy_of, python_function
from pfdist.models import ModelSource
from pfdist.models.beside import own_name

_BY_NAME = sys.stdlib_module_names | {"numpy"}

# With these names a function may use objects that it does not name, or read text as data.
_DYNAMIC = {
    "__annotations__", "__dict__", "__doc__", "__import__", "eval", "exec", "getattr", "globals",
    "import_module", "vars",
}  # fmt: skip
# With these names a function may use every variable of its module.
_WHOLE_MODULE = {"eval", "exec", "globals"}
# Variables that Python adds to a module.
_OF_A_MODULE = {
    "__annotate__", "__annotations__", "__builtins__", "__cached__", "__conditional_annotations__",
    "__doc__", "__file__", "__loader__", "__name__", "__package__", "__path__", "__spec__",
    "__warningregistry__",
}  # fmt: skip
# Attributes that Python adds to a class, or that follow from the fields of a dataclass.
_OF_A_CLASS = {
    "__annotate__", "__annotate_func__", "__annotations__", "__annotations_cache__",
    "__dataclass_fields__", "__dataclass_params__", "__dict__", "__doc__", "__firstlineno__",
    "__match_args__", "__module__", "__orig_bases__", "__qualname__", "__static_attributes__",
    "__weakref__", "_abc_impl",
}  # fmt: skip


class Walk(Content):
    """A walk from a model's formulas to everything that they reach.

    Parameters
    ----------
    functions : mapping of str to callable
        The formulas by their names.
    source : ModelSource or ModelValue
        The source of the model, with its files.
    main : str, optional
        A module whose variables have labels as those of a script, wherever they are defined.
    """

    def __init__(
        self, functions: Mapping[str, Any], source: ModelSource | ModelValue, main: str = ""
    ) -> None:
        super().__init__()
        self._main = main
        self._own = source.package.partition(".")[0]
        self._labels: dict[int, str] = {}  # labels of functions and classes, by their ids
        self._values: dict[str, Any] = {}
        self._todo: deque[str] = deque()
        files = {name: text for name, text in source.sha256.items() if name.endswith(".py")}
        self._files, self._has_files = repr(sorted(files.items())).encode(), bool(files)
        for name, function in functions.items():
            self._enter(name, function)

    def table(self) -> dict[str, str]:
        """Give a hash for every function, class and constant that is reached, by its label.

        Raises
        ------
        UntoldValueError
            The content of a value cannot be read.
        """
        found = {}
        while self._todo:
            label = self._todo.popleft()
            found[label] = self._hash(label)
        return found

    def _hash(self, label: str) -> str:
        self.told, self._within = [], []
        try:
            return digest(self.parts(self._values[label]))
        except UnknownContentError as error:
            raise UntoldValueError(label, str(error)) from error
        except RecursionError as error:
            raise UntoldValueError(label, "something that is nested too deeply") from error
        except Exception as error:  # an object of the user may raise any exception
            reason = f"{type(error).__name__}: {error}".splitlines()[0][:80]
            raise UntoldValueError(label, f"something that fails ({reason})") from error

    def _enter(self, label: str, value: Any) -> str:
        """Add a value to the table, and give its label: a known function keeps its old label."""
        named = isinstance(value, types.FunctionType | type) or python_function(value) is not None
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

    def variable(self, scope: Mapping[str, Any], name: str, uses: Uses | None) -> Parts:
        """Give the label of a global variable. The table has the variable's content there."""
        home = str(scope.get("__name__"))
        # The other modules of pfdist that are in memory differ between processes.
        if name in _OF_A_MODULE or (home == "pfdist" and name != "models"):
            return
        value = scope[name]
        yield name.encode()
        made = self._is_made_for_the_user(value)
        if isinstance(value, types.ModuleType) or (not made and self.by_name(value) is not None):
            yield from self.parts(value, uses)
            return
        function = None if made else getattr(value, "py_func", value)
        qualified = getattr(function, "__qualname__", "") if _has_home(function) else ""
        if qualified and "<" not in qualified:
            home, name = str(home_of(function)), qualified
        module = "__main__" if home == self._main else own_name(home)
        yield self._enter(f"{module}.{name}", value).encode()

    def cell(self, cell: types.CellType, uses: Uses | None = None) -> Parts:
        """Give the content of a variable in a closure. It may have no value yet."""
        try:
            value = cell.cell_contents
        except ValueError:
            yield b"empty"
        else:
            yield from self.parts(value, uses)

    def code(self, function: types.FunctionType) -> Parts:
        """Give the syntax of a function, or its bytecode if it has no source, and its imports."""
        syntax = syntax_of(function)
        if syntax is None:
            yield from bytecode(self, function.__code__)
        else:
            yield syntax
        named = uses_in(function.__code__).named
        if _DYNAMIC & named:
            yield self._files
        if _WHOLE_MODULE & named or (_DYNAMIC & named and not self._has_files):
            for name in sorted(function.__globals__):
                yield from self.variable(function.__globals__, name, None)
        for statement in imports_in(function.__code__):
            yield from self._imported(function, statement)
        for name, value in sorted(vars(function).items()):
            if name != "__wrapped__":  # the closure has it, too
                yield name.encode()
                yield from self.parts(value)

    def _imported(self, function: types.FunctionType, statement: Import) -> Parts:
        """Give the content of a module that a function imports when it is called."""
        name, level, names, variables = statement
        load = function.__builtins__["__import__"]  # type: ignore[attr-defined,unused-ignore]
        try:
            module = load(name, function.__globals__, None, names, level)
        except Exception as error:  # the function raises this error, too, when it is called
            yield type(error).__name__.encode()
            return
        uses = uses_in(function.__code__)
        if not variables & uses.loose:
            yield from self.parts(module, uses.through(name))
        elif names:  # some of these names may be modules that the function passes on
            yield from self.parts(module, Uses(uses.named, uses.loose.union(names)))
        else:
            yield from self.parts(module)

    def by_name(self, value: Any) -> str | None:
        """Give the name of a value that is not the user's; None for a value of the user."""
        if value is np.random.mtrand._rand:  # its state changes with every draw
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

    def parts(self, value: Any, uses: Uses | None = None) -> Parts:
        """Give the content of a value, with the closure of a function that a decorator made."""
        yield from super().parts(value, uses)
        if self._is_made_for_the_user(value) and value not in self.told:
            self.told.append(value)
            for cell in value.__closure__:
                yield from self.cell(cell)

    def _is_made_for_the_user(self, value: Any) -> bool:
        """Whether foreign code, such as a decorator, made a function that may hold user objects."""
        if not isinstance(value, types.FunctionType) or not value.__closure__:
            return False
        author, wrapped = str(home_of(value)), str(value.__module__)
        is_wrapper = author.partition(".")[0] != wrapped.partition(".")[0]
        is_made = is_wrapper or "<locals>" in value.__qualname__
        return is_made and self.by_name(value) is not None

    def dispatcher(self, function: CPUDispatcher) -> Parts:
        """Give the content of a function that its author compiled, with the fixed types."""
        yield from super().dispatcher(function)
        if function.locals or not function._can_compile:
            yield repr(sorted(function.locals.items())).encode()
            fixed = [] if function._can_compile else function.nopython_signatures
            yield repr([str(signature) for signature in fixed]).encode()

    def other(self, value: Any) -> Parts:
        """Give the content of a value of any other kind, as Python would copy it."""
        if type(value) is dict:
            yield from self.entries(list(value.items()))
        elif type(value) in (set, frozenset):
            yield from sorted(digest(self.parts(entry)).encode() for entry in value)
        elif isinstance(value, type):
            yield from self._class_parts(value)
        elif isinstance(value, types.MethodType):
            yield from self.parts((value.__self__, value.__func__))
        elif isinstance(value, property):
            yield from self.parts((value.fget, value.fset, value.fdel))
        elif isinstance(value, functools.cached_property):
            yield from self.parts(value.func)
        elif isinstance(value, staticmethod | classmethod | functools._lru_cache_wrapper):
            yield from self.parts(value.__wrapped__)
        elif (function := python_function(value)) is not None:
            yield from self.parts(function)
        else:
            made_by, arguments, state, entries, items = copy_of(value)
            yield from self.parts((made_by, arguments, state))
            yield from self.parts((entries, items))

    def _class_parts(self, kind: type) -> Parts:
        fields = getattr(kind, "__dataclass_fields__", {})
        yield from self.parts(kind.__bases__)
        if self.by_name(type(kind)) is None:
            yield from self.parts(type(kind))
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


def digest(parts: Iterable[bytes]) -> str:
    """Give the hash of a content's parts."""
    hashed = hashlib.blake2b(digest_size=8)
    for part in parts:
        hashed.update(len(part).to_bytes(8, "little") + part)
    return hashed.hexdigest()


def _numbered(label: str) -> Iterable[str]:
    yield label
    for number in itertools.count(2):
        yield f"{label}#{number}"


def _has_home(value: Any) -> bool:
    return isinstance(value, types.FunctionType | type)
