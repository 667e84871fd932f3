"""The folder of compiled code: it belongs to one user and one version, and nobody needs it."""

import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numba
import pytest

import pfdist
from oracles.in_turn import in_turn
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
    cache: Path | None, package: Path = PACKAGE, code: str = COMPUTES, **environment: str
) -> tuple[list[list[float]], list[str], str]:
    """Weights that another process computes, the warnings, and the file that it imports."""
    result: tuple[list[list[float]], list[str], str]
    result = eval(printed(code, cache, package, **environment))
    assert result[0] == [[1.0, pytest.approx(0.5, rel=1e-6)]]
    return result


def printed(code: str, cache: Path | None, package: Path, **environment: str) -> str:
    """Output of a code in another process."""
    given = {**os.environ, **environment, "PYTHONPATH": str(package.parent)}
    given.pop("PFDIST_CACHE_DIR", None)
    if cache is not None:
        given["PFDIST_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False, cwd="/")
    assert done.returncode == 0, done.stderr
    return done.stdout


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


def _emptied(file: Path) -> None:
    file.write_bytes(b"")


def _cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def _flipped(file: Path) -> None:
    content = file.read_bytes()
    middle = len(content) // 2
    file.write_bytes(content[:middle] + bytes(64) + content[middle + 64 :])


def _added(file: Path) -> None:
    file.with_name("another").touch()


@in_turn(
    ("damage", "suffix"), [(_emptied, "nbi"), (_cut, "nbi"), (_flipped, "nbc"), (_added, "nbc")]
)
def test_damaged_code_is_compiled_again_after_one_warning(damage, suffix, kept, tmp_path):
    """As after a power cut, or on a bad disk; the next process finds whole code."""
    folder = shutil.copytree(kept, tmp_path / damage.__name__)
    for file in [*folder.rglob(f"*.{suffix}")]:
        damage(file)
    _, said, _ = computed(folder)
    assert len(said) == 1
    assert "code that was kept is damaged, and is compiled again: " in said[0]
    assert str(folder) in said[0]
    assert computed(folder)[1] == []


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder with the code of one function."""
    folder = tmp_path_factory.mktemp("kept")
    computed(folder)
    return folder


def test_code_that_numba_cannot_load_is_compiled_again(kept, tmp_path):
    """Its hash is right: it was damaged before it was kept."""
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    (index,) = tmp_path.rglob("*.nbi")
    _cut(index)
    folder = index.parents[1]
    start = folder.name.rpartition("-")[0]
    folder.rename(folder.with_name(f"{start}-{cached._hash_of_files(cached._read(folder))}"))
    assert len(computed(tmp_path)[1]) == 1
    assert computed(tmp_path)[1] == []


@in_turn("left", ["a file", "a dangling link", "nothing"])
def test_what_lies_in_the_place_of_kept_code_is_removed(left, kept, tmp_path):
    folder = shutil.copytree(kept, tmp_path / left)
    (code,) = folder.glob("*/*-*")
    shutil.rmtree(code)
    if left == "a file":
        code.touch()
    elif left == "a dangling link":
        code.symlink_to("/proc/none")
    assert len(computed(folder)[1]) == (left != "nothing")
    assert computed(folder)[1] == []


def test_a_folder_that_cannot_be_written_is_read_and_numba_writes_nowhere_else(kept, tmp_path):
    """Numba would look beside the package, where nothing is compared with a hash."""
    package = shutil.copytree(PACKAGE, tmp_path / "copy" / "pfdist")
    cache, files = tmp_path / "kept", {*package.rglob("*")}
    computed(cache, package)
    before = {*cache.rglob("*")}
    unwritable = "import tempfile as t, pathlib; make = t.mkdtemp\n"
    unwritable += "def refuse(suffix=None, prefix=None, dir=None):\n"
    unwritable += "    if dir is not None: raise PermissionError(13, 'Permission denied')\n"
    unwritable += "    return make(suffix, prefix, dir)\nt.mkdtemp = refuse\n"
    assert computed(cache, package, unwritable + COMPUTES)[1] == []  # it is loaded
    assert {*cache.rglob("*")} == before
    other = tmp_path / "other"
    _, said, _ = computed(other, package, unwritable + COMPUTES)
    assert len(said) == 1
    assert "compiled code is not kept" in said[0]
    assert {*package.rglob("*")} - files <= {*package.rglob("__pycache__"), *package.rglob("*.pyc")}


def test_on_a_full_disk_functions_are_compiled_and_not_kept(tmp_path):
    """No file may have more than 100 bytes: the disk is full after some."""
    full = "import resource as r; r.setrlimit(r.RLIMIT_FSIZE, (100, 100))\n"
    _, said, _ = computed(tmp_path, code=full + COMPUTES)
    assert len(said) == 1
    assert re.search("compiled code is not kept.*: File too large .*" + str(tmp_path), said[0])
    (folder,) = tmp_path.iterdir()
    assert [*folder.iterdir()] == []


CALLS = """
import numpy as np
from numpy.typing import NDArray
from typing import NamedTuple
from pfdist.kernels.cached import entry
from pfdist.kernels.memory import read
from pfdist.other.helper import added

class Numbers(NamedTuple):
    values: NDArray[np.float64]

@entry(Numbers)
def add(numbers):
    values, = read(numbers)
    values[0] += added()
"""
PRINTS = """
import numpy as np
from pfdist.other.call import Numbers, add
values = np.zeros(1)
add(Numbers(values))
print(values[0])
"""
HELPER = """
from pfdist.kernels.cached import compiled

@compiled
def added():
    return {}
"""


def test_an_edited_helper_in_any_folder_of_the_package_counts(tmp_path):
    """Numba looks only at the file of the function that calls it."""
    copy = shutil.copytree(PACKAGE, tmp_path / "copy" / "pfdist")
    (copy / "other").mkdir()
    (copy / "other" / "call.py").write_text(CALLS)
    for number in (1.0, 2.0, 3.0):
        (copy / "other" / "helper.py").write_text(HELPER.format(number))
        assert printed(PRINTS, tmp_path / "kept", copy) == f"{number}\n"


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
    find = partial(cached._folder.__wrapped__, tmp_path)
    assert find().is_relative_to(tmp_path)
    user = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    with pytest.warns(EngineWarning, match="it must belong to this user"):
        assert find() is None
    (tmp_path / "file").touch()
    monkeypatch.setenv(cached.FOLDER_VARIABLE, str(tmp_path / "file"))
    with pytest.warns(EngineWarning, match="compiled code is not kept, so each process compiles"):
        assert find() is None


def test_the_users_own_cached_functions_do_not_move():
    """Numba's setting of the folder holds for the whole process, and is left as it was."""
    assert os.environ.get("NUMBA_CACHE_DIR", "") == numba.config.CACHE_DIR
