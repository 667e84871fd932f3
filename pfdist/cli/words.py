"""How the words of a command line become the arguments of a function.

`WORDS` declares how each parameter is read, by its name, or by ``COMMAND.NAME`` if one command
reads it differently. Most parameters are options, whose names `WORDS` may change (``changes`` is
``--set``). Words without an option are marked in `WORDS`, and some parameters are for Python alone.
"""

import inspect
import pkgutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from cyclopts import Parameter, Token

from pfdist.cli.commands import COMMANDS
from pfdist.common.arguments import columns_argument, sets_argument
from pfdist.common.measurement_times import REGULAR
from pfdist.common.parsing import finite_number, whole_number, whole_numbers
from pfdist.common.plugins import added
from pfdist.errors import shown
from pfdist.pools.kinds import AUTO, POOLS
from pfdist.problem.sweep_points import values_by_key

T = TypeVar("T")


def shown_default(value: Any) -> str | None:
    """A default as the help shows it: a number or a word."""
    is_shown = isinstance(value, int | float | str) and not isinstance(value, bool)
    return str(value) if is_shown and value else None


# Words are no JSON.
_PLAIN = Parameter(negative=(), json_list=False, json_dict=False, show_default=shown_default)
_PYTHON_ALONE = {"say", "progress", "figures", "points"}


class Word(NamedTuple):
    """How a parameter is read.

    Parameters
    ----------
    kind : type
        The type of the parameter for cyclopts; shells complete files for `Path`.
    settings : Parameter
        How cyclopts reads it.
    stands_alone : bool
        Whether the word stands alone, without the name of an option.
    """

    kind: Any
    settings: Parameter
    stands_alone: bool = False


def _each(read: Callable[[str], T]) -> Callable[[Any, Sequence[Token]], T]:
    """A converter of a parameter that is one word."""
    return lambda _, tokens: read(tokens[0].value)


def _all(read: Callable[[list[str]], T]) -> Callable[[Any, Sequence[Token]], T]:
    """A converter of a parameter that is given once for each of its words."""
    return lambda _, tokens: read([token.value for token in tokens])


def _file(metavar: str) -> Word:
    return Word(Path, Parameter(metavar=metavar, converter=_each(_path)), stands_alone=True)


def _folder(metavar: str) -> Word:
    return Word(Path | None, Parameter(metavar=metavar, converter=_each(_path)))


def _text(metavar: str) -> Word:
    return Word(str | None, Parameter(metavar=metavar))


def _number(metavar: str, read: Callable[[str], Any] = whole_number) -> Word:
    return Word(Any, Parameter(metavar=metavar, converter=_each(read)))


def _texts(metavar: str, read: Callable[[list[str]], Any] = list, **settings: Any) -> Word:
    settings = {"n_tokens": -1, **settings}
    return Word(Any, Parameter(metavar=metavar, converter=_all(read), **settings))


def _path(text: str) -> str:
    """A path; an empty word is none: the current folder is ``.``."""
    if not text.strip():
        raise ValueError(f"must be a path, got {shown(text)}")
    return text


def _paths(texts: list[str]) -> list[str]:
    return [_path(text) for text in texts]


def _decimal(text: str) -> int | float | str:
    """A number, or a text that may be a date; a whole number without a point is an int."""
    try:
        return whole_number(text) if text.lstrip("+-").isdigit() else finite_number(text)
    except ValueError:
        return text


def _part(text: str) -> tuple[int, int]:
    """The numbers of ``3/200``; `SweepJob.part` checks them."""
    number, _, parts = text.partition("/")
    try:
        return whole_number(number), whole_number(parts)
    except ValueError as error:
        raise ValueError(f"must be K/N, as 3/200, got {shown(text)}") from error


def _sets_or_one(texts: list[str]) -> dict[str, str]:
    """Sets as `sets_argument` gives them; a single set needs no name."""
    if len(texts) > 1 or "=" in texts[0] or texts == [REGULAR]:
        return sets_argument(texts)
    return {"": texts[0]}


def _search() -> Word:
    # Not above: an installed search that cannot be loaded must not break other commands.
    from pfdist.problem.methods import METHODS  # noqa: PLC0415

    return Word(str | None, Parameter(metavar="METHOD", choices=tuple(METHODS)))


