"""The engine `jax`: recorded programs interpreted with `jax.numpy`, on a GPU, a TPU or processors.

This room can be deleted with its line in `pfdist.filters.engines`, which alone names it. It needs
the extra ``pfdist[jax]``.
"""
