"""The command ``pfdist next``."""

from argparse import ArgumentParser, Namespace
from typing import Any

from pfdist.cli.answers import print_json
from pfdist.cli.arguments import add_job_of_run, add_json, add_measurements, decimal
from pfdist.cli.command import command
from pfdist.cli.layout import line, wrapped_lines
from pfdist.common.percent import cost
from pfdist.common.rounding import with_error
from pfdist.common.told_times import told_time, told_times

_SHOWN = 4  # planned times that are named


def _add_now(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--now",
        type=decimal,
        metavar="T",
        help="the last time that has passed, if nothing was measured then, for instance 17; "
        "times planned up to it are planned again for later",
    )


@command(
    "next",
    add_job_of_run,
    add_measurements,
    _add_now,
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
    from pfdist.api.display import Display
    from pfdist.api.next_time import next_time

    with Display() as display:
        answer = next_time(
            options.job,
            options.measurements,
            now=options.now,
            planned=options.planned,
            prior=options.prior,
            results=options.results,
            changes=options.set,
            say=display.say,
        ).as_json()
    if options.json:
        print_json(answer, options)
        return
    print("\n".join(_lines(answer)))


def _lines(answer: dict[str, Any]) -> list[str]:
    """Give the text that says when to measure next, and the error that follows."""
    number = len(answer["measured"])
    told = f"{number} measurement{'s' * (number != 1)} so far"
    if not answer["plan"]:
        why = "the budget is spent" if answer["left"] == 0 else "no further measurement is possible"
        return [f"{told}: {why}", *_expected(answer, ""), *_warning(answer)]
    following, *later = answer["plan"]
    unit = answer.get("time_unit", "")
    text = f"measure next at t = {told_times([following], unit)}"
    if later:
        named = told_times(later[:_SHOWN])
        text += f"; then about {named}{', ...' if len(later) > _SHOWN else ''}"
    lines = [text, line("known", told), *_expected(answer, "")]
    if answer["planned_before"] != answer["plan"]:
        named = told_times(answer["planned_before"])
        possible = answer["expected_mse_before"] is not None
        ending = "" if possible else ", no longer possible"
        if named:
            lines += wrapped_lines(f"planned by {answer['planned']}", f"t = {named}{ending}")
        else:
            lines.append(line(answer["planned"], "plans no further measurement"))
        lines += _expected(answer, "_before") if possible else []
    return lines + _warning(answer)


def _warning(answer: dict[str, Any]) -> list[str]:
    """Warn if the measurements are too surprising for the model, as `pfdist filter` does."""
    if not answer["is_improbable"]:
        return []
    text = "it may be wrong about this system: look at the surprise that pfdist filter shows"
    return wrapped_lines("the model", text)


def _expected(answer: dict[str, Any], plan: str) -> list[str]:
    mse, error = answer[f"expected_mse{plan}"], answer[f"standard_error{plan}"]
    told = with_error(cost(mse), error)
    return [line("expected MSE", f"{told} from t = {told_time(answer['now'])} on")]
