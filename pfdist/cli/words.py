"""How the words of a command line become the arguments of a function.

`WORDS` declares how each parameter is read, by its name, or by ``COMMAND.NAME`` if one command
reads it differently. Most parameters are options, whose names `WORDS` may change (``changes`` is
``--set``). Words without an option are marked in `WORDS`, and some parameters are for Python alone.
"""

import inspect
import pkgutil
from collections import ChainMap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

from cyclopts import Parameter, Token

from pfdist.cli.commands import COMMANDS
from pfdist.common.arguments import columns_argument, sets_argument
from pfdist.common.measurement_times import REGULAR
from pfdist.common.parsing import finite_number, whole_number
from pfdist.common.plugins import added
from pfdist.errors import shown
from pfdist.pools.kinds import AUTO, POOLS

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


def read_each(read: Callable[[str], T]) -> Callable[[Any, Sequence[Token]], T]:
    """A converter of a parameter that is one word."""
    return lambda _, tokens: read(tokens[0].value)


def read_all(read: Callable[[list[str]], T]) -> Callable[[Any, Sequence[Token]], T]:
    """A converter of a parameter that is given once for each of its words."""
    return lambda _, tokens: read([token.value for token in tokens])


def file_word(metavar: str, *, required: bool | None = None) -> Word:
    """A file or folder that stands alone; by default, one without a default is required."""
    settings = Parameter(metavar=metavar, converter=read_each(_path), required=required)
    return Word(Path, settings, stands_alone=True)


def folder_word(metavar: str, *, required: bool | None = None) -> Word:
    """An option that is a path."""
    settings = Parameter(metavar=metavar, converter=read_each(_path), required=required)
    return Word(Path | None, settings)


def text_word(metavar: str) -> Word:
    """An option that is a text."""
    return Word(str | None, Parameter(metavar=metavar))


def number_word(metavar: str, read: Callable[[str], Any] = whole_number) -> Word:
    """An option that is a number."""
    return Word(Any, Parameter(metavar=metavar, converter=read_each(read)))


def texts_word(metavar: str, read: Callable[[list[str]], Any] = list, **settings: Any) -> Word:
    """An option of several words."""
    settings = {"n_tokens": -1, **settings}
    return Word(Any, Parameter(metavar=metavar, converter=read_all(read), **settings))


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
    "address": text_word("HOST:PORT"),
    "against": texts_word("TIMES"),
    "also": text_word("CRITERIA"),
    "block": number_word("K"),
    "bound_draws": number_word("K"),
    "browser": Word(bool, Parameter(negative="--no-browser")),
    "columns": Word(Any, Parameter(metavar="NAME=COLUMN", converter=read_each(columns_argument))),
    "changes": texts_word("KEY=VALUE", name="--set", consume_multiple=1),
    "data": file_word("DATA"),
    "draws": number_word("K"),
    "export": folder_word("FILE"),
    "folder": file_word("DIR"),
    "horizon": number_word("T"),
    "job": file_word("JOB"),
    "measurements": file_word("MEASUREMENTS"),
    "memory": number_word("MIB"),
    "model": file_word("MODEL"),
    "name": Word(str, Parameter(metavar="NAME"), stands_alone=True),
    "now": number_word("T", _decimal),
    "out": folder_word("PATH"),
    "particles": number_word("P"),
    "planned": text_word("NAME"),
    "pool": Word(str | None, Parameter(metavar="POOL", choices=(AUTO, *POOLS))),
    "port": number_word("PORT"),
    "prior": folder_word("FILE"),
    "report": Word(bool | None, Parameter(negative="--no-report")),
    "replicate": text_word("COLUMN"),
    "results": folder_word("DIR"),
    "reuse": Word(list[Path], Parameter(metavar="RUN", converter=read_all(_paths))),
    "run": file_word("RUN"),
    "runs": file_word("RUN"),
    "search": _search,
    "seed": number_word("S"),
    "shell": Word(
        str, Parameter(metavar="SHELL", choices=("bash", "zsh", "fish")), stands_alone=True
    ),
    "target": number_word("MSE", finite_number),
    "times": texts_word("TIMES", sets_argument),
    "window": number_word("K"),
    "within": number_word("GAP", finite_number),
    "work": number_word("STEPS", finite_number),
    "workers": number_word("N"),
    "evaluate.times": texts_word("TIMES", _sets_or_one),
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
    words = ChainMap(WORDS, *added("words"))
    if found := words.get(f"{command}.{parameter.name}") or words.get(parameter.name):
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
