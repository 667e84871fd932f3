"""The command ``pfdist repair``."""

from argparse import Namespace
from pathlib import Path

from pfdist.cli.arguments import add_run
from pfdist.cli.command import command
from pfdist.errors import one_line


@command(
    "repair",
    add_run,
    examples={"pfdist repair results/plan": "Move damaged files away, after `pfdist verify`"},
)
def repair_command(options: Namespace) -> None:
    """Move the damaged files of a run to quarantine."""
    from pfdist.store.repair import repair_run

    lines = list(repair_run(Path(options.run)))
    for line in lines or [f"{options.run}: nothing to repair"]:
        print(one_line(line))
