"""The fingerprint of a model: all that its formulas compute with.

Two models with the same fingerprint give the same figures. The fingerprint holds

- the syntax of the formulas, and of all functions of the user that they reach, without comments,
  docstrings and positions;
- the value of each global variable, variable of a closure and default argument that these functions
  name: numbers, text, tuples, lists, dictionaries, arrays and frames of pandas;
- the version of every other installed package of which they use a function;
- the parameters, the kinds of noise, the names of components, those that are circular, and the
  bytes of declared data files.

Anything else could change without notice: another kind of value, a class, an import inside a
function, `eval` and `getattr`, a function whose source is not known. A model that uses it has the
fingerprint of its programs at the instants of a job. If it cannot be traced, either, the error
names what it uses. The identity of a run has the versions of pfdist and its kernel; NumPy and the
standard library count by the names that are used.
"""

import ast
import collections
import contextlib
import dis
import hashlib
import sys
import sysconfig
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from pfdist.errors import ModelError
from pfdist.models.checks import own_formulas
from pfdist.models.mistakes import place_of_function, ships
from pfdist.models.seeing import home_of, names_in
from pfdist.models.syntax import codes_in, node_of, source_of, syntax_of
from pfdist.models.twin import traced

Fingerprint = dict[str, Any]
"""Hashes, numbers and versions by labels: ``formulas``, ``helper.C``, ``parameters.sd``, ..."""

FORMULAS: Final = "formulas"
DATA_FILES: Final = "data_files."
"""The beginning of the labels of data files."""
_SETTINGS = ("initial_noise", "process_noise", "measurement_noise", "linear_gaussian")
_NAMES = ("x_names", "y_names", "z_names", "circular")  # they name columns and components
_DYNAMIC = {"__import__", "eval", "exec", "getattr", "globals", "locals", "setattr", "vars"}
_HIDDEN = {
    *("__annotations__", "__closure__", "__code__", "__dict__", "__doc__", "__globals__"),
    "__name__",
}
_PLAIN = (bool, int, float, complex, str, type(None))
_BUILT_IN = {*sys.builtin_module_names, *sys.stdlib_module_names} - {"__main__"}
_WIDEST = {"f": 8, "c": 16}  # bytes
_OF_TYPING = {"__annotations__", "__orig_bases__", "__annotate__", "__annotate_func__"}
_STANDARD = {*sys.stdlib_module_names, "builtins", "numpy"}
_PACKAGES = {"site-packages", "dist-packages"}  # folders with installed distributions
_PFDIST = Path(__file__).parents[1]


@dataclass(frozen=True)
class Inspection:
    """A fingerprint, and what it was taken from."""

    fingerprint: Fingerprint
    modules: set[str]  # names of the user's modules that formulas reach
    texts: dict[str, str]  # text of each source file of a function that formulas reach, by the file


def inspected(model: Any, data: Mapping[str, bytes] | None = None) -> Inspection:
    """The fingerprint of a model; `data` is the content of its data files by their names.

    A `ModelError` names what a formula uses that has no fingerprint.
    """
    walk = _Walk(model.name, model.formulas)
    entries = _with_fields(walk.fingerprint(), model)
    return Inspection(entries | fingerprint_of_files(data or {}), walk.modules, walk.texts)


def fingerprint_of_files(data: Mapping[str, bytes]) -> Fingerprint:
    """The fingerprint of data files, by their names."""
    return {f"{DATA_FILES}{name}": digest([content]) for name, content in data.items()}


def fingerprint_of_programs(models: Sequence[Any], instants: range) -> Fingerprint:
    """The fingerprint of a model, the first of several, by their programs at some instants.

    The others have the parameters of scenarios. A `TraceError` says that a formula cannot be
    traced.
    """
    found = list[str | bytes]()
    for model in models:
        for part in [model, *(part.model for part in model.parts if model.sensors)]:
            for name in own_formulas(part):
                programs = traced(part, name, instants)
                places = programs.which.tobytes(), programs.row.tobytes()
                found += [name, *(each.hash for each in programs.programs), *places]
    return _with_fields({FORMULAS: digest(found)}, models[0])


def users_modules() -> set[str]:
    """The names of all imported modules of the user."""
    modules = [*sys.modules.items()]
    return {name for name, each in modules if each.__name__ == name and is_users_module(each)}


