"""Sets that share their first times share their cloud: the same bits, for less work."""

import math
from dataclasses import replace

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist import StateSpaceModel, load_model, where
from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.prefixes import plan_prefixes

HORIZON = 12
UNGM, BEARINGS = load_model("ungm"), load_model("bearings_only")
DEGENERATE = replace(
    UNGM,
    log_likelihood=lambda y, x, t, p: where(y[0] > 20.0, -math.inf, -0.5 * (y[0] - x[0]) ** 2),
)
INFINITE = replace(
    UNGM,
    quantity_of_interest=lambda x, t, p: (where(abs(x[0]) > 22.0, math.inf, x[0]),),
)


def random_sets(count: int, seed: int) -> list[tuple[int, ...]]:
    rng = np.random.default_rng(seed)
    masks = rng.random((count, HORIZON + 1)) < rng.random((count, 1))
    return [tuple(np.flatnonzero(mask).tolist()) for mask in masks]


SETS = [*random_sets(40, seed=0), (), tuple(range(HORIZON + 1)), (12,), (0,), (12,)]


@pytest.mark.parametrize(
    ("model", "believed"),
    [
        pytest.param(UNGM, DEGENERATE, id="degenerate"),
        pytest.param(UNGM, INFINITE, id="infinite", marks=pytest.mark.slow),
        pytest.param(BEARINGS, BEARINGS, id="bearings", marks=pytest.mark.slow),
    ],
)
def test_together_they_are_bit_for_bit_as_one_by_one(
    model: StateSpaceModel, believed: StateSpaceModel
) -> None:
    ends = believed is not model  # a draw that ended has ended for all that share it
    draws = simulate(model, HORIZON, range(60 if ends else 5), 3)
    given = [HORIZON] * len(SETS), 9, Estimation(70)
    together, degenerate, *_ = filter_checked_sets(believed, draws, SETS, *given)
    alone = [filter_draws(believed, draws, times, 70, 9) for times in SETS]
    np.testing.assert_array_equal(together, np.stack([each.mse for each in alone], axis=1))
    np.testing.assert_array_equal(degenerate, np.stack([each.degenerate for each in alone], axis=1))
    assert not np.isnan(together).any()
    if ends:
        ended = degenerate if believed is DEGENERATE else np.isinf(together)
        assert 0.02 < ended.mean() < 0.98


@in_turn("seed", range(20))
@in_turn("with_ends", [False, True])
def test_every_distinct_prefix_is_walked_once(with_ends: bool, seed: int) -> None:
    sets, instants = random_sets(30, seed), HORIZON + 1
    rng = np.random.default_rng(seed)
    ends = [instants] * len(sets)
    if with_ends:
        ends = [int(rng.integers(max(times, default=0) + 1, instants + 1)) for times in sets]
    planned, place, _ = plan_prefixes(tuple(sets), instants, tuple(ends))
    words = [tuple(t in times for t in range(end)) for times, end in zip(sets, ends, strict=True)]
    ordered = list(zip(planned.measured[:, :, 0], planned.ends, strict=True))  # one byte
    assert [tuple(row[:end].tolist()) for row, end in (ordered[k] for k in place)] == words
    prefixes = {word[: t + 1] for word in words for t in range(len(word))}
    assert (planned.ends - planned.begins).sum() == len(prefixes)
    # The state from which a set goes on is in its place: a set with the same times before has
    # kept it there, and no other has overwritten it.
    kept: dict[int, tuple[bool, ...]] = {}
    for index, (row, end) in enumerate(ordered):
        begin = int(planned.begins[index])
        if begin > 0:
            assert kept[int(planned.sources[index])] == tuple(row[:begin].tolist())
        own = slice(*planned.first_stops[index : index + 2])
        stops, slots = planned.stops[own].tolist(), planned.slots[own].tolist()
        assert stops == sorted(set(stops))
        assert stops[-1] == end
        for stop, slot in zip(stops, slots, strict=True):
            assert stop > begin or (slot, stop) == (-1, end)
            if slot >= 0:
                kept[slot] = tuple(row[:stop].tolist())
    assert len(kept) <= planned.clouds


def test_what_is_wanted_up_to_an_end_is_the_sum_of_the_errors_up_to_there() -> None:
    model, times = UNGM, (0, 3, 7)
    draws = simulate(model, HORIZON, range(5), 3)
    estimate = filter_draws(model, draws, times, 70, 9, trajectories=True).estimate
    assert estimate is not None
    errors = np.cumsum((draws.z - estimate)[:, :, 0] ** 2, axis=1) / (HORIZON + 1)
    sets, ends = ((), (0,), (0,), (0, 3), (0, 3), times, times), (0, 0, 2, 3, 6, 7, 12)
    upto = filter_checked_sets(model, draws, sets, ends, 9, Estimation(70))[0]
    blind = filter_draws(model, draws, (), 70, 9, trajectories=True).estimate
    assert blind is not None
    nothing = (draws.z - blind)[:, 0, 0] ** 2 / (HORIZON + 1)
    np.testing.assert_allclose(upto[:, 0], nothing, rtol=1e-12)
    np.testing.assert_allclose(upto[:, 1:], errors[:, list(ends[1:])], rtol=1e-12)


def test_a_plan_of_neighbours_on_a_long_horizon_fits_into_little_memory() -> None:
    """Only `measured` has an entry for each instant of each set: a byte."""
    regular = tuple(range(0, 600, 10))
    sets = [
        tuple(sorted({*regular} - {out} | {out + step})) for out in regular for step in range(1, 9)
    ]
    planned = plan_prefixes(tuple(sets), 601)
    size = sum(array.nbytes for array in (*planned.plan, planned.places))
    assert size < 1.5 * len(sets) * 601
