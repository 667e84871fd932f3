"""Pools: they apply functions to works, here, on threads, in other processes or on Ray.

A pool knows nothing of models, searches or files. Only the modules whose names begin
with ``ray_`` know Ray.
"""
