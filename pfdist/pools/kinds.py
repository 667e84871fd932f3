"""The pools that a job can name.

A declaration names the pool's class as text, and the class is imported when a pool is made. So
listing the pools does not import Ray.
"""

import os
import pkgutil
import sys
from dataclasses import dataclass

from pfdist.pools.base import Pool


@dataclass(frozen=True)
class PoolKind:
    """A pool that a job can name."""

    title: str  # begins a sentence about a pool: "Serial pool"
    description: str  # where the tasks are computed, as a phrase for help
    factory: str  # ``module:object``, which gives a `Pool` when it is called with its settings
    # ``workers`` if a pool can have several workers, ``address`` if it can join a cluster
    takes: tuple[str, ...] = ()
    # Whether a formula that crashes ends only a worker. If not, it ends the process of the driver.
    isolated: bool = False

    def make(self, **settings: int | str) -> Pool:
        """The pool, which starts when it is entered. Settings that it does not take are ignored.

        With 0 workers, the pool chooses their number.
        """
        taken = {name: settings[name] for name in self.takes if name in settings}
        pool: Pool = pkgutil.resolve_name(self.factory)(**taken)
        return pool


AUTO = "auto"  # one of the pools, by what a job needs
POOLS = {
    "ray": PoolKind(
        "Ray",
        "on Ray workers",
        "pfdist.pools.ray_pool:RayPool",
        takes=("workers", "address"),
        isolated=True,
    ),
    "processes": PoolKind(
        "Process pool",
        "in processes on this machine",
        "pfdist.pools.processes:ProcessPool",
        takes=("workers",),
        isolated=True,
    ),
    "serial": PoolKind("Serial pool", "in this process", "pfdist.pools.base:SerialPool"),
    "threads": PoolKind(
        "Thread pool",
        "on threads of this process",
        "pfdist.pools.threads:ThreadPool",
        takes=("workers",),
    ),
}


def cluster_at_hand(address: str) -> str:
    """A phrase that says why a cluster is available; empty if none is.

    Parameters
    ----------
    address : str
        The address in the job.
    """
    if address:
        return "an address is given"
    if os.environ.get("RAY_ADDRESS"):
        return "RAY_ADDRESS is set"
    ray = sys.modules.get("ray")  # importing Ray takes a second
    return "this process has joined a cluster" if ray and ray.is_initialized() else ""
