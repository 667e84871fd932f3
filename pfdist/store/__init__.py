"""A run on disk: Parquet tables, committed atomically, which are also the checkpoint.

Only this package touches a run's files. It knows tables, columns and keys; what they mean for a
search is the driver's.
"""

from pfdist.store.about import folder_of_run, is_kept_job, read_run, unreadable
from pfdist.store.clock_columns import ClockColumns, frame_of
from pfdist.store.files import remove as remove_file
from pfdist.store.files import write_file
from pfdist.store.folder import (
    add_to_provenance,
    confirm,
    holds_run,
    write_job,
    write_run,
)
from pfdist.store.keys import ABOUT, has_key, keep_key, kept_keys, key_of, own_key, run_key
from pfdist.store.lock import check_not_held, held
from pfdist.store.manifest import Damage, Manifest
from pfdist.store.parquet import ROWS_IN_A_FILE, Store
from pfdist.store.schema import (
    BOUND_PHASE,
    FILTERED_PERCENTS,
    QUESTIONS,
    SCHEMA_VERSION,
    WHY_PHASE,
    WINDOW_PERCENTS,
    compared_schema,
    comparison_schema,
    distance_schema,
    filtered_schema,
    schema,
    trajectories_schema,
    variance_schema,
)
from pfdist.store.strange import check_entries, strange_entries
from pfdist.store.verify import lacking_evaluations, verify

__all__ = [
    "ABOUT",
    "BOUND_PHASE",
    "FILTERED_PERCENTS",
    "QUESTIONS",
    "ROWS_IN_A_FILE",
    "SCHEMA_VERSION",
    "WHY_PHASE",
    "WINDOW_PERCENTS",
    "ClockColumns",
    "Damage",
    "Manifest",
    "Store",
    "add_to_provenance",
    "check_entries",
    "check_not_held",
    "compared_schema",
    "comparison_schema",
    "confirm",
    "distance_schema",
    "filtered_schema",
    "folder_of_run",
    "frame_of",
    "has_key",
    "held",
    "holds_run",
    "is_kept_job",
    "keep_key",
    "kept_keys",
    "key_of",
    "lacking_evaluations",
    "own_key",
    "read_run",
    "remove_file",
    "run_key",
    "schema",
    "strange_entries",
    "trajectories_schema",
    "unreadable",
    "variance_schema",
    "verify",
    "write_file",
    "write_job",
    "write_run",
]
