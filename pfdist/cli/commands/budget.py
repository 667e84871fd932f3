"""The command ``pfdist budget``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_answer, add_job, computing, finite, whole
from pfdist.cli.command import command
from pfdist.cli.words import number_list
from pfdist.common.parsing import SPELLING


def _add_numbers(parser: ArgumentParser) -> None:
    from pfdist.api.budget import DRAWS
    from pfdist.runner.bound_settings import LEAST_DRAWS

    parser.add_argument(
        "--measurements",
        type=number_list,
        required=True,
        metavar="NUMBERS",
        help=f"numbers of measurements: {SPELLING}, for instance 5:41, or 5:41:4, or 10,20,30",
    )
    parser.add_argument(
        "--target",
        type=finite,
        metavar="MSE",
        help="also give the smallest number of measurements whose expected MSE is at most MSE, and "
        "the largest number that is proved not to reach MSE with any times",
    )
    parser.add_argument(
        "--draws",
        type=whole,
        default=DRAWS,
        metavar="K",
        help=f"number of draws on which all sets of times are compared (default: {DRAWS})",
    )
    parser.add_argument(
        "--bound-draws",
        type=whole,
        default=LEAST_DRAWS,
        metavar="K",
        help="number of draws of the lower bound that is proved for each number of measurements; 0 "
        f"for no bound (default: {LEAST_DRAWS})",
    )


@command(
    "budget",
    add_job,
    _add_numbers,
    computing(f"{RESULTS}-budget"),
    add_answer,
    goes_on=True,
    examples={
        "pfdist budget jobs/plan.toml --measurements 5:41": (
            "Show how the error falls with 5, 6, ..., 41 measurements"
        ),
        "pfdist budget jobs/plan.toml --measurements 10:40:10 --results results/tens": (
            "Look at 10, 20, 30 and 40 measurements alone"
        ),
        "pfdist budget jobs/plan.toml --measurements 5:41 --target 25": (
            "Find the smallest number of measurements that reaches an error of 25"
        ),
    },
)
def budget_command(options: Namespace) -> None:
    """Find times for each number of measurements, and compare them with regular times."""
    from pfdist.api.budget import budget
    from pfdist.api.display import Display
    from pfdist.cli.computing import settings

    target = options.target
    with Display() as display:
        finished = budget(
            options.job,
            set(options.measurements),
            draws=options.draws,
            target=target,
            bound_draws=options.bound_draws,
            changes=options.set,
            **settings(options, display),
        )
    print_run(finished, options, target)
