"""Keyed noise: each variate of a simulation or a filter is a pure function of some integers.

There is no generator with a state, except for the random choices of a search. The cipher,
Threefry-4x32 with 13 rounds, gets two arguments:

======= =================================== ======================================
key     stream (64 bits), t, role and       which simulation or filter, when, what
        component                           for, which noise component
counter block, draw, part                   which particles, which draw
======= =================================== ======================================

The part is 0, and 1 for the low bits of centred noise. A role is for instance the process noise of
the truth, or the resampling of the filter. So a variate depends neither on how draws are cut into
tasks, nor on the order of the tasks, nor on the number of particles or of workers.

Particles come in tiles of 64. A tile takes `LANES` blocks of the cipher, and word k of block l is
that of particle 16 k + l. Besides the cipher, only additions, multiplications (also fused) and
square roots of float32 are used, in a fixed order, so all processors give the same bits.

References
----------
Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011. Box, Muller, "A
note on the generation of random normal deviates", Annals of Mathematical Statistics 29, 1958.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_key
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.vectors import LANES, Array, Vector, constant, iota, splat, vectorised

KINDS: Final = ("normal", "uniform", "centred", "exponential")
"""The kinds of noise; compiled code knows them by their numbers here."""

# The roles of noise. A stream is used by the simulation or by a filter, never by both; separate
# roles cost nothing. A filter of real measurements also simulates measurements of its particles,
# in the role of the truth's. They are NumPy integers, because Numba compiles anew for each Python
# constant.
TRUTH_INITIAL, TRUTH_PROCESS, TRUTH_MEASUREMENT = np.arange(3)
FILTER_INITIAL, FILTER_PROCESS, RESAMPLING, TRUTH_RANK = np.arange(3, 7)

TILE: Final = 4 * LANES
SPARE: Final = TILE - LANES
"""Entries behind the last variate into which whole tiles are written."""

_ROUNDS = 13
_ROTATIONS = ((10, 26), (11, 21), (13, 27), (23, 5), (6, 20), (17, 11), (25, 10), (18, 20))
_PARITY = 0x1BD11BDA

Words = list[Vector]


def generator(*parts: Any) -> np.random.Generator:
    """A NumPy generator for the random choices of a search; the parts are its key."""
    return np.random.Generator(np.random.Philox(stream_key(*parts)))


# --- the cipher -----------------------------------------------------------------------------------


def _threefry(key: Words, counters: Sequence[Words]) -> list[Words]:
    """Four words for each counter; the counters' rounds alternate, so that none has to wait."""
    schedule = [*key, key[0] ^ key[1] ^ key[2] ^ key[3] ^ _PARITY]
    blocks = [[word + part for word, part in zip(each, schedule, strict=False)] for each in counters]
    for number in range(_ROUNDS):
        first, second = _ROTATIONS[number % 8]
        b, d = (1, 3) if number % 2 == 0 else (3, 1)
        for x in blocks:
            x[0], x[2] = x[0] + x[b], x[2] + x[d]
        for x in blocks:
            x[b], x[d] = x[b].rotated(first), x[d].rotated(second)
        for x in blocks:
            x[b], x[d] = x[b] ^ x[0], x[d] ^ x[2]
        if number % 4 == 3:
            times = number // 4 + 1
            for word in range(4):
                part = schedule[(times + word) % 5] + (times if word == 3 else 0)
                for x in blocks:
                    x[word] = x[word] + part
    return blocks


def _key(stream: Vector, t: Vector, role: Vector, component: Vector) -> Words:
    """The key as vectors."""
    words = stream, stream >> 32, t, (role << 16) | component
    return [splat(each.to("u4"), LANES) for each in words]


def _counter(block: Vector, draw: Vector, part: int) -> Words:
    lanes = iota(block.builder, "u4", LANES)
    blocks = splat(block.to("u4"), LANES) + lanes
    return [blocks, splat(draw.to("u4"), LANES), lanes.number(part), lanes.number(0)]


# --- from words to variates -----------------------------------------------------------------------


def _polynomial(x: Vector, *coefficients: float) -> Vector:
    value = x.number(coefficients[0])
    for coefficient in coefficients[1:]:
        value = value.fma(x, coefficient)
    return value


