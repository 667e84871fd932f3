"""Every error that pfdist raises on purpose.

::

    PfdistError                     one line: what, got, allowed, where
    ├── JobError                    the job file or an option says something impossible
    ├── ModelError                  a model cannot be loaded, or does not do what a model must
    │   └── CompileError            Numba cannot compile a formula
    ├── MeasurementTimesError       the measurement times do not fit the problem
    ├── StoreError                  a run's folder cannot be read or written
    │   └── RunMismatchError        the folder holds a run of something else
    ├── SearchError                 a search ended without an answer
    └── PoolError                   the workers cannot be had
        └── TaskError               a task failed in its worker; carries the traceback

    EngineWarning                   a model is computed in NumPy, or compiled code is not kept
"""

import reprlib
from typing import Any

_SHOWN = 8  # differences of two runs
_LONGEST = 80  # characters of a value that an error shows


class _Shortener(reprlib.Repr):
    """Cuts values, also whole numbers of thousands of digits, which Python does not write."""

    def repr_int(self, x: int, level: int) -> str:
        if x.bit_length() > 4 * _LONGEST:
            return f"a whole number of {x.bit_length():,} bits"
        return super().repr_int(x, level)


_shortener = _Shortener()
_shortener.maxstring = _shortener.maxother = _shortener.maxlong = _LONGEST
_shortener.maxlevel = 3


def shown(value: Any) -> str:
    """Give a value as an error shows it: as Python writes it, without the middle of a long one.

    Parameters
    ----------
    value : object
        From a file or the command line: of any size and depth.

    Examples
    --------
    >>> shown("fresh"), shown([1, 2, 3])
    ("'fresh'", '[1, 2, 3]')
    >>> shown("x" * 3_000_000).count("x") < 100
    True
    """
    return shown_text(_shortener.repr(value))


def shown_text(text: str) -> str:
    """Give a text as an error shows it: without the middle of a long one."""
    return text if len(text) <= 3 * _LONGEST else f"{text[: 2 * _LONGEST]}...{text[-_LONGEST:]}"


def one_line(text: str) -> str:
    r"""Give a text as one line without control characters, which a path or a table may hold.

    Examples
    --------
    >>> one_line("results/a\nb"), one_line("results/\x1b[2J")
    ('results/a b', 'results/?[2J')
    """
    return "".join(map(_printable, text))


def _printable(character: str) -> str:
    byte_of_a_path = "\udc80" <= character <= "\udcff"  # which is not UTF-8
    if character.isprintable() or byte_of_a_path:
        return character
    return " " if character.isspace() else "?"


class PfdistError(Exception):
    """Base of all errors of pfdist; the command line prints it as one line and exits with 1.

    Parameters
    ----------
    message : str
        In words that hold in Python and on the command line.
    argument : str
        The argument that is to be changed, if there is one: the command line names its option.
    """

    def __init__(self, message: str = "", *, argument: str = "") -> None:
        super().__init__(message)
        self.argument = argument


class JobError(PfdistError):
    """The job file, or an option that overrides it, says something impossible."""


class ModelError(PfdistError):
    """A model cannot be loaded, or does not do what a model must."""


class CompileError(ModelError):
    """Numba cannot compile a formula of a model."""


class MeasurementTimesError(PfdistError):
    """The measurement times do not fit the problem."""


class StoreError(PfdistError):
    """A run's folder cannot be read or written."""


class RunMismatchError(StoreError):
    """The folder holds a run of something else.

    Attributes
    ----------
    differences : tuple of str
        One line a field, ``field: the run's value -> this value``.
    """

    def __init__(self, message: str, differences: tuple[str, ...]) -> None:
        told = "; ".join(differences[:_SHOWN])
        more = f"; and {len(differences) - _SHOWN} more" if len(differences) > _SHOWN else ""
        super().__init__(f"{message}: {told}{more}")
        self.differences = differences


class SearchError(PfdistError):
    """A search ended without an answer."""


class PoolError(PfdistError):
    """The workers cannot be had."""


class TaskError(PoolError):
    """A task failed in its worker.

    Attributes
    ----------
    traceback : str
        The traceback as the worker saw it.
    """

    def __init__(self, message: str, traceback: str) -> None:
        super().__init__(message)
        self.traceback = traceback


class EngineWarning(UserWarning):
    """It will take longer: a model is computed in NumPy, or compiled code is not kept."""
