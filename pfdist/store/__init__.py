"""A run on disk: Parquet tables, committed atomically, which are also the checkpoint.

Only this package accesses a run's files. It defines tables, columns and keys; their meaning for a
search is in the driver.
"""

from pfdist.store.about import (
    add_to_provenance,
    check_models,
    has_models,
    key_of,
    read_listed,
    read_models,
    read_run,
    run_key,
    run_text,
    unusable,
    write_about,
)
from pfdist.store.files import remove as remove_file
from pfdist.store.files import write_file
from pfdist.store.folder import (
    ABOUT,
    RULE,
    check_entries,
    folder_of_run,
    holds_run,
    is_job_of_run,
)
from pfdist.store.listing import forget_pages, listed_pages, record_pages
from pfdist.store.lock import held, is_held
from pfdist.store.parquet import ROWS_IN_A_FILE, Store
from pfdist.store.schema import (
    BOUND_PHASE,
    EVEN_PHASE,
    FILTERED_PERCENTS,
    QUESTIONS,
    RULE_PHASE,
    SCHEMA_VERSION,
    SMOOTHED_START,
    WHY_PHASE,
    WINDOW_PERCENTS,
    TimeColumns,
    backtest_schema,
    comparison_schema,
    filtered_schema,
    first_draws_schema,
    frame_of,
    schema,
    trajectories_schema,
)
