from .bounds import bound as bound
from .figure import draw_figures as draw_figures
from .figure import draw_missing_figures as draw_missing_figures
from .gains import gain as gain
from .gains import one_draw as one_draw
from .searches import comparison as comparison
from .searches import searches as searches
from .system import system as system
from .times_axis import times as times

# isort: split
# Names of plugins, written by docs/tables.py
from ..plugins.budget.figure import budget as budget
from ..plugins.check.figure import particle_losses as particle_losses
from ..plugins.filter.figure import belief as belief
from ..plugins.filter.sizes_figure import effective_sample_size as effective_sample_size
from ..plugins.fit.figure import likelihood_profile as likelihood_profile
from ..plugins.online.figure import online_shares as online_shares
from ..plugins.runs.figure import against as against
from ..plugins.why.figures import error_profile as error_profile
from ..plugins.why.figures import worth as worth

__all__: list[str]
