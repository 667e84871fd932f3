"""A rule that measures when it is needed, against times that are fixed in advance."""

import math
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.changes import change_of, effect, is_clear
from pfdist.common.estimate import Estimate
from pfdist.common.parts import Cell, Facts, Page, Section, Table, Text
from pfdist.common.plugins import asked
from pfdist.common.rounding import rounded, unrounded
from pfdist.common.section import checked
from pfdist.common.shown import Shown
from pfdist.filters.criterion import Criterion, CriterionValue, OtherCriterion, Sample
from pfdist.filters.estimate import Evaluation
from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds
from pfdist.models import StateSpaceModel
from pfdist.plugins.rule.every_strategy import bound_of_strategies
from pfdist.plugins.rule.needs import RULES
from pfdist.plugins.rule.rule_file import keep_rule, rule_json
from pfdist.plugins.rule.ruling import (
    TUNING_DRAWS,
    filtered_by,
    followed,
    rule_of_set,
    settle_rules,
    tuned,
    work_of,
)
from pfdist.problem.feasible import Feasible
from pfdist.problem.problem import JobSource
from pfdist.problem.set_key import phrase_of
from pfdist.questions.at_work import at_work, noted
from pfdist.questions.options import (
    Chosen,
    ComparedDraws,
    Options,
    following,
    with_options,
)
from pfdist.questions.run_of_job import own_store, run_and_job
from pfdist.questions.subject import mse_cell, number_of
from pfdist.results import Run, finite
from pfdist.results.pairs import pairs_table
from pfdist.results.particle_loss import lost_text
from pfdist.results.sets import recommended
from pfdist.results.stored_run import check_one_number, measured_of, provenance_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch, complete
from pfdist.runner.driver import core_steps
from pfdist.runner.opponent import SHARE

RULE = "rule"
_DIGITS = 9  # of prices, whose sums are rounded
MORE = 4  # times the particles, with which a rule may spend another number
_FEWEST, _CLEAR, _NOTICED = 40, 2.0, 0.02  # draws; standard errors; share of the budget


