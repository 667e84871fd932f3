"""`pfdist.plots`: functions that draw one panel, from tables to axes.

The functions `belief`, `bound`, `budget`, `comparison`, `degenerate_draws`,
`effective_sample_size`, `error_profile`, `gain`, `likelihood_profile`, `one_draw`, `online_gain`,
`online_shares`, `particle_losses`, `searches`, `times` and
`worth` each draw a run, or tables, into ``ax`` or into a new figure of pyplot, and return the axes.
So does `against`, which draws a table of many runs. `system` draws three panels into a new figure.
``plt.style.use("pfdist.pages.print")`` gives the look of printed figures, and
``pfdist.pages.screen`` that of figures on a screen.
"""

from pfdist.pages import style  # noqa: F401  first: it decides how Matplotlib is imported
from pfdist.pages.backtested import likelihood_profile
from pfdist.pages.bounds import bound, budget
from pfdist.pages.figure import draw_figures, draw_missing_figures
from pfdist.pages.filtered import belief, draw_filtered, filtered_plot
from pfdist.pages.gains import gain, one_draw
from pfdist.pages.online import online_shares
from pfdist.pages.searches import comparison, searches
from pfdist.pages.sweeps import against, draw_points
from pfdist.pages.system import system
from pfdist.pages.times_axis import times
from pfdist.pages.why import effective_sample_size, error_profile, particle_losses, worth

__all__ = [
    "against",
    "belief",
    "bound",
    "budget",
    "comparison",
    "draw_figures",
    "draw_filtered",
    "draw_missing_figures",
    "draw_points",
    "effective_sample_size",
    "error_profile",
    "filtered_plot",
    "gain",
    "likelihood_profile",
    "one_draw",
    "online_shares",
    "particle_losses",
    "searches",
    "system",
    "times",
    "worth",
]
