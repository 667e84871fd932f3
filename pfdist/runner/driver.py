"""The driver of a run: searches, the comparison, then what plugins add; it uses no pool itself."""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import pyarrow as pa

from pfdist.common.measurement_times import Times
from pfdist.common.plugins import added
from pfdist.errors import ModelError, SearchError
from pfdist.filters.exact import exact_mse
from pfdist.filters.variants import of_error, shown_beside
from pfdist.results.stored_run import StoredRun
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import (
    COMPARISON,
    comparison_steps,
    run_comparison,
    tables_of_first_draws,
    ways_out,
)
from pfdist.runner.design import design_of
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.evenly_spaced import scan_steps
from pfdist.runner.information_prover import InformationProver
from pfdist.runner.later import later_of
from pfdist.runner.opponent import SHARE, best_evenly_spaced, opponent_steps
from pfdist.runner.parts import PARTS, Part
from pfdist.runner.phase import unpublished
from pfdist.runner.prover import Prover
from pfdist.runner.search_phase import is_too_long, run_search, search_steps
from pfdist.store import Store, schema

COMPARED = "search"


class QuickLook(NamedTuple):
    """Quick work of a plan beside its proof, by which its answer has a further sentence."""

    part: Part  # what it is for
    # the number of draws, and of particle-steps, for which so many particle-steps are allowed
    work: Callable[[Built, float], tuple[int, float]]
    # the driver for a run, with the particle-steps that are allowed
    look: Callable[[RunSession, StoredRun, float], Generator[WorkBatch, None, None]]


def looks() -> list[QuickLook]:
    """The quick work of all plugins."""
    return [*added("looks")]


def drive(session: RunSession) -> Generator[WorkBatch, None, None]:
    """Compute everything that a run still lacks, whether it is new or half finished.

    Raises `SearchError` if every final set of a search has an infinite error. Further errors are
    those of every driver; see `pfdist.runner.door`.
    """
    built, store, reporter = session.built, session.store, session.reporter
    reporter.foresee(foreseen_steps(built))
    try:
        # The table of compared sets is published last of all that searches write. If it is whole,
        # the searches need not be replayed.
        has = store.has("compared") and not store.has_parts("compared")
        if not has or unpublished(store, built.phases):
            sets = yield from _search(session)
        else:
            written, points = store.compared_sets(), built.job.problem.points
            sets = {name: points.read(times) for name, times in written.items()}
            reporter.note(done=_searching_steps(built))
        yield from run_comparison(session, sets)
        for work in later_of(built.job):
            yield from work.drive(session, sets)
    finally:  # also if the driver is closed early: rows that still wait are committed
        session.commit()
        with store.together():
            later = (work.phase for work in later_of(built.job))
            for phase in (*built.phases, COMPARISON, *later):
                store.settle("timings", phase)


def prover_of(built: Built, settings: BoundSettings) -> Prover:
    """The prover of the job's criterion; raises as `Prover`."""
    by_gains = built.job.criterion.bound == "submodular"
    return (InformationProver if by_gains else Prover)(built, settings)


def foreseen_steps(built: Built) -> float:
    """Approximate number of particle-steps of a whole run."""
    later = sum(work.steps(built) for work in later_of(built.job))
    return _searching_steps(built) + comparison_steps(built) + later


def foreseen_by_part(built: Built, prover: Prover | None = None) -> dict[Part, float]:
    """Approximate number of particle-steps of a run and of a proof, by what they are for."""
    foreseen: dict[Part, float] = dict.fromkeys(PARTS, 0.0)
    foreseen["search"] = _usual_steps(built)
    foreseen["opponent"] = opponent_steps(built)
    foreseen["comparison"] = comparison_steps(built)
    for table in tables_of_first_draws(built):
        foreseen[table.part] += table.steps
    for work in later_of(built.job):
        foreseen[work.part] += work.steps(built)
    if prover is not None:
        foreseen["proof"], foreseen["likelihood"] = prover.steps, prover.rank_steps
        foreseen["scan"] = scan_steps(built, SHARE * core_steps(built, prover))
        for look in looks():
            _, foreseen[look.part] = look.work(built, SHARE * core_steps(built, prover))
    return {part: steps for part, steps in foreseen.items() if steps}


