"""The Monte Carlo estimate of the expected MSE of a set of measurement times.

Pure functions and frozen data: a unit of work (work), its computation (evaluator), and the expected
MSE with its standard error (estimate). Nothing here reads a file or knows a pool.
"""
