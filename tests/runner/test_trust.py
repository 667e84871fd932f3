"""A search does not believe a filter that fools itself: a sharp sensor collapses its cloud."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import pfdist
from oracles.bytes_of import hashes
from oracles.results_of import results_of
from pfdist import Job
from pfdist.common.streams import stream_of
from pfdist.filters.work import Work
from pfdist.pages import searches as searches_page
from pfdist.pages.figure import Tables
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.questions.run_page import searches
from pfdist.questions.subject import Subject
from pfdist.results import Run
from pfdist.runner.build import build

SHARP = Path(pfdist.__file__).parents[1] / "tests" / "oracles" / "sharp_sensor.toml"
GOOD = (1, 3, 6, 9)
Planned = tuple[Run, list[str], list[Any]]  # a plan, what it has said, and its progress
SMALL = [
    "seed=3",  # exchanges by the squared error end with several sets, which race
    "search.survivors.evaluation.draws=100",
    "comparison.draws=500",
    "execution.pool=serial",
]


@pytest.fixture(scope="module", autouse=True)
def _several_sets_race() -> Iterator[None]:
    """The usual number of draws of a polish leaves a single set of this problem, and no race."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pfdist.runner.searches._POLISH_DRAWS", 128)
        yield


@pytest.fixture(scope="module")
def job() -> Job:
    return pfdist.load_job(SHARP, ["execution.pool=serial"])


@pytest.fixture(scope="module")
def planned(job: Job, tmp_path_factory: pytest.TempPathFactory) -> Planned:
    said, seen = list[str](), list[Any]()
    folder = tmp_path_factory.mktemp("sharp") / "run"
    run = pfdist.plan(
        job, folder, "survivors", SMALL, say=said.append, progress=seen.append, figures=False
    )
    return run, said, seen


def _rows(run: Run, phase: str) -> pd.DataFrame:
    rows = run.table("evaluations")
    return rows[rows["phase"] == phase]


@pytest.mark.slow
def test_a_plan_ends_near_the_best_set_though_the_filters_variance_prefers_another(
    planned: Planned, job: Job
) -> None:
    """Its own particles' variance says 0.1 for {0, 1, 3, 9}, whose error is 6."""
    assert _is_near_the_best(planned[0].sets["survivors"], job)


@pytest.mark.slow
def test_so_does_the_default_search(job: Job, tmp_path: Path) -> None:
    said = list[str]()
    changes = [change.replace("survivors", DEFAULT_METHOD) for change in SMALL]
    run = pfdist.plan(
        job, tmp_path / "run", changes=changes, bound_draws=0, say=said.append, figures=False
    )
    (line,) = [line for line in said if "cannot be believed" in line]
    assert line.startswith(f"search {DEFAULT_METHOD}: filter_variance of 100 particles cannot be")
    assert set(_rows(run, f"{DEFAULT_METHOD}.again")["estimator"]) == {"squared_error"}
    assert _is_near_the_best(run.sets[DEFAULT_METHOD], job)


def _is_near_the_best(times: tuple[int, ...], job: Job) -> bool:
    """Whether the error of the job's own filter is at most 5 % above that of the good set."""
    draws, stream = 5000, stream_of("comparison", 123)
    built = build(job)
    work = Work((times, GOOD), (14, 14), (stream,) * 2, stream, (0, draws), built.comparing)
    mse = built.evaluator(work).mse
    apart = mse[:, 0] - 1.05 * mse[:, 1]
    return bool(np.mean(apart) < 4 * np.std(apart) / np.sqrt(draws))


@pytest.mark.slow
def test_distrust_is_said_in_a_line_with_its_reason_and_kept(planned: Planned) -> None:
    run, said, _ = planned
    (line,) = [line for line in said if "cannot be believed" in line]
    assert line.startswith("search survivors: filter_variance of 100 particles cannot be believed")
    assert line.endswith(". Searching again with the squared error...")
    result = results_of(run)["survivors"]
    assert result.search_distrust in line
    assert result.search_settings == ""  # the race chose, as the comparison estimates
    (row,) = [row for row in searches(Subject(run)).blocks[0].rows if row[0].text == "survivors"]
    assert result.search_distrust in row[-1].text
    assert row[-1].text.endswith("its draws chose the set")


@pytest.mark.slow
def test_probes_are_what_led_the_search_a_prefix_up_to_its_end(planned: Planned, job: Job) -> None:
    run, _, _ = planned
    probes = _rows(run, "survivors.probe")
    searched = _rows(run, "survivors")
    first = probes[probes["generation"] == 0]
    assert set(first["draws"]) == {500}
    counts = first.groupby(["estimator", "particles"]).size()
    assert counts.to_dict() == {
        ("filter_variance", 100): len(first) / 2,
        ("squared_error", 100): len(first) / 2,  # equal numbers of particles
    }
    asked = {(tuple(row.measurement_times), row.end) for row in first.itertuples()}
    assert (job.problem.feasible.regular(), 14) in asked
    for _, generation in searched.groupby("generation"):
        costs = generation["expected_mse"] / (generation["end"] + 1)
        best = generation.loc[costs.idxmin()]
        assert (tuple(best["measurement_times"]), best["end"]) in asked
    ends = {end for times, end in asked if end < 14}
    assert ends == {times[-1] for times, end in asked if end < 14}