def _with_fields(entries: Fingerprint, model: Any) -> Fingerprint:
    """A fingerprint of formulas, with the kinds of noise, names and parameters of the model."""
    settings = [getattr(model, k) for k in _SETTINGS]
    sensors = {name: sensor.measurement_noise for name, sensor in model.sensors.items()}
    settings += filter(None, [sensors, model.proposal_noise])
    entries[FORMULAS] = digest([entries[FORMULAS], *map(repr, settings)])
    names = {name: ", ".join(map(str, given)) for name in _NAMES if (given := getattr(model, name))}
    parameters = {
        f"parameters.{name}": float(value) if np.ndim(value) == 0 else _content_of(np.array(value))
        for name, value in model.parameters.items()
    }
    return entries | names | parameters


def digest(parts: Iterable[str | bytes]) -> str:
    """The hash of texts and bytes."""
    hashed = hashlib.blake2b(digest_size=8)
    for part in parts:
        content = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        hashed.update(len(content).to_bytes(8, "little") + content)
    return hashed.hexdigest()


class _Walk:
    """A walk from a model's formulas, given by their names, to all that they reach."""

    def __init__(self, model: str, formulas: Mapping[str, Any]) -> None:
        self._model, self._formulas = model, formulas
        functions = (f for f in formulas.values() if isinstance(f, types.FunctionType))
        self._own = {home_of(function) for function in functions}
        self._functions: list[types.FunctionType] = []  # in the order in which they were met
        self._syntax: list[bytes] = []
        self._values: Fingerprint = {}
        self._place = ""  # of the function that is looked at
        self.modules: set[str] = set()
        self.texts: dict[str, str] = {}

    def fingerprint(self) -> Fingerprint:
        """The hash of the syntax, and the values and versions by their labels."""
        for name, formula in self._formulas.items():
            self._syntax.append(name.encode())
            if not isinstance(formula, types.FunctionType):
                self._refuse(name, f"is {_described(formula)}")
            self._function(formula, name)
        return {FORMULAS: digest(self._syntax)} | self._values

    def _function(self, function: types.FunctionType, label: str) -> None:
        """Add the syntax of a function of the user, and all that the function names."""
        self._place = place_of_function(function)
        if Path(function.__code__.co_filename) == _PFDIST / "models" / "base.py":
            angles = [cell.cell_contents for cell in function.__closure__ or ()]
            self._syntax.append(f"{function.__qualname__}{angles or ''}".encode())  # default error
            return
        if own := vars(function).keys() - {"__wrapped__"}:
            self._refuse(label, f"has an attribute of its own, {min(own)}: use a variable")
        # A second call is recorded by the function's number. So functions that call each other end
        # the walk, and which function is called still counts.
        if function in self._functions:
            self._syntax.append(b"%d" % self._functions.index(function))
            return
        self._functions.append(function)
        if _is_users(function.__code__.co_filename):
            self.modules.add(home_of(function))
            self.texts[function.__code__.co_filename] = source_of(function)
        node, syntax = node_of(function), syntax_of(function)
        if node is None or syntax is None:
            raise ModelError(
                f"model {self._model}: the source of {label} is not known: "
                + (
                    "its file has changed since it was imported"
                    if source_of(function)
                    else "it was made by exec or typed at a prompt"
                )
                + self._place
            )
        self._syntax.append(syntax)
        self._refuse_dynamic(function, label)
        code, cells = function.__code__, function.__closure__ or ()
        for name, cell in zip(code.co_freevars, cells, strict=True):
            with contextlib.suppress(ValueError):  # it has no value yet
                self._variable(f"{label}.{name}", cell.cell_contents, node, name)
        defaults = function.__defaults__ or ()
        names = code.co_varnames[code.co_argcount - len(defaults) : code.co_argcount]
        keywords = (function.__kwdefaults__ or {}).items()
        for name, value in [*zip(names, defaults, strict=True), *sorted(keywords)]:
            self._variable(f"{label}.{name}", value, node, name)
        scope, module = function.__globals__, self._prefix(home_of(function))
        for name in sorted(_globals_of(function.__code__) & scope.keys()):
            self._variable(f"{module}{name}", scope[name], node, name)

    def _variable(self, label: str, value: Any, node: ast.AST, name: str = "") -> None:
        """Add what a function reads through a name."""
        if isinstance(value, types.ModuleType):
            if is_users_module(value):
                self._module(label, value, node, name)
            else:
                self._library(value, node, name)
        else:
            self._value(label, value)

    def _library(self, module: types.ModuleType, node: ast.AST, name: str) -> None:
        """Add a library's version, and the numbers and arrays that a function reads from it."""
        self._package(module.__name__)
        for attributes in sorted(_chains(node, name)):
            value: Any = module
            for attribute in attributes:
                value = getattr(value, attribute, None)
            if not isinstance(value, types.ModuleType) and (content := _content_of(value)):
                self._values[".".join((module.__name__, *attributes))] = content

    def _module(self, label: str, module: types.ModuleType, node: ast.AST, name: str) -> None:
        """Add the variables that a function reads from a module of the user."""
        self.modules.add(module.__name__)
        for attributes in sorted(_chains(node, name)):
            value: Any = module
            for attribute in attributes:
                home, value = value, getattr(value, attribute, None)
                if not isinstance(value, types.ModuleType):
                    break
                if is_users_module(value):
                    self.modules.add(value.__name__)
            else:
                self._refuse(
                    label, f"is the module {value.__name__}, used as a value: write {name}.NAME"
                )
            self._variable(f"{self._prefix(home.__name__)}{attribute}", value, node)

    def _value(self, label: str, value: Any) -> None:
        if isinstance(value, types.FunctionType) and _is_users(value.__code__.co_filename):
            self._syntax.append(label.encode())
            caller = self._place
            self._function(value, label)
            self._place = caller
        elif (home := _library_of(value)) is not None:
            self._syntax.append(f"{label} {home}.{value.__name__}".encode())
            self._package(home)
        elif type(value) is tuple and any(map(_is_function, value)):
            for number, each in enumerate(value):
                self._value(f"{label}[{number}]", each)
        else:
            try:
                content = _content_of(value)
            except RecursionError:
                content = None
            if content is None:
                self._refuse(label, f"is {_described(value)}")
            before = self._values.get(label)  # of another function with the same name
            same = before is None or repr(before) == repr(content)
            if type(value).__module__.startswith("pandas."):
                self._package("pandas")
            self._values[label] = content if same else digest([repr(before), repr(content)])

    def _package(self, module: str) -> None:
        top = module.partition(".")[0]
        if top not in _STANDARD and top != "pfdist":
            self._values[f"package {top}"] = _version_of(top)

    def _prefix(self, module: str) -> str:
        return "" if module in self._own else f"{module}."

    def _refuse_dynamic(self, function: types.FunctionType, label: str) -> None:
        code = function.__code__
        names = _globals_of(code) - function.__globals__.keys()
        dynamic_names = sorted(_DYNAMIC & names) + sorted(_HIDDEN & names_in(code))
        imported = next(_steps(code, "IMPORT_NAME"), None)
        if imported is not None:
            self._refuse(label, f"imports {imported} when it is called: import it above")
        if dynamic_names:
            self._refuse(
                label, f"uses {dynamic_names[0]}, which may reach anything: name the value"
            )

    def _refuse(self, label: str, what: str) -> NoReturn:
        raise ModelError(
            f"model {self._model}: {label} {what} (a formula that cannot be traced and sent to "
            "workers may use numbers, text, tuples, lists, dictionaries, arrays, frames of pandas "
            "and functions, because a run is resumed only with the same model)"
            f"{self._place}"
        )


