"""The command ``pfdist filter``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_json, print_page
from pfdist.cli.arguments import add_job_of_run, add_json, add_measurements, add_no_report
from pfdist.cli.command import command
from pfdist.errors import one_line


def _add_out(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        default="",
        metavar="DIR",
        help="folder of table, figure and report (default: the folder of MEASUREMENTS)",
    )


@command(
    "filter",
    add_job_of_run,
    add_measurements,
    _add_out,
    add_no_report,
    add_json,
    examples={
        "pfdist filter jobs/plan.toml patient.csv": "Filter the measurements of one system",
        "pfdist filter jobs/plan.toml patient.csv --planned regular --out filtered": (
            "Compare them with the regular times, and write to another folder"
        ),
    },
)
def filter_command(options: Namespace) -> None:
    """Filter real measurements of one system, with the filter of a job."""
    from pfdist.api.display import Display
    from pfdist.api.filter_measurements import filter_measurements

    with Display() as display:
        answer = filter_measurements(
            options.job,
            options.measurements,
            planned=options.planned,
            prior=options.prior,
            out=options.out,
            results=options.results,
            changes=options.set,
            report=not options.no_report,
            say=display.say,
        )
    if options.json:
        print_json(answer.as_json(), options)
        return
    print_page(answer._page(), options)
    print("\n".join(["", *(one_line(str(file)) for file in answer.files)]))
