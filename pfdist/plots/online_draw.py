"""One draw that is measured at times chosen one after another, and at the times of the plan."""

from functools import partial

import numpy as np
import pandas as pd

from pfdist.analysis import relative_gain
from pfdist.plots.figure import Plot, Tables, figure, has_online, write_instead
from pfdist.plots.one_draw import MOST_COMPONENTS, components, plot_one_draw, typical_draw


@figure("online_draw", applies=has_online)
def online_draw_figure(tables: Tables) -> Plot:
    """Truth, estimates and times of the draw with the median gain of online times over the plan."""
    draws, trajectories = tables.online, tables.trajectories
    rows = draws.rows[draws.rows["estimate"].notna()].set_index("draw")
    rows = rows[rows.index.isin(trajectories["draw"])]
    plan, online = (rows[f"mse_{name}"].to_numpy() for name in (draws.plan, "online"))
    gains = pd.Series(relative_gain(online, plan), index=rows.index).dropna()
    if gains.empty:
        told = "no draw with a trajectory has a gain"
        return Plot(2.6, lambda panels: write_instead(panels[0], told))
    draw = typical_draw(gains)
    times = {draws.plan: list(draws.planned_times), "online": list(rows["measurement_times"][draw])}
    trajectory = with_online(trajectories[trajectories["draw"] == draw], rows["estimate"][draw])
    number = min(components(trajectory), MOST_COMPONENTS)
    gain, over = float(gains[draw]), f" over {draws.plan}"
    return Plot(
        1.2 + 1.4 * number,
        partial(plot_one_draw, trajectory=trajectory, times=times, gain=gain, over=over),
        number,
    )


def with_online(trajectory: pd.DataFrame, estimate: np.ndarray) -> pd.DataFrame:
    """Add the estimate with the online times to the trajectory of a draw.

    Parameters
    ----------
    trajectory : DataFrame
        Rows of one draw in the table ``trajectories``.
    estimate : array of float64, ((T+1) q,)
        As in the table ``online``.
    """
    number = components(trajectory)
    estimates = np.reshape(estimate, (-1, number))
    columns = {f"estimate_online_{k}": estimates[:, k] for k in range(number)}
    return trajectory.sort_values("t").assign(**columns)
