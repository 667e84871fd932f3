"""The expected information of the measurements about the path, and what is learned, in nats.

Reference: Grosse, Ancha, Roy, "Measuring the reliability of MCMC inference with bidirectional Monte
Carlo", NeurIPS 2016 (both sides of an evidence).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.common.changes import is_clear
from pfdist.common.estimate import Estimate
from pfdist.common.percent import ROUNDING, other_sets, rounded_up
from pfdist.common.rounding import WIDE, rounded, with_sides
from pfdist.filters.aspects import Aspect
from pfdist.filters.criterion import (
    Array,
    Bound,
    CriterionValue,
    OtherCriterion,
    Sample,
    criterion,
)
from pfdist.kernels.estimators import EVIDENCE, INFORMATION
from pfdist.kernels.schemes import CONDITIONAL, MULTINOMIAL

if TYPE_CHECKING:
    from pfdist.filters.work import Estimation


_IDLE = 4.0  # a gap from which a bound says nothing: others may give five times as much


class Sides(CriterionValue):
    """A lower side, from the lower end of its interval to the upper end of an upper side."""

    __slots__ = ()

    def text(self, unit: str = "") -> str:
        """The number with its unit and interval; if the upper side is far away, both as limits."""
        limits = with_sides(*self, unit)
        return f"{limits}; more particles bring both closer" if limits else super().text(unit)


def information_estimation(own: "Estimation") -> "Estimation":
    """The estimation of the information, with as many particles, one of which is the truth."""
    return own.another(INFORMATION.name, CONDITIONAL.name)


def evidence_estimation(own: "Estimation") -> "Estimation":
    """The estimation of the log evidence; its control is that of a filter beside the truth."""
    return own.another(EVIDENCE.name, MULTINOMIAL.name)


LOWER_SIDE = Aspect(
    "information", "that measurements give about the path; a lower side of its mean",
    information_estimation, unit="nats", sign=-1.0, of_all_draws=True,
)  # fmt: skip
GAP = Aspect(
    "information_gap", "log evidence of a filter beside the truth, less that of one without it",
    evidence_estimation, start="gap", unit="nats", sign=-1.0, is_controlled=True,
)  # fmt: skip


@criterion
@dataclass(frozen=True)
class Information(OtherCriterion):
    """The expected information of the measurements about the path, and what is learned, in nats.

    The number that is minimised is its negative.
    """

    name: str = "information"
    label: str = "information"
    short: str = "information"
    meaning: str = (
        "expected information about the path, and about what is learned; a lower side of "
        "particles, whose interval ends where that of the upper side does"
    )
    unit: str = "nats"
    is_side: bool = True
    most: str = "most"
    additive: bool = True
    bound: Bound = "submodular"
    proof: str = (
        "Information about the path is submodular: what one measurement adds is never more if "
        "others were made before. So the information of N times is at most that of the found times "
        "and the N largest gains by one more measurement; and at most that of all possible "
        "measurements. The smaller of both is the upper bound. It holds if the model is right."
    )
    sign: int = -1
    of_each_draw: bool = False
    aspects: tuple[Aspect, ...] = (LOWER_SIDE, GAP)

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The lower side, from the lower end of its interval to the upper end of the upper side."""
        below = Estimate.of_mean(sample.values_of(LOWER_SIDE))
        return Sides(
            *self._between(below, below, _and_mean(sample.values_of(LOWER_SIDE), _gap(sample)))
        )

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The nats that a set gives more than another."""
        more = sample.values_of(LOWER_SIDE) - other.values_of(LOWER_SIDE)
        low, high = _and_mean(more, -_gap(other)), _and_mean(more, _gap(sample))
        return self._between(Estimate.of_mean(more), low, high)

    @staticmethod
    def _between(value: Estimate, below: Estimate, above: Estimate) -> CriterionValue:
        if value.degrees == math.inf:  # exact: a single draw
            return CriterionValue(value.value, value.value, value.value)
        low, high = (
            each.interval()[place] if math.isfinite(each.value) else each.value
            for place, each in enumerate((below, above))
        )
        return CriterionValue(value.value, low, high)

    def aim(self, z: str) -> str:
        """The information, for the end of a question."""
        return "the most information about the path"

    def than(self, change: CriterionValue, other: str) -> str:
        """The nats that a set tells more than another, for a sentence."""
        return f"{change.text(self.unit)} more than {other}"

    def sentence(self, value: CriterionValue, change: CriterionValue, reference: str) -> str:
        """The information, in bits, too, and how much more that is than with the reference.

        >>> value, change = CriterionValue(9.0, 8.9, 9.1), CriterionValue(0.01, -0.2, 0.2)
        >>> Information().sentence(value, change, "7 times").partition(", not ")[2]
        'clearly another number than 7 times: 0.01 nats (95 % CI -0.20 to 0.20) more.'
        """
        limits = with_sides(*value, self.unit)
        text = limits or CriterionValue(*value).text(self.unit)
        bits = rounded((value.low if limits else value.value) / math.log(2), 3)
        gain, low, high = change
        more = CriterionValue(abs(gain), *((low, high) if gain >= 0 else (-high, -low)))
        than = f"{more.text(self.unit)} {'more' if gain >= 0 else 'less'}"
        if is_clear((low, high)):
            than = f"{than} than {reference}"
        else:
            than = f"not clearly another number than {reference}: {than}"
        help_ = ""
        if value.high - value.low > WIDE * abs(value.value):
            help_ = " More particles, or more draws, narrow the interval."
        if limits:
            help_ = " More filter.particles bring both limits closer."
        return f"They give {text} of information about the path ({bits} bits), {than}.{help_}"

    def proof_sentence(
        self, gap: Mapping[str, Any], measurements: int, *, has_fewer: bool, **about: bool
    ) -> str:
        """How many more nats other times can give.

        >>> gap = {"expected_mse": -2.0, "budget": 4, "gap_at_most": 0.0, "bound_error": 0.1}
        >>> Information().proof_sentence(gap, 4, has_fewer=False)
        'Proved: no other 4 times give more nats.'
        >>> more = {**gap, "gap_at_most": 0.25, "bound_error": 0.0}
        >>> Information().proof_sentence(more, 3, has_fewer=False)
        'Proved: no other times that are no more expensive give more than a further 0.50 nats.'
        """
        times, is_one = other_sets(gap, measurements, has_fewer=has_fewer)
        gives = "gives" if is_one else "give"
        if gap["gap_at_most"] < ROUNDING:
            return f"Proved: no other {times} {gives} more nats."
        if gap["gap_at_most"] >= _IDLE:
            return (
                "The bound says nothing yet: others may give over five times as many nats. More "
                "particles help."
            )
        more = rounded(rounded_up(-gap["expected_mse"] * gap["gap_at_most"]), 2)
        sure = f" ({100 * gap['confidence']:.3g} % confidence)" if gap["bound_error"] else ""
        return f"Proved: no other {times} {gives} more than a further {more} nats{sure}."


def _gap(sample: Sample) -> Array:
    return sample.aspects.get(GAP, np.zeros(1))


def _and_mean(values: Array, others: Array) -> Estimate:
    """The sum of two means, if the other one may be that of the first draws alone."""
    if others.size == values.size:
        return Estimate.of_mean(values + others)
    return Estimate.of_mean(values).plus(Estimate.of_mean(others))
