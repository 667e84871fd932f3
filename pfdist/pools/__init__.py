"""Pools: they apply functions to works in this process, on threads, in other processes or on Ray.

A pool depends on no model, search or file. Only modules named ``ray_...`` import Ray.
"""
