"""A race against what its rounds must be, and against the law of the last one."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.search import Candidate, Race

Array = NDArray[np.float64]


def _run(race: Race, mse: dict[Times, Array]) -> tuple[list[Evaluation], list[list[Candidate]]]:
    """The sets that ran, the winner first, and what a race asked for round by round."""
    state, rng, rounds = race.init(), np.random.default_rng(0), []
    while not race.done(state):
        asked = race.ask(state, rng)
        rounds.append(asked)
        columns = [mse[candidate.measurement_times][: candidate.draws] for candidate in asked]
        told = zip(asked, columns, strict=True)
        state = race.tell(state, [Evaluation(asked_for[0], column) for asked_for, column in told])
    return list(race.finalists(state)), rounds


def test_it_goes_on_with_those_that_may_be_the_best_and_decides_on_all_their_draws() -> None:
    """Sixteen sets, of which one is hardly worse than the best and all others are far worse.

    After a round of 250 draws two are left, and 500 draws decide between them: the best wins with
    the probability that a normal difference of that standard deviation is on its side, which is
    larger than if as many draws were spread evenly.
    """
    sets: list[Times] = [(0, t) for t in range(1, 17)]
    apart, races = 0.06, 400
    means = np.array([0.0, apart, *[1.0] * 14])
    wins, spent = 0, []
    for seed in range(races):
        rng = np.random.default_rng(seed)
        common, own = rng.normal(0, 10, 500), rng.normal(size=(16, 500))
        mse = dict(zip(sets, means[:, None] + own + common, strict=True))
        found, rounds = _run(Race(tuple(sets), 250), mse)
        wins += found[0].measurement_times == sets[0]
        assert [len(asked) for asked in rounds] in ([16, 2], [16])  # seldom one is enough
        spent.append(sum(250 * len(asked) for asked in rounds))  # the first 250 are known by then
    probability = stats.norm.cdf(apart / math.sqrt(2 / 500))
    standard_error = math.sqrt(probability * (1 - probability) / races)
    assert wins / races == pytest.approx(probability, abs=4 * standard_error)
    evenly = stats.norm.cdf(apart / math.sqrt(2 / (np.mean(spent) / 16)))
    assert wins / races > evenly + 2 * standard_error


def test_of_sets_that_no_test_tells_apart_the_worse_half_falls_out() -> None:
    """All that ran are given, each on the most draws that it ran on, and the winner first."""
    sets: list[Times] = [(0, t) for t in range(1, 9)]
    noise = np.random.default_rng(1).normal(size=(8, 1000))
    mse = dict(zip(sets, noise - noise.mean(axis=1, keepdims=True), strict=True))
    race = Race(tuple(sets), 250)
    found, rounds = _run(race, mse)
    asked = [(len(some), {candidate.draws for candidate in some}) for some in rounds]
    assert asked == [(8, {250}), (4, {500}), (2, {1000})]
    assert race.generations == 3
    of_half = sorted(sets, key=lambda times: float(mse[times][:250].mean()))[:4]
    assert {candidate.measurement_times for candidate in rounds[1]} == set(of_half)
    assert [each.draws for each in found] == [1000, 1000, 500, 500, 250, 250, 250, 250]
    assert {each.measurement_times for each in found} == set(sets)
    assert {each.measurement_times for each in found[:4]} == set(of_half)
    assert found[0].expected_mse <= found[1].expected_mse


def test_one_alone_runs_one_round_and_a_killed_one_never_wins() -> None:
    alive, dead = np.ones(100), np.r_[np.ones(99), np.nan]
    (found,), rounds = _run(Race(((0, 1),), 100), {(0, 1): alive})
    assert (found.measurement_times, rounds) == ((0, 1), [[Candidate((0, 1), draws=100)]])
    (first, *_), rounds = _run(Race(((0, 1), (0, 2)), 100), {(0, 1): dead, (0, 2): 5 * alive})
    assert (first.measurement_times, len(rounds)) == ((0, 2), 1)


def test_a_difference_is_that_of_the_paired_t_test() -> None:
    rng = np.random.default_rng(2)
    first, other = rng.normal(1.0, 5.0, 300) + rng.normal(size=(2, 300))
    found = Evaluation((0, 1), first).difference(Evaluation((0, 2), other[:200]))
    expected = stats.ttest_rel(first[:200], other[:200])
    assert found.value / found.standard_error == pytest.approx(expected.statistic)
    assert found.value == pytest.approx(np.mean(first[:200] - other[:200]))


def test_the_foreseen_work_counts_the_sets_that_drop_out() -> None:
    """A hundred sets of which a dozen are alike: draws that nobody has filtered yet, in rounds."""
    sets: list[Times] = [(0, t) for t in range(1, 97)]
    noise = np.random.default_rng(3).normal(size=(96, 96 * 2**6))
    noise -= noise.mean(axis=1, keepdims=True)
    mse = dict(zip(sets, np.repeat((0.0, 3.0), (12, 84))[:, None] + noise, strict=True))
    race = Race(tuple(sets), 96, kept=12, until=600)
    _, rounds = _run(race, mse)
    draws = [len(asked) * (asked[0].draws or 0) for asked in rounds]
    new = draws[0] + sum(each / 2 for each in draws[1:])
    assert race.evaluations * race.draws == pytest.approx(new, rel=0.2)
    assert race.evaluations < 0.7 * Race(race.sets, race.draws).evaluations


def test_a_leader_that_missed_its_rare_large_errors_drops_no_set_before_tests_decide() -> None:
    """A set with the lowest error in 39 of 40 draws, and a larger mean than all others."""
    sets: list[Times] = [(0, t) for t in range(1, 17)]
    best, wins = sets[3], {True: 0, False: 0}
    for seed in range(100):
        rng = np.random.default_rng(seed)
        mse = {times: 1.0 + 0.1 * rng.normal(size=2048) for times in sets}
        mse[best] -= 0.3
        mse[sets[0]] = np.where(rng.random(2048) < 1 / 40, 80.0, 0.5)
        for waits in wins:
            race = Race(tuple(sets), 32, tested_from=1024 * waits)
            wins[waits] += _run(race, mse)[0][0].measurement_times == best
    # It meets none of them in the first 32 draws with the probability (39/40)^32. Then it leads.
    missed = 100 * (39 / 40) ** 32
    assert wins[True] == 100
    assert abs(100 - missed - wins[False]) <= 3 * math.sqrt(missed * (1 - missed / 100))
