"""Checks whether a machine is fit for a run, so that the run does not fail hours later."""

import os
import platform
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import psutil

from pfdist.errors import PfdistError
from pfdist.pools.cores import limits, settings, usable_cores
from pfdist.questions.model_checks import Check
from pfdist.store.lock import try_lock

LEAST_MEMORY = 1.5e9  # Ray takes 0.5e9, the driver and a worker 0.3e9 each
LEAST_SHARED = 1.5e8  # Ray's object store takes 1e8
LEAST_DISK = 1e9  # a comparison of a million draws takes 0.05e9
LEAST_RAY = (2, 52)  # CVE-2025-62593

Finding = tuple[str, str]


def examine(results: Path, address: str = "") -> Iterator[Check]:
    """Yield a check of each thing that a run needs from a machine.

    `results` is the folder for runs. If there is an address, the nodes of this Ray cluster are
    checked, too.
    """
    looks: dict[str, Callable[[], Finding]] = {
        "cores": _cores,
        "memory": _memory,
        "shared memory": _shared_memory,
        "Ray": _ray,
        "ports": _ports,
        "results folder": lambda: _results(results),
    }
    for name, look in looks.items():
        try:
            yield Check(name, *look())
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            yield Check(name, "wrong", f"{where}{error.strerror or error}")
    if address:
        yield from _nodes(address)


def _cores() -> Finding:
    limits_as_text = ", ".join(f"{name} {count}" for name, count in limits().items())
    return "ok", f"{usable_cores()} for workers ({limits_as_text}; the host has {os.cpu_count()})"


def _memory() -> Finding:
    free = psutil.virtual_memory().available
    for name in ("memory.max", "memory.limit_in_bytes"):
        limits = (int(text) for (text,) in settings("memory", name) if text.isdecimal())
        free = min(free, *limits, free)
    return _enough(free, LEAST_MEMORY, "a run needs", "fewer workers need less")


def _shared_memory() -> Finding:
    free = shutil.disk_usage("/dev/shm").free  # noqa: S108  looked at, not written to
    return _enough(free, LEAST_SHARED, "Ray needs", "start the container with --shm-size=1g")


def _enough(free: float, least: float, who: str, what: str) -> Finding:
    if free < least:
        return "wrong", f"{free / 1e9:.2f} GB, and {who} {least / 1e9:.2f}: {what}"
    return "ok", f"{free / 1e9:.2f} GB free"


def _ray() -> Finding:
    installed = version("ray")
    if tuple(int(part) for part in installed.split(".")[:2]) < LEAST_RAY:
        return (
            "wrong",
            f"{installed}: pages of a browser may run code here (CVE-2025-62593), fixed in 2.52",
        )
    return "ok", installed


def _ports() -> Finding:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), timeout=5):
            return "ok", "a port of this machine can be opened and reached"


def _results(results: Path) -> Finding:
    """Whether files in the folder for runs can be written, flushed, replaced and locked."""
    above = (results.absolute(), *results.absolute().parents)
    folder = next(path for path in above if path.is_dir())
    doing = "written"
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".doctor-") as temporary:
            path, other = Path(temporary) / "path", Path(temporary) / "other"
            with path.open("w", encoding="ascii") as file:
                file.write("written")
                file.flush()
                doing = "flushed (fsync)"
                os.fsync(file.fileno())
            doing = "replaced"
            path.replace(other)
            doing = "locked (flock)"
            try_lock(other)
    except OSError as error:
        reason = error.strerror or error
        return "wrong", f"files in {folder} cannot be {doing}: {reason}; runs need another folder"
    free = shutil.disk_usage(folder).free
    text = f"{folder}: files can be flushed and locked, {free / 1e9:.1f} GB free"
    return ("ok" if free > LEAST_DISK else "note"), text


def _nodes(address: str) -> Iterator[Check]:
    # Imported here: without a cluster nothing of this module needs Ray.
    from pfdist.pools.ray_cluster import describe_nodes  # noqa: PLC0415

    here = {"Python": platform.python_version(), "pfdist": version("pfdist")}
    try:
        nodes = describe_nodes(address)
    except PfdistError as error:
        yield Check("cluster", "wrong", str(error))
        return
    for node in nodes:
        differs = [
            f"{what} {node[what.lower()]}, and {mine} here: every node must have the same"
            for what, mine in here.items()
            if node[what.lower()] != mine
        ]
        text = "; ".join(differs) or f"Python {node['python']}, pfdist {node['pfdist']}"
        yield Check(f"node {node['host']}", "wrong" if differs else "ok", text)
