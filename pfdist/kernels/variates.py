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

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_key
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, call, read
from pfdist.kernels.vectors import (
    LANES,
    Vector,
    VectorArray,
    iota,
    polynomial,
    splat,
    vectorised,
)

KINDS: Final = ("normal", "uniform", "centred", "exponential")
"""The kinds of noise; their indices are the codes in compiled code."""

NORMAL, UNIFORM, CENTRED, EXPONENTIAL = np.arange(4)

# The roles of noise. A stream is used by the simulation or by a filter, never by both; separate
# roles cost nothing. A filter of real measurements also simulates measurements of its particles,
# in the role of the truth's. They are NumPy integers, because Numba compiles anew for each Python
# constant.
TRUTH_INITIAL, TRUTH_PROCESS, TRUTH_MEASUREMENT = np.arange(3)
FILTER_INITIAL, FILTER_PROCESS, RESAMPLING, TRUTH_RANK, FILTER_PROPOSAL = np.arange(3, 8)

TILE: Final = 4 * LANES
SPARE: Final = LANES
"""Number of entries after the last variate that may be overwritten."""

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
    blocks = [
        [word + part for word, part in zip(each, schedule, strict=False)] for each in counters
    ]
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
    words = stream, stream >> 32, t, (role << 16) | component
    return [splat(each.to("u4"), LANES) for each in words]


def _counter(block: Vector, draw: Vector, part: Vector) -> Words:
    lanes = iota(block.builder, "u4", LANES)
    return [
        splat(block.to("u4"), LANES) + lanes,
        splat(draw.to("u4"), LANES),
        splat(part.to("u4"), LANES),
        lanes.number(0),
    ]


def _filling(tiles: int) -> Any:
    """A function of vectors that fills so many successive tiles of a draw with words."""

    @vectorised()
    def fill_tiles(
        words: VectorArray, at: Vector, stream: Vector, t: Vector, role: Vector, component: Vector,
        part: Vector, block: Vector, draw: Vector,
    ) -> None:  # fmt: skip
        counters = [_counter(block + LANES * number, draw, part) for number in range(tiles)]
        blocks = _threefry(_key(stream, t, role, component), counters)
        for number, tile in enumerate(blocks):
            for word, vector in enumerate(tile):
                words.store(at, vector, TILE * number + LANES * word)

    return fill_tiles


_fill_tile, _fill_two_tiles = _filling(1), _filling(2)


@vectorised()
def _fill_words_of_draws(
    words: VectorArray, at: Vector, stream: Vector, t: Vector, role: Vector, component: Vector,
    part: Vector, draw: Vector,
) -> None:  # fmt: skip
    """Fill two words of the first particle of consecutive draws, one behind the other."""
    key = _key(stream, t, role, component)
    zeros = key[0].number(0)
    draws = splat(draw.to("u4"), LANES) + iota(draw.builder, "u4", LANES)
    ((first, second, *_),) = _threefry(key, [[zeros, draws, splat(part.to("u4"), LANES), zeros]])
    words.store(at, first)
    words.store(at, second, LANES)


# --- from words to variates -----------------------------------------------------------------------


def _exponential(word: Vector) -> Vector:
    """-ln u for u = (word + 1/2) / 2^32, above 0; error at most 4e-7 before it is rounded."""
    # A little less than 2^-32. Otherwise the highest words would round to u = 1, and -ln u to 0.
    u = word.to("f4").fma(2.0**-32 * (1.0 - 2.0**-24), 2.0**-33)
    bits = u.bits("i4")
    exponent = (bits - 0x3F3504F3) >> 23
    f = (bits - (exponent << 23)).bits("f4") - 1.0  # of a number in 0.707..1.414
    p = polynomial(
        f, -0.11986408, 0.187617192, -0.204925684, 0.248977657, -0.333155447, 0.500014859,
        -1.0,
    )  # fmt: skip
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
    radius = (_exponential(word_a) * 2.0).call("sqrt")
    # An angle of at most an eighth of a turn; two bits of the word choose the eighth.
    s = (word_b << 2).bits("i4").to("f4") * 2.0**-32
    q = s * s
    sine = polynomial(q, -0.0046013, 0.0796826, -0.6459640, 1.5707963) * s
    cosine = polynomial(q, -0.0206890, 0.2536416, -1.2336979, 1.0)
    cosine = (cosine.bits("u4") ^ (word_b & 0x80000000)).bits("f4")
    swap = (word_b & 0x40000000).differs(0)
    return radius * swap.select(cosine, sine), radius * swap.select(sine, cosine)


@vectorised()
def _store_normals(words: VectorArray, at: Vector, out: VectorArray, to: Vector) -> None:
    """Two vectors of normal variates from two of words."""
    first, second = _box_muller(words.load(at, LANES), words.load(at, LANES, LANES))
    out.store(to, first)
    out.store(to, second, LANES)


@vectorised()
def _store_uniforms(words: VectorArray, at: Vector, out: VectorArray, to: Vector) -> None:
    out.store(to, _uniform(words.load(at, LANES)))


@vectorised()
def _store_exponentials(words: VectorArray, at: Vector, out: VectorArray, to: Vector) -> None:
    out.store(to, _exponential(words.load(at, LANES)))


@vectorised()
def _store_centred(
    words: VectorArray, at: Vector, lows: VectorArray, low: Vector, out: VectorArray, to: Vector
) -> None:
    out.store(to, _centred(words.load(at, LANES), lows.load(low, LANES)))


