"""Noise on vectors: the published cipher, the bits of plain NumPy, and the right distributions."""

import numpy as np
import pytest
from scipy import stats

from oracles import keyed
from oracles.in_turn import in_turn
from pfdist.kernels.variates import FILTER_PROCESS, KINDS, TRUTH_INITIAL, variates

STREAM = 0x0123456789ABCDEF
# The published vectors of Threefry-4x32 with 13 rounds (Random123): counter, key, result
PUBLISHED = (
    ((0,) * 4, (0,) * 4, (0x531C7E4F, 0x39491EE5, 0x2C855A92, 0x3D6ABF9A)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 4, (0xC4189358, 0x1C9CC83A, 0xD5881C67, 0x6A0A89E0)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0, 0x082EFA98, 0xEC4E6C89),
        (0x4AA71D8F, 0x734738C2, 0x431FC6A8, 0xAE6DEBF1),
    ),
)
DISTRIBUTIONS = {
    "normal": stats.norm(),
    "uniform": stats.uniform(),
    "centred": stats.uniform(-0.5),
    "exponential": stats.expon(),
}


@pytest.mark.parametrize(("counter", "key", "words"), PUBLISHED)
def test_the_reference_has_the_published_words(counter, key, words):
    assert tuple(map(int, keyed.threefry4x32(key, counter))) == words


@in_turn("kind", KINDS)
@in_turn("particles", [1, 15, 16, 17, 64, 100, 1000])
def test_compiled_noise_has_the_bits_of_the_reference(kind, particles):
    arguments = STREAM, 7, 3, FILTER_PROCESS, 2
    expected = keyed.variates(kind, particles, *arguments)
    np.testing.assert_array_equal(variates(kind, particles, *arguments), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_depends_on_each_number_of_its_key_and_on_nothing_else(kind):
    """Neither on the number of particles, nor on other draws (idea 1 of the design)."""
    first = variates(kind, 100, STREAM, 7, 3, FILTER_PROCESS, 2)
    together = variates(kind, 400, STREAM, np.array([5, 7, 9]), 3, FILTER_PROCESS, 2)
    np.testing.assert_array_equal(together[1, :100], first)
    for changed in (
        (STREAM + 1, 7, 3, FILTER_PROCESS, 2),
        (STREAM + 2**32, 7, 3, FILTER_PROCESS, 2),
        (STREAM, 8, 3, FILTER_PROCESS, 2),
        (STREAM, 7, 4, FILTER_PROCESS, 2),
        (STREAM, 7, 3, TRUTH_INITIAL, 2),
        (STREAM, 7, 3, FILTER_PROCESS, 3),
    ):
        assert not np.intersect1d(variates(kind, 100, *changed), first).size > 1


@pytest.mark.parametrize("kind", KINDS)
def test_noise_has_its_distribution(kind):
    """Kolmogorov-Smirnov with 600,000 variates of a stream that no other test uses."""
    values = variates(kind, 20_000, 20_261_125, np.arange(30), 1, FILTER_PROCESS, 0).ravel()
    assert stats.kstest(values, DISTRIBUTIONS[kind].cdf).pvalue > 1e-4


def test_neighbouring_normals_are_independent():
    """Correlations of pairs and of squares of pairs, 4 standard errors."""
    values = variates("normal", 20_000, 4_711, np.arange(50), 1, FILTER_PROCESS, 0)
    for distance in (1, 16, 32, 64):
        for a, b in ((values, values), (values**2 - 1, values**2 - 1), (values, values**2 - 1)):
            products = a[:, distance:] * b[:, :-distance]
            assert abs(products.mean()) < 4 * products.std() / products.size**0.5


def test_the_polynomials_of_the_reference_have_small_errors():
    """The compiled noise has the bits of the reference; the exact values are those of float64."""
    words = np.random.default_rng(5).integers(0, 2**32, 200_000).astype(np.uint32)
    words[:3] = 0, 1, 2**32 - 1
    got = keyed.exponential(words).astype(float)
    assert got.min() > 0.0
    np.testing.assert_allclose(got, -np.log((words + 0.5) * 2.0**-32), rtol=1.2e-7, atol=5e-7)
    half = np.full(words.size, np.uint32(2**31))
    radius = np.sqrt(2.0 * keyed.exponential(half).astype(float))
    sine, cosine = (each / radius for each in keyed.box_muller(half, words))
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0, rtol=3e-6)
