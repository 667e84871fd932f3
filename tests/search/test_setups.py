"""Numbers beside windows against the plain count of `Setup.firsts`, for setups of any kind."""

import numpy as np
import pytest

from pfdist.constraints.setup import Setup
from pfdist.search.setups import Setups

POINTS = 12


def _setup(rng: np.random.Generator) -> Setup:
    """Some points need it; its ends never decrease, and points before some end share it already."""
    ends = np.maximum.accumulate(np.arange(POINTS) + rng.integers(1, 6, POINTS))
    needed = rng.random(POINTS) < rng.choice([0.4, 1.0])
    price, until = int(rng.integers(0, 4)), int(rng.choice([0, 0, 3]))
    ends = tuple(np.where(needed, ends, 0).tolist())
    return Setup(ends=ends, price=price, since_then=(until, 0))


@pytest.mark.parametrize("seed", range(20))
def test_a_measurement_begins_what_its_set_has_not_begun(seed: int) -> None:
    rng = np.random.default_rng(seed)
    setups = [_setup(rng) for _ in range(3)]
    moves = np.ones(POINTS + 1, np.int64)
    exact, latest = (Setups.within(setups, most, moves) for most in (10**6, 1))
    assert latest.size == 1
    for _ in range(50):
        times = np.flatnonzero(rng.random(POINTS) < 0.5).tolist()
        firsts, fewer = [each.firsts(times) for each in setups], np.zeros(3)
        number = none = np.zeros(1, np.int64)
        for last, time in zip([-1, *times], times, strict=False):
            number, begun = exact.after(np.array([last]), number, time)
            assert begun[:, 0].tolist() == [time in each for each in firsts]
            assert number[0] < exact.size
            _, begun = latest.after(np.array([last]), none, time)
            fewer += begun[:, 0]
        assert (fewer <= [*map(len, firsts)]).all()  # so bounds remain below


def test_the_highest_prices_are_exact_where_not_all_fit() -> None:
    every = tuple(min(point + 3, POINTS) for point in range(POINTS))
    setups = [Setup(ends=every, price=price) for price in (1, 3, 2)]
    few = Setups.within(setups, 9, np.ones(POINTS + 1, np.int64))
    assert [each.size for each in few.ends] == [1, 3, 3]
    assert Setups.within(setups, 9, np.full(POINTS + 1, 10**9)).size == 1
