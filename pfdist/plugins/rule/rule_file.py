"""The file rule.json: a tuned rule as it is written and read, and used for one system."""

import json
import os
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from pfdist.common.parsing import parse_json
from pfdist.common.points import ALONE
from pfdist.common.section import JobSection
from pfdist.errors import ArgumentError, StoreError, shown
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.left import Left
from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds
from pfdist.problem.feasible import Feasible
from pfdist.results import finite
from pfdist.runner.filter import Filter
from pfdist.store import RULE as FILE
from pfdist.store import read_listed, run_key, write_about
from pfdist.store.files import reading


class Rule:
    """A tuned rule that decides, instant by instant, whether to measure one system.

    It needs no simulation. It keeps what was measured, so all constraints of the job hold.

    Parameters
    ----------
    rule : Thresholds
        With a threshold for each instant and sensor.
    limits : StepLimits
        The constraints of the job.
    sensors : sequence of str
        Names of the sensors.

    Examples
    --------
    Measure by the rule of a run::

        rule = pfdist.Rule.load("results/robot/rule.json")
        belief = pfdist.Filter("robot", particles=1000)
        for t in range(rule.instants):
            if rule.decide(belief, t):
                belief.update(t, bearings())
    """

    def __init__(self, rule: Thresholds, limits: StepLimits, sensors: Sequence[str]) -> None:
        ways, thresholds = len(sensors), enumerate(rule.thresholds)
        self.sensors, self.instants = tuple(sensors), len(rule.thresholds) // ways
        allowed = [point for point, threshold in thresholds if threshold < NEVER]
        self._rule, self._chosen, self._next = rule, list[int](), 0
        self._left = Left(limits, ways, allowed, self.instants, rule.limit)

    @classmethod
    def load(cls, path: str | Path) -> "Rule":
        """The rule of a file rule.json, which ``pfdist rule`` writes into the folder of a run.

        Raises
        ------
        StoreError
            The file is missing or damaged, or an earlier version wrote it.
        """
        with reading(Path(path)):
            text = Path(path).read_bytes()
        try:
            answer = parse_json(text)
            written = _Written.read(answer["rule"])
            limits = TypeAdapter(StepLimits).validate_python(answer["constraints"])
            each = written.threshold.values()
            instants = max(map(len, each), default=0)
            _check_sizes(limits, len(written.threshold), instants)
            return cls(written.rule([*written.threshold], instants), limits, [
                name or ALONE for name in written.threshold
            ])  # fmt: skip
        except (ValueError, TypeError, LookupError) as error:
            raise _damaged(Path(path), error, ", or an earlier version wrote it") from error

    @property
    def spent(self) -> float:
        """The number of measurements so far, or their price."""
        return float(self._left.spent[0])

    def decide(self, belief: Filter | float, t: int) -> list[str]:
        """Decide whether to measure at an instant, and count this as spent.

        Parameters
        ----------
        belief : Filter or float
            The filter of the system, with all measurements that have arrived before t; or the
            predicted standard deviation of z(t), as `pfdist.filters.filter_estimate.FilterEstimate`
            has it as `spread`.
        t : int
            An instant after the last one that was asked about.

        Returns
        -------
        list of str
            Names of the sensors that measure now; "y" for the only one of a model without sensors.
            With a delay, the value arrives later.

        Raises
        ------
        ArgumentError
            The instant has passed, or lies after T; or `belief` is no filter and no such number.
        """
        if not self._next <= t < self.instants:
            raise ArgumentError(
                f"t must lie in {self._next}..{self.instants - 1}, got {t}: load the rule again "
                "for another system"
            )
        spread = belief.predict(t).spread if isinstance(belief, Filter) else belief
        if not (isinstance(spread, Real) and spread >= 0.0):
            raise ArgumentError(
                f"belief must be a Filter, or a number of at least 0, got {shown(belief)}"
            )
        self._left.wait(t)
        self._chosen, self._next = sorted(self._rule.chosen(spread, t, self._left)), t + 1
        return [self.sensors[point % len(self.sensors)] for point in self._chosen]

    def not_made(self) -> None:
        """Note that nothing was measured as it was decided last, so nothing is spent.

        A measurement that was made and has failed is spent.
        """
        self._left.drop(self._chosen)
        self._chosen = []


