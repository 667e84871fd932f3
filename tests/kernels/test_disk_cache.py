"""Compiled code on disk: found again by what it was compiled from, and only whole and in a safe place."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit
from numba.core.event import install_recorder

from pfdist.kernels import disk_cache
from pfdist.kernels.disk_cache import FOLDER_VARIABLE, kept_on_disk


def kept(factor, *more):
    """A compiled function as a new process has it: not compiled yet."""

    def scaled(x):
        return factor * x

    compiled = njit(scaled)

    @njit
    def one_more(x):
        return compiled(x) + 1

    return kept_on_disk(one_more, scaled, *more)


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
        assert called(kept(2.0, object()), 5.0) == (11.0, True)
    assert not folder.exists()


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda data: b"",
        lambda data: data[:10],
        lambda data: data[: len(data) // 2],
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: bytes([data[0] ^ 1]) + data[1:],
        lambda data: data[:5000] + bytes([data[5000] ^ 1]) + data[5001:],
        lambda data: data[:-1] + bytes([data[-1] ^ 128]),
    ],
    ids=[
        *("empty", "less than a hash", "half", "all but a byte", "a byte too many"),
        *("a bit of the hash", "a bit in the middle", "the last bit"),
    ],
)
def test_a_file_that_is_not_whole_is_compiled_anew_and_replaced(folder, spoilt):
    kept(2.0)(5.0)
    file = only_file(folder)
    data = file.read_bytes()
    file.write_bytes(spoilt(data))
    assert called(kept(2.0), 5.0) == (11.0, True)
    assert only_file(folder) == file
    assert called(kept(2.0), 5.0) == (11.0, False)


def works_without(folder_used=False):
    for _ in range(2):
        assert called(kept(2.0), 5.0) == (11.0, True)


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o1777])
def test_a_folder_that_others_may_write_to_is_not_used(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    works_without()
    assert not list(folder.iterdir())


def test_a_folder_of_somebody_else_is_not_used(folder, monkeypatch):
    kept(2.0)(5.0)
    disk_cache._folder.cache_clear()
    user = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    before = only_file(folder).stat()
    works_without()
    assert only_file(folder).stat() == before


def test_where_no_folder_can_be_nothing_is_kept(folder):
    folder.write_text("a file")
    works_without()
    assert folder.read_text() == "a file"


@pytest.mark.skipif(os.getuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_to_is_not_used(folder):
    folder.mkdir(mode=0o500)
    works_without()


def test_on_a_full_disk_nothing_is_kept_nor_left(folder, monkeypatch):
    def half(path, data):
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half)
    works_without()
    assert not list(folder.iterdir())


def test_a_new_folder_is_its_users_alone(folder):
    kept(2.0)(5.0)
    assert folder.stat().st_mode & 0o777 == 0o700


# --- other processes ---

PROCESS = """
import json
from numba.core.event import install_recorder
from pfdist import load_model, plain
from pfdist.draws import simulate
from pfdist.kernels.disk_cache import fingerprint

model = load_model("model.py:model")
with install_recorder("numba:compile") as recorder:
    fast = simulate(model, 5, range(2), 1)
told = {
    "compiled": len(recorder.buffer) > 0,
    "fast": fast.x.ravel().tolist(),
    "slow": plain.simulate(model, 5, range(2), 1).x.ravel().tolist(),
    "fingerprint": fingerprint(model.transition, model.initial),
}
print(json.dumps(told))
"""

MODEL = """
import constants
import numpy as np
from constants import DRIFT
from pfdist import StateSpaceModel

GAIN = 0.5

def transition(x, t, w, p):
    return (GAIN * np.sin(x[0]) + DRIFT + constants.SHIFT + w[0],)

model = StateSpaceModel(
    name="edited",
    initial=lambda w, p: (w[0],),
    transition=transition,
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
)
"""
EDITS = [
    ("model.py", "GAIN = 0.5", "GAIN = 0.25"),
    ("constants.py", "DRIFT = 1.0", "DRIFT = 2.0"),
]


def simulated(folder, hash_seed):
    environment = {
        **os.environ,
        "PYTHONHASHSEED": hash_seed,
        "PYTHONPATH": os.pathsep.join(["", *sys.path]),
        "PYTHONDONTWRITEBYTECODE": "1",  # which would hold a constant's old value for a second
    }
    finished = subprocess.run(
        [sys.executable, "-c", PROCESS],
        cwd=folder, env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(finished.stdout)


def test_another_process_loads_what_was_compiled_and_an_edited_model_is_the_new_one(tmp_path):
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "constants.py").write_text("DRIFT = 1.0\nSHIFT = 0.5\n")
    first, second = (simulated(tmp_path, seed) for seed in ("1", "2"))
    assert first.pop("compiled")
    assert not second.pop("compiled")
    assert first == second
    told = [first]
    for name, old, new in EDITS:
        path = tmp_path / name
        path.write_text(path.read_text().replace(old, new))
        told.append(simulated(tmp_path, "1"))
        assert told[-1].pop("compiled")
        assert told[-1]["fast"] != told[-2]["fast"]
    for one in told:
        assert one["fast"] == pytest.approx(one["slow"], rel=1e-12)
