"""The measurement times of sets on one axis."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes

from pfdist.errors import shown
from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    axes_for,
    check_kind,
    height_of_rows,
    label_instants,
    legend_above,
    marker,
    styles_of,
    thin,
    verbatim,
)
from pfdist.pages.style import GREY, set_style
from pfdist.problem.clock import Clock
from pfdist.results import Run
from pfdist.results.stored_run import problem_of

_ROW = 0.17  # inches
_MOST_NAMED = 40  # rows up to which a new figure grows, so that each has its name and its line
_MARGIN = 0.03  # part of the axis beside times that are not whole
_LEADING = 1.25  # distance of two names over the size of their font


@figure("times")
def times_figure(tables: Tables) -> Plot:
    """Measurement times of every set."""
    sets, clock = tables.run.sets, problem_of(tables.run).clock
    rows = times_inches(sum(len(clock.by_sensor(at)) for at in sets.values()))
    numbers = sorted({len(times) for times in sets.values()})
    each = f"{numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"{numbers[0]}"
    title = f"Measurement times of {len(sets)} sets, with {each} measurements each."
    return Plot(rows, lambda panels: times(tables.run, ax=panels[0]), title=title)


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
        barred.update(forbidden_times(run))
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
    shade(ax, barred, clock)
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


def forbidden_times(run: Run) -> list[float]:
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


def shade(ax: Axes, forbidden: set[float], clock: Clock) -> None:
    """Shade each stretch of successive forbidden instants, half a step beyond both ends."""
    at = np.array(clock.times, np.float64)
    middles = (at[1:] + at[:-1]) / 2 if at.size > 1 else at + 0.5
    edges = np.concatenate([[2 * at[0] - middles[0]], middles, [2 * at[-1] - middles[-1]]])
    instants = np.flatnonzero([time in forbidden for time in clock.times])
    for stretch in np.split(instants, np.flatnonzero(np.diff(instants) > 1) + 1):
        if stretch.size:
            begin, end = edges[stretch[0]], edges[stretch[-1] + 1]
            ax.axvspan(begin, end, color=GREY, alpha=0.25, lw=0, zorder=-1, label="forbidden")
