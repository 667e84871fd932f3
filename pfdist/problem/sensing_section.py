"""How sensors sense: the keys of a job that limits, failures, repeats and delays have in common.

A table of measurements has cells beyond a limit, as ``<2``, and codes of cells without a value.
"""

import math
from contextlib import suppress
from typing import Annotated, NamedTuple, Self

from pydantic import Field, model_validator

from pfdist.common.section import JobSection, Listed
from pfdist.common.sensing import PLAIN, REPEATS, Sensing
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.problem.clock import Clock
from pfdist.problem.sections import Moment, Written, ranges_or_column
from pfdist.problem.written import by_instant

_Chance = Annotated[float, Field(ge=0.0, lt=1.0, strict=False)]
Finite = int | Annotated[float, Field(allow_inf_nan=False)]


class SensingSection(JobSection):
    """The limits of a sensor's readings, its failures, and repeated measurements.

    Parameters
    ----------
    limit : number, that of y
        Readings below are known to be below: censored. The model needs `log_tails`.
    limits : list of two numbers, that of y
        Readings below the first, and above the second, are known to be so.
    fails : number or list or section of ranges
        Probability that a planned measurement gives nothing; by time as `price`.
    repeats : int
        Largest number of measurements at one instant, each with its own noise and price.
    delay : number, clock
        Time after which a value arrives, as 2 or "2 h". A smoothed estimate waits for it.
    """

    limit: Finite | None = None
    limits: Annotated[Listed[Finite], Field(min_length=2, max_length=2)] | None = None
    fails: (
        Annotated[float, Field(gt=0.0, lt=1.0, strict=False)]
        | Listed[_Chance]
        | Annotated[dict[str, _Chance], ranges_or_column(minimum=0, exclusiveMaximum=1)]
        | None
    ) = None
    repeats: Annotated[int, Field(ge=2, le=len(REPEATS))] | None = None
    delay: Annotated[Moment, Field(gt=0), Written] | None = None

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        if self.limits is not None and (self.limit is not None or self.limits[0] >= self.limits[1]):
            got = f"limits = {shown(list(self.limits))}, limit = {self.limit}"
            raise ValueError(f"a sensor has a limit, or two limits in ascending order, got {got}")
        return self

    def sensing(self, key: str, clock: Clock, *, waits: bool) -> Sensing:
        """The same for a model, with the delay in instants: 0 if the estimate waits for all values.

        Raises `MeasurementTimesError` unless the delay is a number of steps of an even clock, and
        failures have a probability at each instant.
        """
        delay = 0 if waits else self.delay_in(key, clock)
        low = -math.inf if self.limit is None else float(self.limit)
        low, high = self.limits or (low, math.inf)
        fails = tuple(map(float, by_instant(f"{key}.fails", self.fails or 0.0, clock)))
        chance = fails if len({*fails}) > 1 else fails[0]
        return Sensing(float(low), float(high), chance, self.repeats or 1, delay)

    def delay_in(self, key: str, clock: Clock) -> int:
        """The delay in instants; raises as `sensing`."""
        if self.delay is None:
            return 0
        key, delay, step = f"{key}.delay", float(self.delay), clock.times[1] - clock.times[0]
        steps = round(delay / step)
        if not clock.is_even or abs(steps * step - delay) > clock.slack or steps > clock.horizon:
            raise MeasurementTimesError(
                f"{key} must be a number of steps of an even clock, at most {clock.horizon}, got "
                f"{delay:g}"
            )
        return steps


class MeasurementsSection(JobSection):
    """Codes in tables of measurements that stand for no value; a run does not depend on them.

    Parameters
    ----------
    failed : list of str
        Codes of a measurement that failed, as "Ice". With `works`, this says something about x.
    missing : list of str
        Codes of a value that was measured and lost, as "Eqp" or "-999". It says nothing.
    """

    failed: Listed[str] = ()
    missing: Listed[str] = ()

    @model_validator(mode="after")
    def _differ(self) -> Self:
        for code in {*self.failed} & {*self.missing}:
            raise ValueError(
                f"problem.measurements must have {code!r} in failed or in missing, got it in both"
            )
        return self

    def number(self, cell: str | float) -> float | None:
        """`FAILED` or `LOST` for a cell with a code; None for any other."""
        for codes, number in ((self.failed, FAILED), (self.missing, LOST)):
            if cell in (codes if isinstance(cell, str) else _numbers_of(codes)):
                return number
        return None


FAILED, LOST = math.inf, -math.inf
"""The numbers of cells with a code: the measurement failed, or its value was lost."""


def _numbers_of(codes: tuple[str, ...]) -> set[float]:
    numbers = set[float]()
    for code in codes:
        with suppress(ValueError):
            numbers.add(float(code))
    return numbers


class Sensings(NamedTuple):
    """How the sensors of a model sense, of which several may be repeats of one of the job."""

    each: tuple[Sensing, ...] = ()  # of each sensor of the model; none: all are plain
    names: tuple[str, ...] = ()  # of the job's sensors

    def by_way(self, way: int) -> Sensing:
        """How a sensor senses."""
        return self.each[way] if self.each else PLAIN

    @property
    def are_late(self) -> bool:
        """Whether a value arrives later; then all steps have one length."""
        return any(each.delay for each in self.each)

    @property
    def have_limits(self) -> bool:
        """Whether readings may lie beyond a limit."""
        return any(math.isfinite(end) for each in self.each for end in (each.low, each.high))

    @property
    def low(self) -> float:
        """The limit below which readings are censored, of all sensors."""
        (low, *others) = {each.low for each in self.each} or {-math.inf}
        if others or math.isinf(low):
            raise MeasurementsError(
                "a column NAME_below needs one limit of all sensors: problem.sensor.limit"
            )
        return low

    def read(self, text: str) -> float:
        """The number of a cell, which may be beyond a limit."""
        from pfdist.store.user_tables import number_of_cell  # noqa: PLC0415  it loads pandas

        if text[:1] not in ("<", ">"):
            try:
                return number_of_cell(text)
            except ValueError as error:
                lows = {each.low for each in self.each} or {-math.inf}
                is_limited = len(lows) == 1 and math.isfinite(min(lows))
                below = f"; a reading below the limit is <{min(lows):g}" * is_limited
                raise MeasurementsError(f"{error}{below}") from error
        ends = {each.low if text[0] == "<" else each.high for each in self.each}
        beyond = number_of_cell(text[1:].strip())
        if len(ends) == 1 and beyond in ends:
            return beyond
        known = ", ".join(f"{text[0]}{end:g}" for end in sorted(ends) if math.isfinite(end))
        raise MeasurementsError(
            f"a cell beyond a limit must be that of all sensors, {known or 'which have none'}, got "
            f"{shown(text)}: limit or limits of problem.sensor say what a sensor reads"
        )
