"""The report of a run says what the tables say and support; no file of a run becomes markup."""

import json
import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import pfdist
from oracles.listed import rewrite
from oracles.results_of import results_of
from pfdist import Job
from pfdist.cli.main import main
from pfdist.common import stopping
from pfdist.common.changes import effect
from pfdist.common.parts import Page
from pfdist.common.percent import gap_sentence, percent
from pfdist.errors import StoreError
from pfdist.problem.set_key import phrase_of
from pfdist.questions.about_run import _LOAD
from pfdist.questions.run_page import page_of, searches_section
from pfdist.questions.subject import Subject
from pfdist.results.sampling_windows import windows_of
from pfdist.results.stored_run import problem_of
from pfdist.store.verify import verify_run

MODEL = ("model.name=random_walk", "filter.engine=kalman")
EXACT = (*MODEL, "comparison.draws=30", "search=[{method='genetic', generations=1}]")
BOUND = {"budget": 4, "bound_error": 0.0, "gap": 0.1, "gap_at_most": 0.1, "confidence": 0.95}
See = Callable[[pfdist.Run], Any]  # the page of a run
Make = Callable[..., pfdist.Run]


@pytest.fixture
def exact(small_job: Job) -> Job:
    return small_job.with_changes(EXACT)


@pytest.fixture
def make(finished: Callable[..., Path], tmp_path: Path) -> Make:
    """A copy of the finished run of the exact job with other changes."""

    def copy(*changes: str, name: str = "run") -> pfdist.Run:
        run = shutil.copytree(finished(*EXACT, *changes), tmp_path / name)
        return pfdist.open_run(run)

    return copy


@pytest.fixture
def run(make: Make) -> pfdist.Run:
    return make()


def _text(run: pfdist.Run) -> str:
    return str(page_of(run))


def _again(run: pfdist.Run) -> list[str]:
    """Run the job of a finished run again, for its report; give what is said."""
    said = list[str]()
    pfdist.run(run.path / "job.toml", run.path, figures=False, report=True, say=said.append)
    return said


