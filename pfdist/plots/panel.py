"""Parts that panels share: axes, tables, legends, and sizes that the style gives."""

from collections.abc import Collection, Sequence
from textwrap import wrap
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.ticker import Formatter, MaxNLocator

from pfdist.common.component_names import Component
from pfdist.errors import JobError, shown
from pfdist.plots.style import GREY

T = TypeVar("T")
_POINTS = 8  # of the font for which heights are given
_THIN = 0.7  # width of a thin line over that of a line of the style
_LABEL_LINE = 24  # characters of a line of a vertical axis's label


def axes_for(ax: Axes | None, height: float | None = None) -> Axes:
    """Give the axes to draw into: those given, or those of a new figure of pyplot.

    Parameters
    ----------
    ax : matplotlib Axes or None
    height : float, optional
        Height of a new figure, in inches where the style has 8 points; by default the style's own.

    Raises
    ------
    TypeError
        These are no axes, for instance an array of axes.
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
    """Give a table: the DataFrame itself, or the table that an object has.

    Parameters
    ----------
    source : DataFrame or object
    argument : str
        Name of the argument, for errors.
    *names : str
        The first of these attributes that the object has is the table, or a method that reads it.

    Raises
    ------
    TypeError
        The object has none of these attributes, or the attribute is no table.
    """
    if isinstance(source, pd.DataFrame):
        return source
    for name in names:
        found = getattr(source, name, None)
        if found is not None:
            table: pd.DataFrame = found() if callable(found) else found
            check_kind(table, (pd.DataFrame,), f"{argument}.{name}")
            return table
    wanted = " or ".join(f"`{name}`" for name in names)
    got = type(source).__name__
    raise TypeError(f"{argument} must be a DataFrame, or have the table {wanted}, got {got}")


def check_kind(value: object, kinds: Sequence[type], argument: str) -> None:
    """Raise an error unless a value is of one of some types.

    Raises
    ------
    TypeError

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


def verbatim(name: object) -> str:
    r"""Give a name as texts of a figure show it letter by letter, also its dollar signs.

    Matplotlib takes text between two dollar signs for a formula.

    Examples
    --------
    >>> verbatim("a$b")
    'a\\$b'
    """
    return str(name).replace("$", r"\$")


def clipped(text: str, letters: int) -> str:
    """Give the start of a text, with an ellipsis in the place of the rest.

    Examples
    --------
    >>> clipped("regular", 7), clipped("regular times", 7)
    ('regular', 'regula…')
    """
    return text if len(text) <= letters else f"{text[: letters - 1]}…"


def chosen(name: T, among: Collection[T], argument: str) -> T:
    """Give back a name, if it is among some names.

    Raises
    ------
    JobError
        It is not.
    """
    if name in among:
        return name
    allowed = ", ".join(map(str, among))
    message = f"{argument} must be one of {allowed}, got {shown(name)}"
    raise JobError(message, argument=argument)


def scaled(inches: float) -> float:
    """Scale a height for a font of 8 points to the font of the style in use."""
    return inches * float(rcParams["font.size"]) / _POINTS


def thin(share: float = _THIN) -> float:
    """Width of a thin line in the style in use, in points."""
    return share * float(rcParams["lines.linewidth"])


def marker(share: float = 1.0) -> float:
    """Size of a marker in the style in use, in points."""
    return share * float(rcParams["lines.markersize"])


def minus(text: str) -> str:
    """Give a text with true minus signs in the place of hyphens, if the style has them."""
    return Formatter.fix_minus(text)


def legend_above(
    ax: Axes, handles: Sequence[Any] | None = None, *, columns: int = 2, title: str = ""
) -> None:
    """Put the legend above the axes, where it covers no curve.

    Parameters
    ----------
    ax : matplotlib Axes
    handles : sequence of artists, optional
        By default everything that has a label.
    columns : int
    title : str
    """
    given: dict[str, Any] = {} if handles is None else {"handles": handles}
    if handles is None and not ax.get_legend_handles_labels()[0]:
        return
    ax.legend(
        **given, ncols=columns, title=title or None, loc="lower center", bbox_to_anchor=(0.5, 1.0),
        borderaxespad=0.3,
    )  # fmt: skip


def label_instants(ax: Axes, unit: str = "", *, whole: bool = True) -> None:
    """Label the horizontal axis as time.

    Parameters
    ----------
    ax : matplotlib Axes
    unit : str
        The unit of the clock.
    whole : bool
        Whether the axis has whole numbers alone, because it counts instants.
    """
    ax.set_xlabel(f"$t$ [{verbatim(unit)}]" if unit else "$t$")
    ax.xaxis.set_major_locator(MaxNLocator(integer=whole, steps=[1, 2, 5, 10]))


def label_times(ax: Axes, table: pd.DataFrame) -> None:
    """Label the horizontal axis as the column t of a table: instants, or times on a clock."""
    label_instants(ax, table.attrs.get("time_unit", ""), whole=table["t"].dtype.kind != "f")


def label_quantity(ax: Axes, quantities: Sequence[Component], number: int) -> None:
    """Label the vertical axis as a component of z: by its name and unit, if the model has them."""
    label = quantities[number].label
    if label:
        ax.set_ylabel(verbatim("\n".join(wrap(label, _LABEL_LINE))))
    else:
        ax.set_ylabel("$z$" if len(quantities) == 1 else f"$z_{{{number}}}$")


def step_of(table: pd.DataFrame) -> float:
    """Give the least difference of two times in the column t of a table; 1 for instants."""
    if table["t"].dtype.kind != "f":
        return 1.0
    differences = np.diff(np.unique(table["t"].to_numpy()))
    return float(differences.min()) if differences.size else 1.0


def draw_zero(ax: Axes) -> None:
    """Draw a thin line at 0."""
    ax.axhline(0.0, color=GREY, lw=thin(0.6), zorder=0)


def write_instead(ax: Axes, text: str) -> Axes:
    """Write a sentence where there is nothing to draw."""
    ax.set_axis_off()
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes, wrap=True)
    return ax


def stack(panels: Sequence[Axes]) -> None:
    """Let panels with one horizontal axis share its labels and the legend of the first."""
    for ax in panels[1:]:
        legend = ax.get_legend()
        if legend is not None:
            legend.remove()
    for ax in panels[:-1]:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)
