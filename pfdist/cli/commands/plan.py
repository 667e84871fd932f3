"""The command ``pfdist plan``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_job, add_json, computing
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


@command("plan", add_job, computing(_RESULTS), _add_search, add_json, goes_on=True)
def plan_command(options: Namespace) -> None:
    """Find measurement times for a job's problem and compare them with regular times."""
    from pfdist.api.plan import plan
    from pfdist.cli.computing import settings
    from pfdist.cli.progress import Display

    with Display() as display:
        chosen = settings(options, display)
        finished = plan(options.job, search=options.search, changes=options.set, **chosen)
    print_run(finished.summary(), options)
