import numpy as np
import pytest
from scipy import stats

from pfdist.kernels.noise import padded
from pfdist.kernels.resampling import RESAMPLE, WIDE, grid_ancestors, plain_ancestors

STREAM = 0x0123456789ABCDEF
SIZES = [1, 2, 15, 16, 17, 63, 64, 65, 500]
RESAMPLINGS = 1000
WEIGHTS = np.random.default_rng(5).dirichlet(np.ones(50))
schemes = pytest.mark.parametrize("scheme", RESAMPLE)
sizes = pytest.mark.parametrize("particles", SIZES)


def compiled_ancestors(scheme, weights, draw, t=3):
    count = weights.size
    guide, ancestor = np.empty((2, count + WIDE), np.int64)
    points, ends = np.empty(padded(count)), np.empty(count, np.int64)
    cumulative = np.cumsum(weights)
    RESAMPLE[scheme](cumulative, np.uint64(STREAM), draw, t, points, ends, guide, ancestor)
    return ancestor[:count]


def offspring(scheme, weights, draw):
    return np.bincount(compiled_ancestors(scheme, weights, draw), minlength=weights.size)


@schemes
@pytest.mark.parametrize(
    "weights",
    [
        np.ones(50),
        WEIGHTS,
        np.where(WEIGHTS > 0.01, WEIGHTS, 0),
        1e-300 * WEIGHTS,
        np.eye(50)[7],
        np.random.default_rng(1).random(500) ** 20,
    ],
    ids=["equal", "random", "some zero", "tiny", "one alone", "few of many"],
)
def test_compiled_and_plain_ancestors_agree(scheme, weights):
    for draw in range(100):
        plain = plain_ancestors(scheme, np.cumsum(weights), STREAM, draw, 3)
        np.testing.assert_array_equal(compiled_ancestors(scheme, weights, draw), plain)


@schemes
@sizes
@pytest.mark.parametrize(("draw", "t"), [(0, 0), (3, 60), (2**32 - 1, 32_000)])
def test_any_number_of_particles_and_any_key(scheme, particles, draw, t):
    weights = np.random.default_rng(particles).random(particles)
    plain = plain_ancestors(scheme, np.cumsum(weights), STREAM, draw, t)
    np.testing.assert_array_equal(compiled_ancestors(scheme, weights, draw, t), plain)


@schemes
@pytest.mark.parametrize(("draw", "t"), [(1, 0), (0, 1)])
def test_another_draw_or_time_has_other_ancestors(scheme, draw, t):
    first = compiled_ancestors(scheme, WEIGHTS, 0, 0)
    assert (compiled_ancestors(scheme, WEIGHTS, draw, t) != first).any()


def test_an_ancestor_is_the_first_whose_cumulative_weight_exceeds_the_point():
    # Cumulative weights 0, 1, 2, 2, 4, 4; the grid's points times their total: shift * 2/3 + these
    # 0, 2/3, 4/3, 2, 8/3, 10/3.
    weights = np.array([0.0, 1.0, 1.0, 0.0, 2.0, 0.0])
    ends, ancestor = np.empty(6, np.int64), np.empty(6 + WIDE, np.int64)
    for shift, expected in ((0.1, [1, 1, 2, 4, 4, 4]), (0.9, [1, 2, 2, 4, 4, 4])):
        grid_ancestors(np.cumsum(weights), shift, ends, ancestor)
        assert ancestor[:6].tolist() == expected


@pytest.mark.parametrize("shift", [0.0, 2.0**-33, 0.5, 1 - 2.0**-33])
def test_every_point_of_the_grid_has_an_ancestor_at_the_ends_of_the_shift(shift):
    for seed in range(200):
        weights = np.random.default_rng(seed).random(37) ** 8
        ends, ancestor = np.full(37, -1), np.full(37 + WIDE, -1)
        grid_ancestors(np.cumsum(weights), shift, ends, ancestor)
        assert ends[-1] == 37
        assert (np.diff(ancestor[:37]) >= 0).all()
        assert ancestor[0] >= 0
        assert ancestor[36] <= 36


def test_multinomial_offspring_are_multinomial_in_the_weights():
    counts = sum(offspring("multinomial", WEIGHTS, draw) for draw in range(RESAMPLINGS))
    expected = RESAMPLINGS * WEIGHTS.size * WEIGHTS
    assert stats.chisquare(counts, expected).pvalue > 1e-3


def test_multinomial_offspring_vary_as_multinomial_counts():
    counts = np.array([offspring("multinomial", WEIGHTS, draw) for draw in range(RESAMPLINGS)])
    variance, excess = stats.binom(WEIGHTS.size, WEIGHTS).stats("vk")
    error = variance * np.sqrt((excess + 2) / RESAMPLINGS)  # standard error of a sample variance
    assert (np.abs(counts.var(axis=0) - variance) < 5 * error).all()


def test_systematic_offspring_are_the_expected_number_rounded_down_or_up():
    expected = WEIGHTS.size * WEIGHTS
    counts = np.array([offspring("systematic", WEIGHTS, draw) for draw in range(RESAMPLINGS)])
    assert (np.floor(expected) <= counts).all()
    assert (counts <= np.ceil(expected)).all()
    # A count is one of two neighbours, so its variance is at most 1/4; 5 standard errors.
    assert np.abs(counts.mean(axis=0) - expected).max() < 5 * 0.5 / np.sqrt(RESAMPLINGS)


@sizes
def test_systematic_keeps_each_of_equal_particles_once(particles):
    for draw in range(100):
        assert (offspring("systematic", np.ones(particles), draw) == 1).all()


@schemes
@pytest.mark.parametrize("dominant", [0, 20, 49])
def test_a_particle_with_all_the_weight_has_all_the_offspring(scheme, dominant):
    weights = np.full(50, 1e-300)
    weights[dominant] = 1.0
    for draw in range(100):
        assert offspring(scheme, weights, draw)[dominant] == 50


@schemes
def test_particles_of_zero_weight_have_no_offspring(scheme):
    zero = np.isin(np.arange(50), [0, 1, 20, 21, 48, 49])
    for draw in range(RESAMPLINGS):
        assert not offspring(scheme, np.where(zero, 0.0, WEIGHTS), draw)[zero].any()


@schemes
def test_one_particle_is_its_own_ancestor(scheme):
    assert all(offspring(scheme, np.array([0.3]), draw) == 1 for draw in range(100))
