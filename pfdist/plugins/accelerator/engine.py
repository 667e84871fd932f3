"""The declaration of the engine `jax`, which imports no JAX."""

from typing import Final

from pfdist.filters.engine import Engine

JAX: Final = Engine(
    "jax",
    "Formulas compiled by JAX, for a GPU.",
    simulated_by="pfdist.filters.simulation",
    filtered_by="pfdist.plugins.accelerator.with_jax.filter",
    seconds_a_step=2e-8,
    least_draws=24,
    libraries=("jax", "jaxlib"),
)
