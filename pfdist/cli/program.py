"""The program: its commands, their help, and the messages about wrong words."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from cyclopts import App, CycloptsError, Group
from cyclopts.exceptions import UnknownCommandError, UnknownOptionError, UnusedCliTokensError

import pfdist
from pfdist.cli.commands import COMMANDS, GROUPS
from pfdist.common.nearest import did_you_mean
from pfdist.errors import one_line, shown, shown_text
from pfdist.pages.terminal import line_width

if TYPE_CHECKING:  # it is imported with the first command that is read
    from pfdist.cli.words import Line

PROGRAM = (
    "pfdist finds the measurement times at which a particle filter errs least, and proves how good "
    "they are."
)
_BEGIN_WITH = ("plan", "why", "budget")  # commands, in the order in which they are tried
_BEGIN_WITHOUT_JOBS = ("init", "plan", "why")
_EXIT_CODES = "Exit codes: 0 done; 1 error; 2 wrong arguments; 75 start it again; 130 Ctrl-C."
_RESUMES = "If it is interrupted, the same command resumes where it stopped.\n\n"
_DESCRIBES = "`pfdist COMMAND --help` describes a command.\n\n"


def program(command: str = "") -> App:
    """The whole command line; the function of a command is imported when it is chosen.

    Parameters
    ----------
    command : str
        The command whose docstring is its help; that of the others is their sentence.
    """
    app = App(
        name="pfdist",
        help=PROGRAM,
        help_format="markdown",
        help_epilogue=_end_of_help(_DESCRIBES, _way_in()),
        version=f"pfdist {pfdist.__version__}",
    )
    groups = {
        name: group
        for place, (title, names) in enumerate(GROUPS.items())
        for group in [Group(title, sort_key=place)]
        for name in names
    }
    for name, each in COMMANDS.items():
        app.command(
            f"pfdist.cli.words:{name}",
            name=name,
            group=groups[name],
            sort_key=[*groups].index(name),
            help=None if name == command else each.sentence,
            help_epilogue=_end_of_help(_RESUMES * each.resumes, each.examples),
        )
    return app


def line_of(words: Sequence[str]) -> "Line | None":
    """The command line that some words spell; None if they ask for help or the version.

    Help or version are then printed.

    Raises
    ------
    CycloptsError
        The words are wrong; `complaint` gives the line to print.
    """
    app = program(words[0])
    read, given, _ = app.parse_args(words, exit_on_error=False, print_error=False)
    line: Line | None = read(*given.args, **given.kwargs)
    return line


def _end_of_help(note: str, examples: Mapping[str, str]) -> str:
    lines = [line for command, does in examples.items() for line in (f"# {does}", command)]
    return "\n".join([f"{note}{_EXIT_CODES}", "", "Examples:", "```text", *lines, "```"])


def _way_in() -> dict[str, str]:
    """The command lines to begin with: the first examples of some commands.

    Where the jobs of a checkout are missing, they are about the job that `pfdist init` writes.
    """
    if Path("jobs/plan.toml").exists():
        return _first_examples(_BEGIN_WITH)
    examples = _first_examples(_BEGIN_WITHOUT_JOBS).items()
    return {
        line.replace("jobs/plan", "mine"): does.replace("/plan", "/mine") for line, does in examples
    }


def _first_examples(commands: Sequence[str]) -> dict[str, str]:
    known = (COMMANDS[name] for name in commands if name in COMMANDS)  # a plugin may be missing
    return dict(next(iter(each.examples.items())) for each in known)


def welcome() -> str:
    """The text that ``pfdist`` alone prints."""
    lines = [f"  # {does}\n  {line}" for line, does in _way_in().items()]
    begin = "\n".join(["Three commands to try:", *lines])
    return f"{fill(PROGRAM, line_width())}\n\n{begin}\n\n`pfdist --help` lists all commands."


def complaint(error: CycloptsError) -> str:
    """The mistake in a command line, and the word that was perhaps meant, in a line."""
    name = " ".join(["pfdist", *(error.command_chain or ())])
    return f"{name}: error: {one_line(_reason(error))} (see `{name} --help`)"


def _reason(error: CycloptsError) -> str:
    match error:
        case UnknownCommandError(unused_tokens=[word, *_]):
            meant = did_you_mean(word, [*COMMANDS, "--help", "--version"])
            return f"unknown command {shown_text(word)}{meant}"
        case UnknownOptionError(token=token, argument_collection=arguments):
            word = token.keyword or token.value
            known = {name for each in arguments for name in each.names}
            if word == "--out" and "--results" in known:
                return "unknown option --out: --results FOLDER is where the run is written"
            has_keys = "--set" in known
            keys = " (--set KEY=VALUE changes a key of the job)" * has_keys
            return f"{shown_text(str(error)).rstrip('.')}{keys}"
        case UnusedCliTokensError(unused_tokens=[word, *_]):
            is_number = word.replace(",", "").replace(":", "").isdigit()
            hint = " (a list is one word, as 0,6,12)" if is_number else ""
            return f"unexpected word {shown(word)}{hint}"
    return shown_text(str(error)).rstrip(".")
