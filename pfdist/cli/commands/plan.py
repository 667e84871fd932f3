"""The command ``pfdist plan``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_answer, add_job, computing, whole
from pfdist.cli.command import command

_RESULTS = f"{RESULTS}, with -plan after it if the job lists searches"


def _add_search(parser: ArgumentParser) -> None:
    from pfdist.search.methods import DEFAULT_METHOD, METHODS

    parser.add_argument(
        "--search",
        choices=list(METHODS),
        default=DEFAULT_METHOD,
        metavar="METHOD",
        help=f"search method: {', '.join(METHODS)} (default: {DEFAULT_METHOD}); --set "
        "search.METHOD.KEY=VALUE changes a setting",
    )


def _add_bound_draws(parser: ArgumentParser) -> None:
    from pfdist.runner.bound_settings import LEAST_DRAWS

    parser.add_argument(
        "--bound-draws",
        type=whole,
        metavar="K",
        help="number of draws of the lower bound that is proved for the found times; 0 for no "
        f"bound (default: {LEAST_DRAWS}, or 0 for a range of measurement budgets)",
    )


@command(
    "plan",
    add_job,
    computing(_RESULTS),
    _add_search,
    _add_bound_draws,
    add_answer,
    goes_on=True,
    examples={
        "pfdist plan jobs/plan.toml": (
            "Find times, and prove how good they are; the run is in results/plan"
        ),
        "pfdist plan jobs/two_compartments.toml --set scenarios.criterion=worst": (
            "Plan for the worst of the scenarios of a job"
        ),
        "pfdist plan jobs/plan.toml --set seed=3 --results results/seed3": (
            "Change a key of the job, and keep the run in another folder"
        ),
        "pfdist plan jobs/plan.toml --set filter.particles=auto --results results/auto": (
            "Find first how many particles are enough"
        ),
        "pfdist plan jobs/plan.toml --search greedy_forward --results results/greedy": (
            "Search by another method"
        ),
    },
)
def plan_command(options: Namespace) -> None:
    """Find measurement times for a job's problem, and prove how good they are."""
    from pfdist.api.display import Display
    from pfdist.api.plan import plan
    from pfdist.cli.computing import settings

    with Display() as display:
        chosen = settings(options, display)
        finished = plan(
            options.job,
            search=options.search,
            changes=options.set,
            bound_draws=options.bound_draws,
            **chosen,
        )
    print_run(finished, options)
