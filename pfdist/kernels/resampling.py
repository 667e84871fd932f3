"""Resampling: from cumulative weights to the ancestor of each particle.

A scheme places P points in (0, 1). The ancestor of a point u is the first particle whose cumulative
weight exceeds u times the total. Points and weights are compared as 32-bit numbers. The systematic
scheme instead computes the number of points below each weight by a formula.

================= ===========================================================================
multinomial       independent points in ascending order
stratified        one point in each of P equal intervals, independent
systematic        one point in each of P equal intervals, all at the same position in them
residual          particle j has floor(P w_j) children; the others are multinomial, with the
                  remaining weights
sorted_systematic systematic, after the particles were sorted by their states, which are scalar
                  (`pfdist.kernels.sorting`)
================= ===========================================================================

Each scheme has a plain twin below.

Sources: Douc, Cappe, Moulines, "Comparison of resampling schemes for particle filtering", 2005.
Devroye, "Non-uniform random variate generation", 1986, section V.3 (ascending uniforms).
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels import schemes
from pfdist.kernels.arithmetic import LANES, add_ranks, larger
from pfdist.kernels.melting import melted
from pfdist.kernels.noise import FILL, RESAMPLING, padded, variates
from pfdist.kernels.weights import cumulate, width

SPARE = 3 * LANES  # spare entries behind an array's last particle: whole vectors are written

_ROW, _COMPONENT = np.uintp(0), np.int64(0)  # of the noise that places the points
_STRETCHES = 4
LEAST_TOTAL = 1e-100  # the least total weight: prevents a division by 0 if all weights are 0
SHARES = 2.0**32 - 2.0**8  # the whole weight, in units that fit into 32 bits
_fill_exponentials = FILL["exponential"]
_fill_uniforms = FILL["uniform"]


class ResamplingScratch(NamedTuple):
    """Arrays that resampling reads, works in and fills; ``L = padded(particles + SPARE)``."""

    # (particles or more,): cumulative weights, which may be changed
    cumulative: NDArray[np.float64]
    noise: NDArray[np.float32]  # (a row or more, L)
    sums: NDArray[np.float64]  # (L,)
    points: NDArray[np.uint32]  # (L,)
    shares: NDArray[np.uint32]  # (L,)
    # (particles + SPARE or more,): receives the index of each particle's ancestor
    ancestor: NDArray[np.uint32]


# --- points in ascending order ------------------------------------------------------------------


@melted
def _ascending_points(scratch, stream, draw, t, count):
    """Fill `scratch.points` with ordered uniforms: sums of exponentials over the last sum."""
    noise, sums, points = scratch.noise, scratch.sums, scratch.points
    _fill_exponentials(noise, _ROW, count + 1, stream, draw, t, RESAMPLING, _COMPONENT)
    cumulate(noise, _ROW, padded(count + 1), sums)
    scale = SHARES / sums[count]
    for i in range(count):
        points[i] = np.uint32(np.int64(sums[i] * scale))


@melted
def _stratified_points(scratch, stream, draw, t, count):
    """Fill `scratch.points` with a point in each of `count` equal intervals."""
    noise, points = scratch.noise, scratch.points
    _fill_uniforms(noise, _ROW, count, stream, draw, t, RESAMPLING, _COMPONENT)
    scale = SHARES / count
    for i in range(count):
        points[i] = np.uint32(np.int64((i + np.float64(noise[0, i])) * scale))


# --- from points to ancestors -------------------------------------------------------------------


@melted
def _merge(scratch, total, particles, count, ancestor):
    """Fill `ancestor` with the ancestors of `count` points; `total` is that of the weights."""
    cumulative, shares = scratch.cumulative, scratch.shares
    scale = SHARES / larger(total, LEAST_TOTAL)
    for j in range(particles):
        shares[j] = np.uint32(np.int64(cumulative[j] * scale))
    merged_ancestors(shares, particles, scratch.points, count, ancestor)


@melted
def merged_ancestors(shares, particles, points, count, ancestor):
    """Find the ancestors of ascending points, by merging the points with the cumulative weights.

    In a merge of single numbers each step waits 7 cycles for the step before it. So here a step
    compares all pairs of 16 weights and 16 points, and goes on to the next 16 weights or the next
    16 points. This takes 0.7 ns a particle instead of 3.8 ns.

    `shares` are cumulative weights, 2^32 - 2^8 at most, in an array (width(particles) or more,);
    the last weight and the entries behind it change. `points` is (width(count) or more,), and
    `ancestor` (count + SPARE or more,). Their entries behind the count-th are scratch.
    """
    for j in range(particles - 1, width(particles)):
        shares[j] = np.uint32(0xFFFFFFFF)  # nothing passes the last particle
    for i in range(count, width(count)):
        points[i] = np.uint32(0xFFFFFFFE)
    for i in range(LANES):
        ancestor[i] = 0
    first, begin = np.uintp(0), np.uintp(0)
    lanes, last = np.uintp(LANES), np.uintp(LANES - 1)
    while begin < np.uintp(count):
        for lane in range(lanes):  # all weights before `first` lie below the next points, too
            ancestor[begin + lanes + lane] = first
        add_ranks(shares, first, points, begin, ancestor)
        passed = np.uintp(shares[first + last] <= points[begin + last])
        first += passed * lanes
        begin += (np.uintp(1) - passed) * lanes


@melted
def expanded(ends, particles, count, marks, ancestor):
    """Find the ancestors from the position behind each particle's last child.

    The position of each first child is marked with its parent. A running maximum carries the marks
    to the other children, in four stretches side by side. The maximum is one of floats: LLVM would
    turn a maximum of integers into branches that are often mispredicted (1.2 ns a particle instead
    of 0.5 ns). So there are at most 2^24 particles.

    `ends` (particles,) ascends, and its last entry is `count`. The first row of `marks` (rows,
    count + 1 or more) is scratch. `ancestor` (count or more,) receives the ancestors.
    """
    for i in range(count + 1):
        marks[0, i] = 0.0
    for j in range(np.uintp(1), np.uintp(particles)):
        # The next particle overwrites the mark of a childless particle.
        marks[0, ends[j - np.uintp(1)]] = np.float32(np.int32(j))
    stretch = np.uintp(count // _STRETCHES)
    begin_b, begin_c, begin_d = stretch, np.uintp(2) * stretch, np.uintp(3) * stretch
    a = b = c = d = np.float32(0.0)
    for i in range(stretch):
        a = larger(a, marks[0, i])
        b = larger(b, marks[0, begin_b + i])
        c = larger(c, marks[0, begin_c + i])
        d = larger(d, marks[0, begin_d + i])
        marks[0, i] = a
        marks[0, begin_b + i] = b
        marks[0, begin_c + i] = c
        marks[0, begin_d + i] = d
    before, begin = np.float32(0.0), np.uintp(0)
    for last in (a, b, c, d):
        for i in range(begin, begin + stretch):
            ancestor[i] = np.uint32(larger(marks[0, i], before))
        before, begin = larger(before, last), begin + stretch
    for i in range(begin, np.uintp(count)):
        before = larger(before, marks[0, i])
        ancestor[i] = np.uint32(before)


# --- the schemes --------------------------------------------------------------------------------


@melted
def _multinomial(scratch, particles, stream, draw, t):
    _ascending_points(scratch, stream, draw, t, particles)
    total = scratch.cumulative[particles - 1]
    _merge(scratch, total, particles, particles, scratch.ancestor)


@melted
def _conditional(scratch, particles, stream, draw, t):
    # P - 1 points for the other particles. One of P sorted points cannot simply be left out: the
    # point at a given position of the sorted points is not uniform.
    ancestor, others = scratch.ancestor, particles - 1
    _ascending_points(scratch, stream, draw, t, others)
    _merge(scratch, scratch.cumulative[particles - 1], particles, others, ancestor[1:])
    ancestor[0] = 0


@melted
def _stratified(scratch, particles, stream, draw, t):
    _stratified_points(scratch, stream, draw, t, particles)
    total = scratch.cumulative[particles - 1]
    _merge(scratch, total, particles, particles, scratch.ancestor)


@melted
def _systematic(scratch, particles, stream, draw, t):
    cumulative, noise, ends = scratch.cumulative, scratch.noise, scratch.points
    _fill_uniforms(noise, _ROW, np.int64(1), stream, draw, t, RESAMPLING, _COMPONENT)
    shift = np.float64(noise[0, 0])
    scale = particles / larger(cumulative[particles - 1], LEAST_TOTAL)
    for j in range(particles):  # the number of points below each cumulative weight
        ends[j] = np.uint32(min(math.ceil(cumulative[j] * scale - shift), particles))
    expanded(ends, particles, particles, noise, scratch.ancestor)


@melted
def _residual(scratch, particles, stream, draw, t):
    cumulative, ends, ancestor = scratch.cumulative, scratch.points, scratch.ancestor
    total = larger(cumulative[particles - 1], LEAST_TOTAL)
    before, certain, rest = 0.0, 0, 0.0
    for j in range(particles):
        # This order of operations does not round a whole number away.
        expected = (cumulative[j] - before) * particles / total
        before = cumulative[j]
        children = math.floor(expected)
        certain += children
        rest += expected - children
        ends[j] = np.uint32(certain)
        cumulative[j] = rest
    expanded(ends, particles, certain, scratch.noise, ancestor)
    if certain < particles:
        _ascending_points(scratch, stream, draw, t, particles - certain)
        _merge(scratch, rest, particles, particles - certain, ancestor[certain:])


RESAMPLE: dict[str, Callable[..., Any]] = {
    schemes.MULTINOMIAL.name: _multinomial,
    schemes.STRATIFIED.name: _stratified,
    schemes.SYSTEMATIC.name: _systematic,
    schemes.RESIDUAL.name: _residual,
    schemes.SORTED_SYSTEMATIC.name: _systematic,
    schemes.CONDITIONAL.name: _conditional,
}
"""For each scheme, compiled ``resample(scratch, particles, stream, draw, t)``, which fills the
ancestors of a `ResamplingScratch`."""


def plain_ancestors(
    scheme: str,
    weight: NDArray[np.float64],
    stream: int,
    draw: int | range,
    t: int,
) -> NDArray[np.intp]:
    """Ancestors of the particles; the plain twin of `pfdist.kernels.resampling.RESAMPLE`.

    Parameters
    ----------
    scheme : str
        Name of one of `pfdist.kernels.schemes.ALL_SCHEMES`.
    weight : array of float64, (P,) or (D, P)
        Weights of the particles in one draw, or in D draws, in any unit. A scheme that sorts gets
        the weights of sorted particles.
    stream : int
        Key of the filter's noise, 64 bits.
    draw : int or range
        Index of the draw, or indices of the D draws.
    t : int
        Instant at which the particles are resampled.

    Returns
    -------
    array of intp, shaped as the weights
        Index of the ancestor of each particle. It is arbitrary where all weights of a draw are 0.
    """
    ancestors = _PLAIN[scheme]
    if isinstance(draw, int):
        return ancestors(weight, stream, draw, t)
    rows = [ancestors(row, stream, index, t) for row, index in zip(weight, draw, strict=True)]
    return np.array(rows, np.intp).reshape(weight.shape)


def _ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Ancestors of points in (0, 1), which are compared with the weights as 32-bit integers."""
    cumulative = np.cumsum(weight)
    shares = np.floor(cumulative * (SHARES / max(cumulative[-1], LEAST_TOTAL)))
    places = np.searchsorted(shares, np.floor(points * SHARES), side="right")
    return np.minimum(places, weight.size - 1)


