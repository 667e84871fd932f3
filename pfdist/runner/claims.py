"""Evaluations that several runs share: the run that claims an evaluation first computes it.

The other runs wait until it is committed there, and take its rows. A run computes what it has
claimed before it waits for others, so no two runs wait for each other. An evaluation that a run has
committed in an earlier start of the program is claimed for that run from the beginning.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from pfdist.store import Store


class Wanted(NamedTuple):
    """An evaluation that a run wants.

    Parameters
    ----------
    name : str
        Runs that want it by the same name share it.
    id : str
        Id of the evaluation in the tables.
    rows : int
        Number of rows.
    """

    name: str
    id: str
    rows: int


class Claims:
    """The claims of a run that shares no evaluation."""

    def claim(self, evaluations: Iterable[Wanted]) -> list[Wanted]:
        """Claim evaluations, and give those that another run has claimed or committed before."""
        return []

    def settle(self, evaluations: Iterable[Wanted]) -> None:
        """Say that claimed evaluations are committed."""

    def stores_of(self, evaluations: Iterable[Wanted]) -> dict[Wanted, Store]:
        """Wait until other runs have committed evaluations, or have ended; give their stores."""
        return {}


ALONE = Claims()


@dataclass
class _Claim:
    """The claim of the run in a folder."""

    owner: Path
    settled: threading.Event = field(default_factory=threading.Event)


class SharedClaims:
    """The claims of runs that share their evaluations; each run has a thread of its own."""

    def __init__(self) -> None:
        self._claims: dict[str, _Claim] = {}
        self._committed: dict[str, tuple[Path, int]] = {}
        self._lock = threading.Lock()

    def remember(self, store: Store) -> None:
        """Let all runs take the evaluations that the run of a store has committed before.

        A run with damaged files is left out.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        if any(store.manifest.damages()):
            return
        for id_, rows in store.evaluations().items():
            _, most = self._committed.get(id_, (store.path, 0))
            if rows > most:
                self._committed[id_] = store.path, rows

    def claim(self, evaluation: Wanted, folder: Path) -> _Claim:
        """Give the claim of an evaluation; without a claim, the run in the folder claims it."""
        with self._lock:
            if evaluation.name not in self._claims:
                owner, rows = self._committed.get(evaluation.id, (folder, 0))
                is_there = owner != folder and rows >= evaluation.rows
                claim = self._claims[evaluation.name] = _Claim(owner if is_there else folder)
                if is_there:
                    claim.settled.set()
            return self._claims[evaluation.name]

    def claim_of(self, evaluation: Wanted) -> _Claim:
        """Give the claim of an evaluation that some run has claimed."""
        return self._claims[evaluation.name]

    def release(self, folder: Path) -> None:
        """Settle all claims of a run that has ended: whoever waits computes what is lacking."""
        with self._lock:
            own = [claim for claim in self._claims.values() if claim.owner == folder]
        for claim in own:
            claim.settled.set()


class ClaimsOfRun(Claims):
    """The claims of a run among those of others; a context manager, because each claim has an end.

    Parameters
    ----------
    shared : SharedClaims
    store : Store
        The store of the run.
    """

    def __init__(self, shared: SharedClaims, store: Store) -> None:
        self._shared, self._folder = shared, store.path
        self._readers: dict[Path, Store] = {}

    def __enter__(self) -> "ClaimsOfRun":
        return self

    def __exit__(self, *_: object) -> None:
        self._shared.release(self._folder)

    def claim(self, evaluations: Iterable[Wanted]) -> list[Wanted]:
        """As for `Claims`."""
        return [
            evaluation
            for evaluation in evaluations
            if self._shared.claim(evaluation, self._folder).owner != self._folder
        ]

    def settle(self, evaluations: Iterable[Wanted]) -> None:
        """As for `Claims`."""
        for evaluation in evaluations:
            claim = self._shared.claim_of(evaluation)
            if claim.owner == self._folder:
                claim.settled.set()

    def stores_of(self, evaluations: Iterable[Wanted]) -> dict[Wanted, Store]:
        """As for `Claims`."""
        claims = {evaluation: self._shared.claim_of(evaluation) for evaluation in evaluations}
        for claim in claims.values():
            claim.settled.wait()
        for owner in {claim.owner for claim in claims.values()}:
            if owner in self._readers:
                self._readers[owner].look_again()
            else:  # a reader belongs to one thread
                self._readers[owner] = Store(owner)
        return {evaluation: self._readers[claim.owner] for evaluation, claim in claims.items()}
