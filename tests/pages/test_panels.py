"""Every public figure: of a run or of tables, in given or new axes, with no legend on data.

They are those of `pfdist.plugins.budget`, `pfdist.plugins.check`, `pfdist.plugins.filter`,
`pfdist.plugins.fit`, `pfdist.plugins.runs` and `pfdist.plugins.why`, too.
"""

import inspect
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations, pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.text import Text

import pfdist
from oracles.in_turn import in_turn
from pfdist import plots
from pfdist.common.component_names import numbered_components
from pfdist.errors import JobError
from pfdist.pages import panel
from pfdist.pages.figure import FIGURES, Tables, drawn
from pfdist.pages.panel import label_ends, label_instants, label_quantity, styles_of
from pfdist.pages.style import BLUE, GREY, OCHRE, PRINT, RED, SCREEN, styled
from pfdist.plugins.online.draws import OnlineDraws
from pfdist.plugins.runs.runs_table import RESULTS
from pfdist.problem.clock import Clock
from pfdist.problem.points import Points
from pfdist.results import Run
from pfdist.store import filtered_schema

NAMES = [
    name for name in plots.__all__ if "ax" in inspect.signature(getattr(plots, name)).parameters
]
SETS = ("regular", "mine")
PROFILE = pd.DataFrame(
    [
        {
            "name": name, "t": t, "measured": t % 3 == 0, "draws": 200, "error": 1.0 + t % 3,
            "standard_error": 0.1, "degenerate_draws": 2 * t * (name == "mine"),
            "effective_sample_size": 30.0 + t if t % 3 == 0 else np.nan,
        }
        for name in SETS
        for t in range(10)
    ]
)  # fmt: skip
LOSSES = pd.DataFrame({"particles": [50, 200, 1000], "particle_loss": [0.05, 0.012, 0.001]})
LOSSES = LOSSES.assign(particle_loss_error=0.002, particle_loss_limit=[0.1, 0.03, 0.004])
WORTH = pd.DataFrame([{"name": name, "t": t} for name in SETS for t in range(0, 10, 3)])
WORTH = WORTH.assign(removed=0.1 * WORTH["t"], removed_error=0.02)
WINDOWS = pd.DataFrame(
    [
        {"name": name, "t": t, "moved_to": t + step, "within_1": strict, "within_5": wide}
        for name, t in (("regular", 0), ("mine", 3), ("mine", 7))
        for step, strict, wide in zip(
            range(4),
            ("inside", "inside", "open", "outside"),
            ("inside", "inside", "inside", "open"),
            strict=True,
        )
    ]
)
STUDY = pd.DataFrame(
    [
        dict.fromkeys(RESULTS, 0.5)
        | {
            "run": f"{name}-{budget}-{particles}", "problem.measurement_budget": budget,
            "filter.particles": particles, "set": name, "expected_mse": 40.0 - budget,
            "reference": "regular", "measurement_times": (0, budget),
        }
        for budget in (3, 5)
        for particles in (20, 40)
        for name in SETS
    ]
)[["run", "problem.measurement_budget", "filter.particles", *RESULTS]]  # fmt: skip
MINE = STUDY[STUDY["set"] == "mine"]
WHY = SimpleNamespace(profile=PROFILE, worth=WORTH, sampling_windows=WINDOWS)  # of pfdist.why


def _axes() -> Axes:
    return Figure().subplots()


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    pyplot.close("all")


def _filtered() -> pd.DataFrame:
    table = pd.DataFrame(
        {name: np.arange(5.0) for name in filtered_schema(numbered_components(2)).names}
    )
    return table.assign(t=range(5), measured=[True, False, True, False, False])


def test_times_that_are_not_whole_are_shown_without_a_run() -> None:
    axes = plots.times({"mine": [0.5, 12.9]}, ax=_axes())
    low, high = axes.get_xlim()
    assert low < 0.0
    assert 12.9 < high < 14.0
    shaded = plots.times({"mine": [0.5, 2.0]}, horizon=2.5, forbidden=[1.5], ax=_axes())
    assert shaded.get_xlim()[1] == pytest.approx(2.5 * 1.03)
    (patch,) = shaded.patches
    assert (patch.get_x(), patch.get_x() + patch.get_width()) == (1.0, 1.75)


