"""What a validation error of pydantic means, in one sentence."""

import re
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pfdist.errors import shown


def explained(error: ValidationError, model: type[BaseModel]) -> str:
    """Say in one sentence what is wrong with data: what, got, allowed.

    Parameters
    ----------
    error : ValidationError
    model : type
        The pydantic model that did not accept the data.

    Returns
    -------
    str
    """
    first, *others = _by_weight(error)
    more = f"; {len(others)} more like this" if others else ""
    return f"{_sentence(first, model)}{more}"


def _by_weight(error: ValidationError) -> list[ErrorDetails]:
    """What went wrong, the most telling first: a misspelt key, before the key it stands for."""
    errors = error.errors()
    # A wrong search also leaves the tuple of searches too short; that is no mistake of its own.
    telling = [detail for detail in errors if detail["loc"] != ("search",)] or errors
    return sorted(telling, key=lambda detail: detail["type"] != "extra_forbidden")


def _sentence(error: ErrorDetails, model: type[BaseModel]) -> str:
    key = ".".join(str(part) for part in error["loc"] if not isinstance(part, int))
    kind, got = error["type"], error["input"]
    if kind == "extra_forbidden":
        section, _, name = key.rpartition(".")
        place = f" in [{section}]" if section else ""
        return (
            f"unknown key {shown(name)}{place}, allowed: {', '.join(_allowed_keys(section, model))}"
        )
    if kind == "missing":
        return f"{key} must be given"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        name = error["ctx"]["discriminator"].strip("'")
        value = got.get(name) if isinstance(got, dict) else got
        allowed = ", ".join(map(repr, _tagged(model.model_fields[key].annotation)))
        return f"{key}.{name} must be one of {allowed}, got {shown(value)}"
    if key == "search":
        return f"search must be one or more [[search]] sections, got {shown(got)}"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    rule = re.sub(r"^(Input|String|Value) should ", "must ", error["msg"])
    rule = re.sub(r"a valid dictionary or instance of \w+", "a section", rule)
    return f"{key} {rule}, got {shown(got)}"


def _allowed_keys(section: str, model: type[BaseModel]) -> list[str]:
    """Keys of a section, by its dotted name. A tag follows the name of a section that has kinds."""
    kind: Any = model
    parts = iter(section.split(".") if section else [])
    for part in parts:
        annotation = kind.model_fields[part].annotation
        if tagged := _tagged(annotation):
            kind = tagged[next(parts)]
        else:
            kind = next(iter(get_args(annotation)), annotation)  # an optional section, or one
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
            return []
    return list(kind.model_fields)


def _tagged(annotation: Any) -> dict[str, type[BaseModel]]:
    """The kinds of a section by their tags; empty where a section has one kind."""
    for argument in (annotation, *get_args(annotation)):
        for metadata in getattr(argument, "__metadata__", ()):
            if tag := getattr(metadata, "discriminator", None):
                kinds = get_args(get_args(argument)[0])
                return {kind.model_fields[tag].default: kind for kind in kinds}
    return {}
