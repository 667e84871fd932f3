"""A model by value, as it travels from the process that loads it to the workers.

A worker can import neither a notebook nor the user's files. So the formulas travel with all that
they use from modules of the user. The process that loads a model computes with what travels, too.
So it finds what cannot travel before any worker has a task.
"""

import dataclasses
import io
import linecache
import pickle
import sys
import types
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Final

import cloudpickle

from pfdist.common.streams import stream_key
from pfdist.errors import ModelError, TraceError
from pfdist.models.base import StateSpaceModel
from pfdist.models.fingerprint import (
    DATA_FILES,
    FORMULAS,
    Fingerprint,
    Inspection,
    fingerprint_of_files,
    fingerprint_of_programs,
    inspected,
    users_modules,
)
from pfdist.models.mistakes import error_line
from pfdist.models.parameters import Parameter
from pfdist.models.seeing import with_named_modules

PYTHON: Final = "python:"
"""The beginning of the name, in a job, of a model that was given as an object in Python."""


@dataclass(frozen=True)
class CarriedModel:
    """A model by value, where it came from, and its fingerprint."""

    name: str  # as a job names it; for an object in Python, PYTHON and the model's name
    # The model's fields and the text of its source, pickled. They are sent to workers, and never
    # stored in a run.
    content: bytes = field(repr=False)
    # Without formulas for a model whose programs must tell whether it changed, until there are
    # instants.
    fingerprint: Fingerprint = field(repr=False)

    @property
    def model(self) -> StateSpaceModel:
        """The model; the same content gives the same object.

        A `ModelError` says why it cannot be made here, for instance because a package is not
        installed.
        """
        try:
            return _made(self.content)
        except ModelError:
            raise
        except Exception as error:
            raise ModelError(
                f"model {self.name} cannot be made from what travels to the workers: "
                f"{error_line(error)}"
            ) from error

    @cached_property
    def key(self) -> str:
        """Hash of the fingerprint, which must be known."""
        return f"{stream_key(self.fingerprint):016x}"

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> "CarriedModel":
        """The model with some parameters changed; raises as `StateSpaceModel.with_parameters`."""
        if not parameters:
            return self
        # The data files are not read again: their part of the fingerprint is that of the reading.
        kept = self.fingerprint.items()
        data = {key: value for key, value in kept if key.startswith(DATA_FILES)}
        changed = carried(self.model.with_parameters(parameters), self.name)
        return changed._with(data)

    def at(
        self,
        model: StateSpaceModel,
        horizon: int,
        scenarios: Sequence[Mapping[str, Parameter]] = (),
    ) -> "CarriedModel":
        """The same with a fingerprint, if need be that of its programs at 0..T.

        `model` was made of this one, on its clock; `scenarios` are the parameters that it may have.
        A `ModelError` says that it has no fingerprint and cannot be traced, either.
        """
        if FORMULAS in self.fingerprint:
            return self
        models = [model, *map(model.with_parameters, scenarios)]
        try:
            return self._with(fingerprint_of_programs(models, range(horizon + 1)))
        except TraceError:
            inspected(model)  # raises the error that names what has no fingerprint
            raise

    def _with(self, fingerprint: Fingerprint) -> "CarriedModel":
        return dataclasses.replace(self, fingerprint=self.fingerprint | fingerprint)


def carried(
    model: StateSpaceModel, name: str, data: Mapping[str, bytes] | None = None
) -> CarriedModel:
    """A model by value, with its fingerprint.

    `name` is the model's name in a job, and `data` the content of its data files by their names. A
    `ModelError` names what a formula uses that cannot travel.
    """
    fields = {each.name: getattr(model, each.name) for each in dataclasses.fields(model)}
    fields |= {key: dict(value) for key, value in fields.items() if isinstance(value, Mapping)}
    travelling: Mapping[str, Any] = model.formulas | {"error": model.error}
    unknown: ModelError | None = None  # why the formulas have no fingerprint of their own
    try:
        inspection = inspected(model, data)
        travelling = with_named_modules(travelling)
    except ModelError as error:
        unknown = error
        inspection = Inspection(fingerprint_of_files(data or {}), users_modules(), {})
    fields |= {name: formula for name, formula in travelling.items() if name in fields}
    fields["sensors"] = {
        name: dataclasses.replace(
            sensor,
            measurement=travelling[f"{name}.measurement"],
            log_likelihood=travelling[f"{name}.log_likelihood"],
        )
        for name, sensor in model.sensors.items()
    }
    try:
        with _sent_by_value(inspection.modules):
            written = io.BytesIO()
            _Pickler(written).dump((fields, inspection.texts))
    except Exception as error:  # an object of the user may raise any exception
        raise unknown or ModelError(
            f"model {model.name} cannot be sent to workers: {error_line(error)}"
        ) from error
    result = CarriedModel(name, written.getvalue(), inspection.fingerprint)
    try:
        result.model  # noqa: B018  made here first, to find what cannot be made
    except ModelError as error:
        raise unknown or error from error
    return result


def _reduced(code: types.CodeType) -> tuple[Any, ...]:
    """How code is pickled: as cloudpickle does, with its file, which newer releases leave out.

    The fingerprint, errors and the cache of compiled code read the source of a formula there.
    """
    make, parts = cloudpickle.Pickler.dispatch_table[types.CodeType](code)
    return _of_file, (make, parts, code.co_filename)


def _of_file(
    make: Callable[..., types.CodeType], parts: tuple[Any, ...], file: str
) -> types.CodeType:
    return make(*parts).replace(co_filename=file)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it ships no type hints
    dispatch_table: ClassVar[Mapping[Any, Any]] = ChainMap(
        {types.CodeType: _reduced}, cloudpickle.Pickler.dispatch_table
    )


@contextmanager
def _sent_by_value(names: set[str]) -> Iterator[None]:
    """Have functions of these modules pickled by value, not by their names."""
    registered = cloudpickle.list_registry_pickle_by_value()
    modules = [sys.modules[name] for name in sorted(names & sys.modules.keys() - registered)]
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
