"""The command ``pfdist bound``."""

from argparse import ArgumentParser, Namespace
from dataclasses import fields
from typing import Any

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_job_of_run, add_json, count, finite, pool_options, whole
from pfdist.cli.bound_lines import proof_lines
from pfdist.cli.command import command
from pfdist.cli.layout import line, paragraph
from pfdist.common.percent import particle_loss_text
from pfdist.common.rounding import with_error

_PARTS = {
    "relaxation": "relaxation, chance",
    "estimate": "particles, estimate",
    "filter_model": "wrong filter model",
}


def _add_settings(parser: ArgumentParser) -> None:
    from pfdist.bounds.first_windows import WINDOW
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


_add_pool = pool_options(*(f"execution.{key} of the job" for key in ("pool", "workers", "address")))


@command(
    "bound",
    add_job_of_run,
    _add_settings,
    _add_pool,
    add_json,
    goes_on=True,
    examples={
        "pfdist bound jobs/plan.toml": "Prove a lower bound for the times of a finished run",
        "pfdist bound jobs/plan.toml --within 0.05": "Take draws until the gap is at most 5 %",
    },
)
def bound_command(options: Namespace) -> None:
    """Prove how much lower the expected MSE of any other times can be."""
    from pfdist.api.bound import bound
    from pfdist.api.display import Display
    from pfdist.runner.bound_settings import BoundSettings

    settings = {field.name: getattr(options, field.name) for field in fields(BoundSettings)}
    with Display() as display:
        found = bound(
            options.job,
            BoundSettings(**settings),
            results=options.results,
            changes=options.set,
            pool=options.pool,
            workers=options.workers,
            address=options.address,
            progress=display.show,
            say=display.say,
        )
    answer = found.as_json()
    if options.json:
        print_json(answer, options)
        return
    common = {key: answer[key] for key in ("confidence", "is_constrained")}
    lines = (_lines(name, gap | common) for name, gap in answer["sets"].items())
    print("\n\n".join(map("\n".join, lines)))
    if answer["within_reached"] is False:
        print(f"\nThe limit of a found set is above {100 * options.within:g} % with "
              f"{answer['draws']:,} draws.")  # fmt: skip


def _lines(name: str, gap: dict[str, Any]) -> list[str]:
    """Give the lines about one set."""
    number = len(gap["measurement_times"])
    lines = [
        f"{name}: {number} measurement{'s' * (number != 1)}",
        line("expected MSE", _estimate(gap, "expected_mse")),
    ]
    if gap.get("particle_loss_limit") is not None:
        loss = particle_loss_text(gap["particle_loss"], gap["particle_loss_limit"])
        lines.append(line("particles lose", loss))
    if not gap["reason"]:
        lines.append(line("lower bound", _estimate(gap, "bound")))
    lines += proof_lines(gap, number, is_constrained=gap["is_constrained"])
    lines += paragraph(gap.get("warning") or "")
    if gap["reason"]:
        return lines
    scale = 100 / gap["expected_mse"] if gap["expected_mse"] else 0.0
    for part, title in _PARTS.items():
        share, error = (scale * gap[key] for key in (part, f"{part}_error"))
        if share or error:
            lines.append(line(f"  {title}", f"{with_error(share, error)} %"))
    return lines


def _estimate(gap: dict[str, Any], name: str) -> str:
    value = gap[name]
    return "unknown" if value is None else with_error(value, gap[f"{name}_error"])
