"""The limit: a compiled loop of pfdist's noise and memory traffic that filters nothing.

At each instant it fills the same noise, adds it to the states in a second array, and sums them. At
a measurement it also fills the noise of the resampling scheme, and copies the states from
ancestors that were chosen before. Formulas, weights and the choice of ancestors are left out.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.cached import entry
from pfdist.kernels.memory import ahead, call, read
from pfdist.kernels.variates import (
    EXPONENTIAL,
    FILTER_INITIAL,
    FILTER_PROCESS,
    NORMAL,
    RESAMPLING,
    SPARE,
    TILE,
    Key,
    VariateRow,
    fill,
    number_of_words,
)
from pfdist.kernels.vectors import LANES


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
    ancestor = np.sort(np.random.default_rng(0).integers(particles, size=size)).astype(np.uint32)
    mse = np.empty(len(y))
    work = _Work(
        np.uint64(seed),
        len(y),
        len(measured),
        particles,
        size,
        size if resampling == "multinomial" else TILE,
        np.ascontiguousarray(z, np.float64),
        np.ascontiguousarray(measured, np.uint8),
        np.zeros(2 * size),
        np.zeros(size + SPARE, np.float32),
        np.zeros(number_of_words(1, size), np.uint32),
        ancestor,
        mse,
        fill.address,
    )
    _filter_draws(work)
    return mse


class _Work(NamedTuple):
    stream: np.uint64
    draws: int
    instants: int
    particles: int
    size: int
    points: int  # variates that place the points of the resampling scheme
    z: NDArray[np.float64]
    measured: NDArray[np.uint8]
    cloud: NDArray[np.float64]  # (2, size)
    noise: NDArray[np.float32]
    words: NDArray[np.uint32]
    ancestor: NDArray[np.uint32]
    mse: NDArray[np.float64]
    fill: int  # address of `fill`


@entry(_Work)
def _filter_draws(work):  # type: ignore[no-untyped-def]
    _loop(read(work))


@njit(fastmath=True)  # sums in vectors
def _loop(work):  # type: ignore[no-untyped-def]
    particles, cloud, noise, ancestor = work.particles, work.cloud, work.noise, work.ancestor
    zero = np.int64(0)
    width = (particles + LANES - 1) // LANES * LANES
    for d in range(work.draws):
        _fill(work, width, NORMAL, zero, FILTER_INITIAL, d)
        source, target = cloud, ahead(cloud, work.size)
        for i in range(particles):
            source[i] = 5.0 * noise[i]
        error = 0.0
        for t in range(work.instants):
            if t > 0:
                _fill(work, width, NORMAL, t, FILTER_PROCESS, d)
                for i in range(particles):
                    target[i] = source[i] + noise[i]
                source, target = target, source
            total = 0.0
            for i in range(particles):
                total += source[i]
            error += (total / particles - work.z[d * work.instants + t]) ** 2
            if work.measured[t]:
                _fill(work, work.points, EXPONENTIAL, t, RESAMPLING, d)
                for i in range(particles):
                    target[i] = source[ancestor[i]]
                source, target = target, source
        work.mse[d] = error / work.instants


@njit
def _fill(work, width, kind, t, role, draw):  # type: ignore[no-untyped-def]
    key = Key(work.stream, t, role, np.int64(0))
    call(work.fill, VariateRow(work.words, work.noise, width, kind, key, draw, 1))
