"""The command ``pfdist why``."""

import textwrap
from argparse import ArgumentParser, Namespace
from typing import Any

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_job_of_run, add_json, whole
from pfdist.cli.command import command
from pfdist.common.percent import cost
from pfdist.common.rounding import with_error
from pfdist.common.told_times import told_time
from pfdist.errors import one_line

_ROUNDING = 1e-12  # relative to the expected MSE: rounding errors of doubles are smaller
_LEAST_WIDTH = 17  # of a column
_WIDTH = 80  # of a line


def _add_draws(parser: ArgumentParser) -> None:
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
    _add_draws,
    add_json,
    examples={
        "pfdist why jobs/plan.toml": "Show what each measurement of the plan is worth",
        "pfdist why jobs/plan.toml --draws 20000": "Show it more precisely",
        "pfdist why results/plan/job.toml": "Ask about a run by the job that it keeps",
    },
)
def why_command(options: Namespace) -> None:
    """Show what each measurement of a run is worth, and how exactly it must be kept."""
    from pfdist.analysis import open_run
    from pfdist.api.display import Display
    from pfdist.api.why import why

    with Display() as display:
        answer = why(
            options.job,
            options.draws,
            results=options.results,
            changes=options.set,
            progress=display.show,
            say=display.say,
        ).as_json()
    if options.json:
        print_json(answer, options)
        return
    drawn = f"on {answer['draws']:,} fresh draws; ± standard error"
    precision = drawn if answer["draws"] else "exact"
    lines, found = list[str](), open_run(answer["run"]).found
    for name, examined in answer["sets"].items():
        lines += _set_lines(name, examined, precision)
        lines += [*_window_lines(examined, is_found=name in found), ""]
    print("\n".join(lines + [one_line(file) for file in answer["figures"]]))


def _set_lines(name: str, examined: dict[str, Any], precision: str) -> list[str]:
    """Give a table with a row for each measurement of a set."""
    mse = examined["expected_mse"]
    rows = [_row(measurement, mse or 0.0) for measurement in examined["worth"]]
    width = max([_LEAST_WIDTH, *(len(cell) for row in rows for cell in row[1:])])
    lines = [
        f"{name}: expected MSE {with_error(cost(mse), examined['standard_error'])} ({precision})",
        "  rise of the expected MSE if the measurement at t is",
    ]
    for row in [["t", "removed", "one earlier", "one later"], *rows]:
        cells = "  ".join(f"{cell:>{width}}" for cell in row[1:])
        lines.append(f"  {row[0]:>5}  {cells}".rstrip())
    return lines


def _window_lines(examined: dict[str, Any], *, is_found: bool) -> list[str]:
    """Give a line for each measurement with its sampling windows, and what follows from them."""
    from pfdist.analysis.sampling_windows import STRICT, WIDE, sentences, windows_of

    rows = examined["sampling_windows"]
    if not rows:
        return []
    levels = {percent: windows_of(rows, percent) for percent in (STRICT, WIDE)}
    lines = [f"  instants to which it alone can move at a loss of at most {STRICT} % and {WIDE} %"]
    for strict, wide in zip(*levels.values(), strict=True):
        told = f"{STRICT} %: {strict.text}; {WIDE} %: {wide.text}"
        told = told if strict.can_be_tried else "fixed by the job or by its neighbours"
        lines += _wrapped(told, f"  t = {told_time(strict.t)}: ")
    said = sentences(rows, examined["jitter"], is_found=is_found)
    return lines + [line for sentence in said for line in _wrapped(sentence, "  ")]


def _wrapped(text: str, start: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=start, subsequent_indent=" " * 6)


def _row(measurement: dict[str, Any], mse: float) -> list[str]:
    """Give a measurement and its rises as text; the cell of an impossible shift is empty."""
    cells = [told_time(measurement["t"])]
    for change in [key for key in measurement if f"{key}_error" in measurement]:
        rise, error = measurement[change], measurement[f"{change}_error"]
        if error == 0.0 and rise is not None and abs(rise) < _ROUNDING * abs(mse):
            rise = 0.0
        cells.append("" if rise is None else with_error(rise, error, sign=True))
    return cells
