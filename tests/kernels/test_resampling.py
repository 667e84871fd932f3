import numpy as np
import pytest
from scipy import stats

from pfdist.kernels.noise import padded
from pfdist.kernels.resampling import POINTS, ancestors, plain_ancestors, plain_points

STREAM = 0x0123456789ABCDEF
SIZES = [1, 2, 63, 64, 500]
RESAMPLINGS = 1000
WEIGHTS = np.random.default_rng(5).dirichlet(np.ones(50))
schemes = pytest.mark.parametrize("scheme", POINTS)
sizes = pytest.mark.parametrize("particles", SIZES)


def compiled_points(scheme, particles, draw, t=3):
    points, buffer = np.empty(particles), np.empty(padded(particles + 1), np.float32)
    POINTS[scheme](points, buffer, np.uint64(STREAM), draw, t)
    return points


def compiled_ancestors(weights, points):
    chosen = np.empty(points.size, np.int64)
    ancestors(np.cumsum(weights), points, chosen)
    return chosen


def offspring(scheme, weights, draw):
    chosen = compiled_ancestors(weights, compiled_points(scheme, weights.size, draw))
    return np.bincount(chosen, minlength=weights.size)


@schemes
@sizes
def test_points_are_sorted_and_lie_inside_the_unit_interval(scheme, particles):
    for draw in range(100):
        points = compiled_points(scheme, particles, draw)
        assert (np.diff(points) >= 0).all()
        assert points[0] > 0
        assert points[-1] < 1


@schemes
@sizes
@pytest.mark.parametrize(("draw", "t"), [(0, 0), (3, 60), (2**32 - 1, 32_000)])
def test_compiled_and_plain_points_agree_to_the_last_bit(scheme, particles, draw, t):
    plain = plain_points(scheme, particles, STREAM, draw, t)
    np.testing.assert_array_equal(compiled_points(scheme, particles, draw, t), plain)


@schemes
@pytest.mark.parametrize(("draw", "t"), [(1, 0), (0, 1)])
def test_another_draw_or_time_has_other_points(scheme, draw, t):
    assert (compiled_points(scheme, 50, draw, t) != compiled_points(scheme, 50, 0, 0)).all()


@pytest.mark.parametrize(
    "weights",
    [np.ones(50), WEIGHTS, np.where(WEIGHTS > 0.01, WEIGHTS, 0), 1e-300 * WEIGHTS, np.eye(50)[7]],
    ids=["equal", "random", "some_zero", "tiny", "one_alone"],
)
def test_compiled_and_plain_ancestors_agree(weights):
    for draw in range(100):
        points = compiled_points("multinomial", weights.size, draw)
        plain = plain_ancestors(np.cumsum(weights), points)
        np.testing.assert_array_equal(compiled_ancestors(weights, points), plain)


@pytest.mark.parametrize("merge", [compiled_ancestors, lambda w, u: plain_ancestors(w.cumsum(), u)])
def test_ancestor_is_the_first_whose_cumulative_weight_exceeds_the_point(merge):
    # Cumulative weights 0, 1, 2, 2, 4, 4; points times their total 0.8, 1, 1, 2, 3.6.
    weights = np.array([0.0, 1.0, 1.0, 0.0, 2.0, 0.0])
    points = np.array([0.2, 0.25, 0.25, 0.5, 0.9])
    assert merge(weights, points).tolist() == [1, 2, 2, 4, 4]


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


@pytest.mark.parametrize(("draw", "particles"), [(470_478, 9), (640_661, 36), (2_618_307, 16)])
def test_points_stay_inside_where_the_last_exponential_is_least(draw, particles):
    # With these keys the last exponential's word is one of the 128 highest.
    points, buffer = np.empty(particles), np.empty(padded(particles + 1), np.float32)
    POINTS["multinomial"](points, buffer, np.uint64(0), draw, 0)
    assert buffer[particles] < 1e-7
    assert points[-1] < 1
