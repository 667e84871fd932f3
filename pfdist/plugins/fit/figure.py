"""The profile of a fitted parameter."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.panel import (
    axes_for,
    chosen,
    marker,
    table_of,
    thin,
    verbatim,
)
from pfdist.pages.style import BLUE, GREY

_IN_INTERVAL = 1.92  # half of the 95 % quantile of chi-squared with 1 degree of freedom


def likelihood_profile(
    profile: pd.DataFrame | Any, parameter: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the profile of a fitted parameter: the log-likelihood below its maximum.

    At each value, the other parameters have their best values. The 95 % interval is where the
    profile lies above the dotted line, at -1.92.

    Parameters
    ----------
    profile : DataFrame, or result of `pfdist.fit`
        The table ``profile`` of a result.
    parameter : str, optional
        By default the first.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    table = table_of(profile, "profile", "profile")
    names = [*dict.fromkeys(table["parameter"])]
    parameter = chosen(parameter or names[0], names, "parameter")
    rows = table[table["parameter"] == parameter]
    ax = axes_for(ax)
    ax.plot(rows[parameter], -rows["below"], "o-", color=BLUE, lw=thin(), ms=marker(0.6))
    ax.axhline(-_IN_INTERVAL, color=GREY, ls=":", lw=thin())
    ax.set_xlabel(verbatim(parameter))
    ax.set_ylabel("log-likelihood - maximum")
    return ax
