"""Weights, and resampling: from log-weights to the ancestor of each particle.

Arrays of particles are flat: a draw has `width` entries from its origin on, a multiple of `LANES`,
see `pfdist.kernels.filter`. All sums have a fixed order of additions.

A scheme places P points in (0, 1). The ancestor of a point u is the first particle whose cumulative
weight exceeds u times the total. Points and weights are compared as 31-bit numbers. The systematic
scheme instead computes the number of points below each weight by a formula.

================= ===========================================================================
multinomial       independent points in ascending order
stratified        one point in each of P equal intervals, independent
systematic        one point in each of P equal intervals, all at the same position in them
conditional       particle 0 has itself as ancestor, and the others are multinomial
================= ===========================================================================

References
----------
Douc, Cappe, Moulines, "Comparison of resampling schemes for particle filtering", 2005. Devroye,
"Non-uniform random variate generation", 1986, section V.3 (ascending uniforms).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels import schemes
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, call
from pfdist.kernels.variates import (
    EXPONENTIAL,
    RESAMPLING,
    SPARE,
    UNIFORM,
    Key,
    VariateRow,
    fill,
    number_of_words,
)
from pfdist.kernels.vectors import (
    LANES,
    Vector,
    VectorArray,
    iota,
    splat,
    vectorised,
)

_BEHIND = 4 * LANES  # entries behind the last of a draw that whole vectors may overwrite
_LEAST_TOTAL = 1e-100  # prevents a division by 0 if all weights are 0
_SHARES = 2.0**31 - 2.0**8  # the whole weight, in units that fit into 31 bits
_POINTS = 2.0**31 - 2.0**10  # points lie below the last share
_NOTHING_PASSES = np.int32(2**31 - 1)
_MARKS = 8  # particles that are marked together
_COMPONENT = np.int64(0)  # of the noise that places the points


class Resampling(NamedTuple):
    """Working arrays of resampling; `span` entries for each draw.

    Compiled functions get pointers to them.
    """

    span: int
    ancestor: NDArray[np.int32]  # (draws * span,): receives the ancestors
    points: NDArray[np.int32]  # (2 * span,)
    shares: NDArray[np.int32]  # (2 * span,)
    sums: NDArray[np.float64]  # (span,)
    noise: NDArray[np.float32]  # (span,)
    words: NDArray[np.uint32]  # see `pfdist.kernels.variates.number_of_words`
    chosen: NDArray[np.int64]  # (draws,): the draws that are resampled
    fill: int  # address of `pfdist.kernels.variates.fill`


class Drawn(NamedTuple):
    """Consecutive draws, and the noise key of their points."""

    stream: np.uint64
    key: int | np.int64
    first: int  # index of the first draw
    draws: int | np.int64
    width: int
    particles: int


def resampling_scratch(draws: int, width: int) -> Resampling:
    """The arrays for a batch of draws."""
    span = width + _BEHIND + SPARE
    return Resampling(
        span,
        ancestor=np.zeros(draws * span, np.int32),
        points=np.zeros(2 * span, np.int32),
        shares=np.zeros(2 * span, np.int32),
        sums=np.zeros(span),
        noise=np.zeros(span, np.float32),
        words=np.zeros(number_of_words(1, span), np.uint32),
        chosen=np.zeros(draws, np.int64),
        fill=fill.address,
    )


# --- weights --------------------------------------------------------------------------------------


def _prefix(x: Vector, zero: Vector) -> Vector:
    """Sums of the first lanes: two steps in each four lanes, and two across.

    LLVM does not know that `zero` is 0; else it makes slow instructions of the shuffles.
    """
    lanes, zeros, unknown = range(LANES), x.number(0.0), splat(zero, LANES)
    for step in (1, 2):
        x = x + x.shuffled([i - step if i % 4 >= step else LANES for i in lanes], zeros)
    x = x + x.shuffled([i // 4 * 4 - 1 if i >= 4 else LANES for i in lanes], unknown)
    return x + x.shuffled([LANES if i < 8 else 3 if i < 12 else 7 for i in lanes], unknown)


def _first_lanes(left: Vector) -> Vector:
    """The mask of so many first lanes."""
    return iota(left.builder, "i8", LANES) < left


@vectorised("16 f8")
def _numbers(value: Vector) -> Vector:
    return splat(value, LANES)


@vectorised("16 f8")
def _larger(highest: Vector, log_weight: VectorArray, i: Vector) -> Vector:
    """The larger of each lane and of a log-weight that is finite."""
    value = log_weight.load(i, LANES)
    return ((value > highest) & (value < math.inf)).select(value, highest)


@vectorised()
def _leave_out(log_weight: VectorArray, i: Vector, left: Vector) -> None:
    """Let all but the first of some log-weights be those of weight 0."""
    value = log_weight.load(i, LANES)
    log_weight.store(i, _first_lanes(left).select(value, value.number(-math.inf)))


@vectorised("f8")
def _largest(values: Vector) -> Vector:
    return values.reduced(lambda a, b: (a > b).select(a, b))


@vectorised("f8")
def _total(values: Vector) -> Vector:
    """The sum of all lanes."""
    return values.sum()


def _exp2(x: Vector) -> Vector:
    """2 to the x for x in -126..0, in float32; relative error 2e-7."""
    shift = 12582912.0  # 2^23 + 2^22: the low bits of x + shift are the nearest integer
    shifted = x + shift
    f = x - (shifted - shift)
    p = f.number(0.0013264726724487791)
    for coefficient in (0.009671512899506962, 0.05550733744505766, 0.24022242079714387,
                        0.6931469775989006, 1.0):  # fmt: skip
        p = p.fma(f, coefficient)
    return (p.bits("i4") + (shifted.bits("i4") << 23)).bits("f4")


@vectorised("16 f8")
def _weigh(
    carry: Vector,
    log_weight: VectorArray,
    i: Vector,
    highest: Vector,
    weight: VectorArray,
    cumulative: VectorArray,
) -> Vector:
    """Weights of some particles, and cumulative sums from those before."""
    value = log_weight.load(i, LANES)
    excess = (value - highest).to("f4") * 1.4426950408889634
    possible, zeros = (excess > -125.0) & (excess <= 0.0), excess.number(0.0)
    weights = possible.select(_exp2(possible.select(excess, zeros)), zeros)
    weight.store(i, weights)
    sums = _prefix(weights, (highest - highest).to("f4"))
    cumulative.store(i, sums.to("f8") + carry)
    return carry + splat(sums.lane(LANES - 1).to("f8"), LANES)


@compiled
def weigh(log_weight, origin, width, particles, weight, cumulative):
    """Compute weights and cumulative weights of a draw, and return the sum of the weights.

    The largest weight is 1. Only finite log-weights count. If there is none, the sum is 0 and the
    weights are unchanged. Log-weights after the last particle are changed.
    """
    if particles < width:
        _leave_out(log_weight, origin + width - LANES, particles - width + LANES)
    highest = _numbers(-np.inf)
    for i in range(origin, origin + width, np.int64(LANES)):
        highest = _larger(highest, log_weight, i)
    largest = _largest(highest)
    if largest == -np.inf:
        return 0.0
    carry = _numbers(0.0)
    for i in range(origin, origin + width, np.int64(LANES)):
        carry = _weigh(carry, log_weight, i, largest, weight, cumulative)
    return sum_of_weights(weight, origin, width)


@vectorised("16 f8")
def _add_weights(total: Vector, weight: VectorArray, i: Vector) -> Vector:
    return total + weight.load(i, LANES).to("f8")


@compiled
def sum_of_weights(weight, origin, width):
    """The sum of the weights of a draw."""
    total = _numbers(0.0)
    for i in range(origin, origin + width, np.int64(LANES)):
        total = _add_weights(total, weight, i)
    return _total(total)


@vectorised("16 f8")
def _cumulate(
    carry: Vector, weight: VectorArray, i: Vector, cumulative: VectorArray, zero: Vector
) -> Vector:
    """Cumulative sums of some weights from those before."""
    sums = _prefix(weight.load(i, LANES), zero.to("f4"))
    cumulative.store(i, sums.to("f8") + carry)
    return carry + splat(sums.lane(LANES - 1).to("f8"), LANES)


@compiled
def cumulate(weight, origin, width, cumulative):
    """Compute the cumulative weights of a draw, bit for bit as `weigh` does."""
    carry = _numbers(0.0)
    for i in range(origin, origin + width, np.int64(LANES)):
        carry = _cumulate(carry, weight, i, cumulative, 0.0)


@vectorised("16 f8")
def _add_weighted(total: Vector, weight: VectorArray, values: VectorArray, i: Vector) -> Vector:
    """Add weighted values; a value of weight 0 does not count, even if it is infinite."""
    numbers = values.load(i, LANES)
    weights = weight.load(i, LANES).to("f8")
    counted = (weights > 0.0).select(numbers, numbers.number(0.0))
    return weights.fma(counted, total)


@compiled
def weighted_sum(weight, values, origin, width):
    """The sum of weights times values of a draw."""
    total = _numbers(0.0)
    for i in range(origin, origin + width, np.int64(LANES)):
        total = _add_weighted(total, weight, values, i)
    return _total(total)


@vectorised("16 f8")
def _add_first(total: Vector, values: VectorArray, i: Vector, left: Vector) -> Vector:
    """Add so many of some values."""
    numbers = values.load(i, LANES).to("f8")
    return total + _first_lanes(left).select(numbers, numbers.number(0.0))


@compiled
def sum_of_first(values, origin, particles):
    """The sum of the values of a draw, all with weight 1."""
    total = _numbers(0.0)
    for i in range(np.int64(0), particles, np.int64(LANES)):
        total = _add_first(total, values, origin + i, particles - i)
    return _total(total)


@vectorised("16 f8")
def _add_deviations(
    total: Vector, values: VectorArray, i: Vector, mean: Vector, left: Vector
) -> Vector:
    difference = values.load(i, LANES).to("f8") - splat(mean, LANES)
    return total + _first_lanes(left).select(difference * difference, difference.number(0.0))


@compiled
def sum_of_deviations(values, origin, particles, mean):
    """The sum of squared deviations of the values of a draw, all with weight 1."""
    total = _numbers(0.0)
    for i in range(np.int64(0), particles, np.int64(LANES)):
        total = _add_deviations(total, values, origin + i, mean, particles - i)
    return _total(total)


@vectorised("16 f8")
def _add_squares(total: Vector, weight: VectorArray, i: Vector) -> Vector:
    weights = weight.load(i, LANES).to("f8")
    return weights.fma(weights, total)


@compiled
def sum_of_squares(weight, origin, width):
    """The sum of squared weights of a draw."""
    total = _numbers(0.0)
    for i in range(origin, origin + width, np.int64(LANES)):
        total = _add_squares(total, weight, i)
    return _total(total)


# --- from counts of children to ancestors ---------------------------------------------------------


@vectorised()
def _store_starts(
    cumulative: VectorArray, i: Vector, scale: Vector, shift: Vector, most: Vector,
    starts: VectorArray, to: Vector,
) -> None:  # fmt: skip
    """The number of systematic points below each of some cumulative weights."""
    below = (cumulative.load(i, LANES) * scale - shift).call("ceil")
    limit = splat(most, LANES)
    starts.store(to, (below < limit).select(below, limit).to("i4"))


@vectorised("16 i4")
def _integers(value: Vector) -> Vector:
    return splat(value.to("i4"), LANES)


@vectorised()
def _store_same(out: VectorArray, i: Vector, value: Vector) -> None:
    out.store(i, splat(value.to("i4"), LANES))


@vectorised("16 i4")
def _spread(
    carry: Vector, marks: VectorArray, i: Vector, ancestor: VectorArray, to: Vector
) -> Vector:
    """Running maxima of marks, from those before."""
    value, zeros, lanes = marks.load(i, LANES), carry.number(0), range(LANES)

    def larger(a: Vector, b: Vector) -> Vector:
        return (a > b).select(a, b)

    for step in (1, 2):
        shifted = value.shuffled([k - step if k % 4 >= step else LANES for k in lanes], zeros)
        value = larger(value, shifted)
    for step in (4, 8):
        shifted = value.shuffled([k // step * step - 1 if k >= step else k for k in lanes])
        value = larger(value, shifted)
    value = larger(value, carry)
    ancestor.store(to, value)
    return splat(value.lane(LANES - 1), LANES)


@vectorised()
def _mark(starts: VectorArray, j: Vector, marks: VectorArray) -> None:
    """Mark the first children of some particles with these; behind the last nothing counts."""
    for more in range(_MARKS):
        number = (j + more).to("i4")
        marks.store(starts.load(j, 0, more).to("i8"), number)


@compiled
def _expand(starts, particles, marks, ancestor, origin):
    """Find the ancestors of particles from the position of each particle's first child.

    Each first child is marked with its parent; a later particle overwrites the mark of a childless
    one. A running maximum carries the marks to the other children.
    """
    for i in range(np.int64(0), particles + 1, np.int64(LANES)):
        _store_same(marks, i, np.int64(0))
    for j in range(np.int64(0), particles, np.int64(_MARKS)):
        _mark(starts, j, marks)
    carry = _integers(np.int64(0))
    for i in range(np.int64(0), particles, np.int64(LANES)):
        carry = _spread(carry, marks, i, ancestor, origin + i)


# --- from points to ancestors ---------------------------------------------------------------------


@vectorised("16 f8")
def _add_noise(
    carry: Vector, noise: VectorArray, i: Vector, sums: VectorArray, zero: Vector
) -> Vector:
    """Sums of exponential variates, from those before."""
    part = _prefix(noise.load(i, LANES), zero.to("f4")).to("f8")
    sums.store(i, part + carry)
    return carry + splat(part.lane(LANES - 1), LANES)


@vectorised()
def _store_scaled(
    values: VectorArray, i: Vector, scale: Vector, most: Vector, out: VectorArray, to: Vector
) -> None:
    """Values in units, as integers."""
    scaled, limit = values.load(i, LANES) * scale, splat(most, LANES)
    out.store(to, (scaled < limit).select(scaled, limit).to("i4"))


@compiled
def _fill_noise(scratch, width, kind, drawn, draw):
    """Fill the noise that places the points of a draw."""
    key = Key(drawn.stream, drawn.key, RESAMPLING, _COMPONENT)
    row = VariateRow(scratch.words, scratch.noise, width, kind, key, draw, 1)
    call(scratch.fill, row)


@compiled
def _ascending_points(scratch, to, drawn, draw, count):
    """Fill points with ordered uniforms: sums of exponentials over the last sum."""
    width = (count + np.int64(LANES)) // np.int64(LANES) * np.int64(LANES)  # count + 1 variates
    _fill_noise(scratch, width, EXPONENTIAL, drawn, draw)
    carry = _numbers(0.0)
    for i in range(np.int64(0), width, np.int64(LANES)):
        carry = _add_noise(carry, scratch.noise, i, scratch.sums, 0.0)
    scale = _POINTS / scratch.sums[count]
    for i in range(np.int64(0), width, np.int64(LANES)):
        _store_scaled(scratch.sums, i, scale, _POINTS, scratch.points, to + i)


@compiled
def _stratified_points(scratch, to, drawn, draw, count):
    """Fill points with a point in each of `count` equal intervals."""
    width = (count + np.int64(LANES - 1)) // np.int64(LANES) * np.int64(LANES)
    _fill_noise(scratch, width, UNIFORM, drawn, draw)
    for i in range(count):
        scratch.points[to + i] = np.int32((i + np.float64(scratch.noise[i])) * (_POINTS / count))


@vectorised()
def _add_ranks(
    shares: VectorArray,
    first: Vector,
    points: VectorArray,
    begin: Vector,
    ranks: VectorArray,
    to: Vector,
) -> None:
    """Add to some ranks the number of shares, of as many, that do not exceed each point."""
    point = points.load(begin, LANES)
    sums = [point.number(0)] * 4
    for lane in range(LANES):
        share = splat(shares.load(first, 0, lane), LANES)
        sums[lane % 4] = sums[lane % 4] + (share <= point).to("i4")
    ranks.store(to, ranks.load(to, LANES) + ((sums[0] + sums[1]) + (sums[2] + sums[3])))


@vectorised("i8")
def _passes(shares: VectorArray, first: Vector, points: VectorArray, begin: Vector) -> Vector:
    """1 if the last of some points passes the last of some shares, else 0."""
    return (shares.load(first, 0, LANES - 1) <= points.load(begin, 0, LANES - 1)).to("i8")


@compiled
def _prepare_merge(scratch, number, cumulative, total, particles, count):
    """Fill shares from cumulative weights, and entries that end the merge."""
    base = number * scratch.span
    scale = _SHARES / max(total, _LEAST_TOTAL)
    for i in range(np.int64(0), particles, np.int64(LANES)):
        _store_scaled(cumulative, i, scale, _SHARES, scratch.shares, base + i)
    behind = (particles + np.int64(LANES - 1)) // np.int64(LANES) * np.int64(LANES)
    for j in range(particles - 1, behind):
        scratch.shares[base + j] = _NOTHING_PASSES  # nothing passes the last particle
    for i in range(count, (count + np.int64(LANES - 1)) // np.int64(LANES) * np.int64(LANES)):
        scratch.points[base + i] = _NOTHING_PASSES - 1


@compiled
def _merge(scratch, count, to):
    """Find the ancestors of ascending points, by merging the points with the shares.

    In a merge of single numbers each step waits for the step before it. So here a step compares all
    pairs of `LANES` shares and `LANES` points, and continues with the next shares or points.
    """
    shares, points, ancestor = scratch.shares, scratch.points, scratch.ancestor
    first, begin, lanes = np.int64(0), np.int64(0), np.int64(LANES)
    _store_same(ancestor, to, np.int64(0))
    while begin < count:
        _store_same(ancestor, to + begin + lanes, first)
        _add_ranks(shares, first, points, begin, ancestor, to + begin)
        passed = _passes(shares, first, points, begin)
        first += lanes * passed
        begin += lanes - lanes * passed


@compiled
def _merge_two(scratch, count, to, other):
    """Merge two draws side by side, so that neither waits."""
    shares, points, ancestor = scratch.shares, scratch.points, scratch.ancestor
    first, base, lanes = np.int64(0), scratch.span, np.int64(LANES)
    second, begin, start = base, np.int64(0), np.int64(0)
    most = (count + lanes - 1) // lanes * lanes
    _store_same(ancestor, to, np.int64(0))
    _store_same(ancestor, other, np.int64(0))
    while min(begin, start) < count:
        _store_same(ancestor, to + begin + lanes, first)
        _store_same(ancestor, other + start + lanes, second - base)
        _add_ranks(shares, first, points, begin, ancestor, to + begin)
        _add_ranks(shares, second, points, base + start, ancestor, other + start)
        passed = _passes(shares, first, points, begin)
        second_passed = _passes(shares, second, points, base + start)
        first += lanes * passed
        second += lanes * second_passed
        begin = min(begin + lanes - lanes * passed, most)
        start = min(start + lanes - lanes * second_passed, most)


# --- the schemes ----------------------------------------------------------------------------------


class Search(NamedTuple):
    """The weights of consecutive draws, from which a scheme finds ancestors."""

    cumulative: NDArray[np.float64]
    resamples: NDArray[np.uint8]  # (draws,): a draw without this flag keeps its particles
    # number of first particles that are their own ancestors: 1 for the conditional scheme, else 0
    kept: int | np.int64
    drawn: Drawn
    scratch: Resampling


@compiled
def _chosen(search):
    """The number of draws that are resampled; the others keep their particles."""
    some, scratch = np.int64(0), search.scratch
    for d in range(search.drawn.draws):
        if search.resamples[d]:
            scratch.chosen[some] = d
            some += 1
        else:
            for i in range(search.drawn.width):
                scratch.ancestor[d * scratch.span + i] = i
    return some


@entry(Search)
def systematic(search):
    """Find systematic ancestors; see `ENTRIES`."""
    cumulative, drawn, scratch = search.cumulative, search.drawn, search.scratch
    particles, starts = drawn.particles, scratch.points
    for number in range(_chosen(search)):
        d = scratch.chosen[number]
        weights = ahead(cumulative, d * drawn.width)
        _fill_noise(scratch, np.int64(LANES), UNIFORM, drawn, drawn.first + d)
        shift = np.float64(scratch.noise[0])
        scale = particles / max(weights[drawn.width - 1], _LEAST_TOTAL)
        starts[0] = 0
        for i in range(np.int64(0), particles, np.int64(LANES)):
            _store_starts(weights, i, scale, shift, float(particles), starts, i + 1)
        for j in range(particles, particles + _MARKS):
            starts[j] = particles  # behind all children
        _expand(starts, particles, scratch.shares, scratch.ancestor, d * scratch.span)


@entry(Search)
def multinomial(search):
    """Find multinomial ancestors, or conditional ones; see `ENTRIES`."""
    drawn, scratch = search.drawn, search.scratch
    some, count = _chosen(search), drawn.particles - search.kept
    for number in range(np.int64(0), some, np.int64(2)):
        pair = np.int64(2) if number + 1 < some else np.int64(1)
        for k in range(pair):
            draw = drawn.first + scratch.chosen[number + k]
            # P - 1 points for the others of a conditional cloud. One of P sorted points cannot
            # simply be left out: the point at a given position is not uniform.
            _ascending_points(scratch, k * scratch.span, drawn, draw, count)
        _place(search, number, pair)


@entry(Search)
def stratified(search):
    """Find stratified ancestors; see `ENTRIES`."""
    drawn, scratch = search.drawn, search.scratch
    some, count = _chosen(search), drawn.particles - search.kept
    for number in range(np.int64(0), some, np.int64(2)):
        pair = np.int64(2) if number + 1 < some else np.int64(1)
        for k in range(pair):
            draw = drawn.first + scratch.chosen[number + k]
            _stratified_points(scratch, k * scratch.span, drawn, draw, count)
        _place(search, number, pair)


ENTRIES = {
    schemes.MULTINOMIAL.name: multinomial,
    schemes.STRATIFIED.name: stratified,
    schemes.SYSTEMATIC.name: systematic,
    schemes.CONDITIONAL.name: multinomial,
}
"""The function of each scheme.

