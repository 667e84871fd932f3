"""A run resumes where NumPy and the C library compute constants with other last bits.

NumPy's exp differs in the last bit at 94 of 2,001 arguments between instruction sets. So a model
that is recorded elsewhere may differ in constants, and the run's own are used.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.model_text import MEASURED
from pfdist import Job
from pfdist.errors import RunMismatchError
from pfdist.models.recorded import differences
from pfdist.runner.build import build
from pfdist.store import read_models

pytestmark = pytest.mark.usefixtures("no_figures")
MODEL = (
    """
import math
import numpy as np
from pfdist import StateSpaceModel

def rate(t):
    return ELSEWHERE(0.9 + 0.05 * math.cos(0.7 * t) + 0.01 * math.exp(-t))

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (rate(t) * x[0] + w[0],),
"""
    + MEASURED
    + """)
"""
)
SHORT = ["evaluation.draws=10", "search.genetic.generations=1", "comparison.draws=40"]


def written(job: Job, elsewhere: str) -> Job:
    """The job with a model whose constants are computed so."""
    text = MODEL.replace("ELSEWHERE", elsewhere)
    job.path.with_name("mine.py").write_text(text)
    return job.with_changes(['model.name="mine.py:model"', *SHORT])


def test_a_run_resumes_with_its_own_constants_on_another_processor(
    small_job: Job, tmp_path: Path, stopped: Callable[..., None]
) -> None:
    whole = pfdist.run(written(small_job, ""), tmp_path / "whole").path
    stopped(written(small_job, ""), tmp_path / "run", "comparison")
    job = written(small_job, "(lambda c: np.nextafter(c, 2.0))")  # in the place of another libm
    own, here = read_models(tmp_path / "run")[0], build(job).evaluator.model
    constants = [each.transition.traced.programs[0].constants for each in (own, here)]
    assert not np.array_equal(*constants)
    assert not [*differences(own, here)]
    pfdist.run(job, tmp_path / "run")
    assert hashes(tmp_path / "run") == hashes(whole)
    lent = pfdist.run(job, tmp_path / "lent", reuse=[whole])  # its ids need the same constants
    assert hashes(lent.path) == hashes(whole)
    with pytest.raises(RunMismatchError, match=r"model\.transition: the constant 0\.\d+ -> 0\.\d+"):
        pfdist.run(written(small_job, "(lambda c: c * (1 + 1e-11))"), tmp_path / "run")


@pytest.mark.slow
def test_a_run_resumes_where_numpy_has_fewer_instructions(
    small_job: Job, tmp_path: Path, stopped: Callable[..., None]
) -> None:
    job = written(small_job, "np.tanh")
    whole = pfdist.run(job, tmp_path / "whole").path
    stopped(job, tmp_path / "run", "comparison")
    program = (
        "import sys, pfdist\n"
        "job = pfdist.load_job(sys.argv[1], sys.argv[3:])\n"
        "pfdist.run(job, sys.argv[2], figures=False)"
    )
    changes = ['model.name="mine.py:model"', *SHORT]
    fewer = {"NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512_SKX"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(job.path), str(tmp_path / "run"), *changes],
        env=os.environ | fewer,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert hashes(tmp_path / "run") == hashes(whole)
