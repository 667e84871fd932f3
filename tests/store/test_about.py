"""run.json: each value that a page shows has its type, or the file is named."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from oracles.in_turn import in_turn
from pfdist.store.about import read_run, run_key, write_about

EXAMPLE = Path(__file__).parents[2] / "results" / "example"


def _nested(levels: int) -> str:
    """JSON of lists in lists, which may be too deep for the library."""
    return "[" * levels + "]" * levels


FORGED = {  # JSON of a value, and what is said
    "started": ('"yesterday"', "provenance.started must be a date, got 'yesterday'"),
    "angles": ('"nan"', "provenance.angles must be a list, got 'nan'"),
    "names": ('{"z": {"a": 1}}', "provenance.names.z must be a list"),
    "machine": (_nested(3), "provenance.machine must be a section"),
    "processor": ('{"model": "a"}', "provenance.processor.compiled_for must be given"),
    "declared": (_nested(3), "provenance.declared must be a section"),
    "command": (_nested(100_000), "nest at most 16 deep, got more"),
    "libraries": ("[]", "provenance.libraries must be a section"),
    "continued_on": ("[7]", "each entry of provenance.continued_on must be a section, got 7"),
}


@pytest.mark.plugins("runs")
@in_turn("key", FORGED)
@pytest.mark.parametrize("command", ["status", "report", "table", "verify"])
def test_a_forged_value_is_named_with_its_file(
    key: str, command: str, tmp_path: Path, call: Callable[..., Any]
) -> None:
    """Its hash is right: whoever sent the run has made it."""
    value, reason = FORGED[key]
    run = shutil.copytree(EXAMPLE, tmp_path / key)
    about = read_run(run)[0]
    about["provenance"][key] = "HERE"
    text = json.dumps(about).replace('"HERE"', value)
    write_about(run, run_key(run) or "", {"run.json": text})
    code, out, error = call(f"{command} {run}")
    said = " ".join((out + error).split())
    assert code == 1
    assert "run.json is " in said
    assert reason in said
    assert "unexpected" not in said


def test_a_value_that_is_missing_is_named(tmp_path: Path, call: Callable[..., Any]) -> None:
    for key in ("started", "libraries", "machine", "python", "execution"):
        run = shutil.copytree(EXAMPLE, tmp_path / key)
        about = read_run(run)[0]
        del about["provenance"][key]
        write_about(run, run_key(run) or "", {"run.json": json.dumps(about)})
        said = " ".join(call(f"report {run}").err.split())
        assert f"provenance.{key} must be given" in said
