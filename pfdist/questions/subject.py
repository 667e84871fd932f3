"""The run that a report is about, and phrases that several sections use."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any

from pfdist.common.component_names import Component, named_components
from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.parts import Cell, Table, Text
from pfdist.common.percent import CHECK_FAILS, RANKS_FAIL, heavy_tail_warning
from pfdist.common.rounding import rounded, with_error
from pfdist.filters.aspects import DISTANCE, ErrorBeside
from pfdist.filters.criterion import Criterion
from pfdist.filters.estimate import DOUBTFUL, degenerate_text
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.clock import Clock
from pfdist.problem.sections import EVENLY_SPACED
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run, reaching
from pfdist.results.budget_curve import FOUND
from pfdist.results.columns import COLUMNS, Row, rows_of, sets_table
from pfdist.results.criteria import other_criteria
from pfdist.results.particle_loss import particle_losses_of
from pfdist.results.sets import best_first, rows_of_sets
from pfdist.results.stored_run import (
    angles_of,
    criterion_of,
    problem_of,
    provenance_of,
    unproved,
)

if TYPE_CHECKING:
    import pandas as pd

_LISTED = 5  # times that a sentence lists one and all

ERROR_HEAD = COLUMNS["expected_mse"].head
_MOST_SETS = 4  # beside the reference, in a table of scenarios


@dataclass(frozen=True)
class Subject:
    """A run, and its table of sets.

    Parameters
    ----------
    run : Run
    target : float, optional
        An expected MSE: how many measurements reach it.
    """

    run: Run
    target: float | None = None

    @cached_property
    def sets(self) -> "pd.DataFrame":
        """The table ``sets`` of the run, once the searches have ended."""
        return self.run.table("sets")

    @cached_property
    def rows(self) -> dict[str, Row]:
        """The rows of the table of sets by name, the reference first."""
        return {row.name: row for row in rows_of_sets(self.run)}

    @cached_property
    def distinct(self) -> dict[str, Row]:
        """The rows of sets with different times, by name; sets with the same times are one row."""
        first, rows = dict[tuple[Any, ...], str](), dict[str, Row]()
        for name, row in self.rows.items():
            known = first.setdefault((*row.measurement_times, row.budget), name)
            label = row.label if known == name else f"{rows[known].label} = {row.label}"
            rows[known] = Row(**vars(rows.get(known, row)) | {"label": label})
        return rows

    @property
    def job_reference(self) -> Any:
        """The reference that the job names, or has because no set is evenly spaced."""
        return self.run.job["comparison"]["reference"]

    @property
    def reference_row(self) -> Row:
        """The row of the reference."""
        return next(iter(self.rows.values()))

    @cached_property
    def is_compared(self) -> bool:
        """Whether the comparison has begun."""
        return "comparison" in self.run.tables

    @property
    def found_rows(self) -> dict[str, Row]:
        """The rows of the sets that the searches have found."""
        return {name: row for name, row in self.rows.items() if row.kind == FOUND}

    @cached_property
    def notes(self) -> list[Text]:
        """Lines beside errors: the filter's proposal and why, and intervals that are too short."""
        taken = provenance_of(self.run).get("taken", "")
        heavy = heavy_tail_warning(row.largest_share for row in self.rows.values())
        return [Text(text) for text in (f"{taken}." * bool(taken), heavy) if text]

    @cached_property
    def alarms(self) -> list[str]:
        """Sentences that put the answer in doubt, and so come before it."""
        degenerate = [
            f"With {phrase_of(row.label)}, {text}."
            for row in reversed(self.rows.values())  # the plan comes last
            if (text := degenerate_text(row.degenerate_draws, row.draws, DOUBTFUL))
        ]
        why = unproved(self.run)
        is_wrong = any(reason in why for reason in (CHECK_FAILS, RANKS_FAIL))
        return degenerate[:1] + [why] * is_wrong + self.lost

    @cached_property
    def lost(self) -> list[str]:
        """That much of the best set's error is lost by its particles."""
        best = self.by_error[:1] if self.is_compared and not has_amounts(self.run.job) else []
        losses = particle_losses_of(self.run) if best else {}
        said = [losses[name].alarm for name in best if name in losses]
        return [f"With {phrase_of(self.rows[best[0]].label)}, {text}" for text in said if text]

    @property
    def others(self) -> dict[str, Row]:
        """The rows of all sets but the first reference."""
        return dict([*self.rows.items()][1:])

    @cached_property
    def by_error(self) -> list[str]:
        """Names of the found sets, or of all sets of a run without a search, the best first."""
        return best_first([*self.rows.values()]) if self.rows else []

    @property
    def shown(self) -> list[str]:
        """Names of some of the best sets."""
        return [name for name in self.by_error if name in self.others][:_MOST_SETS]

    @cached_property
    def scenarios(self) -> list[Row]:
        """The rows of the table ``scenarios``, if the job has scenarios."""
        is_known = "scenarios" in self.run.tables
        return rows_of(self.run.table("scenarios")) if is_known else []

    @cached_property
    def criterion(self) -> Criterion:
        """The number that the job minimises."""
        return criterion_of(self.run)

    @cached_property
    def heads(self) -> dict[str, str]:
        """Heads of columns: of criteria, which say what quantile it is; of an upper limit."""
        heads = {name: each.head for name, each in other_criteria(self.run).items()}
        return heads | {e.mse: e.head_of(is_limit=self.is_limit(e)) for e in self.beside}

    @cached_property
    def beside(self) -> list[ErrorBeside]:
        """The errors that are shown beside that of the job."""
        return problem_of(self.run).errors_beside

    def is_limit(self, error: ErrorBeside) -> bool:
        """Whether this error beside the job's is an upper limit; see `Evaluator`."""
        tables = self.run.tables
        return error.is_raised and error.table in tables and DISTANCE.table not in tables

    @property
    def error(self) -> str:
        """The number that the job minimises, as a sentence calls it, with the estimate."""
        return f"the {self.criterion.label}{self.of_the_estimate}"

    @property
    def of_the_estimate(self) -> str:
        """Which estimate has the expected MSE; empty for the filter's."""
        return problem_of(self.run).of_the_estimate

    def reaching(self, target: float, error: float = 0.0) -> dict[str, dict[str, Any]]:
        """How many measurements reach an expected MSE; see `pfdist.results.reaching`."""
        return reaching(self.sets, target, error)

    @property
    def reference(self) -> str:
        """The reference as sentences call it: ``regular times (t = 0, 3, 6, ..., 60)``."""
        row = self.reference_row
        if row.name not in (EVEN, REGULAR):
            others = " (the best opponent)" * (EVEN in self.rows)
            return f"{phrase_of(row.label)}{others}"
        written = [self.clock.text(each) for each in row.measurement_times]
        listed = [*written[:3], "...", written[-1]] if len(written) > _LISTED else written
        phrase = phrase_of(row.label)
        if row.label == EVENLY_SPACED:
            tried = self.evenly_spaced_tried
            counted = f"of {number_of(tried, 'evenly spaced set')} that were tried"
            phrase = f"the best {counted if tried else phrase}"
        return f"{phrase} (t = {', '.join(listed)})"

    @property
    def evenly_spaced_tried(self) -> int:
        """The number of evenly spaced sets of which the reference is the best; 0: of all."""
        compared = self.run.table("compared")
        return int(compared["tried"].fillna(0).max()) if "tried" in compared else 0

    @cached_property
    def quantities(self) -> tuple[Component, ...]:
        """The components of z, with their names and units."""
        names = provenance_of(self.run)["names"]["z"]
        count = len(angles_of(self.run))
        return named_components(names, len(names) or count)

    def typical_errors(self, row: Row, other: Row | None = None) -> str:
        """The typical error of a set, beside that of another: ``1.16 instead of 1.34 g/L``.

        If both have the same three digits, they do not differ.

        Empty if it is not known, or infinite: an angle of which nothing is known has no deviation.
        """
        errors = row.typical_error or ()
        if not all(map(math.isfinite, errors)):
            return ""
        others = (other.typical_error if other else None) or [None] * len(errors)
        parts = [
            _typical(component, angle, error, before)
            for component, angle, error, before in zip(
                self.quantities, angles_of(self.run), errors, others, strict=False
            )
        ]
        names = [each.name or f"z{each.suffix}" for each in self.quantities]
        if len(parts) > 1:
            parts = [f"{name} {part}" for name, part in zip(names, parts, strict=False)]
        return ", ".join(parts)

    @property
    def clock(self) -> Clock:
        """The clock of the job."""
        return problem_of(self.run).clock

    @property
    def head_of_times(self) -> str:
        """Head of a column of times."""
        unit = self.clock.unit
        return "date" if self.clock.has_dates else "t" + f", {unit}" * bool(unit)


