"""Everything that the README and the manual tell a reader to type can be typed, and runs."""

import ast
import inspect
import json
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from doctest import ELLIPSIS, OutputChecker
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

import pfdist
from oracles.in_turn import in_turn
from pfdist import load_model
from pfdist.cli.main import main
from pfdist.cli.program import line_of
from pfdist.filters.simulation import simulate
from pfdist.models.loader import installed_models
from pfdist.plugins.online.section import Online

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*ROOT.glob("*.md"), *DOCS.glob("*.md"), ROOT / "results" / "README.md"]
COMMAND = re.compile(r"(?:`|^ *|&& )pfdist ([a-z][^`\n#]*)(?:`| *$|  +#)", re.MULTILINE)
NAMED_ALONE = re.compile(r"[a-z-]+")  # `pfdist plan`: the page speaks of the command
VALUES = {"COMMAND": "run", "SHELL": "bash", "TIMES": "0:60:3", "NUMBERS": "5:41"}  # for words
VALUES |= {"[RUN": "RUN", "...]": "RUN"}
A_FILE = re.compile(r"# (\w+\.(?:py|toml|csv))")  # the first line of a block that is a file
PAGES_PLAYED = (
    "choose-model", "cookbook", "densities", "example", "filter", "index", "online", "particles",
    "questions", "robust", "sensors",
)  # fmt: skip
PROSE = ("pfdist finds", "pfdist needs")  # sentences of the README that begin a line
SECONDS = 600  # for a cell of the notebook, on a machine with other work


