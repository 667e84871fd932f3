"""Pools: they apply functions to works, in this process, on its threads or on Ray workers.

A pool knows nothing of models, searches or files. Only the modules whose names begin
with ``ray_`` know Ray.
"""
