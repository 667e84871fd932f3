"""The number of cores that this process may use, which may be fewer than the machine has."""

import math
import os
from collections.abc import Iterator

from pfdist.pools.control_group import settings


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
