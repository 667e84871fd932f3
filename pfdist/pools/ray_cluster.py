"""Starts a local Ray cluster or joins an existing cluster, and leaves it.

A cluster of our own listens only on loopback. It obeys only those who have a token that only this
user can read. It keeps its sockets and logs in a folder that only this user can enter, and ends
with this process, whatever ends it.
"""

import contextlib
import logging
import os
import platform
import secrets
import stat
import sys
import tempfile
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pfdist.common.stopping import check, exit_code
from pfdist.errors import PoolError

# Before Ray is imported: by default it writes to standard error, reports its usage, and replaces
# `print`, which Numba then cannot compile.
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
os.environ.setdefault("RAY_TQDM_PATCH_PRINT", "0")
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
# Answers of more bytes go through Ray's object store, for which a driver may wait for ever.
os.environ.setdefault("RAY_max_direct_call_object_size", f"{8 * 1024**2}")

import ray
from ray.exceptions import RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from pfdist.pools.cores import usable_cores
from pfdist.pools.guard import Guard, environment
from pfdist.pools.ray_rehearsal import host_and_port, reach, reason, rehearse, shortened

__all__ = ["NodeAffinitySchedulingStrategy", "ray"]  # also for the pool, with the environment above

START_SECONDS = 120.0
STOP_SECONDS = 5.0
_ADDRESS = "RAY_ADDRESS"
LONGEST_FOLDER = 38  # a socket's path has 107 characters, of which Ray needs 69
_ABANDON_SECONDS = 8.0  # after a signal, for which Ray may still start
_LOOK_SECONDS = 0.1  # between two looks whether a signal was received
_GROUP_SECONDS = 10.0  # within which Ray must find the nodes of free cores
_OBJECT_STORE_BYTES = 100 * 1024**2  # outcomes are kilobytes
_QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}


def private_folder() -> str:
    """A folder for Ray's sockets and logs, with a short path, that no other user can enter.

    Ray lets everyone write to its folder. So the folder lies in another folder, which is private.
    Raises `PoolError` if the folder's name belongs to something else, or if other users may enter
    it.
    """
    name = f"pfdist-ray-{os.getuid()}"
    parent = os.environ.get("RAY_TMPDIR") or tempfile.gettempdir()
    if len(f"{parent}/{name}/r") > LONGEST_FOLDER:
        parent = "/tmp"  # noqa: S108  the folder in it is looked at
    folder = Path(parent, name)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(0o700)
    status = folder.lstat()
    if stat.S_ISLNK(status.st_mode):
        wrong = "a link"
    elif not stat.S_ISDIR(status.st_mode):
        wrong = "no folder"
    elif status.st_uid != os.getuid():
        wrong = f"a folder of user {status.st_uid}"
    elif status.st_mode & 0o077:
        wrong = f"a folder of mode {stat.S_IMODE(status.st_mode):03o}"
    else:
        return str(folder / "r")
    raise PoolError(
        f"Ray's sockets need a folder that only user {os.getuid()} can enter (mode 700), and "
        f"{folder} is {wrong}: remove it, or let RAY_TMPDIR name another folder with a short path"
    )


def within(seconds: float, function: Callable[[], Any]) -> threading.Thread:
    """The thread of a function that may never return, after at most so many seconds."""
    thread = threading.Thread(target=function, daemon=True)
    thread.start()
    thread.join(seconds)
    return thread


@contextlib.contextmanager
def connected(address: str, cores: int = 0) -> Iterator[None]:
    """Be connected to a Ray cluster inside a with statement.

    The address of an existing cluster is host:port, ray://host:port, or auto. If it is empty or
    local, pfdist starts a cluster, which offers so many cores; 0 offers all that this process may
    use. If this process has already joined a cluster, that cluster is used, and not left.

    Raises `PoolError` if the existing cluster cannot be joined, or our own has no folder.
    """
    if ray.is_initialized():
        yield
        return
    if address == "auto":
        address = os.environ.get(_ADDRESS) or address
    # Left in reverse order: `_leave` ends Ray, then the thread that started Ray may end, and last
    # the guard. The guard is entered first, so a kill at any moment leaves no process behind.
    with contextlib.ExitStack() as stack:
        guard, left = stack.enter_context(Guard()), threading.Event()
        stack.callback(left.set)
        if is_own(address):
            folder = private_folder()
            stack.enter_context(_token())
            stack.callback(_leave, guard)
            _start(cores, folder, guard, left)
        else:
            stack.callback(_leave, guard)
            _join(address, guard, left)
        yield


def is_own(address: str) -> bool:
    """Whether an address asks for a local cluster that pfdist starts."""
    return address in {"", "local"}


def all_cores() -> int:
    """Number of cores of the cluster."""
    return int(ray.cluster_resources().get("CPU", 0))


def idle_cores() -> int:
    """Number of cores of the cluster that are not taken."""
    return int(ray.available_resources().get("CPU", 0))


