"""Simulation and filters: draws, the particle filter and its plain NumPy twin, the Kalman filter.

Everything here takes a model, arrays and keys, and gives arrays.
"""
