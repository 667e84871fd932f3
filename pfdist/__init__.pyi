from . import densities as densities
from . import plots as plots
from .analysis import Run as Run
from .analysis import open_run as open_run
from .api.bound import bound as bound
from .api.budget import budget as budget
from .api.check_model import check_model as check_model
from .api.compare import compare as compare
from .api.evaluate import evaluate as evaluate
from .api.filter_measurements import filter_measurements as filter_measurements
from .api.list_runs import list_runs as list_runs
from .api.next_time import next_time as next_time
from .api.online import online as online
from .api.plan import plan as plan
from .api.planner import Planner as Planner
from .api.report import report as report
from .api.run import run as run
from .api.simulate import simulate as simulate
from .api.sweep import Sweep as Sweep
from .api.sweep import sweep as sweep
from .api.table import table as table
from .api.why import why as why
from .elementwise import clip as clip
from .elementwise import where as where
from .errors import PfdistError as PfdistError
from .filters.cloud import Cloud as Cloud
from .filters.estimate import Evaluation as Evaluation
from .job.job import Job as Job
from .job.job import load_job as load_job
from .job.problem import Problem as Problem
from .models import StateSpaceModel as StateSpaceModel
from .models import load_model as load_model
from .models.linear_gaussian import linear_gaussian as linear_gaussian
from .runner.bound_settings import BoundSettings as BoundSettings
from .sequential.filter import Filter as Filter

__all__: list[str]
__version__: str
