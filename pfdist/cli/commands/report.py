"""The command ``pfdist report``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.command import command
from pfdist.errors import one_line


def _add_run(parser: ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN", help="folder of a run, or of a sweep")


def _add_watch(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--watch",
        action="store_true",
        help="write the report again every few seconds while the run goes on; the page reloads "
        "itself",
    )


@command(
    "report",
    _add_run,
    _add_watch,
    examples={
        "pfdist report results/plan": "Write report.html into the folder of the run",
        "pfdist report results/plan --watch": "Write it again and again while the run goes on",
        "pfdist report results/budgets": "Write that of a sweep, with links to the points",
    },
)
def report_command(options: Namespace) -> None:
    """Write the report of a run or a sweep: one HTML file that can be sent to anybody."""
    from pfdist.api.display import Display
    from pfdist.api.report import report

    with Display() as display:
        file = report(options.run, watch=options.watch, say=display.say)
    print(one_line(str(file)))
