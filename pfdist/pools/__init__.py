"""Pools: they apply one function to many tasks, in this process or on Ray workers.

A pool knows nothing of models, searches or files. Only the modules whose names begin
with ``ray_`` know Ray.
"""
