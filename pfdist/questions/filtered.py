"""Answers about real measurements: what the filter believes, and when to measure next."""

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.component_names import Component
from pfdist.common.formatted_times import formatted_time, formatted_times
from pfdist.common.parts import (
    Block,
    Cell,
    Facts,
    Page,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.percent import infinite_if_none
from pfdist.common.rounding import rounded, with_error
from pfdist.questions.subject import number_of
from pfdist.store.schema import components_in

_P_DIGITS = 2
_BELIEF = "Mean of the quantity of interest over time with 50 and 90 % bands, by the filter."
_SIZE = "Effective sample size of the filter's particles at each instant."


def filtered_page(answer: Mapping[str, Any], table: pd.DataFrame) -> Page:
    """The report of filtered measurements.

    Parameters
    ----------
    answer : mapping
        As of `pfdist.questions.filter_measurements.FilteredMeasurements.as_json`.
    table : DataFrame
        With the columns of `pfdist.store.filtered_schema`.
    """
    sections = [_belief(answer, table), _fit(answer, table), _instants(table)]
    run, file = Path(answer["run"]).name, Path(answer["measurements"]).name
    number = number_of(len(answer["measured"]), "measurement")
    subtitle = f"{number} of {file}, filtered as the run {run} does, times of {answer['planned']}"
    source = f"from the measurements {file} by the filter of the run {run}"
    warnings = _improbable(answer)
    return Page("What the measurements say", subtitle, sections, warnings, source=source)


def filtered_answer(answer: Mapping[str, Any]) -> Page:
    """The answer of `pfdist.filter_measurements` in short; see `filtered_page`."""
    number = number_of(len(answer["measured"]), "measurement")
    line = f"{number}, filtered as {answer['run']} does; planned: {answer['planned']}"
    evidence = answer["log_evidence"]
    reason = f"none: {answer['why_no_evidence']}" if evidence is None else ""
    facts = _times(answer)
    if surprise := _surprise(answer):
        at, p, among = surprise
        facts.append(("most surprising", f"t = {at}, p = {p} ({among} among all measurements)"))
    facts.append(("log evidence", reason or rounded(evidence)))
    return Page("", line, [Section("", [Facts(facts)])], _improbable(answer))


def _times(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    unit = answer.get("time_unit", "")
    names = {
        "measured": "measured at t",
        "missing": "planned, missing",
        "to_come": "planned, to come",
        "extra": "measured, not planned",
    }
    return [(name, formatted_times(answer[key], unit) or "none") for key, name in names.items()]


def _surprise(answer: Mapping[str, Any]) -> tuple[str, str, str] | None:
    """Time and p-value of the most surprising measurement, and the p-value among all."""
    most = answer["most_surprising"]
    if not most:
        return None
    p_values = most["surprise"], answer["surprise_of_all"]
    alone, among = (rounded(p, _P_DIGITS) for p in p_values)
    return _time(answer, most["t"]), alone, among


def _improbable(answer: Mapping[str, Any]) -> list[str]:
    """The warning about an improbable measurement, if there is one."""
    at, p, among = _surprise(answer) or ("", "", "")
    what = f"The measurement at t = {at} is improbable, p = {p} ({among} among all)"
    return [f"{what}: the model may be wrong about this system."] * answer["is_improbable"]


def _time(answer: Mapping[str, Any], t: float) -> str:
    """A time with the unit of the answer's clock."""
    return formatted_times([t], answer.get("time_unit", ""))


def _belief(answer: Mapping[str, Any], table: pd.DataFrame) -> Section:
    # Not above: the answers without pictures, and the help, wait for no Matplotlib.
    from pfdist.pages.filtered import filtered_plot  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    times = tuple(answer[key] for key in ("measured", "missing", "extra", "to_come"))
    plot = filtered_plot(table, times)
    return Section(
        "What the filter believes", [picture(plot, "belief", _BELIEF), Facts(_times(answer))]
    )


def _fit(answer: Mapping[str, Any], table: pd.DataFrame) -> Section:
    """Say how well the measurements fit the model, and how many particles count."""
    from pfdist.pages.figure import Plot  # noqa: PLC0415  as in _belief
    from pfdist.pages.why import effective_sample_size  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    blocks: list[Block] = []
    if surprise := _surprise(answer):
        at, p, among = surprise
        text = (
            f"The most surprising measurement is that at t = {at}: p = {p}, and {among} among all "
            "measurements. A p-value near 0 means that the model hardly ever gives such a "
            "measurement."
        )
        blocks.append(Text(text))
    if answer["log_evidence"] is not None:
        blocks.append(Text(f"Log evidence of the model: {rounded(answer['log_evidence'])}."))
    rows = table.dropna(subset="effective_sample_size")
    if len(rows):
        least = rows.iloc[rows["effective_sample_size"].argmin()]
        title = (
            f"At t = {_time(answer, least['t'])} the fewest particles count: "
            f"{least['effective_sample_size']:.0f}."
        )
        plot = Plot(2.0, lambda panels: effective_sample_size(table, ax=panels[0]), title=title)
        blocks.append(picture(plot, "size", _SIZE))
    return Section("How well they fit the model", blocks)


def _instants(table: pd.DataFrame) -> Section:
    quantities = components_in(table, "mean_")
    is_single = len(quantities) == 1
    names = [
        f" of {each.label}" if each.label else "" if is_single else f" of z{k}"
        for k, each in enumerate(quantities)
    ]
    head = ["t", "measured", *(f"{what}{name}" for name in names for what in ("mean", "90 % band"))]
    rows = [_row(row, quantities) for row in table.to_dict("records")]
    instants = Table("Belief at each instant", [*head, "surprise"], rows, detail=True)
    return Section("All instants", [without_empty_columns(instants)])


def _row(row: Mapping[Hashable, Any], quantities: Sequence[Component]) -> list[Cell]:
    cells = [Cell(formatted_time(row["t"]), row["t"]), Cell("yes" if row["measured"] else "no")]
    for each in quantities:
        mean, low, high = (row[f"{name}_{each.suffix}"] for name in ("mean", "q05", "q95"))
        cells.append(Cell(rounded(mean), mean))
        cells.append(Cell(f"{rounded(low)} to {rounded(high)}", low))
    surprise = row["surprise"]
    is_known = surprise is not None and not pd.isna(surprise)
    return [*cells, Cell(rounded(surprise, _P_DIGITS), surprise) if is_known else Cell("")]


_SHOWN = 4  # planned times that are named
_SEE_SURPRISE = (
    "The model may be wrong about this system: look at the surprise that pfdist filter shows."
)


def next_page(answer: Mapping[str, Any]) -> Page:
    """The answer of `pfdist.next_time`, given as of `NextTime.as_json`."""
    so_far = f"{number_of(len(answer['measured']), 'measurement')} so far"
    unit = answer.get("time_unit", "")
    measured = formatted_times(answer["measured"], unit)
    facts = [("expected MSE", _expected(answer, ""))]
    if answer["plan"]:
        following, *later = answer["plan"]
        own_unit = "" if later and isinstance(following, str) else unit
        line = f"measure next at t = {formatted_times([following], own_unit)}"
        if later:
            shown = formatted_times(later[:_SHOWN], unit)
            line += f"; then about {shown}{', ...' if len(later) > _SHOWN else ''}"
        where = f"{so_far}{', at t = ' * bool(measured)}{measured}"
        facts = [("measured", where), *facts, *_before(answer)]
    else:
        why = "the budget is spent" if answer["left"] == 0 else "no further measurement is possible"
        line = f"{so_far}: {why}"
    return Page("", line, [Section("", [Facts(facts)])], [_SEE_SURPRISE] * answer["is_improbable"])


def _before(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The plan from before these measurements, if it was another one."""
    if answer["planned_before"] == answer["plan"]:
        return []
    unit, name = answer.get("time_unit", ""), answer["planned"]
    times = formatted_times(answer["planned_before"], unit)
    if not times:
        return [(name, "plans no further measurement")]
    if answer["expected_mse_before"] is None:
        return [(f"planned by {name}", f"t = {times}, no longer possible")]
    expected = _expected(answer, "_before")
    return [(f"planned by {name}", f"t = {times}"), ("its expected MSE", expected)]


def _expected(answer: Mapping[str, Any], plan: str) -> str:
    error = infinite_if_none(answer[f"expected_mse{plan}"])
    mse = with_error(error, answer[f"standard_error{plan}"])
    return f"{mse} from t = {_time(answer, answer['now'])} on"
