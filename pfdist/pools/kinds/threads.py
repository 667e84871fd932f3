"""The pool ``threads``: a thread for each core, in the process of the driver."""

from pfdist.pools.kinds import POOLS, PoolKind

POOLS.declare(
    "threads",
    PoolKind(
        "Thread pool",
        "on threads of this process",
        "pfdist.pools.threads:ThreadPool",
        takes=("workers",),
    ),
)
