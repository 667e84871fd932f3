"""How many measurements are enough: the expected error of each number, and its lower bound."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_FLOOR, Decimal
from typing import Any

from pfdist.common.measurement_times import REGULAR
from pfdist.common.parts import Block, Cell, Figures, Section, Table, Text
from pfdist.common.percent import percent
from pfdist.common.rounding import with_interval
from pfdist.questions.subject import Subject, all_sets, number_of
from pfdist.results.budget_curve import FOUND
from pfdist.results.columns import COLUMNS, Row, interval_cell

_KINDS = (REGULAR, FOUND)
_HEAD = ("N", "regular times", "found times", "lower bound")
_BOUND = (
    "No times of the same number have a lower expected error than the lower bound, with any filter "
    "of the same model. The bound was computed on other draws. So an estimated error can lie below "
    "it by chance."
)


def budget(subject: Subject) -> Section | None:
    """The budget curve of a run for several numbers of measurements."""
    if not subject.is_compared:
        return None
    rows = [*subject.rows.values()]
    blocks: list[Block] = [
        *_answer(subject),
        *_target(subject),
        Figures(["budget"]),
        Table("Expected error with its 95 % interval", _HEAD, _cells(rows), optional=_HEAD[3:]),
        *([Text(_BOUND, detail=True)] if "bound" in subject.run.tables else []),
        *_worse(rows),
        *_estimated([row for row in rows if row.kind == FOUND]),
        all_sets(subject),
    ]
    return Section("How many measurements are enough?", blocks)


def _answer(subject: Subject) -> list[Text]:
    """How many found times do what the largest number of regular times does."""
    regular = [row for row in subject.rows.values() if row.kind == REGULAR]
    most = max(regular, key=lambda row: int(row.measurements))
    if most.expected_mse is None or math.isinf(most.expected_mse):
        return []
    reached = subject.reaching(most.expected_mse)["found"]
    if reached["measurements"] is None:
        return []
    number, regular_times = reached["measurements"], f"{most.measurements} regular times"
    if number < most.measurements:
        reach = "time reaches" if number == 1 else "times reach"
        text = f"{number} found {reach} the error of {regular_times} on these draws."
    else:
        text = f"No smaller number of found times reaches the error of {regular_times}."
    if reached["impossible"] is not None:
        text += f" Proved: no {number_of(reached['impossible'], 'time')} can (95 % confidence)."
    if untried := _untried(subject, number):
        text += f" {untried}."
    return [Text(text, prominent=True)]


def _target(subject: Subject) -> Iterator[Text]:
    """How many measurements reach the expected MSE that the user asks for."""
    if subject.target is None:
        return
    for kind, reached in subject.reaching(subject.target).items():
        number, text = reached["measurements"], _reached(kind, reached, subject.target)
        untried = "" if number is None else _untried(subject, number)
        yield Text(f"{text}; {untried}" if untried else text, prominent=True)
        if reached["measurement_times"] is not None and kind == "found":
            times = subject.listed(reached["measurement_times"])
            yield Text(f"To reach {subject.target:g}, measure at t = {times}.")


def _reached(kind: str, reached: Mapping[str, Any], target: float) -> str:
    number = reached["measurements"]
    low, high = ("more" if bound is None else str(bound) for bound in reached["interval"])
    text = f"target {target:g}: "
    if number is None:
        text += f"none of these numbers of {kind} times reaches it"
    else:
        reach = "time reaches" if number == 1 else "times reach"
        text += f"{number} {kind} {reach} it (95 %: {low} to {high})"
    others = reached["larger_that_do_not"]
    if others:
        text += f", but not {', '.join(map(str, others))}"
    impossible = reached.get("impossible")
    times = "time" if impossible == 1 else "times"
    proved = f"proved: no {impossible} {times} can (95 % confidence)"
    return text if impossible is None else f"{text}; {proved}"


def _untried(subject: Subject, number: int) -> str:
    """Say which numbers below this one were left out, down to the next that was tried."""
    tried = {row.measurements for row in subject.rows.values()}
    below = max((each for each in tried if each < number), default=number - 1)
    if below == number - 1:
        return ""
    first, last = below + 1, number - 1
    return f"{first} was not tried" if first == last else f"{first} to {last} were not tried"


def _cells(rows: Sequence[Row]) -> list[list[Cell]]:
    numbers = defaultdict[int, dict[str, Any]](dict)
    for row in rows:
        numbers[row.measurements][row.kind] = row
    return [
        [
            Cell(str(number), number),
            *(_error(kinds[kind]) if kind in kinds else Cell("") for kind in _KINDS),
            _bound(kinds[FOUND]) if FOUND in kinds else Cell(""),
        ]
        for number, kinds in sorted(numbers.items())
    ]


def _error(row: Row) -> Cell:
    return interval_cell(row.expected_mse, row.expected_mse_low, row.expected_mse_high)


def _bound(row: Row) -> Cell:
    """The bound and its lower limit, which is rounded down: it must hold as it is printed."""
    bound, limit = row.bound, row.bound_low
    if bound is None or limit is None or not row.bound_error:  # unknown or exact
        return COLUMNS["bound"].cell(row)
    text, low, _ = with_interval(bound, limit, 2 * bound - limit)
    floor = Decimal(limit).quantize(Decimal(low), ROUND_FLOOR)
    return Cell(f"{text} (from {floor})".lower(), bound)  # Decimal writes E for e


def _worse(rows: Sequence[Row]) -> Iterator[Text]:
    """Name the numbers of measurements that are worse than a smaller number."""
    for kind in _KINDS:
        worse = [
            f"{row.measurements} than {row.worse_than}"
            for row in rows
            if row.kind == kind and row.worse_than is not None
        ]
        if worse:
            yield Text(
                f"{kind} times: more measurements are worse (95 % for all pairs together), "
                f"N = {', '.join(worse)}"
            )


def _estimated(rows: Sequence[Row]) -> Iterator[Text]:
    """The mean distance of the search's estimates from the fresh errors (winner's curse)."""
    excesses = [row.search_excess for row in rows if row.search_excess is not None]
    if not excesses or rows[0].search_standard_error == 0.0:  # the search knew exact errors
        return
    mean, causes = sum(excesses) / len(excesses), [row.search_cause for row in rows]
    reasons = "; ".join(filter(None, [max(causes, key=causes.count), rows[0].search_settings]))
    side = "below" if mean < 0 else "above"
    yield Text(
        f"found times: the search's estimates lie on average {percent(abs(mean))} {side} the fresh "
        f"errors ({reasons})",
        detail=True,
    )
    if distrust := rows[0].search_distrust:
        yield Text(f"searched again: {distrust}", detail=True)
