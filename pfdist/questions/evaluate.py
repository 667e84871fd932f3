"""The expected MSE of sets of measurement times, computed in this process."""

import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import repeat
from operator import or_
from pathlib import Path
from typing import Any, overload

import numpy as np

from pfdist.common.arguments import sets_argument
from pfdist.common.changes import change_of, is_clear
from pfdist.common.component_names import Component
from pfdist.common.measurement_times import LINEARIZED, REGULAR, Times
from pfdist.common.parts import Cell, Page, Section, Table, Text
from pfdist.common.percent import heavy_tail_warning
from pfdist.common.rounding import rounded, unrounded
from pfdist.common.streams import stream_of
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.filters.aspects import Aspect, ErrorBeside
from pfdist.filters.criterion import MEAN, Criterion, OtherCriterion, Sample
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse, exact_over_time
from pfdist.filters.variants import for_work, is_limit, of_error, shown_beside
from pfdist.filters.work import FilterWork, Result, joined
from pfdist.models import squared_error
from pfdist.problem.clock import Time
from pfdist.problem.covariates import times_of_file
from pfdist.problem.job import Job, load_job
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.sections import is_list_of
from pfdist.questions.compared_page import parameters_text
from pfdist.questions.options import Names, criteria_in, following
from pfdist.questions.subject import mse_cell, number_of
from pfdist.results import Gain
from pfdist.results.columns import Row, sets_table
from pfdist.results.criteria import fields_over_time
from pfdist.results.over_time import Range, profile_of
from pfdist.results.particle_loss import lost_text
from pfdist.runner.build import Built, build, design_of_job
from pfdist.runner.comparison_phase import FEWER, LOSS_DRAWS
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.particles import LOST_DRAWS, fewest_lines, lost_constants
from pfdist.runner.progress import Progress, heard, silent
from pfdist.runner.searches import comparing_of

UNNAMED = ""
"""Name of a set to which the user gives no name."""

OneSet = Iterable[Time | str] | str
SetsWritten = OneSet | Mapping[str, OneSet]


@overload
def evaluate(
    job: JobSource,
    measurement_times: Mapping[str, Iterable[Time | str] | str],
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
    *,
    profile: bool = False,
    also: Names | None = None,
) -> dict[str, Evaluation]: ...


@overload
def evaluate(
    job: JobSource,
    measurement_times: Iterable[Time] | str,
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
    *,
    profile: bool = False,
    also: Names | None = None,
) -> Evaluation: ...


def evaluate(
    job: JobSource,
    measurement_times: SetsWritten,
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
    *,
    profile: bool = False,
    also: Names | None = None,
) -> Evaluation | dict[str, Evaluation]:
    """Estimate the expected MSE of a set of measurement times, or of several, in this process.

    A terminal and a notebook show the progress from the fifth second on. The proposal "auto" is
    that of the run, or of the last run of this problem in the process; else few draws are plain.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    measurement_times : iterable of int or float, or str; or mapping of str to these
        Any number of times in 0..T, or on the clock of the job, or a text such as "0:60:3",
        "regular" (the regular times of the job) or "linearized" (the set of least linearized
        error). They may break the job's constraints:
        ``load_job(path).problem.broken(times)`` lists the broken ones. Sets with names share their
        draws and the noise of their filters.
    draws, particles, seed : int, optional
        Replace the job's evaluation.draws, filter.particles and seed.
    profile : bool
        Whether the expected error over time is wanted, too.
    also : str or list of str, optional
        Other criteria by which the sets are judged, too, as ``worst_instant,"quantile 0.9"``.

    Returns
    -------
    Evaluation, or dict of str to Evaluation
        ``expected_mse``, ``standard_error``, ``draws``, ``degenerate_draws`` and the per-draw
        values ``mse``; of sets with names, by name. With ``profile``, also the DataFrame
        ``profile`` with a row for each instant: t, measured (whether the set measures then), draws
        (0: exact), weight (of the instant in the MSE; the mean is 1), error and standard_error.
        Errors are scaled as in the MSE, and their weighted mean over time is ``expected_mse``.
        ``pfdist.plots.error_profile`` draws it. The mapping ``also`` has the number of each other
        criterion by its name: value, low and high. It has that of the job, too, if this does not
        minimise the expected MSE.

    Raises
    ------
    JobError, ModelError, MeasurementTimesError
        The job, the model or the times are not possible.
    """
    _, compute = prepare_evaluation(
        job, measurement_times, draws, particles, seed, profile=profile, also=also
    )
    return compute() if _are_named(measurement_times) else compute()[UNNAMED]


