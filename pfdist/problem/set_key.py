"""The key of a compared set: who gave its times, and their number in a run of several numbers.

The key decides the noise of the set's filter and the id of its evaluations, and it is the set's
name in tables. Labels are what people see, so other words change no number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pfdist.common.measurement_times import REGULAR
from pfdist.problem.sections import REFERENCE


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


def label_of(column: str) -> str:
    """The set as sentences and figures call it.

    >>> label_of("regular"), label_of("genetic")
    ('regular times', 'the times of genetic')
    """
    labels = {REGULAR: "regular times", REFERENCE: f"the {REFERENCE}"}
    return labels.get(column, f"the times of {column}")


def key_of(column: str, job: Mapping[str, Any]) -> SetKey:
    """The key of a set by its name in columns, and the resolved job of its run."""
    if "budget" not in job:
        return SetKey(column)
    origin, _, number = column.rpartition("_")
    return SetKey(origin, number)


def references_of(columns: Sequence[str], job: Mapping[str, Any]) -> dict[str, str]:
    """The reference of each compared set that is not a reference, by name.

    With several numbers of measurements, it has as many as the set.

    Parameters
    ----------
    columns : sequence of str
        Names of the compared sets, a reference first.
    job : mapping
        The run's resolved job.
    """
    keys = {column: key_of(column, job) for column in columns}
    reference = keys[columns[0]].origin
    return {
        column: SetKey(reference, key.number).column
        for column, key in keys.items()
        if key.origin != reference
    }
