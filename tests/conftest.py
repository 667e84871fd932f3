"""What tests share: models, small jobs, and one Ray cluster a process."""

import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pfdist import Job, StateSpaceModel, load_job, load_model

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(Path(__file__).parent))  # for `from oracles.kalman import ...`

SMALL_JOB = (Path(__file__).parent / "small.toml").read_text()


@pytest.fixture(scope="session")
def ungm() -> StateSpaceModel:
    return load_model("ungm")


@pytest.fixture
def small_job(tmp_path: Path) -> Job:
    path = tmp_path / "small.toml"
    path.write_text(SMALL_JOB)
    return load_job(path)


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[None]:
    """Two CPUs, for all tests of this process that want Ray."""
    from pfdist.runner import ray_pool  # sets Ray's environment before Ray is imported

    ray_pool.ray.init(
        address="local",
        num_cpus=2,
        num_gpus=0,
        include_dashboard=False,
        log_to_driver=False,
        logging_level=logging.ERROR,
        object_store_memory=100 * 1024**2,
    )
    yield
    ray_pool.ray.shutdown()
