"""The tables of these jobs hold the numbers that they held before the program became lighter.

`pytest -m golden` computes each job and compares all numbers of its tables with those in
`numbers.json`. Only numbers count. A column may have another name, another table, another integer
or float type and another order of its rows; a table may also become rows of a longer table that a
column of text tells apart. If numbers are meant to change, `pytest -m golden --keep-golden` writes
the file anew, in a commit that changes nothing else.
"""

import json
import math
import re
import shlex
from collections.abc import Iterator
from hashlib import sha256
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pandas.api.types import is_bool_dtype, is_numeric_dtype, is_string_dtype

from pfdist.cli.main import main
from pfdist.common.percent import rounded_up
from pfdist.results import open_run

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).with_name("numbers.json")
MOST_PARTS = 20  # values of a text column that may tell tables apart

_FEW = "--set filter.particles=50 --set comparison.draws=1000"
_JOB = f"{{jobs}}/quick.toml --set problem.horizon=20 --set problem.measurement_budget=6 {_FEW}"
_SMALL = f"plan {_JOB}"
_SENSORS = f"plan {{jobs}}/two_compartments.toml {_FEW} --set problem.total_price=4 --bound-draws 0"
COMMANDS = {
    "quick": "run {jobs}/quick.toml",
    "plan": "plan {jobs}/plan.toml",
    "blood": "plan {jobs}/blood.toml",
    "budgets": "sweep {jobs}/budgets.toml --set comparison.draws=2000",
    "online": "online {jobs}/online.toml --draws 20 --set comparison.draws=1000",
    "pharmacokinetics": "plan {jobs}/pharmacokinetics.toml",
    "constrained": "run {jobs}/constrained.toml",
    "linear_gaussian": "run {jobs}/linear_gaussian.toml --set comparison.draws=10000",
    "information": f"{_SMALL} --set problem.criterion=information --bound-draws 480",
    "quantile": f"{_SMALL} --bound-draws 0 --set 'problem.criterion=quantile 0.9'",
    "worst_instant": f"{_SMALL} --set problem.criterion=worst_instant --bound-draws 0",
    "smoothed": f"{_SMALL} --set problem.estimate=smoothed --bound-draws 480",
    "rule": f"{_SMALL} --bound-draws 0; rule {_JOB} --draws 1000",
    "also": (
        f"compare {_JOB} --times a=0:20:4 --times b=0:5"
        " --also 'information,quantile 0.9,worst_instant'"
    ),
    "limits": (
        f"{_SENSORS} --set problem.sensors.immunoassay.fails=0.1"
        " --set problem.sensors.immunoassay.repeats=2 --set problem.sensors.chromatography.most=1"
    ),
    "worst_scenario": f"{_SENSORS} --set scenarios.criterion=worst",
}
ROUNDED = ("constrained", "linear_gaussian")
"""Jobs of the Kalman filter: its matrix products are rounded differently on other processors."""

Summary = str | list[float]
"""What is kept of a column: a digest of its sorted values, or their count and four moments."""


