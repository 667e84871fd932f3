"""Batch scripts hand every word on as it is; the command is one of the words.

Programs in the place of pfdist, Ray and Slurm write down the words that they get;
`tests/crash/test_slurm.py` runs the scripts on a real Slurm.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "jobs" / "slurm"
STRANGE = 'it\'s a "job" $(touch gone) `touch gone`; * \\'
OWN = {
    "one-node": ["--pool", "auto", "--workers", "2"],
    "array": ["--part", "3/200", "--pool", "auto", "--workers", "2"],
    "nodes": ["--pool", "ray", "--address", "10.0.0.1:20007"],
}
PROGRAMS = {
    "pfdist": "printf '%s\\n' \"$@\" > words",
    "scontrol": "printf 'JobId=7 JobName=x\\n   Command=%s x y\\n' \"$SCRIPT\"",
    "python": "echo 10.0.0.1",
    "ray": "[ $1 = status ]",
    "srun": "exec sleep 60",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a strange name, which holds the scripts."""
    folder = tmp_path / STRANGE.replace("\\", "")
    shutil.copytree(SCRIPTS, folder / "scripts of mine")
    (folder / "bin").mkdir()
    for name, body in PROGRAMS.items():
        (folder / "bin" / name).write_text(f"#!/bin/sh\n{body}\n")
        (folder / "bin" / name).chmod(0o755)
    return folder


def started(folder: Path, script: str, *words: str) -> subprocess.CompletedProcess[str]:
    """A script that Slurm has started as a copy."""
    original = folder / "scripts of mine" / f"{script}.sbatch"
    shutil.copy(original, folder / "copy")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SLURM")}
    environment |= {
        "SCRIPT": str(original),
        "PFDIST_VENV": "",
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "SLURM_JOB_ID": "7",
        "SLURM_CPUS_PER_TASK": "2",
        "SLURM_ARRAY_TASK_ID": "3",
        "SLURM_ARRAY_TASK_MAX": "200",
    }
    command = ["bash", "./copy", *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("script", "command"), [("one-node", "plan"), ("array", "sweep"), ("nodes", "bound")]
)
def test_a_batch_script_hands_every_word_on(script: str, command: str, folder: Path) -> None:
    job = f"{STRANGE}.toml"
    (folder / job).touch()
    words = ["--results", f"results/{STRANGE}", "--set", "seed=2", ""]
    done = started(folder, script, command, job, *words)
    assert done.returncode == 0, done.stderr
    got = (folder / "words").read_text().split("\n")[:-1]
    assert got == [command, job, *OWN[script], *words]
    assert not list(folder.rglob("gone"))


@pytest.mark.parametrize("script", OWN)
def test_a_batch_script_refuses_a_missing_job(script: str, folder: Path) -> None:
    done = started(folder, script, "run", "missing.toml")
    assert done.returncode == 2
    assert f"usage: sbatch {'--array=1-N ' if script == 'array' else ''}{script}" in done.stderr
    assert done.stderr.endswith("file, got 'missing.toml'\n")
