"""Checks that the estimates of all compared sets have columns of their own."""

from collections.abc import Sequence

from pfdist.common.component_names import Component
from pfdist.errors import JobError


def check_estimate_columns(sets: Sequence[str], components: Sequence[Component]) -> None:
    """Raise an error if the estimates of two sets would have columns of one name.

    Raises
    ------
    JobError
        The set ``a`` with the component ``b c`` and the set ``a_b`` with the component ``c``, say.
    """
    known = dict[str, tuple[str, str]]()
    for name in sets:
        for each in components:
            column = f"estimate_{name}_{each.suffix}"
            if column in known:
                other, other_suffix = known[column]
                raise JobError(
                    "estimates must have different columns, got the column "
                    f"{column!r} for {other_suffix!r} of the set {other!r} and for {each.suffix!r} "
                    f"of the set {name!r}: give a search, or a set of comparison.sets, another name"
                )
            known[column] = name, each.suffix
