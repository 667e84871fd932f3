"""A model with files beside it, on three nodes that have neither these files nor its folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import pfdist
from crash.nodes import nodes
from oracles.bytes_of import hashes
from oracles.model_text import MEASURED

HELPER = "from shared.numbers import FACTOR\ndef pulled(x):\n    return FACTOR * x\n"
NUMBERS = "from . import scale\nFACTOR = 0.9 * scale.SCALE\n"
MODEL = (
    """
from pathlib import Path

import numpy as np
from helper import pulled
from pfdist import StateSpaceModel

RATES = np.loadtxt(Path(__file__).with_name("rates.csv"))
PUSH = float(RATES[1])

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (pulled(x[0]) + PUSH * w[0],),
"""
    + MEASURED
    + """)
"""
)
DRIVER = """
import importlib
import sys
from pathlib import Path

import ray
import pfdist

job, run, address, model = sys.argv[1:]
nodes = set()
program = importlib.import_module("pfdist.questions.at_work")
make_pool = program.make_pool


def make_pool_without_the_file(*arguments, **settings):
    Path(model).rename(f"{model}-gone")  # before a worker starts
    return make_pool(*arguments, **settings)


program.make_pool = make_pool_without_the_file


def say(line):
    if line.startswith("Ray is ready"):
        nodes.update(node["NodeID"] for node in ray.nodes() if node["Alive"])


done = pfdist.run(job, run, pool="ray", workers=3, address=address, say=say, figures=False)
timings = done.table("timings")
print(len(nodes), timings["worker"].nunique(), timings["error"].isna().all())
"""


@pytest.mark.slow
def test_nodes_need_neither_the_model_nor_the_files_beside_it(tmp_path: Path) -> None:
    model = tmp_path / "model"
    (model / "shared").mkdir(parents=True)
    for name, content in (
        ("mine.py", MODEL),
        ("helper.py", HELPER),
        ("rates.csv", "0.5\n1.5\n"),
        ("shared/__init__.py", ""),
        ("shared/numbers.py", NUMBERS),
        ("shared/scale.py", "SCALE = 1.0\n"),
    ):
        (model / name).write_text(content)
    small = (Path(__file__).parents[1] / "small.toml").read_text()
    job = tmp_path / "job.toml"
    job.write_text(f'{small}\n[model]\nname = "model/mine.py:model"\n'.replace("250", "60000"))
    whole = pfdist.run(job, tmp_path / "whole", pool="serial", figures=False)
    with nodes(tmp_path, 3) as cluster:
        arguments = [str(job), str(tmp_path / "run"), cluster.address, str(model)]
        done = subprocess.run(
            [sys.executable, "-c", DRIVER, *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env=os.environ | cluster.environment,
            timeout=300,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.split() == ["3", "3", "True"]  # nodes, workers that worked, no failure
    assert not model.exists()
    assert hashes(tmp_path / "run") == hashes(whole.path)
