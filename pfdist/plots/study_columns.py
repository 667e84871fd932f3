"""Which columns of a table of many runs a figure draws, and how their axes are labelled."""

from collections.abc import Sequence

import pandas as pd

from pfdist.analysis.studies import SEED, SET, columns_of
from pfdist.analysis.table_cells import keys_of
from pfdist.errors import ArgumentError
from pfdist.plots.panel import chosen, verbatim

_PER_CENT = {
    "gain_of_means": "gain of means [%]",
    "mean_relative_gain": "mean relative gain [%]",
    "positive_fraction": "draws with a gain [%]",
    "loss": "loss [%]",
    "bound_gap": "gap to the lower bound [%]",
    "bound_gap_at_most": "gap to the lower bound, at most [%]",
}
_LABELS = {
    "expected_mse": "expected MSE",
    "reference_mse": "expected MSE of the reference",
    "worker_seconds": "time of all workers [s]",
    "bound": "lower bound",
} | _PER_CENT


def key_among(
    frame: pd.DataFrame, key: str | None, argument: str, among: Sequence[str] = ()
) -> str:
    """Give a column of a table of runs that holds a key; by default the first in which jobs differ.

    Parameters
    ----------
    frame : DataFrame
    key : str or None
    argument : str
        For errors.
    among : sequence of str
        Further columns that are allowed.

    Raises
    ------
    ArgumentError
        There is no such key, or the table is not a table of runs.
    JobError
        The table has other keys.
    """
    for name in ("run", SET):
        if name not in frame.columns:
            raise ArgumentError(
                f"table must be a table of runs as pfdist.table gives it, but lacks the column "
                f"{name}",
                argument="table",
            )
    keys = keys_of(frame)
    if key is not None:
        return chosen(key, [*keys, *among], argument)
    varying = [name for name in (*columns_of(frame), *keys) if name not in (SET, SEED)]
    if not varying:
        raise ArgumentError(
            f"{argument} must be a key in which the jobs differ, but the jobs of the table differ "
            "in none but the seed",
            argument=argument,
        )
    return varying[0]


def value_among(frame: pd.DataFrame, value: str) -> str:
    """Give a column of a table of runs that holds numbers.

    Raises
    ------
    JobError
        There is no such column.
    """
    first = list(frame.columns).index(SET)
    numbers = [
        str(name)
        for name in frame.columns[first:]
        if pd.api.types.is_numeric_dtype(frame[name]) and not str(name).endswith(("_low", "_high"))
    ]
    return chosen(value, numbers, "value")


def label_of(value: str) -> str:
    """Give the label of an axis with a result."""
    return _LABELS.get(value) or verbatim(value.replace("_", " "))


def is_in_per_cent(value: str) -> bool:
    """Whether figures have a result in per cent."""
    return value in _PER_CENT
