"""Commands that read a run and compute nothing: status, list, table, report, plot and others."""

from argparse import ArgumentParser, Namespace
from pathlib import Path

from pfdist.cli.answers import print_page, print_records, print_run
from pfdist.cli.arguments import add_answer, add_json, add_run, argument
from pfdist.cli.command import command
from pfdist.errors import StoreError, one_line


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


@command(
    "list",
    argument(
        "folder",
        nargs="?",
        default="results",
        metavar="DIR",
        help="folder below which runs are sought, three levels deep; links are not followed "
        "(default: results)",
    ),
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

    frame = list_runs(options.folder)
    if options.json:
        print_records("runs", frame, options)
    else:
        print_page(list_page(frame, options.folder), options)


def _add_runs(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="folders of runs, finished or not; a folder with runs or sweeps in it stands for all "
        "these runs that can be read",
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

    frame = table(*options.runs, out=options.out)
    if options.json:
        unit = frame.attrs.get("time_unit")
        print_records("rows", frame, options, {} if unit is None else {"time_unit": unit})
    elif options.out is None:
        print_page(table_page(frame), options)
    else:
        print(one_line(options.out))


@command(
    "report",
    argument("run", metavar="RUN", help="folder of a run, or of a sweep"),
    argument(
        "--watch",
        action="store_true",
        help="write the report again every few seconds while the run goes on; the page reloads "
        "itself",
    ),
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


@command("plot", add_run, examples={"pfdist plot results/plan": "Draw the figures of a run again"})
def plot_command(options: Namespace) -> None:
    """Draw the figures of a run from its tables."""
    from pfdist.analysis import open_run
    from pfdist.plots import draw_figures

    for file in draw_figures(open_run(options.run)):
        print(one_line(str(file)))


@command(
    "verify", add_run, examples={"pfdist verify results/plan": "Check a run after it was copied"}
)
def verify_command(options: Namespace) -> None:
    """Check every byte, row and key of a run."""
    from pfdist.analysis import open_run
    from pfdist.store.verify import verify_run

    path = Path(options.run)
    damages = list(verify_run(path))
    for damage in damages:
        print(one_line(damage))
    if damages:
        raise StoreError(f"{path}: problems found: {len(damages)}")
    run = open_run(path)
    parts = len(list(path.glob("parts/*/*.parquet")))
    is_finished = run.state == "finished"
    unfinished = "" if is_finished else f"; not finished ({run.state}, {parts} parts)"
    whole = "all files are unchanged, and no row or key is missing"
    print(f"{one_line(options.run)}: {whole}{unfinished}")
