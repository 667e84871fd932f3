"""The command ``pfdist bound``."""

from argparse import ArgumentParser, Namespace
from dataclasses import fields

from pfdist.cli.answers import print_json, print_page
from pfdist.cli.arguments import add_answer, add_job_of_run, add_pool, count, finite, whole
from pfdist.cli.command import command


def _add_settings(parser: ArgumentParser) -> None:
    from pfdist.bounds.relaxation import WINDOW
    from pfdist.runner.bound_settings import DRAWS, MEMORY, WITHIN_DRAWS

    parser.add_argument(
        "--within",
        type=finite,
        metavar="GAP",
        help="take more and more draws until the 95 %% limit of the gap of every found set is at "
        "most GAP, for instance 0.02",
    )
    parser.add_argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of fresh draws; with more draws the bound is higher "
        f"(default: {DRAWS}; with --within, at most {WITHIN_DRAWS})",
    )
    parser.add_argument(
        "--particles",
        type=count,
        metavar="P",
        help="number of particles of the bound's filter (default: filter.particles of the job)",
    )
    parser.add_argument(
        "--window",
        type=whole,
        default=WINDOW,
        metavar="K",
        help=f"number of measurements of the first windows (default: {WINDOW})",
    )
    parser.add_argument(
        "--work",
        type=finite,
        metavar="STEPS",
        help="let windows grow for so many particle-steps, for instance 1e9; 0: not at all "
        "(default: twice those of the first windows)",
    )
    parser.add_argument(
        "--memory",
        type=whole,
        default=MEMORY,
        metavar="MIB",
        help=f"memory that the relaxation may take, in MiB (default: {MEMORY})",
    )


@command(
    "bound",
    add_job_of_run,
    _add_settings,
    add_pool,
    add_answer,
    goes_on=True,
    examples={
        "pfdist bound jobs/plan.toml": "Prove a lower bound for the times of a finished run",
        "pfdist bound jobs/plan.toml --within 0.05": "Take draws until the gap is at most 5 %",
    },
)
def bound_command(options: Namespace) -> None:
    """Prove how much lower the expected MSE of any other times can be."""
    from pfdist.answers.bound import bound_page
    from pfdist.api.bound import bound
    from pfdist.api.display import Display
    from pfdist.runner.bound_settings import BoundSettings

    settings = {field.name: getattr(options, field.name) for field in fields(BoundSettings)}
    with Display() as display:
        result = bound(
            options.job,
            BoundSettings(**settings),
            results=options.results,
            changes=options.set,
            pool=options.pool,
            workers=options.workers,
            address=options.address,
            wait_for_cores=options.wait_for_cores,
            progress=display.show,
            say=display.say,
        )
    answer = result.as_json()
    if options.json:
        print_json(answer, options)
    else:
        print_page(bound_page(answer, options.within), options)
