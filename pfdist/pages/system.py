"""The first picture of a run: the system itself, the typical error over time, and the times."""

from collections.abc import Mapping, Sequence
from itertools import product
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.common.component_names import Component
from pfdist.common.rounding import rounded
from pfdist.pages.figure import Plot, Tables, figure, one_number, shown_by_pyplot
from pfdist.pages.panel import (
    check_kind,
    cut_outliers,
    error_unit,
    label_instants,
    label_quantity,
    label_times,
    legend_above,
    marker,
    minus,
    points,
    stack,
    styles_of,
    table_of,
    thin,
    verbatim,
)
from pfdist.pages.style import GREY
from pfdist.pages.times_axis import forbidden_times, shade
from pfdist.problem.clock import Clock, Time
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run
from pfdist.results.over_time import RANGE_SUMS, errors_over_time_of, ranges_of
from pfdist.results.sampling_windows import WIDE, runs_of, windows_of
from pfdist.results.sets import best_first, rows_of_sets, typical_error
from pfdist.results.stored_run import angles_of, problem_of
from pfdist.store.schema import components_in

Array = NDArray[np.float64]
_MOST = 3  # components of z, each in a column
_CURVES = 4  # simulated systems beside the band
_LOW, _HIGH = 0.05, 0.95  # quantiles that limit the band
_LITTLE = 0.05  # share of the typical error: two sets that differ by less are two equal sawteeth
_PANELS, _ROW = (1.35, 0.95), 0.2  # inches of the upper panels, and of a row of times
_LANE = 0.3  # of a row, for bars that would overlap those of another lane
_LETTERS = 14  # of a line of the label of an error


class _Set(NamedTuple):
    """A set of times."""

    name: str
    label: str
    style: Mapping[str, Any]
    times: Mapping[str, Sequence[Time]]  # of each sensor; one without a name has all if none has
    errors: Sequence[float]  # typical ones, by component of z; empty: unknown


class _Bar(NamedTuple):
    """How far a measurement of the plan may move alone, in one of several lanes below its row."""

    sensor: str
    lane: int
    t: Time
    first: Time
    last: Time


class _Component(NamedTuple):
    """A component of z."""

    number: int
    named: Component
    is_angle: bool

    @property
    def unit(self) -> str:
        """Its unit, that of an angle is rad."""
        return self.named.unit or "rad" * self.is_angle


@figure(
    "system",
    applies=lambda run: one_number(run) and {"trajectories", RANGE_SUMS} <= {*run.tables},
)
def system_figure(tables: Tables) -> Plot:
    """The simulated system, the typical error of the plan over time, and its measurement times."""
    run, quantities = tables.run, components_in(tables.trajectories, "z_")
    sets, angles = _sets_of(run), angles_of(run)
    components = [
        _Component(k, each, is_angle)
        for k, each in enumerate(quantities[:_MOST])
        for is_angle in [any(angles[k : k + 1])]
    ]
    profiles = {
        (each.name, k.number): _profile(tables, each.name, k, alone=len(quantities) == 1)
        for each in sets
        for k in components
    }
    bars = _bars_of(run, sets[0])
    lanes = sum(max(bar.lane for bar in bars if bar.sensor == each) + 1
                for each in {bar.sensor for bar in bars})  # fmt: skip
    rows = _ROW * (sum(len(each.times) for each in sets) + _LANE * lanes)
    # All components are drawn alike; a mean over time says nothing where instants have no weight.
    is_little = all(_is_little_better(run, sets, k) for k in components)
    is_little &= 0.0 not in (problem_of(run).weights or ())
    unit = components[0].named.unit_of_error or components[0].unit

    def draw(panels: Sequence[Axes]) -> None:
        for k in components:
            band, errors, times = column = panels[k.number :: len(components)]
            _draw_band(band, tables.trajectories, k)
            label_quantity(band, quantities, k.number)
            what = "typical error" if angles else "expected error"
            draw_errors, of_sets = _draw_errors, [profiles[each.name, k.number] for each in sets]
            if is_little:
                what, draw_errors = "difference", _draw_difference
            of_error = verbatim(k.named.unit_of_error or k.unit)
            text = f"{what} [{of_error}]" if of_error and angles else what
            errors.set_ylabel("\n".join(wrap(text, _LETTERS, break_long_words=False)))
            draw_errors(errors, run, sets, k, of_sets)
            for of_sensor in sets[0].times.values():
                always = problem_of(run).clock.ranges(of_sensor)  # their lines would be a curtain
                for t, ax in product(of_sensor, (band, errors)):
                    if t not in always:
                        colour = sets[0].style["color"]
                        ax.axvline(t, color=colour, lw=thin(0.5), alpha=0.6, zorder=0)
            _draw_times(times, run, sets, bars, named=not k.number)
            stack(column)

    return Plot(
        0.9 + sum(_PANELS) + rows, draw, 3, share_x=True, columns=len(components),
        title=_caption(tables, sets, unit), heights=[*_PANELS, rows],
    )  # fmt: skip


