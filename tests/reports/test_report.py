"""The report of a run: it says what the tables say, and nothing in a run's files becomes markup."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.analysis.sampling_windows import sentences, windows_of
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.store.repair import verify_run

EXACT = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=30")


class Seen(HTMLParser):
    """The text of a page, its elements, and the addresses it names."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.text, self.tags, self.addresses = "", list[str](), list[str]()
        self._unseen = 0
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for key, value in attrs if key in ("href", "src")]
        self._unseen += tag in ("style", "script")

    def handle_endtag(self, tag: str) -> None:
        self._unseen -= tag in ("style", "script")

    def handle_data(self, data: str) -> None:
        if not self._unseen:
            self.text += f" {data.strip()}".replace("\xa0", " ")


def _report(run: pfdist.Run) -> Seen:
    return Seen(pfdist.report(run).read_text(encoding="utf-8"))


@pytest.fixture
def exact(small_job: Job) -> Job:
    return small_job.with_changes([*EXACT, "search=[{method='genetic', generations=1}]"])


def test_it_says_what_the_summary_says_in_a_sentence(exact: Job, tmp_path: Path) -> None:
    run = pfdist.run(exact, tmp_path / "run", bound_draws=480, figures=False)
    result = run.summary()["results"]["genetic"]
    seen = _report(run)
    times = ", ".join(map(str, result["measurement_times"]))
    told = re.search(
        r"Measuring at these 4 times instead of every 4 instants lowers the expected error by "
        r"([\d.]+) %",
        seen.text,
    )
    assert f"Measure at t = {times}." in seen.text
    assert told is not None
    assert float(told[1]) == pytest.approx(100 * result["exact_gain"], abs=0.006)  # rounded
    assert "No other 4 times can lower the error by more than another" in seen.text
    for title in (
        "What was asked",
        "What the times gain",
        "How to cite",
        "How the times were found",
    ):
        assert title in seen.text
    assert not list(verify_run(run.path))


@pytest.mark.slow
def test_it_has_the_sampling_windows_of_every_set(exact: Job, tmp_path: Path) -> None:
    run = pfdist.run(exact, tmp_path / "run", figures=False)
    assert "sampling window" not in _report(run).text
    found = pfdist.why(run, figures=False)
    seen = _report(run)
    assert "A sampling window holds the instants" in seen.text
    assert "Sampling windows of genetic." in seen.text  # the title of the figure
    for name, rows in found.sampling_windows.groupby("name"):
        assert f"Sampling windows, times of {name}" in seen.text
        jitter = found.jitter[found.jitter["name"] == name].to_dict("records")
        records = rows.to_dict("records")
        for said in sentences(records, jitter, is_found=name != "regular"):
            assert said in seen.text
        for window in windows_of(records, 1):
            assert window.text in seen.text


def test_it_loads_nothing_and_runs_no_script_but_its_own(exact: Job, tmp_path: Path) -> None:
    html = pfdist.report(pfdist.run(exact, tmp_path / "run", figures=False)).read_text()
    seen = Seen(html)
    assert seen.tags.count("script") == 1
    assert "script-src &#39;sha256-" in html or "script-src 'sha256-" in html
    outside = [address for address in seen.addresses if not address.startswith(("#", "data:"))]
    assert outside == []


def test_ids_are_not_shared_by_two_figures(exact: Job, tmp_path: Path) -> None:
    html = pfdist.report(pfdist.run(exact, tmp_path / "run", figures=False)).read_text()
    ids = re.findall(r'\bid="([^"]+)"', html)
    assert len(ids) == len(set(ids)) > 50
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', html))
    assert used <= set(ids)


def test_a_name_in_a_runs_files_cannot_become_markup(exact: Job, tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script><img src=x onerror=alert(1)>"
    run = pfdist.run(exact, tmp_path / "<b>run &amp; co", figures=False)
    about = run.path / "run.json"
    content = json.loads(about.read_text())
    content["provenance"]["libraries"] = {hostile: hostile}
    content["provenance"]["processor"] = {"model": hostile, "compiled_for": "]]>"}
    about.write_text(json.dumps(content))
    seen = _report(pfdist.open_run(run.path))
    assert seen.tags.count("script") == 1
    assert not {"img", "b"} & set(seen.tags)
    assert hostile in seen.text


@pytest.mark.parametrize("searches", [0, 1])
def test_a_run_that_is_not_finished_has_a_report_that_says_so(
    small_job: Job, tmp_path: Path, searches: int
) -> None:
    """No search yet, and one search of twenty."""
    many = ", ".join(f"{{method='random', name='s{k}', evaluations=3}}" for k in range(20))
    job = small_job.with_changes([f"search=[{many}]"])

    def stop(progress: Any) -> None:
        if progress.phase == f"s{searches}":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, tmp_path / "run", progress=stop, figures=False)
    seen = _report(pfdist.open_run(tmp_path / "run"))
    assert "This run is not finished" in seen.text
    assert ("How the times were found" in seen.text) == bool(searches)
    assert "What was asked" in seen.text


