"""Resampling against its plain twin, and against the laws of its offspring counts."""

from functools import cache

import numpy as np
import pytest
from scipy import stats

from pfdist.kernels.noise import padded
from pfdist.kernels.resampling import (
    RESAMPLE,
    SPARE,
    ResamplingScratch,
    expanded,
    merged_ancestors,
    plain_ancestors,
)
from pfdist.kernels.schemes import SCHEMES

STREAM = 0x0123456789ABCDEF
SIZES = [1, 2, 3, 4, 5, 15, 16, 17, 63, 64, 65, 500, 1000]
RESAMPLINGS = 2000
GUARD = 99
RNG = np.random.default_rng(5)
WEIGHTS = RNG.dirichlet(np.ones(50))
EXPECTED = WEIGHTS.size * WEIGHTS
MANY = {
    "equal": np.ones(50),
    "random": WEIGHTS,
    "some zero": np.where(WEIGHTS > 0.01, WEIGHTS, 0),
    "tiny": 1e-30 * WEIGHTS,
    "one alone": np.eye(50)[7],
    "few of many": RNG.random(500) ** 20,
    "ties": RNG.choice([0.0, 0.25, 0.5, 0.75, 1.0], 300),
    "over all magnitudes": np.exp(-87 * RNG.random(500)),
}
schemes = pytest.mark.parametrize("scheme", SCHEMES)  # `tests/filters/test_conditional.py` has more
sizes = pytest.mark.parametrize("particles", SIZES)


def guarded(length, kind):
    """An array and what it lies in, whose ends must stay as they are."""
    around = np.full(length + 2 * padded(1), GUARD, kind)
    return around[padded(1) : -padded(1)], around


def untouched(*arounds):
    ends = slice(None, padded(1)), slice(-padded(1), None)
    return all((around[end] == GUARD).all() for around in arounds for end in ends)


def compiled_ancestors(scheme, weight, draw, t=3):
    """With arrays that are exactly as long as they must be."""
    count = weight.size
    cumulative, *around = guarded(count, np.float64)
    scratch = []
    for kind in (np.float32, np.float64, np.uint32, np.uint32):
        array, outside = guarded(padded(count + SPARE), kind)
        scratch.append(array)
        around.append(outside)
    ancestor, outside = guarded(count + SPARE, np.uint32)
    cumulative[:] = np.cumsum(weight)
    noise, *others = scratch
    arrays = ResamplingScratch(cumulative, noise[None], *others, ancestor)
    RESAMPLE[scheme](arrays, count, np.uint64(STREAM), draw, t)
    assert untouched(*around, outside)
    return ancestor[:count]


def offspring(scheme, weight, draw):
    return np.bincount(compiled_ancestors(scheme, weight, draw), minlength=weight.size)


@cache
def counts_of(scheme):
    """Offspring of WEIGHTS, (resamplings, particles)."""
    return np.array([offspring(scheme, WEIGHTS, draw) for draw in range(RESAMPLINGS)])


@schemes
@pytest.mark.parametrize("name", MANY)
def test_compiled_and_plain_ancestors_agree(scheme, name):
    for draw in range(100):
        plain = plain_ancestors(scheme, MANY[name], STREAM, draw, 3)
        np.testing.assert_array_equal(compiled_ancestors(scheme, MANY[name], draw), plain)


@schemes
@sizes
@pytest.mark.parametrize(("draw", "t"), [(0, 0), (3, 60), (2**32 - 1, 32_000)])
def test_any_number_of_particles_and_any_key(scheme, particles, draw, t):
    rng = np.random.default_rng(particles)
    first, last = np.eye(particles)[[0, -1]]
    for weight in (rng.random(particles), rng.random(particles) ** 20, first, last):
        plain = plain_ancestors(scheme, weight, STREAM, draw, t)
        np.testing.assert_array_equal(compiled_ancestors(scheme, weight, draw, t), plain)


@schemes
def test_plain_ancestors_of_many_draws_are_those_of_each(scheme):
    weight = np.random.default_rng(1).random((3, 20))
    apart = [plain_ancestors(scheme, w, STREAM, 7 + d, 3) for d, w in enumerate(weight)]
    np.testing.assert_array_equal(plain_ancestors(scheme, weight, STREAM, range(7, 10), 3), apart)


@schemes
@pytest.mark.parametrize(("draw", "t"), [(1, 0), (0, 1)])
def test_another_draw_or_time_has_other_ancestors(scheme, draw, t):
    first = compiled_ancestors(scheme, WEIGHTS, 0, 0)
    assert (compiled_ancestors(scheme, WEIGHTS, draw, t) != first).any()


# --- the laws of the offspring counts ---


# Offspring are a sum of independent Bernoulli variates, whose probabilities are: of each point, to
# hit the particle. (particles, variates)


def in_each_stratum():
    upper = np.cumsum(EXPECTED)[:, None]
    low = np.arange(WEIGHTS.size)
    overlap = np.minimum(upper, low + 1) - np.maximum(upper - EXPECTED[:, None], low)
    return np.clip(overlap, 0, 1)


REST = EXPECTED % 1
LEFT = round(REST.sum())
PROBABILITIES = {
    "multinomial": np.tile(WEIGHTS[:, None], WEIGHTS.size),
    "stratified": in_each_stratum(),
    "systematic": REST[:, None],
    "residual": np.tile(REST[:, None] / LEFT, LEFT),
    "sorted_systematic": REST[:, None],  # of particles that stand in line already
}


