"""The result of a backtest, and its words: found gains, errors of sets, verdicts, a report."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import pfdist
from pfdist.common.changes import change_of
from pfdist.common.component_names import Component
from pfdist.common.measurement_times import EVEN
from pfdist.common.parts import Cell, Facts, Page, Section, Table, Text
from pfdist.common.rounding import rounded, with_interval
from pfdist.common.shown import Shown
from pfdist.filters.filter_estimate import few_particles
from pfdist.plugins.backtest.backtesting import ReplicateErrors
from pfdist.plugins.backtest.promise import Promise
from pfdist.plugins.backtest.thinned import CENTRED, FROM_START, PLAN
from pfdist.problem.clock import Clock, Time
from pfdist.questions.subject import number_of
from pfdist.results import finite

Array = NDArray[np.float64]
_MUCH = 1000.0  # the end of an interval that says nothing
_DEPENDENT = 0.3  # lag-1 correlation of differences
_MEANING = (
    "Errors are squared errors of the filter's prediction, divided by the variance of what is "
    "judged."
)
_VERDICT_MEANING = (
    "A promise is kept if at least half of the foreseen difference of the errors is found, with "
    "95 % confidence, and not kept if clearly less is found."
)
_GAINS = ("against", "foreseen gain", "found gain")
_VERDICTS = ("against", "found / foreseen", "promise")
_SETS = (
    "times", "error", "foreseen", "error / foreseen", "in 90 % interval", "error without noise",
    "foreseen without noise",
)  # fmt: skip


class ShownReplicate(NamedTuple):
    """A replicate that a report shows in full."""

    name: str
    times: Array  # (T+1,)
    measured: Array  # (T+1, q): what could be judged
    used: tuple[int, ...]  # the instants of the plan
    errors: ReplicateErrors


@dataclass(frozen=True, repr=False)
class Backtest(Shown):
    """Result of `backtest`.

    Parameters
    ----------
    data : Path
        The file with the measurements.
    plan : tuple of int, float or str
        The planned times on the clock of the job; empty with `plan_each`.
    sets : mapping of str to str
        The compared sets with their names in sentences; the first is the plan.
    promises : mapping of str to Promise
        For each set but the plan, whether the foreseen gain of the plan over it was found.
    ratios : mapping of str to (float, (float, float))
        For each set the real error over the foreseen error, with an interval; all intervals hold
        together with 95 % confidence.
    table : DataFrame
        A row for each judged replicate and set, with the columns of `pfdist.store.backtest_schema`.
        Errors are relative to the variance of what is judged.
    noise : float
        The part of all errors that the noise of the judged measurements causes, by the model.
    improbable : float
        Share of the plan's measurements whose p-value is below 1 %.
    left_out : mapping of str to str
        Replicates that are not judged, and why.
    is_checked : bool
        Whether a column says to which replicates the model was fitted.
    within : float
        Largest distance from a wanted time to the measurement that is used instead.
    impossible : int
        Number of filters for which a measurement is impossible.
    collapsed : int
        Number of filters, one for each replicate and set, whose effective sample size falls below
        5. Their estimates are those of a few particles, not the model's.
    files : tuple of Path
        The table, the figure, and the report if it was wanted; none for a DataFrame without `out`.
    shown : tuple of ShownReplicate
    quantities : tuple of Component
        The components of what is judged.
    clock : Clock
        That of the job.
    """

    data: Path
    plan: tuple[Time | str, ...]
    sets: Mapping[str, str]
    promises: Mapping[str, Promise]
    ratios: Mapping[str, tuple[float, tuple[float, float]]]
    table: pd.DataFrame
    noise: float
    improbable: float
    left_out: Mapping[str, str]
    is_checked: bool
    within: float
    impossible: int
    collapsed: int
    files: tuple[Path, ...]
    shown: tuple[ShownReplicate, ...]
    quantities: tuple[Component, ...]
    clock: Clock

    @property
    def wrong(self) -> list[str]:
        """Names of the sets whose real error clearly differs from the foreseen error."""
        return [name for name, (_, (low, high)) in self.ratios.items() if low > 1.0 or high < 1.0]

    @property
    def means(self) -> pd.DataFrame:
        """Means over the replicates by set: real, foreseen, covered."""
        columns = ["real", "foreseen", "covered"]
        return self.table.groupby("set", sort=False)[columns].mean()

    @property
    def judged(self) -> int:
        """Number of judged values."""
        return int(self.table[self.table["set"] == PLAN]["judged"].sum())

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values, with the table as the path of its file."""
        files = dict(zip(("table", "figure", "report"), map(str, self.files), strict=False))
        means = self.means.to_dict("index")
        sets = {
            name: {**means[name], "ratio": ratio, "interval": interval,
                   "is_wrong": name in self.wrong}
            for name, (ratio, interval) in self.ratios.items()
        }  # fmt: skip
        return finite(
            {
                "data": str(self.data),
                "plan": self.plan,
                "replicates": len(self.table) // len(self.sets),
                "judged": self.judged,
                "promises": {
                    name: {"verdict": each.verdict, **vars(each)}
                    for name, each in self.promises.items()
                },
                "sets": sets,
                "noise": self.noise,
                "improbable": self.improbable,
                "collapsed": self.collapsed,
                "left_out": dict(self.left_out),
                "is_checked": self.is_checked,
                **{name: files.get(name) for name in ("table", "figure", "report")},
            }
        )

    def _page(self) -> Page:
        return backtest_answer(self)


