"""The guard withdraws what more particles, or known sets, contradict, and nothing else."""

from dataclasses import replace

import pytest

from pfdist.bounds.gap import Gap, SetAlone, gap_of
from pfdist.bounds.guard import Falls, guarded
from pfdist.bounds.proof import Estimate, Proof

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
STEADY = Estimate(0.001, 0.002)


def _guarded(*gaps: Gap, bounds: Estimate = STEADY, sets: Estimate = STEADY) -> dict[str, Gap]:
    falls = Falls([bounds] * 3, [sets] * len(gaps), "80 particles in the place of 20")
    return guarded({gap.name: gap for gap in gaps}, falls)


def test_what_nothing_contradicts_stands_and_its_limit_holds_the_fall() -> None:
    assert _guarded(GAP)["found"] == replace(GAP, gap_at_most=0.03 + 0.001, fall=0.001)
    rises = Estimate(-0.01, 0.001)
    assert _guarded(GAP, bounds=rises, sets=rises)["found"] == replace(GAP, fall=0.0)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"bounds": Estimate(0.02, 0.004)}, "the bound falls by 2 % with 80 particles in the"),
        ({"sets": Estimate(0.02, 0.004)}, "the variance of a compared set falls with 80"),
    ],
)
def test_a_clear_fall_withdraws_the_bound(changed: dict[str, Estimate], reason: str) -> None:
    found = _guarded(GAP, **changed)["found"]
    assert found.reason.startswith(reason)
    assert found == Gap("found", TIMES, GAP.expected_mse, found.reason)


@pytest.mark.parametrize("fall", [Estimate(0.02, 0.006), Estimate(0.004, 0.0001)])
def test_neither_noise_nor_half_a_per_cent_is_a_fall(fall: Estimate) -> None:
    assert not _guarded(GAP, bounds=fall, sets=fall)["found"].reason


def test_a_variance_above_the_squared_error_withdraws_all_bounds() -> None:
    other = replace(GAP, name="other", estimate=Estimate(-0.5, 0.1))
    reasons = {gap.reason for gap in _guarded(GAP, other).values()}
    assert reasons == {"the variance of the particles exceeds their squared error"}


def test_a_known_set_that_costs_less_than_the_bound_withdraws_it() -> None:
    cheap = replace(GAP, name="cheap", expected_mse=Estimate(9.0, 0.1))
    assert _guarded(GAP, cheap)["found"].reason == "the set cheap costs less than the bound"
    near = replace(cheap, expected_mse=Estimate(9.7, 0.1))
    assert not _guarded(GAP, near)["found"].reason
    for times in ((1,), (1, 4, 5)):  # of another number of measurements: that contradicts nothing
        falls = Falls([STEADY] * 4, [STEADY] * 2, "")
        other = replace(cheap, measurement_times=times, budget=len(times))
        assert not guarded({"found": GAP, "cheap": other}, falls)["found"].reason


def _proof(*bounds: Estimate, slack: Estimate, budget: int = 2) -> Proof:
    paths = [(), (3,), (0, 3)][: len(bounds)]
    return Proof(list(bounds), paths, [0, budget], [Estimate(77.0), slack], 20)


def test_a_gap_is_the_sum_of_its_parts_with_an_error_of_its_own() -> None:
    alone = SetAlone(Estimate(10.0, 0.1), Estimate(0.3), Estimate(0.1), Estimate(0.4, 0.3))
    slack = Estimate(0.5, 0.4)
    proof = _proof(Estimate(99.0), Estimate(99.0), Estimate(9.2, 0.2), slack=slack)
    gap = gap_of("found", TIMES, alone, proof, 1, 0.95)
    assert gap.gap == pytest.approx(0.09)
    assert gap.gap_at_most == pytest.approx(Estimate(0.9, 0.5).at_most(19) / 10)
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
        proof = _proof(*[Estimate(0.0)] * 3, slack=Estimate(slack, 0.1))
        return gap_of("found", TIMES, alone, proof, 1, 0.95)

    assert gap(0.0).gap == 0.0
    assert not gap(-0.4).reason
    assert gap(-1.0).reason == "the set costs less than the bound"
