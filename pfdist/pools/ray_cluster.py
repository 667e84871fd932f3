"""Starts a local Ray cluster or joins an existing one, and leaves it.

A cluster that pfdist starts accepts only processes with its token, which is in the environment of
this command. It ends with this command.
"""

import atexit
import contextlib
import importlib
import logging
import os
import secrets
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from typing import Any

from pfdist.common.stopping import check, exit_code
from pfdist.errors import PoolError, SilenceError
from pfdist.pools.cores import usable_cores

START_SECONDS = 120.0
ANSWER_SECONDS = 30.0
_CONNECT_SECONDS = 5.0
_STOP_SECONDS = 10.0
_ABANDON_SECONDS = 8.0  # after a signal, for which Ray may still start
_LOOK_SECONDS = 0.1  # between two looks whether a signal was received
_OBJECT_STORE_BYTES = 100 * 1024**2  # outcomes are kilobytes
_SHOWN = 300  # characters of what Ray says
_SHOWN_ADDRESS = 80
_LONGEST_FOLDER = 38  # a socket's path has 107 characters, of which Ray needs 69
_ADDRESS = "RAY_ADDRESS"
_SETTINGS = {
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # no warning
    "RAY_TQDM_PATCH_PRINT": "0",  # Numba could not compile another `print`
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_task_oom_retries": "3",  # as often as after a crash; by default without end
    # Answers of more bytes go through Ray's object store, for which a driver may wait for ever.
    "RAY_max_direct_call_object_size": f"{8 * 1024**2}",
}


def load_ray(*, own: bool = False) -> Any:
    """The imported Ray; it reads a token from its environment if pfdist starts the cluster.

    Variables that the user has set are kept. If Ray was imported before, all are kept.
    """
    if "ray" not in sys.modules:
        for name, value in _SETTINGS.items():
            os.environ.setdefault(name, value)
        if own:
            os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
            if len(tempfile.gettempdir()) > _LONGEST_FOLDER:
                os.environ.setdefault("RAY_TMPDIR", "/tmp")  # noqa: S108  Ray's own default
    return importlib.import_module("ray")


def is_own(address: str) -> bool:
    """Whether an address asks for a local cluster that pfdist starts."""
    return address in {"", "local"}


@contextlib.contextmanager
def connected(address: str, cores: int = 0) -> Iterator[None]:
    """A connection to a Ray cluster, as a context.

    The address of an existing cluster is host:port, ray://host:port, or auto. If it is empty or
    local, pfdist starts a cluster, which offers so many cores; 0 offers all that this process may
    use. If this process has already joined a cluster, that cluster is used, and is not left.

    Raises `PoolError` if the cluster cannot be joined, or does not start.
    """
    own = is_own(address)
    ray, left = load_ray(own=own), threading.Event()
    if ray.is_initialized():
        yield
        return
    if own:
        options = {"address": "local", "num_cpus": cores or usable_cores(), "num_gpus": 0}
        options |= {"include_dashboard": False, "object_store_memory": _OBJECT_STORE_BYTES}
    else:
        address = os.environ.get(_ADDRESS) or address if address == "auto" else address
        reach(address)
        options = {"address": address}
    with contextlib.ExitStack() as stack:
        # Without a working directory, workers would look for modules in that of this process.
        empty = stack.enter_context(tempfile.TemporaryDirectory(prefix="pfdist-"))
        stack.push(partial(_leave, ray, left))
        try:
            _start(
                lambda: ray.init(
                    **options,
                    log_to_driver=False,
                    logging_level=logging.CRITICAL,
                    runtime_env={"working_dir": empty},
                ),
                left,
                START_SECONDS if own else ANSWER_SECONDS,
            )
        except Exception as error:
            whose = "Ray does not start" if own else f"no Ray cluster at {shortened(address)}"
            raise PoolError(
                f"{whose}: {reason(error)}; the pools threads and processes need no Ray",
                argument="pool",
            ) from error
        yield


def _start(start: Callable[[], Any], left: threading.Event, most: float) -> None:
    """Start Ray in a thread of its own, which waits until the cluster is left.

    In the main thread, Ray would take the handler of SIGTERM. The servers that Ray starts end with
    the thread that started them. A half-started Ray cannot be left at once: a signal waits for some
    seconds.
    """
    started, deadline = Future[None](), time.monotonic() + most

    def begin() -> None:
        try:
            start()
        except BaseException as error:
            started.set_exception(error)
        else:
            started.set_result(None)
            left.wait()

    threading.Thread(target=begin, daemon=True).start()
    while not started.done() and exit_code() is None:
        if time.monotonic() > deadline:
            raise TimeoutError(f"no answer in {most:.0f} s (is another RAY_AUTH_TOKEN needed?)")
        with contextlib.suppress(TimeoutError):
            started.exception(_LOOK_SECONDS)
    with contextlib.suppress(TimeoutError):
        started.exception(_ABANDON_SECONDS)
    check()
    started.result()


def _leave(ray: Any, left: threading.Event, kind: object, *_: object) -> None:
    """Leave a cluster, which may never answer; `kind` is that of the error that ends the stay.

    A lost cluster is not asked any more, also not by Ray when the process ends: Ray would end this
    process at once, with an exit code of its own. Servers of our own then end with the process.
    """
    if kind is SilenceError:
        atexit.unregister(ray.shutdown)
        return
    if not sys.is_finalizing():  # else no thread can start any more
        thread = threading.Thread(target=ray.shutdown, daemon=True)
        thread.start()
        thread.join(_STOP_SECONDS)
    left.set()


def reach(address: str) -> None:
    """Check that an address accepts connections; Ray itself would wait for minutes.

    Raises `PoolError` if it is not an address, or does not answer. Ray itself resolves auto.
    """
    if address == "auto":
        return
    host, _, port = address.rpartition("://")[2].rpartition(":")
    is_port = port.isascii() and port.isdecimal() and 0 < int(port[:9]) < 2**16
    if not (host and host.isprintable() and is_port):
        raise PoolError(
            "the address of a Ray cluster must be host:port, ray://host:port, auto or local, got "
            f"{shortened(address)}"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_SECONDS).close()
    except (OSError, UnicodeError) as error:
        said = getattr(error, "strerror", None) or reason(error)
        raise PoolError(
            f"no Ray cluster at {shortened(address)}: {said}; the pools threads and processes need "
            "no Ray",
            argument="pool",
        ) from error


def reason(error: BaseException) -> str:
    """The text of a Ray error, as one line of bounded length."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def shortened(address: str) -> str:
    """An address in quotes, cut if it is long."""
    shown = _SHOWN_ADDRESS
    return repr(address if len(address) <= shown else f"{address[:shown]}...")
