"""A Ray cluster that pfdist starts or joins: who can reach it, and what is said without one."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pfdist.errors import PoolError
from pfdist.pools import ray_cluster
from pfdist.pools.ray_cluster import load_ray, reach

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
    home = tmp_path / "home"
    home.mkdir()
    done = subprocess.run(
        [sys.executable, "-P", "-c", _ONE_TASK],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={name: value for name, value in os.environ.items() if "RAY" not in name}
        | {"HOME": str(home)},
    )
    assert not list(tmp_path.glob("imported-*"))
    assert (done.stdout, done.stderr) == ("[1]\n", "")
    assert not list(home.iterdir())  # the token lies in no file


def test_a_cluster_of_our_own_has_a_random_token() -> None:
    """In a fresh process: Ray reads the environment when it is imported."""
    lines = (
        "import os\nfrom pfdist.pools.ray_cluster import load_ray\nload_ray(own=True)\n"
        "print(os.environ['RAY_AUTH_MODE'], len(os.environ['RAY_AUTH_TOKEN']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", lines],
        capture_output=True,
        text=True,
        check=True,
        env={name: value for name, value in os.environ.items() if "RAY" not in name},
    )
    assert done.stdout == "token 64\n"


def test_variables_that_the_user_has_set_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray reads them when it is imported, so nothing changes once it is loaded."""
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "ray")
    monkeypatch.setattr(ray_cluster.importlib, "import_module", lambda name: name)
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "1")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "")  # restored: Ray's servers inherit it
    assert load_ray() == "ray"
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "1"
    assert os.environ["RAY_AUTH_MODE"] == "disabled"
    load_ray(own=True)
    assert os.environ["RAY_AUTH_MODE"] == "token"


def test_the_least_ray_that_is_admitted_has_tokens() -> None:
    """Ray has them since 2.52, which also mends CVE-2025-62593."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    (least,) = re.findall(r"ray>=(\d+)\.(\d+)", " ".join(project["dependencies"]))
    assert tuple(map(int, least)) >= (2, 52)


@pytest.mark.parametrize(
    "address",
    [
        pytest.param("nonsense", id="no-port"),
        pytest.param("head:65536", id="port-too-large"),
        pytest.param("head:" + "9" * 5000, id="port-of-5000-digits"),
        pytest.param("head:٦٣٧٩", id="arabic-digits"),
        pytest.param("x" * 3_000_000, id="three-megabytes"),
    ],
)
def test_what_is_no_address_is_refused_in_one_short_line(address: str) -> None:
    with pytest.raises(PoolError, match="must be host:port") as caught:
        reach(address)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("address", "words"),
    [
        pytest.param("127.0.0.1:1", "Connection refused", id="closed-port"),
        pytest.param("[::1]:1", "no Ray cluster at '[::1]:1'", id="version-6"),
        pytest.param("x" * 3000 + ":1", "no Ray cluster at", id="name-of-3000-letters"),
    ],
)
def test_where_nobody_listens_is_said_with_what_else_computes(address: str, words: str) -> None:
    with pytest.raises(PoolError, match=re.escape(words)) as caught:
        reach(address)
    assert "the pools threads and processes need no Ray" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
