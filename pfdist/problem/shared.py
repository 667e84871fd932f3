"""Prices and limits of several measurements together: of sensors, visits, installations.

`Constraints`, searches and the bound loop over all that a job has, and know none of them by name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

from pfdist.common.measurement_times import Times
from pfdist.constraints.apart import Apart
from pfdist.constraints.setup import Setup
from pfdist.constraints.spacing import Spacing
from pfdist.constraints.step import Step
from pfdist.problem.points import Points


@dataclass(frozen=True)
class Shared:
    """Prices and limits that measurements share; forms of it overwrite what they have.

    All that measurements may do follows from `steps`; the rest is what searches know of it.
    """

    steps: tuple[Step, ...] = field(default=(), kw_only=True)

    @property
    def setups(self) -> tuple[Setup, ...]:
        """All that has a price beside those of measurements, or a largest number."""
        return tuple(step for step in self.steps if isinstance(step, Setup))

    @property
    def priced(self) -> str:
        """The key of the job that gives prices of setups."""
        return ""

    def since(self, first: int, taken: Times, steps: tuple[Step, ...]) -> Self | None:
        """The same from a point on, after some measurements; None if nothing of it is left.

        `steps` are its own from there on.
        """
        return replace(self, steps=steps)

    is_exact: ClassVar[bool] = False
    """Whether sets can have exactly N measurements; then `fitting` finds the measurements."""

    def fitting(self, points: Points, times: Times, among: Times) -> Times:
        """A largest subset of some points that fits beside sorted times; all are sorted."""
        return among

    # --- measurements that belong together --------------------------------------------------------

    spaced: ClassVar[str] = ""
    """Sentences call all that evenly spaced sets space so; empty if it is measurements."""

    def parts(self, times: Times) -> list[Times]:
        """The sorted times that belong together: searches move and keep them together."""
        return []

    def in_words(self, points: Points, times: Times) -> str:
        """When a set measures, by its parts; empty without them."""
        return ""

    def regular(self, feasible: Any) -> Times | None:
        """The regular set of a `Feasible`, if parts are spaced."""
        return None

    def even_sets(self, feasible: Any) -> Any:
        """The `EvenSets` of a `Feasible`, if parts are spaced; else None."""
        return None


class Limit(NamedTuple):
    """Constraints on the measurements of one sensor."""

    most: int | None = None  # the largest number of its measurements in a set
    spacing: Spacing | None = None  # which instants are far enough apart for it


class OfSensors(Shared):
    """The largest number of measurements of each sensor, and their spacing."""

    is_exact: ClassVar[bool] = True

    @classmethod
    def on(cls, points: Points, limits: Sequence[Limit]) -> Self:
        """The limits of each sensor."""
        steps = list[Step]()
        for way, (most, spacing) in enumerate(limits):
            key = f"sensors.{points.sensor(way)}"
            if most is not None:
                ends = points.alone(way)
                steps.append(Setup(key=f"{key}.most", ends=ends, most=most, in_order=False))
            if spacing is not None:
                after, key = spacing.successors, f"{key}.minimum_spacing"
                steps.append(Apart(key=key, after=after, sensor=way, ways=points.ways))
        return cls(steps=tuple(steps))

    @cached_property
    def _spacings(self) -> dict[int, Spacing]:
        return {each.sensor: each.spacing for each in self.steps if isinstance(each, Apart)}

    @cached_property
    def _most(self) -> dict[int, int | None]:
        """How many measurements a sensor has left; its first point is its number."""
        return {next(k for k, end in enumerate(s.ends) if end): s.left for s in self.setups}

    def fitting(self, points: Points, times: Times, among: Times) -> Times:
        """A largest subset of some points that fits beside sorted times; all are sorted.

        Sensors do not depend on each other, because these limits exclude a common spacing.
        """
        chosen = list[int]()
        for way in range(points.ways):
            own, before = points.of_way(way, among), points.of_way(way, times)
            spacing = self._spacings.get(way) or Spacing.constant(1, points.clock.horizon)
            new, left = spacing.fitting(before, own), self._most.get(way)
            left = len(new) if left is None else max(0, left - len(before))
            chosen += [points.alike(way)[t] for t in new[:left]]
        return tuple(sorted(chosen))
