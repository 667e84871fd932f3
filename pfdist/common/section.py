"""Sections of a job file: frozen data, and sentences that say what is wrong with a section."""

from collections.abc import Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from pfdist.common.nearest import did_you_mean, quoted_names
from pfdist.errors import shown


class Section(BaseModel):
    """Base of every section of a job file: frozen, strict about types, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


_RULES = {
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "int_type": "an integer",
    "int_parsing": "an integer",
    "int_parsing_size": "an integer of fewer digits",
    "int_from_float": "an integer",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "string_type": "a string",
    "string_unicode": "a string of Unicode characters",
    "dict_type": "a section",
    "model_type": "a section",
    "model_attributes_type": "a section",
    "list_type": "a list",
    "tuple_type": "a list",
    "none_required": "left out",
    "greater_than": "greater than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "string_too_short": "at least {min_length} characters long",
    "string_too_long": "at most {max_length} characters long",
    "string_pattern_mismatch": "a string that matches {pattern}",
    "too_short": "a list of at least {min_length} entries",
    "too_long": "a list of at most {max_length} entries",
    "literal_error": "{expected}",
}
"""The rule for a value, by pydantic's type of error, with the entries of the error's context."""


def explained(error: ValidationError, model: type[BaseModel]) -> str:
    """One sentence about the first error in data that a pydantic model did not accept.

    It says what is wrong, what was given, and what is allowed.
    """
    first, *others = _by_weight(error)
    more = f"; {len(others)} more like this" if others else ""
    return f"{_sentence(first, model)}{more}"


def _by_weight(error: ValidationError) -> list[ErrorDetails]:
    """The errors, unknown keys first: a misspelt key also makes the right key look missing."""
    errors = error.errors()
    # A wrong search also makes the tuple of searches too short, which is not a second mistake.
    telling = [detail for detail in errors if detail["loc"] != ("search",)] or errors
    return sorted(telling, key=lambda detail: detail["type"] != "extra_forbidden")


def _sentence(error: ErrorDetails, model: type[BaseModel]) -> str:
    parts = [part for part in error["loc"] if isinstance(part, str)]  # each may hold dots
    key, kind, got = ".".join(parts), error["type"], error["input"]
    if kind == "extra_forbidden":
        *section, name = parts
        place = f" in [{'.'.join(section)}]" if section else ""
        keys = _allowed_keys(section, model)
        meant = did_you_mean(name, keys) or _did_you_mean_elsewhere(name, model)
        return f"unknown key {shown(name)}{place}, allowed: {', '.join(keys)}{meant}"
    if kind == "missing":
        return f"{key} must be given"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        name = error["ctx"]["discriminator"].strip("'")
        value = got.get(name) if isinstance(got, dict) else got
        *section, field = parts
        kinds = _kinds(_section(section, model).model_fields[field])
        allowed = ", ".join(map(repr, kinds))
        meant = did_you_mean(value, kinds)
        return f"{key}.{name} must be one of {allowed}, got {shown(value)}{meant}"
    if key == "search":
        return f"search must be one or more [[search]] sections, got {shown(got)}"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    rule = _rule(error)
    meant = did_you_mean(got, quoted_names(rule)) if kind == "literal_error" else ""
    return f"{key} must be {rule}, got {shown(got)}{meant}"


def _rule(error: ErrorDetails) -> str:
    """The rule that a value broke; a type of error without a rule is named."""
    rule = _RULES.get(error["type"], f"valid ({error['type']})")
    context = error.get("ctx", {})
    return rule.format_map({k: f"{v:g}" if type(v) is float else v for k, v in context.items()})


def _allowed_keys(section: Sequence[str], model: type[BaseModel]) -> list[str]:
    """Keys of a section, by the parts of its name; none if the name is not that of a section."""
    kind = _section(section, model)
    is_section = isinstance(kind, type) and issubclass(kind, BaseModel)
    return list(kind.model_fields) if is_section else []


def _did_you_mean_elsewhere(name: str, model: type[BaseModel]) -> str:
    """The end of an error about a key that other sections have; empty if none has it."""
    sections = (key for key, field in model.model_fields.items() if not _kinds(field))
    keys = [f"{section}.{name}" for section in sections if name in _allowed_keys([section], model)]
    return f"; did you mean {' or '.join(map(repr, keys))}?" if keys else ""


def _section(section: Sequence[str], model: type[BaseModel]) -> Any:
    """The type of a section, by the parts of its name.

    The tag follows the name of a section that has kinds.
    """
    kind: Any = model
    parts = iter(section)
    for part in parts:
        if get_origin(kind) is dict:  # sections by names
            kind = get_args(kind)[1]
            continue
        if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
            return kind
        field = kind.model_fields[part]
        if kinds := _kinds(field):
            kind = kinds[next(parts)]
        else:  # a section, which may be optional
            kind = next(iter(get_args(field.annotation)), field.annotation)
    return kind


def _kinds(field: FieldInfo) -> dict[str, type[BaseModel]]:
    """The kinds of a section by their tags; empty where a section has one kind."""
    if isinstance(field.discriminator, str):
        kinds = get_args(field.annotation)
        return {kind.model_fields[field.discriminator].default: kind for kind in kinds}
    for argument in (field.annotation, *get_args(field.annotation)):
        for metadata in getattr(argument, "__metadata__", ()):
            if tag := getattr(metadata, "discriminator", None):
                kinds = get_args(get_args(argument)[0])
                return {kind.model_fields[tag].default: kind for kind in kinds}
    return {}
