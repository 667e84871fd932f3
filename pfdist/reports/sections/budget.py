"""How many measurements are enough: the expected error of each number, and its lower bound."""

from typing import Any

from pfdist.common.percent import cost
from pfdist.common.rounding import with_error, with_interval
from pfdist.reports.parts import Block, Cell, Section, Table, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject, number_of, sets_table

_KINDS = ("regular", "found")
_HEAD = ("measurements", "regular times", "found times", "lower bound")

_BOUND = (
    "No times of the same number have a lower expected error than the lower bound, with any filter "
    "of the same model. The bound was computed on other draws. So an estimated error can lie below "
    "it by chance."
)


def budget(subject: Subject) -> Section | None:
    """Give the budget curve of a run for several numbers of measurements."""
    if not subject.is_compared:
        return None
    blocks: list[Block] = [
        *_answer(subject),
        *pictures(subject.tables, ["budget"]),
        Table("Expected error with its 95 % interval", _HEAD, _rows(subject)),
        *([Text(_BOUND)] if subject.run.has("bound") else []),
        sets_table(subject),
    ]
    return Section("How many measurements are enough?", blocks)


def _answer(subject: Subject) -> list[Text]:
    """How many found times do what the largest number of regular times does."""
    regular = [each for each in subject.results.values() if each["kind"] == "regular"]
    most = max(regular, key=lambda each: int(each["measurements"]))
    if most["expected_mse"] is None:
        return []
    reached = subject.run.reaching(most["expected_mse"])["found"]
    if reached["measurements"] is None:
        return []
    number, regular_times = reached["measurements"], f"{most['measurements']} regular times"
    if number < most["measurements"]:
        reach = "time reaches" if number == 1 else "times reach"
        told = f"{number} found {reach} the error of {regular_times} on these draws."
    else:
        told = f"No smaller number of found times reaches the error of {regular_times}."
    if reached["impossible"] is not None:
        told += f" No {number_of(reached['impossible'], 'time')} can (95 %)."
    return [Text(told, prominent=True)]


def _rows(subject: Subject) -> list[list[Cell]]:
    rows: dict[int, dict[str, dict[str, Any]]] = {}
    for result in subject.results.values():
        rows.setdefault(result["measurements"], {})[result["kind"]] = result
    return [_row(number, rows[number]) for number in sorted(rows)]


def _row(number: int, kinds: dict[str, dict[str, Any]]) -> list[Cell]:
    cells = [Cell(str(number), number)]
    cells += [_cost(kinds[kind]) if kind in kinds else Cell("") for kind in _KINDS]
    found = kinds.get("found", {})
    bound = found.get("bound")
    shown = "" if bound is None else with_error(bound, found["bound_error"])
    return [*cells, Cell(shown, bound)]


def _cost(result: dict[str, Any]) -> Cell:
    mse, low, high = with_interval(cost(result["expected_mse"]), result["low"], result["high"])
    return Cell(f"{mse} ({low} to {high})", cost(result["expected_mse"]))