def free_cores(most: int) -> dict[str, int]:
    """The free cores of each node, at most so many in all.

    Only a placement group tells on which nodes cores are free: Ray reserves them, and they are
    given back here at once. Another driver may take them before an actor starts there.
    """
    cores = min(most, idle_cores())
    if cores <= 0:
        return {}
    group = ray.util.placement_group([{"CPU": 1}] * cores)
    try:
        if not group.wait(_GROUP_SECONDS):
            return {}
        return Counter(ray.util.placement_group_table(group)["bundles_to_node_id"].values())
    finally:
        ray.util.remove_placement_group(group)


def _start(cores: int, folder: str, guard: Guard, left: threading.Event) -> None:
    with guard.watching(), only_loopback(ray):
        _init(
            left,
            address="local",
            num_cpus=cores or usable_cores(),
            num_gpus=0,
            include_dashboard=False,
            object_store_memory=_OBJECT_STORE_BYTES,
            _temp_dir=folder,
            job_config=_job_config(),
            **_QUIET,
        )


def _join(address: str, guard: Guard, left: threading.Event) -> None:
    host_and_port(address)  # a wrong address is no fault of the cluster, so it has its own error
    try:
        with guard.watching():
            rehearse(address)
    except PoolError as error:
        raise PoolError(
            f"the Ray cluster at {shortened(address)} does not answer: {error}; "
            "the serial pool computes without Ray",
            argument="pool",
        ) from error
    # Ray's client (ray://) takes no settings, and leaves the working directory out by itself.
    job_config = None if "://" in address else _job_config()
    _init(left, address=address, job_config=job_config, **_QUIET)


def _job_config() -> Any:
    """Ray's settings for this process; workers look for modules only where this process looks.

    Otherwise Ray lets workers import modules from the working directory before all others.
    """
    return ray.job_config.JobConfig(_client_job=not {"", os.getcwd()} & {*sys.path})


def _init(left: threading.Event, **options: Any) -> None:
    """Start Ray in a thread of its own, which waits until the cluster is left.

    In the main thread, Ray would take the handler of SIGTERM. The servers that Ray starts end with
    the thread that started them. A half-started Ray cannot be left at once: a signal waits for some
    seconds, also Ctrl-C in a notebook.
    """
    started = Future[None]()

    def start() -> None:
        try:
            ray.init(**options)
        except BaseException as error:
            started.set_exception(error)
        else:
            started.set_result(None)
            left.wait()

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        within(0.0, start)
        try:
            while exit_code() is None and not started.done():
                with contextlib.suppress(TimeoutError):
                    started.exception(_LOOK_SECONDS)
        finally:
            with contextlib.suppress(TimeoutError):  # its servers may have received the signal, too
                started.exception(_ABANDON_SECONDS)
    check()
    started.result()


@contextlib.contextmanager
def only_loopback(ray: Any) -> Iterator[None]:
    """Make Ray take 127.0.0.1 for this machine's address, so that its servers listen only there.

    Ray does so by itself where it builds no clusters, on macOS and Windows. At any other address,
    also at 127.0.0.2, its servers listen on all interfaces.
    """
    constants, name = ray._private.ray_constants, "ENABLE_RAY_CLUSTER"
    before = getattr(constants, name)
    setattr(constants, name, False)
    try:
        yield
    finally:
        setattr(constants, name, before)


@contextlib.contextmanager
def _token() -> Iterator[None]:
    """Make Ray require a new token inside a with statement.

    The token is only in the environment of this process and of Ray's, which other users cannot
    read.
    """
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    try:
        with environment(token):
            _read_environment()
            yield
    finally:
        _read_environment()


def _read_environment() -> None:
    """Make Ray read its environment variables again."""
    ray._raylet.Config.initialize("")
    ray._raylet.AuthenticationTokenLoader.instance().reset_cache()


def _leave(guard: Guard) -> None:
    """Leave a cluster, and end the servers of a local cluster, in whatever state they are."""
    if sys.is_finalizing():  # a pool was never left: no thread can start any more
        guard.end()
        return
    # Ray may never answer. Once the guard has ended its servers, the call returns or is abandoned.
    shutdown = within(STOP_SECONDS, ray.shutdown)
    guard.end()
    shutdown.join(STOP_SECONDS)


def about() -> dict[str, Any]:
    """Host, Python and pfdist of the process that calls this."""
    return {
        "host": platform.node(),
        "python": platform.python_version(),
        "pfdist": version("pfdist"),
    }


_about_node: Any = ray.remote(num_cpus=0)(about)


def describe_nodes(address: str) -> list[dict[str, Any]]:
    """Host, Python and pfdist of every node of an existing cluster.

    Raises `PoolError` if the cluster, or one of its nodes, does not answer.
    """
    try:
        if ray.is_initialized() and not is_own(address):
            reach(address)
        with connected(address):
            calls = [
                _about_node.options(
                    scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                ).remote()
                for node in ray.nodes()
                if node["Alive"]
            ]
            nodes: list[dict[str, Any]] = ray.get(calls, timeout=START_SECONDS)
    except (RayError, OSError, RuntimeError, ValueError) as error:
        raise PoolError(
            f"the Ray cluster at {shortened(address)} does not answer: {reason(error)}"
        ) from error
    return nodes
