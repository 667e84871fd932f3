"""The points of a sweep: the changes of the job and the name of each run."""

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pfdist.common.dotted_keys import short_names
from pfdist.common.parsing import parse_toml, whole_numbers
from pfdist.errors import JobError, shown, shown_text

MOST_POINTS = 10_000
_LONGEST_VALUE, _LONGEST_NAME = 40, 150  # characters; a folder's name has at most 255
_STRANGE = re.compile(r"[^A-Za-z0-9.+-]+")  # characters that are replaced in a folder's name
_RANGE = re.compile(r"[-+0-9:,\s]*:[-+0-9:,\s]*")

Values = Mapping[str, Any]
"""A value, or a list of values, by the dotted key of a job, as ``problem.measurement_budget``."""


class Point(NamedTuple):
    """A point of a sweep."""

    name: str  # of the run's folder, made of the values: ``seed=1_measurement_budget=10``
    chosen: Values  # a value for each key that the sweep varies

    @property
    def changes(self) -> list[str]:
        """The changes of the job, in the form that `pfdist.load_job` takes."""
        return [f"{key}={_text(key, value)}" for key, value in self.chosen.items()]


def points_of(over: Values, points: Sequence[Values] = ()) -> tuple[Point, ...]:
    """The points of a sweep, in the order in which they are computed.

    Parameters
    ----------
    over : mapping of str to list
        The values of each key; a text such as ``"1:10"`` is a list of whole numbers. Every
        combination is a point, and the last key changes fastest.
    points : sequence of mappings of str to value
        Further points, each with one value for each of its keys.

    Raises
    ------
    JobError
        Values are not a list, a point or a key is given twice, or the number of points is not 1
        to 10,000.

    Examples
    --------
    >>> [point.name for point in points_of({"seed": [1, 2], "filter.particles": [50]})]
    ['seed=1_particles=50', 'seed=2_particles=50']
    """
    if not isinstance(points, list | tuple):
        raise JobError(f"points must be a list of mappings, got {shown(points)}")
    choices = {key: _values(key, values) for key, values in dotted(over).items()}
    number = math.prod(map(len, choices.values())) if choices else 0
    if not 1 <= number + len(points) <= MOST_POINTS:
        raise JobError(
            f"a sweep must have 1..{MOST_POINTS} points, got {number + len(points)}: give values "
            "of keys, for instance seed=1:10"
        )
    products = itertools.product(*choices.values()) if choices else ()
    chosen = [dict(zip(choices, each, strict=True)) for each in products]
    chosen += [dotted(point) for point in points]
    return tuple(_named(chosen))


def values_by_key(texts: Iterable[str]) -> dict[str, list[Any]]:
    """The values of each key from texts such as ``seed=1:10``; see `values_in`.

    Raises `JobError` if a text is not ``KEY=VALUES``, or if a key is given twice.
    """
    pairs = [values_in(text) for text in texts]
    _check_keys([key for key, _ in pairs])
    return dict(pairs)


def values_in(text: str) -> tuple[str, list[Any]]:
    """The key and the values of ``seed=1:10`` or ``problem.measurement_budget=10,15,21``.

    Raises `JobError` if the text is not ``KEY=VALUES``.
    """
    key, equals, values = text.partition("=")
    if not equals or not key.strip() or not values.strip():
        raise JobError(
            "a sweep goes over KEY=VALUES, for instance seed=1:10 or "
            f"problem.measurement_budget=10,15,21, got {shown(text)}",
            argument="over",
        )
    return key.strip(), _listed(key, values.strip())


def _listed(key: str, text: str) -> list[Any]:
    if _RANGE.fullmatch(text):
        return _numbers(key, text)
    try:
        values: list[Any] = parse_toml(f"values = [{text}]")["values"]
    except ValueError:  # bare words: filter.resampling=systematic,stratified
        return [word.strip() for word in text.split(",")]
    return values


def _numbers(key: str, text: str) -> list[int]:
    try:
        return whole_numbers(text)
    except ValueError as error:
        raise JobError(f"values of {key} {error}", argument="over") from error


def dotted(values: Values, before: str = "") -> dict[str, Any]:
    """Values by dotted keys, from nested mappings: TOML reads ``filter.particles`` as a section.

    >>> dotted({"seed": 1, "filter": {"particles": 100}})
    {'seed': 1, 'filter.particles': 100}
    """
    if not isinstance(values, Mapping):
        raise JobError(
            "a sweep must go over a mapping of keys to values, for instance "
            f"{{'seed': [1, 2]}}, got {shown(values)}"
        )
    joined: dict[str, Any] = {}
    for key, value in values.items():
        is_section = isinstance(value, Mapping)
        added = dotted(value, f"{before}{key}.") if is_section else {f"{before}{key}": value}
        if twice := joined.keys() & added.keys():
            raise JobError(f"each key of a sweep must be given once, got {shown(min(twice))} twice")
        joined |= added
    return joined


def _values(key: str, values: Any) -> Sequence[Any]:
    if isinstance(values, str) and _RANGE.fullmatch(values):
        return _numbers(key, values)
    is_list = isinstance(values, Sequence | np.ndarray) and not isinstance(values, str | bytes)
    if not is_list or not len(values):
        raise JobError(
            f"values of {key} must be a list, or a range such as '1:10', got {shown(values)}"
        )
    listed: Sequence[Any] = values
    return listed


def _check_keys(keys: Sequence[str]) -> None:
    for position, key in enumerate(keys):
        if key in keys[:position]:
            raise JobError(f"each key of a sweep must be given once, got {shown(key)} twice")
        if key.partition(".")[0] == "execution":
            raise JobError(
                f"a sweep must go over keys that change results, got {shown(key)}: all points "
                "share the workers of the job"
            )


def _named(chosen: Sequence[Values]) -> Iterator[Point]:
    """Yield the points with their names, which have the short names of the keys."""
    keys = list(dict.fromkeys(key for values in chosen for key in values))
    short = short_names(keys)
    names, seen = set[str](), set[tuple[tuple[str, str], ...]]()
    for values in chosen:
        _check_keys(list(values))
        texts = {key: _text(key, value) for key, value in values.items()}
        content = tuple(sorted(texts.items()))
        if content in seen:
            twice = shown_text(", ".join(f"{key}={value}" for key, value in texts.items()))
            raise JobError(f"each point of a sweep must be given once, got {twice} twice")
        name = "_".join(f"{short[key]}={_slug(texts[key])}" for key in values)
        if name in names or len(name) > _LONGEST_NAME:
            name = f"{name[:_LONGEST_NAME]}-{_hash(str(texts))}"
        names.add(name)
        seen.add(content)
        yield Point(name, dict(values))


def _text(key: str, value: Any) -> str:
    """A value as a job file spells it."""
    plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    if isinstance(plain, tuple | list):
        return f"[{', '.join(_text(key, each) for each in plain)}]"
    if not isinstance(plain, str | int | float):
        raise JobError(
            f"a value of {key} must be a number, a text, true, false or a list, got {shown(value)}"
        )
    if isinstance(plain, str):
        return json.dumps(plain, ensure_ascii=False)
    return json.dumps(plain).replace("Infinity", "inf").replace("NaN", "nan")


def _slug(text: str) -> str:
    """A value as the name of a folder spells it."""
    slug = _STRANGE.sub("_", text.strip('"[]')) or "empty"
    return slug if len(slug) <= _LONGEST_VALUE else f"{slug[:_LONGEST_VALUE]}-{_hash(text)}"


def _hash(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=4).hexdigest()
