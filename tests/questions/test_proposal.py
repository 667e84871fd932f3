"""Which proposal the filter of a job has: "auto" decides on draws of its own."""

import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

import pfdist
from oracles.guided import sharp_walk
from pfdist import StateSpaceModel
from pfdist.errors import ModelError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.proposal import PLAIN
from pfdist.filters.work import FilterWork
from pfdist.plugins.check import model_checks as checks_of_models
from pfdist.plugins.check.question import checks_of
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.problem.job import Job
from pfdist.runner import choice, particles
from pfdist.runner.build import build
from pfdist.runner.choice import with_long_gap

SHARP = sharp_walk(4)


def problem(model: object, **others: object) -> pfdist.Problem:
    given = {"horizon": 8, "measurement_budget": 2, "particles": 60}
    return pfdist.Problem(model, **(given | others))


def proposal_of(job: Job) -> str:
    return build(job).job.filter.proposal


def test_sharp_sensors_are_guided_and_the_growth_model_is_not() -> None:
    """REFERENCE: with the growth model, a block proposal loses more than the plain filter."""
    assert proposal_of(problem(SHARP).job()) == GUIDED.name
    assert proposal_of(problem("ungm").job()) == PLAIN.name


def test_where_it_is_not_possible_auto_is_plain_and_guided_is_one_line() -> None:
    for engine in ("numpy", "kalman"):
        assert proposal_of(problem(SHARP, engine=engine).job()) == PLAIN.name
    with pytest.raises(ModelError, match=r"needs filter\.engine = 'compiled', got 'numpy'"):
        build(problem(SHARP, engine="numpy", proposal="guided").job())


def test_a_truth_that_cannot_be_guided_makes_it_plain() -> None:
    """The proof guides the filter that knows the truth; asked for, it is one line at once."""
    uniform = replace(
        SHARP, name="uniform", initial_noise=("uniform",) * 4, process_noise=("centred",) * 4
    )
    mistaken = problem(uniform, filter_model=SHARP)
    assert proposal_of(mistaken.job()) == PLAIN.name
    with pytest.raises(ModelError, match="no normal noise"):
        build(mistaken.with_changes(proposal="guided").job())


def test_only_the_run_of_the_job_decides(tmp_path: Path) -> None:
    """Runs whose tables are reused may be plain."""
    other = pfdist.run(
        problem(SHARP, proposal="plain").job(search=[{"method": "random", "evaluations": 2}]),
        tmp_path / "other", changes=["comparison.draws=4"], pool="serial", figures=False,
    )  # fmt: skip
    job = problem(SHARP).job()
    assert build(job, tmp_path / "own", other.path).job.filter.proposal == GUIDED.name


def test_a_run_says_which_and_keeps_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same call goes on with the proposal of the run, and measures nothing again."""
    said, quiet = list[str](), {"pool": "serial", "figures": False}
    quiet |= {"changes": ["search.random.evaluations=2", "comparison.draws=6000"]}
    quiet |= {"search": "random", "bound_draws": 0}
    job = problem(SHARP)
    run = pfdist.plan(job, tmp_path / "run", say=said.append, **quiet)
    assert any(line.startswith("filter.proposal: guided") for line in said)
    assert 'proposal = "guided"\n' in (run.path / "job.toml").read_text()
    monkeypatch.setattr(particles, "why_plain", lambda *_: 1 / 0)
    again = pfdist.plan(job, run.path, **quiet)
    assert again.job["filter"]["proposal"] == GUIDED.name


def test_few_draws_pay_no_comparison_and_take_the_choice_of_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The comparison filters 2,400 times as many draws; that of a run is made once."""
    monkeypatch.setattr(choice, "_choices", {})
    judged = particles.why_plain
    monkeypatch.setattr(particles, "why_plain", lambda *_, **_s: 1 / 0)
    plain, guided = (
        pfdist.evaluate(problem(SHARP, proposal=each), "regular", draws=16).mse.tolist()
        for each in (PLAIN.name, GUIDED.name)
    )
    assert pfdist.evaluate(problem(SHARP), "regular", draws=16).mse.tolist() == plain != guided
    monkeypatch.setattr(particles, "why_plain", judged)
    assert proposal_of(problem(SHARP).job()) == GUIDED.name
    monkeypatch.setattr(particles, "why_plain", lambda *_, **_s: 1 / 0)
    assert pfdist.evaluate(problem(SHARP), "regular", draws=16).mse.tolist() == guided
    assert proposal_of(problem(SHARP).job()) == GUIDED.name


@pytest.mark.parametrize("draws", [1000, 20_000, 100_000])
def test_a_comparison_takes_a_twentieth_of_the_work_of_the_run(
    draws: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of a guided filter counts as eight; see docs/benchmarks.md for measured times."""
    monkeypatch.setattr(choice, "_choices", {})
    steps, filtered = list[float](), Evaluator.filtered

    def counted(self: Evaluator, work: FilterWork) -> object:
        steps.append(work.steps * (8 if work.estimation.proposal == GUIDED.name else 1))
        return filtered(self, work)

    monkeypatch.setattr(Evaluator, "filtered", counted)
    sets = {"early": (0, 1), "late": (7, 8)}
    job = problem(SHARP, particles=64).job(search=[], comparison={"draws": draws, "sets": sets})
    assert proposal_of(job) == (GUIDED.name if draws > 1000 else PLAIN.name)
    assert sum(steps) <= 0.05 * 3 * draws * 64 * 9
    assert (sum(steps) > 0) is (draws > 1000)


SQUARE = StateSpaceModel(  # whose sign no measurement sees
    name="square",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (0.5 * x[0] + w[0],),
    measurement=lambda x, t, v, p: (x[0] ** 2 + 0.2 * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0] ** 2) / 0.2) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
)


def test_a_guided_filter_by_hand_is_judged_as_auto_judges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks_of_models, "enough_particles", lambda *given: given[-1])
    asked = problem(SQUARE, particles=200, horizon=20, measurement_budget=7)
    assert proposal_of(asked.job()) == PLAIN.name
    for proposal, is_judged in ((PLAIN.name, False), (GUIDED.name, True)):
        by_hand = asked.with_changes(proposal=proposal)
        found = [each for each in checks_of(by_hand) if each.name == "filter.proposal"]
        assert [each.state for each in found] == ["note"] * is_judged
        assert all("25 guided ones lose" in each.text for each in found)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            pfdist.particle_losses(by_hand, (200,), draws=20)
        texts = [str(each.message) for each in said]
        assert len(texts) == is_judged
        assert all("'auto' takes 'plain': 200 plain particles" in text for text in texts)


def test_a_long_gap_is_at_most_twice_that_of_regular_times() -> None:
    job = problem("ungm", horizon=60, measurement_budget=21).job()
    times = with_long_gap(job)
    assert job.problem.feasible.accepts(times)
    gaps = [after - before for before, after in pairwise(times)]
    assert 3 < max(gaps) <= 6
