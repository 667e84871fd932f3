"""Keyed noise: each variate of a simulation or a filter is a pure function of some integers.

There is no generator with a state, except for the random choices of a search. The cipher,
Threefry-4x32 with 13 rounds, gets two arguments:

======= ============================== =========================================
key     stream (64 bits), draw, t      which simulation or filter, which draw, when
counter block, component, role, part   which particles, which noise component, what for
======= ============================== =========================================

The part is 0, and 1 for the low bits of centred noise.

A role is for instance the process noise of the truth, or the resampling of the filter. So a variate
depends neither on how draws are cut into tasks, nor on the order of the tasks, nor on the number of
workers. One block of the cipher serves four particles, or one draw of a simulation. Besides the
cipher, only additions, multiplications (also fused) and square roots of float32 are used, and no
libm. So compiled and plain noise agree to the last bit on every machine.

References
----------
Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_key
from pfdist.kernels.arithmetic import LANES, fma
from pfdist.kernels.melting import inlined, melted


@inlined
def _rotate(x, bits):
    return np.uint32((x << np.uint32(bits)) | (x >> np.uint32(32 - bits)))


@inlined
def _round(bits_01, bits_23, x0, x1, x2, x3):
    # Words 1 and 3 leave swapped: that is Threefry's permutation between two rounds.
    x0 = np.uint32(x0 + x1)
    x2 = np.uint32(x2 + x3)
    return x0, np.uint32(_rotate(x3, bits_23) ^ x2), x2, np.uint32(_rotate(x1, bits_01) ^ x0)


@inlined
def _add_key(k0, k1, k2, k3, times, x0, x1, x2, x3):
    return (
        np.uint32(x0 + k0),
        np.uint32(x1 + k1),
        np.uint32(x2 + k2),
        np.uint32(x3 + k3 + np.uint32(times)),
    )


@inlined
def threefry4x32(k0, k1, k2, k3, c0, c1, c2, c3):
    """Four words of the cipher from four words of a key and four of a counter.

    Each word is uint32 or an array of uint32.
    """
    k4 = np.uint32(np.uint32(0x1BD11BDA) ^ k0 ^ k1 ^ k2 ^ k3)
    x = _add_key(k0, k1, k2, k3, 0, c0, c1, c2, c3)
    x = _round(23, 5, *_round(13, 27, *_round(11, 21, *_round(10, 26, *x))))
    x = _add_key(k1, k2, k3, k4, 1, *x)
    x = _round(18, 20, *_round(25, 10, *_round(17, 11, *_round(6, 20, *x))))
    x = _add_key(k2, k3, k4, k0, 2, *x)
    x = _round(23, 5, *_round(13, 27, *_round(11, 21, *_round(10, 26, *x))))
    x = _add_key(k3, k4, k0, k1, 3, *x)
    x0, x3, x2, x1 = _round(6, 20, *x)
    return x0, x1, x2, x3


# The roles of noise. A stream is used by the simulation or by a filter, never by both; separate
# roles cost nothing. A filter of real measurements also simulates measurements of its particles,
# in the role of the truth's. They are NumPy integers, because Numba compiles anew for each Python
# constant.
TRUTH_INITIAL, TRUTH_PROCESS, TRUTH_MEASUREMENT = np.arange(3)
FILTER_INITIAL, FILTER_PROCESS, RESAMPLING, TRUTH_RANK = np.arange(3, 7)

# Particles come in tiles: the four words of each of LANES blocks are LANES entries apart. So the
# compiled loop over the blocks writes whole vectors.
# --- words of noise -------------------------------------------------------------------------------

TILE = 4 * LANES


def generator(*parts: Any) -> np.random.Generator:
    """A NumPy generator for the random choices of a search; the parts are its key."""
    return np.random.Generator(np.random.Philox(stream_key(*parts)))


@inlined
def padded(particles: int) -> int:
    """Length of a noise buffer: the least multiple of TILE that is not below this number."""
    return -(-particles // TILE) * TILE


@inlined
def _words(stream, draw, t, role, component, block, part=0):
    return threefry4x32(
        np.uint32(stream & np.uint64(0xFFFFFFFF)),
        np.uint32(stream >> np.uint64(32)),
        np.uint32(draw),
        np.uint32(t),
        np.uint32(block),
        np.uint32(component),
        np.uint32(role),
        np.uint32(part),
    )


# --- from words to variates -------------------------------------------------------------------
# Each polynomial interpolates at the Chebyshev nodes of its interval.


@inlined
def _exponential(word):
    """-ln u for u = (word + 1/2) / 2^32; error at most 2.2e-7 max(1, -ln u)."""
    # A little less than 2^-32. Otherwise the highest words would round to u = 1, and -ln u to 0.
    less = np.float32(2.0**-32 * (1.0 - 2.0**-24))
    u = fma(np.float32(word), less, np.float32(2.0**-33))
    bits = np.float32(u).view(np.int32)
    exponent = np.int32(np.int32(bits - np.int32(0x3F3504F3)) >> np.int32(23))
    mantissa = np.int32(bits - np.int32(exponent << np.int32(23)))  # of a number in [0.707, 1.414)
    f = np.int32(mantissa).view(np.float32) - np.float32(1.0)
    p = np.float32(-0.08533313)
    p = fma(p, f, np.float32(0.14269258))
    p = fma(p, f, np.float32(-0.14977401))
    p = fma(p, f, np.float32(0.16577993))
    p = fma(p, f, np.float32(-0.19955933))
    p = fma(p, f, np.float32(0.25001353))
    p = fma(p, f, np.float32(-0.33334193))
    p = fma(p, f, np.float32(0.49999997))
    p = fma(p, f, np.float32(-1.0))
    return fma(p, f, np.float32(exponent) * np.float32(-0.69314718))


@inlined
def _uniform(word):
    """A number in (0, 1), ends excluded: the 23 high bits and a half, exact in float32."""
    return (np.float32(word >> np.uint32(9)) + np.float32(0.5)) * np.float32(2.0**-23)


@inlined
def _centred(high, low):
    """A number in -1/2..1/2, uniform, never 0, from 63 bits and a sign; rounded to float32."""
    size = np.float32(low) * np.float32(2.0**-64) + np.float32(2.0**-65)
    size = np.float32(high >> np.uint32(1)) * np.float32(2.0**-32) + size
    return size * (np.float32(1.0) - np.float32(2.0) * np.float32(high & np.uint32(1)))


@inlined
def _sine_cosine(word):
    """Sine and cosine of pi s, s = word / 2^31 in [-1, 1] with a signed word; error 4e-7."""
    s = np.float32(np.int32(word)) * np.float32(2.0**-31)
    q = s * s
    p = np.float32(-3.8589476e-04)
    p = fma(p, q, np.float32(6.8600797e-03))
    p = fma(p, q, np.float32(-7.5187169e-02))
    p = fma(p, q, np.float32(5.2403611e-01))
    p = fma(p, q, np.float32(-2.0261195))
    p = fma(p, q, np.float32(3.1415927))
    sine = fma(-q, s, s) * p
    p = np.float32(-1.6158471e-03)
    p = fma(p, q, np.float32(2.5015287e-02))
    p = fma(p, q, np.float32(-2.2883615e-01))
    p = fma(p, q, np.float32(1.2779757))
    p = fma(p, q, np.float32(-3.7392056))
    p = fma(p, q, np.float32(4.0))
    return sine, (np.float32(0.25) - q) * p


@inlined
def _box_muller(word_a, word_b):
    radius = np.sqrt(np.float32(2.0) * _exponential(word_a))
    sine, cosine = _sine_cosine(word_b)
    return radius * sine, radius * cosine


@inlined
def _four_normals(stream, draw, t, role, component, block):
    a, b, c, d = _words(stream, draw, t, role, component, block)
    e, f = _box_muller(a, b)
    g, h = _box_muller(c, d)
    return e, f, g, h


@inlined
def _four_uniforms(stream, draw, t, role, component, block):
    a, b, c, d = _words(stream, draw, t, role, component, block)
    return _uniform(a), _uniform(b), _uniform(c), _uniform(d)


@inlined
def _four_centred(stream, draw, t, role, component, block):
    a, b, c, d = _words(stream, draw, t, role, component, block)
    e, f, g, h = _words(stream, draw, t, role, component, block, 1)
    return _centred(a, e), _centred(b, f), _centred(c, g), _centred(d, h)


@inlined
def _four_exponentials(stream, draw, t, role, component, block):
    a, b, c, d = _words(stream, draw, t, role, component, block)
    return _exponential(a), _exponential(b), _exponential(c), _exponential(d)


FOUR: dict[str, Callable[..., Any]] = {
    "normal": _four_normals,
    "uniform": _four_uniforms,
    "centred": _four_centred,
    "exponential": _four_exponentials,
}


# --- a variate for each particle, or for each draw ----------------------------------------------


def _filling(four: Callable[..., Any]) -> Callable[..., Any]:
    @melted
    def fill(out, row, particles, stream, draw, t, role, component):
        for tile in range(padded(particles) // TILE):
            first = tile * TILE
            a = out[row, first : first + LANES]
            b = out[row, first + LANES : first + 2 * LANES]
            c = out[row, first + 2 * LANES : first + 3 * LANES]
            d = out[row, first + 3 * LANES : first + 4 * LANES]
            for lane in range(LANES):
                a[lane], b[lane], c[lane], d[lane] = four(
                    stream, draw, t, role, component, tile * LANES + lane
                )

    return fill


def _filling_draws(four: Callable[..., Any]) -> Callable[..., Any]:
    @melted
    def fill(out, row, draws, stream, first, t, role, component):
        for d in range(draws):
            out[row, d] = four(stream, first + d, t, role, component, 0)[0]

    return fill


FILL = {kind: _filling(four) for kind, four in FOUR.items()}
"""For each kind, compiled ``fill(out, row, particles, stream, draw, t, role, component)``.