def _markers(axes: Axes) -> dict[tuple[str, float], list[float]]:
    """The times of each kind of marker in each row."""
    rows = {}
    for line in axes.get_lines():
        for t, level in zip(*line.get_data(), strict=True):
            if line.get_ls() == "None":
                rows.setdefault((line.get_marker(), round(float(level), 3)), []).append(t)
    return rows


def test_each_sensor_has_a_row_among_filtered_measurements() -> None:
    """Two sensors measure at one time, one as planned and the other not."""
    times = (["0 ct", "2 ct", "2 x-ray"], ["0 x-ray"], ["2 x-ray"], ["4 ct"])
    axes = plots.belief(_filtered(), times=times, ax=_axes())
    ct, x_ray = 0.105, 0.035
    assert _markers(axes) == {
        ("|", ct): [0, 2], ("x", x_ray): [0], ("D", x_ray): [2], ("o", ct): [4]
    }  # fmt: skip
    assert [text.get_text() for text in axes.texts] == ["x-ray", "ct"]


def test_each_sensor_has_a_row_below_a_draw() -> None:
    sets = {"regular": ["0 ct", "3 ct"], "mine": ["1 x-ray", "1 ct"]}
    axes = plots.one_draw(_trajectory(), sets, ax=_axes())
    times = [sorted(at) for (_, level), at in sorted(_markers(axes).items())]
    assert sorted(times) == [[0, 3], [1], [1]]
    assert [text.get_text() for text in axes.texts] == ["regular, ct", "mine, ct", "mine, x-ray"]
    assert len(axes.get_legend().get_texts()) == 3  # as without sensors


def test_each_sensor_has_a_marker_at_the_worth_of_its_measurements() -> None:
    """Sensors that measure at one time stand beside each other."""
    worth = pd.DataFrame({"name": "mine", "t": [1, 1, 4], "sensor": ["ct", "x-ray", "ct"]})
    axes = plots.worth(worth.assign(removed=[1.0, 2.0, 3.0], removed_error=0.1), ax=_axes())
    shown = {label.get_text() for label in axes.get_legend().get_texts()}
    assert {"mine", "ct", "x-ray"} <= shown
    rows = _markers(axes)
    found = sorted((t, y) for (shape, y), at in rows.items() for t in at if shape == "o")
    assert found == [(pytest.approx(0.8), 1.0), (pytest.approx(3.8), 3.0)]
    assert [t for (shape, _), at in rows.items() for t in at if shape == "s"] == [
        pytest.approx(1.2)
    ]


def test_with_more_sensors_than_markers_the_markers_come_again() -> None:
    names = [f"s{number:02d}" for number in range(20)]
    worth = pd.DataFrame({"name": "mine", "t": range(20), "sensor": names})
    axes = plots.worth(worth.assign(removed=1.0, removed_error=0.1), ax=_axes())
    shapes = {line.get_label(): line.get_marker() for line in axes.get_lines()}
    assert shapes["s00"] == shapes["s08"] == shapes["s16"] != shapes["s01"]


FALLS = pd.DataFrame({"parameter": "sd", "sd": [0.5, 0.7, 1.1], "below": [2.5, 0.0, 3.1]})


def _trajectory() -> pd.DataFrame:
    columns = {f"estimate_{name}_0": np.arange(10) + 0.5 for name in SETS}
    return pd.DataFrame({"draw": 3, "t": range(10), "z_0": np.arange(10.0), **columns})


Draw = Callable[..., Axes]
Call = tuple[tuple[Any, ...], dict[str, Any]]


def call(*arguments: Any, **options: Any) -> Call:
    return arguments, options


def _way(name: str, given: Call) -> Draw:
    """A way to call a function of `plots`; ``ax`` is left open."""
    arguments, options = given
    return partial(getattr(plots, name), *arguments, **options)


