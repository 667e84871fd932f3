"""When to measure a system next, and the error that follows (``pfdist next``)."""

from collections.abc import Mapping
from typing import Any

from pfdist.answers.subject import number_of
from pfdist.common.formatted_times import formatted_time, formatted_times
from pfdist.common.percent import cost
from pfdist.common.rounding import with_error
from pfdist.documents.parts import Facts, Page, Section

_SHOWN = 4  # planned times that are named
_IMPROBABLE = (
    "The model may be wrong about this system: look at the surprise that pfdist filter shows."
)


def next_page(answer: Mapping[str, Any]) -> Page:
    """The answer of `pfdist.next_time`, given as of `pfdist.api.next_time.NextTime.as_json`."""
    so_far = f"{number_of(len(answer['measured']), 'measurement')} so far"
    unit = answer.get("time_unit", "")
    measured = formatted_times(answer["measured"], unit)
    facts = [("measured", f"{so_far}{', at t = ' * bool(measured)}{measured}")]
    if answer["plan"]:
        following, *later = answer["plan"]
        line = f"measure next at t = {formatted_times([following], unit)}"
        if later:
            shown = formatted_times(later[:_SHOWN])
            line += f"; then about {shown}{', ...' if len(later) > _SHOWN else ''}"
        facts += [("expected MSE", _expected(answer, "")), *_before(answer)]
    else:
        why = "the budget is spent" if answer["left"] == 0 else "no further measurement is possible"
        line = f"{so_far}: {why}"
        facts = [("expected MSE", _expected(answer, ""))]
    warnings = [_IMPROBABLE] if answer["is_improbable"] else []
    return Page("", line, [Section("", [Facts(facts)])], warnings)


def _before(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The plan from before these measurements, if it was another one."""
    if answer["planned_before"] == answer["plan"]:
        return []
    times, name = formatted_times(answer["planned_before"]), answer["planned"]
    if not times:
        return [(name, "plans no further measurement")]
    if answer["expected_mse_before"] is None:
        return [(f"planned by {name}", f"t = {times}, no longer possible")]
    expected = _expected(answer, "_before")
    return [(f"planned by {name}", f"t = {times}"), ("its expected MSE", expected)]


def _expected(answer: Mapping[str, Any], plan: str) -> str:
    mse = with_error(cost(answer[f"expected_mse{plan}"]), answer[f"standard_error{plan}"])
    return f"{mse} from t = {formatted_time(answer['now'])} on"
