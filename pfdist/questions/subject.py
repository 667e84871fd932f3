"""The run that a report is about, and phrases that several sections use."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any

from pfdist.common.formatted_times import formatted_time, formatted_times, time_and_sensor
from pfdist.common.parts import Cell, Table, Text
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded, with_error, with_interval
from pfdist.errors import one_line
from pfdist.problem.set_key import label_of
from pfdist.results import Run, reaching, read_recorded
from pfdist.results.budget_curve import FOUND
from pfdist.results.columns import COLUMNS, Row, rows_of, sets_table
from pfdist.results.online import is_online, online_draws
from pfdist.results.sets import best_first
from pfdist.results.stored_run import problem_of

if TYPE_CHECKING:
    import pandas as pd

ERROR_HEAD = COLUMNS["expected_mse"].head
MOST_SETS = 4
"""Sets that have figures in a report; each has about 60 kB of them."""


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
        is_known = "sets" in self.run.tables
        return {row.name: row for row in rows_of(self.sets)} if is_known else {}

    @property
    def model_name(self) -> str:
        """The name that the model gives itself; in an older run, the name that the job gives."""
        own_name = read_recorded(self.run.path)[0]["provenance"].get("name_of_model")
        return one_line(own_name or without_folder(self.run.job["model"]["name"]))

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

    @property
    def others(self) -> dict[str, Row]:
        """The rows of all sets but the first reference."""
        return dict([*self.rows.items()][1:])

    @cached_property
    def by_error(self) -> list[str]:
        """Names of the found sets, or of all sets of a run without a search, the best first."""
        return best_first(self.sets) if self.rows else []

    @property
    def shown(self) -> list[str]:
        """Names of the sets that have figures in a report: some of the best."""
        return [name for name in self.by_error if name in self.others][:MOST_SETS]

    @cached_property
    def scenarios(self) -> list[Row]:
        """The rows of the table ``scenarios``, if the job has scenarios."""
        is_known = "scenarios" in self.run.tables
        return rows_of(self.run.table("scenarios")) if is_known else []

    @cached_property
    def online(self) -> dict[str, Any] | None:
        """Results of times that were chosen one after another; None if there are none."""
        return online_draws(self.run).summary() if is_online(self.run) else None

    @property
    def worst_decides(self) -> bool:
        """Whether the job asks for the least expected MSE in the worst scenario."""
        return bool(self.run.job.get("scenarios", {}).get("criterion") == "worst")

    @property
    def about_others(self) -> list[Text]:
        """Say where the figures of the other sets are."""
        others = len(self.others) - len(self.shown)
        shown = number_of(len(self.shown), "found set" if self.found_rows else "set")
        text = (
            f"Figures are shown of {shown} with the least expected error. Those of the other "
            f"{number_of(others, 'set')} are in the folder figures of the run."
        )
        return [Text(text)] if others else []

    def reaching(self, target: float) -> dict[str, dict[str, Any]]:
        """How many measurements reach an expected MSE; see `pfdist.results.reaching`."""
        return reaching(self.sets, target)

    @property
    def reference_times(self) -> Sequence[float | str]:
        """Measurement times of the reference."""
        times: Sequence[float | str] = self.reference_row.measurement_times
        return times

    @property
    def reference(self) -> str:
        """The reference as sentences call it: ``every 3 instants``, or its name."""
        name, times = self.reference_row.name, self.reference_times
        sensors = {time_and_sensor(time)[1] for time in times}
        instants = (time_and_sensor(time)[0] for time in times)
        steps = {formatted_time(later - earlier) for earlier, later in pairwise(instants)}
        if len(steps) != 1 or len(sensors) > 1:
            return label_of(name)
        step, sensor = steps.pop(), " by ".join(("", *filter(None, sensors)))
        if problem_of(self.run).has_clock:
            return f"every {step} {self.unit}".rstrip() + sensor
        return ("every instant" if step == "1" else f"every {step} instants") + sensor

    @property
    def unit(self) -> str:
        """The unit of the clock; empty if the job has none."""
        return problem_of(self.run).clock.unit

    def listed(self, times: Sequence[float | str]) -> str:
        """Measurement times as text, with the unit of the clock."""
        return formatted_times(times, self.unit)


def effect(
    gain: float, interval: Sequence[float | None], what: str = "the expected error"
) -> tuple[str, str]:
    """Say what a gain does to the expected error, and what its interval leaves open.

    Parameters
    ----------
    gain : float
        Relative; negative if the error rises.
    interval : list of float or None
        Lower and upper end, 95 %; None and infinite ends are unknown.
    what : str

    Returns
    -------
    (str, str)
        A phrase, and a sentence or an empty text.

    Examples
    --------
    >>> effect(0.05, [0.01, 0.09])
    ('lowers the expected error by 5.0 % (95 %: 1.0 to 9.0 %)', '')
    >>> effect(-0.05, [-0.09, 0.01])[0]
    'raises the expected error by 5.0 % (95 %: -1.0 to 9.0 %)'
    """
    low, high = interval
    changes = "lowers" if gain >= 0 else "raises"
    if low is None or high is None or math.isinf(high - low):
        value, *_ = with_interval(100 * abs(gain), None, None)
        phrase = f"{changes} {what} by {value} %"
        return phrase, "There are too few draws to say how exact this figure is."
    ends = [low, high] if gain >= 0 else [-high, -low]
    value, least, most = with_interval(*(100 * part for part in (abs(gain), *ends)))
    phrase = f"{changes} {what} by {value} % (95 %: {least} to {most} %)"
    open_ = "The interval contains 0, so these draws do not tell which times are better."
    return phrase, open_ if low <= 0.0 <= high else ""


def exact_effect(mse: float, reference: float, what: str = "the expected error") -> str:
    """Say what times do to the expected error, where both expected errors are known exactly.

    Parameters
    ----------
    mse, reference : float
        Expected MSE of the times, and that of the reference.
    what : str

    Examples
    --------
    >>> exact_effect(2.2889, 2.4657)
    'lowers the expected error by 7.17 %, from 2.4657 to 2.2889: the filter knows both exactly'
    """
    changes = "lowers" if mse <= reference else "raises"
    change = percent(abs(1 - mse / reference))
    ends = f"from {rounded(reference)} to {rounded(mse)}"
    return f"{changes} {what} by {change}, {ends}: the filter knows both exactly"


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
    columns = ("name", "measurements", "price", "measurement_times")
    rows = subject.rows.values()
    return sets_table("All sets of times", rows, columns, unit=subject.unit, detail=True)
