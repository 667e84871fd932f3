"""Cores are those that this process may use, whoever limits them."""

import os
from pathlib import Path

import pytest

from oracles.in_turn import in_turn
from pfdist.pools import cores
from pfdist.pools.cores import usable_cores


@pytest.fixture(autouse=True)
def host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A host of 64 cores, on which nothing limits this process yet; give its control groups."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(64)))
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    monkeypatch.setattr(cores, "_ROOT", tmp_path / "cgroup")
    monkeypatch.setattr(cores, "_OWN", tmp_path / "own")
    return tmp_path / "cgroup"


def _write(own: str, folder: Path, **files: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    cores._OWN.write_text(own)
    for name, text in files.items():
        (folder / name.replace("_", ".", 1)).write_text(text + "\n")


def test_without_a_limit_they_are_those_of_the_affinity() -> None:
    assert usable_cores() == 64


@in_turn(("quota", "cores"), [("400000 100000", 4), ("150000 100000", 2), ("50000 100000", 1)])
@in_turn("group", ["", "a/b", "a"])
def test_a_quota_of_version_2_holds_in_its_group_and_all_below(
    quota: str, cores: int, group: str, host: Path
) -> None:
    _write("0::/a/b\n", host / group, cpu_max=quota)
    assert usable_cores() == cores


def test_the_least_quota_of_all_groups_holds(host: Path) -> None:
    _write("0::/a/b\n", host / "a", cpu_max="800000 100000")
    _write("0::/a/b\n", host / "a" / "b", cpu_max="max 100000")
    assert usable_cores() == 8
    _write("0::/a/b\n", host, cpu_max="300000 100000")
    assert usable_cores() == 3


def test_a_sister_group_limits_nobody_else(host: Path) -> None:
    _write("0::/a/b\n", host / "a" / "c", cpu_max="100000 100000")
    assert usable_cores() == 64


@pytest.mark.parametrize("group", ["", "docker/1"], ids=["in a container", "on the host"])
def test_a_quota_of_version_1(group: str, host: Path) -> None:
    own = "4:memory:/docker/1\n3:cpu,cpuacct:/docker/1\n0::/\n"
    folder = host / "cpu" / group
    _write(own, folder, cpu_cfs_quota_us="-1", cpu_cfs_period_us="100000")
    assert usable_cores() == 64
    _write(own, folder, cpu_cfs_quota_us="250000", cpu_cfs_period_us="100000")
    assert usable_cores() == 3


@pytest.mark.parametrize(("told", "cores"), [("6", 6), ("", 64), ("0", 64), ("some", 64)])
def test_a_slurm_task_has_its_cores(told: str, cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", told)
    assert usable_cores() == cores


def test_the_least_of_all_limits_counts(host: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "6")
    _write("0::/\n", host, cpu_max="500000 100000")
    assert usable_cores() == 5
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 7})
    assert usable_cores() == 2
