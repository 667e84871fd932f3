from . import densities as densities
from .elementwise import clip as clip
from .elementwise import where as where
from .errors import PfdistError as PfdistError
from .filters.cloud import Cloud as Cloud
from .filters.estimate import Evaluation as Evaluation
from .models import Sensor as Sensor
from .models import StateSpaceModel as StateSpaceModel
from .models import load_model as load_model
from .models.batched import BatchedModel as BatchedModel
from .models.continuous import ode as ode
from .models.continuous import sde as sde
from .models.library.linear_gaussian import linear_gaussian as linear_gaussian
from .models.symbols import take as take
from .pages import plots as plots
from .problem.job import Job as Job
from .problem.job import load_job as load_job
from .problem.problem import Problem as Problem
from .questions.bound import bound as bound
from .questions.compare import compare as compare
from .questions.evaluate import evaluate as evaluate
from .questions.options import Options as Options
from .questions.plan import plan as plan
from .questions.report import report as report
from .questions.run import run as run
from .results import Run as Run
from .results import open_run as open_run
from .runner.filter import Filter as Filter

# isort: split
# Names of plugins, written by docs/tables.py
from .plugins.backtest.question import backtest as backtest
from .plugins.budget.question import budget as budget
from .plugins.check.losses import particle_losses as particle_losses
from .plugins.check.question import check_model as check_model
from .plugins.explorer.widget import explore as explore
from .plugins.filter.question import filter_measurements as filter_measurements
from .plugins.fit.question import fit as fit
from .plugins.online.next_time import next_time as next_time
from .plugins.online.planner import Planner as Planner
from .plugins.online.question import online as online
from .plugins.rule.question import rule as rule
from .plugins.rule.rule_file import Rule as Rule
from .plugins.runs.listing import list_runs as list_runs
from .plugins.runs.question import table as table
from .plugins.simulate.question import simulate as simulate
from .plugins.sweep.question import Sweep as Sweep
from .plugins.sweep.question import sweep as sweep
from .plugins.why.question import why as why

__all__: list[str]
__version__: str
