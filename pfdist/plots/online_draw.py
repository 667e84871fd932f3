"""One draw that is measured at times chosen one after another, and at the times of the plan."""

import numpy as np
import pandas as pd

from pfdist.analysis import relative_gain
from pfdist.plots.draws import no_draw, plot_of, title_of, typical_draw
from pfdist.plots.figure import Plot, Tables, figure, has_online
from pfdist.plots.panel import (
    minus,
    verbatim,
)
from pfdist.store.schema import components_in


@figure("online_draw", applies=has_online)
def online_draw_figure(tables: Tables) -> Plot:
    """Truth, estimates and times of the draw with the median gain of online times over the plan."""
    draws, trajectories = tables.online, tables.trajectories
    rows = draws.rows[draws.rows["estimate"].notna()].set_index("draw")
    rows = rows[rows.index.isin(trajectories["draw"])]
    plan, online = (rows[f"mse_{name}"].to_numpy() for name in (draws.plan, "online"))
    gains = pd.Series(relative_gain(online, plan), index=rows.index).dropna()
    if gains.empty:
        return no_draw()
    draw = typical_draw(gains)
    sets = {draws.plan: list(draws.planned_times), "online": list(rows["measurement_times"][draw])}
    trajectory = with_online(trajectories[trajectories["draw"] == draw], rows["estimate"][draw])
    gain = float(gains[draw])
    over = f"relative gain over {verbatim(draws.plan)}"
    told = minus(f"draw {draw}, {over} {100 * gain:.1f} %, the median")
    title = title_of(gain, "online times", f"the times of {draws.plan}")
    return plot_of(trajectory, sets, told, title)


def with_online(trajectory: pd.DataFrame, estimate: np.ndarray) -> pd.DataFrame:
    """Add the estimate with the online times to the trajectory of a draw.

    Parameters
    ----------
    trajectory : DataFrame
        Rows of one draw in the table ``trajectories``.
    estimate : array of float64, ((T+1) q,)
        As in the table ``online``.
    """
    quantities = components_in(trajectory, "z_")
    estimates = np.reshape(estimate, (-1, len(quantities)))
    columns = {
        f"estimate_online_{quantity.suffix}": estimates[:, k]
        for k, quantity in enumerate(quantities)
    }
    return trajectory.sort_values("t").assign(**columns)
