"""The expected MSE of each compared set in each scenario, on the draws of the comparison."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from pfdist.analysis.gains import ComparisonStatistics
from pfdist.common.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd


def scenarios_table(
    scenarios: Sequence[Scenario],
    names: list[str],
    references: Mapping[str, str],
    blocks: Iterable[pa.Table],
) -> pd.DataFrame:
    """A row for each scenario and set; columns as of the table ``scenarios``.

    Parameters
    ----------
    scenarios : sequence of Scenario
    names : list of str
        Names of the compared sets.
    references : mapping of str to str
        The set over which each other set gains.
    blocks : iterable of Table
        The table ``comparison`` in blocks.
    """
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    statistics = [ComparisonStatistics(names, references=references) for _ in scenarios]
    for rows in blocks:
        mse = np.stack([rows[f"mse_{name}"].to_numpy() for name in names], axis=1)
        of_draws = rows["scenario"].to_numpy()
        for number, each in enumerate(statistics):
            each.add(mse[of_draws == number])
    table = []
    for number, (scenario, each) in enumerate(zip(scenarios, statistics, strict=True)):
        for name in names:
            moments, gain = each.mse[name], each.gains.get(name)
            low, high = gain.of_means_interval if gain else (np.nan, np.nan)
            row = {
                "scenario": number,
                "share": scenario.share,
                "parameters": dict(scenario.parameters),
                "name": name,
                "draws": moments.count,
                "degenerate_draws": each.draws - moments.count,
                "expected_mse": moments.mean if moments.count else np.nan,
                "standard_error": moments.standard_error,
                "gain_of_means": gain.of_means if gain else np.nan,
                "gain_of_means_low": low,
                "gain_of_means_high": high,
            }
            table.append(row)
    return pd.DataFrame(table)
