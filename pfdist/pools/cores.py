"""How many cores this process may use, which are not the host's."""

import math
import os
from collections.abc import Iterator

from pfdist.pools.control_group import settings


def usable_cores() -> int:
    """Give the least of what affinity, the control group and a Slurm task allow."""
    return max(1, min(limits().values()))


def limits() -> dict[str, int]:
    """Say what limits the cores, by its name."""
    found = {"affinity": len(os.sched_getaffinity(0))}
    quota = min(_quotas(), default=math.inf)
    if quota < math.inf:
        found["cgroup"] = math.ceil(quota)
    slurm = os.environ.get("SLURM_CPUS_PER_TASK", "")
    if slurm.isdecimal() and int(slurm):
        found["SLURM_CPUS_PER_TASK"] = int(slurm)
    return found


def _quotas() -> Iterator[float]:
    """Cores' worth of time, of version 2 and of version 1."""
    texts = [text.split() for (text,) in settings("cpu", "cpu.max")]
    texts += settings("cpu", "cpu.cfs_quota_us", "cpu.cfs_period_us")
    for quota, period in texts:
        if quota.isdecimal():  # not "max", nor -1
            yield int(quota) / int(period)
