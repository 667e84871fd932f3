"""The options of each command, and their help."""

import argparse
import math
from collections.abc import Callable
from typing import Any, NoReturn

import pfdist
from pfdist.common.parsing import whole_number
from pfdist.errors import one_line, shown, shown_text

_EPILOG = (
    "Exit codes: 0 done, 1 an error, 2 a misuse, 130 interrupted by Ctrl-C, "
    "75 ended by SIGTERM or SIGUSR1 (a batch system: run it again to go on)."
)


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line.

    ``options.command`` names the function of `pfdist.cli.commands` to call, and ``options.goes_on``
    says whether the same command, given again, goes on from what is committed.
    """
    parser = _Parser(
        prog="pfdist",
        description="Find when to measure so that a particle filter errs least, and prove it.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"pfdist {pfdist.__version__}")
    added = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (summary, fill) in _COMMANDS.items():
        one = added.add_parser(name, help=summary, description=summary, epilog=_EPILOG)
        one.fill = fill
        one.set_defaults(
            command=f"{name.replace('-', '_')}_command", goes_on=name in ("run", "plan", "budget")
        )
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that gets its options when it has to parse, and shows no long value whole."""

    fill: Callable[[argparse.ArgumentParser], None] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, with the options of the command: some come from modules that take long to load."""
        if self.fill is not None:
            fill, self.fill = self.fill, None
            fill(self)
            self.add_argument("--debug", action="store_true", help="show the traceback of an error")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and exit with 2."""
        super().error(shown_text(one_line(message)))


def _add_run(parser: argparse.ArgumentParser) -> None:
    _add_job(parser)
    _add_computing(parser, "results/<the job file's stem>")
    _add_json(parser)


def _add_plan(parser: argparse.ArgumentParser) -> None:
    # Here and not above: it takes a while, and the list of commands does not want it.
    from pfdist.search.methods import DEFAULT_METHOD, METHODS  # noqa: PLC0415

    _add_job(parser)
    stem = "results/<the job file's stem>"
    _add_computing(parser, f"{stem}, or {stem}-plan if the job names searches")
    parser.add_argument(
        "--search",
        choices=list(METHODS),
        default=DEFAULT_METHOD,
        metavar="METHOD",
        help=f"one of {', '.join(METHODS)}; with its defaults, unless --set "
        f"search.METHOD.KEY=VALUE changes them ({DEFAULT_METHOD})",
    )
    _add_json(parser)


def _add_status(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser)
    _add_json(parser)


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    _add_job(parser)
    parser.add_argument("--times", required=True, metavar="T,T,...", help="for instance 0,3,6")
    parser.add_argument("--draws", type=_whole, metavar="K", help="how many (evaluation.draws)")
    parser.add_argument("--particles", type=_whole, metavar="P", help="how many (filter.particles)")
    parser.add_argument("--seed", type=_whole, metavar="S", help="in the place of the job's")
    _add_json(parser)


def _add_why(parser: argparse.ArgumentParser) -> None:
    from pfdist.api.why import DRAWS  # noqa: PLC0415  as above

    _add_folder(parser, "a run's folder; its model is run again, if it may be")
    parser.add_argument(
        "--draws", type=_whole, default=DRAWS, metavar="K", help=f"how many, of their own ({DRAWS})"
    )
    parser.add_argument(
        "--model",
        default="",
        metavar="FILE.py:OBJECT",
        help="run this model in the place of the file that RUN names, which runs only if it is "
        "unchanged and you have run it on this machine",
    )
    parser.add_argument(
        "--filter-model",
        default="",
        metavar="FILE.py:OBJECT",
        help="likewise, what the filter takes for the truth",
    )
    _add_json(parser)


def _add_doctor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--results", default="results", metavar="DIR", help="where runs go (results)"
    )
    parser.add_argument("--address", default="", help="of a Ray cluster, whose nodes are looked at")
    _add_json(parser)


def _add_check_model(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "name", metavar="MODEL", help="as a job names it, for instance path/file.py:object"
    )
    parser.add_argument("--horizon", type=_count, default=60, metavar="T", help="of the draws (60)")
    parser.add_argument(
        "--particles", type=_count, default=500, metavar="P", help="of the filter (500)"
    )
    _add_json(parser)


def _add_folder(parser: argparse.ArgumentParser, text: str = "a run's folder") -> None:
    parser.add_argument("run", metavar="RUN", help=text)


def _add_budget(parser: argparse.ArgumentParser) -> None:
    from pfdist.api.budget import DRAWS  # noqa: PLC0415  as above

    _add_job(parser)
    parser.add_argument(
        "--measurements", required=True, metavar="A:B", help="from how many to how many"
    )
    parser.add_argument("--target", type=_finite, metavar="X", help="an expected MSE to be reached")
    parser.add_argument(
        "--draws",
        type=_whole,
        default=DRAWS,
        metavar="K",
        help=f"on which all are compared ({DRAWS})",
    )
    _add_computing(parser, "results/<the job file's stem>-budget")
    _add_json(parser)


def _whole(text: str) -> int:
    try:
        return whole_number(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _count(text: str) -> int:
    number = _whole(text)
    if not 1 <= number <= 32_000:
        raise argparse.ArgumentTypeError(f"must be an integer in 1..32000, got {number}")
    return number


def _finite(text: str) -> float:
    try:
        number = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"must be a finite number, got {shown(text)}")
    return number


def _add_job(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("job", metavar="JOB", help="a job file, for instance jobs/paper.toml")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="change keys of the job, for instance seed=3 search.genetic.generations=5",
    )


def _add_computing(parser: argparse.ArgumentParser, results: str) -> None:
    parser.add_argument(
        "--results", metavar="DIR", help=f"the run's own folder (default: {results})"
    )
    parser.add_argument("--pool", choices=["ray", "serial"], help="where tasks are done (ray)")
    parser.add_argument("--workers", type=_whole, metavar="N", help="how many (all cores)")
    parser.add_argument("--address", help="of a Ray cluster to join (a local one is started)")
    parser.add_argument(
        "--fork", metavar="NEW", help="start another run there, from what --results has evaluated"
    )


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object, and nothing else"
    )


_COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "run": ("Run a job, or go on with its run where it stopped.", _add_run),
    "plan": ("Find measurement times for a job's problem and prove them.", _add_plan),
    "budget": (
        "Say how the error falls with the number of measurements, and how many are enough.",
        _add_budget,
    ),
    "status": ("Say how far a run is and what it has found.", _add_status),
    "evaluate": ("Estimate the expected MSE of one set of times.", _add_evaluate),
    "plot": ("Draw the figures of a run from its tables.", _add_folder),
    "why": ("Say what each measurement of a finished run is worth, and draw it.", _add_why),
    "verify": ("Look at every byte, row and key of a run.", _add_folder),
    "repair": ("Move damaged files of a run to quarantine.", _add_folder),
    "doctor": ("Say whether this machine is fit for a run.", _add_doctor),
    "check-model": ("Find what is wrong with a model.", _add_check_model),
    "models": ("List the models that can be named in a job.", lambda parser: None),
}
"""What each command says of itself, and what adds its options."""
