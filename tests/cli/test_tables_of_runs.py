"""`pfdist table` and `pfdist list`: what they print fits a terminal, and JSON has all of it."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

import pfdist
from pfdist.cli.list_lines import list_lines
from pfdist.cli.main import main
from pfdist.cli.runs_lines import runs_lines
from pfdist.common.rounding import with_error

SMALL = (Path(__file__).parents[1] / "small.toml").read_text()
SHORT = ["comparison.draws=60", "search.genetic.generations=1", "filter.particles=10"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    (folder / "small.toml").write_text(SMALL)
    for name, changes in {
        "a": [],
        "b": ["seed=2", "problem.measurement_budget=5"],
        "c": [
            "model.parameters.process_sd=3",
            "filter.engine=numpy",
            "search.random.evaluations=3",
        ],
    }.items():
        job = pfdist.load_job(folder / "small.toml", [*SHORT, *changes])
        pfdist.run(job, folder / "results" / name, figures=False)
    return folder / "results"


def _printed(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(words) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def test_a_table_shows_keys_errors_gains_and_seconds_in_80_columns(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = _printed(["table", str(runs / "a"), str(runs / "b")], capsys).splitlines()
    assert max(map(len, lines)) <= 80
    words = lines[0].split() + lines[1].split()
    assert {"run", "seed", "measurement_", "budget", "set", "gain", "seconds"} <= set(words)
    summary = pfdist.open_run(runs / "b").summary()["results"]["random"]
    row = next(line for line in lines if line.startswith("b ") and "random" in line)
    assert with_error(summary["expected_mse"], summary["standard_error"]) in row
    assert row.split()[:3] == ["b", "2", "5"]
    assert lines[-1] == "gain %: how far the expected MSE is below that of regular (95 %)"


def test_a_table_that_does_not_fit_names_what_it_leaves_out(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = _printed(["table", str(runs)], capsys).splitlines()
    assert max(map(len, lines)) <= 80
    (told,) = [number for number, line in enumerate(lines) if line.startswith("--json and --out")]
    left_out = " ".join(lines[told:])
    assert "model.parameters.process_sd" in left_out  # which two of the jobs lack
    assert [line.split()[0] for line in lines[2:8]] == ["a", "a", "b", "b", "c", "c"] or (
        "run" in left_out
    )


def test_json_has_every_column(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer = json.loads(_printed(["table", str(runs), "--json"], capsys))
    assert set(answer) == {"rows"}
    frame = pfdist.table(runs)
    assert list(answer["rows"][0]) == frame.columns.tolist()
    for row, expected in zip(answer["rows"], frame.to_dict("records"), strict=True):
        for key, value in row.items():
            if value is None:
                assert pd.isna(expected[key])
            else:
                assert (tuple(value) if isinstance(value, list) else value) == expected[key]


@pytest.mark.slow
def test_the_unit_of_the_clock_is_in_the_json_and_in_the_heads(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = ["problem.time_step=0.5", 'problem.time_unit="h"']
    job = pfdist.load_job(runs.parent / "small.toml", [*SHORT, *clock])
    pfdist.run(job, tmp_path / "run", figures=False)
    answer = json.loads(_printed(["table", str(tmp_path / "run"), "--json"], capsys))
    assert answer["time_unit"] == "h"
    assert all(2 * time == int(2 * time) for time in answer["rows"][0]["measurement_times"])
    out = tmp_path / "t.tex"
    assert _printed(["table", str(tmp_path / "run"), "--out", str(out)], capsys) == f"{out}\n"
    assert "measurement times [h]" in out.read_text()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["table", "{runs}/a", "--out", "t.xlsx"], "end in one of .csv, .parquet, .tex, got 't.x"),
        (["table", "{runs}/lacking"], "lacking holds no run"),
        (["list", "{runs}/lacking"], "lacking: No such file or directory"),
    ],
)
def test_a_mistake_is_one_line(
    words: list[str], told: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.format(runs=runs) for word in words]) == 1
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert told in captured.err


def test_a_list_shows_state_age_size_and_gain_in_80_columns(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c"):
        shutil.copytree(runs / name, tmp_path / name)
    (tmp_path / "a" / "run.json").write_text("{}")
    shutil.rmtree(tmp_path / "b" / "tables" / "comparison")
    head, bad, unfinished, good = _printed(["list", str(tmp_path)], capsys).splitlines()
    assert head.split() == ["run", "state", "age", "size", "found"]
    assert max(map(len, (bad, unfinished, good))) <= 80
    assert "damaged" in bad
    assert "cannot read run.json" in bad
    assert unfinished.split()[:2] == ["b", "unfinished"]
    assert unfinished.endswith("0 of 60 draws")
    assert " % below regular" in good or " % above regular" in good
    answer = json.loads(_printed(["list", str(tmp_path), "--json"], capsys))
    assert [row["state"] for row in answer["runs"]] == ["damaged", "unfinished", "finished"]
    assert answer["runs"][1]["gain_of_means"] is None


def test_the_list_of_no_runs_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _printed(["list", str(tmp_path)], capsys) == f"{tmp_path}: no runs\n"


@pytest.mark.parametrize("name", ["a\nb", "\x1b[2J", "x" * 200])
def test_a_name_cannot_spoil_the_terminal(name: str, runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "a", tmp_path / name)
    lines = [
        *list_lines(pfdist.list_runs(tmp_path), "results"),
        *runs_lines(pfdist.table(tmp_path)),
    ]
    assert all(line.isprintable() for line in lines)