@pytest.fixture(scope="module")
def drawings(plain: Run, proved: Run, several: Run) -> dict[str, list[Draw]]:
    """Ways to call each function, with a run and with tables."""
    filtered = SimpleNamespace(table=_filtered(), missing=(1,), extra=(2,), to_come=(4,))
    sets = {"regular": [0, 3], "mine": [1]}
    calls = {
        "against": [
            call(STUDY, "filter.particles", "gain_of_means"),
            call(SimpleNamespace(table=lambda: MINE)),
        ],
        "belief": [call(_filtered(), component=1), call(filtered)],
        "bound": [call(proved.table("bound").assign(steps=1e9))],  # it is exact
        "budget": [call(several), call(several.table("sets"))],
        "comparison": [call(plain), call(proved.table("ranks"))],
        "searches": [
            call(plain, ["survivors"]),
            call(proved.table("evaluations").assign(end=12)),
        ],
        "effective_sample_size": [call(WHY, particles=50), call(filtered)],
        "error_profile": [call(PROFILE), call(WHY, SETS)],
        "gain": [
            call(plain, "survivors"),
            call(plain.table("comparison"), "genetic", reference="survivors"),
        ],
        "likelihood_profile": [call(FALLS, "sd"), call(SimpleNamespace(profile=FALLS), "sd")],
        "one_draw": [call(plain, "survivors", draw=4), call(_trajectory(), sets)],
        "online_shares": [call(proved)],
        "particle_losses": [call(LOSSES), call(LOSSES.iloc[::-1])],
        "times": [call(proved), call(several), call(sets, forbidden=[5, 6])],
        "worth": [call(WORTH), call(WHY)],
    }
    return {name: [_way(name, given) for given in ways] for name, ways in calls.items()}


every = pytest.mark.parametrize("name", NAMES)


def test_plots_are_found_under_pfdist() -> None:
    assert pfdist.plots is plots
    assert len(NAMES) == 15


@every
def test_it_draws_into_given_axes_or_new_ones_and_its_legend_covers_no_data(
    name: str, drawings: dict[str, list[Draw]]
) -> None:
    """Most data lie within the axes; new ones have the user's style."""
    for draw in drawings[name]:
        with styled(PRINT):
            figure = Figure(layout="constrained")
            axes = figure.subplots()
            assert draw(ax=axes) is axes
            assert axes.has_data()
            assert not pyplot.get_fignums()
            shapes = _shapes(axes)
            _check_legends(figure)  # the figure is drawn
            lines = [line for line in axes.get_lines() if np.isfinite(line.get_xydata()).any()]
            points = [line.get_transform().transform(line.get_xydata()) for line in lines]
            box = axes.get_window_extent().padded(1)
            inside = [box.contains(*point) for point in np.concatenate([*points, np.empty((0, 2))])]
            assert np.mean(inside or [True]) > 0.7
        with pytest.raises(TypeError, match=r"^ax must be of type Axes, got ndarray$"):
            draw(ax=np.array([1, 2]))  # as pyplot.subplots gives for two axes
        with pyplot.style.context({"lines.linewidth": 7.5, "figure.facecolor": "0.9"}):
            new = draw()
        assert new.figure is pyplot.gcf()
        assert new.figure.get_facecolor()[:3] == (0.9, 0.9, 0.9)
        assert _shapes(new) == shapes
        pyplot.close("all")


def _shapes(axes: Axes) -> list[list[float]]:
    return [np.asarray(line.get_xydata()).ravel().tolist() for line in axes.get_lines()]


@pytest.mark.slow
def test_no_legend_of_a_runs_figures_covers_data(plain: Run, proved: Run, several: Run) -> None:
    figures = [
        plot
        for run in (plain, proved, several)
        for figure in FIGURES.values()
        for _, plot in figure.plots(Tables(run))
    ]
    for style, size in ((PRINT, {}), (SCREEN, {"figure.figsize": (5.4, 3.0)})):  # of a report
        with styled(style, size):
            for plot in figures:
                _check_legends(drawn(plot))


def _check_legends(figure: Figure) -> None:
    """Check that texts lie on the figure, and legends on no axes, marker or other legend."""
    figure.draw_without_rendering()
    whole = figure.bbox.padded(1)
    for axes in figure.axes:
        for text in filter(Text.get_text, (axes.xaxis.label, axes.yaxis.label, *axes.texts)):
            box = text.get_window_extent()
            assert np.all((whole.min <= box.min) & (box.max <= whole.max)), text
    legends = [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    boxes = [legend.get_window_extent() for legend in legends]
    for number, box in enumerate(boxes):
        assert box.x0 >= -1
        assert box.x1 <= figure.bbox.width + 1
        assert box.y1 <= figure.bbox.height + 1
        assert not any(box.overlaps(other) for other in boxes[:number])
        for axes in figure.axes:
            assert not box.overlaps(axes.get_window_extent())
            for line in axes.get_lines():
                x, y = line.get_transform().transform(np.atleast_2d(line.get_xydata())).T
                radius = line.get_markersize() / 2 / 72 * figure.dpi * (line.get_marker() != "None")
                inside = (box.x0 < x + radius) & (x - radius < box.x1)
                assert not (inside & (box.y0 < y + radius) & (y - radius < box.y1)).any()


def test_the_reference_of_a_run_is_hollow_and_its_forbidden_instants_are_shaded(
    proved: Run, several: Run
) -> None:
    axes = plots.times(proved, ax=_axes())
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["regular", "genetic plan", "random plan"]
    rows = [line for line in axes.get_lines() if line.get_marker() != "None"]
    assert [list(line.get_xdata()) for line in rows] == [list(t) for t in proved.sets.values()]
    assert [line.get_markerfacecolor() == "white" for line in rows] == [True, False, False]
    assert len({line.get_color() for line in rows}) == 3
    shaded = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axes.patches]
    assert shaded == [(6.5, 7.5), (8.5, 10.5)]
    assert axes.get_xlim() == (-0.75, 12.75)
    rows = [line for line in plots.times(several).get_lines() if line.get_marker() == "o"]
    assert [line.get_markerfacecolor() == "white" for line in rows] == [True, True, False, False]


