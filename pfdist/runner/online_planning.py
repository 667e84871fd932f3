"""From the section [online] of a job to the settings of the planning."""

from pfdist.job.job import Job
from pfdist.job.online_section import Online
from pfdist.runner.searches import Settings
from pfdist.sequential.planning import Planning


def planning_of(job: Job, cheapest: str) -> Planning:
    """How the measurements that are left are planned, by the section [online] or its defaults.

    Parameters
    ----------
    job : Job
    cheapest : str
        The estimator that "auto" stands for.
    """
    online = job.online or Online()
    settings = Settings.from_job(job, online.search.evaluation, cheapest)
    return Planning(online.search, settings.draws, online.judging_draws, settings.estimation)
