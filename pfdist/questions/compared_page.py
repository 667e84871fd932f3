"""How sets compare: their order, their pairs, and in each scenario."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pfdist.common.changes import change_of, effect
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import EVEN
from pfdist.common.parts import (
    Block,
    Cell,
    Figures,
    Section,
    Table,
    Text,
    without_column,
    without_empty_columns,
)
from pfdist.common.percent import percent
from pfdist.common.rounding import with_error
from pfdist.filters.criterion import CriterionValue
from pfdist.problem.set_key import phrase_of
from pfdist.questions.subject import Subject, number_of
from pfdist.results.columns import (
    COLUMNS,
    CRITERIA_SHOWN,
    ERRORS_SHOWN,
    Row,
    interval_cell,
    rows_of,
)
from pfdist.results.stored_run import named_sets

_OF_A_SET = "label", "measurements", "price", *ERRORS_SHOWN, *CRITERIA_SHOWN
_GIVEN_SHOWN = 3  # sets of a user that the answer of a plan names
_BELOW = "the best is lower by, %"  # in expected MSE
_PAIRS_HEAD = ("first", "second", "first minus second", "clear", "in % of second")
_SETS_MEANING = (
    "All sets filter the same draws, so differences are far more exact than the errors. Intervals "
    "in brackets are 95 % CIs for one set alone."
)
_PAIRS_MEANING = (
    "If a difference is negative, the first set of the pair has the lower error. A difference is "
    "clear if its sign is certain, with 95 % confidence for all pairs together."
)


def compared(subject: Subject) -> Section | None:
    """The sets of a run whose job names sets, the best first, and their pairs."""
    run = subject.run
    if not (subject.is_compared and named_sets(run)):
        return None
    ranks, pairs = (rows_of(run.table(name)) for name in ("ranks", "pairs"))
    ranks = [row for row in ranks if row.name in subject.distinct]
    pairs = [pair for pair in pairs if {pair.first, pair.second} <= {*subject.distinct}]
    if not subject.criterion.is_mean:
        values = {name: row.criterion_value for name, row in subject.rows.items()}
        ranks.sort(key=lambda row: math.inf if (v := values[row.name]) is None else float(v))
    best_is_reference = ranks[0].name == subject.reference_row.name
    last = f"lower than {subject.reference_row.label} by, %"
    heads = (subject.heads.get(name, COLUMNS[name].head) for name in _OF_A_SET)
    head = [*heads, _BELOW, last]
    cells = [_set_row(subject, row, pairs, ranks[0].name) for row in ranks]
    caption = f"Best first, on {number_of(run.draws_compared, 'draw')}"
    is_mean = subject.criterion.is_mean
    if subject.of_the_estimate or not is_mean:
        caption += f", by {subject.error}"
    sets = Table(caption, head, cells, optional=[last])
    sets = without_column(sets, *[last] * best_is_reference, *[_BELOW] * (not is_mean))
    rows = [_pair_row(subject, pair) for pair in pairs]
    best = ""
    if not subject.found_rows and len(ranks) == 1:
        best = f"All sets have the same times: {next(iter(subject.distinct.values())).label}."
    elif not subject.found_rows:
        best = _best(subject, ranks, pairs) if is_mean else _least(subject, ranks)
    blocks: list[Block] = [
        *([Text(best, prominent=True)] if best else []),
        without_empty_columns(sets),
        *([] if subject.found_rows else subject.notes),  # else the answer has it
        Text(_SETS_MEANING, detail=True),
        Figures(["compared"] if subject.found_rows else ["system", "compared"]),
        Table("Pairs of sets", _PAIRS_HEAD, rows, detail=True, optional=_PAIRS_HEAD[:-3:-1]),
        Text(_PAIRS_MEANING, detail=True),
    ]
    return Section("How the sets compare", blocks)


def _least(subject: Subject, ranks: Sequence[Row]) -> str:
    """The best set by a criterion other than the expected MSE, in sentences.

    It is compared with the reference; if it is the reference, the second is.
    """
    best, second, *_ = (subject.rows[each.name] for each in ranks)
    said = f"Best on these draws by {subject.error}: {phrase_of(best.label)}."
    if best.name == subject.reference_row.name:
        best, said = second, f"{said} Second: {phrase_of(second.label)}."
    return f"{said} {criterion_effect(subject, best) or ''}".rstrip()


def _best(subject: Subject, ranks: Sequence[Row], pairs: Sequence[Row]) -> str:
    """The best set and its lead, or the sets that may be the best, in sentences."""
    best, second, *_ = ranks
    phrases = {name: phrase_of(row.label) for name, row in subject.rows.items()}
    gain, *ends = _lower(pairs, best.name, second.name)
    if gain is None:
        return ""
    together = ", all pairs together" * (len(pairs) > 1)
    joint = "exact" if gain == ends[0] == ends[1] else f"95 % confidence{together}"
    among = [phrases[row.name] for row in ranks if row.best_rank == 1]
    own = subject.rows[best.name]
    said = f"Best of {len(ranks)} sets ({joint}): {among[0]}"
    if len(among) > 1:
        listed = f"{', '.join(among[:-1])} and {among[-1]}"
        said = f"The best of {len(ranks)} sets do not differ clearly ({joint}): {listed}"
    else:
        said += f", t = {subject.clock.listed(own.measurement_times)}"
    typical = subject.typical_errors(own, subject.rows[second.name])
    typical = f" The typical error is {typical}." if typical else ""
    lower = f"The expected MSE is {change_of(gain, ends)} than with {phrases[second.name]}, "
    return f"{said}. {lower}the second.{typical}"


def _lower(pairs: Iterable[Row], name: str, other: str) -> tuple[Any, Any, Any]:
    """The share of another set's error by which a set's is lower, and this pair's 95 % interval."""
    for pair in pairs:
        gains = pair.gain_of_means, pair.gain_of_means_low, pair.gain_of_means_high
        if (pair.first, pair.second) == (name, other):
            return gains
        if (pair.second, pair.first) == (name, other):
            gain, high, low = (None if each in (None, 1.0) else each / (each - 1) for each in gains)
            return gain, low, high
    return 0.0, 0.0, 0.0


