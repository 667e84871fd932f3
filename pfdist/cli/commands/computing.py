"""Commands that compute a run: run, plan, budget, compare, online, sweep."""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING

from pfdist.cli.answers import computed, print_page, print_places, print_records, print_run
from pfdist.cli.arguments import (
    RESULTS,
    add_answer,
    add_changes,
    add_job,
    add_json,
    argument,
    computing,
    finite,
    whole,
)
from pfdist.cli.command import command
from pfdist.cli.words import add_named_times, number_list, sets_by_name
from pfdist.common.parsing import SPELLING
from pfdist.errors import shown

if TYPE_CHECKING:
    from pfdist.api.sweep import Sweep


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
    from pfdist.api.run import run

    print_run(computed(run, options), options)


_RESULTS_OF_PLAN = f"{RESULTS}, with -plan after it if the job lists searches"


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
    computing(_RESULTS_OF_PLAN),
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
    from pfdist.api.plan import plan

    print_run(computed(plan, options), options)


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

    finished = computed(budget, options, set(options.measurements))
    print_run(finished, options, options.target)


def _add_sets(parser: ArgumentParser) -> None:
    parser.add_argument(
        "folders",
        nargs="*",
        default=[],
        metavar="RUN",
        help="folders of finished runs, which are only read; their sets are compared, too, beside "
        "those that the job names in [comparison.sets]",
    )
    add_named_times(
        parser,
        "a set to compare, as clinic=0,6,12,24 or paper=0:60:3, on the clock of the problem; the "
        "word regular stands for the regular times; give --times once for each set",
    )
    parser.add_argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of draws on which all sets are compared (default: comparison.draws)",
    )


@command(
    "compare",
    add_job,
    _add_sets,
    computing(f"{RESULTS}-compare", reuse=False),
    add_answer,
    goes_on=True,
    examples={
        "pfdist compare jobs/plan.toml --times clinic=0,20,40,60 --times mine=0:60:3": (
            "Compare two hand-made sets on the same draws"
        ),
        "pfdist compare jobs/plan.toml results/plan --times a=0:20 --results results/a": (
            "Compare a set with those of a finished run"
        ),
    },
)
def compare_command(options: Namespace) -> None:
    """Compare named sets of times, and the sets of runs, on the same fresh draws."""
    from pfdist.api.compare import compare

    times = sets_by_name(options.times)
    finished = computed(compare, options, *options.folders, times=times)
    print_run(finished, options)


_RESULTS_OF_ONLINE = f"{RESULTS}, with -online after it unless the job has a section [online]"


@command(
    "online",
    add_job,
    argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of draws whose times are chosen one after another, for instance 200; they are "
        "the first draws of the comparison (default: online.draws of the job)",
    ),
    computing(_RESULTS_OF_ONLINE),
    add_answer,
    goes_on=True,
    examples={
        "pfdist online jobs/online.toml": (
            "Compare times chosen one after another with times found in advance"
        ),
        "pfdist online jobs/plan.toml --draws 200": (
            "Do so for a job without a section [online], on few draws"
        ),
    },
)
def online_command(options: Namespace) -> None:
    """Choose times one after another, and compare them with times found in advance."""
    from pfdist.api.online import online

    print_run(computed(online, options), options)


def _add_sweep(parser: ArgumentParser) -> None:
    parser.add_argument(
        "job",
        metavar="SWEEP_OR_JOB",
        help="sweep file, which names a job and values of its keys; or a job file, with --over",
    )
    parser.add_argument(
        "--over",
        action="append",
        default=[],
        metavar="KEY=VALUES",
        help="a key of the job with its values, as seed=1:10 or model.parameters.NAME=0.5,1; "
        "give --over once for each key: every combination is a point",
    )
    parser.add_argument(
        "--bound-draws",
        type=whole,
        default=0,
        metavar="K",
        help="number of draws of the lower bound that is proved at each point (default: 0, no "
        "bound)",
    )
    parser.add_argument(
        "--judge",
        action="store_true",
        default=None,
        help="also judge the times found at each point at every point, in the folder "
        "judged of the sweep (default: judge of the sweep file)",
    )
    either = parser.add_mutually_exclusive_group()
    either.add_argument(
        "--part",
        type=_part,
        metavar="K/N",
        help="compute every N-th point, from the K-th, and look at no other, as tasks of a batch "
        "array do; then the same command without --part judges and reports the whole sweep",
    )
    either.add_argument(
        "--dry-run",
        action="store_true",
        help="print the points, their work by the speed of a few draws, and the number of parts "
        "that pays; compute no point",
    )


def _part(text: str) -> tuple[int, int]:
    """The numbers of ``3/200``; `SweepJob.part` knows which are allowed.

    Raises
    ------
    ArgumentTypeError
        The text is no pair of numbers.
    """
    number, slash, parts = text.partition("/")
    if not slash:
        raise ArgumentTypeError(f"must be K/N, as 3/200, got {shown(text)}")
    return whole(number), whole(parts)


@command(
    "sweep",
    _add_sweep,
    add_changes,
    computing(
        "results/<name of the sweep file>, or results/<name of the job>-sweep",
        reuse=False,
        what="sweep",
    ),
    add_json,
    goes_on=True,
    examples={
        "pfdist sweep jobs/plan.toml --over seed=1:3": (
            "Plan with three seeds, with the same workers"
        ),
        "pfdist sweep jobs/plan.toml --over seed=1:2 --over filter.particles=100,500": (
            "Run every combination of two keys"
        ),
        "pfdist sweep jobs/budgets.toml --dry-run": "List the points of a sweep file",
        "pfdist sweep jobs/budgets.toml --part 3/12": "Compute the third of twelve parts",
    },
)
def sweep_command(options: Namespace) -> None:
    """Run a job at many values of its keys, with the same workers."""
    from pfdist.answers.runs import foreseen_page
    from pfdist.api.sweep import foreseen, sweep
    from pfdist.job.points import values_by_key

    over = values_by_key(options.over)
    if options.dry_run:
        points = computed(foreseen, options, over)
        if options.json:
            print_records("points", points, options)
        else:
            print_page(foreseen_page(points), options)
        return
    _print_sweep(computed(sweep, options, over), options)


def _print_sweep(finished: "Sweep", options: Namespace) -> None:
    """Print the table of a sweep, and where its runs and its report are."""
    import pandas as pd

    from pfdist.answers.runs import table_page
    from pfdist.store.folder import REPORT, has_report

    table = finished.table() if finished.runs else pd.DataFrame()
    if options.json:
        print_records("rows", table, options)
        return
    if finished.runs:
        print_page(table_page(table), options)
    if finished.busy:
        print(f"\nother processes compute {', '.join(finished.busy)}")
    report = {"report": finished.path / REPORT} if has_report(finished.path) else {}
    print_places({"runs": finished.path, **report})
