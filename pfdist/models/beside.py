"""Import of modules that lie beside a model's file.

These modules are found whatever the working folder and ``sys.path`` are, and each model has its
own: two models in two folders may both have a ``helper``. So the modules of a model are loaded
under private names, ``pfdist_model_<key>.helper``. An import statement in these modules looks there
first. Only the standard library, NumPy and pfdist take precedence over modules beside the file.
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
    """Files of a model as a worker has them.

    Parameters
    ----------
    contents : mapping of str to bytes
        Contents by paths relative to the folder of the model's own file.
    """

    def __init__(self, contents: Mapping[str, bytes]) -> None:
        self.contents = dict(contents)

    def read(self, name: str) -> bytes | None:
        """Give the content of a file; None if there is no such file."""
        return self.contents.get(name)

    def is_package(self, name: str) -> bool:
        """Whether a name is that of a folder with files."""
        return any(file.startswith(f"{name}/") for file in self.contents)


class FilesOnDisk(Files):
    """Files of a model in the user's folder. `contents` are the files read so far.

    Parameters
    ----------
    folder : Path
    contents : mapping of str to bytes
        Files that were read already.
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
        """Whether a name is that of a folder, and of no installed package."""
        return (self._folder / name).is_dir() and _is_unknown(name.partition("/")[0])


class Beside(MetaPathFinder, InspectLoader):
    """Importer that finds and loads the module of a model, and the modules beside it.

    Parameters
    ----------
    key : str
        Distinguishes the modules of this model from those of other models.
    file : Path
        The model's file, as errors and tracebacks name it.
    place : Path
        Folder that ``__file__`` of the modules names.
    files : Files
        All files, the model's file among them.
    package : str
        Package to which imports in the model's file are relative, if it is an installed module. An
        installed module has no modules beside it.
    """

    def __init__(self, key: str, file: Path, place: Path, files: Files, package: str) -> None:
        self._name = f"{_PREFIX}{key}"
        self._main = f"{self._name}.{file.stem.replace('.', '_')}"
        self._file, self._place, self._package = file, place, package
        self._files = files
        self._found = {self._main: file.name}
        self._forgotten: dict[str, types.ModuleType] = {}

    def load(self) -> types.ModuleType:
        """Run the model's file and the modules that it imports, and give its module."""
        outer = types.ModuleType(self._name)
        outer.__path__ = []
        self._forgotten = {self._name: outer}
        self._recall()
        return importlib.import_module(self._main)

    def forget(self) -> None:
        """Remove these modules from Python's tables, until one of them imports another."""
        with contextlib.suppress(ValueError):
            sys.meta_path.remove(self)
        for name in [name for name in sys.modules if f"{name}.".startswith(f"{self._name}.")]:
            self._forgotten[name] = sys.modules.pop(name)

    def _recall(self) -> None:
        sys.modules.update(self._forgotten)
        sys.meta_path.append(self)

    def told(self, text: str) -> str:
        """Give the text of an error with the names and paths that the user knows."""
        text = text.replace(f"{self._name}.", "")
        return text.replace(str(self._place), str(self._file.parent))

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module of this model; None for any other module."""
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
        """Give the text from which a module was loaded."""
        content = self._files.read(self._found[fullname])
        return importlib.util.decode_source(content or b"")

    def exec_module(self, module: types.ModuleType) -> None:
        """Run the text of a module. Its imports look beside the model's file first."""
        file = self._found[module.__name__]
        module.__file__ = str(self._place / file)
        if self._package:
            module.__package__, module.__spec__ = self._package, None
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": self._import}
        shown, text = str(self._file.parent / file), self.get_source(module.__name__)
        # Tracebacks then show these lines, even if the file is edited or on another machine.
        linecache.cache[shown] = (len(text), None, text.splitlines(keepends=True), shown)
        code = compile(text, shown, "exec", dont_inherit=True)
        self._find_imports(text, str(module.__package__), by_functions=True)
        exec(code, module.__dict__)  # noqa: S102  the code is the user's

    def _find_imports(self, text: str, package: str, by_functions: bool = False) -> None:
        """Find modules that functions may import later, when they are called: these travel, too."""
        for written in imported_in(text, package, by_functions):
            name = written.removeprefix(f"{self._name}.")
            full = f"{self._name}.{name}"
            if full in self._found or not self._is_beside(name.partition(".")[0]):
                continue
            spec = self.find_spec(full, None)
            if spec is not None and spec.loader is not None:
                inner = full if spec.submodule_search_locations is not None else spec.parent
                # A module with a wrong syntax raises its error when it is imported.
                with contextlib.suppress(SyntaxError, ValueError):
                    self._find_imports(self.get_source(full), str(inner))

    def _import(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,  # noqa: A002  Python's name
        locals: Mapping[str, Any] | None = None,  # noqa: A002
        fromlist: Sequence[str] = (),
        level: int = 0,
    ) -> types.ModuleType:
        """Import a module: every import statement in these modules calls this function."""
        if self._name not in sys.modules:  # a formula imports after the modules were removed
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
    """Give the name of a module as its author knows it."""
    return module.partition(".")[2] if module.startswith(_PREFIX) else module


@cache
def _is_unknown(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is None
    except (ImportError, ValueError):
        return True
