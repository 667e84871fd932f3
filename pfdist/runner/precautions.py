"""Precautions against what Ray does to the process that starts it. No Ray here."""

import contextlib
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from typing import Any

CONNECT_SECONDS = 10.0
LONGEST_FOLDER = 38  # a socket's path has 107 characters, of which Ray needs 69


@contextlib.contextmanager
def own_sigterm() -> Iterator[None]:
    """Keep this program's way with SIGTERM: Ray takes the signal for itself, and exits."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    except SystemExit:  # Ray's way, while it starts
        if callable(before):
            before(signal.SIGTERM, None)
        raise
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def short_folder() -> str | None:
    """Where Ray keeps its sockets, if its own choice has too long a path for them."""
    folder = os.environ.get("RAY_TMPDIR") or tempfile.gettempdir()
    return None if len(folder) <= LONGEST_FOLDER else f"/tmp/pfdist-ray-{os.getuid()}"  # noqa: S108


def within(seconds: float, function: Callable[[], Any]) -> threading.Thread:
    """Call a function that may never return, and wait for it so long."""
    thread = threading.Thread(target=function, daemon=True)
    thread.start()
    thread.join(seconds)
    return thread


def check_reachable(address: str) -> None:
    """Ray itself waits for minutes where nobody listens."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host, int(port)), timeout=CONNECT_SECONDS).close()
