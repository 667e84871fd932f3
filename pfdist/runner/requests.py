"""Requests of evaluations, whose draws come from this session, the store, others or the pool."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.evaluation.work import Estimation, Work, cut
from pfdist.runner.claims import Wanted
from pfdist.runner.collect import Collector
from pfdist.runner.evaluation_rows import draw_rows
from pfdist.search import Candidate
from pfdist.store import Store

Evaluated = dict[str, NDArray[np.float64]]
"""Per-draw MSE by the evaluation's id."""


@dataclass(eq=False)
class Request:
    """An evaluation that is asked for, and the draws that are known of it.

    Parameters
    ----------
    phase : str
        Name of the phase that asks.
    id : str
        Hash of everything on which the per-draw MSE depends.
    candidate : Candidate
    end : int
        Last instant whose error counts.
    stream : int
        Key of draws and filter noise: their roles keep them apart.
    estimation : Estimation
    knows_truth : bool
        Whether the filter uses the true model.
    mse : array of float64, (D,)
        NaN for a draw that is not known yet.
    missing : array of bool, (D,)
    """

    phase: str
    id: str
    candidate: Candidate
    end: int
    stream: int
    estimation: Estimation
    knows_truth: bool
    mse: NDArray[np.float64]
    missing: NDArray[np.bool_]

    @property
    def wanted(self) -> Wanted:
        """The evaluation for several runs: the same set may be asked for more draws."""
        return Wanted(f"{self.id}:{self.mse.size}", self.id, self.mse.size)

    def learn(self, draws: Any, mse: Any) -> None:
        """Store the MSE of some draws."""
        self.mse[draws], self.missing[draws] = mse, False


def known(
    requests: list[Request], evaluated: Evaluated | None, collector: Collector
) -> Iterator[Request]:
    """Yield each request of a phase as soon as all its draws are known.

    Parameters
    ----------
    requests : list of Request
        Each id once.
    evaluated : dict of str to array, or None
        Per-draw MSE by the evaluation's id, of this session, where a set may be asked for again.
    collector : Collector

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    _recall(requests, evaluated, collector)
    wanted = {request.id: request for request in requests if request.missing.any()}
    yield from (request for request in requests if request.id not in wanted)
    theirs = set(collector.claims.claim(request.wanted for request in wanted.values()))
    own = [request for request in wanted.values() if request.wanted not in theirs]
    others = [request for request in wanted.values() if request.wanted in theirs]
    yield from _filtered(own, collector)
    if not theirs:
        return
    collector.flush()  # others may wait for what is claimed here
    stores = collector.claims.stores_of(theirs)
    for request in others:
        _take(request, stores[request.wanted], collector)
        if not request.missing.any():
            yield request
    yield from _filtered([each for each in others if each.missing.any()], collector)


def _filtered(requests: list[Request], collector: Collector) -> Iterator[Request]:
    """Filter the missing draws of requests, and yield each request when none is missing."""
    wanted = {request.id: request for request in requests}
    if not requests:
        return
    run = collector.run(requests[0].phase, "draws", _works(requests), draw_rows, more_follows=True)
    with closing(run) as pieces:
        for work, result in pieces:
            for id_, mse in work.by_id(result).items():
                request = wanted[id_]
                request.learn(slice(*work.draws), mse)
                if not request.missing.any():
                    yield request
    collector.later(partial(collector.claims.settle, [each.wanted for each in requests]))


def _take(request: Request, store: Store, collector: Collector) -> None:
    """Take the draws that another run has evaluated, and commit them here, too."""
    rows = store.per_draw([request.id])
    draws = rows["draw"].to_numpy()
    lacking = np.isin(draws, np.flatnonzero(request.missing))
    request.learn(draws[lacking], rows["mse"].to_numpy()[lacking])
    if lacking.any():
        collector.keep(request.phase, "draws", request.wanted.name, rows.filter(pa.array(lacking)))


def _recall(requests: list[Request], evaluated: Evaluated | None, collector: Collector) -> None:
    """Learn the draws that were evaluated before, in this session or in the store."""
    by_id = {request.id: request for request in requests}
    for id_ in by_id.keys() & (evaluated or {}).keys():
        before = (evaluated or {})[id_][: by_id[id_].mse.size]
        by_id[id_].learn(slice(before.size), before)
    lacking = [id_ for id_, request in by_id.items() if request.missing.any()]
    if collector.resumed and lacking:
        for id_, rows in collector.store.per_draw(lacking).to_pandas().groupby("evaluation"):
            request = by_id[str(id_)]
            wanted = rows[rows["draw"] < request.mse.size]
            request.learn(wanted["draw"], wanted["mse"])
    if evaluated is not None:
        for id_, request in by_id.items():
            if id_ not in evaluated or evaluated[id_].size < request.mse.size:
                evaluated[id_] = request.mse


def _works(requests: list[Request]) -> Iterator[Work]:
    """Works for the missing draws; sets that lack the same draws of a stream go together."""
    together: dict[Any, list[Request]] = defaultdict(list)
    for request in requests:
        together[request.stream, request.estimation, request.missing.tobytes()].append(request)
    for (stream, estimation, _), group in together.items():
        lacking = group[0].missing
        for draws in cut(np.flatnonzero(lacking), lacking.size):
            yield Work(
                measurement_times=tuple(request.candidate.measurement_times for request in group),
                ends=tuple(request.end for request in group),
                filter_streams=(stream,) * len(group),
                draws_stream=stream,
                draws=draws,
                estimation=estimation,
                ids=tuple(request.id for request in group),
                knows_truth=group[0].knows_truth,
            )