def test_an_exact_gain_is_that_of_evaluate(run: pfdist.Run, exact: Job, see: See) -> None:
    """The expected MSEs are no means of draws."""
    pfdist.bound(run.path / "job.toml", figures=False)
    results = results_of(run)
    costs = [
        pfdist.evaluate(exact, result.measurement_times).expected_mse for result in results.values()
    ]
    assert [result.expected_mse for result in results.values()] == pytest.approx(costs)
    gain = results["genetic"].gain_of_means
    assert gain == pytest.approx(1 - costs[1] / costs[0])
    page = see(run)
    told = re.search(
        r"with regular times .*: the expected MSE is ([\d.]+) % lower \(exact\)", page.text
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(100 * gain, abs=0.006)  # rounded
    times = ", ".join(map(str, results["genetic"].measurement_times))
    for words in (
        f"Measure at t = {times}.",
        "What was asked",
        "All sets",
        "How to use and cite it",
        "How the times were found",
        "usually too low",
    ):
        assert words in page.text
    assert "its draws chose the set" not in page.text  # which is said of other filters
    assert "Proved: no other 4 times lower the expected MSE by more than" in page.text
    assert not list(verify_run(run.path))
    # It loads nothing, runs no script but its own, and shares no id.
    assert page.tags.count("script") == 1
    assert "script-src &#39;sha256-" in page.html or "script-src 'sha256-" in page.html
    addresses = [*page.links, *page.loaded]
    assert [address for address in addresses if not address.startswith(("#", "data:"))] == []
    ids = re.findall(r'\bid="([^"]+)"', page.html)
    assert len(ids) == len(set(ids)) > 50
    assert set(re.findall(r'(?:url\(#|href="#)([^")]+)', page.html)) <= set(ids)


@pytest.mark.plugins("why")
@pytest.mark.slow
def test_it_has_the_sampling_windows_of_every_set(run: pfdist.Run, see: See) -> None:
    assert "sampling window" not in see(run).text
    found = pfdist.why(run.path / "job.toml", figures=False)
    page, clock = see(run), problem_of(run).clock
    assert "the instants of its sampling window" in page.text
    assert "Bars: where a time alone may move" in page.text  # in the first picture
    for name, rows in found.sampling_windows.groupby("name"):
        assert f"Measurements of {phrase_of(run.labels[str(name)])}" in page.text
        for window in windows_of(rows.to_dict("records"), 1, clock):
            assert window.text in page.text


@pytest.mark.usefixtures("undrawn")
def test_a_name_in_a_runs_files_cannot_become_markup(make: Make, see: See) -> None:
    hostile = "<script>alert(1)</script><img src=x onerror=alert(1)>"
    run = make(name="<b>run &amp; co")
    about = run.path / "run.json"
    content = json.loads(about.read_text())
    content["provenance"]["libraries"] = {hostile: hostile}
    content["provenance"]["processor"] = {"model": hostile, "compiled_for": "]]>"}
    rewrite(about, json.dumps(content))
    page = see(pfdist.open_run(run.path))
    assert page.tags.count("script") == 1
    assert not {"img", "b"} & set(page.tags)
    assert hostile in page.text


@pytest.mark.usefixtures("undrawn")
def test_it_names_the_run_from_where_the_user_is(
    make: Make, see: See, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands work there; from elsewhere, the name of the folder tells nothing of others."""
    run = make(name="results/lake")
    monkeypatch.chdir(tmp_path)
    text = see(run).text
    assert "pfdist explore results/lake" in text
    assert 'open_run("results/lake")' in text
    assert 'read_parquet("results/lake/tables/comparison")' in text
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    assert 'open_run("lake")' in see(run).text


def _stop_at(phase: str) -> Callable[[Any], None]:
    def stop(progress: Any) -> None:
        if progress.phase == phase:
            raise KeyboardInterrupt

    return stop


@pytest.mark.parametrize("searches", [0, 1])
def test_a_run_that_is_not_finished_has_a_report_that_says_so(
    small_job: Job, tmp_path: Path, searches: int, see: See
) -> None:
    """No search yet, and one search of twenty."""
    many = ", ".join(f"{{method='random', name='s{k}', evaluations=3}}" for k in range(20))
    job = small_job.with_changes([f"search=[{many}]"])
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, tmp_path / "run", progress=_stop_at(f"s{searches}"), figures=False)
    page = see(pfdist.open_run(tmp_path / "run"))
    assert "This run is not finished" in page.text
    assert ("How the times were found" in page.text) == bool(searches)
    assert "What was asked" in page.text


@pytest.mark.slow
def test_the_plan_alone_has_figures(make: Make, see: See) -> None:
    many = ", ".join(f"{{method='random', name='s{k}', evaluations=2}}" for k in range(20))
    run = make(f"search=[{many}]")
    page = see(run)
    said = "How much lower the error is with the {} plan than"
    shown = [name for name in run.names if said.format(name) in page.text]
    assert shown == [run.best.name]
    assert len(page.html.encode()) < 500_000


@pytest.mark.usefixtures("undrawn")
def test_details_are_folded_away_and_sections_of_details_alone_come_last(
    run: pfdist.Run, see: See
) -> None:
    html = see(run).html
    shown, _, folded = html.partition('<details class="folded">')
    assert re.findall(r'<h2 id="[^"]+">([^<]+)', html) == ["The answer"]
    assert "<h2" not in folded
    assert "Expected MSE on 30 draws" not in shown
    for title in ("What was asked", "All sets", "How the times were found", "How it was computed"):
        assert f"<summary>{title}</summary>" in html
    print_rules = html.partition("@media print")[2]
    assert "details:not([open]) { display: none; }" in print_rules


@pytest.mark.usefixtures("undrawn")
def test_errors_that_are_unknown_are_said(small_job: Job, tmp_path: Path, see: See) -> None:
    """Every set that is tried has infinite errors."""
    (small_job.path.parent / "far.py").write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, quantity_of_interest=lambda x, t, p: (1e200 * x[0],))\n"
    )
    changes = ["model.name=far.py:model", "filter.engine=numpy", "comparison.draws=30"]
    changes += ["evaluation.draws=5", "search=[{method='random', evaluations=3}]"]
    with pytest.raises(pfdist.PfdistError):
        pfdist.run(small_job.with_changes(changes), tmp_path / "run", figures=False)
    assert "When to measure" in see(pfdist.open_run(tmp_path / "run")).text


@pytest.mark.usefixtures("undrawn")
def test_the_command_prints_the_file_and_watches_until_the_run_is_finished(
    exact: Job,
    tmp_path: Path,
    stop: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, file = tmp_path / "run", tmp_path / "run" / "report.html"
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(exact, folder, progress=_stop_at("comparison"), figures=False)
    reloads = list[bool]()

    def go_on(seconds: float) -> None:
        reloads.append('http-equiv="refresh"' in file.read_text())
        pfdist.run(exact, folder, figures=False)

    assert main(["report", str(folder), "--watch"]) == 0
    out, err = capsys.readouterr()
    assert out == f"{file}\n"
    assert "is not finished (comparing), and no process computes it: resume it" in err
    monkeypatch.setattr("pfdist.questions.report.is_held", lambda path: True)
    monkeypatch.setattr("pfdist.questions.report.stopping.sleep", go_on)
    assert main(["report", str(folder), "--watch"]) == 0
    assert capsys.readouterr().out == f"{file}\n"
    assert reloads == [True]
    assert 'http-equiv="refresh"' not in file.read_text()

    def end(seconds: float) -> None:
        stop(signal.SIGTERM)
        stopping.check()

    monkeypatch.setattr("pfdist.results.Run.state", "comparing")
    monkeypatch.setattr("pfdist.questions.report.stopping.sleep", end)
    assert main(["report", str(folder), "--watch"]) == 75
    assert 'http-equiv="refresh"' not in file.read_text()


def test_what_is_no_run_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="holds no run"):
        pfdist.report(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("undrawn")
def test_a_report_of_the_unfinished_run_gives_way_when_the_run_ends(
    run: pfdist.Run, exact: Job, see: See
) -> None:
    def look(progress: Any) -> None:
        if progress.phase == "comparison" and not (run.path / "report.html").exists():
            warned.append("not finished" in see(pfdist.open_run(run.path)).text)

    warned = list[bool]()
    more = exact.with_changes(["comparison.draws=60"])
    pfdist.run(more, run.path, figures=False, report=True, progress=look)
    assert warned == [True]
    assert "not finished" not in (run.path / "report.html").read_text()


def test_pages_of_fewer_draws_stay_until_new_ones_replace_them(
    exact: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    said: Callable[..., str],
) -> None:
    """Also if the run is stopped in the comparison, or killed before its new pages are made."""
    edition, folder = ["first"], tmp_path / "run"
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **__: path.write_text(edition[0]))
    monkeypatch.setattr("pfdist.questions.report.page_of", lambda *_: Page(edition[0], "", []))

    def pages() -> dict[str, bytes]:
        found = [folder / "report.html", *(folder / "figures").iterdir()]
        return {page.name: page.read_bytes() for page in found}

    def places() -> list[str]:
        assert not list(verify_run(folder))
        return re.findall("^(tables|figures|report):", said("status", folder), re.MULTILINE)

    pfdist.run(exact, folder, report=True)
    before, more = pages(), exact.with_changes(["comparison.draws=60"])
    edition[0] = "second"
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(more, folder, report=True, progress=_stop_at("comparison"))
    assert (pages(), places()) == (before, ["tables"])
    with monkeypatch.context() as patch:
        patch.setattr("pfdist.plots.draw_missing_figures", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            pfdist.run(more, folder, report=True)
    assert pfdist.open_run(folder).draws_compared == 60
    assert (pages(), places()) == (before, ["tables"])
    pfdist.run(more, folder, report=True)
    after = pages()
    assert after.keys() == before.keys()
    assert all(after[page] != before[page] for page in before)
    assert places() == ["tables", "figures", "report"]
    edition[0] = "third"
    pfdist.run(more, folder, report=True)
    assert pages() == after


@pytest.mark.usefixtures("undrawn")
def test_a_users_own_file_stays_and_no_command_calls_it_a_result(
    run: pfdist.Run, capsys: pytest.CaptureFixture[str]
) -> None:
    report = run.path / "report.html"
    _again(run)
    assert main(["status", str(run.path)]) == 0
    told = ["tables:", f"{run.path}/tables", "report:", f"{report}"]
    assert capsys.readouterr().out.split()[-4:] == told
    report.write_text("mine")
    (run.path / "figures").mkdir()
    (run.path / "figures" / "notes.txt").write_text("mine")
    assert "there is no report" in _again(run)[-1]
    assert report.read_text() == "mine"
    assert main(["status", str(run.path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"tables: {run.path}/tables"


@pytest.mark.parametrize("error", [ZeroDivisionError("a\nb"), StoreError("disk full")])
@pytest.mark.usefixtures("undrawn")
def test_a_mistake_in_the_report_does_not_spoil_a_finished_run(
    run: pfdist.Run, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("pfdist.questions.report.page_of", fail)
    told = _again(run)[-1]
    assert pfdist.open_run(run.path).state == "finished"
    assert not (run.path / "report.html").exists()
    is_ours = isinstance(error, StoreError)
    assert told.startswith(f"there is no report: {error if is_ours else type(error).__name__}")
    assert "\n" not in told


def test_a_gain_is_said_as_far_as_its_interval_supports_it() -> None:
    for gain, ends in ((0.05, [0.01, 0.09]), (-0.05, [-0.09, -0.01])):
        side = "lower" if gain > 0 else "higher"
        said = f"The expected MSE is 5.0 % {side} (95 % CI 1.0 to 9.0 %) than with these"
        assert effect(gain, ends, "these") == said
    said = (
        "No clear difference from these; the expected MSE is 5.0 % higher (95 % CI -1.0 to 9.0 %)"
    )
    assert effect(-0.05, [-0.09, 0.01], "these") == said
    assert "20.0 % lower (too few draws for an interval)" in effect(0.2, [None, None], "these")


def test_a_gap_of_rounding_errors_is_no_gap_and_constraints_are_named() -> None:
    none = gap_sentence(BOUND | {"gap": 1e-16}, 4)
    assert none == "Proved: no other 4 times have a lower expected MSE."
    assert percent(-1e-17) == "0.00 %"
    assert gap_sentence(BOUND, 3, is_constrained=True).startswith(
        "Proved: no other times that are no more expensive and that the constraints allow lower"
    )


def test_the_reference_itself_is_no_gain(make: Make) -> None:
    whole = ("problem.horizon=1", "problem.measurement_budget=2", "search=[{method='exhaustive'}]")
    text = _text(make(*whole))
    assert "These are regular times, so planning gains nothing here." in text
    assert "If you analyse only afterwards, the expected MSE is " in text
    assert "nothing clear" not in text
    assert "(regular: " not in text


def test_two_draws_give_no_interval(make: Make) -> None:
    text = _text(make("comparison.draws=2", "filter.engine=compiled"))
    assert "unknown to unknown" not in text
    assert "too few draws" in text


def test_the_best_of_several_sets_is_chosen_by_exact_errors(make: Make) -> None:
    random = ", ".join(f"{{method='random', name='s{k}', evaluations=1}}" for k in range(4))
    run = make(f"search=[{random}]", "comparison.draws=2")
    subject = Subject(run)
    costs = {name: found.search_mse for name, found in subject.found_rows.items()}
    assert subject.by_error == sorted(costs, key=lambda name: costs[name])
    assert "the best of 4 plans by their expected MSEs, which are exact" in _text(run)


@pytest.mark.plugins("budget")
def test_columns_without_any_value_are_left_out(small_job: Job, tmp_path: Path) -> None:
    """The searches of a range of budgets believe something of each number of measurements."""
    job = small_job.with_changes([*MODEL, "problem.horizon=6"])
    subject = Subject(pfdist.budget(job, (2, 3), tmp_path / "run", draws=20, figures=False))
    found = searches_section(subject)
    assert found is not None
    assert found.blocks[0].head == ["search", "method", "sets evaluated"]


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    ("change", "is_constrained"),
    [("problem.minimum_spacing=1", False), ("problem.minimum_spacing=2", True)],
)
def test_report_and_commands_say_alike_whether_constraints_exclude_times(
    make: Make, said: Callable[..., str], change: str, is_constrained: bool
) -> None:
    run = make(change)
    of_bound = said("bound", run.path / "job.toml")
    for text in (of_bound, said("status", run.path), _text(run)):
        assert ("that the constraints allow" in " ".join(text.split())) == is_constrained


@pytest.mark.plugins("online")
def test_the_best_of_online_and_plan_is_named(exact: Job, tmp_path: Path) -> None:
    text = _text(pfdist.online(exact, tmp_path / "run", draws=5, figures=False))
    assert re.search(
        r"Online times \(5 draws\): .* the expected MSE is [\d.]+ % (lower|higher)", text
    )


def test_a_report_has_the_models_own_name_and_no_folder_of_the_machine(
    exact: Job, tmp_path: Path
) -> None:
    file = tmp_path / "secret" / "walk.py"
    file.parent.mkdir()
    file.write_text(
        "from dataclasses import replace\nfrom pfdist import load_model\n"
        "model = replace(load_model('random_walk'), name='a <walk> in the park')\n"
    )
    job = exact.with_changes([f"model.name={file}:model"])
    run = pfdist.run(job, tmp_path / "run", figures=False)
    assert str(tmp_path) not in _text(run)
    assert "When to measure: a <walk> in the park" in _text(run)


def test_a_run_with_quotes_in_its_name_is_loaded_as_the_report_says(make: Make) -> None:
    blocks = [
        block
        for section in page_of(make(name='a "run" \U0001f600')).sections
        for block in section.blocks
    ]
    (code,) = [
        block.text for block in blocks if block.kind == "code" and block.text.startswith(_LOAD[:13])
    ]
    compile(code, "report", "exec")
    assert '"a \\"run\\" \U0001f600"' in code
