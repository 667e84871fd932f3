"""The program: its commands, their help, and the messages about wrong words."""

import inspect
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Any

from cyclopts import App, CycloptsError, Token
from cyclopts.argument import Argument
from cyclopts.exceptions import (
    CoercionError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

import pfdist
from pfdist.cli.commands import COMMANDS
from pfdist.common.gone import gone
from pfdist.common.nearest import did_you_mean, must_be
from pfdist.errors import one_line, shown, shown_text
from pfdist.pages.terminal import line_width

if TYPE_CHECKING:  # it is imported with the first command that is read
    from pfdist.cli.words import Line

PROGRAM = (
    "pfdist finds the measurement times at which a particle filter errs least, and proves how good "
    "they are."
)
_BEGIN_WITH = ("plan", "why", "budget")  # commands, in the order in which they are tried
_EXIT_CODES = (
    "Exit codes: 0 done; 1 error; 2 wrong arguments; 130 interrupted by Ctrl-C; "
    "75 ended by SIGTERM or SIGUSR1, which batch systems send, because no worker answers, or "
    "because a library or the model ended the process."
)
_RESUMES = "If it is interrupted, the same command resumes where it stopped. "
_MARGIN = 24  # columns before the meaning of an argument


class Program(App):
    """The command line, whose help is that of `help_of`."""

    def help_print(self, tokens: str | Iterable[str] | None = None, **_: Any) -> None:
        """Print the help of the program, or of the command that some words begin with."""
        names = self.parse_commands(tokens)[0]
        print(help_of(self, *names) if names else help_of_all(self))


def program() -> App:
    """The whole command line; the function of a command is imported when it is chosen."""
    app = Program(
        name="pfdist",
        help=PROGRAM,
        version=f"pfdist {pfdist.__version__}",
    )
    for name, command in COMMANDS.items():
        app.command(f"pfdist.cli.words:{name}", name=name, help=command.sentence)
    return app


def line_of(words: Sequence[str]) -> "Line | None":
    """The command line that some words spell; None if they ask for help or the version.

    Help or version are then printed.

    Raises
    ------
    CycloptsError
        The words are wrong; `complaint` gives the line to print.
    """
    read, given, _ = program().parse_args(words, exit_on_error=False, print_error=False)
    line: Line | None = read(*given.args, **given.kwargs)
    return line


# --- help -----------------------------------------------------------------------------------------


def arguments_of(app: App, name: str) -> Iterator[tuple[str, str]]:
    """Each argument of a command, as it is typed, and what it means."""
    for argument in app[name].assemble_argument_collection(parse_docstring=True):
        meaning = " ".join((argument.parameter.help or "").replace("``", "`").split())
        choices = f" Choices: {', '.join(each)}." if (each := argument.get_choices()) else ""
        default = argument.field_info.default
        is_shown = isinstance(default, int | float | str) and default and default is not True
        yield (
            ", ".join(_spelling(argument)),
            f"{meaning}{choices}" + f" (default: {default})" * bool(is_shown),
        )


def _spelling(argument: Argument) -> list[str]:
    metavar = argument.parameter.metavar or ""
    if argument.index is not None:
        return [metavar]
    return [" ".join(filter(None, [name, metavar])) for name in argument.names]


def usage(app: App, name: str) -> str:
    """A command with its files, and the options that must be given: ``JOB --times TIMES``."""
    words = ["pfdist", name]
    for each in app[name].assemble_argument_collection():
        if each.required:
            words += _spelling(each)[:1]
        elif each.index is not None:
            several = " ..." if each.field_info.kind is inspect.Parameter.VAR_POSITIONAL else ""
            words.append(f"[{_spelling(each)[0]}{several}]")
    return " ".join(words)


def help_of(app: App, name: str) -> str:
    """The help of a command: the text of its docstring, its arguments, and examples."""
    command = COMMANDS[name]
    docstring = inspect.getdoc(app[name].default_command) or ""
    about = docstring.partition("\nParameters\n---")[0].replace("``", "`").strip()
    text = "\n\n".join(fill(" ".join(each.split()), line_width()) for each in about.split("\n\n"))
    rows = _rows([*arguments_of(app, name), ("--help, -h", "Show this help.")])
    notes = fill((_RESUMES if command.resumes else "") + _EXIT_CODES, line_width())
    parts = [
        text,
        f"usage: {usage(app, name)} [options]",
        rows,
        notes,
        examples_text(command.examples),
    ]
    return "\n\n".join(parts)


def help_of_all(app: App) -> str:
    """The help of the program: its commands, and the first to try."""
    rows = _rows((name, command.sentence) for name, command in COMMANDS.items())
    notes = fill(f"`pfdist COMMAND --help` describes a command. {_EXIT_CODES}", line_width())
    commands = f"commands:\n{rows}"
    return "\n\n".join(
        [
            fill(PROGRAM, line_width()),
            "usage: pfdist COMMAND ...",
            commands,
            notes,
            examples_text(_way_in()),
        ]
    )


def _rows(rows: Iterable[tuple[str, str]]) -> str:
    """Two columns: words, and what they mean, beside them or below them."""
    listed = list(rows)
    margin = min(_MARGIN, max(len(words) for words, _ in listed) + 4)
    lines = []
    for words, meaning in listed:
        start = f"  {words}"
        if len(start) > margin - 2:
            lines += wrap(start, line_width(), subsequent_indent="    ", break_on_hyphens=False)
            start = ""
        for text in wrap(meaning, line_width() - margin, break_on_hyphens=False):
            lines.append(f"{start:{margin}}{text}")
            start = ""
    return "\n".join(lines)


def examples_text(examples: Mapping[str, str], title: str = "examples:") -> str:
    """Command lines below what they do."""
    return "\n".join([title, *(f"  # {does}\n  {line}" for line, does in examples.items())])


def _way_in() -> dict[str, str]:
    """The command lines to begin with: the first examples of some commands."""
    return dict(next(iter(COMMANDS[name].examples.items())) for name in _BEGIN_WITH)


def welcome() -> str:
    """The text that ``pfdist`` alone prints."""
    begin = examples_text(_way_in(), "Three commands to try:")
    return f"{fill(PROGRAM, line_width())}\n\n{begin}\n\n`pfdist --help` lists all commands."


# --- wrong words ----------------------------------------------------------------------------------


def complaint(error: CycloptsError) -> str:
    """The mistake in a command line, and the word that was perhaps meant, in a line."""
    name = " ".join(["pfdist", *(error.command_chain or ())])
    return f"{name}: error: {shown_text(one_line(_reason(error)))} (see `{name} --help`)"


def _reason(error: CycloptsError) -> str:
    match error:
        case UnknownCommandError() | UnknownOptionError():
            return _unknown(error)
        case MissingArgumentError() if error.argument is not None:
            return _missing(error, error.argument)
        case CoercionError(token=Token() as token) if error.argument is not None:
            return _refused(token, error.argument, str(error.msg or ""))
        case RepeatArgumentError(token=token):
            return f"{token.keyword} is given more than once"
        case UnusedCliTokensError(unused_tokens=[word, *_]):
            is_number = word.replace(",", "").replace(":", "").isdigit()
            hint = " (a list is one word, as 0,6,12)" if is_number else ""
            return f"unexpected word {shown(word)}{hint}"
    return str(error)


def _unknown(error: UnknownCommandError | UnknownOptionError) -> str:
    if isinstance(error, UnknownOptionError):
        word = error.token.keyword or error.token.value
        return _unknown_option(word, _options(error.argument_collection))
    word = (error.unused_tokens or [""])[0]
    is_option = word.startswith("-")
    if is_option:
        return _unknown_option(word, _options([]))
    return gone(word) or _not_one_of("COMMAND", COMMANDS, word)


def _missing(error: MissingArgumentError, argument: Argument) -> str:
    if error.keyword:
        name = error.keyword
        return f"{name} needs a value; one that begins with '-' is written {name}=VALUE"
    if error.app is not None:  # a misspelt option that is required is not called missing
        options = _options(error.app.assemble_argument_collection())
        words = [word.partition("=")[0] for word in error.unused_tokens or ()]
        for word in words:
            if word.startswith("--") and word not in options:
                return _unknown_option(word, options)
    return f"required: {_spelling(argument)[0]}"


def _refused(token: Token, argument: Argument, reason: str) -> str:
    if choices := argument.get_choices(force=True):
        return _not_one_of(argument.name, choices, token.value)
    name = token.keyword or argument.name
    return f"{name}: {reason}" if reason else f"{name} takes no value, got {shown(token.value)}"


def _options(arguments: Iterable[Argument]) -> list[str]:
    names = [name for each in arguments for name in each.names if name.startswith("-")]
    return [*names, "--help", "--version"]


def _not_one_of(name: str, choices: Collection[str], got: str) -> str:
    return must_be(name, f"one of {', '.join(choices)}", got, choices)


def _unknown_option(word: str, options: Collection[str]) -> str:
    option = word.partition("=")[0]
    if option in options:  # after "--", or with a value
        return f"unexpected word {shown(word)}"
    keys = " (--set KEY=VALUE changes a key of the job)" if "--set" in options else ""
    return gone(option) or (
        f"unknown option {shown_text(option)}{keys}{did_you_mean(option, options)}"
    )