def beside_given_sets(subject: Subject, plan: Row) -> Iterator[str]:
    """How far the error of a plan, and of evenly spaced times, lies below that of given sets."""
    written = subject.run.job["comparison"].get("sets") or {}
    given = [name for name in named_sets(subject.run) if list(written[name]) != [name]]
    if not (given and subject.criterion.is_mean):
        return
    pairs = rows_of(subject.run.table("pairs"))
    even = subject.rows.get(EVEN, plan)
    others = [plan, *[even] * (even.measurement_times != plan.measurement_times)]
    for name in given[:_GIVEN_SHOWN]:
        own = subject.rows[name]
        changes = [
            f"{change_of(gain, ends)} with {phrase_of(each.label)}"
            for each in others
            if each.measurement_times != own.measurement_times
            for gain, *ends in [_lower(pairs, each.name, name)]
            if gain is not None
        ]
        if changes:
            number, phrase = number_of(own.measurements, "measurement"), phrase_of(own.label)
            changed = ", and ".join(changes)
            yield f"Instead of {phrase} ({number}), the expected MSE is {changed}."


def _set_row(subject: Subject, row: Row, pairs: Sequence[Row], best: str) -> list[Cell]:
    of_set = subject.distinct[row.name]
    gains = _lower(pairs, best, row.name)
    return [
        *(COLUMNS[name].cell(of_set) for name in _OF_A_SET),
        interval_cell(*gains, is_percent=True) if row.difference else Cell(""),
        COLUMNS["gain_of_means"].cell(of_set),
    ]