def _typical(component: Component, is_angle: bool, error: float, before: float | None) -> str:
    unit, text = component.unit_of_error or "rad" * is_angle, rounded(error, 3)
    if before is None or not math.isfinite(before):
        return f"{text} {unit}".rstrip()
    if text == rounded(before, 3):
        return f"{text} {unit}".rstrip() + " (no difference)"
    return f"{text} instead of {rounded(before, 3)} {unit}".rstrip()


def as_good_text(row: Row) -> str:
    """How many evenly spaced measurements do as well as a set, with at most 2 % more error."""
    undecided, worse = row.evenly_spaced_undecided, row.evenly_spaced_worse
    others = [f"{ranges_of_times(undecided)} may"] * bool(undecided)
    others += [f"{ranges_of_times(worse)} do worse"] * bool(worse)
    said = f"{number_of(row.evenly_spaced, 'evenly spaced measurement')} do as well"
    return f"{said} ({', '.join(others)})" if others else said


def ranges_of_times(numbers: Sequence[int]) -> str:
    """Numbers in ascending order as text.

    >>> ranges_of_times([37]), ranges_of_times([36, 37, 38]), ranges_of_times([36, 37, 40])
    ('37', '36 to 38', '36, 37, 40')
    """
    if len(numbers) > 1 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))


def mse_cell(expected_mse: float | None, error: float | None) -> Cell:
    """A cell with an expected MSE and its standard error."""
    return Cell(with_error(expected_mse, error), expected_mse)


def without_folder(model: str) -> str:
    """The name of a model without a folder of the machine: a report may be sent.

    Examples
    --------
    >>> without_folder("/home/user/walk.py:model"), without_folder("models/walk.py:model")
    ('walk.py:model', 'models/walk.py:model')
    """
    file, colon, name = model.rpartition(":")
    is_absolute = PurePosixPath(file).is_absolute() or PureWindowsPath(file).is_absolute()
    return PureWindowsPath(file).name + colon + name if is_absolute else model


def number_of(count: int, what: str) -> str:
    """A number with a noun in the singular or plural.

    Examples
    --------
    >>> number_of(1, "time"), number_of(12000, "draw")
    ('1 time', '12,000 draws')
    """
    return f"{count:,} {what}{'s' * (count != 1)}"


def all_sets(subject: Subject) -> Table:
    """A table of all sets of times, folded away."""
    columns = ("label", "measurements", "price", "measurement_times")
    rows = subject.distinct.values()
    return sets_table("All sets of times", rows, columns, listed=subject.clock.listed, detail=True)
