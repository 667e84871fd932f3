"""The statistics of a proof against closed forms, and the gap of a set, which a proof gives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from oracles.windows import counted, relaxed_errors
from pfdist.common.estimate import Estimate
from pfdist.problem.constraints import Constraints
from pfdist.runner.proof import Gap, GapTerms, Proof, Sums, consistent, gap_of, prove
from pfdist.search.first_windows import relaxation_with
from pfdist.search.relaxation import START

# One measurement in 0..2, window 2: nothing is added to it, so each window is a set.
RELAXATION = relaxation_with(Constraints(2, 1), 2, 3)
SETS = [(0,), (1,), (2,)]
GROUPS, DRAWS = 20, 50


def _sums(rng: np.random.Generator, scale: float = 1.0) -> Sums:
    """Sums of groups of errors; those of each known set are those of its windows."""
    windows = len(RELAXATION.windows)
    errors = rng.gamma(4.0, scale / 4, size=(GROUPS, DRAWS, windows, 3)).sum(axis=1)
    relaxed = counted(RELAXATION, errors)
    own = np.stack([relaxed_errors(RELAXATION, relaxed, times) for times in SETS], axis=1)
    return Sums(relaxed, own, np.full(GROUPS, float(DRAWS)))


@pytest.fixture
def sums() -> Sums:
    return _sums(np.random.default_rng(3))


def test_the_bound_of_one_measurement_is_the_least_mean_of_its_sets(sums: Sums) -> None:
    proof = prove(RELAXATION, sums, SETS, 1)
    own = sums.known.mean(axis=2).sum(axis=0) / (GROUPS * DRAWS)
    assert proof.bounds[1].value == pytest.approx(own.min(), rel=1e-12)
    assert proof.paths[1] == SETS[int(own.argmin())]
    assert [slack.value for slack in proof.slack] == pytest.approx(list(own - own.min()), abs=1e-12)
    assert {estimate.degrees for estimate in (*proof.bounds, *proof.slack)} == {GROUPS - 1}


def test_the_jackknife_of_a_mean_is_its_textbook_error(sums: Sums) -> None:
    proof = prove(RELAXATION, sums, SETS, 1)
    means = sums.known.mean(axis=2) / DRAWS
    first = RELAXATION.offsets[RELAXATION.index[START]]
    nothing = sums.relaxed[:, first : first + 3].mean(axis=1) / DRAWS  # no measurement
    assert proof.bounds[0].standard_error == pytest.approx(stats.sem(nothing), rel=1e-9)
    best = int(means.mean(axis=0).argmin())
    for slack, column in zip(proof.slack, means.T, strict=True):
        expected = stats.sem(column - means[:, best])
        if expected:  # else the least itself, whose slack is 0 but for groups that change the least
            assert slack.standard_error == pytest.approx(expected, rel=0.3)


def test_groups_of_several_sizes_count_by_their_draws(sums: Sums) -> None:
    whole = prove(RELAXATION, sums, SETS, 1)
    for part in sums:  # twice the draws in the first group, with the same mean
        part[0] *= 2
    weighted = prove(RELAXATION, sums, SETS, 1)
    means = sums.known.mean(axis=2).sum(axis=0) / sums.draws.sum()
    assert weighted.bounds[1].value == pytest.approx(means.min(), rel=1e-12)
    assert weighted.bounds[1].value != whole.bounds[1].value


def test_one_group_holds_exact_errors(sums: Sums) -> None:
    proof = prove(RELAXATION, Sums(*(part[:1] for part in sums)), SETS, 1)
    assert all(estimate.standard_error == 0.0 for estimate in (*proof.bounds, *proof.slack))


def test_sets_bought_with_money_have_the_bound_of_all_of_the_money() -> None:
    """However many times they have: each of them may spend what any of them spends."""
    constraints = Constraints(2, price=(2, 1, 1), total_price=2)
    relaxation, rng = relaxation_with(constraints, 4, 3), np.random.default_rng(4)
    sets = [(0,), (1, 2)]
    relaxed = rng.gamma(4.0, size=(1, int(relaxation.offsets[-1])))
    own = np.stack([relaxed_errors(relaxation, relaxed, times) for times in sets], axis=1)
    proof = prove(relaxation, Sums(relaxed, own, np.ones(1)), sets, relaxation.total)
    assert proof.budgets == [2, 2]
    every = [(), (0,), (1,), (2,), (1, 2)]  # the sets that 2 units pay for
    least = min(relaxed_errors(relaxation, relaxed, times).mean() for times in every)
    assert proof.bounds[2].value == pytest.approx(least, rel=1e-12)
    costs = own[0].mean(axis=1)
    assert [slack.value for slack in proof.slack] == pytest.approx(list(costs - least))


# --- gaps -----------------------------------------------------------------------------------------

TIMES = (1, 4)
GAP = Gap(
    "found",
    TIMES,
    Estimate(10.0, 0.1),
    budget=2,
    bound=Estimate(9.8, 0.05),
    gap=0.02,
    gap_at_most=0.03,
    relaxation=Estimate(0.1, 0.02),
    estimate=Estimate(0.1, 0.02),
    filter_model=Estimate(0.0),
)


def _consistent(*gaps: Gap) -> dict[str, Gap]:
    return consistent({gap.name: gap for gap in gaps})


def test_a_gap_that_nothing_contradicts_stands() -> None:
    assert _consistent(GAP) == {"found": GAP}


def test_a_known_set_that_costs_less_than_the_bound_withdraws_it() -> None:
    cheap = replace(GAP, name="cheap", expected_mse=Estimate(9.0, 0.1))
    assert (
        _consistent(GAP, cheap)["found"].reason == "the error of the set cheap lies below the bound"
    )
    near = replace(cheap, expected_mse=Estimate(9.7, 0.1))
    assert not _consistent(GAP, near)["found"].reason
    for times in ((1,), (1, 4, 5)):  # of another number of measurements: that contradicts nothing
        other = replace(cheap, measurement_times=times, budget=len(times))
        assert not _consistent(GAP, other)["found"].reason


def _proof(*bounds: Estimate, slack: Estimate, budget: int = 2) -> Proof:
    paths = [(), (3,), (0, 3)][: len(bounds)]
    return Proof(list(bounds), paths, [0, budget], [Estimate(77.0), slack])


def test_a_gap_is_the_sum_of_its_parts_with_an_error_of_its_own() -> None:
    alone = GapTerms(Estimate(10.0, 0.1), Estimate(0.3), Estimate(0.1), Estimate(0.4, 0.3))
    slack = Estimate(0.5, 0.4, 19)
    proof = _proof(Estimate(99.0), Estimate(99.0), Estimate(9.2, 0.2), slack=slack)
    gap = gap_of("found", TIMES, alone, proof, 1, 0.95)
    assert gap.gap == pytest.approx(0.09)
    assert gap.gap_at_most == pytest.approx(Estimate(0.9, 0.5, 19).at_most() / 10)
    assert (gap.bound, gap.path, gap.budget) == (proof.bounds[2], (0, 3), 2)
    assert (gap.relaxation, gap.estimate, gap.filter_model) == (
        slack, alone.estimate, alone.filter_model,
    )  # fmt: skip


def test_the_gap_of_a_set_bought_with_money_is_that_to_the_bound_of_all_of_the_money() -> None:
    """Whatever the number of its times: the place in the proof says which sum it may spend."""
    alone = GapTerms(Estimate(10.0))
    proof = _proof(Estimate(9.0), Estimate(8.0), slack=Estimate(2.0), budget=1)
    gap = gap_of("found", TIMES, alone, proof, 1, 0.95)
    assert (gap.bound, gap.path, gap.budget) == (Estimate(8.0), (3,), 1)
    assert gap.gap == pytest.approx(0.2)


def test_a_gap_without_a_bound_has_the_sets_error_and_no_other_number() -> None:
    columns = GAP.refused("why").columns()
    assert (columns["expected_mse"], columns["reason"]) == (10.0, "why")
    assert (columns["budget"], columns["path"]) == (0, ())
    numbers = ("bound", "gap", "gap_at_most", "relaxation", "estimate", "filter_model")
    assert np.isnan([columns[name] for name in numbers]).all()


def test_a_set_clearly_below_the_bound_has_no_bound_and_a_chance_excess_is_no_gap() -> None:
    alone = GapTerms(Estimate(10.0, 0.1), both=Estimate(-0.1, 0.1))

    def gap(slack: float) -> Gap:
        proof = _proof(*[Estimate(0.0)] * 3, slack=Estimate(slack, 0.1, 19))
        return gap_of("found", TIMES, alone, proof, 1, 0.95)

    assert gap(0.0).gap == 0.0
    assert gap(50.0).gap == gap(50.0).gap_at_most == 1.0  # no error is negative
    assert not gap(-0.4).reason
    assert gap(-1.0).reason == "the error of the set lies below the bound"
