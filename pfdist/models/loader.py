"""Find a model by its name, and load it from its source.

A name is that of a model that ships, that of an installed entry point of the group
``pfdist.models``, or ``path/file.py:object``.
"""

import hashlib
import importlib
import importlib.util
import itertools
import pkgutil
import tempfile
import types
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from pfdist.common.nearest import did_you_mean
from pfdist.errors import ModelError, shown
from pfdist.mistakes.endings import is_interrupt, kept_alive, told
from pfdist.mistakes.places import place_of
from pfdist.models.base import StateSpaceModel
from pfdist.models.beside import Beside, Files, FilesOnDisk

PYTHON = "python:"
"""Before the name of a model that was given as an object in Python, in the job of its run."""
_GROUP = "pfdist.models"
_NOT_MODELS = (
    "base",
    "beside",
    "checked_fields",
    "loader",
    "parameters",
    "trial_calls",
)  # modules of this package
_recordings = itertools.count()


@dataclass(frozen=True)
class ModelSource:
    """The source of a model, which travels to the workers.

    Parameters
    ----------
    name : str
        The name in the job file.
    path : str
        The file from which the source was read.
    attribute : str
        Name of the model in that file.
    package : str
        Package to which imports in the source are relative, if an installed module contains the
        model.
    content : bytes
        Content of the file. A worker runs this content and needs no access to the file.
    files : tuple of (str, bytes), optional
        Modules beside the file that it imports, and the model's data files, by their paths relative
        to the file's folder. None until the model was loaded from its folder.
    """

    name: str
    path: str
    attribute: str
    package: str
    content: bytes
    files: tuple[tuple[str, bytes], ...] | None = None

    @property
    def text(self) -> str:
        """Text of the source."""
        return importlib.util.decode_source(self.content)

    @property
    def sha256(self) -> dict[str, str]:
        """Hash of every known file, by its path relative to the model's file."""
        return {name: hashlib.sha256(content).hexdigest() for name, content in self._files.items()}

    def load(self) -> StateSpaceModel:
        """Run the source and give the model. The same source gives the same object.

        The model is loaded as in a worker: from the source and the files that travel with it.

        Raises
        ------
        ModelError
            The source fails, or contains no such model.
        """
        if self.files is None:
            _, source = self.record()
            return source.load()
        return self._taken_from(_loaded(self.path, self.package, tuple(self._files.items())))

    def record(self) -> tuple[StateSpaceModel, "ModelSource"]:
        """Load the model from its folder, and record which files it uses.

        Returns
        -------
        StateSpaceModel
            Loaded anew at every call.
        ModelSource
            This source with `files`.

        Raises
        ------
        ModelError
            The source fails, contains no such model, or a data file cannot be read.
        """
        file = Path(self.path)
        files = FilesOnDisk(file.parent, {file.name: self.content})
        key = f"recorded_{next(_recordings)}"
        beside = Beside(key, file, file.parent, files, self.package)
        try:
            model = self._taken_from(_run(beside, f"{file} fails when loaded"))
        finally:
            beside.forget()
        for name in model.data_files:
            _read_data(files, name, model, file)
        found = sorted(files.contents.items())
        return model, replace(self, files=tuple(pair for pair in found if pair[0] != file.name))

    @property
    def _files(self) -> dict[str, bytes]:
        """All files, with the model's own file first."""
        return {Path(self.path).name: self.content, **dict(self.files or ())}

    def _taken_from(self, module: types.ModuleType) -> StateSpaceModel:
        model = module.__dict__.get(self.attribute)
        if not isinstance(model, StateSpaceModel):
            found = [k for k, v in module.__dict__.items() if isinstance(v, StateSpaceModel)]
            raise ModelError(
                f"{self.path} must contain a StateSpaceModel named {self.attribute!r}, "
                f"got {'nothing' if model is None else type(model).__name__} of that name; "
                f"models in this file: {', '.join(found) or 'none'}"
                f"{did_you_mean(self.attribute, found)}"
            )
        return model


