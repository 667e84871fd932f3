"""The command ``pfdist list``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.arguments import add_json
from pfdist.cli.command import command


def _add_folder(parser: ArgumentParser) -> None:
    parser.add_argument(
        "folder",
        nargs="?",
        default="results",
        metavar="DIR",
        help="folder below which runs are sought, three levels deep; links are not followed "
        "(default: results)",
    )


@command(
    "list",
    _add_folder,
    add_json,
    examples={
        "pfdist list": "Show all runs in the folder results",
        "pfdist list results --json": "Give the same to a program",
    },
)
def list_command(options: Namespace) -> None:
    """List the runs in a folder: how far each is, and what it has found."""
    from pfdist.answers.runs import list_page
    from pfdist.api.list_runs import list_runs
    from pfdist.cli.answers import print_page, print_records

    frame = list_runs(options.folder)
    if options.json:
        print_records("runs", frame, options)
    else:
        print_page(list_page(frame, options.folder), options)
