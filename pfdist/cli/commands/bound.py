"""The command ``pfdist bound``."""

from argparse import ArgumentParser, Namespace
from typing import Any

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_json, add_models, add_run, count, whole
from pfdist.cli.command import command
from pfdist.common.rounding import rounded, with_error

_PARTS = {
    "relaxation": "relaxation and chance",
    "estimate": "particles and estimate",
    "filter_model": "wrong filter model",
}


def _add_settings(parser: ArgumentParser) -> None:
    from pfdist.api.bound import DRAWS, WINDOW

    parser.add_argument(
        "--draws",
        type=whole,
        default=DRAWS,
        metavar="K",
        help=f"number of fresh draws; with more draws the bound is higher (default: {DRAWS})",
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
        help="number of last measurements that the relaxation keeps; with more the bound is "
        f"higher, and takes several times as long (default: {WINDOW})",
    )


@command("bound", add_run, _add_settings, add_models, add_json)
def bound_command(options: Namespace) -> None:
    """Prove how much lower the expected MSE of any other times can be."""
    from pfdist.api.bound import bound
    from pfdist.cli.progress import Display

    with Display() as display:
        answer = bound(
            options.run,
            options.draws,
            particles=options.particles,
            window=options.window,
            model=options.model,
            filter_model=options.filter_model,
            report=display.report,
            say=display.say,
        ).as_json()
    if options.json:
        print_json(answer, options)
        return
    print("\n\n".join("\n".join(_lines(name, gap)) for name, gap in answer["sets"].items()))


def _lines(name: str, gap: dict[str, Any]) -> list[str]:
    """Give the lines about one set."""
    number = len(gap["measurement_times"])
    times = "time" if number == 1 else f"{number} times"
    lines = [
        f"{name}: {number} measurement{'s' * (number != 1)}",
        f"  expected MSE          {with_error(gap['expected_mse'], gap['expected_mse_error'])}",
    ]
    if gap["reason"]:
        return [*lines, f"  no lower bound        {gap['reason']}"]
    limit = f"  (95 %: {_percent(gap['gap_at_most'])})" if gap["bound_error"] else ""
    lines += [
        f"  lower bound           {with_error(gap['bound'], gap['bound_error'])}",
        f"  no other {times} can lower the error by more than {_percent(gap['gap'])}{limit}",
    ]
    scale = 100 / gap["expected_mse"] if gap["expected_mse"] else 0.0
    for part, title in _PARTS.items():
        share, error = (scale * gap[key] for key in (part, f"{part}_error"))
        if share or error:
            lines.append(f"    {title:<24}{with_error(share, error)} %")
    return lines


def _percent(fraction: float) -> str:
    return f"{rounded(100 * fraction, 2)} %"