It finds the ancestors of the particles of consecutive draws. Those of draw d begin at ``d *
scratch.span``, and are counted from the draw's first particle.
"""


@compiled
def _place(search, number, pair):
    """Find the ancestors of one draw or two draws from their points."""
    kept, drawn, scratch = search.kept, search.drawn, search.scratch
    count, span, chosen = drawn.particles - kept, scratch.span, scratch.chosen
    for k in range(pair):
        weights = ahead(search.cumulative, chosen[number + k] * drawn.width)
        total = weights[drawn.width - 1]
        _prepare_merge(scratch, k, weights, total, drawn.particles, count)
    to = chosen[number] * span + kept
    if pair == 2:
        _merge_two(scratch, count, to, chosen[number + 1] * span + kept)
    else:
        _merge(scratch, count, to)
    if kept:
        for k in range(pair):
            scratch.ancestor[chosen[number + k] * span] = 0


@vectorised()
def _take_four(
    ancestor: VectorArray,
    a: Vector,
    source: VectorArray,
    origin: Vector,
    target: VectorArray,
    to: Vector,
) -> None:
    for lane in range(4):
        index = ancestor.load(a, 0, lane).to("i8")
        target.store(to, source.load(origin + index, 0), lane)


@compiled
def take_ancestors(scratch, source, target, d, width):
    """Copy the state of each ancestor of a draw's particles to another row."""
    origin, ancestors = d * width, d * scratch.span
    for i in range(np.int64(0), width, np.int64(4)):
        _take_four(scratch.ancestor, ancestors + i, source, origin, target, origin + i)


