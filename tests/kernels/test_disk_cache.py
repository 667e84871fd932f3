"""Compiled code on disk: found again by what it was compiled from, if it is whole and safe."""

import errno
import json
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba import njit
from numba.core.event import install_recorder

from pfdist.errors import EngineWarning
from pfdist.kernels import disk_cache
from pfdist.kernels.disk_cache import FOLDER_VARIABLE, cached_on_disk


def kept(factor, *more):
    """A compiled function as a new process has it: not compiled yet."""

    def scaled(x):
        return factor * x

    compiled = njit(scaled, forceinline=True)

    @njit
    def one_more(x):
        return compiled(x) + 1

    return cached_on_disk(one_more, [scaled], *more)


def called(function, *arguments):
    """Its value, and whether it was compiled for that."""
    with install_recorder("numba:compile") as recorder:
        value = function(*arguments)
    return value, bool(recorder.buffer)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "cache"))
    disk_cache._folder.cache_clear()
    yield tmp_path / "cache"
    disk_cache._folder.cache_clear()


def only_file(folder):
    (file,) = folder.iterdir()
    return file


def test_the_same_function_is_compiled_once(folder):
    assert called(kept(2.0), 5.0) == (11.0, True)
    before = only_file(folder).read_bytes()
    assert called(kept(2.0), 5.0) == (11.0, False)
    assert only_file(folder).read_bytes() == before
    assert folder.stat().st_mode & 0o777 == 0o700  # its user's alone


def test_another_function_or_other_arguments_are_compiled(folder):
    calls = [(2.0, 5.0), (3.0, 5.0), (2.0, 5)]
    for factor, x in calls:
        assert called(kept(factor), x) == (factor * x + 1, True)
    assert called(kept(2.0, "something else"), 5.0) == (11.0, True)
    for factor, x in calls:
        assert called(kept(factor), x) == (factor * x + 1, False)
    assert len(list(folder.iterdir())) == 4


def test_what_cannot_be_told_is_compiled_in_each_process(folder):
    for _ in range(2):
        scope: dict[str, Any] = {"compiled": njit(lambda x: 2.0 * x, forceinline=True)}
        exec("def one_more(x): return compiled(x) + 1", scope)  # its source is not known
        assert called(cached_on_disk(njit(scope["one_more"]), [scope["one_more"]]), 5.0) == (
            11.0,
            True,
        )
    assert not folder.exists()


@njit
def fibonacci(n):
    return n if n < 2 else fibonacci(n - 1) + fibonacci(n - 2)


def test_what_is_not_all_inlined_is_compiled_in_each_process(folder):
    # The symbols of what is left standing are told apart by a count, which is a process's own.
    for _ in range(2):
        assert called(cached_on_disk(njit(lambda n: fibonacci(n) + 1), []), 7) == (14, True)
    assert not list(folder.iterdir())


SPOILT = {
    "empty": lambda data: b"",
    "less than a hash": lambda data: data[:10],
    "half": lambda data: data[: len(data) // 2],
    "all but a byte": lambda data: data[:-1],
    "a byte too many": lambda data: data + b"\0",
    "a bit of the hash": lambda data: bytes([data[0] ^ 1]) + data[1:],
    "a bit in the middle": lambda data: data[:5000] + bytes([data[5000] ^ 1]) + data[5001:],
    "the last bit": lambda data: data[:-1] + bytes([data[-1] ^ 128]),
    "whole, but no code": lambda data: disk_cache._digest(b"no code") + b"no code",
}


@pytest.mark.parametrize("spoilt", SPOILT.values(), ids=SPOILT)
def test_a_file_that_is_not_whole_is_compiled_anew_and_replaced(folder, spoilt):
    kept(2.0)(5.0)
    file = only_file(folder)
    data = file.read_bytes()
    file.write_bytes(spoilt(data))
    assert called(kept(2.0), 5.0) == (11.0, True)
    assert only_file(folder) == file
    assert called(kept(2.0), 5.0) == (11.0, False)


def works_without():
    for _ in range(2):
        assert called(kept(2.0), 5.0) == (11.0, True)


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o1777])
def test_a_folder_that_others_may_write_to_is_not_used(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    with pytest.warns(EngineWarning, match="compiled code is not kept"):
        works_without()
    assert not list(folder.iterdir())


def given_to(user, monkeypatch):
    """Make the folder look as if it belonged to this user."""
    disk_cache._folder.cache_clear()
    own = Path.lstat

    def lstat(path):
        status = list(own(path))
        status[stat.ST_UID] = user
        return os.stat_result(status)

    monkeypatch.setattr(Path, "lstat", lstat)


def test_a_folder_of_root_is_read(folder, monkeypatch):
    kept(2.0)(5.0)
    given_to(0, monkeypatch)
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert called(kept(2.0), 5.0) == (11.0, False)


def test_a_folder_of_somebody_else_is_not_used(folder, monkeypatch):
    kept(2.0)(5.0)
    given_to(os.getuid() + 1, monkeypatch)
    before = only_file(folder).stat()
    with pytest.warns(EngineWarning, match="compiled code is not kept"):
        works_without()
    assert only_file(folder).stat() == before


def test_where_no_folder_can_be_nothing_is_kept(folder):
    folder.write_text("a file")
    with pytest.warns(EngineWarning, match="compiled code is not kept"):
        works_without()
    assert folder.read_text() == "a file"


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_to_is_not_used(folder):
    folder.mkdir(mode=0o500)
    works_without()
    assert not list(folder.iterdir())


def test_on_a_full_disk_nothing_is_kept_nor_left(folder, monkeypatch):
    def half(path, data):
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half)
    works_without()
    assert not list(folder.iterdir())


