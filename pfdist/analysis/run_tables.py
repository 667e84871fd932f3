"""The tables of a run as pandas DataFrames."""

from pathlib import Path

import pandas as pd

from pfdist.documents.notebook import Shown
from pfdist.store import Store, schema


class RunTables(Shown):
    """Reads the tables of a run.

    Parameters
    ----------
    path : Path
        The folder of the run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._store = Store(path)

    def evaluations(self) -> pd.DataFrame:
        """A row for each evaluation: phase, generation, individual, copies, times, expected MSE."""
        return self._store.read("evaluations")

    def draws(self) -> pd.DataFrame:
        """Per-draw MSE of every evaluation: evaluation, draw, mse."""
        return self._store.read("draws")

    def compared(self) -> pd.DataFrame:
        """A row for each compared set: name, measurement times, cost that its search believed."""
        return self._store.compared()

    def comparison(self, draws: int | None = None) -> pd.DataFrame:
        """A row for each draw: draw, and mse_<name> for every compared set.

        Parameters
        ----------
        draws : int, optional
            Read only so many first draws.
        """
        return self._store.read("comparison", draws)

    def repeated(self) -> pd.DataFrame:
        """A row for each of the first draws: the reference's MSE under other filter noise."""
        return self._store.read("repeated")

    def filter_distance(self) -> pd.DataFrame:
        """For each of the first draws: half the squared distance of two filters with each set."""
        return self._store.read("filter_distance")

    def filter_variance(self) -> pd.DataFrame:
        """For each of the first draws: the variance of particles beside the truth with each set."""
        return self._store.read("filter_variance")

    def online(self) -> pd.DataFrame:
        """A row for each of the first draws: times chosen one after another, and their MSE.

        Without such times the table is empty.
        """
        if not self.has("online"):
            return pd.DataFrame(columns=schema("online").names)
        return self._store.read("online")

    def trajectories(self) -> pd.DataFrame:
        """z, y and the estimate of every filter over time, for the comparison's first draws."""
        return self._store.read("trajectories")

    def timings(self) -> pd.DataFrame:
        """A row for each task: seconds, worker, node, failures."""
        return self._store.read("timings")

    def bounds(self) -> pd.DataFrame:
        """A row for each set and each proof of a lower bound: see the columns' descriptions."""
        return self._store.read("bound")

    def profile(self) -> pd.DataFrame:
        """A row for each set and instant: expected error, standard error, effective sample size.

        The table is of the last call of ``pfdist why``.
        """
        return self._store.read("profile")

    def worth(self) -> pd.DataFrame:
        """A row for each measurement of each set: the rise of the expected MSE without it.

        The table is of the last call of ``pfdist why``, as is that of `profile`.
        """
        return self._store.read("worth")

    def sampling_windows(self) -> pd.DataFrame:
        """A row for each measurement and instant to which it alone is moved, by ``pfdist why``."""
        return self._store.read("sampling_windows")

    def jitter(self) -> pd.DataFrame:
        """A row for each set and level: the loss of random times within the sampling windows."""
        return self._store.read("jitter")

    def has(self, table: str) -> bool:
        """Whether the run has rows of a table."""
        return self._store.has(table)
