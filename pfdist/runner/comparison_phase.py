"""The comparison: all sets on the same fresh draws, which no search has used.

Tasks end in any order. Interim gains use the whole blocks of draws before the first missing one. So
they do not depend on the order, and the comparison stops after the same draws in every run.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.component_names import Component
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times, validated
from pfdist.common.streams import stream_of
from pfdist.errors import SearchError, StoreError
from pfdist.filters.aspects import DISTANCE, VARIANCE, Aspect, ErrorBeside
from pfdist.filters.exact import exact_by_instant
from pfdist.filters.variants import for_work, shown_beside
from pfdist.filters.work import (
    FilterWork,
    Result,
    control_of,
    cut,
    ranges_of_draws,
)
from pfdist.models import StateSpaceModel
from pfdist.models.base import within_half_turn
from pfdist.models.sensed import known_values
from pfdist.problem.set_key import labels_of_sets, references_of
from pfdist.results import BLOCK, ComparisonStatistics
from pfdist.results.over_time import (
    RANGE_SUMS,
    Range,
    joined_ranges,
    longest_range,
    read_ranges,
)
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.parts import Part
from pfdist.runner.progress import SetGain
from pfdist.runner.row_formats import RowsByDraw
from pfdist.runner.search_phase import search_steps
from pfdist.store import (
    ROWS_IN_A_FILE,
    Store,
    comparison_schema,
    first_draws_schema,
    schema,
    trajectories_schema,
)

COMPARISON = "comparison"


def run_comparison(
    session: RunSession, sets: Mapping[str, Times]
) -> Generator[WorkBatch, None, None]:
    """Compare all sets on the same draws, the reference first, and publish the comparison."""
    built, reporter, job = session.built, session.reporter, session.built.job
    draws, study, control = job.comparison.draws, built.study, bool(job.comparison.control)
    work, start = _work(built, sets), reporter.progress.done
    names = list(sets)
    references, labels = references_of(names, job.identity()), labels_of_sets(names, job.identity())
    interim = InterimGains(labels, references, draws)
    shows_gains = len(study.references) == 1 and built.job.criterion.is_mean
    reporter.begin(COMPARISON)
    for table in tables_of_first_draws(built, work):
        yield from table.fill(COMPARISON, session)
    evaluator = built.evaluator
    kinds = {"with_control": control, "with_scenarios": bool(evaluator.scenarios)}
    schema = comparison_schema(list(sets), **kinds)
    if control:
        evaluator.compile(control_of(built.comparing))  # the time of tasks is limited

    def rows_of(piece: FilterWork, result: Result) -> pa.Table:
        # Committed before the rows of the draws: a kill in between leaves sums that are computed
        # again, never draws without sums.
        if piece.over_time:
            ranges = ranges_of_draws(*piece.draws, piece.over_time)
            sums = [
                Range(*each, errors) for each, errors in zip(ranges, result.errors, strict=True)
            ]
            session.keep_rows(COMPARISON, RANGE_SUMS, _range_rows(piece.ids, sums))
        columns = [pa.array(np.arange(*piece.draws))]
        columns += [pa.array(mse) for mse in piece.by_id(result).values()]
        columns += [pa.array(flags) for flags in piece.by_id(result, "degenerate").values()]
        if control:
            columns += [pa.array(values) for values in piece.by_id(result, "control").values()]
        scenarios = evaluator.scenarios_of(piece.draws_stream, range(*piece.draws))
        columns += [] if scenarios is None else [pa.array(scenarios.astype(np.int16))]
        return pa.Table.from_arrays(columns, schema=schema)

    def learn(piece: FilterWork, result: Result) -> None:
        errors = np.hstack([result.mse, result.control]) if control else result.mse
        interim.learn(range(*piece.draws), errors, result.degenerate)
        _check_filters(built, interim.statistics)
        found = interim.so_far if shows_gains else ()
        reporter.advance(piece.steps, len(result.mse), found=found)

    most = longest_range(draws) if study.has_details else 0
    errors = exact_by_instant(evaluator, work.measurement_times) if most else None
    if errors is not None:
        most = 0
        if not session.store.has(RANGE_SUMS):
            session.keep_rows(COMPARISON, RANGE_SUMS, _range_rows(work.ids, [Range(0, 0, errors)]))
    work = replace(work, controlled=control, over_time=most)
    works = [work.piece(draws_of_block) for draws_of_block in cut(range(draws), BLOCK)]
    # The batch commits its last rows before it ends, so publishing finds all draws. A kill while
    # the files are written leaves the parts, and the next start publishes them again.
    beside = (RANGE_SUMS,) if most else ()
    rows = RowsByDraw("comparison", rows_of, _result, beside=beside)
    yield WorkBatch(session, COMPARISON, works, rows, learn, part="comparison")
    reporter.reach(start + comparison_steps(built))
    _publish(session.store, draws, most)


def _check_filters(built: Built, statistics: ComparisonStatistics) -> None:
    """Raise `SearchError` if most draws are degenerate with a found set, and the job forbids it."""
    draws, is_allowed = statistics.draws, built.job.evaluation.degenerate_draws == "continue"
    for name, count in statistics.degenerate_draws.items():
        if count > draws / 2 and not (is_allowed or name in built.study.unsearched):
            raise SearchError(
                f"search {name}: there is no plan, because {count:,} of {draws:,} draws are "
                f"degenerate with its times (no particle explains a measurement): {ways_out(built)}"
            )


def ways_out(built: Built) -> str:
    """Advise what to do if filters fail in many draws, for the end of an error."""
    models = built.evaluator.model, built.evaluator.believed
    is_linear = all(model.linear_gaussian for model in models)
    exact = "filter.engine = 'kalman' is exact for this model; " * is_linear
    return (
        f"pfdist check-model looks for the cause; {exact}more filter.particles may help; "
        "evaluation.degenerate_draws = 'continue' lets filters leave such measurements out "
        f"({built.job.path})"
    )


def _range_rows(names: Sequence[str], ranges: Sequence[Range]) -> pa.Table:
    rows = [
        {"position": place, "name": name, "draw": first, "draws": draws, "sums": sums[place]}
        for place, name in enumerate(names)
        for first, draws, sums in ranges
    ]
    return pa.Table.from_pylist(rows, schema=schema(RANGE_SUMS))


def _result(rows: pa.Table) -> Result:
    names = rows.column_names
    mse, control, degenerate = (
        np.array([rows[name].to_numpy() for name in names if name.startswith(start)]).T
        for start in ("mse_", "control_", "degenerate_")
    )
    return Result(mse, degenerate=degenerate, control=control)


def comparison_steps(built: Built) -> int:
    """Particle-steps of the whole comparison."""
    job = built.job
    instants = len(built.names) * (job.problem.feasible.horizon + 1)
    steps = built.comparing.steps_an_instant
    if job.comparison.control:
        steps += control_of(built.comparing).steps_an_instant
    return job.comparison.draws * steps * instants


def _work(built: Built, sets: Mapping[str, Times]) -> FilterWork:
    """All sets on the same draws, each with separate filter noise; the draws are still open."""
    seed, purpose = built.job.seed, built.study.purpose
    last = built.job.problem.points.number - 1
    checked = [validated(times, last, name) for name, times in sets.items()]
    # The same times have the same noise, so their errors are equal.
    first = {times: name for name, times in reversed([*sets.items()])}
    streams = tuple(stream_of(purpose, seed, "filter", first[times]) for times in sets.values())
    return built.evaluator.work(
        checked,
        0,
        stream_of(purpose, seed, "draws"),
        (0, 0),
        built.comparing,
        filter_streams=streams,
        ids=tuple(sets),
    )


def _publish(store: Store, draws: int, most: int) -> None:
    """Publish the comparison from its parts, a file's rows at a time.

    The table ``range_sums`` gets ranges of at most `most` draws; 0 if it has none.
    """
    tables = "comparison", RANGE_SUMS
    if not any(store.has_parts(table, COMPARISON) for table in tables):
        return
    for table in tables if most else tables[:1]:
        committed = store.draws(table)
        if not committed or committed[0].start > 0 or committed[0].stop < draws:
            raise StoreError(
                f"{store.path} lacks draws that were committed; is another command writing to it? "
                "Run the same command again"
            )
    rows = ROWS_IN_A_FILE["comparison"]
    pieces: dict[str, Iterable[pa.Table]] = {"comparison": store.blocks("comparison", rows, draws)}
    if store.has(RANGE_SUMS):
        sums = store.rows(RANGE_SUMS)
        ranges = [each for each in read_ranges(sums) if each.end <= draws]
        names = list(dict.fromkeys(sums["name"].to_pylist()))  # rows are in order of the sets
        pieces[RANGE_SUMS] = [_range_rows(names, joined_ranges(ranges, most))]
    store.publish_together(COMPARISON, pieces)


class InterimGains:
    """Sums of a comparison's gains.

    The last block of `draws` may be shorter than the others. `labels` has all sets by name, and
    `references` the reference of each other set.
    """

    def __init__(
        self, labels: Mapping[str, str], references: Mapping[str, str], draws: int
    ) -> None:
        self.statistics = ComparisonStatistics([*labels], references=references)
        self._labels, self._draws = labels, draws
        # For each block of draws, their values, which come in any order; whether each is missing
        self._waiting: dict[int, tuple[NDArray[np.float64], NDArray[np.bool_]]] = {}
        self.so_far = tuple[SetGain, ...]()  # the gain of each set, from the whole blocks so far

    def learn(
        self, index: range, errors: NDArray[np.float64], degenerate: NDArray[np.bool_]
    ) -> None:
        """Add errors of draws, and then every whole block without a missing block before it.

        The arguments are those of `ComparisonStatistics.add`.
        """
        values = np.hstack([errors, degenerate])
        for number in range(index.start // BLOCK, (index.stop - 1) // BLOCK + 1):
            start = number * BLOCK
            if number not in self._waiting:
                size = min(BLOCK, self._draws - start)
                self._waiting[number] = np.empty((size, values.shape[1])), np.ones(size, np.bool_)
            first, last = max(index.start, start), min(index.stop, start + BLOCK)
            part = values[first - index.start : last - index.start]
            (mse, missing), places = self._waiting[number], slice(first - start, last - start)
            mse[places], missing[places] = part, False
        while (following := self._next()) is not None:
            sets = len(self.statistics.names)
            self.statistics.add(following[:, :-sets], following[:, -sets:])
            self.so_far = tuple(  # after each block, because outcomes come more often
                SetGain(self._labels[name], Estimate(gain.of_means, gain.errors.ratio_error))
                for name, gain in self.statistics.gains.items()
                if gain.relative.count
            )

    def _next(self) -> NDArray[np.float64] | None:
        number = self.statistics.draws // BLOCK
        if number in self._waiting and not self._waiting[number][1].any():
            return self._waiting.pop(number)[0]
        return None


TRAJECTORIES = 100  # draws whose z, y and estimates are stored
FEWER, _SHARE = 5, 0.1
"""At most one draw in so many gives an error beside the job's, and at most this share of steps."""
LOSS_DRAWS = 1000  # draws on which the loss by a finite number of particles is estimated