def core_steps(built: Built, prover: Prover | None = None) -> float:
    """Particle-steps of search, comparison and proof, of which other parts have shares."""
    searched = sum(search_steps(built, search) for search in built.searches)
    return searched + comparison_steps(built) + (prover.steps if prover else 0)


def _usual_steps(built: Built) -> float:
    searched = sum(search_steps(built, search, usual=True) for search in built.searches)
    return searched + built.study.raced_steps(built)


def _searching_steps(built: Built) -> float:
    return opponent_steps(built) + _usual_steps(built)


def _search(session: RunSession) -> Generator[WorkBatch, None, dict[str, Times]]:
    """The sets that are compared, by name, after every search has ended."""
    built = session.built
    given = {**built.study.unsearched}
    tried = dict[str, int]()
    better = yield from built.study.raced(session, given, tried)
    for name in built.study.even if not better else ():
        found = yield from best_evenly_spaced(session, name)
        given[name], tried[name] = found.times, found.tried
        given = {found.best: given[found.best], **given}  # the best opponent is the reference
    rows: list[dict[str, Any]] = [
        {"name": name, "measurement_times": times, "tried": tried.get(name)}
        for name, times in given.items()
    ]
    rivals = _rivals(built, given)
    for search in built.searches:
        winners = better or (yield from run_search(session, search, rivals))
        rows += [
            {
                "name": name,
                "measurement_times": winner.measurement_times,
                "search_mse": winner.expected_mse,
                "search_standard_error": winner.standard_error,
            }
            for name, winner in winners.items()
        ]
    compared = {row["name"] for row in rows}
    for name in built.names:
        if name not in compared:
            raise SearchError(
                f"search {name}: every set of times that it ended with has an infinite error, by a "
                f"degenerate draw (a measurement no particle explains) or an infinite error: "
                f"{ways_out(built)}"
            )
    for position, row in enumerate(rows):
        row["position"] = position
    optional = ["tried"] if tried else []
    times = [row["measurement_times"] for row in rows]
    for column, (errors, part) in _exact_columns(built, times).items():
        if errors is not None:
            instants = len(times) * (built.evaluator.horizon + 1)
            session.count_exact(COMPARISON, part, instants)
            optional.append(column)
            for row, mse in zip(rows, errors.tolist(), strict=True):
                row[column] = mse
    table = pa.Table.from_pylist(rows, schema=schema("compared", *optional))
    # Written after the tables of the searches: it marks the searches as done.
    session.later(partial(_publish_compared, session.store, table))
    return {row["name"]: row["measurement_times"] for row in rows}


def _rivals(built: Built, given: Mapping[str, Times]) -> list[Times]:
    """The sets that race with a plan: the best opponent, and the linearized design if there is one.

    That takes about a twentieth of the plan's work at most.
    """
    opponent, rivals = next(iter(given.values())), list[Times]()
    polishes = any(each.is_polished and not is_too_long(built, each) for each in built.searches)
    if polishes and not built.job.amounts and not built.evaluator.exact:
        with suppress(ModelError):
            most = SHARE * core_steps(built)
            rivals.append(design_of(built.job, built.evaluator, [opponent], most))
    return [opponent, *rivals]


def _exact_columns(built: Built, sets: Sequence[Times]) -> dict[str, tuple[Any, Part]]:
    """Exact values of each set by column, with what they are for; None if they take draws."""
    evaluator, form = built.evaluator, built.job.criterion.mse_criterion
    columns: dict[str, tuple[Any, Part]] = {"exact_mse": (exact_mse(evaluator, sets), "comparison")}
    for each in shown_beside(evaluator):
        exact = exact_mse(of_error(evaluator, each.named), sets, criterion=form)
        columns[each.exact_column] = exact, "other estimate"
    for form in built.job.other_criteria.values():
        values = exact_mse(evaluator, sets, criterion=form) if form.aspects else None
        if values is not None:
            columns[form.aspects[0].exact_column] = form.sign * values, "statistics"
    return columns


def _publish_compared(store: Store, table: pa.Table) -> None:
    store.commit("compared", COMPARED, table)  # a part shows that publishing was cut short
    store.publish("compared", COMPARED, [table])