def _exact_ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Ancestors of points in (0, 1), which are compared with the weights as 64-bit numbers."""
    cumulative = np.cumsum(weight)
    places = np.searchsorted(cumulative, points * cumulative[-1], side="right")
    return np.minimum(places, weight.size - 1)


def _plain_ascending(count: int, stream: int, draw: int, t: int) -> NDArray[np.float64]:
    """Independent uniform points in ascending order: sums of exponentials over the last sum."""
    sums = np.cumsum(variates("exponential", count + 1, stream, draw, t, RESAMPLING, 0))
    return sums[:-1] / sums[-1]


def _plain_multinomial(weight, stream, draw, t):
    return _ancestors(weight, _plain_ascending(weight.size, stream, draw, t))


def _plain_conditional(weight, stream, draw, t):
    others = _ancestors(weight, _plain_ascending(weight.size - 1, stream, draw, t))
    return np.concatenate([[0], others])  # particle 0 is the true state, and its own ancestor


def _plain_stratified(weight, stream, draw, t):
    places = variates("uniform", weight.size, stream, draw, t, RESAMPLING, 0)
    return _ancestors(weight, (np.arange(weight.size) + places) / weight.size)


def _plain_systematic(weight, stream, draw, t):
    place = variates("uniform", 1, stream, draw, t, RESAMPLING, 0)
    return _exact_ancestors(weight, (np.arange(weight.size) + place) / weight.size)


def _plain_residual(weight, stream, draw, t):
    expected = weight.size * weight / max(np.sum(weight), np.finfo(np.float64).tiny)
    children = np.floor(expected).astype(np.intp)
    sure = np.repeat(np.arange(weight.size), children)
    rest = _plain_ascending(weight.size - sure.size, stream, draw, t)
    return np.concatenate([sure, _ancestors(expected - children, rest)])


_PLAIN: dict[str, Callable[..., NDArray[np.intp]]] = {
    "multinomial": _plain_multinomial,
    "stratified": _plain_stratified,
    "systematic": _plain_systematic,
    "residual": _plain_residual,
    "sorted_systematic": _plain_systematic,  # the filter has sorted the particles
    "conditional": _plain_conditional,
}
