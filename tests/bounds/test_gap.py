"""A gap is the sum of its parts; a wrong likelihood withdraws it, and nothing else does."""

from dataclasses import replace

import pytest

from pfdist.bounds.gap import Gap, SetAlone, consistent, gap_of
from pfdist.bounds.proof import Proof
from pfdist.common.estimate import Estimate

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


def test_a_variance_above_the_squared_error_withdraws_all_bounds() -> None:
    other = replace(GAP, name="other", estimate=Estimate(-0.5, 0.1))
    reasons = {gap.reason for gap in _consistent(GAP, other).values()}
    assert reasons == {"the variance of the particles exceeds their squared error"}


def test_a_known_set_that_costs_less_than_the_bound_withdraws_it() -> None:
    cheap = replace(GAP, name="cheap", expected_mse=Estimate(9.0, 0.1))
    assert _consistent(GAP, cheap)["found"].reason == "the set cheap costs less than the bound"
    near = replace(cheap, expected_mse=Estimate(9.7, 0.1))
    assert not _consistent(GAP, near)["found"].reason
    for times in ((1,), (1, 4, 5)):  # of another number of measurements: that contradicts nothing
        other = replace(cheap, measurement_times=times, budget=len(times))
        assert not _consistent(GAP, other)["found"].reason


def _proof(*bounds: Estimate, slack: Estimate, budget: int = 2) -> Proof:
    paths = [(), (3,), (0, 3)][: len(bounds)]
    return Proof(list(bounds), paths, [0, budget], [Estimate(77.0), slack])


def test_a_gap_is_the_sum_of_its_parts_with_an_error_of_its_own() -> None:
    alone = SetAlone(Estimate(10.0, 0.1), Estimate(0.3), Estimate(0.1), Estimate(0.4, 0.3))
    slack = Estimate(0.5, 0.4, 19)
    proof = _proof(Estimate(99.0), Estimate(99.0), Estimate(9.2, 0.2), slack=slack)
    gap = gap_of("found", TIMES, alone, proof, 1, 0.95)
    assert gap.gap == pytest.approx(0.09)
    assert gap.gap_at_most == pytest.approx(Estimate(0.9, 0.5, 19).at_most() / 10)
    assert (gap.bound, gap.path, gap.budget) == (proof.bounds[2], (0, 3), 2)
    assert (gap.relaxation, gap.estimate, gap.filter_model) == (
        slack, alone.estimate, alone.filter_model,
    )  # fmt: skip


def test_a_set_bought_with_money_has_the_bound_of_all_of_the_money() -> None:
    """Whatever the number of its times: the place in the proof says which sum it may spend."""
    alone = SetAlone(Estimate(10.0))
    proof = _proof(Estimate(9.0), Estimate(8.0), slack=Estimate(2.0), budget=1)
    gap = gap_of("found", TIMES, alone, proof, 1, 0.95)
    assert (gap.bound, gap.path, gap.budget) == (Estimate(8.0), (3,), 1)
    assert gap.gap == pytest.approx(0.2)


def test_a_set_clearly_below_the_bound_has_no_bound_and_a_chance_excess_is_no_gap() -> None:
    alone = SetAlone(Estimate(10.0, 0.1), both=Estimate(-0.1, 0.1))

    def gap(slack: float) -> Gap:
        proof = _proof(*[Estimate(0.0)] * 3, slack=Estimate(slack, 0.1, 19))
        return gap_of("found", TIMES, alone, proof, 1, 0.95)

    assert gap(0.0).gap == 0.0
    assert gap(50.0).gap == gap(50.0).gap_at_most == 1.0  # no error is negative
    assert not gap(-0.4).reason
    assert gap(-1.0).reason == "the set costs less than the bound"
