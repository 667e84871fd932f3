"""All errors of pfdist, and how messages show values, texts and paths.

::

    PfdistError                     message of one line: what, got, allowed, where
    ├── JobError                    a value in a job, or of an option, is wrong
    ├── ArgumentError               an argument that is not a job key is wrong; also a ValueError
    ├── ModelError                  a model cannot be loaded, or a formula is wrong
    │   └── TraceError              a formula cannot be traced
    ├── MeasurementTimesError       measurement times or their constraints are wrong
    ├── MeasurementsError           measured values or their table are wrong
    ├── PriorError                  particles from which a filter starts are wrong
    ├── StoreError                  a run's folder cannot be read or written
    │   ├── BusyError               another process is computing the run
    │   └── RunMismatchError        the folder holds a different run
    ├── SearchError                 a search found no usable set
    ├── MissingExtraError           a library of an extra is missing; also a ModuleNotFoundError
    ├── SweepError                  some points of a sweep failed; the others are finished
    └── PoolError                   workers cannot be started
        ├── SilenceError            workers no longer answer
        └── TaskError               a task failed in its worker; carries the traceback

    PfdistWarning                   results are incomplete, or the model may be wrong
    └── EngineWarning               a model is batched, or compiled code is not kept
"""

import os
import re
import reprlib
from typing import Any

_SHOWN = 8  # largest number of differences of two runs in a message
_LONGEST = 80  # largest number of characters of a value in a message


class _Shortener(reprlib.Repr):
    """Shortens values, even whole numbers of thousands of digits, which Python does not write."""

    def repr_int(self, x: int, level: int) -> str:
        if x.bit_length() > 4 * _LONGEST:
            return f"a whole number of {x.bit_length():,} bits"
        return super().repr_int(x, level)


_shortener = _Shortener()
_shortener.maxstring = _shortener.maxother = _shortener.maxlong = _LONGEST
_shortener.maxlevel = 3


def shown(value: Any) -> str:
    """A value as messages show it: its Python form, without the middle of a long value.

    The value comes from a file or the command line, and may have any size and depth.

    >>> shown("fresh"), shown([1, 2, 3])
    ("'fresh'", '[1, 2, 3]')
    >>> shown("x" * 3_000_000).count("x") < 100
    True
    """
    return shown_text(_shortener.repr(value))


def shown_text(text: str) -> str:
    """A text as messages show it: without the middle of a long text."""
    return text if len(text) <= 3 * _LONGEST else f"{text[: 2 * _LONGEST]}...{text[-_LONGEST:]}"


_started = ""  # the folder in which the program was started


def started_in(folder: str) -> None:
    """Show paths relative to this folder, even if a model leaves it; "" for the working folder."""
    global _started  # noqa: PLW0603  a process has one working folder, too
    _started = folder


def relative(text: str) -> str:
    """A text whose paths below the folder of the program's start are relative to that folder.

    >>> relative(f"no run in {os.getcwd()}/results/a"), relative("no run in /elsewhere")
    ('no run in results/a', 'no run in /elsewhere')
    """
    try:
        folder = _started or os.getcwd()
    except OSError:  # it was removed
        return text
    if folder == "/" or folder not in text:
        return text
    paths = rf"(?<![\w./-]){re.escape(folder)}(?:(/)|(?![\w./-]))"
    return re.sub(paths, lambda match: "" if match[1] else ".", text)


def one_line(text: str) -> str:
    r"""A text as one line without control characters, which a path or a table may contain.

    >>> one_line("results/a\nb"), one_line("results/\x1b[2J")
    ('results/a b', 'results/?[2J')
    """
    return " ".join(printable(text).splitlines())


def reason_of(error: BaseException) -> str:
    """The message of an error in a line; after the name of its type, if pfdist did not expect it.

    >>> reason_of(StoreError("no run")), reason_of(KeyError("a"))
    ('no run', "KeyError: 'a'")

    The messages of pfdist are whole, however long a path in them is.

    >>> len(reason_of(StoreError("no run in " + 300 * "a")))
    310
    """
    expected = isinstance(error, PfdistError)
    return one_line(str(error) if expected else shown_text(f"{type(error).__name__}: {error}"))


