"""How many measurements are enough: the expected error of each number, and its lower bound."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from decimal import ROUND_FLOOR, Decimal
from typing import TYPE_CHECKING, Any

from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.parts import Block, Cell, Figures, Section, Table, Text
from pfdist.common.percent import particle_loss_text
from pfdist.common.rounding import with_interval
from pfdist.problem.sections import EVENLY_SPACED
from pfdist.problem.set_key import PLAN
from pfdist.questions.subject import Subject, all_sets, number_of, ranges_of_times
from pfdist.results.budget_curve import FOUND
from pfdist.results.columns import COLUMNS, Row

if TYPE_CHECKING:
    import pandas as pd

KINDS = {EVEN: EVENLY_SPACED, REGULAR: REGULAR, FOUND: PLAN}
"""Labels of the sets of a budget, by their kind."""
_ERROR = COLUMNS["expected_mse"]
_BOUND = (
    "No times of the same number or price have a lower expected MSE than the lower bound, with any "
    "filter of the same model. A number is undecided if its plan does not reach the error, but "
    "other times might. Evenly spaced measurements are as good if their error on the same draws "
    "lies at most 2 % above that of the plan (95 %); the largest number is the largest that was "
    "tried."
)


def budget_section(subject: Subject) -> Section | None:
    """The budget curve of a run for several numbers of measurements."""
    if not subject.is_compared:
        return None
    rows = [*subject.rows.values()]
    other = KINDS[subject.reference_row.kind]
    head = (
        "price" if _is_money(subject) else "N",
        other,
        KINDS[FOUND],
        f"as good, {other}",
        "lower bound (95 % limit)",
    )
    blocks: list[Block] = [
        *_answer(subject),
        *_target(subject),
        Figures(["budget"]),
        Table("Expected MSE ± standard error", head, _cells(rows)),
        *subject.notes,
        *([Text(_BOUND, detail=True)] if "bound" in subject.run.tables else []),
        *_worse(rows),
        all_sets(subject),
    ]
    return Section("How many measurements are enough?", blocks)


def _answer(subject: Subject) -> list[Text]:
    """How many chosen measurements do as well as the best number of evenly spaced ones."""
    kind = subject.reference_row.kind
    best, budgets = best_reference(subject.sets), subject.sets.groupby("kind")["budget"]
    most = int(budgets.max()[kind])
    if not math.isfinite(best["expected_mse"]):
        return []
    budget = int(best["budget"])
    reached = subject.reaching(best["expected_mse"], best["standard_error"])["found"]
    if reached["measurements"] is None:
        return []
    number, even = reached["measurements"], f"{budget} {KINDS[kind]} ones"
    if _is_money(subject):
        even = f"{KINDS[kind]} ones for {budget}"
    if budget < most:
        even += f" (more, up to {most}, are no better)"
    if number < budget:
        chosen = _amount(subject, number, "chosen ")
        do = "does" if chosen.startswith("1 ") else "do"
        chosen = f"{chosen[0].upper()}{chosen[1:]}"
        text = f"{chosen} {do} at least as well as {even}{_of_number(subject, number)}."
    else:
        text = (
            f"No plan {'for a lower price' if _is_money(subject) else 'of fewer measurements'} "
            f"that was tried does as well as {even}."
        )
        if more := _with_more_particles(subject, FOUND, reached):
            text += f" {more[0].upper()}{more[1:]}."
    if reached["impossible"] is not None:
        too_few = _amount(subject, reached["impossible"])
        text += f" Proved: {too_few} cannot, at any times (95 % confidence)."
    if undecided := _undecided(subject, reached):
        text += f" {undecided}."
    if untried := _untried(subject, number):
        text += f" {untried}."
    return [Text(text, prominent=True)]


def best_reference(table: "pd.DataFrame") -> "pd.Series[Any]":
    """The reference of least expected MSE: more measurements are not always better."""
    rows = table[table["kind"] != FOUND].sort_values("budget", kind="stable")
    return rows.sort_values("expected_mse", kind="stable").iloc[0]


def _target(subject: Subject) -> Iterator[Text]:
    """How many measurements reach the expected MSE that the user asks for."""
    if subject.target is None:
        return
    reaching = subject.reaching(subject.target)
    for kind in (FOUND, subject.reference_row.kind):
        reached = reaching[kind]
        number, impossible = reached["measurements"], reached.get("impossible")
        where = _of_number(subject, number) if number and kind == FOUND else ""
        texts = [_reached(subject, kind, reached, where)]
        texts.append(_with_more_particles(subject, kind, reached))
        if impossible is not None:
            few = "is provably too little" if _is_money(subject) else "are provably too few"
            texts.append(f"{impossible} {few if impossible > 1 else few.replace('are', 'is')}")
            texts.append(_undecided(subject, reached))
        texts.append(_untried(subject, number) if number else "")
        yield Text(f"{'; '.join(filter(None, texts))}.", prominent=True)


def _is_money(subject: Subject) -> bool:
    return subject.reference_row.price is not None


def _amount(subject: Subject, number: int, kind: str = "") -> str:
    """So many measurements, or measurements for so much money."""
    if _is_money(subject):
        return f"{kind}measurements for {number:,}"
    return number_of(number, f"{kind}measurement")


def _of_number(subject: Subject, number: int) -> str:
    """The times and the typical error of the plan of so many measurements, or such a price."""
    row = _row(subject, FOUND, number)
    typical = subject.typical_errors(row)
    error = f" (typical error {typical})" if typical else ""
    return f": t = {subject.clock.listed(row.measurement_times)}{error}"


def _reached(subject: Subject, kind: str, reached: Mapping[str, Any], where: str) -> str:
    number, tried, target = reached["measurements"], "", subject.target
    if kind != FOUND:
        tried = f"{KINDS[kind]} "
    low, high = ("more" if bound is None else str(bound) for bound in reached["interval"])
    if number is None:
        numbers = "prices" if _is_money(subject) else "numbers"
        text = f"None of these {numbers} of {tried}measurements reaches an MSE of {target:g}"
    else:
        needed = _amount(subject, number, tried)
        interval = "" if low == high else f" (95 % CI {low} to {high})"
        text = f"To reach an MSE of {target:g} you need {needed}{interval}{where}"
    if others := reached["larger_that_do_not"]:
        text += f", but {', '.join(map(str, others))} do not reach it"
    return text


def _with_more_particles(subject: Subject, kind: str, reached: Mapping[str, Any]) -> str:
    """Say which number may reach an error with more particles, and what these particles lose."""
    if (number := reached["with_more_particles"]) is None:
        return ""
    row, particles = _row(subject, kind, number), subject.run.job["filter"]["particles"]
    loss = particle_loss_text(row.particle_loss, row.particle_loss_limit)
    return f"with more particles {number} may be enough: these {particles:,} lose {loss}"


def _row(subject: Subject, kind: str, number: int) -> Row:
    rows = [row for row in subject.rows.values() if row.kind == kind]
    return next(row for row in rows if row.budget == number)


def _undecided(subject: Subject, reached: Mapping[str, Any]) -> str:
    """Say which numbers lie between those that are provably too few and those that are enough."""
    few, enough = reached["impossible"], reached["measurements"] or math.inf
    tried = sorted({row.budget for row in subject.rows.values()})
    between = [] if few is None else [number for number in tried if few < number < enough]
    are = "is" if len(between) == 1 else "are"
    return f"{ranges_of_times(between)} {are} undecided" if between else ""


def _untried(subject: Subject, number: int) -> str:
    """The numbers that were left out between this one and the next smaller one, in a sentence."""
    if _is_money(subject):
        return ""
    tried = {row.budget for row in subject.rows.values()}
    below = max((each for each in tried if each < number), default=number - 1)
    if below == number - 1:
        return ""
    first, last = below + 1, number - 1
    return f"{first} was not tried" if first == last else f"{first} to {last} were not tried"


def _cells(rows: Sequence[Row]) -> list[list[Cell]]:
    numbers = defaultdict[int, dict[bool, Any]](dict)
    for row in rows:
        numbers[row.budget][row.kind == FOUND] = row
    return [
        [
            Cell(str(number), number),
            *(_ERROR.cell(sets[each]) if each in sets else Cell("") for each in (False, True)),
            _as_good(sets[True], max(numbers)) if True in sets else Cell(""),
            _bound(sets[True]) if True in sets else Cell(""),
        ]
        for number, sets in sorted(numbers.items())
    ]


def _as_good(row: Row, most: int) -> Cell:
    """The least number of evenly spaced measurements that do as well, of at most so many."""
    number = row.evenly_spaced
    return Cell(f"more than {most}", math.inf) if number is None else Cell(str(number), number)


def _bound(row: Row) -> Cell:
    """The bound and its lower limit, which is rounded down: it must hold as it is printed."""
    bound, limit = row.bound, row.bound_low
    if bound is None or limit is None or not row.bound_error:  # unknown or exact
        return COLUMNS["bound"].cell(row)
    text, low, _ = with_interval(bound, limit, 2 * bound - limit)
    floor = Decimal(limit).quantize(Decimal(low), ROUND_FLOOR)
    return Cell(f"{text} ({floor})".lower(), bound)  # Decimal writes E for e


def _worse(rows: Sequence[Row]) -> Iterator[Text]:
    """Name the numbers of measurements that are worse than a smaller number."""
    for kind in dict.fromkeys(row.kind for row in rows):
        worse = [
            f"{row.budget} than {row.worse_than}"
            for row in rows
            if row.kind == kind and row.worse_than is not None
        ]
        if worse:
            more = "More measurements are" if rows[0].price is None else "A higher price is"
            yield Text(
                f"{more} worse, {KINDS[kind]} (95 % for all pairs together): {', '.join(worse)}."
            )