_SWITCH = Word(bool, Parameter())
WORDS: dict[str, Word | Callable[[], Word]] = {
    "address": _text("HOST:PORT"),
    "against": _texts("TIMES"),
    "also": _text("CRITERIA"),
    "block": _number("K"),
    "bound_draws": _number("K"),
    "browser": Word(bool, Parameter(negative="--no-browser")),
    "columns": Word(Any, Parameter(metavar="NAME=COLUMN", converter=_each(columns_argument))),
    "changes": _texts("KEY=VALUE", name="--set", consume_multiple=1),
    "data": _file("DATA"),
    "draws": _number("K"),
    "export": _folder("FILE"),
    "folder": _file("DIR"),
    "horizon": _number("T"),
    "job": _file("JOB"),
    "measurements": _file("MEASUREMENTS"),
    "memory": _number("MIB"),
    "model": _file("MODEL"),
    "name": Word(str, Parameter(metavar="NAME"), stands_alone=True),
    "now": _number("T", _decimal),
    "out": _folder("PATH"),
    "over": _texts("KEY=VALUES", values_by_key),
    "part": Word(Any, Parameter(metavar="K/N", converter=_each(_part))),
    "particles": _number("P"),
    "planned": _text("NAME"),
    "pool": Word(str | None, Parameter(metavar="POOL", choices=(AUTO, *POOLS))),
    "port": _number("PORT"),
    "prior": _folder("FILE"),
    "report": Word(bool | None, Parameter(negative="--no-report")),
    "replicate": _text("COLUMN"),
    "results": _folder("DIR"),
    "reuse": Word(list[Path], Parameter(metavar="RUN", converter=_all(_paths))),
    "run": _file("RUN"),
    "runs": _file("RUN"),
    "search": _search,
    "seed": _number("S"),
    "shell": Word(
        str, Parameter(metavar="SHELL", choices=("bash", "zsh", "fish")), stands_alone=True
    ),
    "target": _number("MSE", finite_number),
    "times": _texts("TIMES", sets_argument),
    "window": _number("K"),
    "within": _number("GAP", finite_number),
    "work": _number("STEPS", finite_number),
    "workers": _number("N"),
    "backtest.within": _number("TIME", finite_number),
    "filter.within": _number("TIME", finite_number),
    "next.within": _number("TIME", finite_number),
    "budget.measurements": Word(
        Any, Parameter(metavar="NUMBERS", converter=_each(lambda text: set(whole_numbers(text))))
    ),
    "table.runs": Word(
        Path, Parameter(metavar="RUN", converter=_each(_path), required=True), stands_alone=True
    ),
    "evaluate.times": _texts("TIMES", _sets_or_one),
    "simulate.out": Word(Path, Parameter(metavar="FILE", converter=_each(_path), required=True)),
    "check-model.times": _text("TIMES"),
}
"""The words of each parameter by its name, or by its command and its name; others are switches."""


class Line(NamedTuple):
    """A command line as it was read: a function, its arguments, and how its answer is shown."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    json: bool
    verbose: bool
    debug: bool


FLAGS = {
    "json": "Print one JSON object and no text.",
    "verbose": "Also print details: all sets of times, what each search estimated, pairs, a "
    "methods paragraph.",
    "debug": "Show the traceback of an error.",
}
"""Options of every command."""


def __getattr__(name: str) -> Callable[..., Line]:
    """The command of a name, with the parameters of its function and the help of its docstring.

    It reads a `Line` and calls nothing. cyclopts imports commands by such names.
    """
    if name not in COMMANDS:
        raise AttributeError(name)
    function = pkgutil.resolve_name(COMMANDS[name].function)
    parameters = [
        _as_word(name, each)
        for each in inspect.signature(function).parameters.values()
        if each.name not in _PYTHON_ALONE
    ]
    signature = inspect.Signature(sorted(parameters, key=lambda each: each.kind))
    flags = [
        inspect.Parameter(
            flag, inspect.Parameter.KEYWORD_ONLY, default=False,
            annotation=Annotated[bool, Parameter(negative=(), show_default=False, help=text)],
        )
        for flag, text in FLAGS.items()
    ]  # fmt: skip

    def read(
        *arguments: Any,
        json: bool = False,
        verbose: bool = False,
        debug: bool = False,
        **options: Any,
    ) -> Line:
        given = signature.bind(*arguments, **options)
        given.apply_defaults()
        return Line(name, function, given.args, given.kwargs, json, verbose, debug)

    whole = signature.replace(parameters=[*signature.parameters.values(), *flags])
    read.__doc__ = getattr(function, "described", function.__doc__)
    read.__signature__ = whole  # type: ignore[attr-defined]
    read.__annotations__ = {each.name: each.annotation for each in whole.parameters.values()}
    return read


def word_of(command: str, parameter: inspect.Parameter) -> Word:
    """How a parameter of a command is read; a KeyError if no table has it."""
    for table in (WORDS, *added("words")):
        if found := table.get(f"{command}.{parameter.name}") or table.get(parameter.name):
            return found if isinstance(found, Word) else found()
    if isinstance(parameter.default, bool):
        return _SWITCH
    raise KeyError(parameter.name)


def _as_word(command: str, parameter: inspect.Parameter) -> inspect.Parameter:
    word = word_of(command, parameter)
    if parameter.kind is not parameter.VAR_POSITIONAL:
        kind = parameter.POSITIONAL_ONLY if word.stands_alone else parameter.KEYWORD_ONLY
        parameter = parameter.replace(kind=kind)
    settings = Parameter.combine(_PLAIN, word.settings)
    return parameter.replace(annotation=Annotated[word.kind, settings])
