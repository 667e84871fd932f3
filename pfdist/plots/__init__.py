"""The figures of a run, one a file: from tables to axes. Figures read tables alone.

The functions `belief`, `bound`, `budget`, `comparison`, `cost`, `degenerate_draws`,
`effective_sample_size`, `error_profile`, `gain`, `one_draw`, `online_gain`, `online_raster`,
`online_shares`, `sampling_windows`, `shifts`, `times` and `worth` each draw one panel: of a run, or
of tables, into ``ax``, or into a new figure of pyplot. They return the axes. So do `against`,
`heat_map` and `found_times`, which draw a table of many runs.
``plt.style.use("pfdist.plots.print")`` gives the look of printed figures, and
``pfdist.plots.screen`` that of figures on a screen.
"""

from pfdist.plots import library  # noqa: F401  first: it decides how Matplotlib is imported
from pfdist.plots.bounds import bound
from pfdist.plots.budget_curve import budget, draw_target
from pfdist.plots.compared import comparison
from pfdist.plots.costs import cost
from pfdist.plots.draws import one_draw
from pfdist.plots.error_over_time import degenerate_draws, effective_sample_size, error_profile
from pfdist.plots.figures import draw_figures, figure_files, remove_figures
from pfdist.plots.filtered import belief, check_figure_replaceable, draw_filtered, filtered_plot
from pfdist.plots.gain_histogram import gain
from pfdist.plots.measured_online import online_raster, online_shares
from pfdist.plots.measurements import shifts, worth
from pfdist.plots.online_histogram import online_gain
from pfdist.plots.sampling_windows import sampling_windows
from pfdist.plots.study_lines import against
from pfdist.plots.study_map import heat_map
from pfdist.plots.study_times import found_times
from pfdist.plots.times_axis import times

__all__ = [
    "against",
    "belief",
    "bound",
    "budget",
    "check_figure_replaceable",
    "comparison",
    "cost",
    "degenerate_draws",
    "draw_figures",
    "draw_filtered",
    "draw_target",
    "effective_sample_size",
    "error_profile",
    "figure_files",
    "filtered_plot",
    "found_times",
    "gain",
    "heat_map",
    "one_draw",
    "online_gain",
    "online_raster",
    "online_shares",
    "remove_figures",
    "sampling_windows",
    "shifts",
    "times",
    "worth",
]
