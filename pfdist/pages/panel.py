"""Parts that panels share: axes, tables, labels, legends, and axes that outliers do not flatten.

Sizes are those of the style in use.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import compress
from textwrap import wrap
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from matplotlib import dates, rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import Formatter, Locator, MaxNLocator
from numpy.typing import ArrayLike, NDArray

from pfdist.common.component_names import Component, named_component
from pfdist.common.measurement_times import REGULAR
from pfdist.errors import JobError, shown
from pfdist.pages.style import GREY, set_style
from pfdist.problem.calendar import Calendar, calendar_of
from pfdist.problem.clock import Clock
from pfdist.problem.set_key import PLAN
from pfdist.results import Run
from pfdist.results.run import TABLES
from pfdist.results.stored_run import angles_of, provenance_of

T = TypeVar("T")
_dates: Any = dates  # has no types
Array = NDArray[np.float64]
BAND = 1.96  # standard errors in half of a 95 % interval
MOST_COMPONENTS = 6  # components of z that a figure shows, each in a panel
_POINTS = 8  # of the font for which heights are given
_THIN = 0.7  # width of a thin line over that of a line of the style
_LABEL_LINE = 24  # characters of a line of a vertical axis's label
_LEGEND_LETTERS = (14, 24)  # longest label with which a legend has three, and two columns
_SHARE = 0.1  # of all values that may be cut off; one value always may
_STRETCH = 4.0  # values are cut off only if the axis would be so many times longer with them
_MARGIN = 0.08  # room beyond the last value that is shown, over the length of the axis
_LEADING = 1.1  # distance of two names over the size of their font
_MOST_DATES = 7  # on a horizontal axis
_HOURS = (1, 2, 3, 6, 12, 24, 48, 72, 168)  # between two ticks of a clock in hours
_MOST_HOURS = 7.8  # such steps on a horizontal axis
_LABELLED = 2  # of more points beyond the axis, only the farthest has a number


def axes_for(ax: Axes | None, height: float | None = None) -> Axes:
    """The axes to draw into: those given, or those of a new figure of pyplot.

    The height of a new figure is in inches for a font of 8 points; the default is that of the
    style.
    """
    if ax is not None:
        check_kind(ax, (Axes,), "ax")
        return ax
    from matplotlib import pyplot  # noqa: PLC0415  chooses a backend, which files do not need

    figure, axes = pyplot.subplots(layout="constrained")
    if height is not None:
        figure.set_figheight(scaled(height))
    return axes


def table_of(source: object, argument: str, *names: str) -> pd.DataFrame:
    """A DataFrame itself, a table of a run, or an attribute or a method of another object.

    The first of the names that the object has is taken.
    """
    if isinstance(source, pd.DataFrame):
        return source
    if isinstance(source, Run) and names[0] in TABLES:
        table: pd.DataFrame = source.table(names[0])
        table.attrs["error_unit"] = error_unit(source)
        return table
    for name in names:
        attribute = getattr(source, name, None)
        if attribute is not None:
            table = attribute() if callable(attribute) else attribute
            check_kind(table, (pd.DataFrame,), f"{argument}.{name}")
            return table
    wanted = " or ".join(f"`{name}`" for name in names)
    got = type(source).__name__
    raise TypeError(f"{argument} must be a DataFrame, or have the table {wanted}, got {got}")


def check_kind(value: object, kinds: Sequence[type], argument: str) -> None:
    """Raise a `TypeError` unless a value is of one of some types.

    Examples
    --------
    >>> check_kind(5, (pd.DataFrame, Axes), "source")
    Traceback (most recent call last):
        ...
    TypeError: source must be of type DataFrame or Axes, got int
    """
    if not isinstance(value, tuple(kinds)):
        allowed = " or ".join(kind.__name__ for kind in kinds)
        raise TypeError(f"{argument} must be of type {allowed}, got {type(value).__name__}")


def chosen(name: T, among: Collection[T], argument: str) -> T:
    """The name itself; if it is not allowed, a `JobError` lists the allowed names."""
    if name in among:
        return name
    allowed = ", ".join(map(str, among))
    message = f"{argument} must be one of {allowed}, got {shown(name)}"
    raise JobError(message, argument=argument)


def verbatim(name: object) -> str:
    r"""A name as texts of a figure show it letter by letter, also its dollar signs.

    Matplotlib takes text between two dollar signs for a formula.

    Examples
    --------
    >>> verbatim("a$b")
    'a\\$b'
    """
    return str(name).replace("$", r"\$")


def clipped(text: str, letters: int) -> str:
    """The start of a text, with an ellipsis instead of the rest.

    Examples
    --------
    >>> clipped("regular", 7), clipped("regular times", 7)
    ('regular', 'regula…')
    """
    return text if len(text) <= letters else f"{text[: letters - 1]}…"


def scaled(inches: float) -> float:
    """A height for a font of 8 points, scaled to the font of the style in use."""
    return inches * float(rcParams["font.size"]) / _POINTS


def height_of_rows(rows: int, inches: float) -> float:
    """Height of a figure with a row for each set; a row has these inches for a font of 8 points."""
    return 0.9 + inches * max(rows, 3)


def thin(share: float = _THIN) -> float:
    """Width of a thin line in the style in use, in points."""
    return share * float(rcParams["lines.linewidth"])


def marker(share: float = 1.0) -> float:
    """Size of a marker in the style in use, in points."""
    return share * float(rcParams["lines.markersize"])


def minus(text: str) -> str:
    """A text with minus signs instead of hyphens, if the style has them."""
    return Formatter.fix_minus(text)


def legend_above(
    ax: Axes, handles: Sequence[Any] | None = None, *, columns: int = 0, title: str = ""
) -> None:
    """Put the legend above the axes, where it covers no curve.

    The default is three columns, or fewer for long labels, and a handle for each label.
    """
    if handles is None:
        handles = ax.get_legend_handles_labels()[0]
    if handles:
        longest = max(len(str(handle.get_label())) for handle in handles)
        ax.legend(
            handles=handles, title=title or None,
            ncols=columns or 1 + sum(longest <= most for most in _LEGEND_LETTERS),
            loc="lower center", bbox_to_anchor=(0.5, 1.0), borderaxespad=0.3,
        )  # fmt: skip


def label_ends(ax: Axes, ends: Sequence[tuple[float, str, str]]) -> None:
    """Write names of curves beside the right edge, each in its colour near the curve's end.

    Each end has a value of y, a name and a colour. The limits of the axes must not change later.
    """
    ax.autoscale_view()
    inches = ax.get_window_extent().height / ax.figure.dpi
    line = _LEADING * float(rcParams["font.size"]) / 72 / inches
    at = (ax.transData + ax.transAxes.inverted()).transform([(1.0, y) for y, *_ in ends])[:, 1]
    order, level = np.argsort(at, kind="stable"), -math.inf
    levels = np.array([level := max(at[k], level + line) for k in order])
    levels -= np.mean(levels - at[order])  # up and down alike
    for k, height in zip(order, levels, strict=True):
        _, name, color = ends[k]
        ax.text(1.02, height, name, c=color, va="center", transform=ax.transAxes, size="small")


def clock_of_table(table: pd.DataFrame) -> Clock:
    """A clock without instants that writes the times of a table; see its attribute time_unit."""
    unit = table.attrs.get("time_unit", "")
    calendar = calendar_of(unit)
    counts = table["t"].dtype.kind != "f"
    return Clock((), calendar.unit if calendar else unit, counts=counts, calendar=calendar)


def label_instants(ax: Axes, clock: Clock) -> None:
    """Label the horizontal axis as time, with the unit of the clock or dates."""
    calendar, unit = clock.calendar, clock.unit
    if calendar is not None:
        ticks = _DateTicks(calendar)
        ax.xaxis.set_major_locator(ticks)
        ax.xaxis.set_major_formatter(_DateLabels(ticks))
        zone = calendar.start.tzinfo
        ax.set_xlabel(f"date ({verbatim(str(zone))})" if zone else "date")
        return
    ax.set_xlabel(f"time $t$ [{verbatim(unit)}]" if unit else "instant $t$")
    locator = _HourTicks if unit in ("h", "hour", "hours") else MaxNLocator
    ax.xaxis.set_major_locator(locator(integer=clock.counts, steps=[1, 2, 5, 10]))


class _HourTicks(MaxNLocator):
    """Ticks of hours at parts of days, or at days: 0, 6, 12, 18, 24."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        fits = [step for step in _HOURS if 4 <= (vmax - vmin) / step < _MOST_HOURS]
        if not fits:
            return super().tick_values(vmin, vmax)
        step = fits[0]
        return [step * k for k in range(math.ceil(vmin / step), math.floor(vmax / step) + 1)]


