"""Sets of measurement times on one axis, a row for each, and the instants that are forbidden."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties

from pfdist.analysis import Run
from pfdist.analysis.reference import label
from pfdist.errors import shown
from pfdist.plots.figure import Plot, Tables, figure
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    label_instants,
    legend_above,
    marker,
    thin,
    verbatim,
)
from pfdist.plots.style import GREY, set_style
from pfdist.times.clock import Clock

_AXIS_INCHES = 0.9  # height of all but the rows
_ROW_INCHES, _SMALL_ROW_INCHES = 0.2, 0.13  # heights of the first rows, and of the others
_MOST_LARGE = 15  # first rows
_MOST_NAMED = 40  # rows up to which a new figure grows, so that each has its name and its line
_MOST_IN_TITLE = 3  # sets that the title names
_MARGIN = 0.03  # part of the axis beside times that are not whole
_LEADING = 1.25  # distance of two names over the size of their font


@figure("times")
def times_figure(tables: Tables) -> Plot:
    """Measurement times of every compared set, and the instants that are forbidden."""
    run = tables.run
    return Plot(_height(len(run.names)), lambda panels: times(run, ax=panels[0]), title=_title(run))


def _height(rows: int) -> float:
    """Give the height of a figure in which each of up to 40 rows has its name."""
    large = min(rows, _MOST_LARGE)
    small = min(rows, _MOST_NAMED) - large
    return _AXIS_INCHES + _ROW_INCHES * large + _SMALL_ROW_INCHES * small


def _title(run: Run) -> str:
    """Say how many instants each compared set shares with the reference."""
    if run.has_budget:
        numbers = sorted({len(chosen) for chosen in run.sets().values()})
        return f"Regular times and found times, from {numbers[0]} to {numbers[-1]} measurements."
    (reference, first), *others = run.sets().items()
    shared = {name: len({*chosen} & {*first}) for name, chosen in others}
    what = "other times" if run.named else "found times"
    if len(shared) > _MOST_IN_TITLE:
        least, most = min(shared.values()), max(shared.values())
        return (
            f"{what.capitalize()} share {least} to {most} of their instants with "
            f"{label(reference)}."
        )
    parts = [f"{name} {shared[name]} of {len(chosen)}" for name, chosen in others]
    return f"Instants that {what} share with {label(reference)}: {', '.join(parts)}."


def times(
    sets: Run | Mapping[str, Sequence[float]],
    *,
    horizon: float | None = None,
    forbidden: Iterable[float] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw sets of measurement times on one axis, a row for each; forbidden instants are grey.

    The reference of a run has hollow markers. A new figure grows with the sets, up to 40. Axes
    without room for all names show every second, third, ... name, and say so.

    Parameters
    ----------
    sets : Run or mapping of str to sequence of int or float
        A run, or times by the name of their set, from above to below.
    horizon : int or float, optional
        The last instant T, or time of the clock; by default that of the run, or else the last
        measurement time.
    forbidden : iterable of int or float
        Instants or times that may not be measured; a run adds its own. Without a run, times that
        are not whole are shaded halfway to the next given time.
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
        run, problem = sets, sets.problem
        clock = problem.clock
        barred.update(clock.times_of(problem.feasible.forbidden))
        sets = run.sets()
        references = {*run.names} - {*run.references}
    for name, chosen in sets.items():
        check_kind(chosen, (Sequence, np.ndarray), f"sets[{shown(name)}]")
    if clock is None:
        given = {t for chosen in sets.values() for t in chosen} or {0}
        clock = _clock_of(given | barred, max(given) if horizon is None else horizon)
    ax = axes_for(ax, _height(len(sets)))
    size = (_height(len(sets)) - _AXIS_INCHES) / (_ROW_INCHES * max(1, len(sets)))
    for row, (name, chosen) in enumerate(sets.items()):
        style = set_style(0 if name in references else 1) | {"ls": ""}
        if len(sets) <= _MOST_NAMED:
            ax.axhline(row, color=GREY, lw=thin(0.4), zorder=0)
        at = list(chosen)
        ax.plot(at, [row] * len(at), ms=marker(1.2 * size), mew=thin(0.8 * size), zorder=3, **style)
    _shade(ax, barred, clock)
    first, last = clock.times[0], clock.times[-1] if horizon is None else horizon
    beside = 0.75 * (last - first) / max(1, clock.horizon) or 0.75
    if not (is_of_run or clock.counts):  # the steps of this clock are those of the given times
        beside = min(beside, _MARGIN * (last - first))
    ax.set_xlim(first - beside, last + beside)
    ax.set_ylim(len(sets) - 0.5, -0.5)  # the first set on top
    step = max(1, -(-len(sets) // _room_for_names(ax)))
    names = list(map(verbatim, sets))[::step]
    ax.set_yticks(range(0, len(sets), step), names)
    if step > 1:
        ax.set_ylabel(f"{len(sets)} sets, 1 of {step} is named")
    ax.tick_params(axis="y", length=0)
    label_instants(ax, clock.unit, whole=clock.counts)
    if barred:
        legend_above(ax, ax.patches[:1])
    return ax


def _clock_of(times: Iterable[float], last: float) -> Clock:
    """Give the clock of times without a run: whole numbers from 0 on, or else the times alone."""
    instants = {0, last, *(t for t in times if t <= last)}
    if all(t == int(t) for t in instants):
        return Clock.counting(int(last))
    return Clock(tuple(sorted(map(float, instants))))


def _room_for_names(ax: Axes) -> int:
    """Give the number of names that have room on the vertical axis, one below another."""
    points = FontProperties(size=rcParams["ytick.labelsize"]).get_size_in_points()
    figure = ax.get_figure(root=True)
    inches = ax.get_window_extent().height / figure.dpi if figure else 0.0
    return max(1, int(72 * inches / (_LEADING * points)))


def _shade(ax: Axes, forbidden: Iterable[float], clock: Clock) -> None:
    """Shade each stretch of successive forbidden instants, half a step beyond both ends."""
    known = set(forbidden)
    instants = np.array([t for t, time in enumerate(clock.times) if time in known], np.int64)
    times = np.array(clock.times)
    steps = np.diff(times) if times.size > 1 else np.ones(1)
    before, after = np.append(steps[:1], steps) / 2, np.append(steps, steps[-1:]) / 2
    for stretch in np.split(instants, np.flatnonzero(np.diff(instants) > 1) + 1):
        if stretch.size:
            first, last = stretch[0], stretch[-1]
            ax.axvspan(
                times[first] - before[first], times[last] + after[last], color=GREY, alpha=0.25,
                lw=0, zorder=-1, label="forbidden",
            )  # fmt: skip