# --- for engines that compute in NumPy ------------------------------------------------------------


class _Rows(NamedTuple):
    """Weights of consecutive draws, a row for each."""

    draws: int
    width: int
    particles: int
    log_weight: NDArray[np.float64]
    weight: NDArray[np.float32]
    cumulative: NDArray[np.float64]
    resamples: NDArray[np.uint8]


def _rows(log_weight: NDArray[np.float64], weight: NDArray[np.float64]) -> _Rows:
    draws, particles = weight.shape
    padded, singles = _padded(log_weight, np.float64), _padded(weight, np.float32)
    cumulative, resamples = np.empty(padded.shape), np.ones(draws, np.uint8)
    return _Rows(draws, padded.shape[1], particles, padded, singles, cumulative, resamples)


@entry(_Rows)
def _weigh_rows(rows):
    for d in range(rows.draws):
        weigh(
            rows.log_weight, d * rows.width, rows.width, rows.particles, rows.weight,
            rows.cumulative,
        )  # fmt: skip


@entry(_Rows)
def _cumulate_rows(rows):
    for d in range(rows.draws):
        cumulate(rows.weight, d * rows.width, rows.width, rows.cumulative)


def _padded(values: Any, dtype: Any) -> NDArray[Any]:
    draws, particles = values.shape
    padded = np.zeros((draws, -(-particles // LANES) * LANES), dtype)
    padded[:, :particles] = values
    return padded


def weights_of(log_weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (D, P) from log-weights: at most 1 in each draw, or all 0 if none is finite."""
    rows = _rows(log_weight, np.zeros(log_weight.shape))
    _weigh_rows(rows)
    return rows.weight[:, : rows.particles].astype(np.float64)


def ancestors_of(
    scheme: str, weight: NDArray[np.float64], stream: int, draws: range, key: int
) -> NDArray[np.intp]:
    """Ancestors of the particles of consecutive draws, (D, P), from their weights (D, P)."""
    rows = _rows(weight, weight)
    scratch = resampling_scratch(rows.draws, rows.width)
    drawn = Drawn(np.uint64(stream), key, draws.start, rows.draws, rows.width, rows.particles)
    _cumulate_rows(rows)
    kept = int(schemes.ALL_SCHEMES[scheme].holds_truth)
    ENTRIES[scheme](Search(rows.cumulative, rows.resamples, kept, drawn, scratch))
    ancestors = scratch.ancestor[: rows.draws * scratch.span].reshape(rows.draws, -1)
    return ancestors[:, : rows.particles].astype(np.intp)