# --- a variate for each particle, or for each draw ------------------------------------------------


class Key(NamedTuple):
    """The key of the cipher, which is the same for all draws and particles."""

    stream: np.uint64
    t: int | np.signedinteger[Any]
    role: int | np.signedinteger[Any]
    component: int | np.signedinteger[Any]


def number_of_words(draws: int, width: int) -> int:
    """The size of the working array of `fill`: words for whole tiles."""
    return 2 * draws * TILE * -(-width // TILE)


@compiled
def fill_words(words, part, tiles, key, first, draws):
    """Fill words: a number of tiles for each of consecutive draws, two at a time."""
    lanes, two, (stream, t, role, component) = np.int64(LANES), np.int64(2), key
    for d in range(draws):
        at, draw = d * tiles * TILE, first + d
        for tile in range(np.int64(0), tiles - 1, two):
            _fill_two_tiles(
                words, at + tile * TILE, stream, t, role, component, part, tile * lanes, draw
            )
        if tiles % two:
            tile = tiles - 1
            _fill_tile(
                words, at + tile * TILE, stream, t, role, component, part, tile * lanes, draw
            )


class VariateRow(NamedTuple):
    """A row with a variate for each particle of consecutive draws."""

    words: NDArray[np.uint32]  # see `number_of_words`
    out: NDArray[np.float32]
    width: int  # entries of a draw, a multiple of `LANES`
    kind: int | np.int64  # position in `KINDS`
    key: Key
    first: int  # index of the first draw
    draws: int | np.int64


@entry(VariateRow)
def fill(row):
    """Fill a row: particle i of draw ``first + d`` is at ``d * width + i``.

    `SPARE` entries after the last are overwritten.
    """
    words, out, width, kind, key, first, draws = read(row)
    tiles = (width + np.int64(TILE - 1)) // np.int64(TILE)
    zero, lanes, lows = np.int64(0), np.int64(LANES), ahead(words, draws * tiles * TILE)
    fill_words(words, zero, tiles, key, first, draws)
    if kind == CENTRED:
        fill_words(lows, zero + 1, tiles, key, first, draws)
    for d in range(draws):
        at, to = d * tiles * TILE, d * width
        if kind == NORMAL:
            for i in range(zero, width, 2 * lanes):
                _store_normals(words, at + i, out, to + i)
        elif kind == UNIFORM:
            for i in range(zero, width, lanes):
                _store_uniforms(words, at + i, out, to + i)
        elif kind == CENTRED:
            for i in range(zero, width, lanes):
                _store_centred(words, at + i, lows, at + i, out, to + i)
        else:
            for i in range(zero, width, lanes):
                _store_exponentials(words, at + i, out, to + i)


@entry(VariateRow)
def fill_of_draws(row):
    """Fill a row, of width 1, with the variates of the first particle of consecutive draws.

    Up to 15 entries after the last are overwritten. `words` has 64 entries or more.
    """
    words, out, _, kind, key, first, draws = read(row)
    zero, low, (stream, t, role, component) = np.int64(0), np.int64(2 * LANES), key
    for d in range(zero, draws, np.int64(LANES)):
        _fill_words_of_draws(words, zero, stream, t, role, component, zero, first + d)
        if kind == NORMAL:
            _store_normals(words, zero, out, d)
        elif kind == UNIFORM:
            _store_uniforms(words, zero, out, d)
        else:
            _fill_words_of_draws(words, low, stream, t, role, component, zero + 1, first + d)
            _store_centred(words, zero, words, low, out, d)


class _Rows(NamedTuple):
    words: NDArray[np.uint32]
    out: NDArray[np.float32]
    draws: NDArray[np.int64]
    rows: int
    width: int
    kind: int
    key: Key
    fill: int  # address of `fill`


@entry(_Rows)
def _fill_rows(rows):
    words, out, draws, count, width, kind, key, address = read(rows)
    for d in range(count):
        row = ahead(out, d * (width + SPARE))
        call(address, VariateRow(words, row, width, kind, key, draws[d], 1))


def variates(
    kind: str,
    particles: int,
    stream: int,
    draw: int | NDArray[np.int64],
    t: int,
    role: SupportsIndex,
    component: int,
) -> NDArray[np.float64]:
    """The variate of each particle, (particles,); the integers select the noise.

    The values are those of float32, stored as float64. If `draw` is an array (D,), the result is
    (D, particles).
    """
    draws = np.atleast_1d(np.asarray(draw, np.int64))
    width = -(-particles // LANES) * LANES
    out = np.empty((draws.size, width + SPARE), np.float32)
    words = np.zeros(number_of_words(1, width), np.uint32)
    key = Key(np.uint64(stream), int(t), int(role), int(component))
    number = KINDS.index(kind)
    _fill_rows(_Rows(words, out, draws, draws.size, width, number, key, fill.address))
    values = out[:, :particles].astype(np.float64)
    return values if np.ndim(draw) else values[0]


def codes_of(*processes: Sequence[str]) -> NDArray[np.int64]:
    """A row of noise codes for each process, for compiled code; -1 for none."""
    codes = np.full((len(processes), max(1, *map(len, processes))), -1, np.int64)
    for row, kinds in zip(codes, processes, strict=True):
        row[: len(kinds)] = [KINDS.index(kind) for kind in kinds]
    return codes
