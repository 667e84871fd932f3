"""The limit: a compiled loop of pfdist's noise and memory traffic that filters nothing.

At each instant it fills the same noise, adds it to the states in a second array, and sums them. At
a measurement it also fills the noise of the resampling scheme, and copies the states from
ancestors that were chosen before. Formulas, weights and the choice of ancestors are left out.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.variates import (
    EXPONENTIAL,
    FILTER_INITIAL,
    FILTER_PROCESS,
    NORMAL,
    RESAMPLING,
    SPARE,
    TILE,
    Key,
    fill,
    words_of,
)
from pfdist.kernels.vectors import LANES, with_pointers


def filter_draws(
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    measured: NDArray[np.bool_],
    particles: int,
    resampling: str,
    seed: int,
) -> NDArray[np.float64]:
    """Sums of squares without a meaning; see `benchmarks.peer_filters`."""
    size = -(-(particles + 1) // TILE) * TILE
    cloud, noise = np.zeros((2, size)), np.zeros(size + SPARE, np.float32)
    ancestor = np.sort(np.random.default_rng(0).integers(particles, size=size)).astype(np.uint32)
    points = size if resampling == "multinomial" else TILE
    mse = np.empty(len(y))
    pointers = _Pointers(words_of(1, size), noise)
    _loop(np.uint64(seed), z, measured, particles, points, cloud, noise, pointers, ancestor, mse)
    return mse


class _Pointers(NamedTuple):
    words: NDArray[np.uint32]
    noise: NDArray[np.float32]


@njit(nogil=True, fastmath=True)  # sums in vectors
def _loop(stream, z, measured, particles, points, cloud, noise, pointers, ancestor, mse):  # type: ignore[no-untyped-def]
    given = with_pointers(pointers)
    zero, single = np.int64(0), np.int64(1)
    width = np.int64(-(-particles // LANES) * LANES)
    for d in range(mse.size):
        key = Key(stream, zero, FILTER_INITIAL, zero)
        fill(given.words, given.noise, width, NORMAL, key, d, single)
        for i in range(particles):
            cloud[0, i] = 5.0 * noise[i]
        here, error = 0, 0.0
        for t in range(measured.size):
            if t > 0:
                key = Key(stream, t, FILTER_PROCESS, zero)
                fill(given.words, given.noise, width, NORMAL, key, d, single)
                for i in range(particles):
                    cloud[1 - here, i] = cloud[here, i] + noise[i]
                here = 1 - here
            total = 0.0
            for i in range(particles):
                total += cloud[here, i]
            error += (total / particles - z[d, t]) ** 2
            if measured[t]:
                key = Key(stream, t, RESAMPLING, zero)
                fill(given.words, given.noise, points, EXPONENTIAL, key, d, single)
                for i in range(particles):
                    cloud[1 - here, i] = cloud[here, ancestor[i]]
                here = 1 - here
        mse[d] = error / measured.size