def test_a_set_has_one_colour_in_all_figures_of_a_run_and_the_reference_alone_is_blue(
    proved: Run,
) -> None:
    tables, colours = Tables(proved), dict[str, set[Any]]()
    for figure in ("times", "system", "why", "draw", "searches"):
        for _, plot in FIGURES[figure].plots(tables):
            for line in (line for axes in drawn(plot).axes for line in axes.get_lines()):
                label = str(line.get_label()).replace("evenly spaced", "regular")
                words = label.replace(",", " ").split()
                for name in {*words} & {*proved.names}:
                    colours.setdefault(name, set()).add(line.get_color())
    for name in proved.names[1:]:
        bars = plots.gain(proved, name, ax=_axes()).patches
        colours[name].add(to_hex(bars[0].get_facecolor()))
    assert [len(colours[name]) for name in proved.names] == [1, 1, 1]
    assert colours["regular"] == {BLUE}
    assert len(set.union(*colours.values())) == 3
    many = styles_of([f"set {k}" for k in range(12)], [])
    assert [style["color"] for style in many.values()].count(BLUE) == 1


def test_the_plan_is_red_and_evenly_spaced_times_are_blue_wherever_they_stand() -> None:
    labels = {"mine": "mine", "regular": "evenly spaced", "genetic": "plan"}
    colours = {name: style["color"] for name, style in styles_of(labels, []).items()}
    assert colours == {"regular": BLUE, "genetic": RED, "mine": OCHRE}


def test_names_beside_curves_that_end_together_do_not_touch() -> None:
    axes = _axes()
    label_ends(axes, [(0.5, "upper", RED), (0.5, "also", BLUE), (0.1, "lower", GREY)])
    axes.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(box.overlaps(other) for box, other in combinations(boxes, 2))
    assert axes.texts[0].get_text() == "lower"


