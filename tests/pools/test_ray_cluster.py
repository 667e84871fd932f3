"""Who can reach a Ray cluster that pfdist has started."""

import os
import re
import stat
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from crash.runs import listening
from pfdist.checks import machine as doctor
from pfdist.errors import PoolError


def test_all_servers_and_workers_listen_on_loopback_alone(ray_cluster: None) -> None:
    from pfdist.pools.ray_cluster import ray

    ray.get(ray.remote(lambda: 0).remote())  # there is a worker, too
    processes = [os.getpid(), *(child.pid for child in psutil.Process().children(recursive=True))]
    found = set(listening(processes))
    assert found
    assert all(place.is_loopback for place in found), found


def test_the_token_is_required_and_lies_in_no_file(ray_cluster: None) -> None:
    from pfdist.pools.ray_cluster import ray

    token = os.environ["RAY_AUTH_TOKEN"]
    assert os.environ["RAY_AUTH_MODE"] == "token"
    assert ray._raylet.get_authentication_mode() == ray._raylet.AuthenticationMode.TOKEN
    folder = Path(ray._private.worker._global_node.get_session_dir_path())
    for file in folder.rglob("*"):
        if file.is_file() and not file.is_symlink():
            assert token not in file.read_text(errors="replace"), file


def test_nobody_else_can_enter_the_folder_of_a_clusters_sockets(ray_cluster: None) -> None:
    from pfdist.pools.ray_cluster import ray

    folder = Path(ray._private.worker._global_node.get_session_dir_path())
    private = next(
        parent for parent in folder.parents if parent.name == f"pfdist-ray-{os.getuid()}"
    )
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    assert private.stat().st_uid == os.getuid()


_ONE_TASK = """
from pfdist.pools.base import Task
from pfdist.pools.ray_pool import RayPool

with RayPool(1) as pool:
    print([outcome.value for outcome in pool.run([Task("a", abs, -1)])])
"""


@pytest.mark.slow
def test_workers_import_no_module_from_the_working_directory(tmp_path: Path) -> None:
    """SECURITY.md: the command `pfdist` imports nothing from the current folder."""
    for module in ("pfdist", "pyarrow", "pydantic", "numpy"):
        (tmp_path / f"{module}.py").write_text(f"open('imported-{module}', 'w')")
    done = subprocess.run(
        [sys.executable, "-P", "-c", _ONE_TASK],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert not list(tmp_path.glob("imported-*"))
    assert done.stdout == "[1]\n", done.stderr


@pytest.mark.parametrize("address", ["", "local"])
def test_without_an_existing_cluster_one_is_started_alone(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfdist.pools import ray_cluster

    seen: dict[str, Any] = {}

    def init(**options: Any) -> None:
        constants = ray_cluster.ray._private.ray_constants
        seen.update(options, on_all_interfaces=constants.ENABLE_RAY_CLUSTER, **os.environ)

    before = {name: value for name, value in os.environ.items() if name.startswith("RAY_AUTH")}
    monkeypatch.setattr(ray_cluster.ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray_cluster.ray, "init", init)
    monkeypatch.setattr(ray_cluster.ray, "shutdown", lambda: None)
    monkeypatch.setattr(ray_cluster, "_read_environment", lambda: None)
    with ray_cluster.connected(address):
        pass
    assert seen["address"] == "local"
    assert not seen["on_all_interfaces"]
    assert seen["RAY_AUTH_MODE"] == "token"
    assert len(seen["RAY_AUTH_TOKEN"]) == 64
    assert before == {n: value for n, value in os.environ.items() if n.startswith("RAY_AUTH")}


def test_the_least_ray_that_is_admitted_has_tokens() -> None:
    """Ray has them since 2.52, which also mends CVE-2025-62593."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    (least,) = re.findall(r"ray>=(\d+)\.(\d+)", " ".join(project["dependencies"]))
    assert tuple(map(int, least)) == doctor.LEAST_RAY >= (2, 52)


def _refuses(address: str) -> bool:
    raise PoolError("nobody is there")


def test_a_cluster_that_cannot_be_joined_is_named_briefly_with_what_else_computes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from pfdist.pools import ray_cluster

    rehearse: Callable[[str], bool] = _refuses
    monkeypatch.setattr(ray_cluster, "rehearse", rehearse)
    monkeypatch.setattr(ray_cluster.ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray_cluster.ray, "shutdown", lambda: None)
    with pytest.raises(PoolError) as caught, ray_cluster.connected("h" * 100_000 + ":1"):
        pass
    assert len(str(caught.value)) < 250
    assert "does not answer: nobody is there; the serial pool" in str(caught.value)
