"""The source archive has what a clone has, and README's commands work where it is unpacked."""

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.needs("dev")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the unpacked archive."""
    folder = tmp_path_factory.mktemp("archive")
    build = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(folder)]
    subprocess.run([*build, str(ROOT)], check=True, capture_output=True)
    (archive,) = folder.glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    return archive.with_name(archive.name.removesuffix(".tar.gz"))


def test_it_has_every_file_of_a_clone(unpacked: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    files = [name for name in listed.stdout.split("\0") if name and (ROOT / name).exists()]
    assert len(files) > 900
    assert [name for name in files if not (unpacked / name).exists()] == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["pfdist", "plan", "jobs/blood.toml", "--bound-draws", "0"], "Measure at t = 7.25, 7.75,"),
        (["pytest", "-m", "quick", "tests/problem/test_clock.py"], " passed"),
        (["pytest", "--collect-only", "-q", "-n0"], " tests collected"),
    ],
    ids=lambda words: words[0] + words[1] if isinstance(words, list) else "",
)
def test_the_commands_of_the_readme_work_in_it(unpacked: Path, words: list[str], says: str) -> None:
    """`.ci/all` runs them whole, in a new environment."""
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=unpacked, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(unpacked)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert says in done.stdout
