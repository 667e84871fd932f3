"""JAX: ``lax.scan`` over time, ``vmap`` over draws, compiled, float32, on the CPU.

Blocks of 50 draws (`lax.map` with a batch size) take 8 to 25 % less than all at once. Multinomial
resampling is `jax.random.choice`, which looks uniforms up: ascending ones cost more to make (35 %)
than they save. Systematic resampling scatters where each particle's children begin: faster than
`searchsorted` (20 %) and `jnp.repeat` (12 %). The generator is the default, Threefry-2x32; "rbg" is
twice as slow on a CPU.
"""

import os
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

os.environ.setdefault("JAX_PLATFORMS", "cpu")  # read when JAX is imported

import jax
import jax.numpy as jnp
from jax import lax

# Threads that call a compiled function each compute it themselves, and do not wait for each other.
jax.config.update("jax_cpu_enable_async_dispatch", False)

_DRAWS_AT_ONCE = 50


def filter_draws(
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    measured: NDArray[np.bool_],
    particles: int,
    resampling: str,
    seed: int,
) -> NDArray[np.float64]:
    """Filter draws block by block; see `benchmarks.peer_filters`."""
    key = jax.random.key(seed)
    mse = _filter_draws(
        key,
        jnp.asarray(y, jnp.float32),
        jnp.asarray(z, jnp.float32),
        jnp.asarray(measured),
        particles,
        resampling,
    )
    return np.asarray(mse, np.float64)


@partial(jax.jit, static_argnames=("particles", "resampling"))
def _filter_draws(
    key: Any, y: Any, z: Any, measured: Any, particles: int, resampling: str
) -> jax.Array:
    ancestors = ANCESTORS[resampling]

    def observe(x: Any, t: Any, y_t: Any, z_t: Any, measured_t: Any, key: Any) -> Any:
        def weigh_and_resample(x: Any) -> Any:
            sd = jnp.sin(0.25 * t) + 2
            log_weight = -0.5 * ((y_t - x**2 / 20) / sd) ** 2
            weight = jnp.exp(log_weight - log_weight.max())
            weight /= weight.sum()
            return jnp.sum(weight * x), x[ancestors(key, weight)]

        def leave(x: Any) -> Any:
            return x.mean(), x

        mean, x = lax.cond(measured_t, weigh_and_resample, leave, x)
        return x, (mean - z_t) ** 2

    def filter_one(arguments: Any) -> Any:
        key, y, z = arguments
        key_start, key_first, key_rest = jax.random.split(key, 3)
        x = 5 * jax.random.normal(key_start, (particles,))
        x, first = observe(x, 0.0, y[0], z[0], measured[0], key_first)

        def step(x: Any, now: Any) -> Any:
            t, y_t, z_t, measured_t, key = now
            key_noise, key_resampling = jax.random.split(key)
            x = x / 2 + 25 * x / (1 + x**2) + 8 * jnp.cos(1.2 * (t - 1))
            x += jax.random.normal(key_noise, (particles,))
            return observe(x, t, y_t, z_t, measured_t, key_resampling)

        later = (
            jnp.arange(1, y.size, dtype=jnp.float32),
            y[1:],
            z[1:],
            measured[1:],
            jax.random.split(key_rest, y.size - 1),
        )
        _, rest = lax.scan(step, x, later)
        return (first + rest.sum()) / y.size

    keys = jax.random.split(key, len(y))
    mse: jax.Array = lax.map(filter_one, (keys, y, z), batch_size=_DRAWS_AT_ONCE)
    return mse


def _multinomial(key: Any, weight: Any) -> Any:
    return jax.random.choice(key, weight.size, weight.shape, p=weight)


def _systematic(key: Any, weight: Any) -> Any:
    cumulative = jnp.cumsum(weight)
    scale = weight.size / cumulative[-1]
    ends = jnp.ceil(cumulative * scale - jax.random.uniform(key)).astype(jnp.int32)
    passed = jnp.zeros(weight.size, jnp.int32).at[ends].add(1, mode="drop")
    return jnp.minimum(jnp.cumsum(passed), weight.size - 1)


ANCESTORS = {"multinomial": _multinomial, "systematic": _systematic}
"""Each scheme's function from a key and weights to indices of ancestors."""
