"""Columns of components of x, y and z, by the names that a model gives to the components."""

from collections.abc import Sequence

import pandas as pd

from pfdist.common.component_names import Component

LABELS = "labels"
"""Under this name the attributes of a DataFrame hold the labels of its columns."""


def components_in(table: pd.DataFrame, start: str) -> tuple[Component, ...]:
    """Give the components whose columns begin with these characters, such as ``z_``.

    The names and units are those of the attribute ``labels`` of the table. A column without a label
    is called after its suffix, unless that is a number.
    """
    labels = table.attrs.get(LABELS, {})
    return tuple(
        _component(str(column).removeprefix(start), labels.get(column, ""))
        for column in table.columns
        if str(column).startswith(start)
    )


def _component(suffix: str, label: str) -> Component:
    if not label:
        return Component(suffix, "" if suffix.isdecimal() else suffix)
    name, _, unit = label.partition(" [")
    return Component(suffix, name, unit.removesuffix("]"))


def labels_of(start: str, components: Sequence[Component]) -> dict[str, str]:
    """Give the labels of the columns of components that have names, by column."""
    return {f"{start}{each.suffix}": each.label for each in components if each.name}