@dataclass(frozen=True, repr=False)
class Ruled(Shown):
    """Result of `rule`.

    Parameters
    ----------
    run : Path
        Folder of the run.
    rule : Thresholds
        The tuned rule: thresholds (below 0: always), exponent, limit (0: none).
    feasible : Feasible
        The constraints of the job: its budget, prices and sensors.
    criterion : Criterion
        The number that the job minimises.
    plan : str
        Name of the compared set that was planned.
    table : DataFrame
        A row for each judged draw: measurements (their number with the rule; for a job with prices,
        price), degenerate (whether no particle explains one of them), mse_rule, and the MSE of each
        other set, as ``mse_NAME``.
    labels : mapping of str to str
        The other sets as answers call them.
    numbers : mapping of str to float
        How many measurements the other sets have, or their prices.
    bound : Estimate or None
        A number that the expected MSE of no strategy is below; None if no bound is known.
    unit : str
        The unit of the standard deviation of z; empty if it is not known, or if there is none.
    finer : Estimate, optional
        How much more the rule spends on average with four times the particles, on the same draws.
    lost_constants : float
        The share of draws in which the filter ends with few values of a constant.
    figures : list of Path
    """

    run: Path
    rule: Thresholds
    feasible: Feasible
    criterion: Criterion
    plan: str
    table: pd.DataFrame
    labels: Mapping[str, str]
    numbers: Mapping[str, float]
    bound: Estimate | None
    unit: str
    finer: Estimate | None = None
    lost_constants: float = 0.0
    figures: Sequence[Path] = ()

    @property
    def budget(self) -> float:
        """The number of measurements, or the total price, that the rule may spend on average."""
        return self.feasible.budget

    @property
    def what(self) -> str:
        """The column with what is spent: "measurements", or "price"."""
        return str(self.table.columns[0])

    @property
    def spent(self) -> Estimate:
        """The mean number of measurements of a draw, or their mean price."""
        return Estimate.of_mean(self.table[self.what].to_numpy())

    def error(self, name: str = RULE) -> Estimate:
        """The expected MSE, or the job's criterion, with the rule or another set, on the draws."""
        return self.criterion.value(Evaluation((), self.table[f"mse_{name}"].to_numpy()))

    def gain(self, name: str) -> CriterionValue:
        """How far the rule's error lies below that of a set, as a share, with interval."""
        errors = self.table[[f"mse_{RULE}", f"mse_{name}"]].to_numpy()
        if isinstance(self.criterion, OtherCriterion):
            return self.criterion.change(*map(Sample, errors.T))
        (pair,) = pairs_table([RULE, name], [errors], {}).to_dict("records")
        return CriterionValue(*(pair[f"gain_of_means{end}"] for end in ("", "_low", "_high")))

    @property
    def is_plan(self) -> bool:
        """Whether no rule was clearly better than the plan, so that the rule is the plan."""
        own, other = (self.table[f"mse_{name}"] for name in (RULE, self.plan))
        return np.array_equal(own, other, equal_nan=True)  # another rule has other filter noise

    @property
    def verdict(self) -> str:
        """Whether the rule is "the plan", "better" or "worse", or "not clearly" different."""
        if self.is_plan:
            return "the plan"
        gain, *interval = self.gain(self.plan)
        return ("better" if gain > 0 else "worse") if is_clear(interval) else "not clearly"

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values; without sensors, the rule is three numbers."""
        numbers, mean, bound = self.table[self.what], self.spent, None
        if self.bound is not None:
            bound = {"value": self.bound.value, "standard_error": self.bound.standard_error,
                     "at_least": self.at_least, "share": self.share}  # fmt: skip
        sets = {
            name: {self.what: self.numbers[name], **self._error_json(name),
                   **self.gain(name).columns("gain")}
            for name in self.labels
        }  # fmt: skip
        return finite(
            {
                "run": str(self.run),
                "rule": rule_json(self.rule, self.feasible),
                "constraints": self.feasible.step_limits.recorded,
                "budget": self.budget,
                **self._error_json(RULE),
                "draws": len(self.table),
                "degenerate_draws": int(self.table["degenerate"].sum()),
                "tuning_draws": TUNING_DRAWS,
                self.what: {
                    "mean": mean.value,
                    "standard_error": mean.standard_error,
                    "standard_deviation": float(numbers.std()),
                    "draws_by_number": numbers.value_counts().sort_index().to_dict(),
                },
                "plan": self.plan,
                "verdict": self.verdict,
                "bound": bound,
                "sets": sets,
                "figures": [*map(str, self.figures)],
            }
        )

    @property
    def at_least(self) -> float:
        """The number that the expected MSE of no strategy is below, with 95 % confidence."""
        return math.nan if self.bound is None else -self.bound.times(-1.0).at_most()

    @property
    def share(self) -> float:
        """The share of what any strategy can win at most, compared with the plan."""
        own, plan = self.error().value, self.error(self.plan).value
        return (plan - own) / (plan - self.at_least)

    def _error_json(self, name: str) -> dict[str, float]:
        error = self.error(name)
        return {self.criterion.name: error.value, "standard_error": error.standard_error}

    def _page(self) -> Page:
        numbers, mean, label = self.table[self.what], self.spent, self.criterion.label
        gains = {name: self.gain(name) for name in self.labels}
        gain, *interval = gains[self.plan]
        plan = self.labels[self.plan]
        said = effect(gain, interval, plan, f"the rule's {label}")
        if self.is_plan:
            said = f"Deciding on the way wins nothing here: the rule is {plan}"
        elif self.verdict == "worse":
            said = f"The rule is worse than {plan}, so keep {plan}. {said}"
        ends = f"{unrounded(numbers.min())} to {unrounded(numbers.max())}"
        level = level_text(self.rule, self.feasible, self.unit)
        facts = [
            (
                "rule",
                plan
                if self.is_plan
                else f"measure when the standard deviation of z exceeds {level}",
            ),
            (self.what, f"{mean.text} on average (standard deviation {numbers.std():.2g}; {ends})"),
            ("draws", f"{len(numbers):,}, none of which tuned the rule"),
        ]
        if self.bound is not None:
            least = f"estimate {self.bound.text}"
            facts.append(
                ("any strategy", f"at least {rounded(self.at_least)} (95 % confidence; {least})")
            )
            if not self.is_plan and self.share > 0:
                said += f". This is {100 * self.share:.0f} % of what any strategy can win at most"
        rows = []
        for name, other in {RULE: "the rule", **self.labels}.items():
            error, number = self.error(name), self.numbers.get(name, mean.value)
            spent = mean.text if name == RULE else unrounded(number)
            change = "" if name == RULE else change_of(gains[name][0], gains[name][1:])
            rows.append([Cell(other), Cell(spent, number),
                         mse_cell(error.value, error.standard_error), Cell(change)])  # fmt: skip
        head = ("times", f"{self.what} ± SE", f"{label} ± SE", "rule's error")
        blocks = Text(f"{said}.", prominent=True), Facts(facts), Table("", head, rows)
        warnings, few = [], self.table["degenerate"].sum()
        if mean.value - self.budget > 2 * mean.standard_error:
            budget = f"{mean.text}, more than {unrounded(self.budget)}"
            warnings = [f"On these draws the mean {self.what} of the rule is {budget}."]
        if (more := self.finer) is not None and (
            abs(more.value) > max(_CLEAR * more.standard_error, _NOTICED * self.budget)
        ):
            finer = Estimate(mean.value + more.value, more.standard_error)
            warnings.append(
                f"With {MORE} times the particles the rule spends {finer.text} {self.what} on "
                "average: its thresholds fit this number of particles."
            )
        if copies := lost_text(self.lost_constants):
            warnings.append(
                f"{copies} There a deviation of 0 is that of copies, and the rule ends."
            )
        if few:
            warnings += [f"In {few:,} draws, no particle explains a measurement of the rule."]
        return Page("", "", [Section("", blocks)], warnings)


@partial(with_options, without="report")
@checked
def rule(
    job: JobSource | Run,
    *,
    hard: bool = False,
    draws: ComparedDraws | None = None,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Ruled:
    """Measure when the filter is unsure, and compare this with the plan of a run.

    A rule measures at an instant if the predicted standard deviation of z, which the filter's own
    particles have, exceeds the threshold of the instant. Thresholds are tuned on separate draws, so
    that the mean number of measurements is at most that of the plan. If no rule is clearly better
    than the plan, the rule is the plan. The rule and the run's sets then filter the same fresh
    draws: those of its comparison. The same call resumes where it was stopped.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run. If the run has online times, the
        rule is also compared with these.
    hard : bool
        Never measure a draw more often than the plan does. The threshold then grows with the time
        that is left, and falls with the budget that is left.
    draws : int, optional
        Use only the first draws of the comparison; by default all, or all with online times.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    options
        See `Options`.

    Returns
    -------
    Ruled

    Raises
    ------
    StoreError
        There is no finished run of the job, or the run is of another job or of other models.
    JobError
        The job has a criterion other than the expected MSE and a quantile, an exact engine, or a
        model with its own error.
    TaskError, PoolError
        A task failed, or no worker answers. All finished draws are kept.
    """
    chosen = Chosen(**options)
    with following(chosen.progress, chosen.say) as (show, tell):
        run, built = run_and_job(job, results, changes, tell, chosen.execution)
        check_one_number(run)
        RULES.check("a rule", built.job, built.evaluator)
        with own_store(run, built, tell) as store:
            session = RunSession(built, store, show, tell)
            with noted(session):
                pool = at_work(built.job.execution, [built.evaluator.engine], tell)
                found: Ruled = complete(_judge(session, run, draws, is_hard=hard), pool)
            session.reporter.finish()
        if store.path != run.path:  # of another version
            return found
        keep_rule(run.path, {key: value for key, value in found.as_json().items() if key != "run"})
    return replace(found, figures=_draw(found, built)) if chosen.figures else found


def _draw(found: Ruled, built: Built) -> list[Path]:
    """Draw the first draw with the median number of measurements."""
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.plugins.rule.figure import draw_rule  # noqa: PLC0415

    numbers = found.table[found.what]
    usual = numbers[~found.table["degenerate"] & np.isfinite(found.table["mse_rule"])]
    if usual.empty:
        return []
    draw = int((usual - numbers.median()).abs().idxmin())
    shown = followed(built.evaluator, work_of(built, found.rule, draw + 1), draw)
    clock = built.job.problem.clock
    return draw_rule(found.run, shown, numbers.to_numpy(), found.what, found.unit, clock)


def _judge(
    session: RunSession, run: Run, draws: int | None, *, is_hard: bool
) -> Generator[WorkBatch, None, Ruled]:
    """Driver that tunes the rule, and filters the draws of the run's comparison with it."""
    built, store = session.built, session.store
    (table, beside), plan = _compared(run, draws), recommended(run).name
    own = yield from tuned(session, measured_of(run)[plan], is_hard=is_hard)
    feasible, measured, finer = built.feasible, measured_of(run), None
    if (
        own.thresholds == rule_of_set(measured[plan], feasible).thresholds
    ):  # with the noise that the plan has
        mse, degenerate = table[f"mse_{plan}"].to_numpy(), np.zeros(len(table))
        spent = np.full(len(table), float(feasible.price_of(measured[plan])))
    else:
        work = work_of(built, own, len(table))
        session.reporter.foresee(work.steps)
        ((mse, spent, degenerate),) = yield from filtered_by(session, work)
        finer = yield from _with_more_particles(session, own, spent)
    bound = yield from bound_of_strategies(session, is_hard=is_hard)
    session.commit()
    settle_rules(store)
    what = (
        {"price": spent.round(_DIGITS)} if feasible.price else {"measurements": spent.astype(int)}
    )
    own_table = pd.DataFrame(what | {"degenerate": degenerate > 0, "mse_rule": mse})
    table = pd.concat([own_table, table], axis=1)
    labels = {name: phrase_of(run.labels[name]) for name in (plan, run.names[0])}
    labels |= {name.removeprefix("mse_"): label for name, label in beside.items()}
    unit = unit_of(built.evaluator.model)
    numbers = {
        name: float(feasible.price_of(measured[name])) if name in measured else feasible.budget
        for name in labels
    }
    lost = provenance_of(run).get("lost_constants", {}).get(plan, 0.0)
    return Ruled(
        run.path, own, feasible, built.job.criterion, plan, table, labels, numbers, bound, unit,
        finer, lost,
    )  # fmt: skip


