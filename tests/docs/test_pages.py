"""Everything that the README and the manual tell a reader to type can be typed, and runs."""

import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from doctest import ELLIPSIS, OutputChecker
from pathlib import Path
from typing import Any

import matplotlib.image
import pandas as pd
import pytest
from matplotlib import pyplot

import pfdist
from pfdist.cli.main import main
from pfdist.cli.parser import make_parser
from pfdist.search.methods import DEFAULT_METHOD

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*ROOT.glob("*.md"), *DOCS.glob("*.md"), ROOT / "results" / "README.md"]
COMMAND = re.compile(r"(?:`|^ *|&& )pfdist ([a-z][^`\n#]*)(?:`| *$|  +#)", re.MULTILINE)
NAMED_ALONE = re.compile(r"[a-z-]+")  # `pfdist plan`: the page speaks of the command
VALUES = {"COMMAND": "run", "SHELL": "bash", "TIMES": "0:60:3", "NUMBERS": "5:41"}  # for words
PROSE = ("pfdist finds", "pfdist needs")  # sentences of the README that begin a line
SECONDS = 600  # for a cell of the notebook, on a machine with other work


def _blocks(page: Path, language: str = r"\w+") -> list[tuple[str, str]]:
    """Blocks of code of a page: language and text."""
    text = page.read_text(encoding="utf-8")
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


