"""The engine `jax`: recorded programs interpreted with `jax.numpy`, on a GPU, a TPU or processors.

It needs the extra ``pfdist[jax]``. The package can do without this room, and without the engine in
`pfdist.filters.engines`.
"""

from pfdist.errors import PfdistError

try:
    import jax

    jax.default_backend()
except Exception as error:
    reason = str(error).partition("\n")[0] or type(error).__name__
    raise PfdistError(f"filter.engine = 'jax' needs JAX and a device, got {reason}") from error
jax.config.update("jax_traceback_filtering", "off")  # it would put a note behind each error
