"""The command ``pfdist status``."""

from argparse import Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import add_answer, add_run
from pfdist.cli.command import command


@command(
    "status",
    add_run,
    add_answer,
    examples={
        "pfdist status results/plan": "Show what a run has found so far",
        "pfdist status results/plan --json": "Give the same to a program",
    },
)
def status_command(options: Namespace) -> None:
    """Show how far a run is and what it has found."""
    from pfdist.analysis import open_run

    print_run(open_run(options.run), options)
