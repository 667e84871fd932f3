"""A search does not believe a filter that fools itself: a sharp sensor collapses its cloud."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pfdist
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.work import Estimation, FilterWork
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.runner.build import Built, build

SHARP = Path(__file__).parents[1] / "oracles" / "sharp_sensor.toml"
GOOD, BELIEVED = (1, 3, 6, 9), (0, 1, 3, 9)
CHANGES = ["comparison.draws=500", "execution.pool=serial"]


def test_a_search_ends_near_a_good_set_though_the_variance_prefers_another(tmp_path: Path) -> None:
    """Its own particles' variance is 0.1 for {0, 1, 3, 9}, whose error is 6, and 0.7 for a good."""
    run = pfdist.plan(
        SHARP, tmp_path / "run", DEFAULT_METHOD, CHANGES, bound_draws=0, figures=False
    )
    built = build(pfdist.load_job(tmp_path / "run" / "job.toml"))
    guide = built.searches[0].settings.estimation
    assert _excess(built, guide, BELIEVED, share=0.0) < -4
    assert _excess(built, built.comparing, BELIEVED) > 4
    assert _excess(built, built.comparing, run.sets[DEFAULT_METHOD]) < 4


def _excess(built: Built, estimation: Estimation, times: Times, share: float = 0.15) -> float:
    """How far a set's error is above that of a good set and a share of it, in standard errors."""
    draws, stream = 5000, stream_of("comparison", 123)
    work = FilterWork((times, GOOD), (14, 14), (stream,) * 2, stream, (0, draws), estimation)
    mse: NDArray[np.float64] = built.evaluator(work).mse
    apart = mse[:, 0] - (1 + share) * mse[:, 1]
    return float(np.mean(apart) / np.std(apart) * np.sqrt(draws))
