"""The gain of choosing each time when the last measurement is known."""

from typing import Any

from pfdist.common.parts import Cell, Figures, Section, Table, Text
from pfdist.common.percent import percent
from pfdist.questions.subject import ERROR_HEAD, Subject, effect, mse_cell, number_of, percent_cell

_FIGURES = ("online_gain", "online_times", "online_draw")


def online(subject: Subject) -> Section | None:
    """Compare online times with the plan and with the reference."""
    result = subject.summary.online
    if result is None:
        return None
    plan, reference = result["plan"], result["reference"]
    rows = [_row("online", result, {})] + [
        _row(each["name"], each, each) for each in (plan, reference)
    ]
    table = Table(
        f"Expected error on {number_of(result['draws'], 'draw')}",
        ("times", ERROR_HEAD, "online is lower by, %", "draws where online is lower, %"),
        rows,
    )
    meaning = (
        "Each time is chosen when the measurement before it is known: the rest of the plan is made "
        f"anew from what the filter then believes. In {percent(result['differs_from_plan'], 0)} of "
        f"the draws the times differ from those of {plan['name']}."
    )
    return Section("Times chosen one after another", [Text(meaning), table, Figures(_FIGURES)])


def _row(name: str, costs: dict[str, Any], gain: dict[str, Any]) -> list[Cell]:
    cells = [Cell(name), mse_cell(costs["expected_mse"], costs["standard_error"])]
    for key in ("gain_of_means", "positive_fraction"):
        is_known = key in gain
        cells.append(percent_cell(gain[key], gain[f"{key}_interval"]) if is_known else Cell(""))
    return cells


def online_sentence(subject: Subject) -> str:
    """The gain of choosing each time when the last measurement is known; empty if unknown."""
    plan = (subject.summary.online or {}).get("plan", {})
    gain = plan.get("gain_of_means")
    if gain is None:
        return ""
    lowers, left_open = effect(gain, plan["gain_of_means_interval"])
    return (
        f"Choosing each time only when the last measurement is known {lowers}, compared with the "
        f"times of {plan['name']}. {left_open}"
    ).rstrip()
