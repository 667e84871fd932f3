"""A guard: a process that ends everything this command started, if the command is killed.

A command that is killed cannot clean up, and Ray's agents outlive it. So a small process watches
the command and ends everything that carries the command's mark: a variable in the environment
with which Ray's servers begin, and which all processes below them inherit. Neither sessions nor
process groups nor lost parents matter.
"""

import contextlib
import os
import secrets
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, Self

from pfdist.pools.processes import end_marked

_NAME = "PFDIST_STARTED_BY"
_LOOK_SECONDS = 0.5  # between two checks whether the command still lives
_QUIET_SECONDS = 0.5  # for a server that a killed command was just starting
_MOST_SECONDS = 4.0
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
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def end(self) -> None:
        """End all processes that began in `watching`, and all that these have started."""
        end_marked(_NAME, self._mark, 0.0, _MOST_SECONDS)

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Mark the processes that begin meanwhile, and all their descendants."""
        with environment({_NAME: self._mark}):
            yield


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
    """Give the command that calls a module's ``main`` in another Python, found where this one is.

    Nothing is imported from the working directory (``-P``) unless this process does so too.
    """
    paths = [path for path in sys.path if path]
    code = f"import sys; sys.path[:] = {paths!r}; from {module} import main; main()"
    return [sys.executable, "-P", "-c", code, *arguments]


def main(arguments: Any = None) -> None:
    """Wait until a process has ended, then end what carries its mark."""
    mark, parent = (arguments or sys.argv)[1:]
    for number in _IGNORED:  # a batch system sends them to everyone
        signal.signal(number, signal.SIG_IGN)
    while os.getppid() == int(parent):
        if select.select([sys.stdin], [], [], _LOOK_SECONDS)[0]:
            break
    end_marked(_NAME, mark, _QUIET_SECONDS, _MOST_SECONDS)
