"""The pool ``ray``: workers on this machine or on a Ray cluster."""

from pfdist.pools.kinds import POOLS, PoolKind

POOLS.declare(
    "ray",
    PoolKind(
        "Ray",
        "on Ray workers",
        "pfdist.pools.ray_pool:RayPool",
        takes=("workers", "address", "threaded"),
        isolated=True,
    ),
)
