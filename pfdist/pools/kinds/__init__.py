"""The pools that a job can name. Each is declared in one file.

A declaration names the pool's class as text, and the class is imported when a pool is made. So to
list the pools imports no Ray.
"""

import pkgutil
from dataclasses import dataclass

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
        ``module:object``. The object is called with the settings that it takes, and gives a `Pool`.
    takes : tuple of str
        ``workers`` if a pool can have several workers, ``address`` if it can join a cluster,
        ``threaded`` if its workers can be processes with threads, or processes without.
    isolated : bool
        Whether a formula that crashes ends a worker only. If not, it ends the process of the
        driver.
    """

    title: str
    description: str
    factory: str
    takes: tuple[str, ...] = ()
    isolated: bool = False

    def make(self, workers: int = 0, address: str = "", threaded: bool = True) -> Pool:
        """Make a pool; it starts when it is entered.

        Parameters
        ----------
        workers : int
            Number of workers; 0 leaves the number to the pool.
        address : str
            Address of a cluster to join; empty for none.
        threaded : bool
            Whether tasks release Python's lock, so that threads of a process do them together.
        """
        settings = {"workers": workers, "address": address, "threaded": threaded}
        taken = {name: settings[name] for name in self.takes}
        pool: Pool = pkgutil.resolve_name(self.factory)(**taken)
        return pool


POOLS: Registry[PoolKind] = Registry(__name__)