def _are_named(written: SetsWritten) -> bool:
    """Whether sets have names: in a mapping, or in texts ``NAME=TIMES``."""
    texts = [written] if isinstance(written, str) else written
    is_list = isinstance(texts, list | tuple) and is_list_of([*texts], str)
    return isinstance(written, Mapping) or (is_list and any("=" in str(each) for each in texts))


def prepare_evaluation(
    job: JobSource,
    measurement_times: SetsWritten,
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
    *,
    profile: bool = False,
    also: Names | None = None,
) -> tuple[Built, Callable[..., dict[str, Evaluation]]]:
    """The compiled job, and a function that evaluates the sets; a set without a name has ``""``.

    With ``beside`` the function estimates an error beside that of the job, on fewer draws.
    """
    settings = {
        "evaluation": {"draws": draws},
        "filter": {"particles": particles},
        "comparison": {"also": criteria_in(also)},
        "seed": seed,
    }
    job = as_job(job, settings=settings)
    are_named = _are_named(measurement_times)
    written = sets_argument(measurement_times) if are_named else {UNNAMED: measurement_times}
    sets = {name: instants_evaluated(job, name, times) for name, times in written.items()}
    if not sets:
        raise JobError("evaluate needs at least one set of times, got none", argument="times")
    # Sets with names share draws and noise; a single set has its own, if the job wants fresh noise.
    fresh = [] if are_named or job.evaluation.noise != "fresh" else [*sets.values()]
    stream = stream_of("evaluate", job.seed, *fresh)
    built = build(job, asked=job.evaluation.draws * len(sets))
    return built, partial(_evaluated, built, sets, stream, profile=profile)


def instants_evaluated(job: Job, name: str, written: Iterable[Time | str] | str) -> Times:
    """The instants of a set; the error names the option, and the set if it has a name."""
    if isinstance(written, str) and written == REGULAR:
        return job.problem.feasible.regular()
    if isinstance(written, str) and written == LINEARIZED:
        return design_of_job(job)
    place = f"times of {name}" if name else "measurement_times"
    points = job.problem.points
    if isinstance(written, str) and written.startswith("@"):
        written = times_of_file(written, points, Path(), partial(heard, silent), place)
    try:
        return points.checked(written, place, where=name and place)
    except MeasurementTimesError as error:
        error.argument = "times"
        raise


