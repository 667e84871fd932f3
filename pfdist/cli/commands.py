"""What each command does: call, print; no logic."""

import argparse
import ast
import contextlib
import dataclasses
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfdist.common.parsing import whole_number
from pfdist.errors import (
    JobError,
    MeasurementTimesError,
    ModelError,
    PfdistError,
    PoolError,
    StoreError,
    one_line,
    shown,
)

if TYPE_CHECKING:
    from pfdist.checks.model import Check
    from pfdist.cli.progress import Display

# Each command imports what it needs: to look at a run wants no Numba, and no command all libraries.


def run_command(options: argparse.Namespace) -> None:
    """Run a job, or go on with its run where it stopped."""
    from pfdist.api.run import run
    from pfdist.cli.progress import Display
    from pfdist.job.job import load_job

    with Display() as display:
        finished = run(load_job(options.job, options.set), **_settings(options, display))
    _print_run(finished.summary(), options)


def plan_command(options: argparse.Namespace) -> None:
    """Find measurement times for a job's problem and prove them."""
    from pfdist.api.plan import plan
    from pfdist.cli.progress import Display

    with Display() as display:
        settings = _settings(options, display)
        finished = plan(options.job, search=options.search, changes=options.set, **settings)
    _print_run(finished.summary(), options)


def budget_command(options: argparse.Namespace) -> None:
    """Say how the error falls with the number of measurements, and how many are enough."""
    from pfdist.api.budget import budget
    from pfdist.cli.progress import Display

    numbers, target = _range(options.measurements), options.target
    with Display() as display:
        finished = budget(
            options.job,
            numbers,
            draws=options.draws,
            target=target,
            changes=options.set,
            **_settings(options, display),
        )
    reached = {} if target is None else {"target": target, "reached": finished.reaching(target)}
    _print_run(finished.summary() | reached, options)


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


def _settings(options: argparse.Namespace, display: "Display") -> dict[str, Any]:
    """What a command that computes is told besides its job."""
    names = ("results", "pool", "workers", "address", "fork")
    chosen = {name: getattr(options, name) for name in names}
    return {**chosen, "report": display.report, "say": display.say}


def status_command(options: argparse.Namespace) -> None:
    """Say how far a run is and what it has found."""
    from pfdist.analysis import open_run

    _print_run(open_run(options.run).summary(), options)


def evaluate_command(options: argparse.Namespace) -> None:
    """Estimate the expected MSE of one set of times."""
    from pfdist.api.evaluate import prepare
    from pfdist.common.rounding import rounded, with_error
    from pfdist.job.job import load_job

    job = load_job(options.job, options.set)
    times = _times(options.times)
    compute = prepare(job, times, options.draws, options.particles, options.seed)
    start = time.perf_counter()  # what was compiled was compiled
    evaluation = compute()
    seconds = time.perf_counter() - start
    broken = job.problem.broken(evaluation.measurement_times)
    answer = {
        "expected_mse": evaluation.expected_mse,
        "standard_error": evaluation.standard_error,
        "draws": evaluation.draws,
        "degenerate_draws": evaluation.degenerate_draws,
        "broken_constraints": broken,
        "seconds": round(seconds, 3),
    }
    if options.json:
        _print_json(answer, options)
        return
    for constraint in broken:
        print(f"pfdist: note: these times break a constraint: {constraint}", file=sys.stderr)
    if evaluation.exact is not None:
        print(f"expected MSE {rounded(evaluation.exact)} (exact)")
        return
    print(f"expected MSE {with_error(evaluation.expected_mse, evaluation.standard_error)}")
    print(
        f"{answer['draws']:,} draws, {answer['degenerate_draws']:,} degenerate, "
        f"{answer['seconds']:.1f} s"
    )


def plot_command(options: argparse.Namespace) -> None:
    """Draw the figures of a run from its tables."""
    from pfdist.analysis import open_run
    from pfdist.plots import draw_figures

    for file in draw_figures(open_run(options.run)):
        print(one_line(str(file)))


def why_command(options: argparse.Namespace) -> None:
    """Say what each measurement of a finished run is worth, and draw it."""
    from pfdist.api.why import why
    from pfdist.cli.progress import Display
    from pfdist.cli.summary import print_why

    with Display() as display:
        found = why(
            options.run,
            options.draws,
            model=options.model,
            filter_model=options.filter_model,
            report=display.report,
            say=display.say,
        ).as_json()
    if options.json:
        _print_json(found, options)
        return
    print_why(found)


