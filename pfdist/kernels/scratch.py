"""Compiled functions that are handed the arrays they work in, and the arrays of the filter."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.noise import padded
from pfdist.kernels.resampling import SPARE
from pfdist.kernels.sorting import DIGITS
from pfdist.kernels.weights import width

# The rows of weights: where nothing is measured, and where something is.
ALIKE, WEIGHED = np.uintp(0), np.uintp(1)
_LINE = 64  # bytes


class WithScratch:
    """A compiled function whose arrays are made before it is called.

    Compiled code that raises an error frees no array of its own.

    Parameters
    ----------
    compiled : compiled function
    call : callable
        Makes the arrays and calls the compiled function with them.
    """

    def __init__(self, compiled: Any, call: Callable[..., None]) -> None:
        self.compiled = compiled
        self._call = call

    def __call__(self, *arguments: Any) -> None:
        """Make the arrays, and call the compiled function."""
        self._call(*arguments)


def filter_scratch(
    components: tuple[int, int], rows: int, particles: int, clouds: int, dtype: Any
) -> tuple[NDArray[Any], ...]:
    """Arrays that a filter of draws works in.

    Parameters
    ----------
    components : (int, int)
        Numbers of components of x and z.
    rows : int
        Rows of noise.
    particles : int
    clouds : int
        How many clouds are kept at a time.
    dtype : dtype
        What states are kept in.
    """
    (states, quantities), size = components, int(width(particles))
    spacious = int(padded(particles + SPARE))
    weight = aligned((2, size), np.float32)
    weight[:] = 0.0
    weight[ALIKE, :particles] = 1.0
    ancestor = aligned((spacious,), np.uint32)
    ancestor[:] = 0
    return (
        aligned((2, states, size), dtype),
        aligned((rows, spacious), np.float32),
        aligned((quantities, size), np.float64),
        weight,
        aligned((size,), np.float64),
        aligned((spacious,), np.float64),
        aligned((spacious,), np.uint32),
        aligned((spacious,), np.uint32),
        ancestor,
        aligned((2, DIGITS), np.uint32),
        aligned((clouds, states, size), dtype),
        aligned((clouds,), np.float64),
    )


def aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Array that begins where a line of the processor's cache does."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.empty(size + _LINE, np.uint8)
    start = -buffer.ctypes.data % _LINE
    return buffer[start : start + size].view(dtype).reshape(shape)
