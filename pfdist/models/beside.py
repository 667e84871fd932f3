"""Modules that a model imports from beside its file.

They are found there whatever the working folder and ``sys.path``, and for that model alone: two
models in two folders may both have a ``helper``. So each model's modules are loaded under names of
their own, ``pfdist_model_<key>.helper``, and an import statement in these modules looks there
first. Only the standard library, NumPy and pfdist go before what lies beside.
"""

import builtins
import contextlib
import importlib
import importlib.util
import linecache
import sys
import types
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

from pfdist.common.syntax import imported_in

_PREFIX = "pfdist_model_"
_FIRST = sys.stdlib_module_names | {"numpy", "pfdist"}


class Files:
    """Files of a model by their paths relative to its own file's folder, as a worker has them.

    Parameters
    ----------
    contents : mapping of str to bytes
    """

    def __init__(self, contents: Mapping[str, bytes]) -> None:
        self.contents = dict(contents)

    def read(self, name: str) -> bytes | None:
        """Give the content of a file; None if there is no such file."""
        return self.contents.get(name)

    def is_package(self, name: str) -> bool:
        """Whether it is a folder with modules in it."""
        return any(file.startswith(f"{name}/") for file in self.contents)


class FilesOnDisk(Files):
    """Files of a model where its user keeps them; `contents` are those that were read.

    Parameters
    ----------
    folder : Path
    contents : mapping of str to bytes
        What has been read already.
    """

    def __init__(self, folder: Path, contents: Mapping[str, bytes]) -> None:
        super().__init__(contents)
        self._folder = folder

    def read(self, name: str) -> bytes | None:
        """Give the content of a file, and keep it; None if there is no such file."""
        if name not in self.contents:
            path = self._folder / name
            if not path.is_file():
                return None
            self.contents[name] = path.read_bytes()
        return self.contents[name]

    def is_package(self, name: str) -> bool:
        """Whether it is a folder that no installed package hides."""
        return (self._folder / name).is_dir() and _is_unknown(name.partition("/")[0])


class Beside(MetaPathFinder, InspectLoader):
    """Finds and loads a model's own module, and those that it imports from beside.

    Parameters
    ----------
    key : str
        Tells this model's modules from other models'.
    file : Path
        The model's file, as errors and tracebacks name it.
    place : Path
        Folder in which the modules believe to be: what ``__file__`` says.
    files : Files
        The model's file among them.
    package : str
        What imports in the model's file are relative to, if it is an installed module's. It has
        nothing beside: what it imports is installed.
    """

    def __init__(self, key: str, file: Path, place: Path, files: Files, package: str) -> None:
        self._name = f"{_PREFIX}{key}"
        self._main = f"{self._name}.{file.stem.replace('.', '_')}"
        self._file, self._place, self._package = file, place, package
        self._files = files
        self._found = {self._main: file.name}
        self._forgotten: dict[str, types.ModuleType] = {}

    def load(self) -> types.ModuleType:
        """Run the model's file, and with it what it imports."""
        outer = types.ModuleType(self._name)
        outer.__path__ = []
        self._forgotten = {self._name: outer}
        self._recall()
        return importlib.import_module(self._main)

    def forget(self) -> None:
        """Have Python forget these modules, until one of them imports another."""
        with contextlib.suppress(ValueError):
            sys.meta_path.remove(self)
        for name in [name for name in sys.modules if f"{name}.".startswith(f"{self._name}.")]:
            self._forgotten[name] = sys.modules.pop(name)

    def _recall(self) -> None:
        sys.modules.update(self._forgotten)
        sys.meta_path.append(self)

    def told(self, text: str) -> str:
        """Give an error's text with the names and paths that the user knows."""
        text = text.replace(f"{self._name}.", "")
        return text.replace(str(self._place), str(self._file.parent))

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module of this model's."""
        if not fullname.startswith(f"{self._name}."):
            return None
        if fullname == self._main:
            return ModuleSpec(fullname, self, origin=str(self._file))
        name = fullname.removeprefix(f"{self._name}.").replace(".", "/")
        for file, is_package in ((f"{name}/__init__.py", True), (f"{name}.py", False)):
            if self._files.read(file) is not None:
                self._found[fullname] = file
                origin = str(self._file.parent / file)
                return ModuleSpec(fullname, self, origin=origin, is_package=is_package)
        if self._files.is_package(name):
            return ModuleSpec(fullname, None, is_package=True)
        return None

    def get_source(self, fullname: str) -> str:
        """Give the text that a module was loaded from."""
        content = self._files.read(self._found[fullname])
        return importlib.util.decode_source(content or b"")

    def exec_module(self, module: types.ModuleType) -> None:
        """Run a module's text; what it imports is looked for beside it first."""
        file = self._found[module.__name__]
        module.__file__ = str(self._place / file)
        if self._package:
            module.__package__, module.__spec__ = self._package, None
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": self._import}
        shown, text = str(self._file.parent / file), self.get_source(module.__name__)
        # Tracebacks show these lines, though the file is edited, or is not on this machine.
        linecache.cache[shown] = (len(text), None, text.splitlines(keepends=True), shown)
        code = compile(text, shown, "exec", dont_inherit=True)
        self._find_imports(text, str(module.__package__), by_functions=True)
        exec(code, module.__dict__)  # noqa: S102  it is the user's

    def _find_imports(self, text: str, package: str, by_functions: bool = False) -> None:
        """Find what may be imported from beside later, when functions are called: it travels."""
        for written in imported_in(text, package, by_functions):
            name = written.removeprefix(f"{self._name}.")
            full = f"{self._name}.{name}"
            if full in self._found or not self._is_beside(name.partition(".")[0]):
                continue
            spec = self.find_spec(full, None)
            if spec is not None and spec.loader is not None:
                inner = full if spec.submodule_search_locations is not None else spec.parent
                with contextlib.suppress(SyntaxError, ValueError):  # an error when it is imported
                    self._find_imports(self.get_source(full), str(inner))

    def _import(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,  # noqa: A002  as Python calls it
        locals: Mapping[str, Any] | None = None,  # noqa: A002
        fromlist: Sequence[str] = (),
        level: int = 0,
    ) -> types.ModuleType:
        """What an import statement in one of these modules does."""
        if self._name not in sys.modules:  # a formula imports, and the model was forgotten
            self._recall()
            try:
                return self._import(name, globals, locals, fromlist, level)
            finally:
                self.forget()
        top = name.partition(".")[0]
        if level or not self._is_beside(top):
            return builtins.__import__(name, globals, locals, fromlist, level)
        module = builtins.__import__(f"{self._name}.{name}", globals, locals, fromlist)
        return module if fromlist else sys.modules[f"{self._name}.{top}"]

    def _is_beside(self, top: str) -> bool:
        if self._package or top in _FIRST:
            return False
        return f"{self._name}.{top}" in sys.modules or (
            self.find_spec(f"{self._name}.{top}", None) is not None
        )


def own_name(module: str) -> str:
    """Give a module's name as its author knows it."""
    return module.partition(".")[2] if module.startswith(_PREFIX) else module


@cache
def _is_unknown(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is None
    except (ImportError, ValueError):
        return True
