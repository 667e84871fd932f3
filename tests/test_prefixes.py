"""Sets that share their first times share their cloud: the same bits, for less work."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pfdist import StateSpaceModel, load_model, where
from pfdist.draws import simulate
from pfdist.kernels.fused_filter import prefix_tree
from pfdist.particle_filter import filter_draws, filter_sets

HORIZON = 12
DEGENERATE = replace(
    load_model("ungm"),
    log_likelihood=lambda y, x, t, p: where(y[0] > 20.0, -math.inf, -0.5 * (y[0] - x[0]) ** 2),
)
INFINITE = replace(
    load_model("ungm"),
    quantity_of_interest=lambda x, t, p: (where(abs(x[0]) > 22.0, math.inf, x[0]),),
)


def random_sets(count: int, seed: int) -> list[tuple[int, ...]]:
    rng = np.random.default_rng(seed)
    masks = rng.random((count, HORIZON + 1)) < rng.random((count, 1))
    return [tuple(np.flatnonzero(mask).tolist()) for mask in masks]


SETS = [*random_sets(40, seed=0), (), tuple(range(HORIZON + 1)), (12,), (0,), (12,)]


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("resampling", ["multinomial", "systematic"])
@pytest.mark.parametrize("name", ["ungm", "bearings_only"])
def test_together_they_are_bit_for_bit_as_one_by_one(
    name: str, resampling: str, dtype: str
) -> None:
    model = load_model(name)
    draws = simulate(model, HORIZON, range(5), 3)
    together = filter_sets(model, draws, SETS, 70, 9, resampling, dtype)
    alone = [
        filter_draws(model, draws, times, 70, 9, resampling, dtype=dtype).mse for times in SETS
    ]
    np.testing.assert_array_equal(together, np.stack(alone, axis=1))


@pytest.mark.parametrize(("believed", "value"), [(DEGENERATE, math.nan), (INFINITE, math.inf)])
def test_a_draw_that_ended_has_ended_for_all_that_share_it(
    believed: StateSpaceModel, value: float
) -> None:
    draws = simulate(load_model("ungm"), HORIZON, range(60), 3)
    together = filter_sets(believed, draws, SETS, 70, 9)
    alone = np.stack([filter_draws(believed, draws, times, 70, 9).mse for times in SETS], axis=1)
    np.testing.assert_array_equal(together, alone)
    ended = ~np.isfinite(together)
    np.testing.assert_array_equal(together[ended], value)
    assert 0.02 < ended.mean() < 0.98


@pytest.mark.parametrize("seed", range(20))
def test_every_distinct_prefix_is_walked_once(seed: int) -> None:
    sets = random_sets(30, seed)
    measured = np.zeros((len(sets), HORIZON + 1), np.bool_)
    for row, times in zip(measured, sets, strict=True):
        row[list(times)] = True
    (ordered, shared, stops), place = prefix_tree(measured)
    np.testing.assert_array_equal(ordered[place], measured)
    prefixes = {row[: t + 1].tobytes() for row in measured for t in range(HORIZON + 1)}
    assert (HORIZON + 1 - shared).sum() == len(prefixes)
    # What a set goes on from was kept last by one that had the same times before.
    slots: dict[int, bytes] = {}
    for row, begin, stop in zip(ordered, shared, stops, strict=True):
        if begin > 0:
            assert slots[begin] == row[:begin].tobytes()
        for t in np.unique(stop[begin:]):
            assert t > begin
            slots[t] = row[:t].tobytes()
