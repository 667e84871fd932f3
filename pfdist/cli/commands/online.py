"""The command ``pfdist online``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_answer, add_job, computing, whole
from pfdist.cli.command import command

_RESULTS = f"{RESULTS}, with -online after it unless the job has a section [online]"


def _add_draws(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of draws whose times are chosen one after another, for instance 200; they are "
        "the first draws of the comparison (default: online.draws of the job)",
    )


@command(
    "online",
    add_job,
    _add_draws,
    computing(_RESULTS),
    add_answer,
    goes_on=True,
    examples={
        "pfdist online jobs/online.toml": (
            "Compare times chosen one after another with times found in advance"
        ),
        "pfdist online jobs/plan.toml --draws 200": (
            "Do so for a job without a section [online], on few draws"
        ),
    },
)
def online_command(options: Namespace) -> None:
    """Choose times one after another, and compare them with times found in advance."""
    from pfdist.api.display import Display
    from pfdist.api.online import online
    from pfdist.cli.computing import settings

    with Display() as display:
        finished = online(
            options.job, draws=options.draws, changes=options.set, **settings(options, display)
        )
    print_run(finished, options)
