"""Explored jobs."""

from collections.abc import Iterator

import pytest

import pfdist
from oracles.explored import job_of, served
from pfdist.plugins.explorer.session import ExplorerSession


@pytest.fixture(scope="module")
def session() -> ExplorerSession:
    """UNGM with forbidden instants, spacing and a required time."""
    changes = ["problem.forbidden=[7, '9:10']", "problem.minimum_spacing=2"]
    return ExplorerSession(job_of(*changes, "problem.required=[4]"))


@pytest.fixture(scope="module")
def address(session: ExplorerSession) -> Iterator[str]:
    """The address of the page of `session`."""
    with served(session) as address:
        yield address


@pytest.fixture(scope="module")
def of_sensors() -> ExplorerSession:
    """A system with three sensors, one of which is forbidden for a while."""
    from oracles.three_sensors import ThreeSensors

    system = ThreeSensors(0.3, 0.95, 0.5, ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7)), (0.8, 0.4, 0.6))
    return ExplorerSession(
        pfdist.Problem(
            system.as_model(),
            horizon=12,
            measurement_budget=4,
            sensors={"near": {}, "far": {"forbidden": ["3:5"]}, "both": {}},
            engine="kalman",
        )
    )
