"""A guard: a process that ends everything this command started, if the command is killed.

A command that is killed cannot clean up, and Ray's agents outlive it. So a small process watches
the command and ends everything that carries the command's mark: a variable in the environment of
Ray's servers, which all processes below them inherit. Neither sessions nor process groups nor lost
parents matter. Some of Ray's processes overwrite the mark, and lose their parent at once when the
command is killed. So the guard remembers the processes that it saw below a marked one while the
servers started.
"""

import contextlib
import os
import secrets
import select
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, Self

import psutil
from psutil import Process

_NAME = "PFDIST_STARTED_BY"
_BEGINS, _ENDS = b"(", b")"  # messages to the guard at both ends of `watching`
_LOOK_SECONDS = 0.5  # between two checks whether the command still lives
_QUIET_SECONDS = 0.5  # for a server that a killed command was just starting
_MOST_SECONDS = 4.0
_PAUSE_SECONDS = 0.05  # between two searches for processes that are to end
_IGNORED = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)


class Guard:
    """Ends all processes that begin in `watching`, at the latest when this process has ended.

    A context manager.
    """

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(  # noqa: S603  this file
            python_command(__name__, self._mark, str(os.getpid())),
            stdin=subprocess.PIPE,  # it closes when this process ends
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # what a terminal sends to this process does not reach it
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """End all processes that began in `watching`, and all that these have started."""
        if self._process is None:
            return
        guard, self._process = self._process, None
        with contextlib.suppress(subprocess.TimeoutExpired):
            guard.communicate(timeout=2 * _MOST_SECONDS)  # the guard acts when its input ends
        if guard.returncode != 0:
            guard.kill()
            guard.wait()
            end_marked(_NAME, self._mark, 0.0, _MOST_SECONDS)

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Mark the processes that begin meanwhile, and all their descendants."""
        with environment({_NAME: self._mark}):
            self._say(_BEGINS)
            try:
                yield
            finally:
                self._say(_ENDS)

    def _say(self, word: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):  # the guard was ended
                os.write(self._process.stdin.fileno(), word)


@contextlib.contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """Change environment variables of this process inside a with statement."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def python_command(module: str, *arguments: str) -> list[str]:
    """The command that calls a module's ``main`` in another Python with the same search path.

    The new process imports nothing from the working directory (``-P``) unless this process does,
    too.
    """
    paths = [path for path in sys.path if path]
    code = f"import sys; sys.path[:] = {paths!r}; from {module} import main; main()"
    return [sys.executable, "-P", "-c", code, *arguments]


def main(arguments: Any = None) -> None:
    """Wait until a process has ended, then end what carries its mark."""
    mark, parent = (arguments or sys.argv)[1:]
    for number in _IGNORED:  # a batch system sends them to all processes
        signal.signal(number, signal.SIG_IGN)
    marked_processes: list[Process] = []
    watching = False
    while os.getppid() == int(parent):
        message = os.read(0, 64) if select.select([0], [], [], _LOOK_SECONDS)[0] else None
        if message == b"":
            break
        if watching or message:
            marked_processes = marked(_NAME, mark, marked_processes)
        if message:
            watching = message.endswith(_BEGINS)
    quiet = 0.0 if os.getppid() == int(parent) else _QUIET_SECONDS
    end_marked(_NAME, mark, quiet, _MOST_SECONDS, marked_processes)


def marked(name: str, value: str, earlier: Collection[Process] = ()) -> list[Process]:
    """The processes that began with a variable of this value, and all processes below them.

    Children inherit such a mark, even if another process adopts them. But Ray's agents overwrite
    their environment with their titles, so they are found below the server that started them. This
    server may have ended meanwhile: therefore `earlier` has the processes of an earlier call.
    """
    mark = f"{name}={value}".encode()
    everyone = [
        process
        for process in psutil.process_iter(["ppid", "status"])
        if process.info["status"] != psutil.STATUS_ZOMBIE
    ]
    belonging = [process for process in everyone if process in earlier or _has_mark(process, mark)]
    for process in belonging:  # the list grows while it is walked
        children = (child for child in everyone if child.info["ppid"] == process.pid)
        belonging += [child for child in children if child not in belonging]
    return belonging


def end(processes: Iterable[Process]) -> None:
    """Kill the processes that still live, because a stopped process obeys no other signal."""
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()  # psutil spares a later process that has the same number


def end_marked(
    name: str, value: str, quiet: float, most: float, processes: Collection[Process] = ()
) -> None:
    """End all processes with a mark, and those that begin meanwhile; see `marked`.

    The search ends when it has found no such process for `quiet` seconds, and in any case after
    `most` seconds.
    """
    start = last = time.monotonic()
    while (now := time.monotonic()) - start <= most:
        if processes := marked(name, value, processes):
            last = now
            end(processes)
        elif now - last >= quiet:
            return
        time.sleep(_PAUSE_SECONDS)


def _has_mark(process: Process, mark: bytes) -> bool:
    """Whether the environment holds ``name=value``; psutil stops at zeros that a title leaves."""
    try:
        return mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
    except OSError:  # the process has ended, or belongs to another user
        return False