# --- other processes ---

PROCESS = """
import json, sys
from numba.core.event import install_recorder
from pfdist import load_model
from pfdist.filters import plain
from pfdist.filters.simulation import simulate
from pfdist.models.fingerprint import formulas_key

told = []
for file in sys.argv[1:]:
    model = load_model(f"{file}:model")
    with install_recorder("numba:compile") as recorder:
        fast = simulate(model, 5, range(2), 1)
    slow = plain.simulate(model, 5, range(2), 1)
    told.append({
        "compiled": len(recorder.buffer) > 0,
        "fast": fast.x.ravel().tolist(),
        "slow": slow.x.ravel().tolist(),
        "fingerprint": formulas_key("mine", model.formulas),
    })
print(json.dumps(told))
"""

MODEL = """
import math
from dataclasses import replace
import constants
import numpy as np
from constants import DRIFT
from pfdist import load_model

GAIN = 0.5

def transition(x, t, w, p):
    return (GAIN * np.sin(x[0]) + DRIFT + constants.ROUND * math.pi + w[0],)

model = replace(load_model("ungm"), transition=transition)
"""
EDITS = [("mine.py", "GAIN = 0.5", "GAIN = 0.25"), ("constants.py", "ROUND = 2", "ROUND = 3")]


@pytest.fixture
def models(tmp_path):
    """Simulate these files' models in a process of its own."""

    def simulated(*files, hash_seed="1"):
        environment = {
            **os.environ,
            "PYTHONHASHSEED": hash_seed,
            "PYTHONPATH": os.pathsep.join(["", *sys.path]),
            "PYTHONDONTWRITEBYTECODE": "1",  # which would hold a constant's old value for a second
        }
        finished = subprocess.run(
            [sys.executable, "-c", PROCESS, *files],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        told = json.loads(finished.stdout)
        for answer in told:
            assert answer["fast"] == pytest.approx(answer["slow"], rel=1e-12)
        return told

    (tmp_path / "mine.py").write_text(MODEL)
    (tmp_path / "other.py").write_text(MODEL.replace("+ w[0]", "- w[0]"))
    (tmp_path / "constants.py").write_text("DRIFT = 1.0\nROUND = 2\n")
    return simulated


@pytest.mark.slow
def test_another_process_loads_what_one_compiled_and_never_for_an_edited_model(models, tmp_path):
    (first,) = models("mine.py")
    other, second = models("other.py", "mine.py", hash_seed="2")  # beside another model's code
    assert [answer.pop("compiled") for answer in (first, other, second)] == [True, True, False]
    assert first == second
    figures = [first["fast"], other["fast"]]
    for name, old, new in EDITS:
        path = tmp_path / name
        path.write_text(path.read_text().replace(old, new))
        (edited,) = models("mine.py")
        assert edited["compiled"]
        assert edited["fast"] not in figures
        figures.append(edited["fast"])
