"""Protects this process from side effects of Ray: signals, open folders, endless calls."""

import contextlib
import os
import signal
import stat
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from pfdist.errors import PoolError

LONGEST_FOLDER = 38  # a socket's path has 107 characters, of which Ray needs 69


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Let signals wait inside a with statement, because a half-started Ray cannot be left.

    The program's handlers are called at the end; a second signal does not wait.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    handlers: dict[int, Any] = {}

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if len(received) > 1:
            handlers[number](number, frame)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
        if callable(handler := signal.getsignal(number)):
            handlers[number] = handler
            signal.signal(number, note)
    try:
        yield
    finally:
        for caught, handler in handlers.items():
            if signal.getsignal(caught) is note:  # a handler may have changed it
                signal.signal(caught, handler)
        if received:  # Ray's own handler of SIGTERM sets an alarm that ends the process after 3 s
            signal.alarm(0)
        if len(received) == 1:
            handlers[received[0]](received[0], None)


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
