"""The command ``pfdist run``."""

from argparse import Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_answer, add_job, computing
from pfdist.cli.command import command


@command(
    "run",
    add_job,
    computing(RESULTS),
    add_answer,
    goes_on=True,
    examples={
        "pfdist run jobs/quick.toml": "Run a small job; the run is in results/quick",
        "pfdist run jobs/quick.toml --pool serial --results results/serial": (
            "Run it in one process, without Ray"
        ),
        "pfdist run jobs/quick.toml --set comparison.draws=8000": (
            "Go on with more draws in the comparison"
        ),
    },
)
def run_command(options: Namespace) -> None:
    """Run the searches of a job and compare the found times with regular times."""
    from pfdist.api.display import Display
    from pfdist.api.run import run
    from pfdist.cli.computing import settings
    from pfdist.job.job import load_job

    with Display() as display:
        finished = run(load_job(options.job, options.set), **settings(options, display))
    print_run(finished, options)
