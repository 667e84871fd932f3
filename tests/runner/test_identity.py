"""The identity of a run: the programs of its models, whatever the words around them."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from oracles.model_text import MEASURED
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import RunMismatchError
from pfdist.plugins.why.question import why
from pfdist.runner.build import build

MODEL = (
    """
import numpy as np
from pathlib import Path
from helper import f
from pfdist import StateSpaceModel

C = {constant} * np.loadtxt(Path(__file__).with_name("rates.csv")).item()

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (C * f(x[0]) + w[0],),
"""
    + MEASURED
    + ")\n"
)
SHORT = [
    "filter.engine=numpy",
    "execution.pool=serial",
    "evaluation.draws=3",
    "search.genetic.generations=1",
    "search.random.evaluations=2",
    "comparison.draws=4",
    "filter.particles=20",
    "search.genetic.population=4",
]
HELPER = "def f(x):\n    return 0.9 * x\n"


def written(job: Job, *, constant: str = "1.0", helper: str = HELPER, rates: str = "1\n") -> Job:
    """Write a model with a helper module and data, and give the job with it."""
    files = {"mine.py": MODEL.format(constant=constant), "helper.py": helper, "rates.csv": rates}
    for name, text in files.items():
        job.path.with_name(name).write_text(text)
    return job.with_changes(['model.name="mine.py:model"', *SHORT])


OTHER_MODELS = [  # what changes, and what an error says about it
    ({"helper": HELPER.replace("0.9", "0.5")}, r"model\.transition: the constant 0\.9\S* -> 0\.5$"),
    ({"helper": HELPER.replace("*", "+")}, r"model\.transition: it computes something else$"),
    ({"rates": "2\n"}, r"model\.transition: the constant 1 -> 2$"),
]


def test_a_run_goes_on_where_words_alone_have_changed_and_not_with_another_model(
    small_job: Job,
    tmp_path: Path,
    stopped: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "run"
    stopped(written(small_job), path, "comparison")
    for change, says in OTHER_MODELS:
        with pytest.raises(RunMismatchError, match=says):
            pfdist.run(written(small_job, **change), path, figures=False)
    other = written(small_job, helper='def f(x):\n    """Pull."""\n    return (0.9 * x)  # so\n')
    assert pfdist.run(other, path, figures=False).state == "finished"
    change, says = OTHER_MODELS[0]
    with pytest.raises(RunMismatchError, match=says):
        why(written(small_job, **change), draws=2, results=path, figures=False)
    monkeypatch.setattr(
        "pfdist.plugins.why.question.release_the_lock", lambda _: True
    )  # starts threads
    assert why(path, draws=2, figures=False).run == path  # its own model


def test_a_run_goes_on_where_whole_times_are_written_as_floats(
    small_job: Job, tmp_path: Path, stopped: Callable[..., None]
) -> None:
    first, again = (
        [f"problem.minimum_spacing={spacing}", f"problem.instant_weights={weights}", sets]
        for spacing, weights, sets in [
            ("2", [1] * 13, "comparison.sets.mine=[0, 1, 2, 3]"),
            ("2.0", [1.0] * 13, "comparison.sets.mine=[-0.0, 1.0, 2, 3]"),
        ]
    )
    stopped(small_job.with_changes(first), tmp_path / "run", "comparison")
    run = pfdist.run(small_job.with_changes(again), tmp_path / "run", figures=False)
    assert pfdist.open_run(run.path).state == "finished"
    assert main(["verify", str(run.path)]) == 0


@pytest.mark.skipif(not shutil.which("git"), reason="git makes the received repository")
def test_a_run_starts_no_program_that_a_received_repository_names(
    small_job: Job, tmp_path: Path
) -> None:
    """SECURITY.md: pfdist starts no program in the folder of a job or of a run."""

    def git(*words: str) -> None:
        subprocess.run(["git", *words], cwd=small_job.path.parent, check=True)

    git("init", "--quiet")
    git("add", small_job.path.name)
    git("-c", "user.name=x", "-c", "user.email=x", "commit", "--quiet", "--message=x")
    marker, program = tmp_path / "marker", tmp_path / ".git" / "hooks" / "post-index-change"
    program.write_text(f"#!/bin/sh\ntouch {marker}\n")
    program.chmod(0o700)
    (tmp_path / ".gitattributes").write_text("* filter=received\n")
    for key in ("core.fsmonitor", "filter.received.clean"):
        git("config", key, str(program))
    pfdist.run(small_job, tmp_path / "run", figures=False)
    assert not marker.exists()


@pytest.mark.slow
def test_the_filters_model_is_named_where_it_differs(small_job: Job, tmp_path: Path) -> None:
    text = MODEL.format(constant="1.0").replace("import f", "import g").replace("* f(", "* g(")
    other = small_job.path.with_name("other.py")
    other.write_text(text)
    helper = HELPER + "def g(x):\n    return {} * x\n"
    job = written(small_job, helper=helper.format(0.8))
    job = job.with_changes(['model.filter.name="other.py:model"'])
    evaluator = build(job).evaluator
    assert evaluator.believed != evaluator.model
    pfdist.run(job, tmp_path / "run", figures=False)
    written(small_job, helper=helper.format(0.7))
    with pytest.raises(
        RunMismatchError, match=r"now: model\.filter\.transition: .*0\.8\d* -> 0\.7\d*$"
    ):
        pfdist.run(job, tmp_path / "run", figures=False)
