"""The figure of the budget curve: what it draws, and its title."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pfdist
from pfdist import Job
from pfdist.pages.figure import FIGURES, Tables
from pfdist.pages.plots import budget
from pfdist.pages.style import BLUE, RED
from pfdist.plugins.budget.page import best_reference


def _axes() -> Axes:
    axes: Axes = Figure().subplots()
    return axes


@pytest.fixture
def curve() -> pd.DataFrame:
    """A budget curve with a lower bound for 3 numbers of measurements, of which 4 lacks one."""
    costs = {"regular": [9.0, 7.0, 8.0, 6.0], "found": [8.0, 6.0, 5.0, 4.0]}
    table = pd.DataFrame(
        [
            {"kind": kind, "budget": number, "measurement_times": [*range(number)]}
            | {
                "expected_mse": mse,
                "expected_mse_low": mse - 0.2,
                "expected_mse_high": mse + 0.2,
                "draws": 100,
            }
            | {"standard_error": 0.1, "bound": np.nan, "bound_low": np.nan}
            | {"particle_loss": np.nan, "particle_loss_limit": np.nan}
            for kind, column in costs.items()
            for number, mse in enumerate(column, start=2)
        ]
    )
    table.loc[table["kind"] == "found", "bound"] = [7.8, 5.8, np.nan, 3.8]
    table.loc[table["kind"] == "found", "bound_low"] = [7.5, 5.5, np.nan, 3.5]
    return table


def test_the_budget_has_a_curve_each_for_regular_and_found_times_and_the_bound(
    curve: pd.DataFrame,
) -> None:
    axes = budget(curve, ax=_axes())
    names = {text.get_text(): text.get_color() for text in axes.texts}
    colours = {"regular": BLUE, "plan": RED, "lower bound": "black"}
    colours["its 95 % limit"] = "black"
    assert {name: names[name] for name in colours} == colours
    heights = {text.get_text(): text.get_position()[1] for text in axes.texts}
    assert [*colours] == sorted(colours, key=heights.get, reverse=True)
    [line] = [each for each in axes.get_lines() if each.get_label() == "lower bound"]
    np.testing.assert_array_equal(line.get_xdata(), [2, 3, 4, 5])
    np.testing.assert_array_equal(line.get_ydata(), [7.8, 5.8, np.nan, 3.8])
    shade = np.concatenate([path.vertices for path in axes.collections[-1].get_paths()])
    assert (shade[:, 1].min(), shade[:, 1].max()) == (3.5, 7.8)
    lines = [container[0].get_ydata().tolist() for container in axes.containers]
    assert lines == [[9.0, 7.0, 8.0, 6.0], [8.0, 6.0, 5.0, 4.0]]


def test_the_title_of_a_budget_has_the_numbers_of_the_tables(
    small_job: Job, tmp_path: Path
) -> None:
    changes = ["model.name=random_walk", "filter.engine=kalman", "problem.horizon=6"]
    several = pfdist.budget(
        small_job, (2, 3), tmp_path / "run", draws=20, changes=changes, figures=False
    )
    mse = several.table("sets").pivot_table("expected_mse", "measurements", "kind")
    lower = (100 * (1 - mse["found"] / mse["regular"])).round()
    assert (lower.min(), lower.nunique()) > (0, 1)
    [(_, plot)] = FIGURES["budget"].plots(Tables(several))
    said = f"{lower.min():.0f} to {lower.max():.0f} % lower than that of regular times"
    assert f"of the plan is {said}, depending on N." in plot.title


def test_an_arrow_says_how_many_measurements_the_plan_spares(curve: pd.DataFrame) -> None:
    """The error of 5 evenly spaced times is 6: 3 planned times reach it, and 2 do not."""
    [arrow] = [each for each in budget(curve, ax=_axes()).texts if hasattr(each, "arrow_patch")]
    assert (arrow.xy, arrow.xyann) == ((3, 6.0), (5, 6.0))
    assert "at least as good: 3 instead of 5" in [
        text.get_text() for text in budget(curve, ax=_axes()).texts
    ]
    errors = [f"expected_mse{end}" for end in ("", "_low", "_high")]
    worse = curve.assign(**{key: curve[key] + 9 * (curve["kind"] == "found") for key in errors})
    texts = [text.get_text() for text in budget(worse, ax=_axes()).texts]
    assert not any("as good" in text for text in texts)


def test_the_arrow_begins_at_the_best_number_of_evenly_spaced_times(curve: pd.DataFrame) -> None:
    """More evenly spaced times may do worse; then the plan is compared with fewer."""
    assert best_reference(curve)["budget"] == 5
    last = (curve["kind"] != "found") & (curve["budget"] == 5)
    worse = curve.assign(expected_mse=curve["expected_mse"].where(~last, 99.0))
    best = best_reference(worse)
    assert (best["budget"], best["expected_mse"]) == (3, 7.0)