def _blocks(page: Path, language: str = r"\w+", section: str = "") -> list[tuple[str, str]]:
    """Blocks of code of a page, or of a section whose title begins so: language and text."""
    text = page.read_text(encoding="utf-8")
    if section:
        [text] = re.findall(rf"^## {section}.*?(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    return re.findall(rf"^```({language})\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    pyplot.close("all")  # other tests may have left figures open
    with pyplot.style.context("default"):
        yield
    pyplot.close("all")


def _commands() -> list[str]:
    texts = [page.read_text(encoding="utf-8") for page in PAGES if page.name != "CHANGELOG.md"]
    found = {match.strip() for text in texts for match in COMMAND.findall(text)}
    return sorted(command for command in found if not f"pfdist {command}".startswith(PROSE))


@in_turn("command", _commands())
def test_a_command_of_the_manual_is_accepted(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = shlex.split(command.partition(" > ")[0])
    if NAMED_ALONE.fullmatch(command):
        words.append("--help")
    line = line_of([VALUES.get(word, word) for word in words])
    assert (line is None) is bool(capsys.readouterr().out)  # the help was printed, or it is a line


def test_commands_are_found_in_the_manual() -> None:
    assert {"run jobs/paper.toml", "why JOB", "models"} <= set(_commands())


def test_the_model_of_the_readme_is_that_of_its_first_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    [code] = re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    assert code == (ROOT / "jobs" / "blood.py").read_text(encoding="utf-8")
    assert "pfdist plan jobs/blood.toml" in text
    assert pfdist.load_job(ROOT / "jobs" / "blood.toml").problem.measurement_budget == 6


def _play(
    page: str, capsys: pytest.CaptureFixture[str], section: str = "", **names: Any
) -> dict[str, Any]:
    """Do in the working directory what a page or a section does, from first block to last.

    Blocks that begin with the name of a file, as in ``# lake.py``, become this file. A command of
    a console must print the lines below it; ``...`` stands for anything. Python code runs with the
    names of earlier code, which are given in the end. Other blocks are not played.
    """
    for language, text in _blocks(DOCS / f"{page}.md", section=section):
        first, _, rest = text.partition("\n")
        if file := A_FILE.fullmatch(first):
            Path(file[1]).write_text(rest, encoding="utf-8")
        elif language == "python":
            exec(compile(text, f"{page}.md", "exec"), names)
            capsys.readouterr()
        elif language == "console":
            for console in re.split(r"^\$ pfdist ", text, flags=re.MULTILINE)[1:]:
                command, _, shown = console.partition("\n")
                assert main(shlex.split(command)) == 0
                printed = capsys.readouterr().out
                if not OutputChecker().check_output(shown, printed, ELLIPSIS):
                    pytest.fail(f"pfdist {command}\nprints\n{printed}\nand not\n{shown}")
    return names


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the jobs, and with the finished run of jobs/quick.toml."""
    monkeypatch.chdir(tmp_path)
    # A plan leaves a bound out that takes long, as on a busy machine.
    monkeypatch.setattr("pfdist.questions.run.PATIENCE", 10**6)
    shutil.copytree(ROOT / "jobs", "jobs")
    shutil.copytree(ROOT / "results" / "example", "results/quick")
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("checkout")
@pytest.mark.filterwarnings("ignore:The estimate is that of a few particles")  # y fits no model
@pytest.mark.parametrize("page", PAGES_PLAYED)
def test_a_page_prints_what_it_shows(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert _blocks(DOCS / f"{page}.md", "console|python")
    _play(page, capsys, measure_at=lambda t: 0.3 * t)  # what a planner of a page measures


def test_the_job_of_the_page_about_online_times_has_the_settings_of_the_page() -> None:
    assert pfdist.load_job(ROOT / "jobs" / "online.toml").online == Online()


def test_the_scenarios_of_the_page_are_those_of_the_job() -> None:
    [(_, section)] = _blocks(DOCS / "robust.md", "toml")
    job = tomllib.loads((ROOT / "jobs" / "two_compartments.toml").read_text(encoding="utf-8"))
    assert tomllib.loads(section)["scenarios"] == job["scenarios"]


def test_the_page_about_jobs_shows_a_clock_and_sets_that_a_job_may_have(tmp_path: Path) -> None:
    _, (_, clock), (_, dates), (_, sets) = _blocks(DOCS / "job-file.md", "toml")
    file = tmp_path / "job.toml"
    file.write_text(f"seed = 1\n{sets}\n[problem]\nhorizon = 60\nmeasurement_budget = 4\n")
    assert set(pfdist.load_job(file).comparison.sets) == {"clinic", "paper", "regular"}
    file.write_text(f"seed = 1\n{clock}")
    assert pfdist.load_job(file).problem.clock.unit == "h"
    file.write_text(f"seed = 1\n{dates}")
    problem = pfdist.load_job(file).problem
    assert problem.clock.time_unit == "min since 2026-04-01T08:00 Europe/Brussels"
    assert problem.clock.horizon * 30 == problem.horizon == 20160  # the page says so
    allowed = problem.points.written_of(problem.feasible.allowed)
    assert (allowed[0], allowed[-1]) == ("2026-04-01T08:00", "2026-04-15T08:00")
    assert "2026-04-06T12:00" not in allowed  # Easter Monday


@pytest.mark.slow
def test_the_model_with_angles_is_checked_as_its_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = [text for _, text in _blocks(DOCS / "models.md")]
    (code,) = (text for text in blocks if text.startswith("# vane.py"))
    (console,) = (text for text in blocks if text.startswith("$ pfdist check-model vane.py"))
    Path("vane.py").write_text(code, encoding="utf-8")
    command, _, shown = console.partition("\n")
    printed = said(*shlex.split(command.removeprefix("$ pfdist ")))
    assert OutputChecker().check_output(shown, printed, ELLIPSIS), printed


@pytest.mark.parametrize(
    ("page", "file"),
    [
        ("models.md", "tank.py"),
        ("simulators.md", "cell.py"),
        pytest.param("simulators.md", "growth.py", marks=pytest.mark.recipes),
    ],
)
def test_a_model_of_a_page_is_a_model(page: str, file: str, tmp_path: Path) -> None:
    (code,) = (text for _, text in _blocks(DOCS / page) if text.startswith(f"# {file}"))
    (tmp_path / file).write_text(code, encoding="utf-8")
    model = load_model(f"{tmp_path / file}:model")
    assert np.isfinite(simulate(model, 20, range(10), 0).z).all()


REAL_DATA = {
    "A day": {
        "start of temperature": 4.39,
        "start of demand": 0.332,
        "correlation of temperature": 0.18,
        "correlation of demand": 0.71,
    },
    "A year": {"start_sd": 0.154, "kept": 0.944, "disturbance_sd": 0.182, "error_sd": 0.265},
    "A drug": {
        "v1": 5.0,
        "v2": 11.6,
        "v3": 12.6,
        "cl": 2.6,
        "q2": 2.4,
        "q3": 0.086,
        "age_effect": -0.0078,
        "error_sd": 0.167,
    },
}
"""Numbers of the code that the text names."""


@pytest.mark.recipes
@pytest.mark.parametrize("section", REAL_DATA)
def test_a_section_about_real_data_prints_what_it_shows(
    section: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Particles make the fit of remifentanil differ a little between versions."""
    monkeypatch.chdir(tmp_path)
    names = _play("real-data", capsys, section)
    tolerance = 0.1 if section == "A drug" else 0.02
    assert names["in_words"] == pytest.approx(REAL_DATA[section], rel=tolerance)


@pytest.mark.recipes
def test_the_page_of_budgets_prints_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four trips with two samples each; one radar; a sensor that is not worth its installation."""
    monkeypatch.chdir(tmp_path)
    _play("budgets", capsys)
    problems = {
        name: pfdist.load_job(f"{name}.toml").problem for name in ("lake", "radar", "energy")
    }
    feasible = {name: problem.feasible for name, problem in problems.items()}
    assert problems["lake"].by_parts(feasible["lake"].regular()).startswith("in 4 visits. ")
    assert problems["radar"].broken(["3 immunoassay", "3 chromatography"])
    assert feasible["energy"].price_of((0, 2)) == 42
    assert "UID" in Path("clinic.ics").read_text()


def test_the_models_to_start_from_are_those_that_ship() -> None:
    named = set(re.findall(r"`(\w+)`", (DOCS / "choose-model.md").read_text(encoding="utf-8")))
    assert set(installed_models()) <= named


def test_each_name_of_the_library_has_an_example_that_could_run() -> None:
    """The examples are Python, and their arguments are those of the functions."""
    rows = re.findall(
        r"^\| \[`(\w+)`\]\(\S+\) \| `(.+?)` \|", (DOCS / "python.md").read_text(), re.M
    )
    assert {name for name, _ in rows} == set(pfdist.__all__)
    for _, example in rows:
        for call in ast.walk(ast.parse(example)):
            name = ast.unparse(call.func) if isinstance(call, ast.Call) else ""
            if isinstance(call, ast.Call) and re.fullmatch(r"pfdist(\.\w+)+", name):
                function = eval(name, {"pfdist": pfdist})
                keywords = {word.arg: None for word in call.keywords if word.arg}
                inspect.signature(function).bind_partial(*call.args, **keywords)


def test_no_line_of_the_manual_is_a_comment_that_nobody_sees() -> None:
    """A line that begins with %, for instance that of ``95 % limit``, is a comment of the site."""
    hidden = {
        page.name: lines
        for page in [*DOCS.glob("*.md"), *ROOT.glob("*.md")]
        if (lines := re.findall(r"^ *%.*$", page.read_text(encoding="utf-8"), re.MULTILINE))
    }
    assert hidden == {}


def test_every_page_that_a_text_names_exists() -> None:
    """Links are tested on the site; a page is also named in plain text, and in messages."""
    texts = [page for page in PAGES if page.name != "CHANGELOG.md"]
    texts += (ROOT / "pfdist").rglob("*.py")
    missing = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in texts
        for name in re.findall(r"(?<![\w*])[\w./-]+\.md\b", path.read_text(encoding="utf-8"))
        if not any((folder / name).is_file() for folder in (path.parent, ROOT, DOCS))
    ]
    assert missing == []
    assert sum(path.suffix == ".py" for path in texts) > 100


def test_every_file_of_python_that_a_script_names_exists() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in (ROOT / ".ci").iterdir())
    named = {*re.findall(r"\b(?:tests|docs|pfdist)/[\w/]+\.py\b", text)}
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []
    assert len(named) > 8


def test_the_manual_is_short() -> None:
    """Pages of the sidebar, and their words outside of code and made tables."""
    lists = re.findall(
        r"(?s)^```{toctree}.*?^:hidden:\n(.*?)^```", (DOCS / "index.md").read_text(), re.M
    )
    assert len("".join(lists).split()) <= 34
    others = {"architecture", "benchmarks", "changes", "contributing", "notebook", "security"}
    texts = (
        page.read_text(encoding="utf-8") for page in DOCS.glob("*.md") if page.stem not in others
    )
    made = re.compile(r"(?ms)<!-- table: .*?<!-- end -->|^```.*?^```")
    assert sum(len(made.sub("", text).split()) for text in texts) <= 25_000


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 100


def test_a_reviewer_finds_what_the_page_about_claims_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Callable[..., str]
) -> None:
    """On a copy of the run that is committed; the same bytes are found by the files' hashes."""
    [(_, block)] = _blocks(DOCS / "claims.md", "console")
    typed = [line.partition(" #")[0].removeprefix("$ ").split() for line in block.splitlines()]
    by_name = {line[1]: line[1:] for line in typed if line[0] == "pfdist"}
    assert [*by_name] == ["verify", "run", "compare", "bound"]
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "results" / "example", "RUN")
    assert "all files are unchanged" in said(*by_name["verify"])
    said(*by_name["run"], "--no-report")
    found, again = (
        {
            file.name: file.read_bytes()
            for file in Path(run, "tables").rglob("*.parquet")
            if file.parent.name != "timings"
        }
        for run in ("RUN", "again")
    )
    assert found == again
    fresh = said(*by_name["compare"], "--no-report")
    assert "the set relaxation" in fresh
    means = [pd.read_parquet(f"{run}/tables/comparison").mean() for run in ("RUN", "fresh")]
    assert means[0]["mse_relaxation"] != means[1]["mse_relaxation"]
    assert means[1]["mse_relaxation"] < 0.87 * means[1]["mse_evenly_spaced"]
    assert "Proved: no other 21 times" in said(*by_name["bound"], "--draws", "480")
    paragraph = " ".join(said("status", "RUN", "--verbose").split())
    assert "We looked for the measurement times" in paragraph
    assert "Nothing was proved" not in paragraph


def test_the_tables_of_a_run_are_read_without_pfdist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    [code, *_] = [text for _, text in _blocks(DOCS / "python.md", "python", "Tables")]
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["gain"] == pytest.approx(0.1512, abs=1e-4)  # as README.md prints it
    assert len(names["cheapest"]) == 5


def test_after_dropout_late_visits_lose_what_the_page_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exact: the Gaussian error of each prefix of the visits, times its probability."""
    t = np.arange(13)
    covariance = 0.25 + 0.0225 * (np.outer(t, t) + np.minimum.outer(t, t))

    def error(made: list[int]) -> float:
        known = covariance[np.ix_(made, made)] + 0.09 * np.eye(len(made))
        explained = covariance[:, made] @ np.linalg.solve(known, covariance[made])
        return float(np.diag(covariance - explained).mean())

    def with_dropout(visits: list[int]) -> float:
        still = [1.0, *(0.9**visit for visit in visits), 0.0]
        each = zip(still[:-1], still[1:], range(len(visits) + 1), strict=True)
        return sum((here - later) * error(visits[:n]) for here, later, n in each)

    names = _play("cookbook", capsys, "After dropout", pfdist=pfdist)
    for key, visits in (("early", [1, 3, 7]), ("late", [7, 10, 12])):
        found = names[key]
        right = with_dropout(visits)
        assert abs(found.expected_mse - right) <= 4 * found.standard_error + 0.02 * right
    assert with_dropout([7, 10, 12]) / with_dropout([1, 3, 7]) == pytest.approx(1.58, abs=0.03)


def test_that_a_battery_sends_nothing_says_that_it_is_in_use(
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {"pfdist": pfdist, "normal_logpdf": pfdist.densities.normal_logpdf, "np": np}
    found = _play("cookbook", capsys, "Only at rest", **names)
    told, untold = found["told"], found["untold"]
    assert 1.6 < untold.expected_mse / told.expected_mse < 2.1  # nearly twice
    resting = pfdist.Filter(found["resting"], 2000, seed=1)
    resting.update(0, 3.9)
    unasked = resting.predict(6).standard_deviation[0]
    for t in (2, 4, 6):
        asked = resting.update(t, np.nan).standard_deviation[0]
    assert asked < 0.5 * unasked


def test_a_satellite_that_is_not_seen_is_behind_the_hill(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The share of the angles that are hidden at both times: those of a fixed rate, enumerated."""
    names = {"pfdist": pfdist, "normal_logpdf": pfdist.densities.normal_logpdf, "np": np}
    estimate = _play("cookbook", capsys, "Line of sight", **names)["estimate"]
    start = np.linspace(0.0, 2 * np.pi, 100_000, endpoint=False)
    hidden = start[(np.cos(start) <= 0.5) & (np.cos(start + 1.5) <= 0.5)]
    centre = np.angle(np.exp(1j * (hidden + 1.5)).mean())
    assert abs(np.angle(np.exp(1j * (estimate.mean[0] - centre)))) < 0.1
    low, high = (float(np.cos(each)) for each in estimate.quantiles([0.05, 0.95]).ravel())
    assert max(low, high) < 0.5


def test_a_model_of_past_records_predicts_other_records_as_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its errors are those of the Gaussian formula; held-out days have them within chance."""
    monkeypatch.chdir(tmp_path)
    quick = {"figures": False, "bound_draws": 0}
    names = _play("cookbook", capsys, "Only past records", pfdist=pfdist, quick=quick)
    days, model, run = names["days"], names["past"], names["run"]
    draws = simulate(model, 23, range(4000), 1).z[:, :, 0]
    times = [*run.best.measurement_times]
    exact = float(names["errors"][run.best.name])
    known = np.cov(draws, rowvar=False)  # of 4,000 simulated days: within some per cent
    gain = known[:, times] @ np.linalg.inv(known[np.ix_(times, times)] + 0.01 * np.eye(4))
    assert np.diag(known - gain @ known[times]).mean() == pytest.approx(exact, rel=0.1)
    mean, other = days[::2].mean(axis=0), days[1::2]
    read = other[:, times] + 0.1 * np.random.default_rng(3).normal(size=(100, 4))
    left = ((mean + (read - mean[times]) @ gain.T - other) ** 2).mean(axis=1)
    assert abs(left.mean() - exact) < 4 * left.std() / 10
    between = np.array([np.interp(np.arange(24), times, row) for row in read])
    assert ((between - other) ** 2).mean() > 3 * exact
    assert (round(exact, 3), times) == (0.129, [8, 12, 16, 21])  # the page says so
    assert round(((between - other) ** 2).mean(), 2) == 0.56
    assert exact == pytest.approx(names["errors"]["evenly_spaced"])


@pytest.mark.notebook
@pytest.mark.needs("notebook")
def test_duckdb_and_polars_read_what_pandas_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    draws = pd.read_parquet("results/example/tables/comparison")
    names: dict[str, Any] = {}
    for _, text in _blocks(DOCS / "python.md", "python", "Tables"):
        exec(text, names)
    assert names["means"]["mse_evenly_spaced"][0] == pytest.approx(
        draws["mse_evenly_spaced"].mean()
    )


@pytest.mark.plugins("sweep")
@pytest.mark.slow
def test_the_page_about_python_draws_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "tests" / "assets" / "kept", "results/quick")
    over = {"problem.measurement_budget": [3, 4], "filter.particles": [20, 40], "seed": [1, 2]}
    exact = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=20"]
    pfdist.sweep(ROOT / "tests/small.toml", over, results="results/budgets", changes=exact)
    names: dict[str, object] = {}
    for _, text in _blocks(DOCS / "python.md", "python", "Figures"):
        exec(compile(text, "python.md", "exec"), names)
    assert len(pyplot.get_fignums()) == 7
    assert Path("mine.pdf").read_bytes().count(b"/FontFile2")  # TrueType fonts are embedded


@pytest.mark.plugins("why")
@pytest.mark.slow
@pytest.mark.usefixtures("ray_cluster")
def test_the_example_of_the_page_about_python_runs_and_its_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    [(_, code), *_] = _blocks(DOCS / "python.md", "python")
    script, scope = tmp_path / "script.py", {"__name__": "__main__"}
    script.write_text(code, encoding="utf-8")  # the source of the model's formulas
    exec(compile(code, script, "exec"), scope)
    run: Any = scope["run"]
    assert isinstance(run, pfdist.Run)
    assert run.path == Path("results/drifting").absolute()
    for times in run.sets.values():
        assert len(times) == 5
        assert not set(times) & set(range(8, 12))
    gains = run.table("gains")
    assert isinstance(gains, pd.DataFrame)
    assert len(gains) == 2000
    changes = ["comparison.draws=2000"]
    found_worth = pfdist.why(scope["problem"], 500, changes=changes, figures=False).worth
    pd.testing.assert_frame_equal(found_worth, run.table("worth"))


@pytest.mark.notebook
@pytest.mark.needs("notebook")
def test_in_the_notebook_a_model_is_written_planned_compared_and_plotted_without_a_file(
    tmp_path: Path,
) -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(DOCS / "notebook.ipynb", as_version=4)
    NotebookClient(
        notebook, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [
        output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])
    ]
    assert sum("image/png" in data for data in outputs) == 4
    tables = [data["text/html"] for data in outputs if "text/html" in data]
    assert any("relaxation" in table for table in tables)
    assert any("six_hours" in table and "first_wins" in table for table in tables)
    assert not list(tmp_path.glob("*.py")) + list(tmp_path.glob("*.toml"))
    assert (tmp_path / "results" / "tank" / "tables").is_dir()


def test_the_page_of_the_notebook_has_its_code_and_its_outputs() -> None:
    cells = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]).rstrip(";") for cell in cells if cell["cell_type"] == "code"]
    assert [text.strip() for _, text in _blocks(DOCS / "notebook.md", "python")] == code
    page = (DOCS / "notebook.md").read_text(encoding="utf-8")
    assert page.count("](figures/notebook-") == 5
    assert page.count("<table") >= 4


def test_a_figure_of_a_benchmark_is_drawn_from_the_tables_that_lie_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from benchmarks import genetic  # no part of the package, so the wheel's tests have none
    from benchmarks.__main__ import FOLDER, main

    monkeypatch.setattr(genetic, "measure", lambda quick, say: pytest.fail("it measures"))
    shutil.copy(FOLDER / "genetic.csv", tmp_path)
    assert main(["genetic", "peers", "--redraw", "--results", str(tmp_path)]) == 0
    names = sorted(file.name for file in tmp_path.iterdir())
    assert names == ["genetic.csv", "genetic.png"]  # the tables of peers are not there
    assert matplotlib.image.imread(tmp_path / "genetic.png").shape[0] > 400


@pytest.mark.parametrize(
    ("problem", "count"), [("paper", 21), ("tumour", 11), ("linear_gaussian, short", 5)]
)
def test_benchmarks_read_the_best_set_known(problem: str, count: int) -> None:
    from benchmarks.search_runs import best_known  # no part of the package

    sets = best_known(problem)
    assert sets
    for times in sets:
        assert len(times) == count
        assert list(times) == sorted({*times})


def test_contributing_names_every_mark_of_tests() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    marks = {re.split(r"\W", mark)[0] for mark in settings["markers"]}
    named = re.findall(r"`pytest -m (\w+)`", (ROOT / "CONTRIBUTING.md").read_text())
    assert sorted(named) == sorted(marks)
