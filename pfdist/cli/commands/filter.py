"""The command ``pfdist filter``."""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import Any

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_job_of_run, add_json, add_measurements, add_no_report
from pfdist.cli.command import command
from pfdist.cli.layout import line, wrapped_lines
from pfdist.common.rounding import rounded
from pfdist.common.told_times import told_times
from pfdist.errors import one_line

_DIGITS = 2  # of a p-value


def _add_out(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        default="",
        metavar="DIR",
        help="folder of table, figure and report (default: the folder of MEASUREMENTS)",
    )


@command(
    "filter",
    add_job_of_run,
    add_measurements,
    _add_out,
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
    from pfdist.api.display import Display
    from pfdist.api.filter_measurements import filter_measurements

    with Display() as display:
        answer = filter_measurements(
            options.job,
            options.measurements,
            planned=options.planned,
            prior=options.prior,
            out=options.out,
            results=options.results,
            changes=options.set,
            report=not options.no_report,
            say=display.say,
        ).as_json()
    if options.json:
        print_json(answer, options)
        return
    print("\n".join(_lines(answer)))


def _lines(answer: dict[str, Any]) -> list[str]:
    """Give the text that says which measurements there are, and how well they fit the model."""
    number, unit = len(answer["measured"]), answer.get("time_unit", "")
    lines = [
        f"{number} measurement{'s' * (number != 1)}; planned: {answer['planned']}",
        *wrapped_lines("planned, missing", _times(answer["missing"], unit)),
        *wrapped_lines("planned, to come", _times(answer["to_come"], unit)),
        *wrapped_lines("measured, not planned", _times(answer["extra"], unit)),
    ]
    most = answer["most_surprising"]
    if most:
        text = f"t = {told_times([most['t']], unit)}, p = {rounded(most['surprise'], _DIGITS)}"
        among = rounded(answer["surprise_of_all"], _DIGITS)
        lines.append(line("most surprising", f"{text} ({among} among all measurements)"))
    if answer["is_improbable"]:
        text = "it may be wrong about this system: it rarely gives measurements as surprising"
        lines += wrapped_lines("the model", text)
    evidence = answer["log_evidence"]
    text = rounded(evidence) if evidence is not None else f"none: {answer['why_no_evidence']}"
    lines += wrapped_lines("log evidence", text)
    files = ("table", "figure", "report")
    return [*lines, "", *(one_line(answer[file]) for file in files if answer[file])]


def _times(times: Sequence[float], unit: str) -> str:
    return f"t = {told_times(times, unit)}" if times else "none"
