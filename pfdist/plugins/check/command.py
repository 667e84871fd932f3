"""The command `check-model`."""

from collections.abc import Iterator

from pfdist.errors import ArgumentError, ModelError
from pfdist.plugins.check.model_checks import Check
from pfdist.plugins.check.question import checks_of
from pfdist.problem.written import clock_of


def check_model(
    model: str,
    *,
    horizon: int | None = None,
    times: str | None = None,
    particles: int | None = None,
) -> Iterator[Check]:
    """Find what is wrong with a model.

    Parameters
    ----------
    model : str
        Name of a model as a job gives it, as path/file.py:object; or a job file, whose models and
        filter are checked.
    horizon : int, optional
        Last instant of the draws of formulas; by default that of the job, or 60.
    times : str, optional
        A clock, for models that read p.time or p.dt: the time of every instant, as 0:48:0.5 or
        "0 0.25 0.5 1:48". By default such models have the times 0, 1, 2, ..., T.
    particles : int, optional
        Number of particles; by default that of the job, or 500.
    """
    if horizon is not None and times is not None:
        raise ArgumentError("--horizon and --times exclude each other: a clock has a last instant")
    wrong = list[str]()
    for check in checks_of(model, horizon, particles, clock_of(times).times if times else ()):
        yield check
        wrong += [check.name] * (check.state == "wrong")
    if wrong:
        raise ModelError(f"{model}: wrong: {', '.join(wrong)}")
