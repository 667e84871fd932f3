"""Evaluations that several runs share: the run that claims an evaluation first computes it.

The other runs wait until it is committed there, and take its rows. A run computes what it has
claimed before it waits for others, so no two runs wait for each other.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass, field

from pfdist.store import Store


class Claims:
    """The claims of a run that shares no evaluation."""

    def claim(self, ids: Iterable[str]) -> list[str]:
        """Claim evaluations by their ids, and give the ids that another run has claimed before."""
        return []

    def settle(self, ids: Iterable[str]) -> None:
        """Say that claimed evaluations are committed."""

    def stores_of(self, ids: Iterable[str]) -> dict[str, Store]:
        """Wait until other runs have committed evaluations, or have ended; give their stores."""
        return {}


ALONE = Claims()


@dataclass
class _Claim:
    """A run's claim of an evaluation."""

    owner: "ClaimsOfRun"
    settled: threading.Event = field(default_factory=threading.Event)


class SharedClaims:
    """The claims of runs that share their evaluations; each run has a thread of its own."""

    def __init__(self) -> None:
        self.by_id: dict[str, _Claim] = {}
        self.lock = threading.Lock()


class ClaimsOfRun(Claims):
    """The claims of a run among those of others; a context manager, because each claim has an end.

    Parameters
    ----------
    shared : SharedClaims
    store : Store
        The store of the run.
    """

    def __init__(self, shared: SharedClaims, store: Store) -> None:
        self._shared, self._path = shared, store.path
        self._readers: dict[ClaimsOfRun, Store] = {}

    def __enter__(self) -> "ClaimsOfRun":
        return self

    def __exit__(self, *_: object) -> None:
        with self._shared.lock:
            own = [claim for claim in self._shared.by_id.values() if claim.owner is self]
        for claim in own:  # whoever waits computes what is lacking
            claim.settled.set()

    def claim(self, ids: Iterable[str]) -> list[str]:
        """As for `Claims`."""
        with self._shared.lock:
            claims = {id_: self._shared.by_id.setdefault(id_, _Claim(self)) for id_ in ids}
        return [id_ for id_, claim in claims.items() if claim.owner is not self]

    def settle(self, ids: Iterable[str]) -> None:
        """As for `Claims`."""
        for id_ in ids:
            if self._shared.by_id[id_].owner is self:
                self._shared.by_id[id_].settled.set()

    def stores_of(self, ids: Iterable[str]) -> dict[str, Store]:
        """As for `Claims`."""
        claims = {id_: self._shared.by_id[id_] for id_ in ids}
        for claim in claims.values():
            claim.settled.wait()
        for owner in {claim.owner for claim in claims.values()}:
            if owner in self._readers:
                self._readers[owner].look_again()
            else:  # a reader belongs to one thread
                self._readers[owner] = Store(owner._path)
        return {id_: self._readers[claim.owner] for id_, claim in claims.items()}
