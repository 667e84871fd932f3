"""A few outliers do not flatten a figure; arrows and numbers tell where they are."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oracles.in_turn import in_turn
from pfdist.pages.panel import shown_range
from pfdist.pages.plots import error_profile, searches
from pfdist.plugins.budget.figure import budget
from pfdist.plugins.why.figures import worth

RNG = np.random.default_rng(5)
WORTH = pd.DataFrame(
    {"name": "mine", "t": range(12), "removed": RNG.uniform(0.5, 2, 12), "removed_error": 0.1}
)


def _axes() -> Axes:
    return Figure().subplots()


def _arrows(axes: Axes) -> dict[str, list[float]]:
    """Places of the arrows at the upper and at the lower edge."""
    return {
        str(line.get_marker()): np.asarray(line.get_xdata()).tolist()
        for line in axes.get_lines()
        if line.get_marker() in ("^", "v") and line.get_transform() != axes.transData
    }


def _legend(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e9])
def test_limits_have_the_scale_of_the_values(factor: float) -> None:
    values = np.array([3.0, 1.0, 2.0, 1000.0]) * factor
    assert shown_range(values) == (1.0 * factor, 3.0 * factor)
    assert shown_range(-values) == (-3.0 * factor, -1.0 * factor)


BULK = RNG.uniform(1, 2, 38)
ENDS = (BULK.min(), BULK.max())


@in_turn(
    ("values", "limits"),
    [
        ([1.0, 2.0, 3.0, 9.0], None),  # the others have a quarter of the axis
        ([1.0, 2.0, 3.0, 9.1], (1.0, 3.0)),
        ([*BULK, 500, 900], ENDS),
        ([*BULK[:30], *[500] * 10], None),  # a quarter of the values: no outliers
        ([*BULK, 3.0, 900], (BULK.min(), 3.0)),  # no more is cut off than helps
        ([1.0, 2.0, np.inf], (1.0, 2.0)),
        ([2.0, 2.0, 2.0], None),
        ([], None),
    ],
)
def test_at_most_a_tenth_is_cut_off_and_no_more_than_helps(
    values: list[float], limits: tuple[float, float] | None
) -> None:
    assert shown_range(np.array(values)) == limits


def test_measurements_worth_a_hundred_times_the_others_are_arrows_with_one_number() -> None:
    table = WORTH.copy()
    table.loc[4, "removed"] = 152.0
    axes = worth(table, ax=_axes())
    assert axes.get_ylim()[1] < 3
    assert axes.get_ylim()[0] < 0  # the stems begin at 0
    assert _arrows(axes) == {"^": [4.0]}
    assert _legend(axes) == ["mine", "mine, off the axis: 152"]
    several = pd.concat([WORTH] * 4, ignore_index=True).assign(t=range(48))
    several.loc[[3, 9, 30], "removed"] = [300.0, 200.0, 500.0]
    assert _legend(worth(several, ax=_axes()))[-1] == "mine, off the axis: 3 up to 500"
    assert worth(WORTH, ax=_axes()).get_ylim()[1] > WORTH["removed"].max()
    assert _arrows(worth(WORTH, ax=_axes())) == {}


def test_a_rise_far_below_is_an_arrow_at_the_lower_edge_with_a_true_minus_sign() -> None:
    table = WORTH.copy()
    table.loc[7, "removed"] = -90.0
    axes = worth(table, ax=_axes())
    assert _arrows(axes) == {"v": [7.0]}
    assert _legend(axes)[-1] == "mine, off the axis: \N{MINUS SIGN}90"


def _profile(low: float, high: float, last: float) -> pd.DataFrame:
    error = np.append(RNG.uniform(low, high, 20), last)
    instants = pd.DataFrame({"name": "mine", "t": range(21), "measured": False, "error": error})
    return instants.assign(standard_error=0.1)


def test_a_spike_of_the_error_leaves_the_profile_its_room() -> None:
    axes = error_profile(_profile(1, 3, 4e6), ax=_axes())
    assert (axes.get_ylim()[0], axes.get_ylim()[1] < 4) == (0.0, True)
    assert _legend(axes)[-1] == r"mine, off the axis: $4\times 10^{6}$"


def test_an_axis_that_begins_at_0_has_no_arrow_for_a_small_value_that_it_shows() -> None:
    axes = error_profile(_profile(100, 110, 5.0), ax=_axes())
    assert axes.get_ylim()[0] == 0.0
    assert _arrows(axes) == {}


def test_first_generations_far_off_and_infinite_costs_leave_the_search_its_room() -> None:
    costs = [1e5, *np.linspace(40, 20, 20)]
    rows = pd.DataFrame(
        {"phase": "mine", "generation": range(21), "copies": 5, "expected_mse": costs}
    )
    rows.loc[3, "expected_mse"] = np.inf
    axes = searches(rows, {"mine": "genetic"}, reference=("regular times", 60.0), ax=_axes())
    low, high = axes.get_ylim()
    assert low <= 0
    assert high > 4.9e5  # the first generation is shown
    lowest, reference, highest = axes.transData.transform([(0, 0), (0, 200), (0, high)])[:, 1]
    assert reference - lowest > 0.3 * (highest - lowest)


def test_small_budgets_with_huge_errors_leave_the_curve_its_room() -> None:
    numbers = np.arange(2, 42)
    costs = {"regular": 60 / numbers, "found": 40 / numbers}
    costs["found"][0] = 3e4
    table = pd.concat(
        pd.DataFrame({"kind": kind, "budget": numbers, "expected_mse": mse})
        for kind, mse in costs.items()
    ).assign(bound=np.nan, bound_low=np.nan, draws=9, standard_error=0.1, measurement_times=None)
    table = table.assign(particle_loss=np.nan, particle_loss_limit=np.nan)
    for end, factor in (("low", 0.9), ("high", 1.1)):
        table[f"expected_mse_{end}"] = factor * table["expected_mse"]
    axes = budget(table, ax=_axes())
    assert axes.get_ylim()[1] < 40
    assert _legend(axes) == ["plan, off the axis: 30,000"]