def _exponential(word: Vector) -> Vector:
    """-ln u for u = (word + 1/2) / 2^32; relative error at most 3e-6."""
    # A little less than 2^-32. Otherwise the highest words would round to u = 1, and -ln u to 0.
    u = word.to("f4").fma(2.0**-32 * (1.0 - 2.0**-24), 2.0**-33)
    bits = u.bits("i4")
    exponent = (bits - 0x3F3504F3) >> 23
    f = (bits - (exponent << 23)).bits("f4") - 1.0  # of a number in 0.707..1.414
    p = _polynomial(f, 0.145902964, -0.220214174, 0.253406118, -0.332673187, 0.499931014, -1.0)
    return p.fma(f, exponent.to("f4") * -0.69314718)


def _uniform(word: Vector) -> Vector:
    """A number in (0, 1), ends excluded: the 23 high bits and a half, exact in float32."""
    return ((word >> 9).bits("i4").to("f4") + 0.5) * 2.0**-23


def _centred(high: Vector, low: Vector) -> Vector:
    """A number in -1/2..1/2, uniform, never 0, from 63 bits and a sign; rounded to float32."""
    size = low.to("f4") * 2.0**-64 + 2.0**-65
    size = (high >> 1).to("f4") * 2.0**-32 + size
    return (size.bits("u4") ^ (high << 31)).bits("f4")


def _box_muller(word_a: Vector, word_b: Vector) -> tuple[Vector, Vector]:
    """Two independent normal variates."""
    radius = (_exponential(word_a) * 2.0).call("sqrt")
    # An angle of at most an eighth of a turn; two bits of the word choose the eighth.
    s = (word_b << 2).bits("i4").to("f4") * 2.0**-32
    q = s * s
    sine = _polynomial(q, -0.0046013, 0.0796826, -0.6459640, 1.5707963) * s
    cosine = _polynomial(q, -0.0206890, 0.2536416, -1.2336979, 1.0)
    cosine = (cosine.bits("u4") ^ (word_b & 0x80000000)).bits("f4")
    swap = (word_b & 0x40000000).differs(0)
    return radius * swap.select(cosine, sine), radius * swap.select(sine, cosine)


def _variates(kind: str, key: Words, counters: Sequence[tuple[Vector, Vector]]) -> list[Words]:
    """Four vectors of variates for each counter: a tile."""
    blocks = _threefry(key, [_counter(*each, 0) for each in counters])
    if kind == "normal":
        return [[*_box_muller(*words[:2]), *_box_muller(*words[2:])] for words in blocks]
    if kind == "centred":
        others = _threefry(key, [_counter(*each, 1) for each in counters])
        return [
            [_centred(high, low) for high, low in zip(words, lows, strict=True)]
            for words, lows in zip(blocks, others, strict=True)
        ]
    function = _uniform if kind == "uniform" else _exponential
    return [[function(word) for word in words] for words in blocks]


# --- a variate for each particle, or for each draw ------------------------------------------------


