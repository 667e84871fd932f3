"""From a job to its results: build the objects, drive the searches, compare.

The driver knows no Ray: it hands tasks to a pool and takes outcomes in any order. ``import ray``
stands in `pfdist.pools.ray_cluster` and `pfdist.pools.ray_rehearsal` alone.
"""
