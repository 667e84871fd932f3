"""The key of a compared set: the origin of its times, and their number if a run has several.

The key determines the noise of the set's filter and the id of its evaluations, and it is the set's
name in tables. Users see labels, so a new label changes no number.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pfdist.common.measurement_times import EVEN, MOST_REGULAR, REGULAR
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.methods import METHODS
from pfdist.problem.sections import DEFAULT_METHOD, EVENLY_SPACED, REFERENCE

PLAN = "plan"
"""Label of the set that a search found; that of one of several searches ends with it."""
_ALONE, _IN_TURN = " alone", "sensors in turn"  # labels of regular times of sensors


@dataclass(frozen=True)
class SetKey:
    """The key of a compared set.

    Parameters
    ----------
    origin : str
        Name of the search that found the set, ``regular``, ``reference``, or a user's name.
    number : str
        Number of measurements, with as many digits as the largest number; empty unless the run has
        several numbers.

    Examples
    --------
    >>> SetKey("regular", "05").column, SetKey("genetic").column
    ('regular_05', 'genetic')
    """

    origin: str
    number: str = ""

    @property
    def column(self) -> str:
        """The set's name in columns of tables."""
        return f"{self.origin}_{self.number}" if self.number else self.origin


def labels_of_sets(columns: Iterable[str], job: Mapping[str, Any]) -> dict[str, str]:
    """The labels of sets in tables and figures, by name.

    The set of a search is the plan; of several searches, each has a plan with its name. References
    of a problem with sensors say which of them measure.

    >>> job = {"search": [{"name": "genetic"}]}
    >>> labels_of_sets(["evenly_spaced", "genetic", "mine"], job)
    {'evenly_spaced': 'evenly spaced', 'genetic': 'plan', 'mine': 'mine'}
    >>> two = {"search": [{"name": "genetic"}, {"name": "random"}]}
    >>> [*labels_of_sets(["genetic", "random"], two).values()]
    ['genetic plan', 'random plan']
    >>> [*labels_of_sets(["plan", "genetic"], job).values()]
    ['plan', 'genetic plan']
    >>> labels_of_sets(["relaxation"], {}), labels_of_sets(["relaxation", "genetic"], {})
    ({'relaxation': 'plan'}, {'relaxation': 'relaxation', 'genetic': 'genetic'})
    >>> labels_of_sets(["evenly_spaced"], {"problem": {"measurement_budget": 2}})
    {'evenly_spaced': 'regular'}
    >>> labels_of_sets(["hand"], {"comparison": {"labels": {"hand": "an hour after meals"}}})
    {'hand': 'an hour after meals'}
    >>> labels_of_sets(["alone_ct", "rotation"], {"problem": {"sensors": {"ct": {}}}})
    {'alone_ct': 'ct alone', 'rotation': 'sensors in turn'}
    """
    keys = {column: set_key_of(column, job) for column in columns}
    searches = [search["name"] for search in job.get("search", ())]
    if not searches:  # a comparison has sets of runs, and several that were found are named alike
        found = [column for column in keys if column.endswith((*METHODS,))]
        searches = [DEFAULT_METHOD] * (found == [DEFAULT_METHOD])
    number = job.get("problem", {}).get("measurement_budget") or MOST_REGULAR + 1
    labels = {EVEN: REGULAR if number <= MOST_REGULAR and not has_amounts(job) else EVENLY_SPACED}
    labels |= job.get("comparison", {}).get("labels") or {}
    for sensor in job.get("problem", {}).get("sensors", ()):
        labels |= {f"alone_{sensor.lower().replace('-', '_')}": f"{sensor}{_ALONE}"}
        labels["rotation"] = _IN_TURN
    alone = len(searches) == 1 and PLAN not in keys
    for search in searches:
        labels[search] = PLAN if alone or search == PLAN else f"{search} {PLAN}"
    is_money = "total_price" in job.get("problem", {})
    return {
        column: _label(labels.get(key.origin, key.origin), key, is_money)
        for column, key in keys.items()
    }


def phrase_of(label: str) -> str:
    """The phrase for a set in sentences, from its label.

    >>> phrase_of("plan"), phrase_of("5 evenly spaced"), phrase_of("mine")
    ('the plan', '5 evenly spaced times', 'the set mine')
    >>> phrase_of("evenly spaced for 300"), phrase_of("genetic plan of 5")
    ('evenly spaced times for 300', 'the genetic plan of 5')
    >>> print(phrase_of("an hour after meals"))
    "an hour after meals"
    """
    origin, _, price = label.partition(" for ")
    if price:
        return f"{phrase_of(origin)} for {price}"
    if label.endswith((EVENLY_SPACED, REGULAR)):
        return f"{label} times"
    if label.endswith((_ALONE, _IN_TURN)):
        return label
    is_title = label.partition(" of ")[0].split(" ")[-1] in (PLAN, REFERENCE)
    if is_title:
        return f"the {label}"
    return f'"{label}"' if " " in label else f"the set {label}"


def _label(origin: str, key: SetKey, is_money: bool) -> str:
    if not key.number:
        return origin
    number = key.number.lstrip("0")
    if is_money:
        return f"{origin} for {number}"
    return f"{number} {origin}" if origin in (EVENLY_SPACED, REGULAR) else f"{origin} of {number}"


def set_key_of(column: str, job: Mapping[str, Any]) -> SetKey:
    """The key of a set by its name in columns, and the resolved job of its run."""
    if not has_amounts(job):
        return SetKey(column)
    origin, _, number = column.rpartition("_")
    return SetKey(origin, number)


def references_of(columns: Sequence[str], job: Mapping[str, Any]) -> dict[str, str]:
    """The reference of each compared set that is not a reference, by name.

    With several numbers of measurements, it has the number of the set.

    Parameters
    ----------
    columns : sequence of str
        Names of the compared sets, a reference first.
    job : mapping
        The run's resolved job.
    """
    keys = {column: set_key_of(column, job) for column in columns}
    reference = keys[columns[0]].origin
    return {
        column: SetKey(reference, key.number).column
        for column, key in keys.items()
        if key.origin != reference
    }