@pytest.mark.parametrize("command", _commands())
def test_a_command_of_the_manual_is_accepted(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = shlex.split(command.partition(" > ")[0])
    if NAMED_ALONE.fullmatch(command):
        words.append("--help")
    code: object = 0
    try:
        make_parser().parse_args([VALUES.get(word, word) for word in words])
    except SystemExit as ended:
        code = ended.code
    assert code == 0, capsys.readouterr().err


def test_commands_are_found_in_the_manual() -> None:
    assert {"run jobs/paper.toml", "why JOB", "models"} <= set(_commands())


@pytest.mark.zoo
@pytest.mark.usefixtures("no_figures")
def test_the_model_and_the_job_of_the_readme_are_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for language, file in (("python", "mine.py"), ("toml", "mine.toml")):
        (tmp_path / file).write_text(_blocks(ROOT / "README.md", language)[0][1])
    draws = f"search.{DEFAULT_METHOD}.evaluation.draws=20"
    few = ["filter.particles=50", "comparison.draws=40", draws]
    results = ["--pool", "serial", "--results", str(tmp_path / "run"), "--bound-draws", "0"]
    assert main(["plan", str(tmp_path / "mine.toml"), *results, "--set", *few]) == 0
    printed = capsys.readouterr().out
    times = re.search(r"Measure at t = ([\d,\s]+)\.", printed)
    assert times is not None, printed
    found = [int(time) for time in times[1].split(",")]
    assert len(found) == 10
    assert not set(found) & set(range(20, 31))


@pytest.mark.slow
def test_the_worked_example_prints_what_its_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    commands = 0
    for language, text in _blocks(DOCS / "example.md"):
        first, _, rest = text.partition("\n")
        if first.startswith("# "):  # a file of this name
            Path(first.removeprefix("# ")).write_text(rest, encoding="utf-8")
        elif language == "console":
            assert main(shlex.split(first.removeprefix("$ pfdist "))) == 0
            printed = capsys.readouterr().out
            if not OutputChecker().check_output(rest, printed, ELLIPSIS):
                pytest.fail(f"{first}\nprints\n{printed}\nand not\n{rest}")
            commands += 1
        else:
            exec(compile(text, "example.md", "exec"), {})
    assert commands == 4
    assert Path("lake.filtered.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "model"), [("densities", "photons"), ("models", "vane"), ("guided", "echo")]
)
def test_the_model_of_a_page_is_checked_as_the_page_shows(
    page: str,
    model: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = [text for _, text in _blocks(DOCS / f"{page}.md")]
    (code,) = (text for text in blocks if text.startswith(f"# {model}.py"))
    (console,) = (text for text in blocks if text.startswith(f"$ pfdist check-model {model}.py"))
    file, _, source = code.partition("\n")
    Path(file.removeprefix("# ")).write_text(source, encoding="utf-8")
    command, _, shown = console.partition("\n")
    assert main(shlex.split(command.removeprefix("$ pfdist "))) == 0
    printed = capsys.readouterr().out
    assert OutputChecker().check_output(shown, printed, ELLIPSIS), printed


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_the_tables_of_a_run_are_read_without_pfdist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    [code, *_] = [text for _, text in _blocks(DOCS / "dataframes.md", "python")]
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["gain"] == pytest.approx(0.2905, abs=1e-4)  # as README.md prints it
    assert len(names["cheapest"]) == 5


@pytest.mark.notebook
def test_duckdb_polars_and_xarray_read_what_pandas_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    draws = pd.read_parquet("results/example/tables/comparison")
    names: dict[str, Any] = {}
    for _, text in _blocks(DOCS / "dataframes.md", "python"):
        exec(text, names)
    assert names["means"]["mse_regular"][0] == pytest.approx(draws["mse_regular"].mean())
    assert names["error"].sizes == {"time": 61, "set": 3}
    assert float(names["mean_gain"].sel(set="relaxation")) == pytest.approx(0.2734, abs=1e-4)


@pytest.mark.slow
def test_the_page_about_particles_prints_and_draws_what_it_shows(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    [(_, console)] = _blocks(DOCS / "particles.md", "console")
    command, _, shown = console.partition("\n")
    assert main(shlex.split(command.removeprefix("$ pfdist "))) == 0
    printed = capsys.readouterr().out
    assert OutputChecker().check_output(shown, printed, ELLIPSIS), printed
    [(_, code)] = _blocks(DOCS / "particles.md", "python")
    names = dict[str, Any]()
    exec(compile(code, "particles.md", "exec"), names)
    assert names["axes"].has_data()
    assert names["losses"]["particle_loss"].is_monotonic_decreasing
    [(_, section)] = _blocks(DOCS / "particles.md", "toml")
    assert tomllib.loads(section) == {"filter": {"particles": "auto"}}


@pytest.mark.slow
def test_the_page_about_python_draws_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "tests" / "assets" / "schema-3", "results/quick")
    over = {"problem.measurement_budget": [3, 4], "filter.particles": [20, 40], "seed": [1, 2]}
    exact = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=20"]
    pfdist.sweep(ROOT / "tests/small.toml", over, results="results/budgets", changes=exact)
    names: dict[str, object] = {}
    _, *blocks = _blocks(DOCS / "python.md", "python")
    for _, text in blocks:
        exec(compile(text, "python.md", "exec"), names)
    assert len(pyplot.get_fignums()) == 9
    assert Path("mine.pdf").read_bytes().count(b"/FontFile2")  # TrueType fonts are embedded


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
    assert run.path == Path("results/robot")
    for times in run.sets.values():
        assert len(times) == 5
        assert not set(times) & set(range(8, 12))
    gains = run.table("gains")
    assert isinstance(gains, pd.DataFrame)
    assert len(gains) == 2000
    changes = ["comparison.draws=2000"]
    found_worth = pfdist.why(scope["problem"], 500, changes=changes, figures=False).worth
    pd.testing.assert_frame_equal(found_worth, run.table("worth"))


@pytest.mark.slow
def test_the_example_of_the_page_about_sweeps_draws_the_loss_of_wrong_beliefs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times found for the true model lose nothing."""
    [example] = [code for _, code in _blocks(DOCS / "sweep.md", "python") if "heat_map" in code]
    whole = pfdist.sweep
    changes = ("problem.horizon=12", "problem.measurement_budget=4", "filter.particles=30")
    changes += ('search=[{method="random", evaluations=3}]', "evaluation.draws=20")
    changes += ("comparison.draws=60",)

    def small(file: str) -> pfdist.Sweep:
        assert (ROOT / file).is_file()
        keys = ("model.parameters.process_sd", "model.filter.parameters.process_sd")
        return whole(
            ROOT / "jobs" / "plan.toml", {key: [0.5, 2.0] for key in keys}, judge=True,
            pool="serial", results=tmp_path / "sweep", changes=changes, report=False,
        )  # fmt: skip

    monkeypatch.setattr(pfdist, "sweep", small)
    names: dict[str, Any] = {"pfdist": pfdist}
    exec(example, names)
    wrong = names["wrong"]
    assert len(wrong) == 4
    is_right = wrong[names["truth"]] == wrong[names["believed"]]
    assert (wrong.loc[is_right, "loss"] == 0).all()
    [axes, _] = pyplot.gcf().axes
    assert axes.get_xlabel() == "model.parameters.process_sd"


@pytest.mark.notebook
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


def test_contributing_names_every_mark_of_tests() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    marks = {mark.partition(":")[0] for mark in settings["markers"]}
    named = re.findall(r"`pytest -m (\w+)`", (ROOT / "CONTRIBUTING.md").read_text())
    assert sorted(named) == sorted(marks)


@pytest.mark.slow
def test_the_page_about_sensors_prints_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The model, the job, the plan and the next measurement of the page."""
    monkeypatch.chdir(tmp_path)
    consoles = 0
    for language, text in _blocks(DOCS / "sensors.md"):
        first, _, rest = text.partition("\n")
        if language == "text":
            Path("case.csv").write_text(text)
        elif language == "console":
            assert main(shlex.split(first.removeprefix("$ pfdist "))) == 0
            printed = capsys.readouterr().out
            assert OutputChecker().check_output(rest, printed, ELLIPSIS), printed
            consoles += 1
        else:
            Path(first.removeprefix("# ")).write_text(rest)
    assert consoles == 2
