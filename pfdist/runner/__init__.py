"""From a job to its results: build the objects, drive the searches, compare.

The driver knows no Ray: it hands tasks to a pool and takes outcomes in any order. ``import ray``
stands in `pfdist.runner.ray_cluster` and `pfdist.runner.ray_rehearsal` alone.
"""
