"""The command ``pfdist next``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_json, print_page
from pfdist.cli.arguments import add_job_of_run, add_json, add_measurements, decimal
from pfdist.cli.command import command


def _add_now(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--now",
        type=decimal,
        metavar="T",
        help="the last time that has passed, if nothing was measured then, for instance 17; "
        "times planned up to it are planned again for later",
    )


@command(
    "next",
    add_job_of_run,
    add_measurements,
    _add_now,
    add_json,
    examples={
        "pfdist next jobs/plan.toml patient.csv": "Say when to measure this patient next",
        "pfdist next jobs/plan.toml patient.csv --now 17": (
            "Say so if nothing was measured since, up to t = 17"
        ),
    },
)
def next_command(options: Namespace) -> None:
    """Choose when to measure a system next, from the measurements so far."""
    from pfdist.api.display import Display
    from pfdist.api.next_time import next_time

    with Display() as display:
        answer = next_time(
            options.job,
            options.measurements,
            now=options.now,
            planned=options.planned,
            prior=options.prior,
            results=options.results,
            changes=options.set,
            say=display.say,
        )
    if options.json:
        print_json(answer.as_json(), options)
    else:
        print_page(answer._page(), options)
