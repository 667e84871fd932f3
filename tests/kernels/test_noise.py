"""Noise against its cipher's published answers, its plain twin and its distributions."""

from functools import cache
from itertools import combinations, product

import numpy as np
import pytest
from numba import njit
from scipy import stats

from pfdist.common.streams import stream_key
from pfdist.kernels import noise
from pfdist.kernels.noise import (
    FILL,
    LANES,
    TILE,
    filler,
    generator,
    padded,
    threefry4x32,
    variates,
)

KINDS = tuple(FILL)
DISTRIBUTIONS = {
    "normal": stats.norm(),
    "uniform": stats.uniform(),
    "centred": stats.uniform(-0.5, 1),
    "exponential": stats.expon(),
}
STREAM = 0x0123456789ABCDEF
WORDS = 2**32

# Random123, kat_vectors, threefry4x32 with 13 rounds: counter, key, expected.
ONES = [0xFFFFFFFF] * 4
KNOWN_ANSWERS = {
    "zeros": ([0] * 4, [0] * 4, [0x531C7E4F, 0x39491EE5, 0x2C855A92, 0x3D6ABF9A]),
    "ones": (ONES, ONES, [0xC4189358, 0x1C9CC83A, 0xD5881C67, 0x6A0A89E0]),
    "pi": (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0, 0x082EFA98, 0xEC4E6C89],
        [0x4AA71D8F, 0x734738C2, 0x431FC6A8, 0xAE6DEBF1],
    ),
}


@njit
def compiled_threefry(k, c):
    return threefry4x32(k[0], k[1], k[2], k[3], c[0], c[1], c[2], c[3])


def filled(kind, particles, stream=STREAM, draw=0, t=0, role=0, component=0):
    out = np.empty((1, padded(particles)), np.float32)
    FILL[kind](out, 0, particles, np.uint64(stream), draw, t, role, component)
    return out[0, :particles]


@cache
def cloud(kind, **key):
    """(draws, particles): 2048 draws of 512 particles, 2^20 values."""
    return np.stack([filled(kind, 512, draw=d, **key) for d in range(2048)]).astype(np.float64)


@pytest.mark.parametrize("vector", KNOWN_ANSWERS)
def test_threefry_gives_the_published_answers(vector):
    counter, key, expected = (np.array(part, np.uint32) for part in KNOWN_ANSWERS[vector])
    plain = threefry4x32(*key[:, None], *counter[:, None])
    assert np.concatenate(plain).tolist() == expected.tolist()
    assert list(compiled_threefry(key, counter)) == expected.tolist()


