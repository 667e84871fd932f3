"""From a model's name to the model and the source it is made of.

A name is that of a model that ships, of an installed entry point of the group
``pfdist.models``, or ``path/file.py:object``.
"""

import hashlib
import importlib.util
import pkgutil
import sys
import types
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel

_GROUP = "pfdist.models"
_NOT_MODELS = ("base", "loader")


@dataclass(frozen=True)
class ModelSource:
    """A model as its source: what travels to a worker, and what a run is identified by.

    Parameters
    ----------
    name : str
        As the job file has it.
    path : str
        The file the source was read from.
    attribute : str
        The model's name in that file.
    package : str
        What imports in the source are relative to, if it is an installed module's.
    text : str
        The source itself: a worker runs this text, so it needs no access to the file.
    """

    name: str
    path: str
    attribute: str
    package: str
    text: str

    @cached_property
    def sha256(self) -> str:
        """Hash of the source text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @cache  # noqa: B019  the same source is the same model, and is compiled once a process
    def load(self) -> StateSpaceModel:
        """Run the source and take the model from it.

        Raises
        ------
        ModelError
            The source fails, or holds no such model.
        """
        module = types.ModuleType(f"pfdist_model_{self.sha256[:16]}")
        module.__file__, module.__package__ = self.path, self.package
        sys.modules[module.__name__] = module  # dataclasses look their module up there
        try:
            exec(compile(self.text, self.path, "exec"), module.__dict__)  # noqa: S102  it is the user's
        except ModelError:
            raise
        except (Exception, SystemExit) as error:
            raise ModelError(
                f"model.name: {self.path} fails when loaded: {type(error).__name__}: {error}"
            ) from error
        model = module.__dict__.get(self.attribute)
        if not isinstance(model, StateSpaceModel):
            found = [k for k, v in module.__dict__.items() if isinstance(v, StateSpaceModel)]
            raise ModelError(
                f"model.name: {self.path} must hold a StateSpaceModel named {self.attribute!r}, "
                f"got {'nothing' if model is None else type(model).__name__} of that name; "
                f"models in it: {', '.join(found) or 'none'}"
            )
        return model


def find_model(name: str, folder: Path = Path()) -> ModelSource:
    """Find a model's source by its name.

    Parameters
    ----------
    name : str
        A model that ships, an entry point, or ``path/file.py:object``.
    folder : Path
        What a path in the name is relative to; by default the current one.

    Raises
    ------
    ModelError
        There is no such model, or its file cannot be read.
    """
    if ".py:" in name:
        file, _, attribute = name.rpartition(":")
        return _read(name, folder / file, attribute, package="")
    installed = installed_models()
    if name not in installed:
        raise ModelError(
            f"model.name must be one of {', '.join(sorted(installed))} or 'path/file.py:object', "
            f"got {name!r}"
        )
    module, attribute = installed[name]
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        spec = None
    if spec is None or not spec.has_location or spec.origin is None:
        raise ModelError(f"model.name: the module {module!r} of model {name!r} has no source file")
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
    """Module and attribute of every model that ships or is an entry point, by name."""
    package = importlib.import_module("pfdist.models")
    shipped = {
        module.name: (f"pfdist.models.{module.name}", "model")
        for module in pkgutil.iter_modules(package.__path__)
        if module.name not in _NOT_MODELS
    }
    plugged: list[EntryPoint] = list(entry_points(group=_GROUP))
    return {entry.name: (entry.module, entry.attr) for entry in plugged} | shipped


def _read(name: str, path: Path, attribute: str, package: str) -> ModelSource:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ModelError(f"model.name: cannot read {path}: {reason} (got {name!r})") from error
    return ModelSource(name, str(path), attribute, package, text)
