"""A model with files beside it, on two nodes that have neither these files nor its folder."""

import os
import secrets
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import pfdist
from crash.runs import family, until
from oracles.bytes_of import hashes
from oracles.model_text import MEASURED
from pfdist.pools.guard import end

_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": secrets.token_hex(32),
}
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
    + """    data_files=("rates.csv",),
)
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
program = importlib.import_module("pfdist.api.at_work")
make_pool = program.make_pool


def make_pool_without_the_file(*arguments):
    Path(model).rename(f"{model}-gone")  # before a worker starts
    return make_pool(*arguments)


program.make_pool = make_pool_without_the_file


def say(line):
    if line.startswith("Ray is ready"):
        actors = ray._private.state.actors().values()
        nodes.update(actor["Address"]["NodeID"] for actor in actors if actor["State"] == "ALIVE")


done = pfdist.run(job, run, pool="ray", workers=2, address=address, say=say, figures=False)
print(len(nodes), done.timings()["worker"].nunique(), done.timings()["error"].isna().all())
"""


def _start(folder: Path, *options: str) -> "subprocess.Popen[bytes]":
    folder.mkdir()
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=1"]
    alone = ["--min-worker-port=0", "--max-worker-port=0", "--object-store-memory=100000000"]
    with (folder / "said").open("wb") as said:
        return subprocess.Popen(
            [*command, *alone, *options],
            cwd=folder,
            stdout=said,
            stderr=said,
            env=os.environ | _ENVIRONMENT,
        )


def _has_started(node: "subprocess.Popen[bytes]", said: Path) -> bool:
    assert node.poll() is None, said.read_text()[-2000:]
    return b"Ray runtime started" in said.read_bytes()


@contextmanager
def _two_nodes(folder: Path) -> Iterator[str]:
    """Address of a cluster of two nodes on loopback, of one CPU each, with folders of their own."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
    address, nodes = f"127.0.0.1:{port}", []
    head = ["--head", f"--port={port}", "--include-dashboard=false"]
    here = "--node-ip-address=127.0.0.1"
    # A short path, for Ray's sockets, and not where other clusters say that they are.
    temporary = tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp", ignore_cleanup_errors=True)
    head.append(f"--temp-dir={temporary.name}")
    try:
        for name, options in (("head", head), ("other", [f"--address={address}"])):
            nodes.append(_start(folder / name, here, *options))
            said = folder / name / "said"
            until(lambda: _has_started(nodes[-1], said))  # noqa: B023
        yield address
    finally:
        for node in nodes:
            left = family(node.pid)
            node.kill()
            node.wait()
            end(left)
        temporary.cleanup()


@pytest.mark.slow
def test_helper_modules_and_data_files_arrive_on_nodes_that_lack_them(tmp_path: Path) -> None:
    model = tmp_path / "model"
    (model / "shared").mkdir(parents=True)
    for name, text in (
        ("mine.py", MODEL),
        ("helper.py", HELPER),
        ("rates.csv", "0.5\n1.5\n"),
        ("shared/__init__.py", ""),
        ("shared/numbers.py", NUMBERS),
        ("shared/scale.py", "SCALE = 1.0\n"),
    ):
        (model / name).write_text(text)
    small = (Path(__file__).parents[1] / "small.toml").read_text()
    job = tmp_path / "job.toml"
    job.write_text(f'{small}\n[model]\nname = "model/mine.py:model"\n'.replace("250", "60000"))
    whole = pfdist.run(job, tmp_path / "whole", pool="serial", figures=False)
    with _two_nodes(tmp_path) as address:
        arguments = [str(job), str(tmp_path / "run"), address, str(model)]
        done = subprocess.run(
            [sys.executable, "-c", DRIVER, *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env=os.environ | _ENVIRONMENT,
            timeout=300,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.split() == ["2", "2", "True"]  # nodes, workers that worked, no failure
    assert not model.exists()
    assert hashes(tmp_path / "run") == hashes(whole.path)
