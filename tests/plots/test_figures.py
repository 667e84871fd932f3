"""The paper's figures show what the tables say."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from pfdist.analysis import Gain
from pfdist.plots.cost import (
    best_of_each_step,
    best_so_far,
    by_generation,
    one_by_one,
    plot_cost,
)
from pfdist.plots.gain_histogram import plot_gain_histogram
from pfdist.plots.one_draw import plot_one_draw, typical_draw
from pfdist.plots.why import plot_profile, plot_removals, plot_shifts

EVALUATIONS = pd.DataFrame(
    [
        # phase, generation, individual, copies, expected_mse
        ("genetic", 0, 0, 1, 30.0),
        ("genetic", 0, 1, 3, 40.0),
        ("genetic", 1, 0, 2, 20.0),
        ("genetic", 1, 2, 2, np.inf),  # killed
        ("random", 0, 0, 1, 50.0),
        ("random", 0, 1, 1, 30.0),
        ("random", 0, 2, 1, 40.0),
    ],
    columns=["phase", "generation", "individual", "copies", "expected_mse"],
)


def _axes():
    return Figure().subplots()


def _lines(axes) -> dict[str, tuple[list[float], list[float]]]:
    return {
        line.get_label(): (
            np.asarray(line.get_xdata()).tolist(),
            np.asarray(line.get_ydata()).tolist(),
        )
        for line in axes.get_lines()
    }


def test_cost_of_a_population_is_averaged_over_copies_and_of_trials_over_all_so_far() -> None:
    axes = _axes()
    curves = {"genetic": by_generation, "random": one_by_one}
    plot_cost(axes, EVALUATIONS, curves, {"genetic": "", "random": ""}, 31.2)
    lines = _lines(axes)
    assert lines["genetic, average"] == ([4, 8], [37.5, 20.0])
    assert lines["genetic, minimum"] == ([4, 8], [30.0, 20.0])
    assert lines["random, average"] == ([1, 2, 3], [50.0, 40.0, 40.0])
    assert lines["random, minimum"] == ([1, 2, 3], [50.0, 30.0, 30.0])
    assert lines["regular times"][1] == [31.2, 31.2]


def test_of_prefixes_and_of_short_tests_the_work_counts_and_not_the_cost() -> None:
    rows = pd.DataFrame(
        [
            # generation, individual, copies, end, draws, expected_mse
            (0, 0, 1, 5, 100, 1.0),  # a prefix
            (0, 1, 1, 9, 50, 20.0),  # on few draws
            (1, 0, 1, 9, 100, 30.0),
            (1, 1, 1, 9, 100, 25.0),
            (2, 0, 1, 9, 100, 28.0),
        ],
        columns=["generation", "individual", "copies", "end", "draws", "expected_mse"],
    ).assign(phase="mine")
    axes = _axes()
    plot_cost(axes, rows, {"mine": best_so_far}, {"mine": "100 particles"}, 31.2)
    label = "mine, best so far\n(100 particles)"
    assert _lines(axes)[label] == ([3, 4, 5], [30.0, 25.0, 25.0])
    axes = _axes()
    plot_cost(axes, rows, {"mine": best_of_each_step}, {"mine": ""}, 31.2)
    assert _lines(axes)["mine, best of a step"] == ([2, 4, 5], [1.0, 25.0, 28.0])


def test_one_draw_shows_truth_estimates_and_stars_and_plus_signs() -> None:
    trajectory = pd.DataFrame(
        {
            "t": [0, 1, 2],
            "z_0": [1.0, 2.0, 3.0],
            "estimate_regular_0": [0.0, 1.0, 2.0],
            "estimate_genetic_0": [1.0, 2.0, 2.5],
        }
    )
    axes = _axes()
    plot_one_draw(axes, trajectory, {"regular": [0, 2], "genetic": [1]}, 0.283)
    lines = {line.get_label(): line for line in axes.get_lines()}
    regular, genetic = lines[r"$\mathcal{M}$, regular"], lines[r"$\mathcal{M}$, genetic"]
    assert (regular.get_marker(), list(regular.get_xdata())) == ("+", [0, 2])
    assert (genetic.get_marker(), list(genetic.get_xdata())) == ("*", [1])
    assert list(lines["$z(t)$"].get_ydata()) == [1.0, 2.0, 3.0]
    assert "28.3 %" in axes.get_title()


def test_the_draw_shown_is_the_one_nearest_to_the_mean_gain() -> None:
    assert typical_draw(pd.Series([0.1, 0.5, 0.26], index=[3, 4, 7]), 0.25) == 7


def test_the_histogram_counts_the_draws_and_marks_zero_mean_and_fraction() -> None:
    relative = np.random.default_rng(1).normal(0.25, 0.2, 5000).clip(max=1)
    gain = Gain()
    gain.add(1 - relative, np.ones(5000))
    axes = _axes()
    plot_gain_histogram(axes, gain, "genetic")
    area = sum(patch.get_width() * patch.get_height() for patch in axes.patches)
    below = np.sum(100 * relative < axes.patches[0].get_x())
    assert area == pytest.approx(1 - below / 5000)  # of all draws, those that are left out too
    edges = [patch.get_x() for patch in axes.patches]
    edges.append(edges[-1] + axes.patches[0].get_width())
    heights = [patch.get_height() for patch in axes.patches]
    counts, _ = np.histogram(100 * relative, edges)
    np.testing.assert_allclose(heights, counts / 5000 / np.diff(edges), atol=1e-9)
    assert _lines(axes)["no gain"][0] == [0.0, 0.0]
    text = " ".join(entry.get_text() for entry in axes.get_legend().get_texts())
    assert f"mean {100 * relative.mean():.1f} %" in text
    assert f"{100 * np.mean(relative > 0):.1f} %" in text
    assert "5,000 draws" in text
    assert f"{below} of them below" in text
    assert 1 <= below <= 5  # the lowest thousandth, but for those in its bin


def test_a_profile_shows_the_error_its_band_and_the_instants_measured() -> None:
    profile = pd.DataFrame(
        {
            "name": ["regular"] * 3 + ["found"] * 3,
            "t": [0, 1, 2] * 2,
            "measured": [True, False, True, False, True, False],
            "error": [1.0, 5.0, 2.0, 3.0, 1.0, 2.0],
            "standard_error": [0.1] * 6,
        }
    )
    axes = _axes()
    plot_profile(axes, profile, ("regular", "found"), 2000)
    assert "2,000 draws" in axes.get_legend().get_title().get_text()
    lines = {line.get_label(): line for line in axes.get_lines()}
    regular, found = lines["regular, mean 2.667"], lines["found, mean 2"]
    assert np.asarray(regular.get_ydata()).tolist() == [1.0, 5.0, 2.0]
    assert np.asarray(found.get_ydata()).tolist() == [3.0, 1.0, 2.0]
    assert [list(line.get_markevery()) for line in (regular, found)] == [[0, 2], [1]]
    band = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((1 - 0.196, 5 + 0.196))


def test_a_measurements_worth_is_a_stem_and_its_shifts_are_triangles_with_intervals() -> None:
    measurements = pd.DataFrame(
        {
            "name": ["regular", "found", "found"],
            "t": [0, 1, 4],
            "removed": [2.0, 1.0, -0.5],
            "removed_error": [0.1, 0.2, 0.3],
            "earlier": [np.nan, 0.5, 0.25],
            "earlier_error": [np.nan, 0.1, 0.1],
            "later": [-1.0, np.nan, 0.75],
            "later_error": [0.1, np.nan, 0.1],
        }
    )
    axes = _axes()
    plot_removals(axes, measurements, ("regular", "found"))
    stems = [segment.tolist() for segment in axes.collections[2].get_segments()]
    assert stems == [[[1.2, 0.0], [1.2, 1.0]], [[4.2, 0.0], [4.2, -0.5]]]  # beside the other's
    bars = np.stack(axes.collections[3].get_segments())[:, :, 1]
    np.testing.assert_allclose(bars, [[1 - 0.392, 1 + 0.392], [-0.5 - 0.588, -0.5 + 0.588]])
    axes = _axes()
    plot_shifts(axes, measurements, ("regular", "found"))
    shown = {(line.get_marker(), *np.asarray(line.get_ydata())) for line in axes.get_lines()}
    assert {("<", 0.5, 0.25), (">", -1.0), (">", 0.75)} <= shown
