"""The command line: parse, call, print; no logic."""

import argparse
import ast
import contextlib
import dataclasses
import json
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import pfdist
from pfdist.analysis import finite, open_run
from pfdist.display import Display, print_check, print_summary, print_why
from pfdist.errors import (
    EngineWarning,
    JobError,
    MeasurementTimesError,
    ModelError,
    PfdistError,
    PoolError,
    StoreError,
    TaskError,
)
from pfdist.job import load_job
from pfdist.models import find_model, installed_models
from pfdist.plots import draw_figures
from pfdist.runner.budget import DRAWS as BUDGET_DRAWS
from pfdist.runner.budget import budget
from pfdist.runner.check_model import Check, check_model
from pfdist.runner.doctor import examine
from pfdist.runner.evaluate import evaluate
from pfdist.runner.plan import plan
from pfdist.runner.repair import repair_run, verify_run
from pfdist.runner.run import run
from pfdist.runner.why import DRAWS, why
from pfdist.search_sections import PLANNER, SEARCHES

_EPILOG = (
    "Exit codes: 0 done, 1 an error, 2 a misuse, 130 interrupted by Ctrl-C, "
    "75 ended by SIGTERM or SIGUSR1 (a batch system: run it again to go on)."
)
_GO_ON = "what was done is committed; the same command goes on from there"


