"""Noise, weights and resampling in plain NumPy, bit for bit as compiled code computes them.

The fused multiply-add of float32 goes through float64, which holds the product exactly. It rounds
twice, which changes one of 2^29 results; no argument of the tests is such a case.
"""

import numpy as np

from pfdist.kernels.variates import RESAMPLING

_ROTATIONS = ((10, 26), (11, 21), (13, 27), (23, 5), (6, 20), (17, 11), (25, 10), (18, 20))
_POINTS, _SHARES = 2.0**31 - 2.0**10, 2.0**31 - 2.0**8
single = np.float32


def threefry4x32(key, counter, rounds=13):
    """Four words of the cipher for words of keys and counters, which are arrays of uint32.

    Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
    """
    key = [np.asarray(word, np.uint32) for word in key]
    schedule = [*key, key[0] ^ key[1] ^ key[2] ^ key[3] ^ np.uint32(0x1BD11BDA)]
    with np.errstate(over="ignore"):
        x = [np.asarray(c, np.uint32) + k for c, k in zip(counter, schedule, strict=False)]
        for number in range(rounds):
            b, d = (1, 3) if number % 2 == 0 else (3, 1)
            for first, second, bits in ((0, b, 0), (2, d, 1)):
                x[first] = x[first] + x[second]
                shift = np.uint32(_ROTATIONS[number % 8][bits])
                rotated = (x[second] << shift) | (x[second] >> (np.uint32(32) - shift))
                x[second] = rotated ^ x[first]
            if number % 4 == 3:
                times = number // 4 + 1
                x = [word + schedule[(times + i) % 5] for i, word in enumerate(x)]
                x[3] = x[3] + np.uint32(times)
    return x


def _fma(a, b, c):
    return single(np.float64(a) * np.float64(b) + np.float64(c))


def _polynomial(x, *coefficients):
    value = np.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = _fma(value, x, single(coefficient))
    return value


def exponential(word):
    u = _fma(word.astype(single), single(2.0**-32 * (1.0 - 2.0**-24)), single(2.0**-33))
    bits = u.view(np.int32)
    exponent = (bits - np.int32(0x3F3504F3)) >> np.int32(23)
    f = (bits - (exponent << np.int32(23))).view(single) - single(1.0)
    p = _polynomial(
        f,
        *(-0.11986408, 0.187617192, -0.204925684, 0.248977657),
        *(-0.333155447, 0.500014859, -1.0),
    )
    return _fma(p, f, exponent.astype(single) * single(-0.69314718))


def uniform(word):
    return ((word >> np.uint32(9)).astype(single) + single(0.5)) * single(2.0**-23)


def centred(high, low):
    size = low.astype(single) * single(2.0**-64) + single(2.0**-65)
    size = (high >> np.uint32(1)).astype(single) * single(2.0**-32) + size
    return np.where(high & np.uint32(1), -size, size)


def box_muller(word_a, word_b):
    radius = np.sqrt(exponential(word_a) * single(2.0))
    s = (word_b << np.uint32(2)).view(np.int32).astype(single) * single(2.0**-32)
    q = s * s
    sine = _polynomial(q, -0.0046013, 0.0796826, -0.6459640, 1.5707963) * s
    cosine = _polynomial(q, -0.0206890, 0.2536416, -1.2336979, 1.0)
    cosine = np.where(word_b & np.uint32(0x80000000), -cosine, cosine)
    swap = (word_b & np.uint32(0x40000000)) != 0
    return radius * np.where(swap, cosine, sine), radius * np.where(swap, sine, cosine)


