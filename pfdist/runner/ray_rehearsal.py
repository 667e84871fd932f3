"""Join a Ray cluster on trial, in a process of its own.

Ray waits for minutes where nobody answers, writes its log on standard error meanwhile, and may
never return. Here this happens to a process that nobody sees, and that the kernel ends in time.
"""

import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from pfdist.errors import PoolError
from pfdist.runner.guard import python_command

ANSWER_SECONDS = 25  # from the moment at which Ray is loaded
LOAD_SECONDS = 120
CONNECT_SECONDS = 5.0
LEAVE_SECONDS = 5
_SHOWN = 300  # characters of what Ray says


def rehearse(address: str) -> bool:
    """Try to join a Ray cluster.

    Parameters
    ----------
    address : str
        host:port, ray://host:port, or auto.

    Returns
    -------
    bool
        Whether the cluster listens on loopback alone.

    Raises
    ------
    PoolError
        The cluster cannot be joined.
    """
    with subprocess.Popen(  # noqa: S603  this file
        python_command(__name__, address), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as trial:
        assert trial.stdout is not None  # noqa: S101  for mypy
        answer = trial.stdout.readline()
    if not answer:
        raise PoolError(
            f"no answer from a Ray cluster in {ANSWER_SECONDS} s; besides the cluster, there must "
            "be a node of the cluster on this machine (ray start --address=...)"
            if trial.returncode == -signal.SIGALRM
            else f"Ray ended with code {trial.returncode} as it joined the cluster"
        )
    found = json.loads(answer)
    if "refusal" in found:
        raise PoolError(found["refusal"])
    return bool(found["loopback"])


def main() -> None:
    """Print whether the cluster at the address in the command line can be joined, and how."""
    answer = os.dup(1)
    with open(os.devnull, "w") as nowhere:  # noqa: PTH123
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LOAD_SECONDS)
    try:
        found = {"loopback": _join(sys.argv[1])}
    except Exception as error:
        found = {"refusal": reason(error)}
    os.write(answer, json.dumps(found).encode() + b"\n")
    os.close(answer)
    _leave()


def _join(address: str) -> bool:
    host, port = _host_and_port(address)
    if port:
        _connect(host, port)
    # Here and not above: where nobody listens, this is said at once.
    import ray  # noqa: PLC0415

    signal.alarm(ANSWER_SECONDS)
    loopback = "://" not in address and _is_loopback_alone(ray, address)
    with only_loopback(ray, loopback):
        ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)
    return loopback


def _host_and_port(address: str) -> tuple[str, int]:
    """Take an address apart; Ray itself finds out what ``auto`` is."""
    if address == "auto":
        return "", 0
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not (host and port.isascii() and port.isdecimal() and 0 < int(port[:9]) < 2**16):
        raise PoolError("an address must be host:port, ray://host:port, auto or local")
    return host.strip("[]"), int(port)


def _connect(host: str, port: int) -> None:
    try:
        socket.create_connection((host, port), timeout=CONNECT_SECONDS).close()
    except TimeoutError as error:
        raise PoolError(
            f"nobody answers at {host}:{port} within {CONNECT_SECONDS:.0f} s"
        ) from error
    except (OSError, UnicodeError) as error:
        said = getattr(error, "strerror", None) or error
        raise PoolError(f"nobody can be reached at {host}:{port}: {said}") from error


def _is_loopback_alone(ray: Any, address: str) -> bool:
    """Whether a cluster is heard at 127.0.0.1, and not at this machine's address.

    Ray takes the latter for the former, unless it is told to stay on loopback.
    """
    refusal: PoolError | None = None
    for loopback in (False, True):
        with only_loopback(ray, loopback):
            place = ray._private.services.canonicalize_bootstrap_address(address)
        try:
            _connect(*_host_and_port(place or ""))
        except PoolError as error:
            refusal = refusal or error
        else:
            return loopback
    assert refusal is not None  # noqa: S101  for mypy
    raise refusal


@contextlib.contextmanager
def only_loopback(ray: Any, alone: bool) -> Iterator[None]:
    """Have Ray take 127.0.0.1 for this machine's address, so that what it starts listens there.

    Ray does so by itself where it builds no clusters, on macOS and Windows.

    Parameters
    ----------
    ray : module
    alone : bool
        If not, nothing changes.
    """
    constants, name = ray._private.ray_constants, "ENABLE_RAY_CLUSTER"
    before = getattr(constants, name, True)
    setattr(constants, name, before and not alone)
    try:
        yield
    finally:
        setattr(constants, name, before)


def reason(error: Exception) -> str:
    """Give what an error of Ray says, in one line of bounded length."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= _SHOWN else f"{said[:_SHOWN]}..."


def _leave() -> None:
    """Leave the cluster, if there is one, and end."""
    signal.alarm(LEAVE_SECONDS)
    if (ray := sys.modules.get("ray")) is not None:
        ray.shutdown()
    os._exit(0)