def _with_more_particles(
    session: RunSession, own: Thresholds, spent: NDArray[np.float64]
) -> Generator[WorkBatch, None, Estimate | None]:
    """How much more a rule spends with more particles, on first draws; None if too few fit."""
    built = session.built
    particles = MORE * built.comparing.particles
    a_draw = work_of(built, own, 1, particles=particles).steps
    draws = min(len(spent), int(SHARE * core_steps(built) / a_draw))
    if draws < _FEWEST:
        return None
    work = work_of(built, own, draws, particles=particles)
    session.reporter.foresee(work.steps)
    ((_, more, _),) = yield from filtered_by(session, work)
    return Estimate.of_mean(more - spent[:draws])


def unit_of(model: StateSpaceModel) -> str:
    """The unit of the standard deviation of z; empty for that of an angle, sqrt(1 - R)."""
    (quantity, *others) = model.named("z")
    return "" if others or any(model.is_angle) else quantity.unit


def _compared(run: Run, draws: int | None) -> tuple[pd.DataFrame, dict[str, str]]:
    """The errors of a run's sets and online times with the same draws, and labels of the latter."""
    table = run.table("comparison", draws).filter(regex="^(draw|mse_.*)$")
    errors_beside = asked("rule.beside")
    beside = None if errors_beside is None else errors_beside(run, draws)
    if beside is not None:
        table = table.merge(beside, on="draw")
    labels = {} if beside is None else beside.attrs["labels"]
    return table.drop(columns="draw").reset_index(drop=True), labels


