"""The run that a report is about, and phrases that several sections use."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

from pfdist.common.formatted_times import formatted_time, formatted_times, time_and_sensor
from pfdist.common.parts import Cell, Table, Text, without_empty_columns
from pfdist.common.percent import cost, percent, range_of, times_100
from pfdist.common.rounding import rounded, with_error, with_interval
from pfdist.errors import one_line
from pfdist.results import Run, reaching, read_recorded
from pfdist.results.reference import label
from pfdist.results.stored_run import problem_of
from pfdist.results.summary import SetResult, Summary

ERROR_HEAD = "expected error ± standard error"
MOST_SETS = 4
"""Sets that have figures in a report; each has about 60 kB of them."""


@dataclass(frozen=True)
class Subject:
    """A run, its summary and its tables.

    Parameters
    ----------
    run : Run
    target : float, optional
        An expected MSE: how many measurements reach it.
    """

    run: Run
    target: float | None = None

    @cached_property
    def summary(self) -> Summary:
        """As of `pfdist.results.Run.summary`."""
        return self.run.summary()

    @property
    def results(self) -> dict[str, SetResult]:
        """Results of each set by name, the reference first."""
        return self.summary.results

    @property
    def model_name(self) -> str:
        """The name that the model gives itself; in an older run, the name that the job gives."""
        own_name = read_recorded(self.run.path)[0]["provenance"].get("name_of_model")
        return one_line(own_name or without_folder(self.run.job["model"]["name"]))

    @property
    def is_compared(self) -> bool:
        """Whether the comparison has begun."""
        return any(result.is_compared for result in self.results.values())

    @property
    def found_results(self) -> dict[str, SetResult]:
        """Results of the sets that the searches have found."""
        return {name: result for name, result in self.results.items() if result.is_found}

    @property
    def others(self) -> dict[str, SetResult]:
        """Results of all sets but the reference."""
        return dict([*self.results.items()][1:])

    @property
    def shown(self) -> list[str]:
        """Names of the sets that have figures in a report: some of the best."""
        return [name for name in self.summary.by_error if name in self.others][:MOST_SETS]

    @property
    def about_others(self) -> list[Text]:
        """Say where the figures of the other sets are."""
        others = len(self.others) - len(self.shown)
        shown = number_of(len(self.shown), "found set" if self.found_results else "set")
        text = (
            f"Figures are shown of {shown} with the least expected error. Those of the other "
            f"{number_of(others, 'set')} are in the folder figures of the run."
        )
        return [Text(text)] if others else []

    def reaching(self, target: float) -> dict[str, dict[str, Any]]:
        """How many measurements reach an expected MSE; see `pfdist.results.reaching`."""
        return reaching(self.run.table("budget"), target)

    @property
    def reference_times(self) -> Sequence[float | str]:
        """Measurement times of the reference."""
        return next(iter(self.results.values())).measurement_times

    @property
    def reference(self) -> str:
        """The reference as sentences call it: ``every 3 instants``, or its name."""
        name, times = next(iter(self.results)), self.reference_times
        sensors = {time_and_sensor(time)[1] for time in times}
        instants = (time_and_sensor(time)[0] for time in times)
        steps = {formatted_time(later - earlier) for earlier, later in pairwise(instants)}
        if len(steps) != 1 or len(sensors) > 1:
            return label(name)
        step, sensor = steps.pop(), " by ".join(("", *filter(None, sensors)))
        if problem_of(self.run).has_clock:
            return f"every {step} {self.unit}".rstrip() + sensor
        return ("every instant" if step == "1" else f"every {step} instants") + sensor

    @property
    def unit(self) -> str:
        """The unit of the clock; empty if the job has none."""
        return problem_of(self.run).clock.unit

    @property
    def cost_head(self) -> str:
        """Head of the column of costs; the column is empty if the job has no total cost."""
        return f"cost, of {problem_of(self.run).total_cost}"

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
        Lower and upper end, 95 %; None is unknown.
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
    if low is None or high is None:
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
    """A cell with an expected MSE and its standard error; None stands for an infinite value."""
    mse = cost(expected_mse)
    return Cell(with_error(mse, error), mse)


def percent_cell(fraction: float | None, interval: list[float | None]) -> Cell:
    """A cell with a fraction in per cent and its interval.

    Parameters
    ----------
    fraction : float or None
    interval : list of float or None
        Lower and upper end.
    """
    value, low, high = with_interval(*(times_100(part) for part in (fraction, *interval)))
    return Cell(f"{value} ({range_of(low, high)})", fraction)


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


def cost_cell(result: SetResult) -> Cell:
    """A cell with the cost of a set; empty if the job has no total cost."""
    return Cell("" if result.cost is None else str(result.cost), result.cost)


def sets_table(subject: Subject) -> Table:
    """A table of all sets of times, folded away."""
    rows = [
        [
            Cell(name),
            Cell(str(len(times)), len(times)),
            cost_cell(result),
            Cell(subject.listed(times)),
        ]
        for name, result in subject.results.items()
        for times in (result.measurement_times,)
    ]
    head = ("times", "number", subject.cost_head, "t")
    return without_empty_columns(Table("All sets of times", head, rows, detail=True))