def backtest_answer(answer: Backtest) -> Page:
    """The answer of a terminal: the found gains in a sentence, and tables."""
    section = Section("", [Text(_headline(answer), prominent=True), _gains(answer), _sets(answer),
                           Facts(_facts(answer)), *_verdicts(answer)])  # fmt: skip
    place = ""
    if answer.files:
        kind = "Report" if answer.files[-1].suffix == ".html" else "Figure"
        place = f"{kind}: {answer.files[-1]}"
    return Page("", "", [section], [*_warnings(answer)], place=place, alarms=_alarms(answer))


def report_of(answer: Backtest) -> Page:
    """The report: the found gains, the errors by replicate, and some replicates in full."""
    # Not above: answers without pictures wait for no Matplotlib.
    from pfdist.plugins.backtest.figures import by_replicate, in_full  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    errors = by_replicate(answer.table, answer.sets)
    full = in_full(answer.shown, answer.quantities[0], answer.clock)
    sections = [
        Section("The answer", [Text(_headline(answer), prominent=True), _gains(answer),
                               Text(_MEANING), *_verdicts(answer)]),
        Section("By replicate", [picture(errors, "replicates", "Real error against the error that "
                                         "the model foresaw, for each replicate.")]),
        Section("Is the model right?", [_sets(answer), Facts(_facts(answer))]),
        Section("Some replicates in full", [picture(full, "full", "Measurements, and the filter's "
                                                    "prediction with the plan.")]),
        Section("All replicates", [_replicates(answer)]),
    ]  # fmt: skip
    replicates = number_of(_count(answer), "replicate")
    return Page(
        "Does the plan help on real measurements?",
        f"A plan, judged by the measurements of {replicates}. {answer.data.name}, pfdist "
        f"{pfdist.__version__}",
        sections,
        [*_warnings(answer)],
        source=f"from the measurements {answer.data.name}",
        alarms=_alarms(answer),
    )


def _count(answer: Backtest) -> int:
    return len(answer.table) // len(answer.sets)


def _headline(answer: Backtest) -> str:
    gains, same = [], []
    grids = [name for name in (FROM_START, CENTRED, EVEN) if name in answer.sets]
    for name in sorted(grids, key=lambda name: answer.promises[name].found):
        gain = answer.promises[name]
        if _is_same(gain.found, gain.found_interval):
            same.append(answer.sets[name])
            continue
        ends = [each if math.isfinite(each) else None for each in gain.found_interval]
        change = change_of(gain.found, ends).replace("few draws", "few replicates")
        gains.append(f"{change} than with {answer.sets[name]}")
    ratio, (low, high) = answer.ratios[PLAN]
    value, lowest, highest = with_interval(ratio, low, high)
    interval = f" (95 % CI {lowest} to {highest})" if high < _MUCH else ""
    found = [f"The plan has the same times as {each}." for each in same]
    found += [f"With the plan, the error is {', and '.join(gains)}."] if gains else []
    subject = "It" if gains else "Its error"
    ending = f"{subject} is {value} times the error that the model foresees{interval}."
    return " ".join([*found, ending])


def _is_same(gain: float, interval: tuple[float, float]) -> bool:
    """Whether all errors are equal, as only those of the same times are."""
    return gain == 0 and interval == (0, 0)


def _gain(gain: float, interval: tuple[float, float]) -> Cell:
    if _is_same(gain, interval):
        return Cell("the same times", gain)
    if not all(map(math.isfinite, interval)):
        return Cell(f"{100 * gain:.2g} %", gain)
    value, low, high = with_interval(*(100 * each for each in (gain, *interval)))
    return Cell(f"{value} ({low} to {high}) %", gain)


