"""Curves of the cost that a search has reached against its number of evaluations."""

from collections.abc import Callable

import numpy as np
import pandas as pd

from pfdist.search.methods import METHODS

Curve = Callable[[pd.DataFrame], pd.DataFrame]


def by_generation(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of the finite costs of each generation (the paper's curves)."""
    alive = rows[np.isfinite(rows["expected_mse"])]
    total = (alive["expected_mse"] * alive["copies"]).groupby(alive["generation"]).sum()
    groups = alive.groupby("generation")
    curve = pd.DataFrame(
        {"average": total / groups["copies"].sum(), "minimum": groups["expected_mse"].min()}
    )
    population = rows.groupby("generation")["copies"].sum().cumsum()
    return curve.set_index(population.reindex(curve.index))


def one_by_one(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of all evaluations so far."""
    rows = rows.sort_values(["generation", "individual"])
    cost = rows["expected_mse"].where(np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"average": cost.expanding().mean(), "minimum": cost.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum())


def best_of_each_step(rows: pd.DataFrame) -> pd.DataFrame:
    """Least cost of each generation, for sets that grow or shrink by one time a generation."""
    curve = by_generation(rows)
    return pd.DataFrame({"best of a step": curve["minimum"]})


def best_so_far(rows: pd.DataFrame) -> pd.DataFrame:
    """Least cost of all complete sets so far that were evaluated on all draws.

    Prefixes, and sets that were evaluated on fewer draws, only count as evaluations.
    """
    rows = rows.sort_values(["generation", "individual"])
    whole = (rows["end"] == rows["end"].max()) & (rows["draws"] == rows["draws"].max())
    cost = rows["expected_mse"].where(whole & np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"best so far": cost.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum()).dropna()


_CURVES: dict[str, Curve] = {
    "generations": by_generation,
    "trials": one_by_one,
    "best so far": best_so_far,
    "best of a step": best_of_each_step,
}


def curve_of(method: str) -> Curve:
    """Give the curves of a search method; those of generations if the method is unknown."""
    return _CURVES[METHODS[method].curve if method in METHODS else "generations"]
