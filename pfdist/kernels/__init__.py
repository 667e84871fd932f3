"""The pieces the simulation and the filter are fused from: noise, resampling, components.

Here only NumPy and Numba. Nothing here knows a model; everything here runs compiled, a value
at a time, and (its ``register_jitable`` part) as it stands on NumPy arrays.
"""