@pytest.mark.parametrize(
    ("names", "angles", "unit"),
    [
        (["mass [mg]"], [False], "mg"),
        (["drug [g/L]", "blood [g/L]"], [False, False], "(g/L)"),
        (["drug [g/L]", "mass"], [False, False], ""),
        ([], [False], ""),
        (["heading [rad]"], [True], ""),  # its error is no square
        (["mass [mg]"], [], ""),  # an error of the model's own
    ],
)
def test_squared_errors_have_the_unit_of_z_squared(
    names: list[str], angles: list[bool], unit: str, several: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = {"provenance": {"names": {"z": names}}}
    monkeypatch.setattr(panel, "provenance_of", lambda run: about["provenance"])
    monkeypatch.setattr(panel, "angles_of", lambda run: angles)
    label = plots.budget(several, ax=_axes()).get_ylabel()
    assert label == (f"expected MSE [{unit}²]" if unit else "expected MSE")


def test_a_bound_is_drawn_once_it_has_grown_and_an_exact_one_never(proved: Run) -> None:
    assert not FIGURES["bound"].files(proved)
    assert "no lower bound" in plots.bound(proved, ax=_axes()).texts[0].get_text()
    rows = proved.table("bound").assign(steps=1e9, bound_error=0.1)
    steps = {98: 2e9, 99: 2.1e9}
    later = (rows.assign(steps=each, draws=draws) for draws, each in steps.items())
    axes = plots.bound(pd.concat([rows, *later]), ax=_axes())
    (bars,) = axes.containers
    assert bars[0].get_xydata()[:, 0].tolist() == [1.0, 2.0, 2.1]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2.1"]  # none overlap
    assert bars[0].get_color() == "black"


def test_the_effective_sample_size_has_a_point_where_it_is_known() -> None:
    axes = plots.effective_sample_size(PROFILE, particles=5000, ax=_axes())
    assert axes.get_ylim()[1] > 5000  # the line of all particles is seen
    axes = plots.effective_sample_size(PROFILE, particles=50, ax=_axes())
    assert list(axes.get_lines()[0].get_xdata()) == [0, 3, 6, 9]
    assert (axes.get_yscale(), axes.get_ylim()[0]) == ("linear", 0.0)
    far = PROFILE.assign(effective_sample_size=PROFILE["effective_sample_size"] ** 3)
    axes = plots.effective_sample_size(far, ax=_axes())
    assert axes.get_yscale() == "linear"
    far.loc[0, "effective_sample_size"] = 2.0
    axes = plots.effective_sample_size(far, ax=_axes())
    assert (axes.get_yscale(), axes.get_ylim()[0]) == ("log", 1.0)
    known = PROFILE.assign(effective_sample_size=np.nan, draws=0)
    axes = plots.effective_sample_size(known, ax=_axes())
    assert "exact filters" in axes.texts[0].get_text()


def test_the_loss_is_in_per_cent_and_a_loss_below_0_has_no_place_on_the_axis() -> None:
    losses = LOSSES.assign(particle_loss=[0.05, 0.012, -0.001]).iloc[::-1]
    axes = plots.particle_losses(losses, ax=_axes())
    (by_two, *_), (limit, *_) = axes.containers
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    np.testing.assert_array_equal(by_two.get_xdata(), LOSSES["particles"])
    np.testing.assert_allclose(by_two.get_ydata(orig=False), [5.0, 1.2, np.nan])
    np.testing.assert_allclose(limit.get_ydata(orig=False), [10.0, 3.0, 0.4])


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda run: plots.gain(run, "nobody"), "name must be one of genetic, survivors, got 'nob"),
        (lambda run: plots.one_draw(run, draw=61), "draw must be one of 0, 1, 2"),
        (lambda run: plots.searches(run, ["nobody"]), "searches must be one of genetic, survivors"),
        (lambda run: plots.worth(WORTH, ["nobody"]), "names must be one of regular, mine, got 'n"),
    ],
)
def test_a_name_that_does_not_exist_is_told_with_those_that_do(
    draw: Callable[[Run], Axes], words: str, plain: Run
) -> None:
    with pytest.raises(JobError, match=words):
        draw(plain)
    assert not pyplot.get_fignums()


@every
@in_turn("wrong", [5, "results/quick", {"regular": 3}, [1, 2], None])
def test_what_is_no_source_is_refused_in_one_line(name: str, wrong: object) -> None:
    """The line names the argument, the allowed types, and the type that it got."""
    draw = getattr(plots, name)
    source = next(iter(inspect.signature(draw).parameters))
    got = "int" if wrong == {"regular": 3} and name == "times" else type(wrong).__name__
    told = rf"^{source}\S* must be (of type \w+( or \w+)*|a DataFrame, or have .*), got {got}$"
    with pytest.raises(TypeError, match=told):
        draw(wrong)
    assert not pyplot.get_fignums()


def test_a_table_of_another_kind_is_refused() -> None:
    with pytest.raises(TypeError, match=r"^profile\.profile must be of type DataFrame, got int$"):
        plots.error_profile(SimpleNamespace(profile=3))
    with pytest.raises(TypeError, match=r"^names must be of type Sequence, got int$"):
        plots.worth(WORTH, 3)  # type: ignore[arg-type]
    assert next(line.get_label() for line in plots.worth(WORTH, "mine").get_lines()) == "mine"


COSTLY = r"US$\frac$_^{"  # what Matplotlib would take for a formula, and could not read


