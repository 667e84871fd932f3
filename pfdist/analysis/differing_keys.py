"""The keys in which the jobs of runs differ."""

from collections.abc import Iterable, Mapping
from typing import Any

from pfdist.common.leaves import leaves

_NO_SEARCH = "search"  # the leaf of an empty list; the key search.order says the same


def differing_keys(jobs: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """The keys in which jobs differ, each with the value of every job.

    Parameters
    ----------
    jobs : iterable of mapping
        Resolved jobs, as `pfdist.analysis.Run.job`.

    Returns
    -------
    dict of str to list
        The keys are dotted, in the order of the jobs' sections. The names of searches are in
        ``search.order`` alone. None stands for a key that a job lacks. Lists are tuples.

    Examples
    --------
    >>> differing_keys([{"seed": 1, "filter": {"particles": 9}}, {"seed": 2, "filter": {}}])
    {'seed': [1, 2], 'filter.particles': [9, None]}
    """
    flat = [{key: _frozen(value) for key, value in leaves(job)} for job in jobs]
    keys = dict.fromkeys(key for each in flat for key in each if not _is_repeated(key))
    columns = {key: [each.get(key) for each in flat] for key in keys}
    return {key: values for key, values in columns.items() if _differ(values)}


def _is_repeated(key: str) -> bool:
    """Whether another key says the same."""
    return key == _NO_SEARCH or (key.startswith("search.") and key.endswith(".name"))


def _differ(values: list[Any]) -> bool:
    return any(value != values[0] for value in values[1:])


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