class _DateTicks(Locator):
    """Ticks at round dates on an axis of times that count a unit from a start."""

    def __init__(self, calendar: Calendar) -> None:
        self.calendar = calendar
        self.dates = _dates.AutoDateLocator(calendar.start.tzinfo, minticks=3, maxticks=_MOST_DATES)

    def __call__(self) -> Sequence[float]:
        axis: Any = self.axis
        return self.tick_values(*axis.get_view_interval())

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        found = self.dates.tick_values(*map(self.calendar.date, sorted((vmin, vmax))))
        return [self.calendar.time(each) for each in _dates.num2date(found)]


class _DateLabels(Formatter):
    """Labels of such ticks, with what they share beside the axis."""

    def __init__(self, ticks: _DateTicks) -> None:
        zone = ticks.calendar.start.tzinfo
        self.ticks, self.labels = ticks, _dates.ConciseDateFormatter(ticks.dates, zone)

    def __call__(self, x: float, pos: int | None = None) -> str:
        return self.ticks.calendar.written(x)

    def format_ticks(self, values: Sequence[float]) -> list[str]:
        at = [_dates.date2num(self.ticks.calendar.date(x)) for x in values]
        return list(self.labels.format_ticks(at))

    def get_offset(self) -> str:
        return str(self.labels.get_offset())


