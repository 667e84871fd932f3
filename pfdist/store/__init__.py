"""A run on disk: Parquet tables, committed atomically, which are also the checkpoint.

Only this package touches a run's files. It knows tables, columns and keys; what they mean for a
search is the driver's.
"""

from pfdist.store.folder import holds_run, read_run, write_job, write_run
from pfdist.store.parquet import ROWS_IN_A_FILE, Store
from pfdist.store.schema import SCHEMA_VERSION, comparison_schema, schema, trajectories_schema

__all__ = [
    "ROWS_IN_A_FILE",
    "SCHEMA_VERSION",
    "Store",
    "comparison_schema",
    "holds_run",
    "read_run",
    "schema",
    "trajectories_schema",
    "write_job",
    "write_run",
]
