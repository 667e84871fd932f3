"""A file system that goes wrong at one operation of a run: its process is gone, or it says so."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfdist.store import files, tables

_WRITES = ("write_table", "write_text", "write_bytes")


class Ended(BaseException):
    """Stands for a kill: nothing handles it, and no file is touched any more."""


class FileLayer:
    """Counts what is done to files, and goes wrong where it is told to.

    A write that goes wrong leaves half a file.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
    folder : Path
        Files elsewhere, such as the cache of compiled code, are left alone.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.count, self._folder, self._at = 0, folder, -1
        self._fault: str | None = None
        for place, name, needs_space in (
            (tables, "write_table", True),
            (Path, "write_text", True),
            (Path, "write_bytes", True),
            (Path, "mkdir", True),
            (os, "replace", False),
            (os, "unlink", False),
        ):
            operation = getattr(place, name)
            monkeypatch.setattr(place, name, self._counted(operation, needs_space))
        # A flush serves the disk; here it can only go wrong, and takes no time.
        monkeypatch.setattr(files, "_flush", self._counted(lambda path, mode: None, True))

    def run(self, act: Callable[[], Any], fault: str | None = None, at: int = -1) -> int:
        """Act, with a fault at one operation; give how many there were.

        Parameters
        ----------
        act : callable
        fault : {"ended", "ENOSPC", "EIO", "EROFS"}, optional
            Once ended all is; a disk stays full; a folder that cannot be written stays so; a
            failure to read or write comes once.
        at : int
            The operation.
        """
        self.count, self._fault, self._at = 0, fault, at
        try:
            act()
        finally:
            self._fault = None
        return self.count

    def _counted(self, operation: Callable[..., Any], needs_space: bool) -> Callable[..., Any]:
        def counted(*arguments: Any, **options: Any) -> Any:
            paths = [
                Path(argument) for argument in arguments if isinstance(argument, str | os.PathLike)
            ]
            if not paths[0].is_relative_to(self._folder):
                return operation(*arguments, **options)
            self.count += 1
            wrong = self._wrong(needs_space)
            if wrong is None:
                return operation(*arguments, **options)
            if operation.__name__ in _WRITES and not isinstance(wrong, Again):
                fault, self._fault = self._fault, None  # what the operation itself does is real
                before = paths[0].stat().st_size if paths[0].exists() else 0
                operation(*arguments, **options)
                self._fault = fault
                os.truncate(paths[0], (before + paths[0].stat().st_size) // 2)
            raise wrong

        return counted

    def _wrong(self, needs_space: bool) -> BaseException | None:
        number = self.count - 1
        if self._fault is None or number < self._at:
            return None
        if self._fault == "ended":
            return Ended() if number == self._at else Again()
        code = getattr(errno, self._fault)
        stays = self._fault == "EROFS" or (self._fault == "ENOSPC" and needs_space)
        if number == self._at or stays:
            return OSError(code, os.strerror(code))
        return None


class Again(Ended):
    """Once more, after the end."""
