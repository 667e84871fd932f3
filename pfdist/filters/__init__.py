"""Simulation and filters: draws, the particle filter and its plain NumPy twin, the Kalman filter.

They take a model, arrays and keys, and give arrays. On them rests the Monte Carlo estimate of the
expected MSE of a set of times: a unit of work (work), its computation (engines, evaluator), and the
expected MSE with its standard error (estimate). Nothing here reads a file or knows a pool.
"""
