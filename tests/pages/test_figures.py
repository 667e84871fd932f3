"""The paper's figures show what the tables say."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import pfdist
from pfdist import plots
from pfdist.common.rounding import rounded
from pfdist.errors import JobError
from pfdist.pages.figure import FIGURES, Tables, drawn
from pfdist.pages.plots import (
    draw_figures,
    error_profile,
    gain,
    one_draw,
    searches,
)
from pfdist.pages.searches import legend_inches
from pfdist.pages.style import COLUMN_INCHES, styled
from pfdist.pages.system import _stretch
from pfdist.plugins.online.draws import OnlineDraws
from pfdist.plugins.online.figure import online_shares
from pfdist.plugins.why.figures import worth
from pfdist.problem.calendar import Calendar
from pfdist.problem.clock import Clock
from pfdist.problem.points import Points
from pfdist.problem.set_key import phrase_of
from pfdist.results import Gain, Run, open_run
from pfdist.results.over_time import errors_over_time_of, ranges_of
from pfdist.results.stored_run import statistics_of
from pfdist.store.folder import FORMATS

ROOT = Path(__file__).parents[1]
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


def _legend(axes) -> str:
    return " ".join(entry.get_text() for entry in axes.get_legend().get_texts())


def test_cost_of_a_population_is_averaged_over_copies_and_of_trials_over_all_so_far() -> None:
    methods = {"genetic": "genetic", "random": "random"}
    axes = searches(EVALUATIONS, methods, reference=("regular times", 31.2), ax=_axes())
    lines = _lines(axes)
    above = {label: (x, [round(percent, 9) for percent in y]) for label, (x, y) in lines.items()}
    assert above["genetic, average"] == ([4, 8], [87.5, 0.0])  # 37.5 and 20, over 20
    assert above["genetic, minimum"] == ([4, 8], [50.0, 0.0])
    assert above["random, average"] == ([1, 2, 3], [150.0, 100.0, 100.0])
    assert above["random, minimum"] == ([1, 2, 3], [150.0, 50.0, 50.0])
    assert above["regular times: 31.2"][1] == [56.0, 56.0]
    axes = searches(EVALUATIONS, methods, best=("genetic", 25.0), ax=_axes())
    assert _lines(axes)["genetic, minimum"][1] == pytest.approx([20.0, -20.0])
    assert _lines(axes)["genetic: 25"][1] == [0.0, 0.0]


@pytest.mark.parametrize("worst", [1.05, 1.5, 200.0])
def test_differences_of_1_percent_are_seen_beside_larger_ones(worst: float) -> None:
    rows = EVALUATIONS[EVALUATIONS["phase"] == "random"]
    rows = rows.assign(expected_mse=[20.0 * worst, 20.2, 20.0])
    axes = searches(rows, {"random": "random"}, ax=_axes())
    bottom, near, top = axes.transData.transform([(0, 0.0), (0, 1.0), (0, 100 * (worst - 1))])[:, 1]
    assert near - bottom > 0.07 * (top - bottom)


def test_errors_are_relative_to_the_least_of_the_searches_that_estimate_alike(
    plain: Run, finished: Callable[..., Path]
) -> None:
    """The expected MSEs on fresh draws are shown beside searches that estimate so."""
    [(_, plot)] = FIGURES["searches"].plots(Tables(plain))
    [axes] = drawn(plot).axes
    mse = {name: each.mean for name, each in statistics_of(plain).mse.items()}
    best = min(mse, key=mse.get)
    lines = {f"{phrase_of(plain.labels[name])}: {mse[name]:.4g}" for name in ("regular", best)}
    curves = {"genetic, average", "genetic, minimum", "survivors, best so far"}
    assert {*_lines(axes)} == curves | lines == {*_lines(searches(plain, ax=_axes()))}
    evaluations = plain.table("evaluations")
    genetic = evaluations[evaluations["phase"] == "genetic"]["expected_mse"].min()
    assert min(_lines(axes)["genetic, minimum"][1]) == pytest.approx(
        100 * (genetic / mse[best] - 1)
    )
    assert min(_lines(axes)["survivors, best so far"][1]) == pytest.approx(0.0)
    assert "survivors: filter variance, systematic resampling" in _legend(axes)
    run = pfdist.open_run(finished("comparison.reference=[0, 3, 9]"))
    assert any(label.startswith("the reference: ") for label in _lines(searches(run, ax=_axes())))


def test_a_file_is_laid_out_once_and_drawn_once(
    plain: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A canvas with a layout engine draws everything once more for each format."""
    draws, draw = list[Figure](), Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda canvas, to: (draws.append(canvas), draw(canvas, to)))
    run = open_run(shutil.copytree(plain.path, tmp_path / "run"))
    files = draw_figures(run, "times", FORMATS)
    assert len(draws) == len(files) == 3
    before = [file.read_bytes() for file in files]
    assert [
        file.read_bytes() for file in draw_figures(run, "times")
    ] == before  # all that are there


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
    axes = searches(rows, {"mine": "survivors"}, ax=_axes())
    numbers, above = _lines(axes)["mine, best so far"]
    assert (numbers, np.round(above, 9).tolist()) == ([3, 4, 5], [20.0, 0.0, 0.0])