@pytest.mark.slow
def test_the_best_sets_of_both_searches_join_one_race(planned: Planned) -> None:
    race = _rows(planned[0], "survivors.again.shortlist")
    raced = {*map(tuple, race["measurement_times"])}
    for phase in ("survivors.polish", "survivors.again.polish"):
        rows = _rows(planned[0], phase)
        best = rows.loc[rows["expected_mse"].idxmin(), "measurement_times"]
        assert tuple(best) in raced
    assert not len(_rows(planned[0], "survivors.shortlist"))
    last = race[race["generation"] == race["generation"].max()]
    winner = last.loc[last["expected_mse"].idxmin()]
    result = results_of(planned[0])["survivors"]
    assert result.measurement_times == list(winner["measurement_times"])
    assert result.search_mse == winner["expected_mse"]


@pytest.mark.slow
def test_the_race_is_by_the_squared_error_of_the_jobs_own_filter(planned: Planned) -> None:
    assert len(_rows(planned[0], "survivors.again.shortlist")) > 1
    for phase in ("survivors.again", "survivors.again.shortlist"):
        rows = _rows(planned[0], phase)
        assert (set(rows["estimator"]), set(rows["particles"])) == ({"squared_error"}, {500})


@pytest.mark.slow
def test_the_progress_has_room_for_what_is_done_again(planned: Planned) -> None:
    states = planned[2]
    assert states[-1].done == states[-1].total > states[0].total
    shares = [state.done / state.total for state in states]
    assert max(shares) == shares[-1] == 1.0


@pytest.mark.slow
def test_a_search_by_the_squared_error_needs_no_probe(job: Job, tmp_path: Path) -> None:
    changes = [*SMALL, "search.survivors.evaluation.estimator=squared_error"]
    run = pfdist.plan(job, tmp_path / "run", "survivors", changes, figures=False)
    phases = {"survivors", "survivors.polish", "survivors.shortlist"}
    assert set(run.table("evaluations")["phase"]) == phases
    assert results_of(run)["survivors"].search_distrust is None


def test_an_estimator_that_the_user_chose_is_probed_as_well(job: Job, tmp_path: Path) -> None:
    said: list[str] = []
    section = "[{method='random', evaluations=40, evaluation={estimator='filter_variance'}}]"
    changes = ["evaluation.draws=50", "comparison.draws=2", f"search={section}"]
    run = pfdist.run(job.with_changes(changes), tmp_path / "run", say=said.append, figures=False)
    assert any("search random: filter_variance of 500 particles cannot be" in line for line in said)
    assert set(_rows(run, "random.again")["estimator"]) == {"squared_error"}


@pytest.mark.slow
def test_where_the_best_sets_change_their_order_the_search_is_done_again(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said, seen = list[str](), list[Any]()

    def any_two(believed: Any, squared: Any) -> Any:
        seen.append((believed, squared))
        return squared[:2]

    monkeypatch.setattr("pfdist.search.probe.BELOW", 10.0)  # the probes fail on nothing
    monkeypatch.setattr("pfdist.search.probe.misordered", any_two)
    run = pfdist.plan(job, tmp_path / "run", "survivors", SMALL, say=said.append, figures=False)
    ((believed, squared),) = seen  # once: the squared error is what it is
    assert {evaluation.measurement_times for evaluation in squared} == {*believed}
    (line,) = [line for line in said if "cannot be believed" in line]
    assert "it prefers {" in line
    found = results_of(run)["survivors"]
    again = _rows(run, "survivors.again.shortlist")
    assert tuple(found.measurement_times) in set(map(tuple, again["measurement_times"]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "pool"),
    [
        ("survivors", {}),
        ("survivors.probe", {}),
        ("survivors.probe", {"pool": "ray", "workers": 2}),
        ("survivors.again", {}),
        ("survivors.again.shortlist", {}),
    ],
)
def test_a_run_that_was_cut_short_distrusts_again_and_ends_with_the_same_bytes(
    phase: str,
    pool: dict[str, Any],
    planned: Planned,
    job: Job,
    tmp_path: Path,
    cut_short: Callable[..., None],
    request: pytest.FixtureRequest,
) -> None:
    if pool:
        request.getfixturevalue("ray_cluster")
    whole, said, _ = planned
    cut_short(phase, job, tmp_path / "run", "survivors", SMALL, figures=False)
    assert pfdist.open_run(tmp_path / "run").state == "searching"
    told: list[str] = []
    pfdist.plan(job, tmp_path / "run", "survivors", SMALL, say=told.append, **pool, figures=False)
    assert hashes(tmp_path / "run") == hashes(whole.path)
    first, again = ([line for line in lines if "believed" in line] for lines in (said, told))
    assert first == again


@pytest.mark.slow
def test_the_figure_of_searches_shows_the_search_that_was_done_again(
    planned: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(
        searches_page, "searches", lambda *given, **named: drawn.append((*given, named))
    )
    searches_page.searches_figure(Tables(planned[0])).draw([Figure().subplots()])
    ((evaluations, _, named),) = drawn
    assert named["title"].endswith("\nsystematic resampling")  # and the squared error
    shown = evaluations[evaluations["phase"] == "survivors"]
    assert set(shown["estimator"]) == {"squared_error"}
    assert len(shown) == len(_rows(planned[0], "survivors.again"))
