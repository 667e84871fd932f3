"""Sets as bits: the same sets, keys and plans as with tuples."""

import numpy as np
import pytest

from pfdist.common.measurement_times import ManySets
from pfdist.common.streams import stream_key
from pfdist.kernels.prefixes import plan_prefixes


@pytest.mark.parametrize(("instants", "sensors"), [(13, 1), (61, 16), (7, 3), (30, 9)])
def test_bits_are_the_sets_and_give_the_same_keys_and_plans(instants: int, sensors: int) -> None:
    rng = np.random.default_rng(sensors)
    masks = rng.random((40, instants * sensors)) < rng.random((40, 1))
    sets = [(), *(tuple(np.flatnonzero(mask).tolist()) for mask in masks), (0,)]
    many = ManySets.packed(sets, instants, sensors)
    assert [*many] == sets
    assert [*(many + sets[:2])] == [*sets, *sets[:2]]
    assert many == ManySets.packed(sets, instants, sensors) != many[1:]
    np.testing.assert_array_equal(many.points()[1:-1], masks)
    assert stream_key("a", many, {"b": 1}) == stream_key("a", sets, {"b": 1})
    assert stream_key(many[:0]) == stream_key([])
    assert many[:0].points().shape == (0, instants * sensors)
    assert many[:0] == ManySets.packed([], instants, sensors)
    plan, places, givers = plan_prefixes(many, instants, None, sensors)
    expected = plan_prefixes(tuple(sets), instants, None, sensors)
    for found, own in zip((*plan, places, givers), (*expected.plan, *expected[1:]), strict=True):
        np.testing.assert_array_equal(found, own)
