"""The command ``pfdist table``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.arguments import add_json
from pfdist.cli.command import command


def _add_runs(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="folders of runs, finished or not; a folder with runs or sweeps in it stands for all "
        "these runs",
    )
    parser.add_argument(
        "--out",
        metavar="TABLE",
        help="write the table to this file, which ends in .csv, .parquet or .tex (booktabs, for a "
        "paper); an earlier table of runs is replaced, another file is not",
    )


@command(
    "table",
    _add_runs,
    add_json,
    examples={
        "pfdist table results/plan": "Show the results of a run, a row for each found set",
        "pfdist table results --out runs.csv": "Write all runs in a folder to a file",
        "pfdist table results --out runs.tex": "Make a table for a paper",
    },
)
def table_command(options: Namespace) -> None:
    """Put many runs into one table: what differs between them, and what they found."""
    from pfdist.answers.runs import table_page
    from pfdist.api.table import table
    from pfdist.cli.answers import print_page, print_records
    from pfdist.errors import one_line

    frame = table(*options.runs, out=options.out)
    if options.json:
        unit = frame.attrs.get("time_unit")
        print_records("rows", frame, options, {} if unit is None else {"time_unit": unit})
    elif options.out is None:
        print_page(table_page(frame), options)
    else:
        print(one_line(options.out))
