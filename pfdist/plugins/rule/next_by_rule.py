"""The time to measure next by a run's rule, from the measurements so far."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pandas as pd

from pfdist.common.parts import Facts, Page, Section, Text
from pfdist.common.rounding import rounded
from pfdist.common.shown import Shown
from pfdist.kernels.follows import ROUNDING
from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds
from pfdist.plugins.rule.question import level_text
from pfdist.plugins.rule.rule_file import rule_json, rule_of
from pfdist.problem.clock import Time
from pfdist.problem.feasible import Feasible
from pfdist.problem.measurements import Reading, read_measurements
from pfdist.questions.planned_run import (
    PlannedRun,
    instant_now,
    next_in_words,
    system_of_table,
)
from pfdist.questions.subject import number_of
from pfdist.questions.surprises import IMPROBABLE, SEE_SURPRISE, few_at, surprise_of
from pfdist.results import finite

_BEYOND = (
    "The budget is spent: this rule keeps it on average alone, and one of `pfdist rule --hard` in "
    "each system."
)


@dataclass(frozen=True, repr=False)
class NextByRule(Shown):
    """Result of `next_time` with a rule.

    Parameters
    ----------
    run : Path
    rule : Thresholds
        That of the file ``rule.json`` in the folder of the run.
    measured : tuple of int or float
        Times with a measurement.
    next : int, float, str or None
        The first time, on the clock of the job, at which the rule measures if nothing is measured
        before, with sensors as ``12 x-ray``; None if there is none.
    standard_deviation, level : float
        Predicted standard deviation of z at that time, and the lowest level that it exceeds;
        without such a time, both at the last instant that is left, or NaN.
    feasible : Feasible
        The constraints of the job.
    doubts : sequence of str
        Sentences that put the answer in doubt.
    """

    run: Path
    rule: Thresholds
    measured: tuple[Time, ...]
    next: Time | str | None
    standard_deviation: float
    level: float
    feasible: Feasible
    doubts: Sequence[str]

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        names = ("measured", "next", "standard_deviation", "level")
        values = {name: getattr(self, name) for name in names}
        return finite({"run": str(self.run), "rule": rule_json(self.rule, self.feasible), **values})

    def _page(self) -> Page:
        said = f"The rule measures no more after {number_of(len(self.measured), 'measurement')}"
        level = level_text(self.rule, self.feasible)
        facts = [("rule", f"standard deviation of z above {level}")]
        if self.next is not None:
            said = f"Measure next {next_in_words(self.feasible.points.clock, self.next)}"
            spread = f"{rounded(self.standard_deviation)}, above {rounded(self.level)}"
            facts.append(("predicted standard deviation", spread))
        blocks = Text(f"{said}.", prominent=True), Facts(facts)
        return Page("", "", [Section("", blocks)], alarms=self.doubts)


def next_by_rule(
    plan: PlannedRun, table: Path | pd.DataFrame, now: Any, reading: Reading
) -> NextByRule:
    """The first instant at which the spread exceeds a level of the run's rule."""
    run = cast(Path, plan.path)
    feasible, points = plan.built.feasible, plan.built.feasible.points
    rule, clock = rule_of(run, feasible), points.clock
    start = 0 if plan.prior is None else plan.prior.t
    rows = read_measurements(table, plan.built.evaluator.believed, clock, start, reading)
    filtering, _, taken, measured = system_of_table(plan, rows)
    estimates = [filtering.update(*each, warn=False) for each in zip(rows.t, rows.y, strict=True)]
    at, last = rows.clock.nearest(clock.times), max((*rows.t, *rows.missed), default=-1)
    passed = max([start - 1, *(k for k in range(len(clock.times)) if at[k] <= last)])
    if now is not None:
        passed = instant_now(now, max(passed, start), clock, reading.note)
    waiting = tuple(point for point in rows.in_flight if points.instant(point) > passed)
    # A rule that is a set of times measures as often in each system, whatever was measured before.
    is_set = {*rule.thresholds} <= {ALWAYS, NEVER}
    left = feasible.left(taken, passed + 1, waiting, None if is_set else rule.limit)
    following, spread, level = None, math.nan, math.nan
    for k in range(passed + 1, len(clock.times)):
        left.wait(k)
        here, spent = left.made_at(k), float(left.spent[0])
        if not any(left.may(point)[0] for point in here):
            continue
        spread = filtering.predict(at[k]).spread
        chosen = rule.chosen(spread, k, left)
        level = min(rule.levels(chosen or here, len(clock.times) - k, spent))
        if chosen:
            written = points.written_of(sorted(chosen))
            following = ", ".join(written) if points.sensors else written[0]
            break
    surprise = surprise_of(estimates)
    few = next((each.collapsed for each in estimates if each.collapsed is not None), None)
    doubts = few_at(None if few is None else rows.clock.time(few), clock)
    doubts += [SEE_SURPRISE] * (surprise is not None and surprise < IMPROBABLE)
    is_beyond = float(left.spent[0]) > (1 + ROUNDING) * feasible.budget
    doubts += [_BEYOND] * (following is not None and is_beyond)
    return NextByRule(run, rule, measured, following, spread, level, feasible, doubts)