`out` is float32, (rows, padded(particles) or more). Rows are unsigned, because signed rows prevent
vectorisation.
"""

FILL_DRAWS = {kind: _filling_draws(four) for kind, four in FOUR.items()}
"""For each kind, compiled ``fill(out, row, draws, stream, first, t, role, component)``.

It fills the variates of the first particle of some draws, one after another.
"""


@cache
def filler(kinds: tuple[str, ...], *, of_draws: bool = False) -> Callable[..., Any]:
    """A compiled function that fills one row of noise for each component of a process.

    It is ``fill(out, particles, stream, draw, t, role)``, with the variates of the particles of one
    draw; `out` is float32, (components or more, padded(particles) or more). With `of_draws` it is
    ``fill(out, draws, stream, first, t, role)``, with a variate for each draw from the draw `first`
    on; `out` is (components or more, draws or more).
    """
    fills = FILL_DRAWS if of_draws else FILL
    count, (first, *others) = len(kinds), sorted(set(kinds)) or ["normal"]
    fill_row = fills[first]
    for kind in others:
        fill_row = _either(fill_row, fills[kind], np.array([each == kind for each in kinds]))

    @melted
    def fill_all(out, size, stream, draw, t, role):
        for component in range(count):
            fill_row(out, np.uintp(component), size, stream, draw, t, role, component)

    return fill_all


def _either(
    fill: Callable[..., Any], other: Callable[..., Any], is_other: NDArray[np.bool_]
) -> Callable[..., Any]:
    @melted
    def fill_row(out, row, size, stream, draw, t, role, component):
        if is_other[component]:
            other(out, row, size, stream, draw, t, role, component)
        else:
            fill(out, row, size, stream, draw, t, role, component)

    return fill_row


def variates(
    kind: str,
    particles: int,
    stream: int,
    draw: int | NDArray[np.int64],
    t: int,
    role: SupportsIndex,
    component: int,
) -> NDArray[np.float64]:
    """Each particle's variate by NumPy, (particles,), with the values of the compiled function.

    The integers select the noise: see the table above. If `draw` is an array (D,), the result is
    (D, particles). The values are those of float32, stored as float64.
    """
    block = np.arange(padded(particles) // 4)
    # The key as an array too: NumPy warns when a scalar's addition wraps, an array's may.
    of_draw = np.asarray(draw)[..., None]
    key = [np.full_like(block, part) for part in (t, role, component)]
    four = FOUR[kind](np.full(block.shape, stream, np.uint64), of_draw, *key, block)
    tiles = np.moveaxis(np.reshape(four, (4, *four[0].shape[:-1], -1, LANES)), 0, -2)
    values = tiles.reshape(*four[0].shape[:-1], -1)
    return values[..., :particles].astype(np.float64)