def system(run: Run) -> Sequence[Axes]:
    """Draw the system of a run, the typical error of its plan, and when the plan measures.

    There is a column for each of the first three components of z, with three panels on one time
    axis. The first has the band of 90 % of the simulated systems, four of them, and lines at the
    plan's times. The second has the typical error of the plan and of the reference in the unit of
    z; where the plan's is smaller, the difference is shaded. If it is smaller by less than 5 %, a
    moving mean of the difference over two measurements is drawn instead. The third has the times of
    both, and how far each time of the plan alone may move at a loss of at most 5 %, where
    `pfdist.why` was asked.

    Parameters
    ----------
    run : Run
        A run for one number of measurements that has compared draws.

    Returns
    -------
    sequence of matplotlib Axes
        The panels of a new figure of pyplot, row by row.
    """
    check_kind(run, (Run,), "run")
    return shown_by_pyplot(system_figure(Tables(run)))


def simulated_plot(table: pd.DataFrame, angles: Sequence[bool]) -> Plot:
    """The plot of simulated systems: the band of 90 % of each component of z, and some of them.

    The table has the columns of `pfdist.simulate`; `angles` says which components are angles.
    """
    quantities = components_in(table, "z_")
    components = [_Component(k, each, angles[k]) for k, each in enumerate(quantities[:_MOST])]

    def draw(panels: Sequence[Axes]) -> None:
        for ax, k in zip(panels, components, strict=True):
            _draw_band(ax, table, k)
            label_quantity(ax, quantities, k.number)
            label_times(ax, table)

    title = f"{table['draw'].nunique()} simulated systems."
    return Plot(0.7 + _PANELS[0], draw, columns=len(components), title=title)


def _sets_of(run: Run) -> list[_Set]:
    """The plan, or the best set, and the reference, or the set beside it."""
    styles, clock = styles_of(run.labels, ()), problem_of(run).clock
    rows = {row.name: row for row in rows_of_sets(run)}
    best = best_first([*rows.values()])[0]
    other = next((name for name in rows if name != best), best)
    return [
        _Set(name, str(styles[name]["label"]), styles[name] | {"label": None},
             clock.by_sensor(run.sets[name]), rows[name].typical_error or ())
        for name in dict.fromkeys([best, other])
    ]  # fmt: skip


def _profile(tables: Tables, name: str, k: _Component, *, alone: bool) -> "pd.Series[float]":
    """The typical error of a set by time; of all draws if z has this component alone."""
    if alone:
        table = table_of(tables.run, "run", "error_over_time")
        errors = table[table["name"] == name].set_index("t")["error"]
    else:
        rows, suffix = tables.trajectories, k.named.suffix
        difference = rows[f"z_{suffix}"] - rows[f"estimate_{name}_{suffix}"]
        each = 1 - np.cos(difference) if k.is_angle else difference**2
        errors = pd.Series(each).groupby(rows["t"]).mean()
    if not angles_of(tables.run):  # errors are not in the unit of z
        return errors
    return errors.map(lambda error: typical_error(error, k.is_angle))


def _draw_band(ax: Axes, trajectories: pd.DataFrame, k: _Component) -> None:
    """The band of 90 % of the simulated systems, and some of them; angles around their mean."""
    table = trajectories.pivot_table(f"z_{k.named.suffix}", "draw", "t", dropna=False)
    t, z = table.columns.to_numpy(), table.to_numpy()
    if k.is_angle:
        mean = np.unwrap(np.angle(np.exp(1j * z).mean(axis=0)))
        z = z + 2 * np.pi * np.round((mean - z) / (2 * np.pi))
    low, high = np.nanquantile(z, (_LOW, _HIGH), axis=0)
    share = f"{100 * (_HIGH - _LOW):.0f} % of simulated systems"
    ax.fill_between(t, low, high, color=GREY, alpha=0.2, lw=0, label=share)
    for curve in z[:_CURVES]:
        turns = k.is_angle & (np.abs(np.diff(curve, prepend=curve[0])) > np.pi)
        ax.plot(t, np.where(turns, np.nan, curve), color=GREY, lw=thin(0.6))
    legend_above(ax)