@schemes
def test_offspring_have_the_mean_and_the_variance_of_the_scheme(scheme):
    each = PROBABILITIES[scheme] * (1 - PROBABILITIES[scheme])
    variance, fourth_cumulant = each.sum(axis=1), (each * (1 - 6 * each)).sum(axis=1)
    error = counts_of(scheme) - EXPECTED
    limit = 5 * np.sqrt(variance / RESAMPLINGS)
    assert (np.abs(error.mean(axis=0)) < limit).all()
    # The variance of a square is the fourth cumulant and twice the squared variance.
    limit = 5 * np.sqrt((fourth_cumulant + 2 * variance**2) / RESAMPLINGS)
    assert (np.abs((error**2).mean(axis=0) - variance) < limit).all()


def test_multinomial_offspring_are_multinomial_in_the_weights():
    counts = counts_of("multinomial").sum(axis=0)
    assert stats.chisquare(counts, RESAMPLINGS * EXPECTED).pvalue > 1e-3


@pytest.mark.parametrize("scheme", ["systematic", "sorted_systematic"])
def test_systematic_offspring_are_the_expected_number_rounded_down_or_up(scheme):
    counts = counts_of(scheme)
    assert (np.floor(EXPECTED) <= counts).all()
    assert (counts <= np.ceil(EXPECTED)).all()


def test_stratified_offspring_are_less_than_two_from_the_expected_number():
    # A particle has each point of the intervals inside its weight; at either end it reaches into
    # one more interval, whose point it has or not.
    assert (np.abs(counts_of("stratified") - EXPECTED) < 2).all()


def test_residual_offspring_are_at_least_the_expected_number_rounded_down():
    assert (np.floor(EXPECTED) <= counts_of("residual")).all()


def test_residual_offspring_are_at_least_the_expected_number_that_is_whole():
    weight = np.full(64, 49 / 64)
    weight[:2] = 1, 34 / 64  # the sum is 49: 62 particles are expected to have one child
    assert (offspring("residual", weight, 0)[2:] >= 1).all()


@sizes
@pytest.mark.parametrize("scheme", ["stratified", "systematic", "residual", "sorted_systematic"])
def test_each_of_equal_particles_is_kept_once(scheme, particles):
    for draw in range(50):
        assert (offspring(scheme, np.ones(particles), draw) == 1).all()


@schemes
@pytest.mark.parametrize("dominant", [0, 20, 49])
def test_a_particle_with_all_the_weight_has_all_the_offspring(scheme, dominant):
    weight = np.full(50, 1e-300)
    weight[dominant] = 1.0
    for draw in range(100):
        assert offspring(scheme, weight, draw)[dominant] == 50


@schemes
def test_particles_of_zero_weight_have_no_offspring(scheme):
    zero = np.isin(np.arange(50), [0, 1, 20, 21, 48, 49])
    for draw in range(500):
        assert not offspring(scheme, np.where(zero, 0.0, WEIGHTS), draw)[zero].any()


@schemes
@sizes
def test_without_any_weight_ancestors_are_particles_all_the_same(scheme, particles):
    # The compiled filter leaves the draw before that; the plain one goes on with the others.
    for ancestors in (
        plain_ancestors(scheme, np.zeros(particles), STREAM, 0, 3),
        compiled_ancestors(scheme, np.zeros(particles), 0),
    ):
        assert ancestors.shape == (particles,)
        assert np.isin(ancestors, np.arange(particles)).all()


# --- the pieces ---


@pytest.mark.parametrize("whole", [False, True], ids=["apart", "many points on a weight"])
@pytest.mark.parametrize("particles", [1, 2, 3, 5, 64, 100, 500])
def test_a_point_belongs_to_the_first_particle_whose_cumulative_weight_exceeds_it(particles, whole):
    for count in (1, 2, 3, 7, 64, 100, 501):
        rng = np.random.default_rng(particles + count)
        weight = rng.integers(0, 3 if whole else 2**32 // particles, particles)
        shares, around_c = guarded(particles + SPARE, np.uint32)
        shares[:particles] = np.cumsum(weight)
        shares[particles - 1] += 1  # the last one lies above every point
        points, around_p = guarded(count + SPARE, np.uint32)
        points[:count] = np.sort(rng.integers(0, shares[particles - 1], count))
        ancestor, around_a = guarded(count + SPARE, np.uint32)
        expected = np.searchsorted(shares[:particles], points[:count], side="right")
        merged_ancestors(shares, particles, points, count, ancestor)
        np.testing.assert_array_equal(ancestor[:count], expected, err_msg=f"{count} points")
        assert untouched(around_c, around_p, around_a)


@pytest.mark.parametrize("childless", [0.0, 0.5, 0.95])
@sizes
def test_each_particle_is_said_as_often_as_it_has_children(particles, childless):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        children = rng.poisson(2, particles) * (rng.random(particles) >= childless)
        count = int(children.sum())
        ends, around_e = guarded(particles, np.uint32)
        ends[:] = np.cumsum(children)
        marks, around_m = guarded(count + 1, np.float32)
        ancestor, around_a = guarded(count, np.uint32)
        expanded(ends, particles, count, marks[None], ancestor)
        np.testing.assert_array_equal(ancestor, np.repeat(np.arange(particles), children))
        assert untouched(around_e, around_m, around_a)