@dataclass(frozen=True)
class FirstDrawsTable:
    """A table of the comparison's first draws."""

    table: str
    schema: pa.Schema
    work: FilterWork  # on draws 0, 1, ...
    columns: Callable[
        [FilterWork, Result], dict[str, Any]
    ]  # of the table, from a work and its result
    part: Part = "statistics"

    @property
    def steps(self) -> int:
        """Particle-steps, if sets share no prefix."""
        work, (first, last) = self.work, self.work.draws
        instants = (sum(work.ends) + len(work.ends)) * (1 + work.controlled)
        return (last - first) * instants * work.estimation.steps_an_instant

    def rows(self, piece: FilterWork, result: Result) -> pa.Table:
        """Rows of the table for the draws of a piece."""
        return pa.table(self.columns(piece, result), schema=self.schema)

    def fill(self, phase: str, session: RunSession) -> Generator[WorkBatch, None, None]:
        """Compute the table, and publish it."""
        rows = RowsByDraw(self.table, self.rows)
        # Before the first task, whose time is limited.
        for_work(session.built.evaluator, self.work).compile(self.work.estimation)
        yield WorkBatch(session, phase, [self.work], rows, more_follows=True, part=self.part)
        session.later(partial(self._publish, phase, session.store))

    def _publish(self, phase: str, store: Store) -> None:
        if store.has_parts(self.table, phase):
            store.publish_frame(self.table, phase, store.read(self.table), self.schema)


