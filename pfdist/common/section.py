"""Sections of a job file and arguments of functions: frozen data, and what is wrong with it.

Types declare the allowed values. pydantic checks the values, and `explained` turns its first error
into a sentence.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce, wraps
from numbers import Real
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, create_model
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from pfdist.common.nearest import allowed_names, did_you_mean, must_be, quoted_names
from pfdist.errors import ArgumentError, PfdistError, shown

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


class JobSection(BaseModel):
    """Base class of the sections of a job file: frozen, with strict types, without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def keys_of_section(section: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a section by the keys of a job file."""
    return {field.alias or name: field for name, field in section.model_fields.items()}


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Listed = Annotated[tuple[T, ...], BeforeValidator(_as_tuple)]
"""A tuple of values of one type; job files and JSON may give a list."""


# --- arguments ------------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    """A number of NumPy as one of Python; other values as they are."""
    return value.item() if isinstance(value, Real) and hasattr(value, "item") else value


Whole = Annotated[int, BeforeValidator(_plain)]
"""An argument that is an integer of Python or of NumPy."""
Number = Annotated[float, BeforeValidator(_plain)]
"""An argument that is a number of Python or of NumPy."""


class Arguments(JobSection):
    """Base class of function arguments that are checked together.

    Raises
    ------
    PfdistError
        An argument is wrong. The class attribute `error` is its type, by default `ArgumentError`.
    """

    error: ClassVar[type[PfdistError]] = ArgumentError

    def __init__(self, **given: Any) -> None:
        try:
            super().__init__(**given)
        except ValidationError as error:
            name = str(_by_weight(error)[0]["loc"][0])
            raise self.error(explained(error, type(self)), argument=name) from error


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """The function with a check of its arguments, whose limits are declared with ``Annotated``.

    The signature has the types without the limits. An `ArgumentError` names the wrong argument.

    >>> from pydantic import Field
    >>> @checked
    ... def square(draws: Annotated[Whole, Field(ge=2)]) -> int:
    ...     return draws**2
    >>> square(3)
    9
    >>> square(1)
    Traceback (most recent call last):
        ...
    pfdist.errors.ArgumentError: draws must be at least 2, got 1
    """
    signature = inspect.signature(function)
    limits, shown_types = get_type_hints(function, include_extras=True), get_type_hints(function)
    limited = [name for name, kind in shown_types.items() if limits[name] != kind]
    parameters = [
        each.replace(annotation=shown_types.get(each.name, each.annotation))
        for each in signature.parameters.values()
    ]

    @cache
    def model() -> type[Arguments]:
        types: Any = {name: (limits[name], ...) for name in limited}
        return create_model(function.__name__, __base__=Arguments, **types)

    @wraps(function)
    def call(*arguments: P.args, **named: P.kwargs) -> R:
        given = signature.bind(*arguments, **named)
        given.apply_defaults()
        values = model()(**{name: given.arguments[name] for name in limited})
        given.arguments.update(values)
        return function(*given.args, **given.kwargs)

    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return call


# --- errors ---------------------------------------------------------------------------------------

_RULES = {
    "bool_type": "true or false",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "float_type": "a number",
    "string_type": "a string",
    "dict_type": "a section",
    "model_type": "a section",
    "model_attributes_type": "a section",
    "list_type": "a list",
    "tuple_type": "a list",
    "greater_than_equal": "at least {ge:,.10g}",
    "less_than_equal": "at most {le:,.10g}",
}
"""Our words for the rules that are broken most, by pydantic's type of error."""


def explained(error: ValidationError, model: type[BaseModel]) -> str:
    """One sentence about the first error that pydantic found in some data.

    The sentence has the key, the rule, and the value that was given.
    """
    errors = _by_weight(error)
    place = _place(errors[0], model)
    of_place = [each for each in errors if _place(each, model) == place]
    depth = max(len(each["loc"]) for each in of_place)  # of the members that fit best
    sentence = _sentence([each for each in of_place if len(each["loc"]) == depth], place, model)
    others = len(errors) - len(of_place)
    return f"{sentence}; {others} more like this" if others else sentence


def _by_weight(error: ValidationError) -> list[ErrorDetails]:
    """The errors, unknown keys first: a misspelt key also makes the right key look missing."""
    errors = error.errors()
    # A wrong search also makes the tuple of searches too short, which is not a second mistake.
    telling = [detail for detail in errors if detail["loc"] != ("search",)] or errors
    return sorted(telling, key=lambda detail: detail["type"] != "extra_forbidden")


def _place(error: ErrorDetails, model: Any) -> tuple[int | str, ...]:
    """The place of an error, without the members of unions, which pydantic names last."""
    place, kind = error["loc"], reduce(_inner, error["loc"][:1], model)
    for number, part in enumerate(place[1:], 1):
        kind = _inner(kind, part)
        if kind is None and error["type"] != "extra_forbidden":
            return place[:number]
    return place


def _sentence(
    errors: list[ErrorDetails], place: tuple[int | str, ...], model: type[BaseModel]
) -> str:
    """A sentence about a value, by the errors that the members of its type give."""
    error = errors[0]
    parts = [part for part in place if isinstance(part, str)]  # each may hold dots
    key, kind, got = ".".join(parts), error["type"], error["input"]
    if kind == "extra_forbidden":
        *section, name = parts
        where = f" in [{'.'.join(section)}]" if section else ""
        keys = _allowed_keys(place[:-1], model)
        meant = did_you_mean(name, keys) or _did_you_mean_elsewhere(name, model)
        return f"unknown key {shown(name)}{where}{allowed_names(keys, meant)}"
    if kind == "missing":
        return f"{key} must be given"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        name = error["ctx"]["discriminator"].strip("'")
        value = got.get(name) if isinstance(got, dict) else got
        kinds: Any = reduce(_inner, place, model)
        rule = f"one of {', '.join(map(repr, kinds))}"
        lacking = (
            f"; another {name} needs its package installed, or in Python its module imported first"
        )
        fault = must_be(f"{key}.{name}", rule, value, kinds)
        return fault + lacking * (isinstance(value, str) and not did_you_mean(value, kinds))
    if key == "search":
        return f"search must be one or more [[search]] sections, got {shown(got)}"
    if kind == "value_error":
        return str(error["ctx"]["error"])
    rules = dict.fromkeys(map(_rule, errors))
    if any(rule.endswith("number") for rule in rules):
        rules.pop("an integer", None)
    key = f"each entry of {key}" if place and isinstance(place[-1], int) else key
    rule = next((rule for rule in rules if " should " in rule), "")
    said, rule = f"{key}: {rule}, got {shown(got)}" if rule else "", " or ".join(rules)
    # A number for a section is meant for a key of another.
    meant = _did_you_mean_elsewhere(key, model, is_near=True) if rule == "a section" else ""
    return (said or must_be(key, rule, got, quoted_names(rule))) + meant


def _rule(error: ErrorDetails) -> str:
    if error["type"] in _RULES:
        return _RULES[error["type"]].format(**error.get("ctx", {}))
    return error["msg"].removeprefix("Input should be ")


def _allowed_keys(place: Sequence[int | str], model: type[BaseModel]) -> list[str]:
    """Keys of a section, by its place; none if there is no section."""
    kind = reduce(_inner, place, model)
    kinds = [each for each in (kind, *get_args(kind)) if isinstance(each, type)]
    return [key for each in kinds if issubclass(each, BaseModel) for key in keys_of_section(each)]


def _did_you_mean_elsewhere(name: str, model: type[BaseModel], *, is_near: bool = False) -> str:
    """The end of an error about a key that other sections have; empty if none has it."""
    sections = [key for key, field in model.model_fields.items() if not _kinds(field)]
    allowed = {f"{section}.{key}": key for section in sections
               for key in _allowed_keys([section], model)}  # fmt: skip
    keys = [written for written, key in allowed.items()
            if key == name or (is_near and name in key.split("_"))]  # fmt: skip
    return f"; did you mean {' or '.join(map(repr, keys))}?" if keys else ""


def _inner(kind: Any, part: int | str) -> Any:
    """The type of a part of a value: of a field, of an entry, or of the section with a tag.

    The kinds of a section are a dictionary by their tags. None says that there is no such part.
    """
    if isinstance(kind, dict):
        return kind if isinstance(part, int) else kind.get(part)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        field = keys_of_section(kind).get(str(part))
        return None if field is None else _kinds(field) or field.annotation
    origin = get_origin(kind)
    members = [each for each in get_args(kind) if each is not NoneType]
    if origin is Annotated or (origin in (Union, UnionType) and len(members) == 1):
        return _inner(members[0], part)
    if origin in (tuple, list) and isinstance(part, int):
        return members[0]
    return members[1] if origin in (dict, Mapping) else None


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