def _filling(kind: str) -> tuple[Any, Any]:
    """Compile functions that fill four tiles at a time, and a vector of draws."""

    @vectorised()
    def fill_tiles(
        out: Array, stream: Vector, t: Vector, role: Vector, component: Vector,
        place_a: Vector, block_a: Vector, draw_a: Vector,
        place_b: Vector, block_b: Vector, draw_b: Vector,
        place_c: Vector, block_c: Vector, draw_c: Vector,
        place_d: Vector, block_d: Vector, draw_d: Vector,
    ) -> None:  # fmt: skip
        """Fill four tiles, each at a place, for a block of particles of a draw."""
        counters = (block_a, draw_a), (block_b, draw_b), (block_c, draw_c), (block_d, draw_d)
        tiles = _variates(kind, _key(stream, t, role, component), counters)
        for place, tile in zip((place_a, place_b, place_c, place_d), tiles, strict=True):
            for quarter, vector in enumerate(tile):
                out.store(place, vector, LANES * quarter)

    @vectorised()
    def fill_vector(
        out: Array, stream: Vector, t: Vector, role: Vector, component: Vector,
        place: Vector, draw: Vector,
    ) -> None:  # fmt: skip
        """Fill the variates of the first particle of consecutive draws."""
        key = _key(stream, t, role, component)
        zero = constant(draw.builder, "u4", LANES, 0)
        draws = splat(draw.to("u4"), LANES) + iota(draw.builder, "u4", LANES)
        words = [_threefry(key, [[zero, draws, zero.number(part), zero]])[0] for part in (0, 1)]
        made: dict[str, Callable[[], Vector]] = {
            "normal": lambda: _box_muller(*words[0][:2])[0],
            "uniform": lambda: _uniform(words[0][0]),
            "centred": lambda: _centred(words[0][0], words[1][0]),
            "exponential": lambda: _exponential(words[0][0]),
        }
        out.store(place, made[kind]())

    @compiled
    def fill_kind(out, at, width, stream, t, role, component, first, draws):
        tiles = (width + np.int64(TILE - 1)) // np.int64(TILE)
        # A tile's end is overwritten by the next draw, so the order of tiles matters; at the end,
        # the last tile is filled again.
        last = draws * tiles - 1
        for a in range(np.int64(0), last + 1, np.int64(4)):
            b, c, d = min(a + 1, last), min(a + 2, last), min(a + 3, last)
            fill_tiles(
                out, stream, t, role, component,
                at + a // tiles * width + a % tiles * TILE, a % tiles * LANES, first + a // tiles,
                at + b // tiles * width + b % tiles * TILE, b % tiles * LANES, first + b // tiles,
                at + c // tiles * width + c % tiles * TILE, c % tiles * LANES, first + c // tiles,
                at + d // tiles * width + d % tiles * TILE, d % tiles * LANES, first + d // tiles,
            )  # fmt: skip

    @compiled
    def fill_kind_of_draws(out, at, stream, t, role, component, first, draws):
        for d in range(np.int64(0), draws, np.int64(LANES)):
            fill_vector(out, stream, t, role, component, at + d, first + d)

    return fill_kind, fill_kind_of_draws


_normal, _normal_of_draws = _filling("normal")
_uniforms, _uniform_of_draws = _filling("uniform")
_centreds, _centred_of_draws = _filling("centred")
fill_exponentials, _ = _filling("exponential")
fill_uniforms = _uniforms


@compiled
def fill(out, at, width, kind, stream, t, role, component, first, draws):
    """Fill a row with a variate for each particle of consecutive draws.

    Particle i of draw ``first + d`` is at ``at + d * width + i``; `width` is a multiple of `LANES`.
    `SPARE` entries behind the last are overwritten. `kind` is a position in `KINDS`.
    """
    if kind == 0:
        _normal(out, at, width, stream, t, role, component, first, draws)
    elif kind == 1:
        _uniforms(out, at, width, stream, t, role, component, first, draws)
    elif kind == 2:
        _centreds(out, at, width, stream, t, role, component, first, draws)
    else:
        fill_exponentials(out, at, width, stream, t, role, component, first, draws)


@compiled
def fill_of_draws(out, at, kind, stream, t, role, component, first, draws):
    """Fill a row with the variates of the first particle of consecutive draws.

    Up to 15 entries behind the last are overwritten.
    """
    if kind == 0:
        _normal_of_draws(out, at, stream, t, role, component, first, draws)
    elif kind == 1:
        _uniform_of_draws(out, at, stream, t, role, component, first, draws)
    else:
        _centred_of_draws(out, at, stream, t, role, component, first, draws)


@entry
def _fill_rows(out, kind, stream, draws, t, role, component):
    width = np.int64(out.shape[1] - SPARE)
    for row in range(draws.size):
        fill(out[row], np.int64(0), width, kind, stream, t, role, component, draws[row], np.int64(1))


def variates(
    kind: str,
    particles: int,
    stream: int,
    draw: int | NDArray[np.int64],
    t: int,
    role: SupportsIndex,
    component: int,
) -> NDArray[np.float64]:
    """Each particle's variate, (particles,); the integers select the noise.

    The values are those of float32, stored as float64. If `draw` is an array (D,), the result is
    (D, particles).
    """
    draws = np.atleast_1d(np.asarray(draw, np.int64))
    width = -(-particles // LANES) * LANES
    out = np.empty((draws.size, width + SPARE), np.float32)
    numbers = int(t), int(role), int(component)
    _fill_rows(out, KINDS.index(kind), np.uint64(stream), draws, *numbers)
    values = out[:, :particles].astype(np.float64)
    return values if np.ndim(draw) else values[0]


def codes_of(kinds: Sequence[str]) -> NDArray[np.int64]:
    """The numbers of some kinds, as compiled code takes them."""
    return np.array([KINDS.index(kind) for kind in kinds], np.int64)
