"""How sets compare: their ranks and pairs, in each scenario, and with times chosen online."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pfdist.common.estimate import Estimate
from pfdist.common.parts import (
    Block,
    Cell,
    Figures,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.percent import percent
from pfdist.common.rounding import with_error
from pfdist.questions.subject import ERROR_HEAD, Subject, effect, number_of
from pfdist.results.columns import COLUMNS, Row, interval_cell, rows_of
from pfdist.results.pairs import formatted_ranks
from pfdist.results.stored_run import named_sets

_OF_A_SET = ("name", "measurements", "price", "expected_mse")
_PAIRS_HEAD = (
    "first", "second", "first less second", "clear", "in % of second",
    "draws where first is lower, %",
)  # fmt: skip
_PAIRS_MEANING = (
    "All sets filter the same draws, so differences are far more exact than the errors. A negative "
    "difference says that the first set of a pair has the lower error. Intervals in brackets hold "
    "with 95 % for one pair alone. A difference is clear if its sign holds with 95 % for all pairs "
    "together. The best rank of a set counts the sets that are clearly better, the worst rank all "
    "that are not clearly worse. A number without an interval is exact."
)
_MOST_OPEN = 28
"""Pairs of 8 sets; a table of more pairs is folded away."""


def compared(subject: Subject) -> Section | None:
    """The ranks and the pairs of a run whose job names sets."""
    run = subject.run
    if not (subject.is_compared and named_sets(run)):
        return None
    ranks, pairs = (rows_of(run.table(name)) for name in ("ranks", "pairs"))
    draws = number_of(run.draws_compared, "draw")
    head = ("rank", *(COLUMNS[name].head for name in _OF_A_SET), "above the best by")
    sets = Table(f"Ranks on {draws}", head, [_set_row(subject, row) for row in ranks])
    rows = [_pair_row(pair) for pair in pairs]
    blocks: list[Block] = [
        without_empty_columns(sets),
        Text(_PAIRS_MEANING, detail=True),
        Figures(["compared"] if subject.found_rows else ["times", "compared"]),
        Table(
            "Pairs of sets", _PAIRS_HEAD, rows, len(rows) > _MOST_OPEN, optional=_PAIRS_HEAD[:-4:-1]
        ),
    ]
    return Section("How the sets compare", blocks)


def _set_row(subject: Subject, row: Row) -> list[Cell]:
    return [
        Cell(formatted_ranks(row.best_rank, row.worst_rank), row.best_rank),
        *(COLUMNS[name].cell(subject.rows[row.name]) for name in _OF_A_SET),
        _difference(row) if row.difference else Cell(""),
    ]


def _pair_row(pair: Row) -> list[Cell]:
    gains = (pair.gain_of_means, pair.gain_of_means_high, pair.gain_of_means_low)
    relative = (None if gain is None else -gain for gain in gains)
    wins = (pair.first_wins, pair.first_wins_low, pair.first_wins_high)
    return [
        Cell(pair.first),
        Cell(pair.second),
        _difference(pair),
        Cell("yes" if pair.clear else "no"),
        interval_cell(*relative, is_percent=True),
        interval_cell(*wins, is_percent=True),
    ]


def _difference(row: Row) -> Cell:
    return interval_cell(row.difference, row.low, row.high)


# --- scenarios ------------------------------------------------------------------------------------

_THE_WORST = "the expected error of the worst scenario"

_SCENARIOS_MEANING = (
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
    return Section("In each scenario", [*texts, table, Text(_SCENARIOS_MEANING, detail=True)])


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


# --- times chosen one after another ---------------------------------------------------------------

_SHOWN = ("name", "expected_mse", "gain_of_means", "positive_fraction")
_NOTHING = dict.fromkeys(_SHOWN)
_FIGURES = ("online_gain", "online_times", "online_draw")


def online(subject: Subject) -> Section | None:
    """Compare online times with the plan and with the reference."""
    result = subject.online
    if result is None:
        return None
    plan = result["plan"]
    sets = [{"name": "online", **result}, plan, result["reference"]]
    rows = [Row(**_NOTHING | each) for each in sets]
    table = Table(
        f"Expected error on {number_of(result['draws'], 'draw')}",
        ("times", ERROR_HEAD, "online is lower by, %", "draws where online is lower, %"),
        [[COLUMNS[name].cell(row) for name in _SHOWN] for row in rows],
    )
    meaning = (
        "Each time is chosen when the measurement before it is known: the rest of the plan is made "
        f"anew from what the filter then believes. In {percent(result['differs_from_plan'], 0)} of "
        f"the draws the times differ from those of {plan['name']}."
    )
    return Section("Times chosen one after another", [Text(meaning), table, Figures(_FIGURES)])


def online_sentence(subject: Subject) -> str:
    """The gain of choosing each time when the last measurement is known; empty if unknown."""
    if subject.online is None:
        return ""
    plan = subject.online["plan"]
    if not math.isfinite(gain := plan["gain_of_means"]):
        return ""
    ends = [plan["gain_of_means_low"], plan["gain_of_means_high"]]
    lowers, left_open = effect(gain, ends)
    return (
        f"Choosing each time only when the last measurement is known {lowers}, compared with the "
        f"times of {plan['name']}. {left_open}"
    ).rstrip()
