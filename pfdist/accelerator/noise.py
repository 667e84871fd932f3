"""Keyed noise with `jax.numpy`: the bits of `pfdist.kernels.variates`, but for rounding."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from pfdist.kernels.variates import PARITY, ROTATIONS, ROUNDS, TILE
from pfdist.kernels.vectors import LANES


class KeyOfDraws(NamedTuple):
    """The key of the cipher, and the draws, (D,)."""

    stream: Any  # (2,): low and high word
    t: Any
    role: int
    draws: Any


def _words(key: KeyOfDraws, component: int, part: int, tiles: int) -> list[Any]:
    """Four arrays (D, tiles, LANES) of words, see `pfdist.kernels.variates`."""
    last = jnp.uint32(int(key.role) << 16 | component)
    words = [*key.stream, jnp.uint32(key.t), last]
    schedule = [*words, words[0] ^ words[1] ^ words[2] ^ words[3] ^ jnp.uint32(PARITY)]
    block = jnp.arange(tiles * LANES, dtype=jnp.uint32).reshape(tiles, LANES)
    draws = jnp.uint32(key.draws)[:, None, None]
    counter = jnp.broadcast_arrays(block, draws, jnp.uint32(part), jnp.uint32(0))
    x = [word + each for word, each in zip(counter, schedule[:4], strict=True)]
    for number in range(ROUNDS):
        b, d = (1, 3) if number % 2 == 0 else (3, 1)
        x[0], x[2] = x[0] + x[b], x[2] + x[d]
        for at, onto, bits in zip((b, d), (0, 2), ROTATIONS[number % 8], strict=True):
            x[at] = ((x[at] << bits) | (x[at] >> (32 - bits))) ^ x[onto]
        if number % 4 == 3:
            times = number // 4 + 1
            for word in range(4):
                x[word] = x[word] + schedule[(times + word) % 5] + jnp.uint32(times * (word == 3))
    return x


def _float(word: Any, kind: Any = jnp.int32) -> Any:
    return lax.bitcast_convert_type(word, kind).astype(jnp.float32)


def _exponential(word: Any) -> Any:
    return -jnp.log(_float(word, jnp.uint32) * (2.0**-32 * (1.0 - 2.0**-24)) + 2.0**-33)


def _normals(word_a: Any, word_b: Any) -> tuple[Any, Any]:
    radius = jnp.sqrt(2.0 * _exponential(word_a))
    angle = (2.0**-32 * 2 * jnp.pi / 4) * _float(word_b << 2)  # at most an eighth of a turn
    sine, cosine = jnp.sin(angle), jnp.cos(angle) * jnp.where(word_b >> 31, -1.0, 1.0)
    swap = (word_b & 0x40000000) != 0
    return radius * jnp.where(swap, cosine, sine), radius * jnp.where(swap, sine, cosine)


def noise_of_particles(kind: str, particles: int, key: KeyOfDraws, component: int) -> Any:
    """The variate of each particle of each draw, (D, P)."""
    tiles = -(-particles // TILE)
    words = _words(key, component, 0, tiles)
    if kind == "normal":
        found = [*_normals(*words[:2]), *_normals(*words[2:])]
    elif kind == "uniform":
        found = [(_float(each >> 9) + 0.5) * 2.0**-23 for each in words]
    elif kind == "exponential":
        found = [_exponential(each) for each in words]
    else:
        lows = _words(key, component, 1, tiles)
        sizes = [_float(h >> 1) * 2.0**-32 for h in words]
        sizes = [
            s + (_float(w, jnp.uint32) * 2.0**-64 + 2.0**-65)
            for s, w in zip(sizes, lows, strict=True)
        ]
        found = [jnp.where(h & 1, -s, s) for h, s in zip(words, sizes, strict=True)]
    whole = jnp.zeros((key.draws.size, tiles, 4, LANES))
    for number, each in enumerate(found):  # XLA would compute a stack again and again
        whole = whole.at[:, :, number].set(each)
    return whole.reshape(key.draws.size, -1)[:, :particles]
