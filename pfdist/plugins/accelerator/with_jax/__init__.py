"""The engine `jax`: recorded programs interpreted with `jax.numpy`, on a GPU, a TPU or processors.

It needs the extra ``jax``.
"""

from pfdist.errors import MissingExtraError, PfdistError

try:
    import jax

    jax.default_backend()
except ModuleNotFoundError as error:
    raise MissingExtraError("filter.engine = 'jax'", "jax", error.name) from error
except Exception as error:
    reason = str(error).partition("\n")[0] or type(error).__name__
    raise PfdistError(f"filter.engine = 'jax' needs JAX and a device, got {reason}") from error
jax.config.update("jax_traceback_filtering", "off")  # it would put a note behind each error