def _trajectory(components: int) -> pd.DataFrame:
    columns = {"t": [0, 1, 2]}
    for k in range(components):
        columns[f"z_{k}"] = [k, k + 0.5, k + 1]
        columns[f"estimate_regular_{k}"] = [k, k + 0.25, k + 2]
        columns[f"estimate_genetic_{k}"] = [k, k + 0.75, k + 3]
    return pd.DataFrame(columns)


def test_one_draw_shows_each_component_its_estimates_and_stars_and_plus_signs() -> None:
    trajectory, sets = _trajectory(3), {"regular": [0, 2], "genetic": [1]}
    for k in range(3):
        axes = one_draw(trajectory, sets, title="draw 3", component=k, ax=_axes())
        assert axes.get_legend().get_title().get_text() == "draw 3"
        lines = {line.get_label(): line for line in axes.get_lines()}
        measured = {line.get_marker(): list(line.get_xdata()) for line in axes.get_lines()}
        assert (measured["+"], measured["*"]) == ([0, 2], [1])
        assert [text.get_text() for text in axes.texts] == [*sets]
        assert list(lines["truth"].get_ydata()) == [k, k + 0.5, k + 1]
        assert [k, k + 0.25, k + 2] in [y for _, y in _lines(axes).values()]
        assert axes.get_ylabel() == f"$z_{{{k}}}$"
    assert one_draw(_trajectory(1), sets, ax=_axes()).get_ylabel() == "$z$"
    with pytest.raises(JobError, match="component must be one of 0, 1, 2, got 3"):
        one_draw(trajectory, sets, component=3, ax=_axes())


def test_the_draw_nearest_the_median_gain_is_shown_unless_another_is_wanted(plain: Run) -> None:
    told = one_draw(plain, ax=_axes()).get_legend().get_title().get_text()
    gains = plain.table("gains").set_index("draw")["gain_genetic"]
    kept = gains[plain.table("trajectories")["draw"].unique()]
    nearest = (kept - gains.median()).abs().idxmin()
    assert told.startswith(f"draw {nearest}, relative gain ")
    [(_, plot), *_] = FIGURES["draw"].plots(Tables(plain))
    said = f"near the median of all {len(gains)}: with "
    assert said in plot.title
    assert f"is {100 * abs(kept[nearest]):.1f} % " in plot.title
    z = plain.table("trajectories").query("draw == 7")["z_0"].tolist()
    assert _lines(one_draw(plain, draw=7, ax=_axes()))["truth"][1] == z