_preempted: list[int] = []  # signals by which a batch system has asked for the machine


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        In the place of the process's own.

    Returns
    -------
    int
        The exit code.
    """
    options = _parser().parse_args(arguments)
    _preempted.clear()
    for number in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, _preempt)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, as by nohup
        signal.signal(signal.SIGINT, _interrupt)
    try:
        with _warnings_as_lines():
            options.command(options)
    except PfdistError as error:
        if options.debug:
            raise
        print(f"pfdist: {_one_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        ended = "asked to end" if _preempted else "interrupted"
        go_on = f"; {_GO_ON}" if options.command in (_run, _plan, _budget) else ""
        print(f"pfdist: {ended}{go_on}", file=sys.stderr)
        return 75 if _preempted else 130
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        sys.stderr.close()
        return 1
    except OSError as error:
        print(f"pfdist: {error}", file=sys.stderr)
        return 1
    except MemoryError:
        print("pfdist: not enough memory: fewer draws or particles need less", file=sys.stderr)
        return 1
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))  # asked twice: at once
    raise KeyboardInterrupt


def _preempt(number: int, frame: FrameType | None) -> None:
    for again in (signal.SIGTERM, signal.SIGUSR1):
        signal.signal(again, signal.SIG_IGN)  # it is said twice where a script forwards it
    _preempted.append(number)
    raise KeyboardInterrupt


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"pfdist: warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", EngineWarning)
        warnings.showwarning = show
        yield


def _one_line(error: PfdistError) -> str:
    hint = " (--debug shows the traceback)" if isinstance(error, TaskError) else ""
    return " ".join(str(error).split()) + hint


def _run(options: argparse.Namespace) -> None:
    with Display() as display:
        finished = run(
            load_job(options.job, options.set), fork=options.fork, **_settings(options, display)
        )
    _print_run(finished.summary(), options)


def _plan(options: argparse.Namespace) -> None:
    with Display() as display:
        finished = plan(
            load_job(options.job, options.set), search=options.search, **_settings(options, display)
        )
    _print_run(finished.summary(), options)


def _budget(options: argparse.Namespace) -> None:
    numbers, target = _range(options.measurements), options.target
    with Display() as display:
        finished = budget(
            load_job(options.job, options.set),
            numbers,
            draws=options.draws,
            target=target,
            **_settings(options, display),
        )
    reached = {} if target is None else {"target": target, "reached": finished.reaching(target)}
    _print_run(finished.summary() | reached, options)


def _range(text: str) -> tuple[int, int]:
    least, _, most = text.partition(":")
    if not (least.isdecimal() and most.isdecimal() and 2 <= int(least) <= int(most)):
        raise JobError(
            "--measurements must be two numbers A:B with 2 <= A <= B, for instance 5:41, "
            f"got {text!r}"
        )
    return int(least), int(most)


def _settings(options: argparse.Namespace, display: Display) -> dict[str, Any]:
    """What a command that computes is told besides its job."""
    chosen = {name: getattr(options, name) for name in ("results", "pool", "workers", "address")}
    return {**chosen, "report": display.report, "say": display.say}


def _status(options: argparse.Namespace) -> None:
    _print_run(open_run(options.run).summary(), options)


def _evaluate(options: argparse.Namespace) -> None:
    start = time.perf_counter()
    job = load_job(options.job, options.set)
    evaluation = evaluate(
        job, _times(options.times), options.draws, options.particles, options.seed
    )
    answer = {
        "expected_mse": evaluation.expected_mse,
        "standard_error": evaluation.standard_error,
        "draws": evaluation.draws,
        "degenerate_draws": evaluation.degenerate_draws,
        "seconds": round(time.perf_counter() - start, 3),
    }
    if options.json:
        _print_json(answer)
        return
    print(f"expected MSE {answer['expected_mse']:.4f} ± {answer['standard_error']:.4f}")
    print(
        f"{answer['draws']:,} draws, {answer['degenerate_draws']:,} degenerate, "
        f"{answer['seconds']:.1f} s"
    )


def _plot(options: argparse.Namespace) -> None:
    for file in draw_figures(open_run(options.run)):
        print(file)


def _why(options: argparse.Namespace) -> None:
    with Display() as display:
        found = why(options.run, options.draws, report=display.report, say=display.say).as_json()
    if options.json:
        _print_json(found)
        return
    print_why(found)


def _verify(options: argparse.Namespace) -> None:
    path = Path(options.run)
    damages = list(verify_run(path))
    for damage in damages:
        print(f"{path / damage.path} {damage.what}")
    if damages:
        raise StoreError(f"{path}: {len(damages)} wrong; `pfdist repair {path}` says what to do")
    print(f"{path}: every file is what was committed, every row and key is there")


def _repair(options: argparse.Namespace) -> None:
    lines = list(repair_run(Path(options.run)))
    print("\n".join(lines) or f"{options.run}: nothing to repair")


def _doctor(options: argparse.Namespace) -> None:
    wrong = _print_checks(examine(Path(options.results), options.address), options)
    if wrong:
        raise PoolError(f"not fit for a run: {', '.join(wrong)}")


def _models(options: argparse.Namespace) -> None:
    names = sorted(installed_models())
    width = max(map(len, names))
    for name in names:
        try:
            summary = ast.get_docstring(ast.parse(find_model(name).text)) or ""
        except (PfdistError, SyntaxError) as error:
            summary = f"cannot be loaded: {error}"
        print(f"{name:{width}}  {summary.partition(chr(10))[0]}".rstrip())


def _check_model(options: argparse.Namespace) -> None:
    checks = check_model(options.name, options.horizon, options.particles)
    wrong = _print_checks(checks, options)
    if wrong:
        raise ModelError(f"{options.name}: wrong: {', '.join(wrong)}")


def _print_checks(checks: Iterable[Check], options: argparse.Namespace) -> list[str]:
    """Print them as they come, or as one object; give the names of those that are wrong."""
    done = []
    for check in checks:
        done.append(check)
        if not options.json:
            print_check(check)
    if options.json:
        _print_json({"checks": [dataclasses.asdict(check) for check in done]})
    return [check.name for check in done if check.state == "wrong"]


def _times(text: str) -> list[int]:
    try:
        return [int(time) for time in text.rstrip(",").split(",")]
    except ValueError as error:
        raise MeasurementTimesError(
            f"--times must be integers separated by commas, for instance 0,3,6, got {text!r}"
        ) from error


def _print_run(summary: dict[str, Any], options: argparse.Namespace) -> None:
    if options.json:
        _print_json(summary)
        return
    path = summary["run"]
    print_summary(summary, f"tables: {path}/tables   figures: {path}/figures")


def _print_json(value: dict[str, Any]) -> None:
    print(json.dumps(finite(value), indent=2, allow_nan=False))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pfdist",
        description="Find when to measure so that a particle filter errs least, and prove it.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"pfdist {pfdist.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, function: Any, summary: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=summary, description=summary, epilog=_EPILOG)
        added.set_defaults(command=function)
        added.add_argument("--debug", action="store_true", help="show the traceback of an error")
        return added

    one = command("run", _run, "Run a job, or go on with its run where it stopped.")
    _add_job(one)
    _add_computing(one, "results/<the job file's stem>")
    one.add_argument(
        "--fork", metavar="NEW", help="start another run there, from what --results has evaluated"
    )
    _add_json(one)

    one = command("plan", _plan, "Find measurement times for a job's problem and prove them.")
    _add_job(one)
    _add_computing(one, "results/<the job file's stem>-plan")
    one.add_argument(
        "--search",
        choices=list(SEARCHES),
        default=PLANNER,
        metavar="METHOD",
        help=f"one of {', '.join(SEARCHES)}; with its defaults ({PLANNER})",
    )
    _add_json(one)

    summary = "Say how the error falls with the number of measurements, and how many are enough."
    _add_budget(command("budget", _budget, summary))

    one = command("status", _status, "Say how far a run is and what it has found.")
    one.add_argument("run", metavar="RUN", help="a run's folder")
    _add_json(one)

    one = command("evaluate", _evaluate, "Estimate the expected MSE of one set of times.")
    _add_job(one)
    one.add_argument("--times", required=True, metavar="T,T,...", help="for instance 0,3,6")
    one.add_argument("--draws", type=int, metavar="K", help="how many (evaluation.draws)")
    one.add_argument("--particles", type=int, metavar="P", help="how many (filter.particles)")
    one.add_argument("--seed", type=int, metavar="S", help="in the place of the job's")
    _add_json(one)

    one = command("plot", _plot, "Draw the figures of a run from its tables.")
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = command("why", _why, "Say what each measurement of a finished run is worth, and draw it.")
    one.add_argument("run", metavar="RUN", help="a run's folder; its model is run again")
    one.add_argument(
        "--draws", type=int, default=DRAWS, metavar="K", help=f"how many, of their own ({DRAWS})"
    )
    _add_json(one)

    one = command("verify", _verify, "Look at every byte, row and key of a run.")
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = command("repair", _repair, "Move damaged files of a run to quarantine.")
    one.add_argument("run", metavar="RUN", help="a run's folder")

    one = command("doctor", _doctor, "Say whether this machine is fit for a run.")
    one.add_argument("--results", default="results", metavar="DIR", help="where runs go (results)")
    one.add_argument("--address", default="", help="of a Ray cluster, whose nodes are looked at")
    _add_json(one)

    one = command("check-model", _check_model, "Find what is wrong with a model.")
    one.add_argument(
        "name", metavar="MODEL", help="as a job names it, for instance path/file.py:object"
    )
    one.add_argument("--horizon", type=_count, default=60, metavar="T", help="of the draws (60)")
    one.add_argument(
        "--particles", type=_count, default=500, metavar="P", help="of the filter (500)"
    )
    _add_json(one)

    command("models", _models, "List the models that can be named in a job.")
    return parser


def _add_budget(parser: argparse.ArgumentParser) -> None:
    _add_job(parser)
    parser.add_argument(
        "--measurements", required=True, metavar="A:B", help="from how many to how many"
    )
    parser.add_argument("--target", type=float, metavar="X", help="an expected MSE to be reached")
    parser.add_argument(
        "--draws",
        type=int,
        default=BUDGET_DRAWS,
        metavar="K",
        help=f"on which all are compared ({BUDGET_DRAWS})",
    )
    _add_computing(parser, "results/<the job file's stem>-budget")
    _add_json(parser)


def _count(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= 32_000):
        raise argparse.ArgumentTypeError(f"must be an integer in 1..32000, got {text!r}")
    return int(text)


def _add_job(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("job", metavar="JOB", help="a job file, for instance jobs/paper.toml")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="KEY=VALUE",
        help="change keys of the job, for instance seed=3 search.genetic.generations=5",
    )


def _add_computing(parser: argparse.ArgumentParser, results: str) -> None:
    parser.add_argument(
        "--results", metavar="DIR", help=f"the run's own folder (default: {results})"
    )
    parser.add_argument("--pool", choices=["ray", "serial"], help="where tasks are done (ray)")
    parser.add_argument("--workers", type=int, metavar="N", help="how many (all cores)")
    parser.add_argument("--address", help="of a Ray cluster to join (a local one is started)")


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object, and nothing else"
    )
