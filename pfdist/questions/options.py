"""Options that all computing functions share: where they compute, and what they show."""

import contextlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from typing import Annotated, Any, ParamSpec, TypedDict, TypeVar

from pydantic import Field

from pfdist.common.arguments import names_argument
from pfdist.common.nearest import did_you_mean
from pfdist.common.section import Arguments, Whole
from pfdist.errors import ArgumentError
from pfdist.runner.progress import Say, Show, silent

ComparedDraws = Annotated[Whole, Field(ge=2, le=100_000_000)]
"""A number of draws, at most as many as a comparison may have."""


@contextlib.contextmanager
def following(progress: Show | bool | None, say: Say) -> Iterator[tuple[Show, Say]]:
    """The functions that receive the progress and the messages of a computation.

    Parameters
    ----------
    progress : callable, bool or None
        True shows progress and messages: a bar in a terminal, a line in a notebook, else a line
        every few seconds. False shows nothing. None shows the progress of a computation that
        takes longer than five seconds in a terminal or a notebook. A callable receives each
        `pfdist.runner.progress.Progress`.
    say : callable
        Receives the messages, line by line.
    """
    # A process without a terminal and a notebook loads no rich.
    wanted = (sys.stderr.isatty() or "IPython" in sys.modules) if progress is None else progress
    if not isinstance(wanted, bool):
        yield wanted, say
    elif not wanted:
        yield lambda state: None, say
    else:
        from pfdist.questions.display import LINE_SECONDS, Display  # noqa: PLC0415  rich takes long to load

        with Display(after=LINE_SECONDS if progress is None else 0.0) as display:
            yield display.show, display.say if progress and say is silent else say


Names = str | Sequence[str]
"""Names in a text with commas, or in a list."""


def criteria_in(also: Names | None) -> list[str] | None:
    """The names of criteria in a text, as in ``worst_instant,quantile 0.9``, or in a list."""
    return None if also is None else names_argument("also", also)


P = ParamSpec("P")
R = TypeVar("R")
_PLACE = "options\n    See `Options`."


class Options(TypedDict, total=False):
    """Options of every function that computes a run; editors complete them.

    pool : str, optional
        Where tasks are computed: by Ray's workers (``ray``), in ``processes`` or on ``threads`` of
        this machine, or one after another (``serial``). The default is execution.pool of the job:
        with ``auto``, by Ray if a cluster is given, in processes if formulas are not compiled, else
        on threads.
    workers : int, optional
        Number of workers, at most 1,000 on one machine; 0 is one for each core. The default is
        execution.workers of the job.
    address : str, optional
        The Ray cluster to join, as HOST:PORT; ``auto`` finds one, ``local`` starts one here. The
        default is execution.address of the job.
    figures : bool
        Whether to draw the figures that the folder lacks.
    report : bool, optional
        Whether to write ``report.html``, one HTML file; by default if figures are drawn, as
        commands do.
    progress : callable or bool, optional
        Whether to show progress and messages, or what receives each
        `pfdist.runner.progress.Progress`. By default a terminal and a notebook show the progress
        from the fifth second on.
    say : callable, optional
        Receives lines: which model files are run, when the pool is ready, which files were
        damaged, why a search was run again, and why there is no lower bound. If it is not given,
        lines that concern the results become a `pfdist.errors.PfdistWarning`.
    """

    pool: str | None
    workers: int | None
    address: str | None
    figures: bool
    report: bool | None
    progress: Show | bool | None
    say: Say


class Chosen(Arguments):
    """The options that a caller chose, and the defaults of the others; see `Options`."""

    pool: str | None = None
    workers: Whole | None = None
    address: str | None = None
    figures: bool = True
    report: bool | None = None
    progress: Show | bool | None = None
    say: Say = silent

    @property
    def execution(self) -> dict[str, Any]:
        """Changes of the job's section [execution]."""
        return {key: getattr(self, key) for key in ("pool", "workers", "address")}

    @property
    def has_report(self) -> bool:
        """Whether a report is written."""
        return self.figures if self.report is None else self.report


def with_options(function: Callable[P, R], without: str = "") -> Callable[P, R]:
    """Name the options in the signature and the docstring of a function that takes ``**options``.

    Its attribute ``described``, the help of its command, describes each of them.

    Parameters
    ----------
    function : callable
    without : str
        Name of an option that the function does not have.

    Raises
    ------
    ArgumentError
        The function has no parameter of a given name; the error names the nearest.
    """
    signature = inspect.signature(function)
    own = [each for each in signature.parameters.values() if each.kind is not each.VAR_KEYWORD]
    added = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=Chosen.model_fields[name].default,
            annotation=kind,
        )
        for name, kind in Options.__annotations__.items()
        if name != without
    ]
    names = [each.name for each in (*own, *added)]

    @wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        for name in named:
            if name not in names:
                nearest = did_you_mean(name, names)
                keys = " (changes=['KEY=VALUE'] changes a key of the job)"
                raise ArgumentError(
                    f"{function.__name__} takes {', '.join(names)}, got {name}{nearest}"
                    f"{keys if 'changes' in names else ''}"
                )
        return function(*arguments, **named)

    call.__signature__ = signature.replace(parameters=[*own, *added])  # type: ignore[attr-defined]
    described = inspect.cleandoc(Options.__doc__ or "").partition("\n\n")[2]
    if without:
        described = re.sub(rf"(?m)^{without} : .*\n(?: .*\n)*", "", described)
    # Python 3.13 strips docstrings of their indentation, earlier versions do not.
    before, _, after = inspect.cleandoc(function.__doc__ or "").partition(_PLACE)
    listed = ", ".join(each.name for each in added)
    see = "Where to compute, and what to show: see `pfdist.Options`."
    call.__doc__ = f"{before}{listed} : options\n    {see}{after}"
    call.described = f"{before}{described}{after}"  # type: ignore[attr-defined]
    return call
