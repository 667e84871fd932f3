"""Models as bytes, to be sent to workers.

A recorded model is plain data. Only functions of a batched model are user code, which a worker may
be unable to import. So this code is sent by value.
"""

import io
import os
import pickle
import sys
import sysconfig
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, ClassVar

import cloudpickle

from pfdist.errors import ModelError
from pfdist.models.mistakes import error_line
from pfdist.models.recorded import declared, is_recorded

_INSTALLED = {"site-packages", "dist-packages"}


def by_value(models: Sequence[Any]) -> bytes:
    """Models as bytes.

    Raises
    ------
    ModelError
        A function of a batched model uses an object that cannot be sent.
    """
    if all(is_recorded(each) and not declared(each) for each in models if each is not None):
        return pickle.dumps(None) + pickle.dumps(models)  # plain data
    with _users_modules_by_value():
        try:
            written = io.BytesIO()
            pickle.dump(_has_doubles_in_jax(), written)
            _Pickler(written).dump(models)
        except Exception as error:  # an object of the user may raise any exception
            raise ModelError(
                f"model {models[0].name} cannot be sent to workers: {error_line(error)}"
            ) from error
    return written.getvalue()


@lru_cache(maxsize=64)
def models_made(content: bytes) -> tuple[Any, ...]:
    """The models from their bytes; the same bytes give the same objects.

    Raises
    ------
    ModelError
        A model cannot be loaded here, for instance because a package is not installed.
    """
    try:
        arrived = io.BytesIO(content)  # the driver made it
        _set_doubles_in_jax(pickle.load(arrived))  # noqa: S301
        models: tuple[Any, ...] = pickle.load(arrived)  # noqa: S301
    except Exception as error:  # an object of the user may raise any exception
        raise ModelError(f"a worker cannot load a model: {error_line(error)}") from error
    return models


def _has_doubles_in_jax() -> bool | None:
    """Whether JAX computes in float64 here; None if it is not imported.

    A model's file may say so when it is imported, which workers do not do.
    """
    jax = sys.modules.get("jax")
    return None if jax is None else bool(jax.config.jax_enable_x64)


def _set_doubles_in_jax(has_doubles: bool | None) -> None:
    """Have JAX compute in float64 in this process, or in float32."""
    if has_doubles is None:
        return
    os.environ["JAX_ENABLE_X64"] = str(int(has_doubles))  # as JAX reads it when it is imported
    jax = sys.modules.get("jax")
    if jax is not None:
        jax.config.update("jax_enable_x64", has_doubles)


def _reduced(code: CodeType) -> tuple[Any, ...]:
    """How code is pickled: as cloudpickle does, with its file, which newer releases leave out.

    Errors name it.
    """
    make, parts = cloudpickle.Pickler.dispatch_table[CodeType](code)
    return _of_file, (make, parts, code.co_filename)


def _of_file(make: Callable[..., CodeType], parts: tuple[Any, ...], file: str) -> CodeType:
    return make(*parts).replace(co_filename=file)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it ships no type hints
    dispatch_table: ClassVar[Mapping[Any, Any]] = ChainMap(
        {CodeType: _reduced}, cloudpickle.Pickler.dispatch_table
    )


@contextmanager
def _users_modules_by_value() -> Iterator[None]:
    """Have functions of the user's modules pickled by value, not by their names."""
    registered = cloudpickle.list_registry_pickle_by_value()
    modules = [
        module
        for name, module in sys.modules.copy().items()  # other threads import
        if name not in registered and _is_users(module)
    ]
    for module in modules:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)


def _is_users(module: ModuleType) -> bool:
    file = getattr(module, "__file__", None)
    if not isinstance(file, str) or module.__name__.partition(".")[0] in ("pfdist", "__main__"):
        return False
    return not (
        _INSTALLED & set(Path(file).parts)
        or Path(file).is_relative_to(sysconfig.get_path("stdlib"))
    )