@cache
def _loaded(path: str, package: str, contents: tuple[tuple[str, bytes], ...]) -> types.ModuleType:
    """Load a model's file, which is the first of the contents, once in each process."""
    file, files = Path(path), Files(dict(contents))
    key = _key(path, package, contents)
    with tempfile.TemporaryDirectory(prefix="pfdist-model-") as folder:
        place = file.parent
        if not package:  # files that an installed module reads are installed, too
            place = Path(folder)
            _write(place, files.contents)
        beside = Beside(key, file, place, files, package)
        others = ", ".join(name for name, _ in contents[1:]) or "none"
        try:
            return _run(
                beside,
                f"{file} fails when loaded as in a worker, with only its data_files and the "
                f"modules beside it that it imports ({others})",
            )
        except BaseException:
            beside.forget()
            raise


def _key(path: str, package: str, contents: tuple[tuple[str, bytes], ...]) -> str:
    digest = hashlib.sha256(repr((path, package)).encode())
    for name, content in contents:
        digest.update(f"{name!r} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def _write(folder: Path, contents: Mapping[str, bytes]) -> None:
    for name, content in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _run(beside: Beside, fails: str) -> types.ModuleType:
    try:
        with kept_alive():
            return beside.load()
    except ModelError:
        raise
    except BaseException as error:  # a model may raise any exception
        if is_interrupt(error):
            raise
        reason = beside.told(told(error))
        raise ModelError(f"{fails}: {reason}{place_of(error)}") from error


def _read_data(files: FilesOnDisk, name: str, model: StateSpaceModel, file: Path) -> None:
    try:
        found = files.read(name) is not None
        reason = "there is no such file"
    except OSError as error:
        found, reason = False, str(error.strerror)
    if not found:
        raise ModelError(
            f"model {model.name}: data_files must name files that can be read, got {name!r}: "
            f"{file.parent / name}: {reason}"
        )


def find_model(name: str, folder: Path = Path()) -> ModelSource:
    """Find a model's source by its name.

    Parameters
    ----------
    name : str
        A model that ships, an entry point, or ``path/file.py:object``.
    folder : Path
        Folder to which a path in the name is relative. By default the working folder.

    Raises
    ------
    ModelError
        There is no such model, or its file cannot be read.
    """
    if not isinstance(name, str):
        raise ModelError(f"the name of a model must be a text, got {shown(name)}")
    if name.startswith(PYTHON):
        raise ModelError(
            f"the model {name!r} was given as an object in Python: give the object again, from "
            "Python, or name a file that holds it, 'path/file.py:object'"
        )
    if ".py:" in name:
        file, _, attribute = name.rpartition(":")
        return _read(name, folder / file, attribute, package="")
    installed = installed_models()
    if name not in installed:
        raise ModelError(
            f"a model must be one of {', '.join(sorted(installed))} or 'path/file.py:object', "
            f"got {name!r}{did_you_mean(name, installed)}"
        )
    module, attribute = installed[name]
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        spec = None
    if spec is None or not spec.has_location or spec.origin is None:
        raise ModelError(f"the module {module!r} of model {name!r} has no source file")
    return _read(name, Path(spec.origin), attribute, spec.parent or "")


def load_model(name: str) -> StateSpaceModel:
    """Load a model by its name.

    Parameters
    ----------
    name : str
        A model that ships, an installed entry point of the group ``pfdist.models``, or
        ``path/file.py:object``.

    Returns
    -------
    StateSpaceModel

    Raises
    ------
    ModelError
        There is no such model, or it cannot be loaded.
    """
    return find_model(name).load()


def installed_models() -> dict[str, tuple[str, str]]:
    """Give module and attribute of every model that ships or is an entry point, by name."""
    package = importlib.import_module("pfdist.models")
    shipped = {
        module.name: (f"pfdist.models.{module.name}", "model")
        for module in pkgutil.iter_modules(package.__path__)
        if module.name not in _NOT_MODELS
    }
    plugged: list[EntryPoint] = list(entry_points(group=_GROUP))
    return {entry.name: (entry.module, entry.attr) for entry in plugged} | shipped


def _read(name: str, path: Path, attribute: str, package: str) -> ModelSource:
    if path.exists() and not path.is_file():  # opening a pipe would wait for ever
        raise ModelError(f"{path} must be a file, got something else ({name!r})")
    try:
        content = path.read_bytes()
        content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ModelError(f"cannot read {path}: {reason} (got {name!r})") from error
    return ModelSource(name, str(path), attribute, package, content)