def _gains(answer: Backtest) -> Table:
    rows = []
    for name, each in answer.promises.items():
        gains = each.foreseen, *each.foreseen_interval
        foreseen, *_ = with_interval(*(100 * gain for gain in gains))  # the digits that are known
        found = _gain(each.found, each.found_interval)
        rows.append([Cell(answer.sets[name]), Cell(f"{foreseen} %", each.foreseen), found])
    return Table("Gain of the plan (95 % CI)", _GAINS, rows)


def _verdicts(answer: Backtest) -> list[Table | Text]:
    rows = [
        [
            Cell(answer.sets[name]),
            Cell(_ratio(each.ratio, each.interval), each.ratio),
            Cell(each.verdict),
        ]
        for name, each in answer.promises.items()
    ]
    caption = "Whether half of the foreseen gain is found (95 % CI)"
    return [Table(caption, _VERDICTS, rows, detail=True), Text(_VERDICT_MEANING, detail=True)]


def _ratio(ratio: float, interval: tuple[float, float]) -> str:
    is_known = all(map(math.isfinite, (ratio, *interval))) and interval[1] < _MUCH
    if not is_known:
        return f"{rounded(ratio, 2)} (any)"
    value, low, high = with_interval(ratio, *interval)
    return f"{value} ({low} to {high})"


def _sets(answer: Backtest) -> Table:
    means, rows = answer.means, []
    for name, label in answer.sets.items():
        real, foreseen, covered = map(float, means.loc[name].to_numpy())
        cells = [Cell(label), Cell(rounded(real, 3), real), Cell(rounded(foreseen, 3), foreseen)]
        cells.append(Cell(_ratio(*answer.ratios[name]), answer.ratios[name][0]))
        cells.append(Cell(f"{100 * covered:.1f} %", covered))
        without = (each - answer.noise for each in (real, foreseen))
        rows.append([*cells, *(Cell(rounded(each, 3), each) for each in without)])
    return Table(
        "Errors of each set (intervals hold together, 95 %)", _SETS, rows, optional=_SETS[5:]
    )


def _facts(answer: Backtest) -> list[tuple[str, str]]:
    plan = answer.clock.listed(answer.plan) or "one for each replicate"
    within = answer.clock.duration(answer.within)
    facts = [
        ("plan", f"t = {plan}" if answer.plan else plan),
        ("judged", f"{number_of(answer.judged, 'value')} of "
                   f"{number_of(_count(answer), 'replicate')}, which no set uses"),
        ("improbable", f"{100 * answer.improbable:.1f} % of the plan's measurements (p < 1 %; a "
                       "right model: 1 %)"),
        ("distance", f"at most {within} from a wanted time to the measurement used"),
    ]  # fmt: skip
    if answer.left_out:
        facts.append(("left out", "; ".join(_reasons(answer))))
    if not answer.is_checked:
        facts.append(
            ("not checked", "whether the model was fitted to these replicates (a column train "
                            "marks those that it was)")
        )  # fmt: skip
    return facts


def _reasons(answer: Backtest) -> Iterator[str]:
    names = dict[str, list[str]]()
    for name, why in answer.left_out.items():
        names.setdefault(why, []).append(name)
    for why, those in names.items():
        shown = ", ".join(those[:5]) + f" and {len(those) - 5} others" * (len(those) > 5)
        yield f"{shown}: {why}"


def _alarms(answer: Backtest) -> list[str]:
    sets = ", ".join(answer.sets[name] for name in answer.wrong)
    said = f"The model is wrong: the real error differs from the foreseen error with {sets}."
    where = f"in {answer.collapsed:,} of {len(answer.table):,} filters"
    few = few_particles(where, 'filter.proposal = "guided", ')
    return [few] * bool(answer.collapsed) + [said] * bool(answer.wrong)


def _warnings(answer: Backtest) -> Iterator[str]:
    if answer.impossible:
        count = number_of(answer.impossible, "filter")
        yield f"In {count} no particle explains a measurement, which is then left out."
    if max((each.correlation for each in answer.promises.values()), default=0.0) > _DEPENDENT:
        yield (
            "Consecutive replicates depend on each other, so intervals are too narrow: --block "
            "joins them."
        )


def _replicates(answer: Backtest) -> Table:
    names, rows = [*answer.sets], []
    for name, group in answer.table.groupby("replicate", sort=False):
        by_set = group.set_index("set")
        cells = [Cell(str(name)), Cell(str(by_set["judged"].iloc[0]))]
        for each in names:
            for column in ("real", "foreseen"):
                error = float(by_set[column][each])
                cells.append(Cell(rounded(error, 3), error))
        rows.append(cells)
    head = ["replicate", "judged", *(f"{which}, {answer.sets[each]}" for each in names
                                     for which in ("error", "foreseen"))]  # fmt: skip
    return Table("Errors of each replicate", head, rows, detail=True)
