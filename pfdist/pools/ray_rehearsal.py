"""Tries to join a Ray cluster in a separate process.

Ray waits for minutes if nobody answers, writes its log on standard error meanwhile, and may never
return. Here this happens to a process whose output nobody sees, and which the kernel ends in time.
"""

import json
import logging
import os
import signal
import socket
import subprocess
import sys

from pfdist.common.stopping import check, sleep
from pfdist.errors import PoolError
from pfdist.pools.guard import python_command

ANSWER_SECONDS = 18  # after Ray is imported
LOAD_SECONDS = 120
CONNECT_SECONDS = 5.0
LEAVE_SECONDS = 5
_PAUSE_SECONDS = 0.01  # between two looks at the trial
_SHOWN = 300  # characters of what Ray says
_SHOWN_ADDRESS = 80


def rehearse(address: str) -> None:
    """Try to join a Ray cluster at host:port, ray://host:port, or auto.

    Raises `PoolError` if the cluster cannot be joined; the error says why.
    """
    with subprocess.Popen(  # noqa: S603  this file
        python_command(__name__, address), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as trial:
        while trial.poll() is None:  # its answer is short; the guard ends a trial that is left
            sleep(_PAUSE_SECONDS)
        answer, _ = trial.communicate()
    check()  # the trial may have received the signal, too
    if not answer:
        raise PoolError(
            f"no answer from a Ray cluster in {ANSWER_SECONDS} s; it may want another token "
            "(RAY_AUTH_MODE, RAY_AUTH_TOKEN), or a node on this machine (ray start --address=...)"
            if trial.returncode == -signal.SIGALRM
            else f"Ray ended with code {trial.returncode} as it joined the cluster"
        )
    if refusal := json.loads(answer):
        raise PoolError(refusal)


def main() -> None:
    """Print why the cluster at the address in the command line cannot be joined; "" if it can."""
    answer = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LOAD_SECONDS)
    refusal = ""
    try:
        _join(sys.argv[1])
    except Exception as error:
        refusal = reason(error)
    os.write(answer, json.dumps(refusal).encode() + b"\n")
    os.close(answer)
    _leave()


def _join(address: str) -> None:
    reach(address)
    # Imported here: if nobody listens, the answer comes at once, without waiting for the import.
    import ray  # noqa: PLC0415

    signal.alarm(ANSWER_SECONDS)
    ray.init(address=address, log_to_driver=False, logging_level=logging.CRITICAL)


def host_and_port(address: str) -> tuple[str, int]:
    """Host and port of an address; Ray itself resolves ``auto``.

    Raises `PoolError` if it is no address.
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

    Raises `PoolError` if it is no address, or if nobody listens there.
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


def reason(error: Exception) -> str:
    """The text of a Ray error, as one line of bounded length."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def shortened(address: str) -> str:
    """An address in quotes, cut if it is long."""
    shown = _SHOWN_ADDRESS
    return repr(address if len(address) <= shown else f"{address[:shown]}...")


def _leave() -> None:
    """Leave the cluster, if there is one, and end this process."""
    signal.alarm(LEAVE_SECONDS)
    if (ray := sys.modules.get("ray")) is not None:
        ray.shutdown()
    os._exit(0)
