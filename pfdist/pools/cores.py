"""The cores that this process may use, with the limits of control groups."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

_ROOT, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def usable_cores() -> int:
    """Number of cores that this process may use: by its affinity, its control groups, and Slurm."""
    slurm = os.environ.get("SLURM_CPUS_PER_TASK", "")
    of_slurm = [int(slurm)] if slurm.isdecimal() and int(slurm) else []
    return max(1, min([affinity(), *of_slurm, *map(math.ceil, _quotas())]))


def affinity() -> int:
    """Number of cores on which this process may run; on macOS, the number of all cores."""
    known = getattr(os, "sched_getaffinity", None)
    return len(known(0)) if known else os.cpu_count() or 1


def _quotas() -> Iterator[float]:
    """Quotas of processor time in cores, of control groups of versions 2 and 1."""
    texts = [text.split() for (text,) in _settings("cpu.max")]
    texts += _settings("cpu.cfs_quota_us", "cpu.cfs_period_us")
    for quota, period in texts:
        if quota.isdecimal():  # not "max", nor -1
            yield int(quota) / int(period)


def _settings(*names: str) -> Iterator[list[str]]:
    """Yield the texts of files of this process's control group and of each group above it.

    Linux sets limits by control groups; see cgroups(7). The limits of all groups apply. The names
    are those of version 2 or of version 1. A group without one of the files is skipped.
    """
    try:
        lines = _OWN.read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:  # version 2
            root = _ROOT
        elif "cpu" in controllers.split(","):
            root = _ROOT / "cpu"
        else:
            continue
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):
            if not folder.is_relative_to(root):
                break
            try:
                yield [(folder / name).read_text(encoding="ascii").strip() for name in names]
            except OSError:  # no such file: no such limit
                continue