def tables_of_first_draws(built: Built, work: FilterWork | None = None) -> list[FirstDrawsTable]:
    """All tables of first draws beside a comparison; by default that of sets still to be found."""
    work = work or _work(built, dict.fromkeys(built.names, built.job.problem.feasible.regular()))
    evaluator, has_details = built.evaluator, built.study.has_details
    tables = [trajectories(built, work)] * has_details
    for each in shown_beside(evaluator) if has_details and not evaluator.exact else ():
        tables += beside(built, work, each)
    wanted = [each.aspects for each in built.job.other_criteria.values() if not evaluator.exact]
    aspects = [aspect for of_criterion in wanted for aspect in of_criterion]
    if evaluator.has_particle_loss:
        aspects.append(DISTANCE)
        # Without the scenario of a draw the difference of both filters is not a particle loss.
        aspects += [VARIANCE] * (evaluator.knows_scenario or not evaluator.scenarios)
    return [*tables, *(of_aspect(built, work, aspect) for aspect in aspects)]


def trajectories(built: Built, work: FilterWork) -> FirstDrawsTable:
    """Truth, measurements and estimates of the first draws, which the figures show."""
    model = built.evaluator.model
    draws = min(TRAJECTORIES, built.job.comparison.draws)
    return FirstDrawsTable(
        "trajectories",
        trajectories_schema(list(work.ids), model.named("z"), model.named("y")),
        replace(work, draws=(0, draws), trajectories=True),
        partial(_trajectory_columns, model),
    )


