"""The cores and the memory that this process may use, and limits of control groups."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

_ROOT, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def usable_cores() -> int:
    """Give the smallest limit of affinity, control group and Slurm task."""
    return max(1, min(limits().values()))


def limits() -> dict[str, int]:
    """Give each limit of the number of cores, by its name."""
    found = {"affinity": len(os.sched_getaffinity(0))}
    quota = min(_quotas(), default=math.inf)
    if quota < math.inf:
        found["cgroup"] = math.ceil(quota)
    slurm = os.environ.get("SLURM_CPUS_PER_TASK", "")
    if slurm.isdecimal() and int(slurm):
        found["SLURM_CPUS_PER_TASK"] = int(slurm)
    return found


def _quotas() -> Iterator[float]:
    """Quotas of processor time in cores, of control groups of versions 2 and 1."""
    texts = [text.split() for (text,) in settings("cpu", "cpu.max")]
    texts += settings("cpu", "cpu.cfs_quota_us", "cpu.cfs_period_us")
    for quota, period in texts:
        if quota.isdecimal():  # not "max", nor -1
            yield int(quota) / int(period)


def settings(controller: str, *names: str) -> Iterator[list[str]]:
    """Read files of this process's control group and of all groups above it; all limits apply.

    Linux sets limits by control groups; see cgroups(7).

    Parameters
    ----------
    controller : str
        ``cpu`` or ``memory``.
    names : str
        Names of the files, of version 2 or of version 1.

    Yields
    ------
    list of str
        The texts of the files, for each group that has all of them.
    """
    try:
        lines = _OWN.read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:  # version 2
            root = _ROOT
        elif controller in controllers.split(","):
            root = _ROOT / controller
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
