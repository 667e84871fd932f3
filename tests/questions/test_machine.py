"""Check what `pfdist doctor` finds, here and on machines with one fault each."""

import errno
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfdist.cli.main import main
from pfdist.pools import cores
from pfdist.questions import machine as doctor
from pfdist.questions.model_checks import Check
from pfdist.store import lock

Fault = Callable[[pytest.MonkeyPatch, Path], None]
LOOKS = ["cores", "memory", "shared memory", "Ray", "ports", "results folder"]


def found(results: Path, address: str = "") -> dict[str, Check]:
    return {check.name: check for check in doctor.examine(results, address)}


def test_all_is_well_here_and_nothing_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for least in ("LEAST_MEMORY", "LEAST_SHARED", "LEAST_DISK"):  # wherever the tests run
        monkeypatch.setattr(doctor, least, 0.0)
    assert main(["doctor", "--results", str(tmp_path / "some" / "results")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines if str(tmp_path) not in line)
    first = [line for line in lines if not line.startswith(" ")]
    assert [line.partition(":")[0] for line in first] == [f"ok    {look}" for look in LOOKS]
    assert str(tmp_path) in "\n".join(lines)  # not cut
    assert not list(tmp_path.iterdir())
    assert main(["doctor", "--results", str(tmp_path), "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert [check["name"] for check in checks] == LOOKS
    assert {check["state"] for check in checks} == {"ok"}


def _little_memory(patch: pytest.MonkeyPatch, folder: Path) -> None:
    memory = SimpleNamespace(total=64 * 10**9, available=1024 * 10**6)
    patch.setattr(doctor.psutil, "virtual_memory", lambda: memory)


def _limited_memory(patch: pytest.MonkeyPatch, folder: Path) -> None:
    (folder / "own").write_text("0::/job\n")
    (folder / "job").mkdir()
    (folder / "job" / "memory.max").write_text(f"{10**9}\n")
    patch.setattr(cores, "_OWN", folder / "own")
    patch.setattr(cores, "_ROOT", folder)


def _little_shared_memory(patch: pytest.MonkeyPatch, folder: Path) -> None:
    usage = shutil.disk_usage
    docker = SimpleNamespace(free=64 * 1024**2)
    patch.setattr(shutil, "disk_usage", lambda path: docker if "shm" in str(path) else usage(path))


def _old_ray(patch: pytest.MonkeyPatch, folder: Path) -> None:
    patch.setattr(doctor, "version", lambda name: "2.9.3")


def _failing(module: Any, name: str, number: int) -> Fault:
    def fail(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    return lambda patch, folder: patch.setattr(module, name, fail)


NO_PORT = _failing(doctor.socket, "create_server", errno.EMFILE)
READ_ONLY = _failing(doctor.tempfile, "TemporaryDirectory", errno.EROFS)
NO_FLUSH = _failing(os, "fsync", errno.EINVAL)
NO_LOCK = _failing(lock.fcntl, "flock", errno.ENOLCK)
FAULTS: list[tuple[Fault, str, str]] = [
    (_little_memory, "memory", "1.02 GB, and a run needs 1.50: fewer workers need less"),
    (_limited_memory, "memory", "1.00 GB, and a run needs"),
    (_little_shared_memory, "shared memory", "0.07 GB, and Ray needs .*--shm-size"),
    (_old_ray, "Ray", r"2\.9\.3: .*fixed in 2\.52"),
    (NO_PORT, "ports", "Too many open files"),
    (READ_ONLY, "results folder", "written: Read-only file system; runs need another folder"),
    (NO_FLUSH, "results folder", r"cannot be flushed \(fsync\): Invalid argument"),
    (NO_LOCK, "results folder", r"cannot be locked \(flock\): No locks available"),
]


@pytest.mark.parametrize(("fault", "look", "words"), FAULTS)
def test_each_fault_is_found_alone_with_what_to_do(
    fault: Fault, look: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "results").mkdir()
    with monkeypatch.context() as patch:
        fault(patch, tmp_path)
        checks = found(tmp_path / "results")
    assert list(checks) == LOOKS
    assert [check.name for check in checks.values() if check.state == "wrong"] == [look]
    assert re.search(words, checks[look].text)
    assert "\n" not in checks[look].text


def test_what_is_wrong_is_one_line_and_exit_code_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--results", "/proc/nowhere"]) == 1
    captured = capsys.readouterr()
    assert captured.err == "pfdist: not fit for a run: results folder\n"
    assert "wrong results folder: files in /proc cannot be written" in captured.out
    assert main(["doctor", "--results", "/proc/nowhere", "--json"]) == 1
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert [check["state"] for check in checks][-1] == "wrong"


def test_every_node_of_a_cluster_is_asked_and_the_session_stays(
    ray_cluster: None, tmp_path: Path
) -> None:
    from pfdist.pools.ray_cluster import load_ray

    ray = load_ray()
    address = ray.get_runtime_context().gcs_address
    nodes = {name: check for name, check in found(tmp_path, address).items() if name not in LOOKS}
    assert [check.state for check in nodes.values()] == ["ok"] * len(ray.nodes())
    assert ray.is_initialized()


def test_a_node_with_another_python_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfdist.pools import ray_cluster

    here = {"python": doctor.platform.python_version(), "pfdist": doctor.version("pfdist")}
    nodes = [{"host": "a", **here}, {"host": "b", **here, "python": "3.11.0"}]
    monkeypatch.setattr(ray_cluster, "describe_nodes", lambda address: nodes)
    checks = found(tmp_path, "head:6379")
    assert checks["node a"].state == "ok"
    assert checks["node b"].state == "wrong"
    assert checks["node b"].text == (
        f"Python 3.11.0, and {here['python']} here: every node must have the same"
    )


def test_a_cluster_that_does_not_answer_is_wrong(tmp_path: Path) -> None:
    check = found(tmp_path, "127.0.0.1:1")["cluster"]
    assert check.state == "wrong"
    assert "no Ray cluster at '127.0.0.1:1': Connection refused" in check.text