@pytest.mark.golden
@pytest.mark.parametrize("job", COMMANDS)
def test_the_numbers_of_the_tables_are_those_that_were_kept(
    job: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A plan leaves a bound out that takes long, as on a busy machine.
    monkeypatch.setattr("pfdist.questions.run.PATIENCE", 10**6)
    for command in COMMANDS[job].split("; "):
        words = [word.format(jobs=ROOT / "jobs") for word in shlex.split(command)]
        words += ["--no-report"] * (words[0] != "rule")
        assert main([*words, "--results", str(tmp_path), "--pool", "serial"]) == 0
    if job in ("plan", "blood"):
        check_readme(tmp_path)
    now = summaries(tmp_path, rounded=job in ROUNDED)
    if request.config.getoption("--keep-golden"):
        keep(job, now)
    kept = json.loads(KEPT.read_text())[job]
    missing = [label for label in kept if not is_found(label, kept, now)]
    assert not missing, f"no column has the numbers that these columns had: {missing}"


def check_readme(run: Path) -> None:
    """The README claims no more than the plan says: its numbers are of all evenly spaced sets."""
    rows = {row["label"]: row for row in open_run(run).as_json()["sets"]}
    plan, readme = rows["plan"], " ".join((ROOT / "README.md").read_text("utf-8").split())
    readme = readme.replace("**", "")
    number = "21" if plan["measurements"] == 21 else "Six"
    [claimed] = re.findall(rf"{number} chosen measurements do as well as (\d+) evenly", readme)
    assert plan["measurements"] < int(claimed) <= plan["evenly_spaced"]
    lower = f"{100 * plan['gain_of_means']:.0f} % lower than with the best 21"
    assert plan["measurements"] != 21 or f"The expected MSE is {lower} evenly spaced" in readme
    assert f"by more than a further {100 * rounded_up(plan['bound_gap_at_most']):.2g} %" in readme


def keep(job: str, numbers: dict[str, Summary]) -> None:
    everything = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    everything[job] = numbers
    KEPT.write_text(json.dumps(everything, indent=0) + "\n")


def is_found(label: str, kept: dict[str, Summary], now: dict[str, Summary]) -> bool:
    """Whether some column has the numbers of a kept column, or several have those of its parts."""
    if any(is_same(kept[label], summary) for summary in now.values()):
        return True
    parts = [part for part in kept if part.startswith(f"{label} where ")]
    return bool(parts) and all(is_found(part, kept, now) for part in parts)


def is_same(kept: Summary, now: Summary) -> bool:
    if isinstance(kept, str) or isinstance(now, str):
        return kept == now
    return all(
        math.isclose(before, after, rel_tol=1e-10, abs_tol=1e-300)
        for before, after in zip(kept, now, strict=True)
    )


def summaries(results: Path, rounded: bool) -> dict[str, Summary]:
    """Summary of every column of numbers under a folder of results, whole and in parts."""
    found: dict[str, Summary] = {}
    files = (file for file in results.rglob("tables/*/*.parquet") if file.is_file())
    for table in sorted({file.parent for file in files}):
        if table.name == "timings":
            continue
        frame = pd.read_parquet(table)
        run = table.parents[1].relative_to(results).as_posix()
        for part, rows in parts_of(frame):
            for name in frame.columns:
                if (values := numbers_in(rows[name])) is not None:
                    label = f"{run}/{table.name}.{name}".removeprefix("./")
                    found[f"{label}{part}"] = moments_of(values) if rounded else digest_of(values)
    return found


def parts_of(frame: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """The table, and its rows for each value of each column of text that has few values."""
    yield "", frame
    for name in frame.columns:
        if is_string_dtype(frame[name].dropna()) and 1 < frame[name].nunique() <= MOST_PARTS:
            for value, rows in frame.groupby(name):
                yield f" where {name} is {value}", rows


def numbers_in(column: pd.Series) -> list[tuple[float, ...]] | None:
    """The numbers of each row; None for text."""
    column = column.dropna()
    if column.empty:
        return None
    if is_numeric_dtype(column) and not is_bool_dtype(column):
        return [(float(value),) for value in column]
    if isinstance(first := column.iloc[0], np.ndarray) and is_numeric_dtype(first.dtype):
        return [tuple(map(float, value)) for value in column]
    return None


def digest_of(rows: list[tuple[float, ...]]) -> str:
    digest = sha256()
    for row in sorted(rows):
        digest.update(len(row).to_bytes(8, "little") + np.array(row, "<f8").tobytes())
    return digest.hexdigest()[:32]


def moments_of(rows: list[tuple[float, ...]]) -> list[float]:
    values = [value for value in chain.from_iterable(rows) if math.isfinite(value)]
    sums = math.fsum(map(abs, values)), math.fsum(value * value for value in values)
    return [float(len(values)), *sums, min(values, default=0.0), max(values, default=0.0)]
