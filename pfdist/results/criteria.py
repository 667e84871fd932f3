"""The criteria by which a run judges its sets besides the expected MSE."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pfdist.filters.aspects import Aspect
from pfdist.filters.criterion import OtherCriterion, Sample, other_criteria_of
from pfdist.results.columns import Results
from pfdist.results.over_time import RANGE_SUMS, Array, Range, errors_over_time_of, ranges_of
from pfdist.results.stored_run import StoredRun, criterion_of, exact_values, problem_of


def other_criteria(run: StoredRun) -> dict[str, OtherCriterion]:
    """The criteria of a run by their names; empty if only the expected MSE counts."""
    comparison = run.job["comparison"]
    return other_criteria_of(run.job["problem"].get("criterion"), comparison.get("also"))


def fields_over_time(ranges: list[Range], place: int, weights: Array) -> dict[str, Any]:
    """The fields of a `Sample` with the errors of the set at this place of the ranges, if any."""
    if not ranges:
        return {}
    errors, standard_errors = (each[weights > 0.0] for each in errors_over_time_of(ranges, place))
    return {"errors": errors, "standard_errors": standard_errors, "degrees": len(ranges) - 1.0}


def samples_of(run: StoredRun) -> dict[str, Sample]:
    """The results of each compared set by name."""
    rows, problem = run._store.rows("comparison"), problem_of(run)
    ranges = ranges_of(run) if run._store.has(RANGE_SUMS) else []
    weights = np.array(problem.weights or (1.0,) * len(problem.clock.times))
    wanted = [aspect for each in other_criteria(run).values() for aspect in each.aspects]
    known = {aspect: values for aspect in wanted if (values := _values_of(run, aspect))}
    return {
        name: Sample(
            rows[f"mse_{name}"].to_numpy(),
            aspects={aspect: values[name] for aspect, values in known.items()},
            **fields_over_time(ranges, place, weights),
        )
        for place, name in enumerate(run.names)
    }


def _values_of(run: StoredRun, aspect: Aspect) -> dict[str, Array]:
    """The values of an aspect for each set by name: of draws, or an exact one."""
    if exact := exact_values(run, aspect.exact_column):
        return {name: np.array([value]) for name, value in exact.items()}
    if not run._store.has(aspect.table):
        return {}
    rows = run._store.rows(aspect.table)
    return {name: rows[f"{aspect.named}_{name}"].to_numpy() for name in run.names}


def columns_of_criteria(run: StoredRun) -> Iterator[tuple[str, Results]]:
    """The name of each set, and its columns by the criteria.

    A set also has its gain over its reference by the criterion of the job.
    """
    wanted, form = other_criteria(run), criterion_of(run)
    samples = samples_of(run) if wanted else {}
    for name, sample in samples.items():
        columns: Results = {}
        for criterion in wanted.values():
            judged = criterion.of_sample(sample)
            columns |= judged.columns(criterion.name)
            if criterion == form:
                columns["criterion_value"] = judged.value * criterion.sign
                if name in run.references:
                    gain = criterion.change(sample, samples[run.references[name]])
                    columns |= gain.columns("criterion_gain")
        yield name, columns