def test_the_first_picture_has_the_system_the_typical_error_and_the_times(
    finished: Callable[..., Path], several: Run
) -> None:
    run = pfdist.open_run(finished())
    [(_, plot)] = FIGURES["system"].plots(Tables(run))
    band, errors, times = drawn(plot).axes
    z = run.table("trajectories").pivot_table("z_state", "draw", "t")
    edges = band.collections[0].get_paths()[0].vertices[:, 1]
    assert edges.max() == z.quantile(0.95).max()
    assert edges.min() == z.quantile(0.05).min()
    curves = [line for line in band.get_lines() if len(line.get_xdata()) == len(z.columns)]
    assert [line.get_ydata().tolist() for line in curves] == z.head(4).to_numpy().tolist()
    best, reference = run.best, run.table("sets").iloc[0]
    lines = [[*line.get_xdata()] for ax in (band, errors) for line in ax.get_lines()]
    assert all(lines.count([t, t]) == 2 for t in best.measurement_times)
    profile = run.table("error_over_time").set_index("name")
    shown = errors.get_lines()[:2]
    for line, row in zip(shown, (reference, best), strict=True):
        error = np.sqrt(profile.loc[row["name"] if row is reference else row.name, "error"])
        np.testing.assert_allclose(line.get_ydata(), error, rtol=1e-12)
        assert line.get_label() == f"{row.label}: {rounded(row.typical_error[0], 3)}"
    dots = [line for line in times.get_lines() if line.get_marker() != "None"]
    assert [[*line.get_xdata()] for line in dots] == [
        [*row.measurement_times] for row in (reference, best)
    ]
    told = re.search(r"falls most at t = (\d+)(?: to (\d+))?: from (\S+) to (\S+)\.", plot.title)
    ranges, names = ranges_of(run), [reference["name"], best.name]
    places = [run.names.index(name) for name in names]
    before, now = (errors_over_time_of(ranges[::2], place)[0] for place in places)
    first, last = int(told[1]), int(told[2] or told[1])
    change, at = before - now, slice(first, last + 1)  # chosen on one half of the draws
    change -= max(0, change.mean())
    stretches = [change[a:b] for a in range(len(change)) for b in range(a + 1, len(change) + 1)]
    assert change[at].sum() == pytest.approx(max(part.sum() for part in stretches))
    before, now = (errors_over_time_of(ranges[1::2], place)[0] for place in places)
    assert float(told[3]) == pytest.approx(np.sqrt(before[at].mean()), rel=0.01)
    assert float(told[4]) == pytest.approx(np.sqrt(now[at].mean()), rel=0.01)
    assert not FIGURES["system"].files(several)
    [(_, plot)] = FIGURES["times"].plots(Tables(several))  # of several numbers
    assert len(drawn(plot).axes) == 1


