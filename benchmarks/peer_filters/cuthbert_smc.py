"""cuthbert: steps of its particle filter in ``lax.scan``, ``vmap`` over draws, float32, on the CPU.

Two of its filters take turns: one resamples, after a measurement, and the other does not. Blocks of
50 draws. The resampling is that of `jax_scan`, passed as a function of the package's own protocol.
On a CPU its own functions call Numba for each draw: systematic takes 7 times the time of the whole
filter. `cuthbert.filter` would store all particles of all instants.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peer_filters.jax_scan import ANCESTORS

import jax  # isort: skip  after jax_scan, which chooses the CPU
import jax.numpy as jnp  # isort: skip
from cuthbert.smc.particle_filter import build_filter  # isort: skip
from cuthbertlib.resampling import no_resampling  # isort: skip

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
    with jax.enable_x64(False):  # whatever an earlier benchmark has chosen
        mse = _filter_draws(
            jax.random.key(seed),
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

    def resample(key: Any, logits: Any, x: Any, n: int) -> Any:
        chosen = ancestors(key, jax.nn.softmax(logits))
        return chosen, jnp.zeros(n), x[chosen]

    build = partial(build_filter, _initial, _transition, _log_potential, particles)
    resampling_filter, other_filter = build(resample), build(no_resampling.resampling)
    t = jnp.arange(y.shape[1], dtype=jnp.float32)
    push, sd = 8 * jnp.cos(1.2 * (t - 1)), jnp.sin(0.25 * t) + 2

    def filter_one(arguments: Any) -> Any:
        key, y, z = arguments
        inputs = y, measured, push, sd
        key_start, key_rest = jax.random.split(key)
        now = jax.tree.map(lambda values: values[0], inputs)
        start = resampling_filter.init_prepare(key=key_start)
        weight = jax.vmap(_log_potential, (None, 0, None))(0.0, start.particles, now)
        start = start._replace(model_inputs=now, log_weights=weight)

        def error(state: Any, z_t: Any) -> Any:
            mean = jnp.sum(jax.nn.softmax(state.log_weights) * state.particles)
            return (mean - z_t) ** 2

        def step(before: Any, now: Any) -> Any:
            inputs, z_t, was_measured, key = now
            after = resampling_filter.filter_prepare(inputs, key=key)
            after = jax.lax.cond(
                was_measured,
                resampling_filter.filter_combine,
                other_filter.filter_combine,
                before,
                after,
            )
            return after, error(after, z_t)

        later = jax.tree.map(lambda values: values[1:], inputs)
        keys = jax.random.split(key_rest, y.size - 1)
        _, rest = jax.lax.scan(step, start, (later, z[1:], measured[:-1], keys))
        return (error(start, z[0]) + rest.sum()) / y.size

    keys = jax.random.split(key, len(y))
    mse: jax.Array = jax.lax.map(filter_one, (keys, y, z), batch_size=_DRAWS_AT_ONCE)
    return mse


def _initial(key: Any) -> Any:
    return 5 * jax.random.normal(key)


def _transition(key: Any, x: Any, now: Any) -> Any:
    _, _, push, _ = now
    return x / 2 + 25 * x / (1 + x**2) + push + jax.random.normal(key)


def _log_potential(before: Any, x: Any, now: Any) -> Any:
    y, measured, _, sd = now
    return jnp.where(measured, -0.5 * ((y - x**2 / 20) / sd) ** 2, 0.0)
