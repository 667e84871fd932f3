"""The pool ``ray``: workers on this machine or on a Ray cluster."""

import os
import sys

from pfdist.pools.kinds import POOLS, PoolKind

POOLS.declare(
    "ray",
    PoolKind(
        "Ray",
        "on Ray workers",
        "pfdist.pools.ray_pool:RayPool",
        takes=("workers", "address", "wait_for_cores", "threaded"),
        isolated=True,
    ),
)


def cluster_at_hand(address: str) -> str:
    """Why a cluster is at hand, as a phrase; empty if there is none.

    Parameters
    ----------
    address : str
        That of the job.
    """
    if address:
        return "an address is given"
    if os.environ.get("RAY_ADDRESS"):
        return "RAY_ADDRESS is set"
    ray = sys.modules.get("ray")  # importing Ray takes a second
    return "this process has joined a cluster" if ray and ray.is_initialized() else ""