def test_the_first_picture_shows_a_small_difference_alone_and_says_months(
    finished: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sets of nearly the same error are two sawteeth: a moving mean of the difference."""
    found = pfdist.open_run(finished())
    best = found.best.measurement_times
    tried = found.table("evaluations").sort_values("expected_mse")["measurement_times"].map(tuple)
    moved = next([*map(int, times)] for times in tried if times != best)
    dated = "problem.clock={start='2027-04-30',step='1 d'}"
    run = pfdist.open_run(finished(f"comparison.reference={moved}", dated))
    own, other = (row.typical_error[0] for row in run.table("sets").iloc[[-1, 0]].itertuples())
    [(_, plot)] = FIGURES["system"].plots(Tables(run))
    _, errors, _ = drawn(plot).axes
    assert abs(own - other) > 0.05 * other
    assert errors.get_ylabel() == "typical error"
    monkeypatch.setattr("pfdist.pages.system._LITTLE", 0.1)
    [(_, plot)] = FIGURES["system"].plots(Tables(run))
    _, errors, _ = drawn(plot).axes
    assert errors.get_ylabel() == "difference"
    zero, mean, *_ = errors.get_lines()
    assert [*zero.get_ydata()] == [0, 0]
    assert mean.get_label().startswith(f"reference ({rounded(other, 3)}) less ")
    profile = run.table("error_over_time").set_index("name")["error"]
    change = np.sqrt(profile[run.names[0]].to_numpy()) - np.sqrt(profile[run.best.name].to_numpy())
    reach = 12 // len(best)  # of the 13 instants, twice the mean interval in all
    middle = [change[t - reach : t + reach + 1].mean() for t in range(reach, 13 - reach)]
    np.testing.assert_allclose(mean.get_ydata()[reach : 13 - reach], middle, rtol=1e-9)
    assert re.search(r"falls most (on|from) 2027-05-\d\d.*: from ", plot.title)


@pytest.mark.plugins("why")
def test_bars_of_windows_hold_their_time_and_do_not_overlap(tmp_path: Path) -> None:
    """Errors are exact. Each bar is a window of the plan; those of one lane are apart."""
    walk = pfdist.Problem("random_walk", horizon=30, measurement_budget=6, engine="kalman")
    changes = ["comparison.draws=20"]
    run = pfdist.plan(walk, tmp_path, bound_draws=0, changes=changes, figures=False)
    pfdist.why(run, figures=False)
    [(_, plot)] = FIGURES["system"].plots(Tables(open_run(tmp_path)))
    *_, times = drawn(plot).axes
    bars = [line for line in times.get_lines() if np.ptp(line.get_xdata()) and line.get_ls() == "-"]
    assert len(bars) > 2
    lanes = dict[float, list[list[float]]]()
    for bar in bars:
        lanes.setdefault(bar.get_ydata()[0], []).append([*bar.get_xdata()])
    marks = [line for line in times.get_lines() if line.get_marker() == "|"]
    for (first, last), mark in zip((bar.get_xdata() for bar in bars), marks, strict=True):
        assert first <= mark.get_xdata()[0] <= last
    for lane in lanes.values():
        assert all(before[1] < after[0] for before, after in pairwise(sorted(lane)))


def test_a_stretch_of_dates_says_days_and_hours_of_one_day() -> None:
    hours = replace(Clock.regular(9000, 1, "h"), calendar=Calendar.starting("2027-12-30", "h"))
    assert [_stretch(hours, 8, last) for last in (8, 12, 40, 80)] == [
        "on 2027-12-30",
        "on 2027-12-30, 08:00 to 12:00",
        "from 2027-12-30 to 2027-12-31",
        "from 2027-12-30 to 2028-01-02",
    ]
    assert _stretch(Clock.counting(9), 3, 5) == "at t = 3 to 5"


def test_the_first_picture_names_no_gain_over_the_same_times(finished: Callable[..., Path]) -> None:
    best = [*pfdist.open_run(finished()).best.measurement_times]
    run = pfdist.open_run(finished(f"comparison.reference={best}"))
    assert [*run.sets.values()].count(tuple(best)) > 1
    [(_, plot)] = FIGURES["system"].plots(Tables(run))
    assert "falls most" not in plot.title


def test_each_component_has_a_column_and_an_angle_is_drawn_around_its_mean(tmp_path: Path) -> None:
    turns = ["model.name=robot", "problem.horizon=10", "problem.measurement_budget=2"]
    turns += ["comparison.reference=[0, 1]"]  # so the plan is clearly better
    run = pfdist.run(ROOT / "small.toml", tmp_path / "robot", changes=turns, figures=False)
    band, errors, _ = plots.system(run)
    low, high = band.dataLim.intervaly
    assert high - low <= 2 * np.pi
    assert errors.get_ylabel() == "typical error\n[rad]"
    [(_, plot)] = FIGURES["system"].plots(Tables(run))
    assert re.search(r"falls most at .* to \S+ rad\.$", plot.title)
    pair = ["model.name=constant_velocity", "problem.horizon=10"]
    pair += ["problem.measurement_budget=2", "comparison.reference=[9, 10]"]
    pair += [f"problem.instant_weights={[1] * 5 + [0] * 6}"]
    run = pfdist.run(ROOT / "small.toml", tmp_path / "ship", changes=pair, figures=False)
    first, second, *_ = panels = plots.system(run)
    assert (len(panels), first.get_ylabel(), second.get_ylabel()) == (6, "east [km]", "north [km]")
    [gain] = panels[2].collections  # shaded where it counts
    assert max(path.vertices[:, 0].max() for path in gain.get_paths()) <= 4
    pyplot.close("all")


def _gain(relative: np.ndarray) -> Gain:
    known = Gain()
    known.add(1 - relative, np.ones(relative.size))
    return known


def _per_cent(axes) -> float:
    return sum(patch.get_height() for patch in axes.patches)


def test_the_histogram_counts_the_draws_and_marks_zero_mean_and_fraction() -> None:
    relative = np.random.default_rng(1).normal(0.25, 0.2, 5000).clip(max=1)
    axes = gain(_gain(relative), "genetic", reference="regular times", ax=_axes())
    assert _per_cent(axes) == pytest.approx(100)
    edges = [patch.get_x() for patch in axes.patches]
    edges.append(edges[-1] + axes.patches[0].get_width())
    heights = [patch.get_height() for patch in axes.patches]
    counts, _ = np.histogram(100 * relative, edges)
    np.testing.assert_allclose(heights, counts / 50, atol=1e-9)
    assert _lines(axes)["no gain"][0] == [0.0, 0.0]
    assert _legend(axes) == f"genetic, mean gain {100 * relative.mean():.1f} %"
    assert not axes.texts
    assert axes.get_xlabel() == "relative gain over regular times [%]\n(right: genetic better)"


def test_a_long_tail_is_counted_and_leaves_the_bulk_its_room() -> None:
    rng = np.random.default_rng(2)
    bulk, tail = rng.normal(0.2, 0.1, 4900), -rng.uniform(2, 8.38, 90)
    relative = np.concatenate([bulk, tail, np.full(10, -20.0)])  # and beyond all bins
    axes = gain(_gain(relative), "mine", reference="the reference", ax=_axes())
    low, high = axes.get_xlim()
    middle = np.quantile(100 * relative, [0.25, 0.75])
    assert np.diff(middle)[0] > 0.1 * (high - low)  # at most 7 quartile ranges are shown
    below = int(np.sum(100 * relative < low))
    assert below >= 100
    told = f"{below} draws\nbelow {low:.0f} %".replace("-", "\N{MINUS SIGN}")
    assert [text.get_text() for text in axes.texts] == [told]
    assert any(line.get_marker() == "<" for line in axes.get_lines())
    assert _per_cent(axes) == pytest.approx(100 * (1 - below / relative.size))  # of all draws


def test_bars_have_the_share_of_draws_that_are_measured_at_each_instant() -> None:
    times = [(0, 3), (1, 2), (0, 3), (0, 2)]
    table = pd.DataFrame({"measurement_times": times})
    draws = OnlineDraws("regular", "survivors", (0, 3), table, Points(Clock.counting(4)))
    axes = online_shares(draws, ax=_axes())
    assert [bar.get_height() for bar in axes.patches] == [75, 25, 50, 50, 0]
    planned = _lines(axes)["survivors"][0]
    assert planned == [0, 3]


@pytest.mark.parametrize("times", [(0.0, 0.5, 1.0, 1.5), (0.0, 0.5, 1.0, 2.4)])
def test_online_times_on_a_clock_stand_at_their_times(times: tuple[float, ...]) -> None:
    clock = Clock(times, "h")
    rows = pd.DataFrame({"measurement_times": [(0.0, 0.5), (0.5, times[-1])]})
    draws = OnlineDraws("regular", "survivors", (0.0, 1.0), rows, Points(clock))  # type: ignore[arg-type]
    axes = online_shares(draws, ax=_axes())
    middles = [bar.get_x() + bar.get_width() / 2 for bar in axes.patches]
    np.testing.assert_allclose(middles, times)
    assert [bar.get_height() for bar in axes.patches] == [50, 100, 0, 50]


def test_online_times_of_two_sensors_stand_beside_each_other_in_two_shades() -> None:
    points = Points(Clock((0, 1, 2)), ("probe", "core"))
    rows = pd.DataFrame({"measurement_times": [("0 core", "2 probe"), ("0 core", "0 probe")]})
    draws = OnlineDraws("regular", "plan", ("0 core",), rows, points)  # type: ignore[arg-type]
    axes = online_shares(draws, ax=_axes())
    assert [bar.get_height() for bar in axes.patches] == [50, 0, 50, 100, 0, 0]
    probe, core = axes.patches[0], axes.patches[3]
    assert probe.get_x() + probe.get_width() < core.get_x()
    assert probe.get_facecolor() != core.get_facecolor()


def test_a_profile_shows_the_error_its_band_and_the_instants_measured() -> None:
    profile = pd.DataFrame({"name": ["regular"] * 3 + ["found"] * 3, "t": [0, 1, 2] * 2})
    profile["measured"] = [True, False, True, False, True, False]
    profile = profile.assign(error=[1.0, 5.0, 2.0, 3.0, 1.0, 2.0], standard_error=0.1, draws=2000)
    axes = error_profile(profile, ax=_axes())
    assert "2,000 draws" in axes.get_legend().get_title().get_text()
    lines = {line.get_label(): line for line in axes.get_lines()}
    regular, found = lines["regular, mean 2.667"], lines["found, mean 2"]
    assert np.asarray(regular.get_ydata()).tolist() == [1.0, 5.0, 2.0]
    assert np.asarray(found.get_ydata()).tolist() == [3.0, 1.0, 2.0]
    assert [list(line.get_markevery()) for line in (regular, found)] == [[0, 2], [1]]
    band = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((1 - 0.196, 5 + 0.196))


@pytest.mark.parametrize(
    ("weights", "mean"), [([2.25, 0.75, 0.0], "2.5"), ([1.0, 1.0, 1.0], "nan")]
)
def test_the_mean_of_a_profile_is_weighted_as_the_mse_is(weights: list[float], mean: str) -> None:
    """An error that is unknown counts unless its weight is 0."""
    profile = pd.DataFrame(
        {"name": "found", "t": [0.0, 1.0, 4.0], "measured": [True, False, False]}
    )
    profile = profile.assign(error=[2.0, 4.0, np.nan], standard_error=0.1, weight=weights)
    axes = error_profile(profile, ax=_axes())
    assert axes.get_lines()[0].get_label() == f"found, mean {mean}"


def test_a_measurements_worth_is_a_stem_with_its_interval() -> None:
    measurements = pd.DataFrame(
        {
            "name": ["regular", "found", "found"],
            "t": [0, 1, 4],
            "removed": [2.0, 1.0, -0.5],
            "removed_error": [0.1, 0.2, 0.3],
        }
    )
    axes = worth(measurements, ax=_axes())
    stems = [segment.tolist() for segment in axes.collections[2].get_segments()]
    assert stems == [[[1.2, 0.0], [1.2, 1.0]], [[4.2, 0.0], [4.2, -0.5]]]  # beside the other's
    bars = np.stack(axes.collections[3].get_segments())[:, :, 1]
    np.testing.assert_allclose(bars, [[1 - 0.392, 1 + 0.392], [-0.5 - 0.588, -0.5 + 0.588]])


def test_a_figure_of_twenty_searches_has_room_for_curves_and_legend() -> None:
    names = [f"a_search_with_quite_a_long_name_{number}" for number in range(20)]
    rows = [EVALUATIONS[EVALUATIONS["phase"] == "random"].assign(phase=search) for search in names]
    with styled():
        height = 1.9 + legend_inches(names)
        figure = Figure(figsize=(COLUMN_INCHES, height), layout="constrained")
        axes = figure.subplots()
        methods, reference = dict.fromkeys(names, "random"), ("regular times", 31.2)
        searches(pd.concat(rows), methods, reference=reference, ax=axes)
        figure.draw_without_rendering()
    texts = [text.get_window_extent() for text in axes.get_legend().get_texts()]
    assert len(axes.get_legend().get_texts()) == 21  # and the reference
    assert len({line.get_color() for line in axes.get_lines()}) == 21  # a colour for each search
    assert axes.get_window_extent().height > 1.0 * figure.dpi
    assert all(text.x0 >= 0 and text.x1 <= figure.bbox.width for text in texts)
    assert all(text.y1 <= figure.bbox.height for text in texts)
    for column in {round(text.x0) for text in texts}:
        rows = sorted(text.y0 for text in texts if round(text.x0) == column)
        assert min(np.diff(rows)) > 7 / 72 * figure.dpi  # no line lies on another
