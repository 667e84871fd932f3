"""The engine `jax`, for a GPU."""

from pfdist.common.plugins import Plugin

PLUGIN = Plugin(engines=("pfdist.plugins.accelerator.engine:JAX",))
