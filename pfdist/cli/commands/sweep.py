"""The command ``pfdist sweep``."""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING

from pfdist.cli.answers import print_page, print_records
from pfdist.cli.arguments import add_changes, add_json, computing, whole
from pfdist.cli.command import command
from pfdist.errors import one_line, shown

if TYPE_CHECKING:
    from pfdist.api.sweep import Sweep


def _add_sweep(parser: ArgumentParser) -> None:
    parser.add_argument(
        "job",
        metavar="SWEEP_OR_JOB",
        help="sweep file, which names a job and values of its keys; or a job file, with --over",
    )
    parser.add_argument(
        "--over",
        action="append",
        default=[],
        metavar="KEY=VALUES",
        help="a key of the job with its values, as seed=1:10 or model.parameters.NAME=0.5,1; "
        "give --over once for each key: every combination is a point",
    )
    parser.add_argument(
        "--bound-draws",
        type=whole,
        default=0,
        metavar="K",
        help="number of draws of the lower bound that is proved at each point (default: 0, no "
        "bound)",
    )
    parser.add_argument(
        "--judge",
        action="store_true",
        default=None,
        help="also judge the times found at each point at every point, in the folder "
        "judged of the sweep (default: judge of the sweep file)",
    )
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--part",
        type=_part,
        metavar="K/N",
        help="compute every N-th point, from the K-th, and look at no other, as tasks of a batch "
        "array do; then the same command without --part judges and reports the whole sweep",
    )
    either.add_argument(
        "--dry-run",
        action="store_true",
        help="print the points, their work, and the number of parts that pays; compute nothing",
    )


def _part(text: str) -> tuple[int, int]:
    """The numbers of ``3/200``; `SweepJob.part` knows which are allowed.

    Raises
    ------
    ArgumentTypeError
        The text is no pair of numbers.
    """
    number, slash, parts = text.partition("/")
    if not slash:
        raise ArgumentTypeError(f"must be K/N, as 3/200, got {shown(text)}")
    return whole(number), whole(parts)


@command(
    "sweep",
    _add_sweep,
    add_changes,
    computing(
        "results/<name of the sweep file>, or results/<name of the job>-sweep",
        reuse=False,
        what="sweep",
    ),
    add_json,
    goes_on=True,
    examples={
        "pfdist sweep jobs/plan.toml --over seed=1:3": (
            "Plan with three seeds, with the same workers"
        ),
        "pfdist sweep jobs/plan.toml --over seed=1:2 --over filter.particles=100,500": (
            "Run every combination of two keys"
        ),
        "pfdist sweep jobs/budgets.toml --dry-run": "List the points of a sweep file",
        "pfdist sweep jobs/budgets.toml --part 3/12": "Compute the third of twelve parts",
    },
)
def sweep_command(options: Namespace) -> None:
    """Run a job at many values of its keys, with the same workers."""
    from pfdist.answers.runs import foreseen_page
    from pfdist.api.display import Display
    from pfdist.api.sweep import foreseen, sweep
    from pfdist.cli.computing import settings
    from pfdist.job.points import values_by_key

    over = values_by_key(options.over)
    shared = {"results": options.results, "changes": options.set, "judge": options.judge}
    if options.dry_run:
        points = foreseen(options.job, over, **shared)
        if options.json:
            print_records("points", points, options)
        else:
            print_page(foreseen_page(points), options)
        return
    with Display() as display:
        chosen = {**settings(options, display), **shared, "part": options.part}
        finished = sweep(options.job, over, **chosen, bound_draws=options.bound_draws)
    _print_sweep(finished, options)


def _print_sweep(finished: "Sweep", options: Namespace) -> None:
    """Print the table of a sweep, and where its runs and its report are."""
    import pandas as pd

    from pfdist.answers.runs import table_page
    from pfdist.store.folder import REPORT, has_report

    table = finished.table() if finished.runs else pd.DataFrame()
    if options.json:
        print_records("rows", table, options)
        return
    if finished.runs:
        print_page(table_page(table), options)
    if finished.busy:
        print(f"\nother processes compute {', '.join(finished.busy)}")
    there = [f"runs: {finished.path}"]
    if has_report(finished.path):
        there.append(f"report: {finished.path / REPORT}")
    print(f"\n{one_line('   '.join(there))}")
