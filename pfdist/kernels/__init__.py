"""The pieces the simulation and the filter are fused from: noise, resampling, components.

Here only NumPy and Numba, and nothing here knows a model. Noise and weights are written once and
run twice, compiled a value at a time and as they stand on NumPy arrays; all else that is compiled
has a plain twin, or NumPy's own function, to be held against.
"""
