"""Arguments that several commands share, and types of their values."""

import contextlib
import math
from argparse import ArgumentParser, ArgumentTypeError
from collections.abc import Callable
from typing import Any, TypeVar

from pfdist.cli.command import AddArguments
from pfdist.common.parsing import finite_number, whole_number
from pfdist.errors import shown
from pfdist.pools.kinds import AUTO, POOLS

T = TypeVar("T")
RESULTS = "results/<name of the job file without .toml>"
"""The folder of a run, if the user names none."""


def argument(*names: str, **settings: Any) -> AddArguments:
    """A function that adds an argument with these settings of argparse to a parser."""

    def add(parser: ArgumentParser) -> None:
        parser.add_argument(*names, **settings)

    return add


add_changes = argument(
    "--set",
    nargs="+",
    action="extend",
    default=[],
    metavar="KEY=VALUE",
    help="change keys of the job, for instance seed=3 search.genetic.generations=5",
)
add_run = argument("run", metavar="RUN", help="folder of a run")
add_json = argument("--json", action="store_true", help="print one JSON object and no text")
add_no_report = argument(
    "--no-report",
    action="store_true",
    help="write no report (an HTML file that can be sent; see `pfdist report`)",
)


def add_job(parser: ArgumentParser) -> None:
    """Add JOB and ``--set``."""
    parser.add_argument(
        "job",
        metavar="JOB",
        help="job file, for instance jobs/paper.toml, or the folder of a run",
    )
    add_changes(parser)


def add_job_of_run(parser: ArgumentParser) -> None:
    """Add JOB, ``--set`` and ``--results``, for a question about the finished run of a job."""
    add_job(parser)
    parser.add_argument(
        "--results",
        metavar="DIR",
        help=f"folder of the run (default: {RESULTS}, where `pfdist run` and `pfdist plan` put the "
        "run; with -plan after it if only that one holds a run; of the folder of a run, this one)",
    )


def add_answer(parser: ArgumentParser) -> None:
    """Add ``--verbose`` and ``--json``."""
    parser.add_argument(
        "--verbose",
        action="store_true",
        help="also print the details: all sets of times, what each search believed, quartiles",
    )
    add_json(parser)


def add_pool(parser: ArgumentParser) -> None:
    """Add ``--pool``, ``--workers``, ``--address`` and ``--wait-for-cores``."""
    kinds = "; ".join(f"{name}, {kind.description}" for name, kind in POOLS.items())
    parser.add_argument(
        "--pool",
        choices=[AUTO, *POOLS],
        help=f"where tasks are computed: {kinds}; {AUTO}, on Ray if a cluster is given or "
        f"formulas run in NumPy, else on threads (default: execution.pool of the job)",
    )
    parser.add_argument(
        "--workers",
        type=whole,
        metavar="N",
        help="number of workers, at most 1,000 on one machine; 0 is one for each core "
        "(default: execution.workers of the job)",
    )
    parser.add_argument(
        "--address",
        metavar="HOST:PORT",
        help="join the Ray cluster at this address; "
        '"auto" finds a cluster, "local" starts one on this machine (default: '
        "execution.address of the job)",
    )
    parser.add_argument(
        "--wait-for-cores",
        type=whole,
        metavar="N",
        help="begin when the Ray cluster has N cores, within 5 minutes (default: "
        "execution.wait_for_cores of the job)",
    )


def computing(results: str, *, reuse: bool = True, what: str = "run") -> AddArguments:
    """A function that adds what a command needs to compute a run.

    Parameters
    ----------
    results : str
        Describes the folder of the run if ``--results`` is not given.
    reuse : bool
        Whether the run may take evaluations from another run.
    what : str
        A noun for what lies in the folder.
    """

    def add(parser: ArgumentParser) -> None:
        parser.add_argument(
            "--results", metavar="DIR", help=f"folder of the {what} (default: {results})"
        )
        add_pool(parser)
        if reuse:
            parser.add_argument(
                "--reuse",
                action="append",
                default=[],
                metavar="RUN",
                help="take every evaluation that the run in the folder RUN has, for instance that "
                "of a similar job; give --reuse once for each run",
            )
        add_no_report(parser)

    return add


def argument_type(read: Callable[[str], T]) -> Callable[[str], T]:
    """The type of an option whose wrong values argparse refuses with the words of a ValueError."""

    def typed(text: str) -> T:
        try:
            return read(text)
        except ValueError as error:
            raise ArgumentTypeError(str(error)) from error

    return typed


whole = argument_type(whole_number)
"""A whole number."""


@argument_type
def decimal(text: str) -> int | float:
    """A number with digits and a decimal point; a whole number without a point is an int."""
    return whole_number(text) if text.lstrip("+-").isdigit() else finite_number(text)


@argument_type
def count(text: str) -> int:
    """A whole number from 1 to 32,000."""
    number = whole_number(text)
    if not 1 <= number <= 32_000:
        raise ValueError(f"must be an integer in 1..32000, got {number}")
    return number


@argument_type
def finite(text: str) -> float:
    """A finite number."""
    with contextlib.suppress(ValueError):
        number = float(text) if text.isascii() and "_" not in text else math.nan
        if math.isfinite(number):
            return number
    raise ValueError(f"must be a finite number, got {shown(text)}")


def add_measurements(parser: ArgumentParser) -> None:
    """Add the table of measurements, the planned set, and the particles to start from."""
    parser.add_argument(
        "measurements",
        metavar="MEASUREMENTS",
        help="table with the columns t, y0, y1, ... (or y_ and the model's name of the component), "
        "in CSV or Parquet, for instance patient.csv; an empty cell is a missing component, "
        "a row without any value a missed time; if the model has sensors, the column sensor names "
        "the sensor of a row, whose components are y0, y1, ...",
    )
    parser.add_argument(
        "--planned",
        default="",
        metavar="NAME",
        help="compared set whose times were planned, for instance regular (default: the found set "
        "with the lowest expected MSE)",
    )
    parser.add_argument(
        "--prior",
        default="",
        metavar="FILE",
        help="particles from which the filter starts, in Parquet or CSV, for instance "
        "prior.parquet: columns x0, x1, ... (or x_ and a name), if wanted weight, and t, their "
        "time (default: the first)",
    )
