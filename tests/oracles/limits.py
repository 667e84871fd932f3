"""Limits as a filter has them, from what each sensor may do."""

from collections.abc import Sequence

from pfdist.common.measurement_times import Times
from pfdist.constraints.apart import Apart
from pfdist.constraints.kinds import PlainStep
from pfdist.constraints.setup import NO_LIMIT, Setup
from pfdist.constraints.step import Money, Step
from pfdist.constraints.together import Together
from pfdist.kernels.follows import StepLimits


def limits(
    points: int = 0,
    prices: tuple[float, ...] = (),
    delays: Times = (),
    required: Times = (),
    apart: Times = (),
    own_apart: Sequence[Times] = (),
    most: Times = (),
    numbers: Times = (),
    install: Sequence[Money] = (),
    visits: Setup | None = None,
) -> StepLimits:
    """Spacing of all and of each sensor, its largest number and price, a group, and visits."""
    steps = list[Step]([Apart(after=apart)] if apart else [])
    steps += [Apart(after=own, sensor=sensor) for sensor, own in enumerate(own_apart) if any(own)]
    ways, every = max(1, len(most) or len(install)), range(points)
    late = [max(delays) - delay for delay in delays] or [0] * ways
    for sensor, number in enumerate(most):
        moments = (p + late[sensor] * ways + 1 for p in every)
        ends = tuple(m * (p % ways == sensor) for p, m in zip(every, moments, strict=True))
        steps.append(Setup(ends=ends, most=number))
    for sensor, price in enumerate(install):
        ends = tuple(NO_LIMIT * (p % ways == sensor) for p in every)
        steps += [Setup(ends=ends, price=price)] * bool(price)
    steps += [Together(numbers=numbers)] if any(numbers) else []
    steps += [visits] if visits else []
    return StepLimits(prices, delays, required, tuple(map(PlainStep.made_from, steps)))
