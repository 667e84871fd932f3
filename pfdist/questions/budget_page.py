"""How many measurements are enough: the expected error of each number, and its lower bound."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_FLOOR, Decimal
from typing import Any

from pfdist.common.parts import Block, Cell, Figures, Section, Table, Text
from pfdist.common.percent import cost, percent
from pfdist.common.rounding import rounded, with_interval
from pfdist.questions.subject import Subject, number_of, sets_table
from pfdist.results.summary import SetResult

_KINDS = ("regular", "found")
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
    results = list(subject.results.values())
    found_results = [result for result in results if result.kind == "found"]
    blocks: list[Block] = [
        *_answer(subject),
        *_target(subject),
        Figures(["budget"]),
        Table("Expected error with its 95 % interval", _HEAD, _rows(results), optional=_HEAD[3:]),
        *([Text(_BOUND, detail=True)] if "bound" in subject.run.tables else []),
        *_worse(results),
        *_believed(found_results),
        sets_table(subject),
    ]
    return Section("How many measurements are enough?", blocks)


def _answer(subject: Subject) -> list[Text]:
    """How many found times do what the largest number of regular times does."""
    regular = [each for each in subject.results.values() if each.kind == "regular"]
    most = max(regular, key=lambda each: each.measurements)
    if most.expected_mse is None:
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
    tried = {each.measurements for each in subject.results.values()}
    below = max((each for each in tried if each < number), default=number - 1)
    if below == number - 1:
        return ""
    first, last = below + 1, number - 1
    return f"{first} was not tried" if first == last else f"{first} to {last} were not tried"


def _rows(results: Sequence[SetResult]) -> list[list[Cell]]:
    rows = defaultdict[int, dict[str, SetResult]](dict)
    for result in results:
        rows[result.measurements][result.kind] = result
    return [
        [
            Cell(str(number), number),
            *(_cost(kinds[kind]) if kind in kinds else Cell("") for kind in _KINDS),
            _bound(kinds["found"]) if "found" in kinds else Cell(""),
        ]
        for number, kinds in sorted(rows.items())
    ]


def _cost(result: SetResult) -> Cell:
    mse, low, high = with_interval(cost(result.expected_mse), result.low, result.high)
    return Cell(f"{mse} ({low} to {high})", cost(result.expected_mse))


def _bound(result: SetResult) -> Cell:
    """The bound and its lower limit, which is rounded down: it must hold as it is printed."""
    bound, limit = result.bound, result.bound_low
    if bound is None or limit is None or not result.bound_error:  # unknown or exact
        return Cell("" if bound is None else rounded(bound), bound)
    text, low, _ = with_interval(bound, limit, 2 * bound - limit)
    floor = Decimal(limit).quantize(Decimal(low), ROUND_FLOOR)
    return Cell(f"{text} (from {floor})".lower(), bound)  # Decimal writes E for e


def _worse(results: Sequence[SetResult]) -> Iterator[Text]:
    """Name the numbers of measurements that are worse than a smaller number."""
    for kind in _KINDS:
        worse = [
            f"{result.measurements} than {result.worse_than}"
            for result in results
            if result.kind == kind and result.worse_than is not None
        ]
        if worse:
            yield Text(
                f"{kind} times: more measurements are worse (95 % for all pairs together), "
                f"N = {', '.join(worse)}"
            )


def _believed(results: Sequence[SetResult]) -> Iterator[Text]:
    """The mean distance of what the search believed from the fresh costs (winner's curse)."""
    excesses = [result.search_excess for result in results if result.search_excess is not None]
    if not excesses or results[0].search_standard_error == 0.0:  # the search knew exact costs
        return
    mean, causes = sum(excesses) / len(excesses), [result.search_cause for result in results]
    settings = [f"{key} = {value}" for key, value in results[0].search_estimation.items()]
    reasons = "; ".join(filter(None, [max(causes, key=causes.count), ", ".join(settings)]))
    side = "below" if mean < 0 else "above"
    yield Text(
        f"found times: the search believed on average {percent(abs(mean))} {side} the fresh cost "
        f"({reasons})",
        detail=True,
    )
    if distrust := results[0].search_distrust:
        yield Text(f"searched again: {distrust}", detail=True)
