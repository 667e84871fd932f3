"""Columns of instants, as times on the clock of a run."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.store.component_columns import LABELS

_INSTANTS: Final = ("t", "moved_to", "end", "measurement_times", "path")


@dataclass(frozen=True)
class ClockColumns:
    """Turns columns of instants into columns of times, in the clock's unit.

    Parameters
    ----------
    times : tuple of float, (T+1,)
        The time of each instant.
    unit : str
        The unit, for the metadata of the columns.
    """

    times: tuple[float, ...]
    unit: str

    def table(self, rows: pa.Table) -> pa.Table:
        """Give a table with times in the place of instants; columns of times stay as they are."""
        clock = np.array(self.times)
        for index, field in enumerate(rows.schema):
            if _holds_instants(field):
                column = rows.column(index).combine_chunks()
                rows = rows.set_column(index, self._field(field), _timed(column, clock))
        return rows

    def schema(self, schema: pa.Schema) -> pa.Schema:
        """Give the schema of such a table."""
        for index, field in enumerate(schema):
            if _holds_instants(field):
                schema = schema.set(index, self._field(field))
        return schema

    def _field(self, field: pa.Field) -> pa.Field:
        kind = pa.list_(pa.float64()) if pa.types.is_list(field.type) else pa.float64()
        metadata = dict(field.metadata or {}) | {b"unit": self.unit.encode()}
        return pa.field(field.name, kind, metadata=metadata)


def frame_of(table: pa.Table) -> pd.DataFrame:
    """Give a DataFrame with what the metadata says of its columns.

    If the column t has times on a clock, the DataFrame has the attribute ``time_unit``. If columns
    are those of components with names, it has the attribute ``labels``: names and units by column.
    """
    frame: pd.DataFrame = table.to_pandas()
    index = table.schema.get_field_index("t")
    if index >= 0 and pa.types.is_floating(table.schema.field(index).type):
        metadata = table.schema.field(index).metadata or {}
        frame.attrs["time_unit"] = metadata.get(b"unit", b"").decode()
    labels = {
        field.name: field.metadata[b"label"].decode(errors="replace")
        for field in table.schema
        if b"label" in (field.metadata or {})
    }
    if labels:
        frame.attrs[LABELS] = labels
    return frame


def _holds_instants(field: pa.Field) -> bool:
    kind = field.type.value_type if pa.types.is_list(field.type) else field.type
    return field.name in _INSTANTS and pa.types.is_integer(kind)


def _timed(column: pa.Array, clock: NDArray[np.float64]) -> pa.Array:
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
    if pa.types.is_list(column.type):
        values = pa.array(clock[column.flatten().to_numpy(zero_copy_only=False)])
        offsets = column.offsets.to_numpy()  # a slice of a column begins later
        return pa.ListArray.from_arrays(
            pa.array(offsets - offsets[0]), values, mask=column.is_null()
        )
    return pa.array(clock[column.to_numpy(zero_copy_only=False)])
