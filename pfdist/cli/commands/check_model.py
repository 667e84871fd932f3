"""The command ``pfdist check-model``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.answers import print_checks
from pfdist.cli.arguments import add_json, count
from pfdist.cli.command import command
from pfdist.errors import ModelError

_HORIZON, _PARTICLES = 60, 500


def _add_model(parser: ArgumentParser) -> None:
    parser.add_argument(
        "name",
        metavar="MODEL",
        help="name of a model as a job gives it, for instance path/file.py:object",
    )
    parser.add_argument(
        "--horizon",
        type=count,
        default=_HORIZON,
        metavar="T",
        help=f"last instant of the draws (default: {_HORIZON})",
    )
    parser.add_argument(
        "--particles",
        type=count,
        default=_PARTICLES,
        metavar="P",
        help=f"number of particles (default: {_PARTICLES})",
    )


@command(
    "check-model",
    _add_model,
    add_json,
    examples={
        "pfdist check-model mine.py:model": "Check the object `model` in the file mine.py",
        "pfdist check-model ungm --horizon 20": "Check a model that ships, on short draws",
    },
)
def check_model_command(options: Namespace) -> None:
    """Find what is wrong with a model."""
    from pfdist.checks.model import check_model

    checks = check_model(options.name, options.horizon, options.particles)
    wrong = print_checks(checks, options)
    if wrong:
        raise ModelError(f"{options.name}: wrong: {', '.join(wrong)}")
