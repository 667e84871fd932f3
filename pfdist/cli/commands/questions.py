"""Commands that answer a question: bound, why, evaluate, filter, next."""

import time
from argparse import ArgumentParser, Namespace
from dataclasses import fields

from pfdist.cli.answers import computed, print_answer, print_json, print_page
from pfdist.cli.arguments import (
    add_answer,
    add_job,
    add_job_of_run,
    add_json,
    add_measurements,
    add_no_report,
    add_pool,
    argument,
    count,
    decimal,
    finite,
    whole,
)
from pfdist.cli.command import command
from pfdist.cli.words import add_named_times, sets_by_name
from pfdist.common.parsing import SPELLING

_ANSWERED = ("expected_mse", "standard_error", "draws", "degenerate_draws", "top_percent_share")


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
    from pfdist.api.bound import bound
    from pfdist.runner.bound_settings import BoundSettings

    settings = {field.name: getattr(options, field.name) for field in fields(BoundSettings)}
    print_answer(computed(bound, options, BoundSettings(**settings)), options)


def _add_why_draws(parser: ArgumentParser) -> None:
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
    _add_why_draws,
    add_answer,
    examples={
        "pfdist why jobs/plan.toml": "Show what each measurement of the plan is worth",
        "pfdist why jobs/plan.toml --draws 20000": "Show it more precisely",
        "pfdist why results/plan": "Ask about a run by its folder",
    },
)
def why_command(options: Namespace) -> None:
    """Show what each measurement of a run is worth, and how exactly it must be kept."""
    from pfdist.api.why import why

    answer = computed(why, options)
    print_answer(answer, options, answer.figures)


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
        answers = {
            name: {key: getattr(evaluation, key) for key in _ANSWERED}
            | {"broken_constraints": broken[name]}
            for name, evaluation in evaluations.items()
        }
        answer = answers[UNNAMED] if is_one else {"sets": answers}
        print_json(answer | {"seconds": round(seconds, 3)}, options)
        return
    scenarios = job.scenarios.each if job.scenarios else ()
    parameters = [scenario.parameters for scenario in scenarios]
    print_page(evaluate_page(evaluations, broken, parameters), options)


@command(
    "filter",
    add_job_of_run,
    add_measurements,
    argument(
        "--out",
        default="",
        metavar="DIR",
        help="folder of table, figure and report (default: the folder of MEASUREMENTS)",
    ),
    add_no_report,
    add_json,
    examples={
        "pfdist filter jobs/plan.toml patient.csv": "Filter the measurements of one system",
        "pfdist filter jobs/plan.toml patient.csv --planned regular --out filtered": (
            "Compare them with the regular times, and write to another folder"
        ),
    },
)
def filter_command(options: Namespace) -> None:
    """Filter real measurements of one system, with the filter of a job."""
    from pfdist.api.filter_measurements import filter_measurements

    answer = computed(filter_measurements, options)
    print_answer(answer, options, answer.files)


@command(
    "next",
    add_job_of_run,
    add_measurements,
    argument(
        "--now",
        type=decimal,
        metavar="T",
        help="the last time that has passed, if nothing was measured then, for instance 17; "
        "times planned up to it are planned again for later",
    ),
    add_json,
    examples={
        "pfdist next jobs/plan.toml patient.csv": "Say when to measure this patient next",
        "pfdist next jobs/plan.toml patient.csv --now 17": (
            "Say so if nothing was measured since, up to t = 17"
        ),
    },
)
def next_command(options: Namespace) -> None:
    """Choose when to measure a system next, from the measurements so far."""
    from pfdist.api.next_time import next_time

    print_answer(computed(next_time, options), options)