@pytest.mark.slow
def test_of_many_searches_the_best_sets_have_figures(small_job: Job, tmp_path: Path) -> None:
    many = ", ".join(f"{{method='random', name='s{k}', evaluations=2}}" for k in range(20))
    job = small_job.with_changes([*EXACT, f"search=[{many}]"])
    run = pfdist.run(job, tmp_path / "run", figures=False)
    file = pfdist.report(run)
    seen = Seen(file.read_text(encoding="utf-8"))
    best = sorted(run.summary()["results"].items(), key=lambda each: each[1]["expected_mse"])
    best_sets = [name for name, _ in best if name != "regular"][:4]
    shown = [name for name in run.names if f"the times of {name} err" in seen.text]
    assert sorted(shown) == sorted(best_sets)
    assert "Those of the other 16 are in the folder figures" in seen.text
    assert file.stat().st_size < 2_000_000


def test_errors_that_are_unknown_are_said(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "far.py").write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model, where\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, quantity_of_interest=lambda x, t, p: (1e200 * x[0],))\n"
    )
    changes = ["model.name=far.py:model", "filter.engine=numpy", "comparison.draws=30"]
    changes += ["evaluation.draws=5"]
    search = "search=[{method='random', evaluations=3}]"
    try:
        run = pfdist.run(
            small_job.with_changes([*changes, search]), tmp_path / "run", figures=False
        )
    except pfdist.PfdistError:  # every set that was tried has infinite errors
        run = pfdist.open_run(tmp_path / "run")
    assert "When to measure" in _report(run).text


def test_the_command_prints_the_file_and_watches_until_the_run_is_finished(
    exact: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(progress: Any) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(exact, tmp_path / "run", progress=stop, figures=False)
    reloads = list[bool]()

    def go_on(seconds: float) -> None:
        reloads.append('http-equiv="refresh"' in (tmp_path / "run" / "report.html").read_text())
        pfdist.run(exact, tmp_path / "run", figures=False)

    assert main(["report", str(tmp_path / "run"), "--watch"]) == 0
    out, err = capsys.readouterr()
    assert out == f"{tmp_path / 'run' / 'report.html'}\n"
    assert "is not finished (comparing), and no process computes it: run its job on" in err
    monkeypatch.setattr("pfdist.api.report.is_computed", lambda path: True)
    monkeypatch.setattr("pfdist.api.report.time.sleep", go_on)
    assert main(["report", str(tmp_path / "run"), "--watch"]) == 0
    file = tmp_path / "run" / "report.html"
    assert capsys.readouterr().out == f"{file}\n"
    assert reloads == [True]
    assert 'http-equiv="refresh"' not in file.read_text()


def test_what_is_no_run_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="holds no run"):
        pfdist.report(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_report_of_the_unfinished_run_gives_way_when_the_run_ends(
    exact: Job, tmp_path: Path
) -> None:
    def look(progress: Any) -> None:
        if progress.phase == "comparison" and not (tmp_path / "run" / "report.html").exists():
            warned.append("not finished" in _report(pfdist.open_run(tmp_path / "run")).text)

    warned = list[bool]()
    more = exact.with_changes(["comparison.draws=60"])
    pfdist.run(exact, tmp_path / "run", figures=False)
    pfdist.run(more, tmp_path / "run", figures=False, report=True, progress=look)
    assert warned == [True]
    assert "not finished" not in (tmp_path / "run" / "report.html").read_text()


def test_a_users_own_file_stays_and_the_run_says_that_there_is_no_report(
    exact: Job, tmp_path: Path
) -> None:
    told = list[str]()
    pfdist.run(exact, tmp_path / "run", figures=False)
    (tmp_path / "run" / "report.html").write_text("mine")
    pfdist.run(exact, tmp_path / "run", figures=False, report=True, say=told.append)
    assert (tmp_path / "run" / "report.html").read_text() == "mine"
    assert "there is no report" in told[-1]


@pytest.mark.parametrize(
    "error", [KeyError("z"), ZeroDivisionError("a\nb"), MemoryError(), StoreError("disk full")]
)
def test_a_mistake_in_the_report_does_not_spoil_a_finished_run(
    exact: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("pfdist.reports.run_report.page_of", fail)
    told = list[str]()
    run = pfdist.run(exact, tmp_path / "run", figures=False, report=True, say=told.append)
    assert run.state == "finished"
    assert not (run.path / "report.html").exists()
    is_ours = isinstance(error, StoreError)
    assert told[-1].startswith(f"there is no report: {error if is_ours else type(error).__name__}")
    assert "\n" not in told[-1]


def test_commands_name_no_file_of_the_users_own_as_a_result(
    exact: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pfdist.run(exact, tmp_path / "run", figures=False, report=True)
    assert main(["status", str(run.path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == (
        f"tables: {run.path}/tables   report: {run.path}/report.html"
    )
    (run.path / "report.html").write_text("mine")
    (run.path / "figures").mkdir()
    (run.path / "figures" / "notes.txt").write_text("mine")
    assert main(["status", str(run.path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"tables: {run.path}/tables"
