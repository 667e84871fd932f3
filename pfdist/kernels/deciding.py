"""Deciding on the way, in the compiled filter: at each instant, the spread of a draw decides.

A draw of a batch that is not measured keeps its place, so its bits are those with the fixed set of
the sensors that measured it. `Thresholds.chosen` is the twin of a decision, and
`pfdist.kernels.left.Left` that of what may follow.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.ancestors import sum_of_deviations
from pfdist.kernels.batch import (
    At,
    FilterArrays,
    Instant,
    fill_mean_of_z,
    fill_variances,
    present,
    with_given,
)
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, read
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.rules import Applied, Ruling
from pfdist.kernels.stepping import add_measurement, addresses_of, copy_record


def ruling_of(
    applied: Applied | None, planned: Plan, draws: range, instants: range, sensors: int, *,
    is_alone: bool,
) -> tuple[Plan, Ruling, dict[str, NDArray[Any]]]:  # fmt: skip
    """A rule for the filter of a plan's only set, that plan, and the results that the rule fills.

    The set has the points that may be measured. The filter fills the plan: each draw has a set.
    Without a rule, the plan stays as it is. With several sensors, or if it must be, each draw is
    filtered alone, because it has a separate set.
    """
    if applied is None:
        return planned, Ruling(), {}
    rule, limits, flipped = applied
    follows = limits.arrays(sensors, instants, addresses_of(limits.steps))
    own = np.unpackbits(planned.measured[0], axis=1, count=sensors, bitorder="little")
    follows = follows._replace(prices=follows.prices * own.ravel())
    points = np.arange(instants.start * sensors, instants.stop * sensors)
    thresholds = np.reshape(rule.thresholds_of(points), own.shape)
    arrives = np.arange(len(own))[:, None] + follows.delays
    of_instant = np.pad(thresholds, ((0, follows.longest_delay), (0, 0)))
    turns = np.argsort(-of_instant[arrives, range(sensors)], axis=1, kind="stable")
    measured = np.zeros_like(planned.measured)
    measured[:, -1] = 1  # any gap may come before a measurement
    filled = {"measured": np.zeros((len(draws), *measured.shape[1:]), np.uint8)}
    if flipped is not None:
        filled["deviation"] = np.full(len(draws), np.nan)
    size, together = follows.start.size, 1 if sensors > 1 or is_alone else max(1, len(draws))
    ruling = Ruling(
        decide.address,
        together,
        rule.exponent,
        float(rule.limit),
        thresholds,
        turns,
        -1 if flipped is None else flipped - instants.start * sensors,
        follows,
        size,
        np.zeros((together + 1, 2)),
        np.zeros((together + 1, size), np.int64),
    )
    return planned._replace(measured=measured), ruling, filled


def with_points(results: FilterArrays, sensors: int) -> FilterArrays:
    """The results with the points of each draw instead of bits, if a rule decided."""
    if not results.measured.size:
        return results
    bits = np.unpackbits(results.measured, axis=2, count=sensors, bitorder="little")
    return results._replace(measured=bits.reshape(len(bits), sensors * bits.shape[1]))


@entry(Instant)
def decide(instant):
    """Choose the sensors that measure each draw, by the standard deviation of z; see `Thresholds`.

    The results have the set of each draw, and the plan has what some draw of the batch measures.
    """
    at, s, t, _, _ = read(instant)
    request, batch, row = at.work.request, at.work.batch, at.work.batch.row
    mean = ahead(batch.moments, request.quantities * row)
    variance = ahead(mean, request.quantities * row)
    width = (request.sensors + 7) // 8
    some = ahead(at.work.plan.measured, (s * request.instants + t) * width)
    fill_mean_of_z(at, t, mean)
    for place in range(width):
        some[place] = 0
    has_variance = False
    for d in range(at.draws):
        left = _at_instant(at, t, d)
        if not left > 0.0:
            continue
        total = 0.0
        if request.is_state and batch.weighted[d] == 0:  # the same, in one pass
            for c in range(request.quantities):
                values = ahead(present(at), request.components_of_state[c] * batch.stride)
                origin = d * batch.width
                total += sum_of_deviations(values, origin, request.particles, mean[c * row + d])
            total /= request.particles
        else:
            if not has_variance:
                fill_variances(at, t, mean, variance)
            has_variance = True
            for c in range(request.quantities):
                total += variance[c * row + d]
        _choose(at, t, d, np.sqrt(total))
    for d in range(at.draws):
        own = ahead(at.work.results.measured, _set_of(at, t, d))
        for place in range(width):
            some[place] |= own[place]


@compiled
def _choose(at, t, d, deviation):
    """Choose the sensors of a draw, from the highest threshold to the lowest."""
    request, rule = at.work.request, at.work.rule
    follows, factor = rule.follows, 1.0
    if rule.limit > 0.0:
        left = rule.limit - rule.spent[2 * d]
        factor = ((request.instants - t) / left) ** rule.exponent
    for turn in range(request.sensors):
        sensor = rule.turns[t * request.sensors + turn]
        arrives = t + follows.delays[sensor]
        point = arrives * request.sensors + sensor
        if arrives >= request.instants or not follows.prices[point] > 0.0:
            continue
        exceeds = deviation > rule.thresholds[point] * factor or follows.required[point] != 0
        is_flipped = point == rule.flipped
        if not (exceeds or is_flipped) or not _may_follow(at, t, d, point):
            continue
        if is_flipped:
            at.work.results.deviation[at.first + d] = deviation / factor
        if exceeds != is_flipped:
            own = ahead(at.work.results.measured, _set_of(at, arrives, d))
            own[sensor // 8] |= 1 << sensor % 8


# The constraints on the measurements that may follow in a draw; `pfdist.kernels.left.Left` is the
# twin. A record has what was spent before this instant, and the states of all steps.


@compiled
def _at_instant(at, t, d):
    """Bring the record of a draw to an instant; what is left to spend, 0 if nothing may follow."""
    request, rule = at.work.request, at.work.rule
    follows, size = rule.follows, rule.size
    spent, state = ahead(rule.spent, 2 * d), ahead(rule.states, d * size)
    if t == 0:
        spent[0], spent[1] = 0.0, 0.0
        for number in range(size):
            state[number] = follows.start[number]
    else:
        for sensor in range(request.sensors):
            if _has(at, t - 1 + follows.delays[sensor], d, sensor):
                _add(at, t - 1, sensor, spent, state)
    if t < spent[1]:
        return 0.0
    return rule.limit - spent[0] if rule.limit > 0.0 else np.inf


@compiled
def _may_follow(at, t, d, added):
    """Whether a point may be added to what a draw has measured, with all required ones to come."""
    request, rule = at.work.request, at.work.rule
    follows, size = rule.follows, rule.size
    trial = ahead(rule.states, rule.together * size)
    trial_spent = ahead(rule.spent, 2 * rule.together)
    copy_record(ahead(rule.spent, 2 * d), ahead(rule.states, d * size), trial_spent, trial, size)
    for made_at in range(t, max(t, follows.last_required) + 1):
        for sensor in range(request.sensors):
            arrives = made_at + follows.delays[sensor]
            if arrives >= request.instants:
                continue
            point = arrives * request.sensors + sensor
            is_wanted = point == added or follows.required[point] != 0
            is_wanted |= _has(at, arrives, d, sensor)
            if is_wanted and not _add(at, made_at, sensor, trial_spent, trial):
                return False
    return True


@compiled
def _add(at, made_at, sensor, spent, state):
    """Add a measurement, the latest so far, to a record; whether it breaks no constraint."""
    sensors, rule = at.work.request.sensors, at.work.rule
    point = (made_at + rule.follows.delays[sensor]) * sensors + sensor
    return add_measurement(rule.follows, rule.limit, sensors, point, spent, state)


@compiled
def _has(at, t, d, sensor):
    """Whether a sensor measures a draw, so that its value arrives at an instant."""
    if t >= at.work.request.instants:
        return False
    own = ahead(at.work.results.measured, _set_of(at, t, d))
    return ((own[sensor // 8] >> sensor % 8) & 1) != 0


@compiled
def _set_of(at, t, d):
    """Where the results have the sensors that measure a draw at an instant."""
    request = at.work.request
    return ((at.first + d) * request.instants + t) * ((request.sensors + 7) // 8)


@compiled
def is_measured(at, t, d):
    """Whether a draw of a batch is measured, and not only others, by a rule."""
    if at.work.rule.decide == 0:
        return True
    own, some = ahead(at.work.results.measured, _set_of(at, t, d)), False
    for place in range((at.work.request.sensors + 7) // 8):
        some |= own[place] != 0
    return some


@compiled
def with_measured(at, block, t, source, target, given, of_draw, of_component):
    """Call a block as `with_given` does; by a rule only for measured draws, one after another."""
    if at.work.rule.decide == 0:
        with_given(at, block, t, source, target, given, of_draw, of_component)
        return
    width = at.work.batch.width
    for d in range(at.draws):
        if is_measured(at, t, d):
            alone, origin = At(at.work, at.stream, at.number, at.first + d, 1), d * width
            with_given(
                alone, block, t, ahead(source, origin), ahead(target, origin),
                ahead(given, d * of_draw), of_draw, of_component,
            )  # fmt: skip
