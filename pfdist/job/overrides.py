"""Changes of a job's values: as text, which a user types after ``--set``, or as typed values."""

from collections.abc import Mapping
from numbers import Integral
from typing import Any

from pfdist.common.nearest import did_you_mean
from pfdist.common.parsing import MOST_LEVELS, parse_toml
from pfdist.errors import JobError, shown, shown_text


def override(data: dict[str, Any], change: str) -> None:
    """Change a value in the data of a job file, in place.

    The change is ``key=value``, with a dotted key and a TOML value; see `pfdist.job.job.load_job`.
    Raises `JobError` if it is no such text, or if the job has no such section or search.
    """
    key, equals, text = change.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path) or "\n" in change:
        raise JobError(
            f"changes must be key=value, for instance seed=3, got {shown(change)}", argument="set"
        )
    if len(path) > MOST_LEVELS:
        raise JobError(
            f"keys of changes must have at most {MOST_LEVELS} parts, got {len(path):,}",
            argument="set",
        )
    value = _value(text.strip(), change)
    section: Any = data
    if path[0] == "search" and len(path) > 1:
        section, path = _search_named(data, path[1], change), path[2:]
    for part in path[:-1]:
        section = section.setdefault(part, {})
        if not isinstance(section, dict):
            raise JobError(
                f"change {shown_text(change)}: {shown_text(part)} is no section, so it has no keys",
                argument="set",
            )
    if not path:
        raise JobError(
            f"change {shown_text(change)}: name a key of the search, search.NAME.KEY=value",
            argument="set",
        )
    section[path[-1]] = value


def set_values(data: dict[str, Any], settings: Mapping[str, Any]) -> list[str]:
    """Set typed values in the data of a job file, in place, and return the changes as text.

    `settings` has a value for each key, or a mapping of keys to values for each section. An empty
    mapping makes a section. None leaves the value as it is. The texts are for errors.
    """
    changes = []
    for name, value in settings.items():
        if isinstance(value, Mapping):
            section = data.get(name, {})
            given = {key: each for key, each in value.items() if each is not None}
            if isinstance(section, dict) and (given or not value):  # others are refused later
                section = data[name] = dict(section)
                changes += [f"{name}.{change}" for change in set_values(section, given)]
        elif value is not None:
            is_index = isinstance(value, Integral) and not isinstance(value, bool)
            data[name] = int(value) if is_index else value  # a section takes no NumPy integer
            changes.append(f"{name}={value if isinstance(value, str) else shown(data[name])}")
    return changes


def _value(text: str, change: str) -> Any:
    """The TOML value that a text spells, or the text itself if it spells none."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise JobError(f"changes must be UTF-8 text, got {shown(change)}") from error
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError as error:
        if text[:1] in ("[", "{") or text.strip("+-").isdecimal():
            raise JobError(f"change {shown_text(change)}: {error}") from error
    return text  # a bare word: filter.resampling=systematic


def _search_named(data: dict[str, Any], name: str, change: str) -> dict[str, Any]:
    searches = data.get("search")
    searches = searches if isinstance(searches, list) else []
    searches = [search for search in searches if isinstance(search, dict)]
    names = [str(search.get("name", search.get("method"))) for search in searches]
    if name not in names:
        allowed = ", ".join(names) or "none, there is no [[search]]"
        raise JobError(
            f"change {shown_text(change)}: the job has no search {shown(name)}, allowed: {allowed}"
            f"{did_you_mean(name, names)}",
            argument="set",
        )
    section: dict[str, Any] = searches[names.index(name)]
    return section