def verify_command(options: argparse.Namespace) -> None:
    """Look at every byte, row and key of a run."""
    from pfdist.store.repair import verify_run

    path = Path(options.run)
    damages = list(verify_run(path))
    for damage in damages:
        print(one_line(f"{path / damage.path} {damage.what}"))
    if damages:
        if all(damage.is_missing for damage in damages):
            raise StoreError(
                f"{path}: {len(damages)} missing: the job, run again with --results {path}, makes "
                "them again"
            )
        raise StoreError(f"{path}: {len(damages)} wrong; `pfdist repair {path}` says what to do")
    print(f"{one_line(options.run)}: every file is what was committed, every row and key is there")


def repair_command(options: argparse.Namespace) -> None:
    """Move damaged files of a run to quarantine."""
    from pfdist.store.repair import repair_run

    lines = list(repair_run(Path(options.run)))
    for line in lines or [f"{options.run}: nothing to repair"]:
        print(one_line(line))


def doctor_command(options: argparse.Namespace) -> None:
    """Say whether this machine is fit for a run."""
    from pfdist.checks.machine import examine

    wrong = _print_checks(examine(Path(options.results), options.address), options)
    if wrong:
        raise PoolError(f"not fit for a run: {', '.join(wrong)}")


def models_command(options: argparse.Namespace) -> None:
    """List the models that can be named in a job."""
    from pfdist.models import find_model, installed_models

    names = sorted(installed_models())
    width = max(map(len, names))
    for name in names:
        try:
            summary = ast.get_docstring(ast.parse(find_model(name).text)) or ""
        except (PfdistError, SyntaxError) as error:
            summary = f"cannot be loaded: {error}"
        print(f"{name:{width}}  {summary.partition(chr(10))[0]}".rstrip())


def check_model_command(options: argparse.Namespace) -> None:
    """Find what is wrong with a model."""
    from pfdist.checks.model import check_model

    checks = check_model(options.name, options.horizon, options.particles)
    wrong = _print_checks(checks, options)
    if wrong:
        raise ModelError(f"{options.name}: wrong: {', '.join(wrong)}")


def _print_checks(checks: Iterable["Check"], options: argparse.Namespace) -> list[str]:
    """Print them as they come, or as one object; give the names of those that are wrong."""
    from pfdist.cli.summary import print_check

    done = []
    for check in checks:
        done.append(check)
        if not options.json:
            print_check(check)
    if options.json:
        _print_json({"checks": [dataclasses.asdict(check) for check in done]}, options)
    return [check.name for check in done if check.state == "wrong"]


def _times(text: str) -> list[int]:
    try:
        return [whole_number(time.strip()) for time in text.strip().rstrip(",").split(",")]
    except ValueError as error:
        raise MeasurementTimesError(
            f"--times must be integers separated by commas, for instance 0,3,6, got {shown(text)}"
        ) from error


def _print_run(summary: dict[str, Any], options: argparse.Namespace) -> None:
    from pfdist.cli.summary import print_summary

    if options.json:
        _print_json(summary, options)
        return
    path = Path(summary["run"])
    folders = [name for name in ("tables", "figures") if (path / name).is_dir()]
    print_summary(summary, "   ".join(one_line(f"{name}: {path / name}") for name in folders))


def _print_json(value: dict[str, Any], options: argparse.Namespace) -> None:
    from pfdist.analysis import finite

    print(json.dumps(finite(value), indent=2, allow_nan=False), file=options.answers)


@contextlib.contextmanager
def answers_alone(options: argparse.Namespace, *, ends: bool) -> Iterator[None]:
    """Keep standard output for the JSON object that is asked for, whatever a model prints.

    Parameters
    ----------
    options : Namespace
        Whose `answers` becomes the stream for the object. All else goes to standard error, also
        what compiled code and other processes print.
    ends : bool
        Whether the process ends with this command, so that nothing that follows is an answer.
    """
    if not getattr(options, "json", False):
        yield
        return
    with contextlib.ExitStack() as stack:
        options.answers = stack.enter_context(_own_output(sys.stdout, ends=ends))
        stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        yield


@contextlib.contextmanager
def _own_output(stream: Any, *, ends: bool) -> Iterator[Any]:
    """Give a stream to where another one leads, and let its descriptor and 1 lead to 2."""
    try:
        stream.flush()
        kept = {number: os.dup(number) for number in {1, stream.fileno()}}
    except (AttributeError, OSError):  # closed, or none of a process, as in a notebook
        yield stream
        return
    for number in kept:
        try:
            os.dup2(2, number)
        except OSError:  # standard error is closed
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
    answers = os.dup(kept[stream.fileno()])
    try:
        with open(answers, "w", encoding=stream.encoding, errors=stream.errors) as own:
            yield own
    finally:
        for number, copy in kept.items():
            if not ends:
                os.dup2(copy, number)
            os.close(copy)
