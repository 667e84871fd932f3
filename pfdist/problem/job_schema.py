"""The JSON schema of job files and of other files, by which editors complete and check them."""

import inspect
import re
from collections.abc import Iterator
from functools import reduce
from operator import or_
from typing import Any

from pydantic.json_schema import models_json_schema

from pfdist.common.plugins import added
from pfdist.common.section import JobSection
from pfdist.problem.job import Job

_KEY = re.compile(r"(?m)^(\w+) : (.*)\n((?:    .*\n?)+)")
_KEYWORDS = {"gt": "exclusiveMinimum", "lt": "exclusiveMaximum"}
_OF_LISTS = {"minLength": "minItems", "maxLength": "maxItems"}


def documented(section: type) -> dict[str, tuple[str, str]]:
    """The type and the meaning of each key of a section, by the docstrings of its classes.

    The keys of the first base come before those of the class.
    """
    base = section.__base__
    inherited = documented(base) if base is not None and issubclass(base, JobSection) else {}
    text = inspect.getdoc(section) or ""
    parameters = text.partition("Parameters\n----------\n")[2].partition("\n\n")[0]
    found = _KEY.findall(parameters + "\n")
    return inherited | {name: (kind, " ".join(lines.split())) for name, kind, lines in found}


def job_schema() -> dict[str, Any]:
    """The JSON schema of jobs and of files of plugins as they are written, with dates as texts."""
    files = [Job, *added("files")]
    _, all_files = models_json_schema([(each, "validation") for each in files], by_alias=True)
    sections: dict[str, Any] = all_files["$defs"]
    roots = {each.__name__ for each in files}
    for of_section in _below(JobSection):
        if section := sections.get(of_section.__name__):
            text = inspect.getdoc(of_section) or ""
            section["description"] = text.partition("\n\nParameters\n")[0]
            keys: dict[str, dict[str, Any]] = section.get("properties", {})
            for key, (_, meaning) in documented(of_section).items():
                if key in keys:
                    keys[key]["description"] = meaning
    job, *others = (sections[each.__name__]["properties"] for each in files)
    allowed: dict[str, Any] = {
        "propertyNames": {"enum": [*job]}, "required": sections["Job"]["required"]
    }  # fmt: skip
    for each in others:
        marked = {"if": {"required": [next(iter(each))]}}
        allowed = marked | {"then": {"propertyNames": {"enum": [*each]}}, "else": allowed}
    whole = {  # no choice at the root, so that an editor marks the wrong key and not all lines
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A file of pfdist",
        "type": "object",
        "properties": reduce(or_, others, job),
        **allowed,
        "$defs": {name: each for name, each in sections.items() if name not in roots},
    }
    written: dict[str, Any] = _as_written(whole)
    return written


def _below(section: type) -> Iterator[type]:
    """All classes that are made from a class."""
    classes: list[type] = section.__subclasses__()
    for each in classes:
        yield from (each, *_below(each))


def _as_written(schema: Any) -> Any:
    """The schema of files in TOML, which has no null; without choices where one type is left."""
    if isinstance(schema, list):
        return [_as_written(each) for each in schema if each != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    keywords = _KEYWORDS | (_OF_LISTS if schema.get("type") == "array" else {})
    written = {
        keywords.get(key, key): _as_written(value)
        for key, value in schema.items()
        if value is not None
    }
    ways = written.get("anyOf", ())
    if len(ways) == 1:
        return ways[0] | {key: value for key, value in written.items() if key != "anyOf"}
    if ways and all(set(way) == {"type"} for way in ways):
        written["type"] = [way["type"] for way in written.pop("anyOf")]
    return written
