"""Sets of times that a job gives: the reference, and the named sets of [comparison.sets]."""

from collections.abc import Iterable

from pfdist.job.problem_section import ProblemSection
from pfdist.job.sections import RESERVED, Comparison
from pfdist.times.measurement_times import REGULAR, Times
from pfdist.times.written import validated_instants


def given_sets(comparison: Comparison, problem: ProblemSection) -> dict[str, Times | None]:
    """Instants of all sets that a job gives, by name, the reference first.

    None stands for the regular times of the problem. The clock of the problem reads the times.
    Raises `MeasurementTimesError` if a time lies outside the horizon, is no time of the clock, or
    stands twice; it names the key.
    """
    first = comparison.reference_name
    written = {name: (f"comparison.sets.{name}", times) for name, times in comparison.named.items()}
    if first not in written:
        written = {first: ("comparison.reference", comparison.reference), **written}
    written = {first: written[first], **written}
    return {
        name: None if times == REGULAR else validated_instants(times, problem.clock, key, key)
        for name, (key, times) in written.items()
    }


def check_names(comparison: Comparison, searches: Iterable[str]) -> None:
    """Check the names of the sets that a job gives, and those of its searches.

    Raises `ValueError` if a name is reserved or stands twice, or if the reference is no set of the
    job.
    """
    names = list(searches)
    for name in names:
        if name in RESERVED:
            raise ValueError(
                f"search names must not be {', '.join(map(repr, RESERVED))}, got {name!r}"
            )
        if names.count(name) > 1:
            raise ValueError(
                f"search names must be unique, got {name!r} twice: give one of these searches "
                'another name with name = "..."'
            )
        if name in comparison.named:
            raise ValueError(
                f"comparison.sets must have other names than the searches, got {name!r} in both"
            )
    reference = comparison.reference
    if isinstance(reference, str) and reference not in (REGULAR, *comparison.named):
        sets = ", ".join(map(repr, comparison.named)) or "which names none"
        raise ValueError(
            f"comparison.reference must be {REGULAR!r}, a list of times, for instance [0, 3, 6], "
            f"or the name of a set of comparison.sets ({sets}), got {reference!r}"
        )
    if not names and not comparison.named:
        raise ValueError(
            "search must name at least one search, unless comparison.sets gives sets to compare, "
            "got none"
        )
