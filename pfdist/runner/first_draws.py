"""Tables of the comparison's first draws, which are filtered once more for figures and summary."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.component_names import Component
from pfdist.evaluation.estimate import REPORT
from pfdist.evaluation.work import Result, Work, cut
from pfdist.models import StateSpaceModel
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.store import Store, schema, trajectories_schema

TRAJECTORIES = 100  # draws whose z, y and estimates are kept
REPEATED = 2000  # draws that the reference filters twice


@dataclass(frozen=True)
class FirstDraws:
    """A table of the comparison's first draws.

    Parameters
    ----------
    table : str
    schema : pyarrow.Schema
    work : Work
        The work on draws 0, 1, ...
    columns : callable
        Gives the columns of the table from a work and its result.
    """

    table: str
    schema: pa.Schema
    work: Work
    columns: Callable[[Work, Result], dict[str, Any]]

    def rows(self, piece: Work, result: Result) -> pa.Table:
        """Rows of the table for the draws of a piece."""
        return pa.table(self.columns(piece, result), schema=self.schema)

    def fill(self, phase: str, collector: Collector) -> None:
        """Compute the draws that the table lacks, and publish the table."""
        draws, store = self.work.draws[1], collector.store
        missing = np.setdiff1d(np.arange(draws), np.flatnonzero(store.present(self.table, "draw")))
        works = [replace(self.work, draws=lacking) for lacking in cut(missing, draws)]
        run = collector.run(phase, self.table, works, self.rows, more_follows=True)
        with closing(run) as pieces:
            for _ in pieces:
                pass
        collector.later(partial(self._publish, phase, store))

    def _publish(self, phase: str, store: Store) -> None:
        if store.has_parts(self.table, phase):
            kept = store.read(self.table)
            own = store.own_schema(self.schema)
            rows = pa.Table.from_pandas(kept, schema=own, preserve_index=False)
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

    It shows what the filters' noise alone does to a relative gain.
    """
    job = built.job
    stream = REPORT.stream(job.seed, "filter", job.comparison.reference_name, "again")
    again = replace(
        work,
        measurement_times=work.measurement_times[:1],
        ends=work.ends[:1],
        filter_streams=(stream,),
        ids=work.ids[:1],
        draws=(0, min(REPEATED, job.comparison.draws)),
    )
    return FirstDraws("repeated", schema("repeated"), again, _repeated_columns)


TABLES = {"trajectories": trajectories, "repeated": repeated}
"""Makes each table from the built job and the work of the whole comparison."""


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