def _draw_errors(
    ax: Axes, run: Run, sets: Sequence[_Set], k: _Component, profiles: Sequence["pd.Series[float]"]
) -> None:
    """The typical error of the plan and of the reference; the gain is shaded where it counts."""
    curves, counts = [], np.array(problem_of(run).weights or 1.0) > 0
    for each, errors in zip(sets[::-1], profiles[::-1], strict=True):
        known, style = [*each.errors][k.number : k.number + 1], each.style
        label = ": ".join([each.label, *(minus(rounded(error, 3)) for error in known)])
        ax.plot(errors.index, errors, color=style["color"], ls=style["ls"], label=label)
        curves.append(points(errors.index, errors, style["color"], each.label))
    plan, other = profiles[0].to_numpy(), profiles[-1].to_numpy()
    ax.fill_between(profiles[0].index, plan, other, counts & (other > plan),
                    color=sets[0].style["color"], alpha=0.15, lw=0)  # fmt: skip
    cut_outliers(ax, curves, zero=True)
    legend_above(ax)


def _is_better(run: Run, plan: _Set) -> bool:
    """Whether the expected MSE of a plan is clearly lower than that of its reference."""
    row = run.table("sets").set_index("name").loc[plan.name]
    return bool(row["gain_of_means"] > 0 and not row["gain_of_means_low"] <= 0)


def _is_little_better(run: Run, sets: Sequence[_Set], k: _Component) -> bool:
    """Whether a plan is better by so little that the curves could not be told apart."""
    errors = [error for each in sets for error in [*each.errors][k.number : k.number + 1]]
    is_near = len(errors) == 2 and 0 < abs(errors[0] - errors[1]) < _LITTLE * errors[1]
    return is_near and _is_better(run, sets[0])


def _draw_difference(
    ax: Axes, run: Run, sets: Sequence[_Set], k: _Component, profiles: Sequence["pd.Series[float]"]
) -> None:
    """How far the error of the plan lies below that of the reference, as a moving mean."""
    clock, (plan, other) = problem_of(run).clock, sets
    t, change = profiles[0].index.to_numpy(np.float64), (profiles[1] - profiles[0]).to_numpy()
    long = 2 * (t[-1] - t[0]) / max(2, *(len(times) for times in plan.times.values()))
    total = np.cumsum([0.0, *np.nan_to_num(change, posinf=0.0, neginf=0.0)])
    first, end = np.searchsorted(t, t - long / 2), np.searchsorted(t, t + long / 2, "right")
    mean = (total[end] - total[first]) / (end - first)
    own, before = (rounded(each.errors[k.number], 3) for each in sets)
    over = f"{long:.0f} instants" if clock.counts else clock.duration(long)
    label = f"{other.label} ({before}) less {plan.label} ({own}), mean over {over}"
    colour = plan.style["color"]
    ax.axhline(0, color=GREY, lw=thin(0.6))
    ax.plot(t, mean, color=colour, label=label)
    ax.fill_between(t, 0, mean, mean > 0, color=colour, alpha=0.15, lw=0)
    legend_above(ax)


def _bars_of(run: Run, plan: _Set) -> list[_Bar]:
    """The sampling windows of the plan, in as few lanes as do not overlap."""
    if "sampling_windows" not in run.tables:
        return []
    table = run.table("sampling_windows")
    rows = table[table["name"] == plan.name].to_dict("records")
    bars, ends = list[_Bar](), dict[str, list[Time]]()
    for window in windows_of(rows, WIDE, problem_of(run).clock):
        [reach] = [each for each in runs_of(window.inside) if window.t in each]
        if len(reach) > 1:
            lanes = ends.setdefault(window.sensor, [])
            free = (lane for lane, end in enumerate(lanes) if end < reach[0])
            lane = next(free, len(lanes))
            lanes[lane : lane + 1] = [reach[-1]]
            bars.append(_Bar(window.sensor, lane, window.t, reach[0], reach[-1]))
    return bars