def _content_of(value: Any) -> Any:
    """A number, or a hash of text, a container or an array; None for another kind of value."""
    if type(value) is float and np.isfinite(value):
        return value
    if type(value) in _PLAIN:
        return f"{type(value).__name__} {value!r}" if type(value) is not str else digest([value])
    if type(value) is np.ndarray or isinstance(value, np.generic):
        kind, size = value.dtype.kind, value.dtype.itemsize
        if kind not in "biufcSU" or (kind in "fc" and size > _WIDEST[kind]):
            return None  # the bytes of objects are addresses, and wide numbers are padded
        order = f"{value.flags.c_contiguous} {value.flags.f_contiguous}"
        about = f"{type(value).__name__} {value.dtype.str} {value.shape} {order}"
        return digest([about, value.tobytes()])
    if type(value) in (tuple, list, dict) or _is_named_tuple(value):
        kind = type(value).__name__ if type(value) in (list, dict) else ""
        named = str(getattr(value, "_fields", kind))
        entries = [_content_of(each) for each in (value.items() if kind == "dict" else value)]
        return None if None in entries else digest([named, *map(repr, entries)])
    return _content_of_frame(value)


def _content_of_frame(value: Any) -> str | None:
    """A hash of a frame or a series of pandas; None for another kind of value."""
    pandas = sys.modules.get("pandas")
    if pandas is None or type(value) not in (pandas.DataFrame, pandas.Series):
        return None
    columns = value.to_frame() if type(value) is pandas.Series else value
    about = f"{type(value).__name__} {[*columns.columns]} {[*map(str, columns.dtypes)]}"
    try:
        return digest([about, pandas.util.hash_pandas_object(value).to_numpy().tobytes()])
    except TypeError:  # an entry has no hash
        return None


