"""What a validation error of a job means, in one sentence."""

import re
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pfdist.errors import shown
from pfdist.job.search_sections import SEARCHES


def explained(error: ValidationError, job: type[BaseModel]) -> str:
    """Say in one sentence what is wrong with a job: what, got, allowed.

    Parameters
    ----------
    error : ValidationError
    job : type
        Of what was to be validated: it has the keys that are allowed.

    Returns
    -------
    str
    """
    first, *others = _by_weight(error)
    more = f"; {len(others)} more like this" if others else ""
    return f"{_sentence(first, job)}{more}"


def _by_weight(error: ValidationError) -> list[ErrorDetails]:
    """What went wrong, the most telling first: a misspelt key, before the key it stands for."""
    errors = error.errors()
    # A wrong search also leaves the tuple of searches too short; that is no mistake of its own.
    telling = [one for one in errors if one["loc"] != ("search",)] or errors
    return sorted(telling, key=lambda one: one["type"] != "extra_forbidden")


def _sentence(error: ErrorDetails, job: type[BaseModel]) -> str:
    key = ".".join(str(part) for part in error["loc"] if not isinstance(part, int))
    kind, got = error["type"], error["input"]
    if kind == "extra_forbidden":
        section, _, name = key.rpartition(".")
        place = f" in [{section}]" if section else ""
        return (
            f"unknown key {shown(name)}{place}, allowed: {', '.join(_allowed_keys(section, job))}"
        )
    if kind == "missing":
        return f"{key} must be given"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        method = got.get("method") if isinstance(got, dict) else got
        return f"search.method must be one of {', '.join(map(repr, SEARCHES))}, got {shown(method)}"
    if key == "search":
        return f"search must be one or more [[search]] sections, got {shown(got)}"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    rule = re.sub(r"^(Input|String|Value) should ", "must ", error["msg"])
    rule = re.sub(r"a valid dictionary or instance of \w+", "a section", rule)
    return f"{key} {rule}, got {shown(got)}"


def _allowed_keys(section: str, job: type[BaseModel]) -> list[str]:
    """The keys of a section, by its dotted name; a search's section is named by its method."""
    kind: Any = job
    parts = section.split(".") if section else []
    if len(parts) > 1 and parts[0] == "search":
        kind, parts = SEARCHES[parts[1]], parts[2:]
    for part in parts:
        annotation = kind.model_fields[part].annotation
        kind = next(iter(get_args(annotation)), annotation)  # an optional section, or one
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
            return []
    return list(kind.model_fields)
