"""The reporter: it alone adds up how far a run is."""

import pytest

from pfdist.runner.progress import Progress, Reporter


@pytest.fixture
def reported() -> list[Progress]:
    return []


@pytest.fixture
def reporter(reported: list[Progress]) -> Reporter:
    return Reporter(reported.append, total=100.0)


def test_a_phase_goes_on_from_where_the_last_phase_ended_and_shows_nothing_of_it(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("genetic", generation=1, generations=5)
    reporter.reach(20.0, evaluations=7, best=3.0, mean=4.0)
    reporter.note(done=25.0)
    reporter.begin("comparison")
    assert reported[-1] == Progress("comparison", done=25.0, total=100.0)


def test_what_is_noted_is_shown_with_the_next_report_only(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("random")
    reporter.note(best=2.0)
    assert [state.best for state in reported] == [None]
    reporter.reach(1.0)
    assert [state.best for state in reported] == [None, 2.0]


def test_work_that_was_not_foreseen_adds_to_the_total_and_at_the_end_nothing_remains(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("survivors")
    reporter.foresee(50.0)
    reporter.reach(120.0)
    assert (reported[-1].done, reported[-1].total) == (120.0, 150.0)
    reporter.finish()  # an early end: fewer draws were enough
    assert reported[-1].done == reported[-1].total == 120.0
