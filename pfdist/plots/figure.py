"""Figures of a run. Each is one file of `pfdist.plots` and declares itself."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from pfdist.analysis import ComparisonStatistics, Run
from pfdist.analysis.online import OnlineDraws, online_draws
from pfdist.common.registry import Registry

Applies = Callable[[Run], bool]


@dataclass(frozen=True)
class Plot:
    """The size of a figure, and what draws it.

    Parameters
    ----------
    height : float
        In inches where the style has 8 points; the style gives the width, and other fonts scale the
        height.
    draw : callable
        Draws into the panels, from above to below.
    panels : int
        Number of panels.
    share_x : bool
        Whether the panels share one horizontal axis.
    title : str
        One sentence that says what to see in the data. It is not drawn; reports show it beside the
        figure, and files hold it as their title.
    """

    height: float
    draw: Callable[[Sequence[Axes]], Any]
    panels: int = 1
    share_x: bool = False
    title: str = ""


class Tables:
    """A run, and the tables of it that several figures need, each read once.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self.run = run

    @cached_property
    def statistics(self) -> ComparisonStatistics:
        """Statistics of the comparison."""
        return self.run.statistics()

    @cached_property
    def trajectories(self) -> pd.DataFrame:
        """Truth, measurements and estimates of the first draws."""
        return self.run.trajectories()

    @cached_property
    def gains_of_trajectories(self) -> pd.DataFrame:
        """Relative gains of the draws that have trajectories, by draw."""
        draws = int(self.trajectories["draw"].max()) + 1
        return self.run.gains(draws=draws).set_index("draw")

    @cached_property
    def online(self) -> OnlineDraws:
        """The draws whose times were chosen one after another."""
        return online_draws(self.run)


@dataclass(frozen=True)
class Figure:
    """A figure that a run can have.

    Parameters
    ----------
    name : str
        File name without suffix; with ``each_set`` the first part of it.
    description : str
        The figure in one line: what it shows of any run. Reports take it as alternative text.
    plot : callable
        Gives the plot of `Tables`; with ``each_set`` of `Tables` and the name of a set.
    applies : callable
        Says whether a run has the figure.
    each_set : bool
        Whether there is a file ``<name>-<set>`` for each compared set but the reference.
    """

    name: str
    description: str
    plot: Callable[..., Plot]
    applies: Applies
    each_set: bool = False

    def files(self, run: Run) -> list[str]:
        """Give the names of the figure's files of a run, without suffix."""
        return list(self._arguments(run))

    def plots(self, tables: Tables) -> Iterator[tuple[str, Plot]]:
        """Give the name of each file, without suffix, and the plot in it."""
        for file, arguments in self._arguments(tables.run).items():
            yield file, self.plot(tables, *arguments)

    def _arguments(self, run: Run) -> dict[str, tuple[str, ...]]:
        """Arguments of ``plot``, beside the tables, by the name of the file."""
        if not self.applies(run):
            return {}
        if self.each_set:
            return {f"{self.name}-{name}": (name,) for name in run.names[1:]}
        return {self.name: ()}


FIGURES: Registry[Figure] = Registry("pfdist.plots")


def every_run(run: Run) -> bool:
    """Whether a run has a figure that all runs have."""
    return True


def one_number(run: Run) -> bool:
    """Whether the found sets of a run have one number of measurements."""
    return not run.has_budget


def several_numbers(run: Run) -> bool:
    """Whether a run has found sets of several numbers of measurements."""
    return run.has_budget


def has_online(run: Run) -> bool:
    """Whether a run has times that were chosen one after another."""
    return run.has("online")


def figure(
    name: str, *, applies: Applies = every_run, each_set: bool = False
) -> Callable[[Callable[..., Plot]], Callable[..., Plot]]:
    """Declare a function as a figure; the first line of the docstring describes the figure.

    Parameters
    ----------
    name : str
        File name without suffix; with ``each_set`` the first part of it.
    applies : callable
        Says whether a run has the figure.
    each_set : bool
        Whether there is a file ``<name>-<set>`` for each compared set but the reference. The
        function is then called with the name of a set, too.
    """

    def declare(plot: Callable[..., Plot]) -> Callable[..., Plot]:
        description = (plot.__doc__ or "").partition("\n")[0]
        FIGURES.declare(name, Figure(name, description, plot, applies, each_set))
        return plot

    return declare
