"""The same filter in other libraries: the paper's model with intermittent measurements.

Each peer has a file, written in the best style of its library. The docstring names slower variants
that were tried. Each file has the function ::

    filter_draws(y, z, measured, particles, resampling, seed) -> mse

The arguments are the measurements y and quantities of interest z, (D, T+1); whether each instant is
measured, (T+1,); the number of particles; "multinomial" or "systematic"; and a seed. Particles are
propagated. At a measurement they are weighted and resampled. The weighted mean before resampling
estimates z, and mse (D,) is the mean of the squared error over t.
"""
