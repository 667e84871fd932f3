"""The command ``pfdist compare``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_answer, add_job, computing, whole
from pfdist.cli.command import command
from pfdist.cli.words import add_named_times, sets_by_name


def _add_sets(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs",
        nargs="*",
        default=[],
        metavar="RUN",
        help="folders of finished runs, which are only read; their sets are compared, too, beside "
        "those that the job names in [comparison.sets]",
    )
    add_named_times(
        parser,
        "a set to compare, as clinic=0,6,12,24 or paper=0:60:3, on the clock of the problem; the "
        "word regular stands for the regular times; give --times once for each set",
    )
    parser.add_argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of draws on which all sets are compared (default: comparison.draws)",
    )


@command(
    "compare",
    add_job,
    _add_sets,
    computing(f"{RESULTS}-compare", reuse=False),
    add_answer,
    goes_on=True,
    examples={
        "pfdist compare jobs/plan.toml --times clinic=0,20,40,60 --times mine=0:60:3": (
            "Compare two hand-made sets on the same draws"
        ),
        "pfdist compare jobs/plan.toml results/plan --times a=0:20 --results results/a": (
            "Compare a set with those of a finished run"
        ),
    },
)
def compare_command(options: Namespace) -> None:
    """Compare named sets of times, and the sets of runs, on the same fresh draws."""
    from pfdist.api.compare import compare
    from pfdist.api.display import Display
    from pfdist.cli.computing import settings

    with Display() as display:
        finished = compare(
            options.job,
            *options.runs,
            times=sets_by_name(options.times),
            draws=options.draws,
            changes=options.set,
            **settings(options, display),
        )
    print_run(finished, options)
