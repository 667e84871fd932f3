"""The arrays that the fused filter works in, and compiled functions with the arrays they work in.

Compiled code that raises an error does not free the arrays that it made itself. So all arrays are
made in Python, and passed to the compiled code.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.arithmetic import shaped
from pfdist.kernels.melting import melted
from pfdist.kernels.noise import padded
from pfdist.kernels.prefixes import Saved
from pfdist.kernels.resampling import SPARE, ResamplingScratch
from pfdist.kernels.sorting import DIGITS, SortingScratch
from pfdist.kernels.weights import width

EQUAL, WEIGHTED = np.uintp(0), np.uintp(1)
"""Rows of `Scratch.weight` for instants without and with a measurement."""
_CACHE_LINE = 64  # bytes


@dataclass(frozen=True)
class WithScratch:
    """A compiled function, and `call`, the function that makes its arrays and calls it."""

    compiled: Any
    call: Callable[..., None]

    def __call__(self, *arguments: Any) -> None:
        """Make the arrays, and call the compiled function."""
        self.call(*arguments)


class Scratch(NamedTuple):
    """Arrays that a filter works in; P particles, ``W = width(P)``, ``L = padded(P + SPARE)``."""

    # (2, n, W): the states; a step reads one half and writes the other
    cloud: NDArray[np.float64]
    noise: NDArray[np.float32]  # (rows, L)
    # (2, W): row EQUAL is 1 for each particle and 0 behind the last; row WEIGHTED holds the weights
    # after a measurement
    weight: NDArray[np.float32]
    log_weight: NDArray[np.float64]  # (W,)
    # (q, W), and a row for each angle: the terms of a weighted sum. `log_weight` has the memory of
    # the first row: it is no longer needed when the terms are computed.
    terms: NDArray[np.float64]
    resampling: ResamplingScratch
    sorting: SortingScratch  # in the memory of `resampling` and `log_weight`
    saved: Saved
    # (U, T+1, q): estimates of the first of two filters; empty if there is one filter
    first_means: NDArray[np.float64]


def filter_scratch(
    components: tuple[int, int],
    noise_rows: int,
    particles: int,
    slots: int,
    first_means: tuple[int, int],
) -> Scratch:
    """Arrays for a filter of draws.

    `components` are the numbers of components of x and of rows of `Scratch.terms`. `slots` is the
    largest number of clouds that are saved at a time, and `first_means` the numbers of sets and of
    instants of `Scratch.first_means`.
    """
    (states, rows), size = components, int(width(particles))
    spacious = int(padded(particles + SPARE))
    weight = aligned((2, size), np.float32)
    weight[:] = 0.0
    weight[EQUAL, :particles] = 1.0
    noise = aligned((noise_rows, spacious), np.float32)
    terms = aligned((rows, size), np.float64)
    cumulative, sums = aligned((size,), np.float64), aligned((spacious,), np.float64)
    points, shares, ancestor = (aligned((spacious,), np.uint32) for _ in range(3))
    ancestor[:] = 0
    # Sorting takes the memory of arrays that are idle while it runs: log-weights have become
    # weights before it, and points, shares and ancestors are filled after it.
    return Scratch(
        aligned((2, states, size), np.float64),
        noise,
        weight,
        terms[0],
        terms,
        ResamplingScratch(cumulative, noise, sums, points, shares, ancestor),
        SortingScratch(terms[0], aligned((2, DIGITS), np.uint32), points, shares, ancestor),
        Saved(
            aligned((slots, states, size), np.float64),
            aligned((slots,), np.float64),
            aligned((slots, size), np.float32),
            aligned((slots,), np.bool_),
        ),
        aligned((*first_means, rows), np.float64),
    )


@melted
def with_sizes(scratch, states, rows, noise_rows, particles):
    """The same arrays with sizes that LLVM knows, or knows to be multiples of a vector's length."""
    size, spacious = width(particles), padded(particles + SPARE)
    given = scratch.resampling
    noise = shaped(given.noise, (noise_rows, spacious))
    log_weight = shaped(scratch.log_weight, (size,))
    points, shares = shaped(given.points, (spacious,)), shaped(given.shares, (spacious,))
    ancestor, sums = shaped(given.ancestor, (spacious,)), shaped(given.sums, (spacious,))
    cumulative = shaped(given.cumulative, (size,))
    counts = shaped(scratch.sorting.counts, (2, DIGITS))
    saved, slots = scratch.saved, scratch.saved.errors.size
    return Scratch(
        shaped(scratch.cloud, (2, states, size)),
        noise,
        shaped(scratch.weight, (2, size)),
        log_weight,
        shaped(scratch.terms, (rows, size)),
        ResamplingScratch(cumulative, noise, sums, points, shares, ancestor),
        SortingScratch(log_weight, counts, points, shares, ancestor),
        Saved(
            shaped(saved.clouds, (slots, states, size)),
            saved.errors,
            shaped(saved.weights, (slots, size)),
            saved.degenerate,
        ),
        scratch.first_means,
    )


def aligned(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """An array with arbitrary content that begins where a line of the processor's cache begins."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.empty(size + _CACHE_LINE, np.uint8)
    start = -buffer.ctypes.data % _CACHE_LINE
    return buffer[start : start + size].view(dtype).reshape(shape)
