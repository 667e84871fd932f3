"""Doubts about the filter of one system: improbable measurements, and few particles."""

from collections.abc import Iterable

from pfdist.filters.filter_estimate import FilterEstimate, few_particles
from pfdist.problem.clock import Clock, Time

IMPROBABLE = 0.01  # for the most surprising of all measurements: the model may be wrong
SEE_SURPRISE = (
    "The model may be wrong about this system: look at the surprise that pfdist filter shows."
)


def surprise_of(estimates: Iterable[FilterEstimate]) -> float | None:
    """The p-value of the most surprising among all measurements (Bonferroni)."""
    surprises = [each.surprise for each in estimates if each.surprise is not None]
    return min(1.0, len(surprises) * min(surprises)) if surprises else None


def few_at(t: Time | None, clock: Clock) -> list[str]:
    """The sentence that the estimate is that of a few particles, if a filter collapses at t."""
    return [] if t is None else [few_particles(f"at t = {clock.listed([t])}")]
