"""The command ``pfdist evaluate``."""

import time
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from pfdist.cli.answers import print_json, print_page
from pfdist.cli.arguments import add_job, add_json, whole
from pfdist.cli.command import command
from pfdist.cli.words import add_named_times, sets_by_name
from pfdist.common.parsing import SPELLING

if TYPE_CHECKING:  # a command that evaluates nothing needs no NumPy
    from pfdist.filters.estimate import Evaluation


def _add_times(parser: ArgumentParser) -> None:
    add_named_times(
        parser,
        f"measurement times: {SPELLING}, for instance 0:60:3, or 0,6,12, or 0 6 12; on the clock "
        "of the job, if it has one; NAME=TIMES, given several times, evaluates several sets on the "
        "same draws",
        required=True,
    )
    parser.add_argument(
        "--draws",
        type=whole,
        metavar="K",
        help="number of draws (default: evaluation.draws of the job)",
    )
    parser.add_argument(
        "--particles",
        type=whole,
        metavar="P",
        help="number of particles (default: filter.particles of the job)",
    )
    parser.add_argument(
        "--seed", type=whole, metavar="S", help="seed of the noise (default: seed of the job)"
    )


@command(
    "evaluate",
    add_job,
    _add_times,
    add_json,
    examples={
        "pfdist evaluate jobs/plan.toml --times 0:60:3": "Measure at t = 0, 3, 6, ..., 60",
        "pfdist evaluate jobs/plan.toml --times 0,6,12 20:30 --draws 5000": (
            "Measure at 0, 6, 12 and at each instant from 20 to 30, on more draws"
        ),
        "pfdist evaluate jobs/plan.toml --times few=0:60:6 --times many=0:60:3": (
            "Evaluate two sets on the same draws"
        ),
    },
)
def evaluate_command(options: Namespace) -> None:
    """Estimate the expected MSE of a set of measurement times, or of several."""
    from pfdist.answers.evaluate import evaluate_page
    from pfdist.api.evaluate import UNNAMED, prepare
    from pfdist.job.job import load_job

    job = load_job(options.job, options.set)
    (name, times), *others = options.times
    is_one = not name and not others
    written = times if is_one else sets_by_name(options.times)
    compute = prepare(job, written, options.draws, options.particles, options.seed)
    start = time.perf_counter()  # after the compilation
    evaluations = compute()
    seconds = time.perf_counter() - start
    broken = {
        name: job.problem.broken(evaluation.measurement_times)
        for name, evaluation in evaluations.items()
    }
    if options.json:
        answers = {name: _answer(evaluations[name], broken[name]) for name in evaluations}
        answer = answers[UNNAMED] if is_one else {"sets": answers}
        print_json(answer | {"seconds": round(seconds, 3)}, options)
        return
    scenarios = job.scenarios.each if job.scenarios else ()
    parameters = [scenario.parameters for scenario in scenarios]
    print_page(evaluate_page(evaluations, broken, parameters), options)


def _answer(evaluation: "Evaluation", broken: list[str]) -> dict[str, Any]:
    return {
        "expected_mse": evaluation.expected_mse,
        "standard_error": evaluation.standard_error,
        "draws": evaluation.draws,
        "degenerate_draws": evaluation.degenerate_draws,
        "top_percent_share": evaluation.top_percent_share,
        "broken_constraints": broken,
    }
