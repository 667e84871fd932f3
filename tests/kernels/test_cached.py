"""The folder of compiled code: it belongs to one user and one version, and nobody needs it."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest

import pfdist
from pfdist.errors import EngineWarning
from pfdist.kernels import cached

PACKAGE = Path(pfdist.__file__).parent
COMPUTES = """
import warnings
import numpy as np
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from pfdist.kernels.ancestors import weights_of
    weight = weights_of(np.log([[1.0, 0.5]]))
said = [str(each.message) for each in caught]
print(repr((weight.tolist(), said, weights_of.__code__.co_filename)))
"""


def computed(
    cache: Path | None, package: Path = PACKAGE, **environment: str
) -> tuple[list[list[float]], list[str], str]:
    """Weights that another process computes, the warnings, and the file that it imports."""
    given = {**os.environ, **environment, "PYTHONPATH": str(package.parent)}
    given.pop("PFDIST_CACHE_DIR", None)
    if cache is not None:
        given["PFDIST_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-c", COMPUTES]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False, cwd="/")
    assert done.returncode == 0, done.stderr
    result: tuple[list[list[float]], list[str], str] = eval(done.stdout)
    assert result[0] == [[1.0, pytest.approx(0.5, rel=1e-6)]]
    return result


def folders(cache: Path) -> set[str]:
    return {each.name for each in cache.iterdir()}


def test_two_processes_fill_one_folder_at_a_time_and_the_third_compiles_nothing(tmp_path):
    """As two nodes do that share a home."""
    with ThreadPoolExecutor(2) as together:
        both = [*together.map(computed, [tmp_path] * 2)]
    assert [said for _, said, _ in both] == [[], []]
    assert len(folders(tmp_path)) == 1
    files = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb*")}
    assert files
    assert computed(tmp_path)[1] == []
    assert files == {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nb*")}


def test_an_edited_source_has_another_hash(tmp_path, monkeypatch):
    copy = shutil.copytree(PACKAGE / "kernels", tmp_path / "kernels")
    before = cached._hash_of_sources()
    monkeypatch.setattr(cached, "__file__", str(copy / "cached.py"))
    assert cached._hash_of_sources() == before
    with (copy / "vectors.py").open("a") as file:
        file.write("\n# edited\n")
    assert cached._hash_of_sources() != before


def test_nothing_is_written_beside_the_package_or_at_home(tmp_path):
    copy = shutil.copytree(PACKAGE, tmp_path / "copy" / "pfdist")
    files = {*copy.rglob("*")}
    (tmp_path / "place").mkdir()
    place = {
        "TMPDIR": str(tmp_path / "place"),
        "HOME": "/proc/none",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    _, said, file = computed(None, copy, **place)
    assert Path(file).is_relative_to(copy)
    assert said == []
    assert {*copy.rglob("*")} == files
    assert folders(tmp_path / "place") == {f"pfdist-{os.getuid()}"}


def test_the_folder_of_another_user_and_a_file_are_not_used(tmp_path, monkeypatch):
    monkeypatch.setenv(cached.FOLDER_VARIABLE, str(tmp_path / "kept"))
    find = cached._folder.__wrapped__
    assert Path(find()).is_relative_to(tmp_path)
    user = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    with pytest.warns(EngineWarning, match="it must belong to this user"):
        assert find() == ""
    (tmp_path / "file").touch()
    monkeypatch.setenv(cached.FOLDER_VARIABLE, str(tmp_path / "file"))
    with pytest.warns(EngineWarning, match="compiled code is not kept, so each process compiles"):
        assert find() == ""


def test_the_users_own_cached_functions_do_not_move():
    """Numba's setting of the folder holds for the whole process, and is left as it was."""
    assert os.environ.get("NUMBA_CACHE_DIR", "") == numba.config.CACHE_DIR
