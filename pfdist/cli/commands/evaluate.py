"""The command ``pfdist evaluate``."""

import sys
import time
from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_job, add_json, whole
from pfdist.cli.command import command
from pfdist.cli.words import number_list
from pfdist.common.number_list import SPELLING


def _add_times(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--times",
        type=number_list,
        required=True,
        metavar="TIMES",
        help=f"measurement times: {SPELLING}, for instance 0:60:3, or 0,6,12, or 0 6 12",
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
    },
)
def evaluate_command(options: Namespace) -> None:
    """Estimate the expected MSE of one set of measurement times."""
    from pfdist.api.evaluate import prepare
    from pfdist.common.rounding import rounded, with_error
    from pfdist.job.job import load_job

    job = load_job(options.job, options.set)
    compute = prepare(job, options.times, options.draws, options.particles, options.seed)
    start = time.perf_counter()  # after the compilation
    evaluation = compute()
    seconds = time.perf_counter() - start
    broken = job.problem.broken(evaluation.measurement_times)
    if options.json:
        answer = {
            "expected_mse": evaluation.expected_mse,
            "standard_error": evaluation.standard_error,
            "draws": evaluation.draws,
            "degenerate_draws": evaluation.degenerate_draws,
            "broken_constraints": broken,
            "seconds": round(seconds, 3),
        }
        print_json(answer, options)
        return
    for constraint in broken:
        print(f"pfdist: note: these times break a constraint: {constraint}", file=sys.stderr)
    if evaluation.exact is not None:
        print(f"expected MSE {rounded(evaluation.exact)} (exact)")
        return
    print(f"expected MSE {with_error(evaluation.expected_mse, evaluation.standard_error)}")
    print(
        f"{evaluation.draws:,} draws, {evaluation.degenerate_draws:,} degenerate, {seconds:.1f} s"
    )