def test_noise_is_threefry_of_the_key_that_is_documented():
    draw, t, role, component = 11, 7, 4, 2
    block = np.arange(2 * LANES, dtype=np.uint32)  # two tiles
    key = [STREAM % WORDS, STREAM // WORDS, draw, t]
    counter = [block, *(np.full_like(block, part) for part in (component, role, 0))]
    words = threefry4x32(*(np.full_like(block, part) for part in key), *counter)
    expected = [
        (word[lanes] // 512 + 0.5) / 2**23 for lanes in np.split(block, 2) for word in words
    ]
    given = variates("uniform", 2 * TILE, STREAM, draw, t, role, component)
    np.testing.assert_array_equal(given, np.concatenate(expected))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("particles", [1, 63, 64, 65, 500])
@pytest.mark.parametrize("key", [(STREAM, 3, 2, 1, 0), (2**64 - 1, WORDS - 1, 32_000, 5, 7)])
def test_compiled_and_plain_noise_agree_to_the_last_bit(kind, particles, key):
    plain = variates(kind, particles, *key)
    given = filled(kind, particles, *key)
    np.testing.assert_array_equal(plain, plain.astype(np.float32))  # no bit beyond float32
    assert plain.astype(np.float32).tobytes() == given.tobytes()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("particles", [1, 65])
def test_filling_writes_one_row_as_far_as_it_is_padded(kind, particles):
    out = np.full((3, padded(particles) + 8), -7, np.float32)
    FILL[kind](out, 1, particles, np.uint64(STREAM), 0, 0, 0, 0)
    written = np.zeros(out.shape, np.bool_)
    written[1, : padded(particles)] = True
    np.testing.assert_array_equal(out != -7, written)  # a variate is -7 once in 10^12


@pytest.mark.parametrize("kind", KINDS)
def test_variates_of_many_draws_are_those_of_each(kind):
    draws = np.array([0, 5, 6, WORDS - 1])
    together = variates(kind, 70, STREAM, draws, 2, 3, 4)
    apart = [variates(kind, 70, STREAM, int(draw), 2, 3, 4) for draw in draws]
    np.testing.assert_array_equal(together, apart)


@pytest.mark.parametrize("kind", KINDS)
def test_a_particle_has_its_variate_whatever_the_number_of_particles(kind):
    many = variates(kind, 500, STREAM, 1, 2, 3, 4)
    np.testing.assert_array_equal(variates(kind, 100, STREAM, 1, 2, 3, 4), many[:100])


@pytest.mark.parametrize(
    "kinds", [(), ("uniform",), ("normal", "uniform", "normal"), ("centred", "normal", "uniform")]
)
def test_filler_gives_each_component_its_kind_and_its_key(kinds):
    out = np.zeros((4, padded(70)), np.float32)
    filler(kinds)(out, 70, np.uint64(STREAM), 1, 2, 3)
    for component, kind in enumerate(kinds):
        expected = variates(kind, 70, STREAM, 1, 2, 3, component)
        np.testing.assert_array_equal(out[component, :70], expected)
    assert not out[len(kinds) :].any()


@pytest.mark.parametrize("kind", KINDS)
def test_moments_are_those_of_the_distribution(kind):
    values = cloud(kind).ravel()
    n = values.size
    mean, variance, skewness, kurtosis = (float(m) for m in DISTRIBUTIONS[kind].stats("mvsk"))
    # Standard errors of mean and variance, by the central moments 2 and 4; 5 of them.
    assert abs(values.mean() - mean) < 5 * np.sqrt(variance / n)
    assert abs(values.var() - variance) < 5 * variance * np.sqrt((kurtosis + 2) / n)
    # The same for the mean of the standardised cubes, by the moments 6 and 3.
    cubes = (values - mean) ** 3 / variance**1.5
    sixth = {"normal": 15, "uniform": 27 / 7, "centred": 27 / 7, "exponential": 265}[kind]
    assert abs(cubes.mean() - skewness) < 5 * np.sqrt((sixth - skewness**2) / n)


def test_normals_have_the_kurtosis_of_the_normal():
    z = cloud("normal").ravel()
    assert abs(stats.kurtosis(z)) < 5 * np.sqrt(24 / z.size)


@pytest.mark.parametrize("kind", KINDS)
def test_kolmogorov_smirnov_does_not_reject_the_distribution(kind):
    given = cloud(kind)[:400].ravel()
    assert stats.kstest(given, DISTRIBUTIONS[kind].cdf).pvalue > 1e-3


def assert_uncorrelated(a, b):
    limit = 5 / np.sqrt(a.size)  # a correlation of n independent pairs has standard error n^-1/2
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < limit
    assert abs(np.corrcoef(a.ravel() ** 2, b.ravel() ** 2)[0, 1]) < limit


@pytest.mark.parametrize(
    "key",
    [{"stream": STREAM + 1}, {"stream": STREAM + WORDS}, {"t": 1}, {"role": 1}, {"component": 1}],
    ids=str,
)
def test_neighbouring_keys_are_uncorrelated(key):
    assert_uncorrelated(cloud("normal"), cloud("normal", **key))


def test_neighbouring_draws_are_uncorrelated():
    assert_uncorrelated(cloud("normal")[:-1], cloud("normal")[1:])


# Within a tile the four words of a block, two of which share a radius, lie LANES apart.
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("lag", [1, LANES, 2 * LANES, 3 * LANES, TILE])
def test_neighbouring_particles_are_uncorrelated(kind, lag):
    assert_uncorrelated(cloud(kind)[:, :-lag], cloud(kind)[:, lag:])


EXTREME = np.array([0, 1, 2**31 - 1, 2**31, WORDS - 2, WORDS - 1], np.uint32)


def test_uniforms_lie_strictly_inside_the_unit_interval_for_every_word():
    np.testing.assert_array_equal(
        noise._uniform(EXTREME[[0, -1]]).astype(np.float64), [2.0**-24, 1 - 2.0**-24]
    )


def test_centred_noise_is_never_0_and_reaches_2_to_the_minus_65_on_both_sides():
    high, low = np.array([0, 1, 2, WORDS - 1], np.uint32), np.array([0, 0, 0, WORDS - 1], np.uint32)
    expected = [2.0**-65, -(2.0**-65), 2.0**-32, -0.5]
    np.testing.assert_array_equal(noise._centred(high, low).astype(np.float64), expected)


def test_few_centred_variates_lie_near_0_and_as_many_as_a_uniform_distribution_has():
    near = np.abs(cloud("centred").ravel())
    for width in (2.0**-10, 2.0**-14, 2.0**-17):  # 2^20 variates: 2048, 128 and 16 are expected
        expected = 2 * width * near.size
        assert abs((near < width).sum() - expected) < 5 * np.sqrt(expected)
    assert np.unique(near).size > 0.9 * near.size  # they are finer than 2^-23


def test_exponentials_are_positive_and_finite_for_every_word():
    # The largest u is 1 - 2^-24, the smallest 2^-33. A zero would make two points one.
    smallest, largest = noise._exponential(EXTREME[[-1, 0]]).tolist()
    assert smallest == pytest.approx(2.0**-24, rel=1e-6)
    assert largest == pytest.approx(33 * np.log(2), rel=1e-6)


def test_normals_are_finite_for_extreme_words():
    a, b = np.array(list(product(EXTREME, EXTREME)), np.uint32).T
    # The smallest u is 2^-33, so no radius exceeds sqrt(2 * 33 ln 2) = 6.7637.
    assert np.abs(noise._box_muller(a, b)).max() < 6.764


def test_polynomials_are_the_functions_they_stand_for():
    w = np.concatenate([EXTREME, np.random.default_rng(1).integers(WORDS, size=10**6)])
    w = w.astype(np.uint32)
    unit = 2.0**-24  # half a unit in the last place of a float32 in [1, 2)
    exact = -np.log((w + 0.5) / WORDS)
    # A unit each: u is rounded, and a little less than it should be (2^-24 of it); the sum is
    # rounded; and the polynomial has its own error.
    assert (np.abs(noise._exponential(w) - exact) < 4 * unit * np.maximum(1, exact)).all()
    angle = np.pi * w.view(np.int32) / 2**31
    for value, exact in zip(noise._sine_cosine(w), (np.sin(angle), np.cos(angle)), strict=True):
        # Rounded: the angle, up to pi units, and the operations after it, about a unit each.
        assert np.abs(value - exact).max() < 8 * unit


def test_stream_key_is_pinned():
    # printf '[2020,"search","genetic",3,[0,5,60]]' | b2sum -l 64, little-endian
    expected = int.from_bytes(bytes.fromhex("ebe23d694ebe207d"), "little")
    assert stream_key(2020, "search", "genetic", 3, (0, 5, 60)) == expected


def test_different_parts_give_different_streams():
    parts = [(1,), ("1",), (1, 1), (11,), ("a", "bc"), ("ab", "c"), ([1, 2], 3), (1, [2, 3]), ()]
    assert all(stream_key(*a) != stream_key(*b) for a, b in combinations(parts, 2))


def test_generator_repeats_for_the_same_parts_only():
    first, again, other = (generator(1, "search", g).random(4).tolist() for g in (0, 0, 1))
    assert first == again != other