def label_times(ax: Axes, table: pd.DataFrame) -> None:
    """Label the horizontal axis as the column t of a table: instants, or times on a clock."""
    label_instants(ax, clock_of_table(table))


def label_quantity(
    ax: Axes, quantities: Sequence[Component], number: int, what: str = "{}"
) -> None:
    """Label the vertical axis as a component of z, by its name and unit if the model has them.

    The text `what` is the label, with braces for the component. The axis does not go below 0 if no
    value does. Call it after all curves are drawn.
    """
    symbol = "$z$" if len(quantities) == 1 else f"$z_{{{number}}}$"
    text = what.format(verbatim(quantities[number].label) or symbol)
    if ax.dataLim.y0 >= 0 > ax.get_ylim()[0]:  # a share or a concentration
        ax.set_ylim(bottom=0)
    ax.set_ylabel("\n".join(wrap(text, _LABEL_LINE)))


def label_error(ax: Axes, table: pd.DataFrame, what: str = "expected MSE") -> None:
    """Label the vertical axis as a mean squared error, with its unit if there is one."""
    unit = table.attrs.get("error_unit", "")
    ax.set_ylabel("\n".join(wrap(what, _LABEL_LINE)) + (f" [{verbatim(unit)}²]" if unit else ""))


def error_unit(run: Run) -> str:
    """The unit of the root of an error, in brackets unless it is a word.

    It is empty if z has no unit or several, or if errors are not squares, or are weighted or
    scaled.
    """
    names = provenance_of(run)["names"]["z"]
    units, angles = {named_component(name).unit for name in names}, angles_of(run)
    if len(units) != 1 or not angles or any(angles):
        return ""
    [unit] = units
    return unit if unit.isalpha() or not unit else f"({unit})"


def step_of(times: Iterable[float]) -> float:
    """The least difference of two times; 1 for instants, which are whole numbers."""
    different = np.unique(np.asarray(list(times)))
    if different.dtype.kind != "f" or different.size < 2:
        return 1.0
    return float(np.diff(different).min())


def styles_of(
    source: pd.DataFrame | Collection[str], names: Iterable[str]
) -> dict[str, dict[str, Any]]:
    """The style of each set by name, with its label; it is the same in all figures of a run.

    The source is a table of the run, or the labels or names of its sets. The evenly spaced times,
    or else the first set, have the style of a reference, and the plan has the next style. Names
    that are not sets of the run come last.
    """
    sets = source.attrs.get("sets", ()) if isinstance(source, pd.DataFrame) else source
    labels = sets if isinstance(sets, Mapping) else {}
    places = dict.fromkeys([*sets, *names])
    first = REGULAR if REGULAR in places else next(iter(places), "")
    order = sorted(places, key=lambda name: (name != first, labels.get(name) != PLAN))
    return {
        name: set_style(place) | {"label": verbatim(labels.get(name, name))}
        for place, name in enumerate(order)
    }


def rows_with_results(
    table: pd.DataFrame, names: Sequence[str]
) -> list[tuple[str, pd.DataFrame, dict[str, Any]]]:
    """The name, the rows in order of time and the style of each set of a table; by default of all.

    A table without a column name has one set, whose name is empty. An empty table has no set. A
    single name may be a str.
    """
    check_kind(names, (Sequence,), "names")
    names = [names] if isinstance(names, str) else names
    if table.empty:
        return []
    if "name" not in table:
        return [("", table.sort_values("t"), set_style(1) | {"label": None})]
    every = list(dict.fromkeys(map(str, table["name"])))
    drawn = [chosen(name, every, "names") for name in names] or every
    styles = styles_of(table, drawn)
    return [(name, table[table["name"] == name].sort_values("t"), styles[name]) for name in drawn]


def name_row(ax: Axes, level: float, name: str, *, share: bool = False, color: str = GREY) -> None:
    """Write the name of a row beside the axes, at a value of y or at a share of the height."""
    transform = ax.transAxes if share else ax.get_yaxis_transform()
    ax.text(1.01, level, name, transform=transform, color=color, va="center", fontsize="x-small")


def write_instead(ax: Axes, text: str) -> Axes:
    """Write a sentence where there is nothing to draw."""
    ax.set_axis_off()
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes, wrap=True)
    return ax


