"""The Monte Carlo estimate of the expected MSE of a set of measurement times.

Pure functions and frozen data: what is to be computed (work), computing it (problem), and the
expected MSE that follows (estimate). Nothing here reads a file or knows a pool.
"""
