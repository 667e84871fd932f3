"""A table that a user hands over: the path of a file, or a DataFrame."""

from pathlib import Path
from typing import Any

import pandas as pd

from pfdist.common.arguments import path_argument

Table = str | Path | pd.DataFrame
"""The path of a table in CSV or Parquet, or a table in memory."""


def table_argument(name: str, value: Any) -> Path | pd.DataFrame:
    """An argument as a path or a DataFrame; an `ArgumentError` if it is neither."""
    return value if isinstance(value, pd.DataFrame) else path_argument(name, value)
