"""The command ``pfdist why``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_json, print_page
from pfdist.cli.arguments import add_answer, add_job_of_run, whole
from pfdist.cli.command import command
from pfdist.errors import one_line


def _add_draws(parser: ArgumentParser) -> None:
    from pfdist.api.why import DRAWS

    parser.add_argument(
        "--draws",
        type=whole,
        default=DRAWS,
        metavar="K",
        help=f"number of fresh draws (default: {DRAWS})",
    )


@command(
    "why",
    add_job_of_run,
    _add_draws,
    add_answer,
    examples={
        "pfdist why jobs/plan.toml": "Show what each measurement of the plan is worth",
        "pfdist why jobs/plan.toml --draws 20000": "Show it more precisely",
        "pfdist why results/plan/job.toml": "Ask about a run by the job that it keeps",
    },
)
def why_command(options: Namespace) -> None:
    """Show what each measurement of a run is worth, and how exactly it must be kept."""
    from pfdist.api.display import Display
    from pfdist.api.why import why

    with Display() as display:
        answer = why(
            options.job,
            options.draws,
            results=options.results,
            changes=options.set,
            progress=display.show,
            say=display.say,
        )
    if options.json:
        print_json(answer.as_json(), options)
        return
    print_page(answer._page(), options)
    print("\n".join(["", *(one_line(str(file)) for file in answer.figures)]))