Positive = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Level = Annotated[float, Field(ge=ALWAYS, allow_inf_nan=False)]


class _Written(JobSection):
    """A rule as `rule_json` writes it."""

    threshold: dict[str, list[Level | None]]  # of each sensor
    exponent: Positive
    limit: Positive

    @classmethod
    def read(cls, rule: Any) -> "_Written":
        threshold = rule["threshold"]
        each = threshold if isinstance(threshold, dict) else {"": threshold}
        return cls.model_validate({**rule, "threshold": each})

    def rule(self, sensors: Sequence[str], instants: int) -> Thresholds:
        columns = [self.threshold[name] for name in sensors]
        if {*map(len, columns)} != {instants}:
            raise ValueError(f"thresholds of {len(columns[0])} instants, not of {instants}")
        rows = zip(*columns, strict=True)
        thresholds = tuple(NEVER if level is None else level for row in rows for level in row)
        if any(ALWAYS < threshold < 0.0 for threshold in thresholds):
            raise ValueError("a threshold must be at least 0, -1 (always) or null (never)")
        return Thresholds(thresholds, self.exponent, self.limit)


def _check_sizes(limits: StepLimits, ways: int, instants: int) -> None:
    """Raise `ValueError` unless arrays of limits have as many numbers as there are sensors."""
    points = ways * instants
    sizes = {"prices": points, "delays": ways}
    is_right = {name: len(getattr(limits, name)) in {0, size} for name, size in sizes.items()}
    is_right["required"] = {*limits.required} <= {*range(points)}
    is_right["delays"] &= min((0, *limits.delays)) == 0
    is_right["steps"] = all(step.is_of(ways, instants) for step in limits.steps)
    for name in (name for name, right in is_right.items() if not right):
        raise ValueError(f"constraints.{name} is not that of these sensors and instants")


def rule_json(rule: Thresholds, feasible: Feasible) -> dict[str, Any]:
    """A rule as JSON values: a threshold for each instant, -1 for always, null for never.

    With sensors, `threshold` has those of each.
    """
    points, allowed = feasible.points, np.isin(range(feasible.possible), feasible.allowed)
    thresholds = np.where(allowed, rule.thresholds_of(range(feasible.possible)), NEVER)
    thresholds[[*feasible.required]] = ALWAYS
    each = thresholds.reshape(-1, points.ways).T.tolist()
    threshold = dict(zip(points.sensors, each, strict=True)) if points.sensors else each[0]
    return finite({"threshold": threshold, "exponent": rule.exponent, "limit": rule.limit})


def keep_rule(run: Path, answer: Mapping[str, Any]) -> None:
    """Write the answer about a rule to rule.json; the caller holds the run's lock."""
    write_about(run, run_key(run) or "", {FILE: json.dumps(answer, indent=2)})


def rule_of(run: Path, feasible: Feasible) -> Thresholds:
    """The rule that was tuned last for a run; a `StoreError` if there is none."""
    if not os.path.lexists(run / FILE):
        raise StoreError(f"{run} has no rule: `pfdist rule {run}` tunes one")
    content, sensors = read_listed(run, FILE), feasible.points.sensors or [""]
    try:
        written = _Written.read(parse_json(content)["rule"])
        return written.rule(sensors, feasible.horizon + 1)
    except (ValueError, TypeError, KeyError) as error:
        raise _damaged(run / FILE, error) from error


def _damaged(path: Path, error: Exception, more: str = "") -> StoreError:
    """The error that names a wrong key of a file."""
    what = str(error)
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        what = f"{'.'.join(map(str, first['loc']))}: {first['msg']}, got {shown(first['input'])}"
    what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else what
    return StoreError(
        f"{path} is damaged ({what}){more}: `pfdist rule {path.parent}` writes it again"
    )
