"""How the times do in each scenario: a table, and the worst scenario in a sentence."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pfdist.common.estimate import Estimate
from pfdist.common.parts import Cell, Section, Table, Text
from pfdist.common.percent import percent
from pfdist.common.rounding import with_error
from pfdist.questions.subject import Subject, effect
from pfdist.results.columns import COLUMNS, Row

_THE_WORST = "the expected error of the worst scenario"

_MEANING = (
    "The true model of each draw has the parameters of one scenario, with the probability of its "
    "share. The last column says how much lower the error of the last set is than that of the "
    "first. Intervals in brackets hold with 95 % for one scenario alone. The worst scenario is "
    "chosen by these same draws, so the largest error is a little too large."
)


def scenarios(subject: Subject) -> Section | None:
    """The expected error of the best sets and of the reference in each scenario."""
    if not subject.scenarios:
        return None
    shown = [subject.reference_row.name, *reversed(subject.shown)]
    head = ("scenario", "share, %", *shown, COLUMNS["gain_of_means"].head)
    rows = defaultdict[int, dict[str, Any]](dict)
    for row in subject.scenarios:
        rows[row.scenario][row.name] = row
    cells = [_cells(of_set, shown) for _, of_set in sorted(rows.items())]
    texts = [Text(sentence, prominent=True) for sentence in _sentences(subject, shown[-1])]
    table = Table(
        "Expected error ± standard error in each scenario", head, cells, optional=shown[1:-1]
    )
    return Section("In each scenario", [*texts, table, Text(_MEANING, detail=True)])


def _cells(of_set: Mapping[str, Row], shown: Sequence[str]) -> list[Cell]:
    best, error = of_set[shown[-1]], COLUMNS["expected_mse"]
    return [
        Cell(parameters_text(best.parameters), best.scenario),
        Cell(percent(best.share, 1), best.share),
        *(error.cell(of_set[name]) for name in shown),
        COLUMNS["gain_of_means"].cell(best),
    ]


def _worst_scenario(subject: Subject, name: str) -> Row | None:
    """The scenario with the largest expected MSE of a set; None if one is unknown or infinite."""
    rows = [row for row in subject.scenarios if row.name == name]
    if not all(row.expected_mse is not None and math.isfinite(row.expected_mse) for row in rows):
        return None
    return max(rows, key=lambda row: float(row.expected_mse))


def _sentences(subject: Subject, best: str) -> Iterator[str]:
    """Compare the worst scenario of the best set with that of the reference."""
    names = best, subject.reference_row.name
    worst, reference = (_worst_scenario(subject, name) for name in names)
    if worst is None or reference is None or best == reference.name:
        return
    errors = [with_error(each.expected_mse, each.standard_error) for each in (worst, reference)]
    first, second = (parameters_text(each.parameters) for each in (worst, reference))
    where = "there, too" if first == second else f"in its worst scenario, {second}"
    yield (
        f"The worst scenario of {best} is {first}, with an expected error of {errors[0]}; "
        f"{reference.name} has {errors[1]} {where}."
    )


def worst_effect(subject: Subject, name: str) -> str | None:
    """Say what a set does to the error of the worst scenario, if the job asks for the least.

    The worst scenarios of two sets may differ. Then their draws do, too, so the logarithms of the
    two errors are independent.
    """
    if not (subject.scenarios and subject.worst_decides):
        return None
    names = name, subject.reference_row.name
    worst, reference = (_worst_scenario(subject, each) for each in names)
    if worst is None or reference is None or not worst.expected_mse * reference.expected_mse:
        return None
    ends = [worst.gain_of_means_low, worst.gain_of_means_high]
    mse, of_reference = (
        Estimate(each.expected_mse, each.standard_error) for each in (worst, reference)
    )
    if worst.scenario != reference.scenario:
        errors = (each.standard_error / each.value for each in (mse, of_reference))
        apart = Estimate(math.log(mse.value / of_reference.value), math.hypot(*errors))
        ends = [1 - math.exp(end) for end in reversed(apart.interval())]
    phrase, left_open = effect(1 - mse.value / of_reference.value, ends, _THE_WORST)
    return f"{phrase}, from {of_reference.text} to {mse.text}. {left_open}".rstrip()


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """The parameters of a scenario: ``k = 1.5, dose = 2``."""
    return ", ".join(
        f"{name} = {value:.4g}" if isinstance(value, float) else f"{name} varies"
        for name, value in parameters.items()
    )
