"""The pools that a job can name. Each is declared in one file.

A declaration names the pool's class as text, and the class is imported when a pool is made. So to
list the pools imports no Ray.
"""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pfdist.common.registry import Registry
from pfdist.pools.base import Pool


@dataclass(frozen=True)
class PoolKind:
    """A pool that a job can name.

    Parameters
    ----------
    title : str
        Begins a sentence about a pool: "Serial pool".
    description : str
        Where the tasks are computed, as a phrase for help.
    factory : str
        ``module:object``. The object is called with `make`'s arguments, and gives a `Pool`.
    distributed : bool
        Whether a pool can have several workers, or join a cluster. If not, the factory is called
        with ``make_function`` alone.
    """

    title: str
    description: str
    factory: str
    distributed: bool = False

    def make(
        self,
        make_function: Callable[[], Callable[[Any], Any]],
        workers: int = 0,
        address: str = "",
    ) -> Pool:
        """Make a pool; it starts when it is entered.

        Parameters
        ----------
        make_function : callable
            Makes, in each worker, the function that is applied to each task's work.
        workers : int
            Number of workers; 0 leaves the number to the pool.
        address : str
            Address of a cluster to join; empty for none.
        """
        settings = (workers, address) if self.distributed else ()
        pool: Pool = pkgutil.resolve_name(self.factory)(make_function, *settings)
        return pool


POOLS: Registry[PoolKind] = Registry(__name__)
