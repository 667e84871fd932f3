"""Rows of tables as a run stores them."""

import numpy as np
import pyarrow as pa

from pfdist.store import comparison_schema


def compared_rows(first: int, last: int) -> pa.Table:
    """The comparison of one set on the draws first..last-1."""
    draw = np.arange(first, last)
    columns = {"draw": draw, "mse_a": draw / 2, "degenerate_a": draw < 0}
    return pa.table(columns, schema=comparison_schema(["a"]))
