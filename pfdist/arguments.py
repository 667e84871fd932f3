"""The options of each command, and their help."""

import argparse
import math
from typing import Any

import pfdist
from pfdist import commands
from pfdist.runner.budget import DRAWS as BUDGET_DRAWS
from pfdist.runner.why import DRAWS
from pfdist.search_sections import PLANNER, SEARCHES

_EPILOG = (
    "Exit codes: 0 done, 1 an error, 2 a misuse, 130 interrupted by Ctrl-C, "
    "75 ended by SIGTERM or SIGUSR1 (a batch system: run it again to go on)."
)


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line; ``options.command`` is what to call."""
    parser = argparse.ArgumentParser(
        prog="pfdist",
        description="Find when to measure so that a particle filter errs least, and prove it.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"pfdist {pfdist.__version__}")
    added = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_what_computes(added)
    _add_what_asks(added)
    _add_what_looks_after_runs(added)
    return parser


def _command(added: Any, name: str, function: Any) -> argparse.ArgumentParser:
    """Add a command; what its function says of itself is its help."""
    summary = function.__doc__
    one: argparse.ArgumentParser = added.add_parser(
        name, help=summary, description=summary, epilog=_EPILOG
    )
    one.set_defaults(command=function, goes_on=function in commands.RESUMABLE)
    one.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return one


def _add_what_computes(added: Any) -> None:
    one = _command(added, "run", commands.run_command)
    _add_job(one)
    _add_computing(one, "results/<the job file's stem>")
    _add_json(one)

    one = _command(added, "plan", commands.plan_command)
    _add_job(one)
    stem = "results/<the job file's stem>"
    _add_computing(one, f"{stem}, or {stem}-plan if the job names searches")
    one.add_argument(
        "--search",
        choices=list(SEARCHES),
        default=PLANNER,
        metavar="METHOD",
        help=f"one of {', '.join(SEARCHES)}; with its defaults, unless --set "
        f"search.METHOD.KEY=VALUE changes them ({PLANNER})",
    )
    _add_json(one)

    _add_budget(_command(added, "budget", commands.budget_command))


def _add_what_asks(added: Any) -> None:
    one = _command(added, "status", commands.status_command)
    one.add_argument("run", metavar="RUN", help="a run's folder")
    _add_json(one)

    one = _command(added, "evaluate", commands.evaluate_command)
    _add_job(one)
    one.add_argument("--times", required=True, metavar="T,T,...", help="for instance 0,3,6")
    one.add_argument("--draws", type=int, metavar="K", help="how many (evaluation.draws)")
    one.add_argument("--particles", type=int, metavar="P", help="how many (filter.particles)")
    one.add_argument("--seed", type=int, metavar="S", help="in the place of the job's")
    _add_json(one)

    one = _command(added, "plot", commands.plot_command)
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = _command(added, "why", commands.why_command)
    one.add_argument(
        "run", metavar="RUN", help="a run's folder; its model is run again, if it may be"
    )
    one.add_argument(
        "--draws", type=int, default=DRAWS, metavar="K", help=f"how many, of their own ({DRAWS})"
    )
    one.add_argument(
        "--model",
        default="",
        metavar="FILE.py:OBJECT",
        help="run this model in the place of the file that RUN names, which runs only if it is "
        "unchanged and you have run it on this machine",
    )
    one.add_argument(
        "--filter-model",
        default="",
        metavar="FILE.py:OBJECT",
        help="likewise, what the filter takes for the truth",
    )
    _add_json(one)


def _add_what_looks_after_runs(added: Any) -> None:
    one = _command(added, "verify", commands.verify_command)
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = _command(added, "repair", commands.repair_command)
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = _command(added, "doctor", commands.doctor_command)
    one.add_argument("--results", default="results", metavar="DIR", help="where runs go (results)")
    one.add_argument("--address", default="", help="of a Ray cluster, whose nodes are looked at")
    _add_json(one)

    one = _command(added, "check-model", commands.check_model_command)
    one.add_argument(
        "name", metavar="MODEL", help="as a job names it, for instance path/file.py:object"
    )
    one.add_argument("--horizon", type=_count, default=60, metavar="T", help="of the draws (60)")
    one.add_argument(
        "--particles", type=_count, default=500, metavar="P", help="of the filter (500)"
    )
    _add_json(one)

    _command(added, "models", commands.models_command)


def _add_budget(parser: argparse.ArgumentParser) -> None:
    _add_job(parser)
    parser.add_argument(
        "--measurements", required=True, metavar="A:B", help="from how many to how many"
    )
    parser.add_argument("--target", type=_finite, metavar="X", help="an expected MSE to be reached")
    parser.add_argument(
        "--draws",
        type=int,
        default=BUDGET_DRAWS,
        metavar="K",
        help=f"on which all are compared ({BUDGET_DRAWS})",
    )
    _add_computing(parser, "results/<the job file's stem>-budget")
    _add_json(parser)


def _count(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 32_000):
        raise argparse.ArgumentTypeError(f"must be an integer in 1..32000, got {text!r}")
    return int(text)


def _finite(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"must be a finite number, got {text!r}")
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
    parser.add_argument("--workers", type=int, metavar="N", help="how many (all cores)")
    parser.add_argument("--address", help="of a Ray cluster to join (a local one is started)")
    parser.add_argument(
        "--fork", metavar="NEW", help="start another run there, from what --results has evaluated"
    )


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object, and nothing else"
    )
