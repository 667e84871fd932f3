"""The JSON schema of job files and sweep files, by which editors complete and check them."""

import inspect
import re
from typing import Any

from pydantic.json_schema import models_json_schema

from pfdist.problem.job import Job
from pfdist.problem.sweep import SweepFile

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
    either = [{"$ref": f"#/$defs/{each.__name__}"} for each in (Job, SweepFile)]
    title = "A job or a sweep of pfdist"
    return {"title": title, "anyOf": either, "$defs": _without_nulls(sections)}


def _without_nulls(schema: Any) -> Any:
    """The schema of files in TOML, which has no null."""
    if isinstance(schema, list):
        return [_without_nulls(each) for each in schema if each != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    return {
        key: _without_nulls(value)
        for key, value in schema.items()
        if (key, value) != ("default", None)
    }