def _draw_times(
    ax: Axes, run: Run, sets: Sequence[_Set], bars: Sequence[_Bar], *, named: bool
) -> None:
    """The times of each set and sensor, and below those of the plan how far each may move."""
    clock, names, level = problem_of(run).clock, dict[float, str](), 0.0
    for each in sets[::-1]:
        for sensor, times in each.times.items():
            style = {**each.style, "ls": "", "ms": marker()}
            ax.plot(times, [level] * len(times), clip_on=False, zorder=3, **style)
            names[level] = ", ".join(filter(None, [each.label, verbatim(sensor)]))
            below = [bar for bar in bars if bar.sensor == sensor] if each is sets[0] else []
            for bar in below:
                at, color = level + 0.4 + _LANE * bar.lane, style["color"]
                ax.plot([bar.first, bar.last], [at, at], c=color, lw=thin())
                ax.plot([bar.t], [at], "|", c=color, ms=marker(0.7), mew=thin())
            level += 1 + _LANE * max((bar.lane + 1 for bar in below), default=0)
    shade(ax, {*forbidden_times(run)}, clock)
    ax.set_ylim(level - 0.4, -0.6)
    ax.set_yticks([*names], [*names.values()] if named else [""] * len(names))
    ax.tick_params(axis="y", length=0)
    label_instants(ax, clock)


def _of_halves(run: Run, name: str) -> tuple[Array, Array]:
    """The error of a set over time on one half of the draws, and on the other.

    The instants with the largest of noisy differences are chosen on the first half: their
    differences on it are too large.
    """
    ranges, place = ranges_of(run), run.names.index(name)
    halves = (ranges[::2], ranges[1::2]) if len(ranges) > 1 else (ranges, ranges)  # one: exact
    first, second = (errors_over_time_of(half, place)[0] for half in halves)
    return first, second


def _stretch(clock: Clock, first: float, last: float) -> str:
    """From one time to another in words: days, and hours only of one day."""
    ends = [*dict.fromkeys(map(clock.text, [first, last]))]
    if clock.calendar is None:
        return f"at t = {' to '.join(ends)}"
    dates = [*map(clock.calendar.date, [first, last])]
    days = [*dict.fromkeys(each.date().isoformat() for each in dates)]
    if len(days) == 1 and len(ends) == 2:
        return f"on {days[0]}, {dates[0]:%H:%M} to {dates[1]:%H:%M}"
    return f"on {days[0]}" if len(days) == 1 else f"from {days[0]} to {days[1]}"


def _caption(tables: Tables, sets: Sequence[_Set], unit: str) -> str:
    """Say what the panels show, and where the error of the plan is lowest beside the other."""
    run, clock = tables.run, problem_of(tables.run).clock
    plan, other = (phrase_of(run.labels[each.name]) for each in (sets[0], sets[-1]))
    profile = table_of(run, "run", "error_over_time")
    own = profile[profile["name"] == sets[0].name]
    t, weight = (own[key].to_numpy() for key in ("t", "weight"))
    (best, second), (reference, second_of_reference) = (
        _of_halves(run, each.name) for each in (sets[0], sets[-1])
    )
    change, size = (
        np.nan_to_num(weight * each, posinf=0.0, neginf=0.0) for each in (reference - best, best)
    )
    said = "The system, the typical error over time, and the times of measurements."
    change -= max(0.0, change.mean())  # no stretch is all of time
    # Constants that are analysed afterwards have the same error at all times, up to rounding.
    if (change > 1e-9 * size.max()).any() and _is_better(run, sets[0]):
        total = np.cumsum([0.0, *change])
        stretches = np.triu(total - total[:, None], 1)  # from one instant to before another
        first, end = np.unravel_index(stretches.argmax(), stretches.shape)
        here = slice(first, end)
        is_root = len(angles_of(run)) == 1
        unit = unit if is_root else f"{error_unit(run)}²".lstrip("²")
        means = [np.average(e[here], weights=weight[here]) for e in (second_of_reference, second)]
        before, now = (
            rounded(typical_error(mean, angles_of(run)[0]) if is_root else mean, 3)
            for mean in means
        )
        ends = [float(t[k]) for k in (first, end - 1)]
        is_short = 2 * (ends[1] - ends[0]) <= t[-1] - t[0]  # "most" of more than half says nothing
        when, what = _stretch(clock, *ends), "typical error" if is_root else "expected MSE"
        if is_short and means[1] < means[0] and now != before:
            said = (
                f"With {plan} instead of {other}, the {what} falls most {when}: from "
                f"{before} to {f'{now} {unit}'.rstrip()}."
            )
    if len(components_in(tables.trajectories, "z_")) > 1:
        draws = tables.trajectories["draw"].nunique()
        said += f" The errors over time are those of {draws} draws, the numbers those of all."
    if "sampling_windows" in run.tables:
        said += f" Bars: where a time alone may move at a loss of at most {WIDE} %."
    return said