def _pair_row(subject: Subject, pair: Row) -> list[Cell]:
    gains = (pair.gain_of_means, pair.gain_of_means_high, pair.gain_of_means_low)
    relative = (None if gain is None else -gain for gain in gains)
    return [
        *(Cell(subject.rows[name].label) for name in (pair.first, pair.second)),
        interval_cell(pair.difference, pair.low, pair.high),
        Cell("yes" if pair.clear else "no"),
        interval_cell(*relative, is_percent=True),
    ]


# --- scenarios ------------------------------------------------------------------------------------

_SCENARIOS_MEANING = (
    "The true model of each draw has the parameters of one scenario, with the probability of its "
    "share. The last column is how much lower the error of the last set is than that of the "
    "first. Intervals in brackets are 95 % CIs for one scenario alone. The worst scenario is "
    "chosen on these same draws, so the largest error is slightly too large."
)


def scenarios(subject: Subject) -> Section | None:
    """The expected error of the best sets and of the reference in each scenario."""
    if not subject.scenarios:
        return None
    shown = [subject.reference_row.name, *reversed(subject.shown)]
    labels = [subject.rows[name].label for name in shown]
    head = ("scenario", "share, %", *labels, COLUMNS["gain_of_means"].head)
    rows = defaultdict[int, dict[str, Any]](dict)
    for row in subject.scenarios:
        rows[row.scenario][row.name] = row
    cells = [_cells(of_set, shown) for _, of_set in sorted(rows.items())]
    texts = [Text(sentence, prominent=True) for sentence in _sentences(subject, shown[-1])]
    table = Table(
        "Expected MSE ± standard error in each scenario", head, cells, optional=labels[1:-1]
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
    """A sentence about the worst scenarios of the best set and of the reference."""
    names = best, subject.reference_row.name
    worst, reference = (_worst_scenario(subject, name) for name in names)
    if worst is None or reference is None or best == reference.name:
        return
    errors = [with_error(each.expected_mse, each.standard_error) for each in (worst, reference)]
    first, second = (parameters_text(each.parameters) for each in (worst, reference))
    where = "there" if first == second else f"in the worst scenario of these, {second}"
    own, other = (phrase_of(subject.rows[name].label) for name in names)
    yield (
        f"The worst scenario of {own} is {first}: the expected MSE is {errors[0]}; with {other} "
        f"it is {errors[1]} {where}."
    )


def criterion_effect(subject: Subject, row: Row) -> str | None:
    """The effect of a set on the job's criterion; None if that is the expected MSE, or unknown."""
    if subject.criterion.is_mean:
        return None
    if row.criterion_gain is None:
        return _worst_effect(subject, row.name)
    reference, name = subject.reference_row, subject.criterion.name
    gain, *ends = row.criterion_gain, row.criterion_gain_low, row.criterion_gain_high
    own, other = (COLUMNS[name].cell(each).text for each in (row, reference))
    value = CriterionValue(*(float(vars(row)[f"{name}{end}"]) for end in ("", "_low", "_high")))
    own_words = subject.criterion.sentence(value, CriterionValue(gain, *ends), subject.reference)
    said = effect(gain, ends, subject.reference, subject.error)
    return own_words or f"{said}: {own} instead of {other}."


def _worst_effect(subject: Subject, name: str) -> str | None:
    """The effect of a set on the error of the worst scenario, if the job asks for the least.

    The worst scenarios of two sets may differ. Then their draws differ, too, so the logarithms of
    the two errors are independent.
    """
    if not subject.scenarios:
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
        ratio = Estimate(math.log(mse.value / of_reference.value), math.hypot(*errors))
        ends = [1 - math.exp(end) for end in reversed(ratio.interval())]
    gain, what = 1 - mse.value / of_reference.value, subject.error
    said = effect(gain, ends, subject.reference, what)
    return f"{said}: {mse.text} instead of {of_reference.text}."


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """The parameters of a scenario: ``k = 1.5, dose = 2``."""
    return ", ".join(
        f"{name} = {value:.4g}" if isinstance(value, float) else f"{name} varies"
        for name, value in parameters.items()
    )
