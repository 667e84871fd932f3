"""The command ``pfdist plot``."""

from argparse import Namespace

from pfdist.cli.arguments import add_run
from pfdist.cli.command import command
from pfdist.errors import one_line


@command(
    "plot",
    add_run,
    examples={"pfdist plot results/plan": "Draw the figures of a run again"},
)
def plot_command(options: Namespace) -> None:
    """Draw the figures of a run from its tables."""
    from pfdist.analysis import open_run
    from pfdist.plots import draw_figures

    for file in draw_figures(open_run(options.run)):
        print(one_line(str(file)))
