"""A model as it travels from the process that loads it to the workers: by value.

A worker can import neither a notebook nor the user's files. So the formulas travel with all that
they use from modules of the user. The process that loads a model computes with what travels, too:
what cannot travel is found before any worker has a task.
"""

import dataclasses
import linecache
import pickle
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final

import cloudpickle

from pfdist.common.streams import stream_key
from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel
from pfdist.models.fingerprint import Fingerprint, looked_at
from pfdist.models.mistakes import told
from pfdist.models.parameters import Parameter
from pfdist.models.seeing import alone

PYTHON: Final = "python:"
"""Before the name of a model that was given as an object in Python, in the job of its run."""


@dataclass(frozen=True)
class CarriedModel:
    """A model by value, where it came from, and its fingerprint.

    Parameters
    ----------
    name : str
        As a job names it; "python:" and the model's name for an object that was given in Python.
    content : bytes
        The fields of the model, and the text of its source, pickled. They are sent to workers, and
        never stored.
    fingerprint : Fingerprint
    """

    name: str
    content: bytes = field(repr=False)
    fingerprint: Fingerprint = field(repr=False)

    @property
    def model(self) -> StateSpaceModel:
        """The model. The same content gives the same object.

        Raises
        ------
        ModelError
            It cannot be made here, for instance because a package is not installed.
        """
        try:
            return _made(self.content)
        except ModelError:
            raise
        except Exception as error:
            raise ModelError(
                f"model {self.name} cannot be made from what travels to the workers: {told(error)}"
            ) from error

    @cached_property
    def key(self) -> str:
        """Hash of the fingerprint."""
        return f"{stream_key(self.fingerprint):016x}"

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> "CarriedModel":
        """Give the model with some parameters changed.

        Raises
        ------
        ModelError
            A parameter is unknown, or its value lies outside its range.
        """
        if not parameters:
            return self
        data = {key: value for key, value in self.fingerprint.items() if key.startswith(_DATA)}
        changed = carried(self.model.with_parameters(parameters), self.name)
        return dataclasses.replace(changed, fingerprint=changed.fingerprint | data)


_DATA = "data_files."


def carried(
    model: StateSpaceModel, name: str, data: Mapping[str, bytes] | None = None
) -> CarriedModel:
    """Give a model by value, with its fingerprint.

    Parameters
    ----------
    model : StateSpaceModel
    name : str
        As a job names it.
    data : mapping of str to bytes, optional
        Content of its data files by their names.

    Raises
    ------
    ModelError
        A formula uses something that has no fingerprint, or that cannot travel.
    """
    seen = looked_at(model, data)
    fields = {each.name: getattr(model, each.name) for each in dataclasses.fields(model)}
    fields |= {key: dict(value) for key, value in fields.items() if isinstance(value, Mapping)}
    fields |= alone(model.formulas)
    try:
        with _sent_by_value(seen.modules):
            content = cloudpickle.dumps((fields, seen.texts))
    except Exception as error:  # an object of the user may raise any exception
        raise ModelError(f"model {model.name} cannot be sent to workers: {told(error)}") from error
    known = CarriedModel(name, content, seen.fingerprint)
    known.model  # noqa: B018  made here first, to find what cannot be made
    return known


@contextmanager
def _sent_by_value(names: set[str]) -> Iterator[None]:
    """Have functions of these modules pickled by value, not by their names."""
    known = cloudpickle.list_registry_pickle_by_value()
    modules = [sys.modules[name] for name in sorted(names & sys.modules.keys() - known)]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


@lru_cache(maxsize=64)
def _made(content: bytes) -> StateSpaceModel:
    fields, texts = pickle.loads(content)  # noqa: S301  the driver made it
    for file, text in texts.items():  # tracebacks show these lines, also where the file is another
        if "".join(linecache.getlines(file)) != text:
            linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
    return StateSpaceModel(**fields)
