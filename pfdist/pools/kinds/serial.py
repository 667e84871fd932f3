"""The pool ``serial``: one worker, the process of the driver."""

from pfdist.pools.kinds import POOLS, PoolKind

POOLS.declare("serial", PoolKind("Serial pool", "in this process", "pfdist.pools.base:SerialPool"))
