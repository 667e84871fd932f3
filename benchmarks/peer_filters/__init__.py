"""The same job done by others: the paper's model, filtered with intermittent measurements.

A file a peer, written by the peer's own best idioms; what else was tried stands in its docstring.
Each has one function::

    filter_draws(y, z, measured, particles, resampling, seed) -> mse

of the measurements and quantities of interest y and z (D, T+1), whether each instant is measured
(T+1,), the number of particles, "multinomial" or "systematic", and a seed. Particles are
propagated, where something is measured weighted and resampled, and z is estimated by their
weighted mean before resampling; mse (D,) is the mean of its squared error over t.
"""
