"""Tables of the comparison's first draws, which are filtered once more for figures and summary."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.component_names import Component
from pfdist.common.streams import stream_of
from pfdist.filters.work import Estimation, Result, Work, with_truth
from pfdist.kernels.estimators import FILTER_NOISE
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.base import within_half_turn
from pfdist.runner.build import Built
from pfdist.runner.door import Batch, Session
from pfdist.runner.row_formats import RowsByDraw
from pfdist.store import (
    Store,
    distance_schema,
    schema,
    trajectories_schema,
    variance_schema,
)

TRAJECTORIES = 100  # draws whose z, y and estimates are stored
REPEATED = 2000  # draws that the reference filters twice
LOSS_DRAWS = 1000  # draws on which the loss by a finite number of particles is estimated


@dataclass(frozen=True)
class FirstDraws:
    """A table of the comparison's first draws."""

    table: str
    schema: pa.Schema
    work: Work  # on draws 0, 1, ...
    columns: Callable[[Work, Result], dict[str, Any]]  # of the table, from a work and its result

    def rows(self, piece: Work, result: Result) -> pa.Table:
        """Rows of the table for the draws of a piece."""
        return pa.table(self.columns(piece, result), schema=self.schema)

    def fill(self, phase: str, session: Session) -> Generator[Batch, None, None]:
        """Compute the table, and publish it."""
        rows = RowsByDraw(self.table, self.rows)
        yield Batch(session, phase, [self.work], rows, more_follows=True)
        session.later(partial(self._publish, phase, session.store))

    def _publish(self, phase: str, store: Store) -> None:
        if store.has_parts(self.table, phase):
            committed = store.read(self.table)
            own = store.own_schema(self.schema)
            rows = pa.Table.from_pandas(committed, schema=own, preserve_index=False)
            store.publish(self.table, phase, [rows])


def trajectories(built: Built, work: Work) -> FirstDraws:
    """Truth, measurements and estimates of the first draws, which the figures show."""
    model = built.evaluator.model
    draws = min(TRAJECTORIES, built.job.comparison.draws)
    return FirstDraws(
        "trajectories",
        trajectories_schema(list(work.ids), model.named("z"), model.named("y")),
        replace(work, draws=(0, draws), trajectories=True),
        partial(_trajectory_columns, model),
    )


def repeated(built: Built, work: Work) -> FirstDraws:
    """MSE of the reference on the first draws under other filter noise.

    It shows how much the noise of the filters alone changes a relative gain.
    """
    job = built.job
    stream = stream_of("comparison", job.seed, "filter", job.comparison.reference_name, "again")
    again = replace(
        work,
        measurement_times=work.measurement_times[:1],
        ends=work.ends[:1],
        filter_streams=(stream,),
        ids=work.ids[:1],
        draws=(0, min(REPEATED, job.comparison.draws)),
    )
    return FirstDraws("repeated", schema("repeated"), again, _repeated_columns)


def distances(built: Built, work: Work) -> FirstDraws | None:
    """Half the squared distance of two filters with each set; see `pfdist.analysis.particle_loss`.

    None unless the error is the squared norm and the engine has particles.
    """
    estimation = replace(work.estimation, estimator=FILTER_NOISE.name)
    schema = distance_schema(work.ids)
    return _by_set("filter_distance", schema, built, work, estimation, knows_truth=False)


def variances(built: Built, work: Work) -> FirstDraws | None:
    """Variance of particles beside the truth, with each set and without any measurement.

    None in the same cases as `distances`, and if the filter is not told the scenario of a draw: the
    difference of both filters would be no loss by particles.
    """
    if built.evaluator.scenarios and not built.evaluator.told:
        return None
    estimation, schema = with_truth(work.estimation.particles), variance_schema(work.ids)
    work = replace(work, measurement_times=(*work.measurement_times, ()))
    return _by_set("filter_variance", schema, built, work, estimation, knows_truth=True)


def _by_set(
    table: str,
    schema: pa.Schema,
    built: Built,
    work: Work,
    estimation: Estimation,
    *,
    knows_truth: bool,
) -> FirstDraws | None:
    if built.evaluator.exact or built.evaluator.model.error is not squared_error:
        return None
    evaluator = built.evaluator.truth if knows_truth else built.evaluator
    evaluator.compile(estimation)  # before the first task, whose time is limited
    stream, sets = (
        stream_of("comparison", built.job.seed, "filter", table),
        len(work.measurement_times),
    )
    of_sets = replace(
        work,
        ends=work.ends[:1] * sets,
        filter_streams=(stream,) * sets,  # sets share the noise, and so their common prefixes
        draws=(0, min(LOSS_DRAWS, built.job.comparison.draws)),
        estimation=estimation,
        knows_truth=knows_truth,
    )
    return FirstDraws(table, schema, of_sets, partial(_columns_by_set, schema))


TABLES = {
    "trajectories": trajectories,
    "repeated": repeated,
    "filter_distance": distances,
    "filter_variance": variances,
}
"""Functions that make each table, or None, from the built job and the comparison's work."""


def _columns_by_set(schema: pa.Schema, piece: Work, result: Result) -> dict[str, Any]:
    columns = (pa.array(mse, from_pandas=True) for mse in result.mse.T)
    return dict(zip(schema.names, (np.arange(*piece.draws), *columns), strict=True))


def _repeated_columns(piece: Work, result: Result) -> dict[str, Any]:
    mse = pa.array(result.mse[:, 0], from_pandas=True)
    return {"draw": np.arange(*piece.draws), "mse": mse}


def _trajectory_columns(model: StateSpaceModel, piece: Work, result: Result) -> dict[str, Any]:
    first, last = piece.draws
    instants = result.z.shape[1]
    columns: dict[str, Any] = {
        "draw": np.repeat(np.arange(first, last), instants),
        "t": np.tile(np.arange(instants, dtype=np.int32), last - first),
    }
    z, y = model.named("z"), model.named("y")
    columns |= _by_component("z", z, result.z) | _by_component("y", y, result.y)
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
