"""Pools: they apply one function to many tasks, in this process or on Ray workers.

A pool knows nothing of models, searches or files. Only `pfdist.pools.ray_cluster`,
`pfdist.pools.ray_rehearsal` and `pfdist.pools.ray_pool` know Ray.
"""
