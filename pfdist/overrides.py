"""Changes of a job's keys, as ``--set`` takes them."""

import tomllib
from typing import Any

from pfdist.errors import JobError


def override(data: dict[str, Any], change: str) -> None:
    """Change a key of a job's data, in place.

    Parameters
    ----------
    data : dict
        As of a job file.
    change : str
        ``key=value``, with a dotted key and a TOML value; see `pfdist.job.load_job`.

    Raises
    ------
    JobError
        It is no such change, or the job has no such section or search.
    """
    key, equals, text = change.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path) or "\n" in change:
        raise JobError(f"--set must be key=value, for instance seed=3, got {change!r}")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()  # a bare word is a string: filter.resampling=systematic
    section: Any = data
    if path[0] == "search" and len(path) > 1:
        section, path = _search_named(data, path[1], change), path[2:]
    for part in path[:-1]:
        section = section.setdefault(part, {})
        if not isinstance(section, dict):
            raise JobError(f"--set {change}: {part} is no section, so it has no keys")
    if not path:
        raise JobError(f"--set {change}: name a key of the search, search.NAME.KEY=value")
    section[path[-1]] = value


def _search_named(data: dict[str, Any], name: str, change: str) -> dict[str, Any]:
    searches = data.get("search")
    searches = searches if isinstance(searches, list) else []
    searches = [search for search in searches if isinstance(search, dict)]
    names = [str(search.get("name", search.get("method"))) for search in searches]
    if name not in names:
        allowed = ", ".join(names) or "none, there is no [[search]]"
        raise JobError(f"--set {change}: the job has no search {name!r}, allowed: {allowed}")
    found: dict[str, Any] = searches[names.index(name)]
    return found