def beside(built: Built, work: FilterWork, error: ErrorBeside) -> list[FirstDrawsTable]:
    """An error beside the job's, of the same noise; none if its share is less than a draw."""
    steps = comparison_steps(built) + sum(search_steps(built, each) for each in built.searches)
    of_a_draw = _table_of(error, error.beside(built.evaluator, work, 1), part="other estimate")
    draws = min(built.job.comparison.draws // FEWER, int(_SHARE * steps // of_a_draw.steps))
    return [replace(of_a_draw, work=of_a_draw.work.piece((0, draws)))] if draws else []


def of_aspect(built: Built, work: FilterWork, aspect: Aspect) -> FirstDrawsTable:
    """An aspect of the sets on the first draws; all sets share the noise of its filters."""
    draws = built.job.comparison.draws
    first = draws if aspect.of_all_draws else min(LOSS_DRAWS, draws)
    sets = work.measurement_times + ((),) * aspect.has_unmeasured
    stream = stream_of("comparison", built.job.seed, "filter", aspect.table)
    of_sets = replace(
        aspect.work(work, first),
        measurement_times=sets,
        ends=work.ends[:1] * len(sets),
        filter_streams=(stream,) * len(sets),  # so they share common prefixes, too
    )
    return _table_of(aspect, of_sets)


def _table_of(aspect: Aspect, work: FilterWork, part: Part = "statistics") -> FirstDrawsTable:
    rows = schema_of_aspect(aspect, work.ids)
    columns = partial(_columns_by_set, rows, aspect.values)
    return FirstDrawsTable(aspect.table, rows, work, columns, part)


def schema_of_aspect(aspect: Aspect, names: Sequence[str]) -> pa.Schema:
    """Schema of the draws of an aspect: a row for each draw, a column for each set."""
    return first_draws_schema(
        aspect.table, aspect.named, aspect.description, names,
        unit=aspect.unit, has_unmeasured=aspect.has_unmeasured,
    )  # fmt: skip


def _columns_by_set(
    schema: pa.Schema, values_of: Callable[..., Any], piece: FilterWork, result: Result
) -> dict[str, Any]:
    """The values of each set from its errors and their controls."""
    columns = (pa.array(each, from_pandas=True) for each in values_of(result.mse, result.control).T)
    return dict(zip(schema.names, (np.arange(*piece.draws), *columns), strict=True))


def _trajectory_columns(
    model: StateSpaceModel, piece: FilterWork, result: Result
) -> dict[str, Any]:
    first, last = piece.draws
    instants = result.z.shape[1]
    columns: dict[str, Any] = {
        "draw": np.repeat(np.arange(first, last), instants),
        "t": np.tile(np.arange(instants, dtype=np.int32), last - first),
    }
    z, y = model.named("z"), model.named("y")
    columns |= _by_component("z", z, result.z) | _by_component("y", y, known_values(result.y))
    for name, estimate in zip(piece.ids, result.estimates, strict=True):
        estimate = within_half_turn(estimate, result.z, model.is_angle)  # noqa: PLW2901
        columns |= _by_component(f"estimate_{name}", z, estimate)
    return columns


def _by_component(
    name: str, components: Sequence[Component], values: NDArray[np.float64]
) -> dict[str, pa.Array]:
    """A column for each component of (D, T+1, components), draw after draw; NaN becomes null."""
    return {
        f"{name}_{component.suffix}": pa.array(values[:, :, k].ravel(), from_pandas=True)
        for k, component in enumerate(components)
    }
