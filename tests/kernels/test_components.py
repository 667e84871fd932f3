import numpy as np
import pytest
from numba import njit

from pfdist.kernels.components import formula, reader, writer

COUNTS = [0, 1, 3]


def cloud():
    """(components, particles): 10 c + i for component c of particle i, in float32."""
    return (10 * np.arange(3)[:, None] + np.arange(4)).astype(np.float32)


@pytest.mark.parametrize("components", COUNTS)
def test_reader_gives_one_particle_as_a_tuple(components):
    assert reader(components)(cloud(), 2) == (2.0, 12.0, 22.0)[:components]


def test_what_is_read_is_float64_whatever_the_array():
    read = reader(1)
    square = njit(lambda array: read(array, 0)[0] * read(array, 0)[0])
    assert square(np.full((1, 1), 0.1, np.float32)) == float(np.float32(0.1)) ** 2


@pytest.mark.parametrize("components", COUNTS)
def test_writer_changes_one_particle_and_its_components_alone(components):
    array = np.zeros((3, 4))
    writer(components)(array, 2, (7.0, 8.0, 9.0)[:components])
    expected = np.zeros((3, 4))
    expected[:components, 2] = [7.0, 8.0, 9.0][:components]
    np.testing.assert_array_equal(array, expected)


@pytest.mark.parametrize("components", COUNTS)
def test_written_is_read_again_in_compiled_code(components):
    read, write = reader(components), writer(components)

    @njit
    def copy(source, target):
        for i in range(source.shape[1]):
            write(target, i, read(source, i))

    target = np.zeros((components, 4))
    copy(cloud(), target)
    np.testing.assert_array_equal(target, cloud()[:components])


@pytest.mark.parametrize(("numerator", "quotient"), [(1.0, np.inf), (-1.0, -np.inf), (0.0, np.nan)])
def test_a_formula_divides_by_zero_as_numpy_does(numerator, quotient):
    divide = formula(lambda a, b: a / b)
    np.testing.assert_equal(divide(numerator, 0.0), quotient)