def variates(kind, particles, stream, draw, t, role, component):
    """The variates of one draw, (particles,), as float32."""
    tiles = -(-particles // 64)
    blocks = np.arange(16 * tiles, dtype=np.uint32)
    key = (stream & 0xFFFFFFFF, stream >> 32, t, int(role) << 16 | component)
    zeros = np.zeros_like(blocks)
    a, b, c, d = threefry4x32(key, (blocks, zeros + np.uint32(draw), zeros, zeros))
    if kind == "normal":
        words = [*box_muller(a, b), *box_muller(c, d)]
    elif kind == "centred":
        part = zeros + np.uint32(1)
        lows = threefry4x32(key, (blocks, zeros + np.uint32(draw), part, zeros))
        words = [centred(*pair) for pair in zip((a, b, c, d), lows, strict=True)]
    else:
        function = uniform if kind == "uniform" else exponential
        words = [function(word) for word in (a, b, c, d)]
    tiled = np.stack([word.reshape(tiles, 16) for word in words], axis=1)
    return tiled.reshape(-1)[:particles]


# --- sums in the order of compiled code -----------------------------------------------------------


def _prefix(rows):
    """Sums of the first of 16 lanes: two steps in each four lanes, and two across."""
    lanes, x = np.arange(16), rows

    def shifted(source, mask):
        return np.where(mask, x[:, np.maximum(source, 0)], single(0.0))

    x = x + shifted(lanes - 1, lanes % 4 >= 1)
    x = x + shifted(lanes - 2, lanes % 4 >= 2)
    x = x + shifted(lanes // 4 * 4 - 1, lanes >= 4)
    return x + shifted(np.where(lanes < 12, 3, 7), lanes >= 8)


def cumulative(values):
    """Running sums of float32 numbers, as float64."""
    padded = np.zeros(-(-len(values) // 16) * 16, single)
    padded[: len(values)] = values
    prefixes = _prefix(padded.reshape(-1, 16)).astype(np.float64)
    carries = np.concatenate([[0.0], np.cumsum(prefixes[:, -1])[:-1]])
    return (prefixes + carries[:, None]).ravel()[: len(values)]


def _exp2(x):
    shift = single(12582912.0)
    shifted = x + shift
    p = _polynomial(
        x - (shifted - shift),
        *(0.0013264726724487791, 0.009671512899506962, 0.05550733744505766),
        *(0.24022242079714387, 0.6931469775989006, 1.0),
    )
    return (p.view(np.int32) + (shifted.view(np.int32) << np.int32(23))).view(single)


def weights(log_weight):
    """Weights of one draw as float32, the largest 1; all 0 if no log-weight is finite."""
    finite = np.isfinite(log_weight)
    if not finite.any():
        return np.zeros(log_weight.shape, single)
    with np.errstate(invalid="ignore"):
        excess = (log_weight - log_weight[finite].max()).astype(single) * single(1.442695)
    possible = finite & (excess > single(-125.0))
    return np.where(possible, _exp2(np.where(possible, excess, single(0.0))), single(0.0))


# --- ancestors ------------------------------------------------------------------------------------


def ancestors(scheme, weight, stream, draw, key):
    """Ancestors of the particles of one draw, from weights as float32."""
    particles, sums = len(weight), cumulative(weight)
    total = sums[-1]
    if scheme == "systematic":
        shift = np.float64(variates("uniform", 1, stream, draw, key, RESAMPLING, 0)[0])
        ends = np.minimum(np.ceil(sums * (particles / total) - shift), particles).astype(int)
        return _expanded(ends, particles)
    count = particles - (scheme == "conditional")
    if scheme == "stratified":
        noise = variates("uniform", count, stream, draw, key, RESAMPLING, 0).astype(np.float64)
        points = ((np.arange(count) + noise) * (_POINTS / count)).astype(np.int64)
    else:
        points = _ascending(count, stream, draw, key)
    merged = _merged(sums, total, points)
    return np.concatenate([[0], merged]) if scheme == "conditional" else merged


def _ascending(count, stream, draw, key):
    sums = cumulative(variates("exponential", count + 1, stream, draw, key, RESAMPLING, 0))
    return np.minimum(sums[:count] * (_POINTS / sums[count]), _POINTS).astype(np.int64)


def _merged(sums, total, points):
    """For each point the number of shares that do not exceed it; the last particle has no end."""
    shares = np.minimum(sums * (_SHARES / max(total, 1e-100)), _SHARES).astype(np.int64)
    return (shares[:-1, None] <= points).sum(axis=0)


def _expanded(ends, count):
    """Ancestors of `count` particles from the position behind each particle's last child."""
    marks = np.zeros(count + 1, int)
    for particle, start in enumerate([0, *ends[:-1]]):
        marks[start] = particle
    return np.maximum.accumulate(marks[:count])
