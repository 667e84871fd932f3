"""The JSON schema of job files: what is a job validates, what is not does not."""

import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from oracles.in_turn import in_turn
from pfdist.common.parsing import parse_toml
from pfdist.plugins.init.command import JOB
from pfdist.problem.job_schema import job_schema

ROOT = Path(__file__).parents[2]
VALIDATOR = jsonschema.Draft202012Validator(job_schema())


def test_it_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(job_schema())


def test_every_job_and_every_sweep_validates() -> None:
    texts = [file.read_text() for file in (ROOT / "jobs").glob("*.toml")]
    for text in [*texts, JOB, JOB.replace("\n# clock", "\nclock")]:
        VALIDATOR.validate(parse_toml(text))


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{p.name}" for p in ROOT.glob("docs/*.md"))])
def test_every_job_of_the_manual_validates_and_so_do_parts_of_jobs(page: str) -> None:
    for text in re.findall(r"^```toml\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S):
        data = parse_toml(text)
        if "project" not in data:  # of a package
            whole = {"seed": 1, "problem": {"horizon": 9}, **data}
            VALIDATOR.validate(data if "job" in data else whole)


@in_turn(
    ("key", "value"),
    [
        ("horizont", 9),
        ("measurement_budget", "six"),
        ("measurement_budget", 0),
        ("forbidden", "20:30"),
        ("horizon", [1]),
        ("sensors", [1]),
        ("total_price", -1),
        ("estimate", "smooth"),
    ],
)
def test_a_wrong_key_or_value_is_marked_in_its_place(key: str, value: Any) -> None:
    problem = {"horizon": 9, "measurement_budget": 3} | {key: value}
    (error,) = VALIDATOR.iter_errors({"seed": 1, "problem": problem})
    is_unknown = error.validator == "additionalProperties"
    assert [*error.path][:2] == ["problem", key][: 1 if is_unknown else 2]
    assert repr(key) in error.message if is_unknown else error.validator != "anyOf"


def test_a_file_is_a_job_or_a_sweep() -> None:
    assert VALIDATOR.is_valid({"job": "job.toml", "over": {"seed": [1, 2]}})
    assert not VALIDATOR.is_valid({"job": "job.toml", "seed": 1})
    assert not VALIDATOR.is_valid({"seed": 1, "problem": {"horizon": 9}, "over": {"seed": [1, 2]}})
    assert not VALIDATOR.is_valid({"over": {"seed": [1, 2]}})


def test_keys_have_the_descriptions_of_their_sections() -> None:
    sections = job_schema()["$defs"]
    keys = sections["ProblemSection"]["properties"]
    assert keys["total_price"]["description"].startswith("Largest sum of the prices of a set")
    for section in sections.values():
        for key in section.get("properties", {}).values():
            assert "description" in key or "$ref" in key


def test_it_has_no_keywords_that_json_schemas_do_not_have() -> None:
    lengths = [{"type": "array", "minItems": 2, "maxItems": 2}, {"type": "string", "minLength": 1}]
    schema = job_schema()["$defs"]["SensorSection"]["properties"]
    assert all(schema["limits"][key] == value for key, value in lengths[0].items())
    assert all(schema["together"][key] == value for key, value in lengths[1].items())
    assert schema["install"]["exclusiveMinimum"] == 0
