"""When to measure: the error of each set over time, and its measurement times on one axis."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib import rcParams
from matplotlib.axes import Axes

from pfdist.errors import shown
from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    BAND,
    axes_for,
    check_kind,
    height_of_rows,
    label_instants,
    legend_above,
    marker,
    stack,
    styles_of,
    table_of,
    thin,
    verbatim,
)
from pfdist.pages.style import GREY, set_style
from pfdist.pages.why import error_profile
from pfdist.problem.clock import Clock
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run
from pfdist.results.over_time import RANGE_SUMS, difference_over_time
from pfdist.results.stored_run import problem_of

_ROW, _PANEL = 0.17, 1.6  # inches
_MOST_NAMED = 40  # rows up to which a new figure grows, so that each has its name and its line
_MARGIN = 0.03  # part of the axis beside times that are not whole
_LEADING = 1.25  # distance of two names over the size of their font


@figure("times")
def times_figure(tables: Tables) -> Plot:
    """Expected error over time of two sets, and the measurement times of every set."""
    run, sets = tables.run, tables.run.sets
    clock = problem_of(run).clock
    rows = times_inches(sum(len(clock.by_sensor(at)) for at in sets.values()))
    if len(sets) < 2 or RANGE_SUMS not in run.tables:
        numbers = sorted({len(times) for times in sets.values()})
        each = f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"{numbers[0]}"
        title = f"Measurement times of {len(sets)} sets, with {each} measurements each."
        return Plot(rows, lambda panels: times(run, ax=panels[0]), title=title)
    means = {name: each.mean for name, each in tables.statistics.mse.items()}
    mse = {name: np.nan_to_num(mean, nan=np.inf) for name, mean in means.items()}
    reference, *others = run.names
    pair = [reference, min(others, key=lambda name: mse[name])]
    best, worse = sorted(pair, key=lambda name: mse[name])
    profile = table_of(run, "run", "error_over_time")

    def draw(panels: Sequence[Axes]) -> None:
        error_profile(profile, pair, ax=panels[0])
        times(run, ax=panels[1])
        stack(panels)

    return Plot(
        0.3 + _PANEL + rows, draw, 2, share_x=True, title=_title(run, profile, best, worse),
        heights=[_PANEL, rows - 0.75],
    )  # fmt: skip


def _title(run: Run, profile: pd.DataFrame, best: str, reference: str) -> str:
    """Say in which stretches of time the best set lowers and raises the error most, and how often.

    An instant counts if the difference on common draws is clear there, with 95 % confidence.
    """
    rows = {name: profile[profile["name"] == name] for name in (best, reference)}
    at_times = rows[best]["t"].tolist()
    difference, error = difference_over_time(run, best, reference)
    lower = np.nan_to_num(-difference, posinf=0.0, neginf=0.0)
    weight = rows[best]["weight"].to_numpy()
    unit = f" {profile.attrs.get('error_unit', '')}²" if profile.attrs.get("error_unit") else ""
    parts = list[str]()
    for word, change in (("falls", weight * lower), ("rises", -weight * lower)):
        if not (change > 0).any():
            continue
        total = np.cumsum([0.0, *(change - max(0.0, change.mean()))])  # no stretch is all of time
        stretches = np.triu(total - total[:, None], 1)  # from one instant to before another
        first, end = np.unravel_index(stretches.argmax(), stretches.shape)
        here = slice(first, end)
        before, now = (
            f"{np.average(rows[name]['error'][here], weights=weight[here]):#.3g}".rstrip(".")
            for name in (reference, best)
        )
        ends = dict.fromkeys([at_times[first], at_times[end - 1]])
        at = " to ".join(map(problem_of(run).clock.text, ends))
        parts.append(f"{word} most at t = {at} (from {before} to {now}{unit})")
    smaller, larger = (int(np.sum(side * lower > BAND * error)) for side in (1, -1))
    draws = int(profile["draws"].max())
    on = f"{draws:,} common draws, 95 % confidence at each instant" if draws else "exact"
    return (
        f"With {phrase_of(run.labels[best])} instead of {phrase_of(run.labels[reference])}, the "
        f"expected error {' and '.join(parts) or 'is the same at all instants'}. It is smaller at "
        f"{smaller} of {lower.size} instants and larger at {larger} ({on})."
    )


def times(
    sets: Run | Mapping[str, Sequence[float]],
    *,
    horizon: float | None = None,
    forbidden: Iterable[float] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw sets of measurement times on one axis, a row for each; forbidden instants are grey.

    The reference of a run has hollow markers. A new figure grows with the sets, up to 40. Axes
    without room for all names show every second, third, ... name; the label has the distance.

    Parameters
    ----------
    sets : Run or mapping of str to sequence of int or float
        A run, or times by the name of their set, from above to below.
    horizon : int or float, optional
        The last instant T, or time of the clock; by default that of the run, or else the last
        measurement time.
    forbidden : iterable of int or float
        Instants or times that may not be measured, in addition to those of a run. Without a run,
        times that are not whole are shaded halfway to the next given time.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    TypeError
        The sets are neither a run nor times by name.
    """
    check_kind(sets, (Run, Mapping), "sets")
    barred, references, clock = set[float](forbidden), set[str](), None
    if is_of_run := isinstance(sets, Run):
        run, clock = sets, problem_of(sets).clock
        barred.update(_forbidden_times(run))
        sets = run.sets
        references = {*run.names} - {*run.references}
    for name, at in sets.items():
        check_kind(at, (Sequence, np.ndarray), f"sets[{shown(name)}]")
    labels = run.labels if is_of_run else {name: name for name in sets}
    writer = clock or Clock.counting(0)
    rows = [
        (name, f"{labels[name]}, {sensor}" if sensor else labels[name], at)
        for name, measurements in sets.items()
        for sensor, at in writer.by_sensor(measurements).items()
    ]
    if clock is None:
        given = {t for _, _, at in rows for t in at} or {0}
        clock = _clock_of(given | barred, max(given) if horizon is None else horizon)
    ax = axes_for(ax, times_inches(len(rows)))
    size = 1.1 * min(1.0, _MOST_NAMED / max(1, len(rows)))
    styles = styles_of(labels, ())
    if len(references) > 1:  # sets of several numbers of measurements
        styles = {name: set_style(name not in references) for name in sets}
    for row, (name, _, at) in enumerate(rows):
        style = styles[name] | {"ls": "", "label": None}
        if len(rows) <= _MOST_NAMED:
            ax.axhline(row, color=GREY, lw=thin(0.4), zorder=0)
        ax.plot(
            at, [row] * len(at), ms=marker(size), mew=thin(0.8), zorder=3, clip_on=False, **style
        )
    _shade(ax, barred, clock)
    first, last = clock.times[0], clock.times[-1] if horizon is None else horizon
    beside = 0.75 * (last - first) / max(1, clock.horizon) or 0.75
    if not (is_of_run or clock.counts):  # the steps of this clock are those of the given times
        beside = min(beside, _MARGIN * (last - first))
    ax.set_xlim(first - beside, last + beside)
    ax.set_ylim(len(rows) - 0.5, -0.5)  # the first set on top
    inches = ax.get_window_extent().height / ax.figure.dpi
    room = 72 * inches / (_LEADING * 0.875 * rcParams["font.size"])
    step = -(-len(rows) // max(1, int(room)))
    named = [verbatim(label) for _, label, _ in rows]
    ax.set_yticks(range(0, len(rows), step), named[::step])
    if step > 1:
        ax.set_ylabel(f"{len(rows)} sets, 1 of {step} is named")
    ax.tick_params(axis="y", length=0)
    label_instants(ax, clock)
    legend_above(ax, ax.patches[:1])
    return ax


def times_inches(sets: int) -> float:
    """Height of the figure `times`, in which each of up to 40 sets has its name."""
    return height_of_rows(min(sets, _MOST_NAMED), _ROW)


def _forbidden_times(run: Run) -> list[float]:
    """The times at which nothing may be measured."""
    problem = problem_of(run)
    allowed = problem.points.made({*range(problem.points.number)} - {*problem.feasible.forbidden})
    return [time for t, time in enumerate(problem.clock.times) if t not in allowed]


def _clock_of(times: Iterable[float], last: float) -> Clock:
    """The clock of times without a run: whole numbers from 0 on, or only these times."""
    instants = {0, last, *(t for t in times if t <= last)}
    if all(t == int(t) for t in instants):
        return Clock.counting(int(last))
    return Clock(tuple(sorted(map(float, instants))))


def _shade(ax: Axes, forbidden: set[float], clock: Clock) -> None:
    """Shade each stretch of successive forbidden instants, half a step beyond both ends."""
    at = np.array(clock.times, np.float64)
    middles = (at[1:] + at[:-1]) / 2 if at.size > 1 else at + 0.5
    edges = np.concatenate([[2 * at[0] - middles[0]], middles, [2 * at[-1] - middles[-1]]])
    instants = np.flatnonzero([time in forbidden for time in clock.times])
    for stretch in np.split(instants, np.flatnonzero(np.diff(instants) > 1) + 1):
        if stretch.size:
            begin, end = edges[stretch[0]], edges[stretch[-1] + 1]
            ax.axvspan(begin, end, color=GREY, alpha=0.25, lw=0, zorder=-1, label="forbidden")
