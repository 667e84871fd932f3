"""`pfdist.plots`: functions that draw one panel, from tables to axes.

Each function draws a run, or tables, into ``ax`` or into a new figure of pyplot, and returns the
axes; `against` draws a table of many runs. `system` draws three panels into a new figure.
``plt.style.use("pfdist.pages.print")`` gives the look of printed figures, and
``pfdist.pages.screen`` that of figures on a screen.
"""

from pfdist.common.stub import names_of_stub
from pfdist.pages import style  # noqa: F401  first: it decides how Matplotlib is imported

__getattr__, __all__ = names_of_stub(globals())


def __dir__() -> list[str]:
    return __all__
