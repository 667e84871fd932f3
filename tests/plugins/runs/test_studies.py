"""The figure of many runs: it shows the numbers of the table, and never mixes unlike runs."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from scipy import stats

from pfdist import plots
from pfdist.common.rounding import with_interval
from pfdist.errors import ArgumentError, JobError
from pfdist.pages.style import BLUE, GREY, RED
from pfdist.plugins.runs.pages import lowest_text
from pfdist.plugins.runs.runs_table import RESULTS
from pfdist.plugins.runs.studies import averages

BUDGET, PARTICLES = "problem.measurement_budget", "filter.particles"


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    pyplot.close("all")


def study(
    seeds: Sequence[int] = (1, 2, 3),
    sets: Sequence[str] = ("genetic",),
    particles: Sequence[Any] = (20,),
    budgets: Sequence[Any] = (3, 5),
) -> pd.DataFrame:
    """Give a table with the columns of `pfdist.table`; no two results are equal."""
    rows = []
    for number, (budget, size, seed, name) in enumerate(product(budgets, particles, seeds, sets)):
        row = dict.fromkeys(RESULTS) | {
            "run": f"run-{number}", "seed": seed, BUDGET: budget, PARTICLES: size, "set": name,
            "state": "finished", "draws": 100, "expected_mse": 30.0 + number + 0.1 * number**2,
            "standard_error": 0.5 + 0.01 * number, "reference": "regular", "reference_mse": 80.0,
            "reference_standard_error": 0.7, "gain_of_means": 0.3 + 0.02 * number,
            "gain_of_means_low": 0.25, "gain_of_means_high": 0.4 + 0.02 * number,
            "measurements": 3, "measurement_times": (0, 2 + number % 5, 9), "worker_seconds": 1.0,
            "evaluations": 10, "path": f"results/run-{number}",
        }  # fmt: skip
        rows.append(row)
    frame = pd.DataFrame(rows)
    return frame[["run", "seed", BUDGET, PARTICLES, *RESULTS]]


MIXED = study(sets=["genetic", "random"], particles=[20, 40])
MANY = study(seeds=[1], particles=range(10, 32))


def axes_of(**options: Any) -> Axes:
    axes: Axes = Figure(**options).subplots()
    return axes


def bars_of(axes: Axes) -> dict[str, tuple[list[float], list[float], list[float], list[float]]]:
    """Give x, value, low and high of each line but the reference's, by its label."""
    found = {}
    for container in axes.containers:
        assert isinstance(container, ErrorbarContainer)
        if to_hex(container.lines[0].get_color()) == GREY:
            continue
        line, _, (bars,) = container.lines
        ends = np.array(bars.get_segments())[:, :, 1]
        x, y = line.get_data()
        label = str(container.get_label())
        found[label] = (list(x), list(y), ends[:, 0].tolist(), ends[:, 1].tolist())
    return found


def test_without_replicates_a_value_has_the_interval_of_its_run() -> None:
    """The expected MSE has 1.96 standard errors, a gain the columns of the table, in per cent."""
    table = study(seeds=[1])
    axes = plots.against(table, BUDGET, ax=axes_of())
    [(x, y, low, high)] = bars_of(axes).values()
    assert x == [3.0, 5.0]
    assert y == table["expected_mse"].tolist()
    half = stats.norm.ppf(0.975) * table["standard_error"]
    assert low == pytest.approx((table["expected_mse"] - half).tolist())
    assert high == pytest.approx((table["expected_mse"] + half).tolist())
    axes = plots.against(table, BUDGET, "gain_of_means", ax=axes_of())
    [(_, y, low, high)] = bars_of(axes).values()
    assert y == pytest.approx((100 * table["gain_of_means"]).tolist())
    assert low == pytest.approx([25.0, 25.0])
    assert high == pytest.approx((100 * table["gain_of_means_high"]).tolist())
    assert axes.get_ylabel() == "gain of means [%]"


def test_runs_that_differ_in_their_seeds_are_points_around_their_mean() -> None:
    table = study()
    axes = plots.against(table, BUDGET, ax=axes_of())
    [(_, y, low, high)] = bars_of(axes).values()
    groups = [group["expected_mse"].to_numpy() for _, group in table.groupby(BUDGET)]
    assert y == pytest.approx([group.mean() for group in groups])
    for group, down, up in zip(groups, low, high, strict=True):
        ends = stats.t.interval(0.95, 2, group.mean(), group.std(ddof=1) / math.sqrt(3))
        assert (down, up) == pytest.approx(ends)
    [seeds] = [line for line in axes.get_lines() if line.get_alpha() and len(line.get_xdata())]
    assert list(seeds.get_xdata()) == [3.0] * 3 + [5.0] * 3
    assert list(seeds.get_ydata()) == table["expected_mse"].tolist()


def test_the_point_with_the_lowest_mean_over_its_seeds_is_named_with_its_interval() -> None:
    """The interval is Student's. Where the seeds alone differ, nothing is chosen."""
    table = study(particles=[20, 40])
    errors = table.groupby([BUDGET, PARTICLES])["expected_mse"]
    (budget, particles), mean = errors.mean().idxmin(), errors.mean().min()
    half = stats.t.ppf(0.975, 2) * errors.std()[budget, particles] / math.sqrt(3)
    told = "{} (95 % CI {} to {})".format(*with_interval(mean, mean - half, mean + half))
    point = f"measurement_budget {budget}, particles {particles}"
    assert lowest_text(table) == (
        f"The lowest expected MSE is {told}, the mean of 3 seeds: {point}."
    )
    alone = table[(table[BUDGET] == budget) & (table[PARTICLES] == particles)]
    alone = alone.drop(columns=[BUDGET, PARTICLES])
    assert lowest_text(alone) == f"The expected MSE is {told}, the mean of 3 seeds."
    axes = plots.against(alone, ax=axes_of())
    assert axes.get_xlabel() == "seed"
    assert next(iter(bars_of(axes).values()))[0] == [1.0, 2.0, 3.0]