def _evaluated(
    built: Built,
    sets: Mapping[str, Times],
    stream: int,
    *,
    profile: bool,
    beside: ErrorBeside | None = None,
) -> dict[str, Evaluation]:
    evaluator, times = built.evaluator, tuple(sets.values())
    criterion, criteria = built.job.criterion.mse_criterion, built.job.other_criteria
    estimation, draws = comparing_of(built.job), built.job.evaluation.draws
    if beside:
        own, estimation = estimation, beside.settings(evaluator, estimation)
        more = estimation.steps_an_instant // own.steps_an_instant
        draws = -(-draws // (FEWER * max(1, more // 2)))
        evaluator, profile, criteria = of_error(evaluator, beside.named), False, {}
    written = [tuple(built.job.problem.points.written_of(each)) for each in times]
    exact = exact_mse(evaluator, times, criterion=criterion)
    by_instant = any(each.by_instant for each in criteria.values())
    work = evaluator.work(
        times,
        stream,
        stream,
        (0, draws),
        estimation,
        ids=tuple(sets),
        over_time=int(exact is None and (profile or by_instant)),
    )
    result = Result(np.empty((0, len(sets))), errors=np.empty((0, len(sets), 0)))
    if exact is None or any(each.needs_draws for each in criteria.values()):
        result = _filtered(evaluator, work)
    if exact is not None:
        known = map(Evaluation.exactly, written, exact.tolist(), repeat(criterion))
        found = {n: replace(e, purpose="evaluate") for n, e in zip(sets, known, strict=True)}
    else:
        scenarios = evaluator.scenarios_of(stream, range(draws))
        formatted = built.job.problem.clock.formatted
        each_set = (work.piece((0, draws), [place]) for place in range(len(sets)))
        lines = [("", False) if beside else fewest_lines(evaluator, e, formatted) for e in each_set]
        seed, own = built.job.seed, estimation
        lost = [
            "" if beside else lost_text(lost_constants(evaluator, times, seed, own, LOST_DRAWS))
            for times in sets.values()
        ]
        found = {
            name: Evaluation(
                written_of_set,
                mse,
                purpose="evaluate",
                scenarios=scenarios,
                criterion=criterion,
                degenerate=degenerate,
                few_lines=" ".join(filter(None, (text * is_few, said))),
            )
            for name, written_of_set, mse, degenerate, (text, is_few), said in zip(
                sets, written, result.mse.T.copy(), result.degenerate.T, lines, lost, strict=True
            )
        }
    if profile:
        found = _with_profiles(built, sets, found, result.errors)
    if criteria:
        for name, sample in zip(sets, _samples(built, work, result), strict=True):
            also = {key: each.of_sample(sample) for key, each in criteria.items()}
            found[name] = replace(found[name], sample=sample, also=also)
    return found


def _filtered(evaluator: Evaluator, work: FilterWork) -> Result:
    pieces, draws = list[Result](), work.draws[1]
    with following(None, silent) as (show, _):
        for piece in evaluator.pieces(work, MOST_SECONDS):
            pieces.append(evaluator.filtered(piece))
            show(Progress("evaluate", piece.draws[1], draws, evaluations=piece.draws[1]))
    return joined(pieces)


def _with_profiles(
    built: Built, sets: Mapping[str, Times], found: Mapping[str, Evaluation], errors: Any
) -> dict[str, Evaluation]:
    """The evaluations with their errors over time, from the error of each draw, (D, S, T+1).

    The draws count that decide. An exact engine has no draws.
    """
    evaluations = dict[str, Evaluation]()
    for place, (name, each) in enumerate(found.items()):
        rows = errors[:, place]
        deciding = rows[each.criterion.deciding(each)] if each.draws else rows
        ranges = _over_time_of(built, sets[name], built.job.criterion.mse_criterion, deciding)
        table = profile_of(built.job.problem, sets[name], ranges, 0)
        if name:
            table.insert(0, "name", name)
        evaluations[name] = replace(each, profile=table)
    return evaluations


def _samples(built: Built, work: FilterWork, result: Result) -> Iterator[Sample]:
    """The results of each set of a work."""
    wanted = built.job.other_criteria.values()
    aspects = [(aspect, form) for form in wanted for aspect in form.aspects]
    results = {aspect: _values_of(built, work, aspect, form) for aspect, form in aspects}
    by_instant = any(each.by_instant for each in wanted)
    for place, times in enumerate(work.measurement_times):
        ranges = _over_time_of(built, times, MEAN, result.errors[:, place]) if by_instant else []
        of_set = {aspect: values[:, place] for aspect, values in results.items() if values.size}
        errors = fields_over_time(ranges, 0, built.evaluator.relative_weights)
        yield Sample(result.mse[:, place], aspects=of_set, **errors)


def _values_of(built: Built, work: FilterWork, aspect: Aspect, form: Criterion) -> Any:
    """The values of an aspect with each set, (D, S): of draws, or the exact ones of the first."""
    exact = exact_mse(built.evaluator, work.measurement_times, criterion=form)
    if exact is not None:
        return form.sign * exact[None][: aspect == form.aspects[0]]
    draws = work.draws[1] if aspect.of_all_draws else min(LOSS_DRAWS, work.draws[1])
    own = aspect.work(work, draws)
    of_draws = _filtered(for_work(built.evaluator, own), own)
    return aspect.values(of_draws.mse, of_draws.control)


def _over_time_of(built: Built, times: Times, criterion: Criterion, errors: Any) -> list[Range]:
    exact = exact_over_time(built.evaluator, times, criterion)
    if exact is not None:
        return [Range(0, 0, exact)]
    return [Range(draw, 1, error[None]) for draw, error in enumerate(errors)]


# --- the command ----------------------------------------------------------------------------------

_ANSWERED = ("expected_mse", "standard_error", "draws", "degenerate_draws", "largest_share")
_OVER_TIME = ("error", "standard_error")
_OF_INSTANT = ("t", "date", "weight")


@dataclass(frozen=True)
class Evaluated:
    """The answer of ``pfdist evaluate``: sets of times, which may break constraints, by name."""

    evaluations: Mapping[str, Evaluation]
    beside: Mapping[ErrorBeside, Mapping[str, Evaluation]]  # errors beside that of the job
    problem: ProblemSection
    broken: Mapping[str, Sequence[str]]
    parameters: Sequence[Mapping[str, Any]]  # of each scenario
    seconds: float
    quantity: Component | None  # z, if the root of an expected MSE is in its unit
    limits: Collection[ErrorBeside] = ()  # those of `beside` that are upper limits
    form: Criterion = MEAN  # what the job minimises
    criteria: Mapping[str, OtherCriterion] = field(default_factory=dict)  # also wanted
    taken: str = ""  # the filter's proposal, if the job leaves it open

    def as_json(self) -> dict[str, Any]:
        """The estimates of each set, or of the one that has no name."""
        sets = {
            name: self._columns(name)
            | {"broken_constraints": self.broken[name]}
            | _columns_of(evaluation)
            for name, evaluation in self.evaluations.items()
        }
        answer: dict[str, Any] = sets[UNNAMED] if list(sets) == [UNNAMED] else {"sets": sets}
        about = {"criterion": self.form.label, "criterion_unit": self.form.unit}
        return answer | about | {"seconds": round(self.seconds, 3)}

    def _columns(self, name: str) -> dict[str, Any]:
        """The estimates of a set as in the table of sets."""
        evaluation, beside = self.evaluations[name], self.beside.items()
        own = {key: getattr(evaluation, key) for key in _ANSWERED}
        others = [error.columns(found[name].estimate) for error, found in beside]
        judged = [each.columns(key) for key, each in evaluation.also.items()]
        return reduce(or_, [own, *others, *judged])

    def _page(self) -> Page:
        of_the_estimate, tables = self.problem.of_the_estimate, list[Table]()
        if list(self.evaluations) == [UNNAMED]:
            number = len(self.evaluations[UNNAMED].measurement_times)
            draws = self.evaluations[UNNAMED].draws
            about = [number_of(number, "measurement"), *([f"{draws:,} draws"] if draws else [])]
            said = f"Expected MSE{of_the_estimate} {self._mse(UNNAMED)} ({', '.join(about)})"
            said += self._typical(UNNAMED, ";")
            judged = {each: self._judged(UNNAMED, each) for each in self.criteria}
            first = judged.pop(self.form.name, "")
            said = ". ".join(filter(None, [first, said, *judged.values()]))
            for error, found in self.beside.items():
                if math.isfinite(found[UNNAMED].expected_mse):
                    limit = "at most " * (error in self.limits)
                    said += f". {error.when}: {limit}{_text_of(found[UNNAMED])}"
        else:
            said = self._lowest()
            tables.append(self._table(f"Expected MSE{of_the_estimate}" * bool(of_the_estimate)))
        tables += _of_scenarios(self.evaluations, self.parameters)
        tables += _over_time(self.evaluations)
        heavy = heavy_tail_warning(each.largest_share for each in self.evaluations.values())
        notes = filter(None, [f"{self.taken}." * bool(self.taken), heavy])
        texts = [Text(f"{said}.", prominent=True), *map(Text, notes)]
        section = Section("", [*texts, *tables])
        doubts = ((name, each.alarm) for name, each in self.evaluations.items())
        alarms = [f"{name}: " * bool(name) + f"{text}." for name, text in doubts if text]
        return Page("", "", [section], [*self._warnings()], alarms=alarms)

    def _judged(self, name: str, criterion: str) -> str:
        """A set's number by another criterion."""
        label, judged = self.criteria[criterion].label, self.evaluations[name].also[criterion]
        return f"{label[0].upper()}{label[1:]}: {judged.text(self.criteria[criterion].unit)}"

    def _best(self, form: OtherCriterion) -> str:
        """Say which set is best by the job's criterion, and how far from the second."""
        each, key = self.evaluations, form.name
        ranked = sorted(each, key=lambda name: form.sign * each[name].also[key].value)
        best, *others = ranked
        judged = each[best].also[key].text(form.unit)
        first, second = (each[name].sample for name in (best, (others or ranked)[0]))
        if not others or first is None or second is None:
            return f"The {form.label} of {best} is {judged}"
        change = form.change(first, second)
        than = form.than(change, others[0])
        if not is_clear(change[1:]):
            return f"No clear difference: the {form.label} of {best} is {judged}, {than}"
        return f"{best} has the {form.most} {form.label}, {judged}: {than}"

    def _lowest(self) -> str:
        """Say which set has the lowest expected MSE, and how far below the second lowest."""
        each, form = self.evaluations, self.form
        if isinstance(form, OtherCriterion):
            return self._best(form)
        ranked = sorted(each, key=lambda name: each[name].expected_mse)
        if len(ranked) == 1:
            return f"Expected MSE of {ranked[0]}: {self._mse(ranked[0])}"
        best, other = ranked[:2]
        if not math.isfinite(each[other].expected_mse):
            return f"The expected MSE of {other} is not finite"
        gain = Gain.of_draws(each[best].mse, each[other].mse)
        value, interval = gain.of_means, gain.of_means_interval
        if not each[best].draws:
            value = 1 - each[best].expected_mse / each[other].expected_mse
            interval = value, value
        said = f"{change_of(value, interval)} than {other}"
        typical = self._typical(best, ":")
        if not each[best].criterion.is_mean:
            return f"{best} has the lowest {each[best].criterion.label}"
        if is_clear(interval):
            return f"{best} has the lowest expected MSE, {said}{typical}"
        return f"No clear difference: the expected MSE of {best} is {said}{typical}"

    def _mse(self, name: str) -> str:
        is_finite = math.isfinite(self.evaluations[name].expected_mse)
        return _text_of(self.evaluations[name]) if is_finite else "not finite"

    def _table(self, caption: str) -> Table:
        rows = [
            Row(label=name, measurements=len(each.measurement_times), **self._columns(name))
            for name, each in self.evaluations.items()
        ]
        for row in rows:
            row.draws = row.draws or "exact"
        heads = {"draws": "draws"} | {name: each.head for name, each in self.criteria.items()}
        heads |= {e.mse: e.head_of(is_limit=e in self.limits) for e in self.beside}
        last = (error.mse for error in self.beside)
        columns = ("label", "measurements", "expected_mse", *self.criteria, "draws", *last)
        return sets_table(caption, rows, columns, heads=heads)

    def _typical(self, name: str, mark: str) -> str:
        mse = self.evaluations[name].expected_mse
        if self.quantity is None or not math.isfinite(mse):
            return ""
        unit = self.quantity.unit_of_error
        return f"{mark} typical error {rounded(math.sqrt(mse), 3)} {unit}".rstrip()

    def _warnings(self) -> Iterator[str]:
        for name, evaluation in self.evaluations.items():
            these = f"the times of {name} break" if name else "these times break"
            for constraint in self.broken[name]:
                yield f"{these} a constraint: {constraint}"
            degenerate = evaluation.degenerate_text * (not evaluation.alarm)
            for text in filter(None, (degenerate, evaluation.few_lines)):
                yield f"{name}: " * bool(name) + text


def evaluated(
    job: str,
    *,
    times: Mapping[str, str],
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
    changes: Iterable[str] = (),
    profile: bool = False,
    also: Names | None = None,
) -> Evaluated:
    """Estimate the expected MSE of a set of measurement times, or of several.

    With filter.proposal = "auto", the folder of a run has the proposal of the run. A job file has
    the plain filter, unless many draws are asked for. A fifth of the draws also gives the error of
    an analysis afterwards, with all measurements (if the job asks for this, of the moment).

    Parameters
    ----------
    job : str
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    times : mapping of str to str
        Measurement times, as 0:60:3 or 0,6,12, on the job's clock; or regular, its regular times.
        Several sets have names, as in --times mine=0,6,12 --times regular, and share draws.
    draws : int, optional
        Number of draws; by default evaluation.draws of the job.
    particles : int, optional
        Number of particles; by default filter.particles of the job.
    seed : int, optional
        Seed of the noise; by default that of the job.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    profile : bool
        Also estimate the expected error at each instant.
    also : str or list of str, optional
        Other criteria by which the sets are judged, too, as ``worst_instant,"quantile 0.9"``.
    """
    loaded = load_job(job, changes)
    written = times[UNNAMED] if list(times) == [UNNAMED] else times
    built, compute = prepare_evaluation(
        loaded, written, draws, particles, seed, profile=profile, also=also
    )
    start = time.perf_counter()  # after the compilation
    evaluations = compute()
    seconds = time.perf_counter() - start
    errors = shown_beside(built.evaluator)
    beside = {each: compute(beside=each) for each in errors}
    broken = {
        name: loaded.problem.broken(evaluation.measurement_times)
        for name, evaluation in evaluations.items()
    }
    scenarios = loaded.scenarios.of_draws if loaded.scenarios else ()
    about = loaded.problem, broken, [each.parameters for each in scenarios]
    judged_by = built.job.criterion, built.job.other_criteria
    limits = [each for each in errors if is_limit(built.evaluator, each)]
    return Evaluated(
        evaluations, beside, *about, seconds, _quantity(built), limits, *judged_by,
        taken=built.taken,
    )  # fmt: skip


def _text_of(evaluation: Evaluation) -> str:
    return evaluation.estimate.text + " (exact)" * (not evaluation.draws)


def _quantity(built: Built) -> Component | None:
    """The only component of z, if errors are its squared differences, not scaled.

    Its typical error is the root of the expected MSE.
    """
    evaluator, quantities = built.evaluator, built.evaluator.model.named("z")
    is_squared = evaluator.model.error is squared_error and not any(evaluator.model.is_angle)
    is_scaled = any(each.scale != 1.0 for each in evaluator.scenarios)
    is_plain = is_squared and not is_scaled and built.job.criterion.mse_criterion.is_mean
    return quantities[0] if is_plain and len(quantities) == 1 else None


def _of_scenarios(
    evaluations: Mapping[str, Evaluation], parameters: Sequence[Mapping[str, Any]]
) -> list[Table]:
    """The expected MSE of each set in each scenario that has a draw."""
    if not all(evaluation.of_scenarios for evaluation in evaluations.values()):
        return []
    columns = {name or "expected MSE": each.of_scenarios for name, each in evaluations.items()}
    rows = [
        [
            Cell(parameters_text(parameters[number])),
            *(
                mse_cell(each[number].expected_mse, each[number].standard_error)
                for each in columns.values()
            ),
        ]
        for number in sorted(next(iter(columns.values())))
    ]
    return [Table("Expected MSE ± standard error in each scenario", ("scenario", *columns), rows)]


def _columns_of(evaluation: Evaluation) -> dict[str, Any]:
    """The error over time as JSON, if it was asked for."""
    profile = evaluation.profile
    if profile is None:
        return {}
    shown = [each for each in (*_OF_INSTANT, *_OVER_TIME) if each in profile]
    return {"profile": profile[shown].to_dict("list")}


def _over_time(evaluations: Mapping[str, Evaluation]) -> list[Table]:
    """The expected error of each set at each instant, if it was asked for."""
    profiles = {name: each.profile for name, each in evaluations.items()}
    tables = {name or "expected error": each for name, each in profiles.items() if each is not None}
    if not tables:
        return []
    first = next(iter(tables.values()))
    time = "date" if "date" in first else "t"
    unit, weights = first.attrs.get("time_unit", ""), first["weight"]
    columns = [
        [mse_cell(*at) for at in each[[*_OVER_TIME]].itertuples(index=False)]
        for each in tables.values()
    ]
    head, caption = [*tables], "Expected error at each instant ± standard error"
    if (weights != 1.0).any():
        columns.insert(0, [Cell(rounded(weight, 3), weight) for weight in weights])
        head.insert(0, "weight")
        caption += "; their weighted mean is the expected MSE"
    rows = [
        [Cell(unrounded(at), t), *cells]
        for at, t, *cells in zip(first[time], first["t"], *columns, strict=True)
    ]
    head.insert(0, f"t [{unit}]" if unit and time == "t" else time)
    return [Table(caption, head, rows)]