def stack(panels: Sequence[Axes], components: int = 0) -> None:
    """Remove labels and entries of legends that another of some panels with one axis has.

    If there are more components of z than panels, the last label has the number that is left out.
    """
    said = set[str]()
    for ax in panels:
        legend, (handles, labels) = ax.get_legend(), ax.get_legend_handles_labels()
        if legend is not None and said.intersection(labels):
            legend.remove()
            new = (label not in said for label in labels)
            legend_above(ax, list(compress(handles, new)))
        said.update(labels)
    for ax in panels[:-1]:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)
    if components > len(panels):
        left_out = components - len(panels)
        panels[-1].set_xlabel(f"{panels[-1].get_xlabel()}; {left_out} more components are left out")


class CurvePoints(NamedTuple):
    """The points of a curve, as arrows at the edge of the axes would show them, (n,)."""

    x: Array
    y: Array
    colour: str
    name: str


def points(x: ArrayLike, y: ArrayLike, colour: str, name: str) -> CurvePoints:
    """The points of a curve that have a value, which may be infinite. The name is verbatim."""
    at, values = np.asarray(x, np.float64), np.asarray(y, np.float64)
    present = ~np.isnan(values)
    return CurvePoints(at[present], values[present], colour, name)


def cut_outliers(
    ax: Axes, curves: Sequence[CurvePoints], keep: Iterable[float] = (), *, zero: bool = False
) -> None:
    """Limit the vertical axis if outliers flatten it; arrows show where the outliers are.

    Call it after all curves are drawn, and before the legend, because arrows have labels. The
    values in `keep` are shown. With `zero`, the axis begins at 0.
    """
    limits = shown_range(np.concatenate([curve.y for curve in curves] or [np.zeros(0)]))
    if zero:
        ax.set_ylim(bottom=0)
    if limits is None:
        return
    must = [value for value in (*keep, *([0.0] if zero else [])) if math.isfinite(value)]
    low, high = min([limits[0], *must]), max([limits[1], *must])
    room = _MARGIN * (high - low or 1.0)
    ax.set_ylim(0.0 if zero else low - room, high + room)
    for curve in curves:
        _mark_beyond(ax, curve, curve.y > high, 1.0, "^")
        _mark_beyond(ax, curve, curve.y < low, 0.0, "v")


def shown_range(values: Array) -> tuple[float, float] | None:
    """The least and the largest value to show; None if no value need be cut off.

    Up to a tenth of the values, those farthest from the median, are cut off if the axis would
    otherwise be four times as long; as few as possible. Infinite values are always cut off.

    Examples
    --------
    >>> shown_range(np.array([2.0, 3.0, 5.0, 400.0]))
    (2.0, 5.0)
    >>> shown_range(np.array([2.0, 3.0, 5.0, 12.0]))
    """
    finite = values[np.isfinite(values)]
    if finite.size < 2:
        return None
    ordered = finite[np.argsort(np.abs(finite - np.median(finite)), kind="stable")]
    for count in range(1, max(1, int(_SHARE * finite.size)) + 1):
        rest = ordered[:-count]
        if 0 < np.ptp(rest) * _STRETCH < np.ptp(ordered):
            return float(rest.min()), float(rest.max())
    is_infinite = finite.size < values.size
    return (float(finite.min()), float(finite.max())) if is_infinite else None


def number(value: float) -> str:
    r"""A number with three digits, as a text of a figure.

    Examples
    --------
    >>> number(1234.5), number(0.01234), number(1.2e7), number(np.inf)
    ('1,234', '0.0123', '$1.2\\times 10^{7}$', '∞')
    """
    if math.isinf(value):
        return minus("-∞" if value < 0 else "∞")
    if 1e-3 <= abs(value) < 1e5 or value == 0.0:
        return minus(f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}")
    mantissa, _, exponent = f"{value:.2g}".partition("e")
    return minus(rf"${mantissa}\times 10^{{{int(exponent)}}}$")


def _mark_beyond(
    ax: Axes, curve: CurvePoints, beyond: NDArray[np.bool_], edge: float, shape: str
) -> None:
    """Draw an arrow at the edge for each point beyond it; labels have the numbers."""
    if not beyond.any():
        return
    farthest = sorted(curve.y[beyond].tolist(), key=abs, reverse=True)
    text = " and ".join(map(number, farthest))
    if len(farthest) > _LABELLED:
        text = f"{len(farthest)} {'up' if edge else 'down'} to {number(farthest[0])}"
    ax.plot(
        curve.x[beyond], np.full(len(farthest), edge), shape, color=curve.colour, ms=marker(),
        mfc=curve.colour, transform=ax.get_xaxis_transform(), clip_on=False, zorder=5,
        label=f"{curve.name}, off the axis: {text}" if curve.name else text,
    )  # fmt: skip
