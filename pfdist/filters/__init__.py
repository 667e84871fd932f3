"""Simulation and filters: draws, the particle filter and its plain NumPy twin, the Kalman filter.

They take a model, arrays and keys, and return arrays. The Monte Carlo estimate of the expected MSE
of a set of times builds on them: a unit of work (work), its computation (engines, evaluator), and
the expected MSE with its standard error (estimate). Nothing here reads a file or uses a pool.
"""
