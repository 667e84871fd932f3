"""Tuples out of arrays and back."""

import numpy as np
import pytest
from numba import njit

from pfdist.kernels.components import naming, reader, tuple_of, writer

VALUES = (7.0, 8.0, 9.0)
counts = pytest.mark.parametrize("components", [0, 1, 3])


def cloud():
    """(half, components, particles): 100 h + 10 c + i, in float32."""
    h, c, i = np.ogrid[:2, :3, :4]
    return (100 * h + 10 * c + i).astype(np.float32)


@counts
def test_the_entries_along_the_axis_c_are_read_and_written_and_no_others(components):
    read, write = reader(components, "half, i, c"), writer(components, "half, c, i")

    @njit
    def copy(source, target):
        for i in range(source.shape[1]):
            write(target, 1, i, read(source, 1, i))

    source, target, expected = cloud().transpose(0, 2, 1), cloud() + 500, cloud() + 500
    copy(source, target)
    expected[1, :components] = cloud()[1, :components]
    np.testing.assert_array_equal(target, expected)


def test_what_is_read_is_float64_whatever_the_array():
    read = reader(1, "c, i")
    square = njit(lambda array: read(array, 0)[0] * read(array, 0)[0])
    assert square(np.full((1, 1), 0.1, np.float32)) == float(np.float32(0.1)) ** 2


@pytest.mark.parametrize("any_order", [False, True])
@counts
def test_entry_c_of_the_tuple_is_the_expression_with_c_in_it(components, any_order):
    entry = "vectors[c] + c * scale"  # no other c of the text is touched
    result = tuple_of(components, "vectors, scale", entry, any_order=any_order)
    assert result(VALUES, 10.0) == (7.0, 18.0, 29.0)[:components]


def test_nan_and_infinity_are_told_apart_where_additions_may_be_in_any_order():
    # Additions may change their order; nothing else may be assumed of floats.
    known = tuple_of(1, "a, b", "a[c] + (b[c] if b[c] == b[c] else 0.0)", any_order=True)
    finite = tuple_of(1, "a, b", "a[c] + (b[c] if abs(b[c]) < 1e999 else 0.0)", any_order=True)
    values = (2.0,), (np.inf,), (np.nan,)
    assert [known((1.0,), value) for value in values] == [(3.0,), (np.inf,), (1.0,)]
    assert [finite((1.0,), value) for value in values] == [(3.0,), (1.0,), (1.0,)]


def test_parameters_are_read_by_their_names():
    values = np.array([1.5, 2.5, 3.5])
    named = naming(("sigma", "c", "i"))
    assert njit(lambda values: named(values).c - named(values).sigma)(values) == 1.0
    assert named(values)._asdict() == {"sigma": 1.5, "c": 2.5, "i": 3.5}
    assert naming(())(np.empty(0)) == ()