def _with_costly_names() -> dict[str, Draw]:
    """A way to draw own tables with such names for each function that shows names."""
    mse = np.linspace(1.0, 2.0, 50)
    comparison = pd.DataFrame({"mse_a$b": mse, f"mse_{COSTLY}": mse[::-1], "mse_$": mse**2})
    rows = pd.DataFrame({"draw": range(50), "measurement_times": [[0, 3]] * 50})
    evaluations = pd.DataFrame({"phase": COSTLY, "generation": [0, 0, 1, 1], "individual": 0})
    evaluations = evaluations.assign(copies=1, expected_mse=[3.0, 2.0, 1.0, 1e9], draws=5, end=9)
    bounds = pd.DataFrame({"position": [0, 1], "name": ["a$b", COSTLY], "draws": 5, "steps": 1e9})
    bounds = bounds.assign(compared_draws=5, window=1, work=1.0, memory=1, particles=5)
    bounds = bounds.assign(expected_mse=2.0, bound=1.0, bound_error=0.1)
    trajectory = _trajectory().rename(columns={"estimate_mine_0": f"estimate_{COSTLY}_0"})
    sets = {"regular": [0, 3], COSTLY: [1]}
    profile, worth, study = (table.replace("mine", COSTLY) for table in (PROFILE, WORTH, STUDY))
    calls = {
        "against": call(study),
        "bound": call(bounds),
        "searches": call(evaluations, reference=(COSTLY, 2.0)),
        "effective_sample_size": call(profile),
        "error_profile": call(profile),
        "gain": call(comparison, COSTLY, reference="a$b"),
        "one_draw": call(trajectory, sets),
        "online_shares": call(
            OnlineDraws("regular", COSTLY, (1,), rows, Points(Clock.counting(12)))
        ),
        "times": call(sets),
        "worth": call(worth),
    }
    return {name: _way(name, given) for name, given in calls.items()}


@in_turn("draw", _with_costly_names().values())
def test_a_name_is_no_formula(draw: Draw) -> None:
    figure = Figure(layout="constrained")
    axes = draw(ax=figure.subplots())
    figure.draw_without_rendering()  # which sets texts
    legend = axes.get_legend()
    texts = [
        *axes.texts,
        *axes.get_yticklabels(),
        axes.xaxis.label,
        *(legend.get_texts() if legend else []),
    ]
    assert any(COSTLY.replace("$", r"\$") in text.get_text() for text in texts)


def _boxes(axes: Axes) -> list[Any]:
    """Where the names of sets lie, one below another: no two of them touch."""
    axes.get_figure().draw_without_rendering()
    boxes = [label.get_window_extent() for label in axes.get_yticklabels()]
    assert not any(box.overlaps(other) for box, other in pairwise(boxes))
    return boxes


def test_each_of_forty_sets_has_its_name_in_a_new_figure() -> None:
    sets = {f"set {position}": [position] for position in range(40)}
    with styled(PRINT):
        axes = plots.times(sets)
        assert len(_boxes(axes)) == 40
    assert [label.get_text() for label in axes.get_yticklabels()] == list(sets)


def test_names_that_have_no_room_are_left_out_and_the_axis_says_so() -> None:
    sets = {f"set {position}": [position] for position in range(101)}
    axes = plots.times(sets)
    step = -(-101 // len(_boxes(axes)))
    assert step > 1
    assert [label.get_text() for label in axes.get_yticklabels()] == list(sets)[::step]
    assert axes.get_ylabel() == f"101 sets, 1 of {step} is named"
    small = plots.times(sets, ax=Figure(figsize=(3, 1.5)).subplots())
    assert len(small.get_yticks()) < len(axes.get_yticks())


@pytest.mark.parametrize(
    ("hours", "ticks"),
    [
        (24, [0, 6, 12, 18, 24]),
        (12, [0, 2, 4, 6, 8, 10, 12]),
        (48, [0, 12, 24, 36, 48]),
        (168, [24 * day for day in range(8)]),
        (1.0, [0, 0.2, 0.4, 0.6, 0.8, 1.0]),
    ],
)
def test_ticks_of_hours_are_parts_of_a_day_or_days(hours: float, ticks: list[float]) -> None:
    ax = Figure().subplots()
    ax.plot([0, hours], [0, 1])
    label_instants(ax, Clock.regular(hours, hours / 96, "h"))
    low, high = ax.get_xlim()
    shown = [tick for tick in ax.get_xticks() if low <= tick <= high]
    np.testing.assert_allclose(shown, ticks, atol=1e-12)


def test_the_axis_of_what_is_never_negative_begins_at_0() -> None:
    shares, others = Figure().subplots(2)
    shares.plot([0, 1, 2], [0.01, 30, 0.02])
    others.plot([0, 1, 2], [-0.01, 30, 0.02])
    for ax in (shares, others):
        label_quantity(ax, numbered_components(1), 0)
    assert shares.get_ylim()[0] == 0
    assert others.get_ylim()[0] < -0.01