def level_text(rule: Thresholds, feasible: Feasible, unit: str = "") -> str:
    """The levels of a rule as a formula; thresholds that differ are given by their range.

    >>> counted = Feasible(horizon=3, measurement_budget=2)
    >>> level_text(Thresholds((6.0,)), counted, "m")
    '6 m'
    >>> level_text(Thresholds((3.5,), 0.5, 2), counted)
    '3.5 x (rest of time / rest of budget)^0.5, at most 2 times'
    >>> level_text(Thresholds((2.0, NEVER, 3.5, ALWAYS)), counted)
    '2 to 3.5 by the time, always at t = 3, never at t = 1'
    """
    points, levels = feasible.points, list[str]()
    for way in range(points.ways):
        own = [point for point in feasible.allowed if points.way(point) == way]
        thresholds = dict(zip(own, rule.thresholds_of(own).tolist(), strict=True))
        numbers = sorted({c for c in thresholds.values() if ALWAYS < c < NEVER})
        ends = [f"{unrounded(c)} {unit}".rstrip() for c in numbers[:1] + numbers[1:][-1:]]
        parts = [" to ".join(ends) + " by the time" * (len(ends) > 1)] * bool(ends)
        for word, flag in (("always", ALWAYS), ("never", NEVER)):
            at = [points.instant(point) for point, c in thresholds.items() if c == flag]
            when = f"{word} at t = {points.clock.listed(points.clock.time(t) for t in at)}"
            parts += [word if len(at) == len(own) else when] * bool(at)
        name = f" ({points.sensors[way]})" if points.sensors else ""
        levels.append(", ".join(parts) + name)
    power = f" x (rest of time / rest of budget)^{unrounded(rule.exponent)}" * (rule.exponent > 0)
    limit = rule.limit
    paid = f"a price of {unrounded(limit)}" if feasible.price else number_of(int(limit), "time")
    return ", ".join(levels) + power + f", at most {paid}" * (limit > 0)
