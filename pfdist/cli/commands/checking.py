"""Commands that need no run: check-model, models, doctor."""

from argparse import ArgumentParser, Namespace
from importlib import import_module
from pathlib import Path

from pfdist.cli.answers import print_checks
from pfdist.cli.arguments import add_json, count
from pfdist.cli.command import command
from pfdist.cli.words import time_list
from pfdist.errors import ModelError, PoolError


def _add_model(parser: ArgumentParser) -> None:
    parser.add_argument(
        "name",
        metavar="MODEL",
        help="name of a model as a job gives it, for instance path/file.py:object; or a job file, "
        "whose models and filter are checked",
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--horizon",
        type=count,
        metavar="T",
        help="last instant of the draws of formulas (default: that of the job, or 60)",
    )
    length.add_argument(
        "--times",
        type=time_list,
        metavar="TIMES",
        help="a clock, for models that read p.time or p.dt: the time of every instant, for "
        "instance 0:48:0.5, or 0 0.25 0.5 1:48 (default for such models: 0, 1, 2, ..., T)",
    )
    parser.add_argument(
        "--particles",
        type=count,
        metavar="P",
        help="number of particles (default: that of the job, or 500)",
    )


@command(
    "check-model",
    _add_model,
    add_json,
    examples={
        "pfdist check-model mine.py:model": "Check the object `model` in the file mine.py",
        "pfdist check-model ungm --horizon 20": "Check a model that ships, on short draws",
        "pfdist check-model jobs/plan.toml": "Check the models of a job, with its parameters",
        "pfdist check-model mine.py:model --times 0:12:0.5 14 18 24": "Check a model on a clock",
    },
)
def check_model_command(options: Namespace) -> None:
    """Find what is wrong with a model."""
    from pfdist.api.check_model import checks_of
    from pfdist.times.written import clock_of

    times = clock_of(options.times).times if options.times else ()
    checks = checks_of(options.name, options.horizon, options.particles, times)
    wrong = print_checks(checks, options)
    if wrong:
        raise ModelError(f"{options.name}: wrong: {', '.join(wrong)}")


@command("models", examples={"pfdist models": "Show which names a job can give as model.name"})
def models_command(options: Namespace) -> None:
    """List the models that a job can name."""
    from pfdist.models import installed_models

    models = installed_models()
    width = max(map(len, models))
    for name in sorted(models):
        try:
            description = import_module(models[name][0]).__doc__ or ""
        except Exception as error:  # a package that was installed beside pfdist
            description = f"cannot be loaded: {type(error).__name__}: {error}"
        print(f"{name:{width}}  {description.partition(chr(10))[0]}".rstrip())


def _add_machine(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--results",
        default="results",
        metavar="DIR",
        help="folder that will hold runs (default: results)",
    )
    parser.add_argument(
        "--address",
        default="",
        metavar="HOST:PORT",
        help="check the nodes of the Ray cluster at this address, too",
    )


@command(
    "doctor",
    _add_machine,
    add_json,
    examples={
        "pfdist doctor": "Check this machine, before the first run",
        "pfdist doctor --results /tmp": "Check whether another disk can hold runs",
    },
)
def doctor_command(options: Namespace) -> None:
    """Check whether this machine is fit for a run."""
    from pfdist.checks.machine import examine

    wrong = print_checks(examine(Path(options.results), options.address), options)
    if wrong:
        raise PoolError(f"not fit for a run: {', '.join(wrong)}")
