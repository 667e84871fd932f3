"""The command ``pfdist budget``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_run
from pfdist.cli.arguments import RESULTS, add_job, add_json, computing, finite, whole
from pfdist.cli.command import command
from pfdist.common.parsing import whole_number
from pfdist.errors import JobError, shown


def _add_numbers(parser: ArgumentParser) -> None:
    from pfdist.api.budget import DRAWS
    from pfdist.runner.bound_settings import LEAST_DRAWS

    parser.add_argument(
        "--measurements",
        required=True,
        metavar="A:B",
        help="smallest and largest number of measurements, for instance 5:41",
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


@command("budget", add_job, _add_numbers, computing(f"{RESULTS}-budget"), add_json, goes_on=True)
def budget_command(options: Namespace) -> None:
    """Find times for each number of measurements, and compare them with regular times."""
    from pfdist.api.budget import budget
    from pfdist.cli.computing import settings
    from pfdist.cli.progress import Display

    numbers, target = _range(options.measurements), options.target
    with Display() as display:
        finished = budget(
            options.job,
            numbers,
            draws=options.draws,
            target=target,
            bound_draws=options.bound_draws,
            changes=options.set,
            **settings(options, display),
        )
    reached = {} if target is None else {"target": target, "reached": finished.reaching(target)}
    print_run(finished.summary() | reached, options)


def _range(text: str) -> tuple[int, int]:
    least, _, most = text.partition(":")
    try:
        numbers = whole_number(least), whole_number(most)
    except ValueError:
        numbers = (0, 0)
    if not 2 <= numbers[0] <= numbers[1]:
        raise JobError(
            "--measurements must be two numbers A:B with 2 <= A <= B, for instance 5:41, "
            f"got {shown(text)}"
        )
    return numbers