def printable(text: str) -> str:
    """A text as outputs show it: with relative paths, and no control characters but line breaks."""
    text = relative(text)
    return text if text.isprintable() else "".join(map(_printable, text))


def _printable(character: str) -> str:
    byte_of_a_path = "\udc80" <= character <= "\udcff"  # a byte that is not UTF-8
    if character.isprintable() or byte_of_a_path or character == "\n":
        return character
    return " " if character.isspace() else "?"


class PfdistError(Exception):
    """Base class of all errors of pfdist; the command line prints one line, and ends with 1 or 75.

    Parameters
    ----------
    message : str
        The error in one line, for Python and the command line.
    argument : str
        Name of the wrong argument, if there is one. The line then begins with its option.
    """

    def __init__(self, message: str = "", *, argument: str = "") -> None:
        super().__init__(one_line(message))
        self.argument = argument


class JobError(PfdistError):
    """A value in a job, or of an option that replaces one, is wrong."""


class ArgumentError(PfdistError, ValueError):
    """An argument of a function that is not a key of a job is wrong."""


class ModelError(PfdistError):
    """A model cannot be loaded, or one of its formulas is wrong."""


class TraceError(ModelError):
    """A formula of a model cannot be traced."""


class MeasurementTimesError(PfdistError):
    """Measurement times, or constraints on them, are wrong."""


class MeasurementsError(PfdistError):
    """Measured values, or a table of them, are wrong."""


class PriorError(PfdistError):
    """Particles from which draws and filters start are wrong."""


class StoreError(PfdistError):
    """A run's folder cannot be read or written."""


class BusyError(StoreError):
    """Another process is computing the run."""


class RunMismatchError(StoreError):
    """The folder holds the run of a different job, model or version.

    Parameters
    ----------
    message : str
    differences : tuple of str
        One line for each field: ``field: the run's value -> this value``.
    """

    def __init__(self, message: str, differences: tuple[str, ...]) -> None:
        shown_differences = "; ".join(differences[:_SHOWN])
        more = f"; and {len(differences) - _SHOWN} more" if len(differences) > _SHOWN else ""
        super().__init__(f"{message}: {shown_differences}{more}")
        self.differences = differences


class SearchError(PfdistError):
    """A search found no usable set of times."""


class MissingExtraError(PfdistError, ModuleNotFoundError):
    """A library of an extra is not installed.

    Parameters
    ----------
    needed_by : str
        A name for users of that which needs the extra.
    extra : str
        Name of the extra.
    library : str
        The missing library.
    """

    def __init__(self, needed_by: str, extra: str, library: str | None) -> None:
        super().__init__(f"{needed_by} needs pip install -e '.[{extra}]', got no {library}")


class SweepError(PfdistError):
    """Some points of a sweep failed; the others are finished.

    Parameters
    ----------
    message : str
        The first failures, each with the name of the point.
    failed : dict of str to str
        Why each point failed, by its name.
    """

    def __init__(self, message: str, failed: dict[str, str]) -> None:
        super().__init__(message)
        self.failed = failed


class PoolError(PfdistError):
    """Workers cannot be started."""


class SilenceError(PoolError):
    """Workers no longer answer. Finished work is saved; the same command resumes."""


class TaskError(PoolError):
    """A task failed in its worker.

    Parameters
    ----------
    message : str
    traceback : str
        The traceback in the worker.
    """

    def __init__(self, message: str, traceback: str) -> None:
        super().__init__(message)
        self.traceback = traceback


class PfdistWarning(UserWarning):
    """A warning about results: they are incomplete, or the model may be wrong.

    Parameters
    ----------
    message : str
        The warning in one line.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class EngineWarning(PfdistWarning):
    """A warning about how a run computes: a model is batched, or compiled code is not kept."""
