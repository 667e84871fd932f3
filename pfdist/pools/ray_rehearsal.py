"""Tries to join a Ray cluster in a separate process.

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
from pfdist.pools.guard import python_command

ANSWER_SECONDS = 18  # from the moment at which Ray is loaded
LOAD_SECONDS = 120
CONNECT_SECONDS = 5.0
LEAVE_SECONDS = 5
_SHOWN = 300  # characters of what Ray says
_SHOWN_ADDRESS = 80


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
        answer, _ = trial.communicate()
    if not answer:
        raise PoolError(
            f"no answer from a Ray cluster in {ANSWER_SECONDS} s; it may want another token "
            "(RAY_AUTH_MODE, RAY_AUTH_TOKEN), or a node on this machine (ray start --address=...)"
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
    with open(os.devnull, "w") as nowhere:
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LOAD_SECONDS)
    found: dict[str, bool | str]
    try:
        found = {"loopback": _join(sys.argv[1])}
    except Exception as error:
        found = {"refusal": reason(error)}
    os.write(answer, json.dumps(found).encode() + b"\n")
    os.close(answer)
    _leave()


def _join(address: str) -> bool:
    reach(address)
    # Here and not above: where nobody listens, this is said at once.
    import ray  # noqa: PLC0415

    signal.alarm(ANSWER_SECONDS)
    loopback = "://" not in address and _is_loopback_alone(ray, address)
    with only_loopback(ray, loopback):
        ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)
    return loopback


def host_and_port(address: str) -> tuple[str, int]:
    """Give host and port of an address; Ray itself resolves ``auto``.

    Raises
    ------
    PoolError
        It is no address.
    """
    if address == "auto":
        return "", 0
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not (
        host.isprintable()
        and host
        and port.isascii()
        and port.isdecimal()
        and 0 < int(port[:9]) < 2**16
    ):
        raise PoolError(
            "the address of a Ray cluster must be host:port, ray://host:port, auto or local, got "
            f"{shortened(address)}"
        )
    return host.strip("[]"), int(port)


def reach(address: str) -> None:
    """Connect to an address, and send nothing.

    Raises
    ------
    PoolError
        It is no address, or nobody listens there.
    """
    host, port = host_and_port(address)
    if not port:
        return
    where = shortened(f"{host}:{port}")
    try:
        socket.create_connection((host, port), timeout=CONNECT_SECONDS).close()
    except TimeoutError as error:
        raise PoolError(f"nobody answers at {where} in {CONNECT_SECONDS:.0f} s") from error
    except (OSError, UnicodeError) as error:
        said = getattr(error, "strerror", None) or reason(error)
        raise PoolError(f"nobody can be reached at {where}: {said}") from error


def _is_loopback_alone(ray: Any, address: str) -> bool:
    """Whether a cluster is heard at 127.0.0.1, and not at this machine's address.

    Ray takes the latter for the former, unless it is told to stay on loopback.
    """
    places = []
    for loopback in (False, True):
        with only_loopback(ray, loopback):
            places.append(ray._private.services.canonicalize_bootstrap_address(address))
    try:
        reach(places[0])
    except PoolError as error:
        try:
            reach(places[1])
        except PoolError:
            raise error from None
        return True
    return False


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
    """Give the text of a Ray error, as one line of bounded length."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= _SHOWN else f"{said[:_SHOWN]}..."


def shortened(address: str) -> str:
    """Give an address in quotes, cut if it is long."""
    shown = _SHOWN_ADDRESS
    return repr(address if len(address) <= shown else f"{address[:shown]}...")


def _leave() -> None:
    """Leave the cluster, if there is one, and end this process."""
    signal.alarm(LEAVE_SECONDS)
    if (ray := sys.modules.get("ray")) is not None:
        ray.shutdown()
    os._exit(0)
