"""The criteria by which a run judges its sets besides the expected MSE."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pfdist.filters.criterion import Judging, Sample, judging_of
from pfdist.results.columns import Results
from pfdist.results.over_time import RANGE_SUMS, errors_over_time_of, ranges_of
from pfdist.results.stored_run import StoredRun, criterion_of, exact_information, problem_of


def judging(run: StoredRun) -> dict[str, Judging]:
    """The criteria by their names; empty if only the expected MSE counts."""
    comparison = run.job["comparison"]
    return judging_of(run.job["problem"].get("criterion"), comparison.get("also"))


def samples_of(run: StoredRun) -> dict[str, Sample]:
    """The results that the criteria judge, of each compared set by name."""
    rows, exact = run._store.rows("comparison"), exact_information(run)
    told = run._store.rows("information") if run._store.has("information") else {}
    gaps = run._store.rows("information_gap") if told else {}
    ranges = ranges_of(run) if run._store.has(RANGE_SUMS) else []
    counts = np.array(problem_of(run).weights or (1.0,) * len(problem_of(run).clock.times)) > 0.0
    samples = dict[str, Sample]()
    for place, name in enumerate(run.names):
        sample = Sample(rows[f"mse_{name}"].to_numpy())
        if ranges:
            errors, apart = errors_over_time_of(ranges, place)
            sample = replace(sample, errors=errors[counts], standard_errors=apart[counts])
            sample = replace(sample, degrees=len(ranges) - 1.0)
        if name in exact:
            sample = replace(sample, information=np.array([exact[name]]))
        elif told:
            own, gap = told[f"information_{name}"], gaps[f"gap_{name}"]
            sample = replace(sample, information=own.to_numpy(), gap=gap.to_numpy())
        samples[name] = sample
    return samples


def columns_of_criteria(run: StoredRun) -> Iterator[tuple[str, Results]]:
    """The name of each set, and its columns by the criteria.

    A set also has its gain over its reference by the criterion of the job.
    """
    wanted, form = judging(run), criterion_of(run)
    samples = samples_of(run) if wanted else {}
    for name, sample in samples.items():
        columns: Results = {}
        for criterion in wanted.values():
            judged = criterion.judged(sample)
            columns |= judged.columns(criterion.name)
            if criterion == form:
                columns["criterion_value"] = judged.value * criterion.sign
                if name in run.references:
                    gain = criterion.change(sample, samples[run.references[name]])
                    columns |= gain.columns("criterion_gain")
        yield name, columns
