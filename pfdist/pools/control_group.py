"""The limits that Linux control groups set for this process; see cgroups(7)."""

from collections.abc import Iterator
from pathlib import Path

_ROOT, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def settings(controller: str, *names: str) -> Iterator[list[str]]:
    """Read files of this process's control group and of all groups above it; all limits apply.

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
