"""The JSON schema of job files and sweep files, by which editors complete and check them."""

import inspect
import re
from typing import Any

from pydantic.json_schema import models_json_schema

from pfdist.problem.job import Job
from pfdist.problem.sweep import SweepFile

_ROOTS = frozenset({Job.__name__, SweepFile.__name__})
_KEY = re.compile(r"^(\w+(?:, \w+)*) : .*\n((?:    .*(?:\n|$))+)", re.MULTILINE)


def job_schema() -> dict[str, Any]:
    """The JSON schema of job files and sweep files as they are written, with dates as texts."""
    _, whole = models_json_schema([(Job, "validation"), (SweepFile, "validation")], by_alias=True)
    sections: dict[str, Any] = whole["$defs"]
    for section in sections.values():
        about = inspect.cleandoc(section.pop("description", ""))
        section["description"] = about.partition("\n\nParameters\n")[0]
        described = {
            name: " ".join(text.split())
            for names, text in _KEY.findall(about)
            for name in names.split(", ")
        }
        keys: dict[str, dict[str, Any]] = section.get("properties", {})
        for key in described.keys() & keys.keys():
            keys[key]["description"] = described[key]
    job, sweep = (sections[each.__name__]["properties"] for each in (Job, SweepFile))
    whole = {  # no choice at the root, so that an editor marks the wrong key and not all lines
        "title": "A job or a sweep of pfdist",
        "type": "object",
        "properties": job | sweep,
        "if": {"required": ["job"]},
        "then": {"propertyNames": {"enum": [*sweep]}},
        "else": {"propertyNames": {"enum": [*job]}, "required": sections["Job"]["required"]},
        "$defs": {name: each for name, each in sections.items() if name not in _ROOTS},
    }
    written: dict[str, Any] = _as_written(whole)
    return written


def _as_written(schema: Any) -> Any:
    """The schema of files in TOML, which has no null; without choices where one type is left."""
    if isinstance(schema, list):
        return [_as_written(each) for each in schema if each != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    written = {
        key: _as_written(value)
        for key, value in schema.items()
        if (key, value) != ("default", None)
    }
    ways = written.get("anyOf", ())
    if len(ways) == 1:
        return ways[0] | {key: value for key, value in written.items() if key != "anyOf"}
    if ways and all(set(way) == {"type"} for way in ways):
        written["type"] = [way["type"] for way in written.pop("anyOf")]
    return written
