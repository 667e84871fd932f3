"""The job and the model to begin with: they run, and so does each choice in their comments."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import load_job
from pfdist.plugins.init.command import init

Call = Callable[..., Any]


@pytest.mark.plugins("check")
def test_the_job_plans_and_its_model_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text, _ = call("init", "lake")
    assert (code, text.splitlines()) == (
        0,
        ["lake.toml", "lake.py", "`pfdist plan lake.toml` finds when to measure"],
    )
    code, text, _ = call("check-model", "lake.toml")
    assert code == 0
    few = {"changes": ["comparison.draws=200", "filter.particles=100"]}
    run = pfdist.plan("lake.toml", bound_draws=0, figures=False, pool="serial", report=False, **few)
    times = np.array(run.best.measurement_times)
    assert len(times) == 6
    assert np.sum((times > 25) & (times < 50)) >= 4  # where it is disturbed most
    code, _, error = call("init", "lake")
    assert (code, error) == (1, "pfdist: lake.toml exists: give another name, or remove the file\n")
    code, _, error = call("init", "a b")
    assert code == 1
    assert "name must have letters" in error


@pytest.mark.plugins("simulate")
def test_a_model_is_seen_before_it_is_planned_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    """The table is that of `pfdist.simulate`; a file of the user is not replaced."""
    monkeypatch.chdir(tmp_path)
    assert call("init", "lake").code == 0
    for out in ("lake.csv", "lake.parquet", "lake.csv"):
        code, text, _ = call("simulate", "lake.toml", "--out", out, "--draws", "4", "--seed", "7")
        assert (code, text.splitlines()) == (0, [out, "lake.png"])
        read = pd.read_csv if out == "lake.csv" else pd.read_parquet
        expected = pfdist.simulate("lake.toml", 4, seed=7)
        pd.testing.assert_frame_equal(read(out), expected, check_names=False)
    assert (tmp_path / "lake.png").read_bytes()[1:4] == b"PNG"
    for name in ("lake.png", "other.csv"):
        (tmp_path / name).write_text("mine")
        code, _, error = call("simulate", "lake.toml", "--out", f"{name[:-4]}.csv")
        assert (code, error.count("\n")) == (1, 1)
        assert (tmp_path / name).read_text() == "mine"
    assert call("simulate", "lake.toml").code == 2


def test_an_editor_finds_the_schema_that_a_job_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call("init", "lake").code == 0
    first, command = (tmp_path / "lake.toml").read_text().splitlines()[:2]
    assert first == "#:schema ./job.schema.json"
    assert "`pfdist schema > job.schema.json`" in command
    schema = json.loads(call("schema").out)
    assert "measurement_budget" in schema["$defs"]["ProblemSection"]["properties"]


def test_each_choice_in_a_comment_is_a_possible_job(tmp_path: Path) -> None:
    assert [*init(str(tmp_path / "mine"))]
    text = (tmp_path / "mine.toml").read_text()
    choices = re.findall(r"^# (\w+ = .*?)(?:  +#.*)?$", text, re.MULTILINE)
    assert len(choices) == 6
    usual = load_job(tmp_path / "mine.toml").problem
    for choice in choices:
        (tmp_path / "one.toml").write_text(text.replace(f"# {choice}", choice))
        changed = load_job(tmp_path / "one.toml").problem
        key = choice.partition(" ")[0]
        assert getattr(changed, key) != getattr(usual, key)
