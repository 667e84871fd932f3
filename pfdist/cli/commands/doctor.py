"""The command ``pfdist doctor``."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from pfdist.cli.answers import print_checks
from pfdist.cli.arguments import add_json
from pfdist.cli.command import command
from pfdist.errors import PoolError


def _add_machine(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--results",
        default="results",
        metavar="DIR",
        help="folder that will hold runs (default: results)",
    )
    parser.add_argument(
        "--address",
        default="",
        metavar="HOST:PORT",
        help="check the nodes of the Ray cluster at this address, too",
    )


@command(
    "doctor",
    _add_machine,
    add_json,
    examples={
        "pfdist doctor": "Check this machine, before the first run",
        "pfdist doctor --results /tmp": "Check whether another disk can hold runs",
    },
)
def doctor_command(options: Namespace) -> None:
    """Check whether this machine is fit for a run."""
    from pfdist.checks.machine import examine

    wrong = print_checks(examine(Path(options.results), options.address), options)
    if wrong:
        raise PoolError(f"not fit for a run: {', '.join(wrong)}")