def test_a_value_with_one_seed_among_several_has_no_interval() -> None:
    """Its own error does not say how much another seed would change."""
    table = study().iloc[:4]  # budget 3 has three seeds, budget 5 has one
    [_, alone] = averages(table, [BUDGET], "expected_mse")
    assert math.isnan(alone.low)
    [(_, y, low, high)] = bars_of(plots.against(table, BUDGET, ax=axes_of())).values()
    assert low[1] == y[1] == high[1]


def test_each_combination_of_the_other_keys_has_a_line_and_the_reference_is_grey() -> None:
    table = study(sets=["genetic", "random"], particles=[20, 40])
    axes = plots.against(table, ax=axes_of())
    found = bars_of(axes)
    assert set(found) == {f"{n}, particles {k}" for n in ("genetic", "random") for k in (20, 40)}
    for label, (_, y, _, _) in found.items():
        name, particles = label.split(", particles ")
        rows = table[(table["set"] == name) & (table[PARTICLES] == int(particles))]
        assert y == pytest.approx(rows.groupby(BUDGET)["expected_mse"].mean().tolist())
    colours = {label: to_hex(each.lines[0].get_color()) for each in axes.containers
               for label in [str(each.get_label())]}  # fmt: skip
    assert {colour for label, colour in colours.items() if "genetic" in label} == {RED}
    assert {colour for label, colour in colours.items() if "random" in label} == {BLUE}
    grey = [each for each in axes.containers if to_hex(each.lines[0].get_color()) == GREY]
    assert list(grey[0].lines[0].get_xdata()) == [3.0, 5.0]
    assert list(grey[0].lines[0].get_ydata()) == [80.0, 80.0]
    assert grey[0].get_label() == "regular"
    gains = plots.against(table, BUDGET, "gain_of_means", ax=axes_of())
    assert GREY not in {to_hex(line.get_color()) for line in gains.get_lines()}


@pytest.mark.parametrize("budgets", [(3, 5), (3, 50, 900), ("few", "many")])
def test_all_points_and_intervals_lie_within_the_axes(budgets: Sequence[Any]) -> None:
    table = study(particles=[20, 40], budgets=budgets)
    axes = plots.against(table, BUDGET, ax=axes_of())
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert (high - low) < 2 * np.ptp([*table["expected_mse"], 80.0])
    for x, *values in bars_of(axes).values():
        assert left < min(x) <= max(x) < right
        assert low < min(map(min, values)) <= max(map(max, values)) < high


def test_a_key_that_changes_with_the_axis_makes_no_lines() -> None:
    table = study(seeds=[1])
    table[PARTICLES] = 10 * table[BUDGET]
    assert len(bars_of(plots.against(table, BUDGET, ax=axes_of()))) == 1


def test_texts_and_missing_values_are_categories_and_numbers_lie_at_their_places() -> None:
    table = study(seeds=[1], particles=["systematic", "multinomial", None])
    axes = plots.against(table, PARTICLES, ax=axes_of())
    assert [text.get_text() for text in axes.get_xticklabels()] == [
        "multinomial", "systematic", "none",
    ]  # fmt: skip
    axes = plots.against(study(seeds=[1], particles=[True, False]), PARTICLES, ax=axes_of())
    assert [text.get_text() for text in axes.get_xticklabels()] == ["false", "true"]
    many = study(seeds=[1], particles=[10, 100, 1000, 10000], budgets=[3])
    axes = plots.against(many, PARTICLES, ax=axes_of())
    assert axes.get_xscale() == "log"
    assert [text.get_text() for text in axes.get_xticklabels()] == ["10", "100", "1000", "10000"]


def test_unknown_and_infinite_results_are_no_points() -> None:
    table = study(seeds=[1], budgets=[3, 4, 5, 6])
    table.loc[1, "expected_mse"], table.loc[2, "expected_mse"] = math.nan, math.inf
    [(x, _, _, _)] = bars_of(plots.against(table, BUDGET, ax=axes_of())).values()
    assert x == [3.0, 6.0]
    axes = plots.against(table.assign(expected_mse=math.nan), BUDGET, ax=axes_of())
    assert "no result" in axes.texts[0].get_text()


@pytest.mark.parametrize(
    ("draw", "told"),
    [
        (lambda: plots.against(study(), "particle"), "key must be one of seed, problem"),
        (lambda: plots.against(study(), BUDGET, "mse"), "value must be one of draws, ex"),
        (lambda: plots.against(study(seeds=[1]).iloc[:, 4:]), "without the column run"),
        (lambda: plots.against(MIXED.drop(columns=[BUDGET, PARTICLES, "seed"])), "whose jobs diff"),
        (lambda: plots.against(MANY, BUDGET), r"at most 20 lines, got 22 .* select rows"),
    ],
)
def test_a_table_that_cannot_be_drawn_is_refused_in_one_line(
    draw: Callable[[], Axes], told: str
) -> None:
    with pytest.raises((ArgumentError, JobError), match=told) as caught:
        draw()
    assert "\n" not in str(caught.value)
    assert not pyplot.get_fignums()