def _is_named_tuple(value: Any) -> bool:
    """Whether a value is a named tuple with nothing but its fields."""
    kind = type(value)
    if kind.__bases__ != (tuple,) or not hasattr(kind, "_fields"):
        return False
    plain = vars(collections.namedtuple("Plain", kind._fields)).keys()
    return not vars(kind).keys() - plain - _OF_TYPING


def _described(value: Any) -> str:
    """Description of a value without a fingerprint, and advice what to write instead."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    kind = type(value).__name__
    if kind == "tuple":
        return "a tuple that holds something else than formulas may use"
    return f"a value of the kind {kind}"


def _library_of(value: Any) -> str | None:
    """The name of the module of a library's function or class; None for any other value."""
    if isinstance(value, np.ufunc):
        homes = (np, sys.modules.get("scipy.special"))
        modules = (home for home in homes if getattr(home, value.__name__, None) is value)
        return getattr(next(modules, None), "__name__", None)
    if not _is_function(value) and not isinstance(value, type):
        return None
    home = getattr(value, "__module__", None) or "builtins"
    module = sys.modules.get(home)
    if module is None or is_users_module(module):
        return None
    member: Any = module
    for part in getattr(value, "__qualname__", "").split("."):
        member = getattr(member, part, None)
    return home if member is value else None


def _is_function(value: Any) -> bool:
    return callable(value) and hasattr(value, "__name__") and not isinstance(value, type)


def file_of(module: types.ModuleType) -> str | None:
    """The file of a module, or the folder of a package without a file."""
    return module.__dict__.get("__file__") or next(iter(getattr(module, "__path__", ())), None)


def is_users_module(module: types.ModuleType) -> bool:
    """Whether a module is the user's, or that of a model that ships: then its content counts."""
    file = file_of(module)
    if file is None:  # it is built into Python, or made by the user
        return module.__name__.partition(".")[0] not in _BUILT_IN
    return _is_users(file)


def _is_users(file: str) -> bool:
    """Whether a source file is the user's, or that of a model that ships."""
    path = Path(file)
    if path.is_relative_to(_PFDIST):
        return path.parent.name == "models" and ships(path.stem)
    return not (path.is_relative_to(sysconfig.get_path("stdlib")) or _PACKAGES & set(path.parts))


@cache
def _version_of(top: str) -> str:
    try:
        return version(top)
    except PackageNotFoundError:  # the distribution has another name than its module
        names = sorted(set(packages_distributions().get(top, [])))
        return ", ".join(f"{name} {version(name)}" for name in names) or "unknown"


def _chains(node: ast.AST, name: str) -> set[tuple[str, ...]]:
    """``("a", "b")`` for each ``name.a.b`` in a function, and ``()`` for the bare name."""
    inner = {id(each.value) for each in ast.walk(node) if isinstance(each, ast.Attribute)}
    chains = set()
    for outermost in ast.walk(node):
        if id(outermost) in inner:
            continue
        each, attributes = outermost, list[str]()
        while isinstance(each, ast.Attribute):
            attributes.insert(0, each.attr)
            each = each.value
        if isinstance(each, ast.Name) and each.id == name:
            chains.add(tuple(attributes))
    return chains


def _globals_of(code: types.CodeType) -> set[str]:
    """Names of the global variables that a function and the functions it defines read."""
    return {*_steps(code, "LOAD_GLOBAL"), *_steps(code, "LOAD_NAME")}


def _steps(code: types.CodeType, kind: str) -> Iterator[str]:
    """Arguments of a function's instructions of a kind, also in the functions that it defines."""
    for inner in codes_in(code):
        yield from (each.argval for each in dis.get_instructions(inner) if each.opname == kind)
