"""Count what was computed and committed: together all that a run needs, and nothing twice."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pfdist.pools.base import Outcome, SerialPool
from pfdist.store import Store

SETS = 3  # that the small job compares
A_DRAW = 13 * 40  # particle-steps of one of its draws with one set


def count_draws(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count how many draws each task of the serial pool filters, from now on."""
    counted: list[int] = []
    do = SerialPool.run

    def counting(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        for outcome in do(self, tasks):
            draws = [(piece.draws, len(piece.measurement_times)) for piece in outcome.task.work]
            counted.append(sum((last - first) * sets for (first, last), sets in draws))
            yield outcome

    monkeypatch.setattr(SerialPool, "run", counting)
    return counted


def committed_draws(run: Path) -> int:
    """How many filtered draws a run of the small job holds, over all its tables and parts."""
    store = Store(run)
    searched = len(store.read("draws")) if store.has("draws") else 0
    compared = sum(
        sum(map(len, store.draws(table)))
        for table in ("trajectories", "other_estimate", "filter_distance", "filter_variance")
    )
    # A draw of the comparison counts if both its rows and its errors over time are there.
    rows, sums = (
        {draw for each in store.draws(table) for draw in each}
        for table in ("comparison", "range_sums")
    )
    compared += len(rows & sums)
    unmeasured = sum(map(len, store.draws("filter_variance")))
    return searched + SETS * compared + unmeasured
