"""The limit: a compiled loop of pfdist's noise and memory traffic that filters nothing.

At each instant it fills the same noise, adds it to the states in a second array, and sums them. At
a measurement it also fills the noise of the resampling scheme, and copies the states from
ancestors that were chosen before. Formulas, weights and the choice of ancestors are left out.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.noise import FILL, FILTER_INITIAL, FILTER_PROCESS, RESAMPLING, padded
from pfdist.kernels.scratch import aligned

_fill_normals, _fill_exponentials = FILL["normal"], FILL["exponential"]
_ROW = np.uintp(0)


def filter_draws(
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    measured: NDArray[np.bool_],
    particles: int,
    resampling: str,
    seed: int,
) -> NDArray[np.float64]:
    """Sums of squares without a meaning; see `benchmarks.peer_filters`."""
    size = int(padded(particles + 1))
    cloud, noise = aligned((2, size), np.float64), aligned((1, size), np.float32)
    ancestor = np.sort(np.random.default_rng(0).integers(particles, size=size)).astype(np.uint32)
    points = particles + 1 if resampling == "multinomial" else 1
    mse = np.empty(len(y))
    _loop(np.uint64(seed), z, measured, particles, points, cloud, noise, ancestor, mse)
    return mse


@njit(nogil=True, fastmath=True)  # sums in vectors
def _loop(stream, z, measured, particles, points, cloud, noise, ancestor, mse):  # type: ignore[no-untyped-def]
    zero = np.int64(0)
    for d in range(mse.size):
        _fill_normals(noise, _ROW, particles, stream, d, zero, FILTER_INITIAL, zero)
        for i in range(particles):
            cloud[0, i] = 5.0 * noise[0, i]
        here, error = 0, 0.0
        for t in range(measured.size):
            if t > 0:
                _fill_normals(noise, _ROW, particles, stream, d, t, FILTER_PROCESS, zero)
                for i in range(particles):
                    cloud[1 - here, i] = cloud[here, i] + noise[0, i]
                here = 1 - here
            total = 0.0
            for i in range(particles):
                total += cloud[here, i]
            error += (total / particles - z[d, t]) ** 2
            if measured[t]:
                _fill_exponentials(noise, _ROW, points, stream, d, t, RESAMPLING, zero)
                for i in range(particles):
                    cloud[1 - here, i] = cloud[here, ancestor[i]]
                here = 1 - here
        mse[d] = error / measured.size
