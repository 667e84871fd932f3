"""One start of the program: what all phases of a run need."""

import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pfdist.pools.base import Pool
from pfdist.runner.build import Built
from pfdist.runner.claims import ALONE, Claims
from pfdist.runner.collect import Collector
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Reporter, Show
from pfdist.store import Store


@dataclass(frozen=True)
class Session:
    """One start of the program on a run.

    Parameters
    ----------
    built : Built
    collector : Collector
    reporter : Reporter
    say : callable
        Receives lines for the user.
    """

    built: Built
    collector: Collector
    reporter: Reporter
    say: Callable[[str], Any]

    @classmethod
    def start(
        cls,
        built: Built,
        store: Store,
        pool: Pool,
        show: Show = lambda progress: None,
        say: Callable[[str], Any] = lambda line: None,
        claims: Claims = ALONE,
    ) -> "Session":
        """Start with a store and a pool that the caller has entered; nothing is computed yet."""
        pace = Pace(built.evaluator.seconds_a_step, pool.workers, is_shared=claims is not ALONE)
        failures, resumed = built.job.execution.failures, store.has("draws")
        collector = Collector(store, pool, _name(), pace, failures, resumed, claims)
        return cls(built, collector, Reporter(show), say)

    @property
    def store(self) -> Store:
        """The store of the run."""
        return self.collector.store


def _name() -> str:
    """A name for a start of the program; names sort in the order of the starts."""
    return f"{int(time.time()):08x}{uuid.uuid4().hex[:4]}"
