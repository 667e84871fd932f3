"""Numbers of a JSON answer as text; None is an unknown or infinite number."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pfdist.common.rounding import rounded, with_interval

HEAVY = 0.2
"""If the largest 1 % of the draws carries more than this share of an expected MSE, the interval of
the mean is too short.

Light tails have 0.06 to 0.12. With 0.33 to 0.49, of log-normal errors, 72, 79 and 88 % of the
intervals from 250, 1,000 and 8,000 draws hold, for 95 %, and no interval from so few can do better.
"""


def times_100(fraction: float | None) -> float | None:
    """A fraction times 100; None stays None."""
    return None if fraction is None else 100 * fraction


def percent(fraction: float | None, decimals: int = 2) -> str:
    """A fraction as text in per cent."""
    if fraction is None:
        return "unknown"
    per_cent = 100 * fraction
    if abs(per_cent) < 0.5 * 10.0**-decimals:
        per_cent = 0.0  # without a minus sign
    return f"{per_cent:.{decimals}f} %" if abs(per_cent) < 1e6 else f"{rounded(per_cent, 3)} %"


def particle_loss_text(loss: float, limit: float) -> str:
    """The upper 95 % limit of a particle loss, and its estimate, in words.

    >>> particle_loss_text(0.0056, 0.018)
    'at most 1.80 % of the expected MSE (95 % confidence; estimate 0.56 %)'
    """
    low, high = percent(max(0.0, loss)), percent(min(1.0, max(0.0, loss, limit)))
    return f"at most {high} of the expected MSE (95 % confidence; estimate {low})"


def percent_with_interval(fraction: float | None, interval: list[float | None]) -> str:
    """A fraction in per cent with its 95 % interval, lower and upper end, as text."""
    value, low, high = with_interval(*(times_100(part) for part in (fraction, *interval)))
    return f"{value} % (95 % CI {range_of(low, high)} %)"


def heavy_tail_warning(shares: Iterable[float | None]) -> str:
    """A warning that the intervals of expected MSEs are too short, else nothing.

    Parameters
    ----------
    shares : iterable of float or None
        For each set the share of its expected MSE that the largest 1 % of the draws carries; see
        `pfdist.filters.estimate.largest_share`.

    Examples
    --------
    >>> heavy_tail_warning([0.41, 0.12, None])
    'Heavy tail: 1 % of the draws carries 41 % of the expected MSE; its interval is too short.'
    >>> heavy_tail_warning([0.1])
    ''
    """
    share = max((each for each in shares if each), default=0.0)
    return (
        f"Heavy tail: 1 % of the draws carries {percent(share, 0)} of the expected MSE; its "
        "interval is too short."
    ) * (share > HEAVY)


def range_of(low: str, high: str) -> str:
    """An interval as text, or "unknown" if both ends are unknown."""
    return low if low == high == rounded(None) else f"{low} to {high}"


ROUNDING = 1e-9
"""Error of exact values."""
_IDLE = 0.8  # a gap from which a bound says nothing: others are five times better
_HELP = {
    "relaxation": "More work of the proof helps (pfdist bound)",
    "estimate": "More particles help",
    "filter_model": "A filter with the true model helps",
}
"""What makes each part of a gap smaller."""


def relaxed_sentence(names: Sequence[str]) -> str:
    """The sentence that says which constraints a bound relaxes; empty if there are none.

    >>> relaxed_sentence(["most of visits", "together"])
    'The bound relaxes most of visits, and together: the gap may be smaller.'
    """
    if not names:
        return ""
    return f"The bound relaxes {', and '.join(names)}: the gap may be smaller."


CHECK_FAILS = "check-model finds that the likelihood is wrong"
RANKS_FAIL = "the log-likelihood does not fit the measurements"
"""How the reason for a missing bound begins if a likelihood is wrong."""


def gap_sentence(
    gap: Mapping[str, Any],
    measurements: int,
    *,
    has_fewer: bool = False,
    is_constrained: bool = False,
    has_scenarios: bool = False,
    label: str = "expected MSE",
) -> str:
    r"""The sentence that says how much lower the error of other times can be, given a bound.

    `gap` has the fields of `pfdist.runner.proof.Gap` as JSON, and ``confidence``. `measurements` is
    the number of measurements of the set, `has_fewer` is whether other sets may have fewer than the
    budget, `is_constrained` is whether other constraints exclude some times, and `label` is that
    of the criterion. Numbers have no-break spaces.

    >>> gap = {"budget": 4, "gap": 0.0, "bound_error": 0.0}
    >>> gap_sentence(gap, 4)
    'Proved: no other 4 times have a lower expected MSE.'
    >>> gap_sentence(gap, 3)
    'Proved: no other times that are no more expensive have a lower expected MSE.'
    >>> gap_sentence(gap, 3, has_fewer=True)
    'Proved: no other set of at most 4 times has a lower expected MSE.'
    >>> gap_sentence({**gap, "budget": 1}, 1, is_constrained=True)
    'Proved: no other time that the constraints allow has a lower expected MSE.'
    >>> gap_sentence({**gap, "gap": 0.5}, 4, has_scenarios=True).partition(", ")[2]
    'even with a filter that is told the scenario.'
    >>> estimated = gap | {"bound_error": 1.0, "confidence": 0.95, "gap": 0.017}
    >>> estimated = gap_sentence(estimated | {"gap_at_most": 0.0301}, 4).replace("\xa0", " ")
    >>> estimated.partition("by more than ")[2]
    'a further 3.1 % (95 % confidence; estimate 1.7 %).'
    """
    times, is_one = other_sets(gap, measurements, has_fewer=has_fewer)
    if is_constrained:
        times += f"{' and' * ('that' in times)} that the constraints allow"
    have, lower = ("has", "lowers") if is_one else ("have", "lower")
    if not gap["bound_error"] and gap["gap"] < ROUNDING:
        return f"Proved: no other {times} {have} a lower {label}."
    if idle := idle_bound(gap):
        return idle
    even_with = ", even with a filter that is told the scenario" if has_scenarios else ""
    return f"Proved: no other {times} {lower} the {label} {at_most(gap, even_with)}."


def idle_bound(gap: Mapping[str, Any]) -> str:
    r"""A sentence if a bound excludes nothing worth knowing: that it does, and what helps.

    `gap` may have the parts of `pfdist.runner.proof.Gap`, the largest of which decides what helps.

    >>> gap = {"bound_error": 1.0, "gap": 0.93, "gap_at_most": 1.0, "estimate": 0.6}
    >>> idle_bound(gap).replace("\xa0", " ")
    'The bound says nothing yet: other times may be 100 % better. More particles help.'
    >>> idle_bound({**gap, "gap": 0.3}).partition("better. ")[2]
    'More draws of the proof help (pfdist bound).'
    >>> idle_bound({**gap, "gap_at_most": 0.79})
    ''
    """
    limit = rounded_up(gap["gap_at_most"] if gap["bound_error"] else gap["gap"])
    if not limit >= _IDLE:
        return ""
    parts = {part: gap.get(part) or 0.0 for part in _HELP}
    help_ = _HELP[max(parts, key=lambda part: parts[part])]
    if gap["bound_error"] and gap["gap"] < limit / 2:  # it is chance
        help_ = "More draws of the proof help (pfdist bound)"
    better = f"other times may be {_percent(min(1.0, limit))} better"
    return f"The bound says nothing yet: {better}. {help_}."


def other_sets(gap: Mapping[str, Any], measurements: int, *, has_fewer: bool) -> tuple[str, bool]:
    """The sets for which a bound holds, in words, and whether these are singular."""
    budget = gap["budget"]
    if has_fewer:
        return f"set of at most {budget} time{'s' * (budget != 1)}", True
    if budget != measurements:  # the budget counts money
        return "times that are no more expensive", False
    return ("time", True) if measurements == 1 else (f"{measurements} times", False)


def at_most(gap: Mapping[str, Any], even_with: str = "") -> str:
    """The gap in words: first the proved limit, then its confidence and the estimate."""
    if not gap["bound_error"]:  # it is exact
        return f"by more than a further {_percent(rounded_up(gap['gap']))}{even_with}"
    limit = f"by more than a further {_percent(rounded_up(gap['gap_at_most']))}{even_with}"
    confidence = f"{100 * gap['confidence']:.3g}\xa0% confidence"
    return f"{limit} ({confidence}; estimate {_percent(gap['gap'])})"


def rounded_up(fraction: float) -> float:
    """The number rounded up to two digits, so that a limit holds as it is printed.

    >>> rounded_up(0.0441), rounded_up(0.0)
    (0.045, 0.0)
    """
    if fraction < ROUNDING:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(fraction)) - 1)
    return math.ceil(fraction / unit * (1 - 1e-12)) * unit


def _percent(fraction: float) -> str:
    return f"{rounded(100 * fraction, 2)}\xa0%"
