"""Filters that measure by a rule: against fixed sets, exact filters and exact policies."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from oracles import beliefs, watched
from oracles.batched import batched
from oracles.kalman import SCALAR, THREE, kalman_filter, riccati_cost
from oracles.learned import SD, WALK
from oracles.limits import limits
from oracles.ruled import filter_by_rule
from oracles.three_sensors import HORIZON, SYSTEMS
from pfdist import StateSpaceModel, load_model
from pfdist.common.measurement_times import Lag, Times
from pfdist.constraints.setup import Setup
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_checked_draws, filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.rules import ALWAYS, NEVER, Applied, Thresholds
from pfdist.models.learned import learned

INSTANTS = tuple(range(13))
SLOW = pytest.mark.slow
RULES = Thresholds((5.0,)), Thresholds((3.0,), 0.5, 4), Thresholds((2.0,), 1.0, 2)


def check_against_plain(
    model: StateSpaceModel, draws: Draws, candidates: Times, settings: Estimation
) -> FilterArrays:
    """The results with a rule, after a comparison with the plain filter."""
    found = filter_checked_draws(model, draws, candidates, 3, settings)
    measured, mse = filter_by_rule(model, draws, candidates, 3, settings)
    np.testing.assert_array_equal(found.measured, measured)
    np.testing.assert_allclose(found.mse, mse, rtol=1e-9)
    return found


def check_against_fixed_sets(
    model: StateSpaceModel, draws: Draws, found: FilterArrays, settings: Estimation
) -> None:
    """The bits of each draw are those with the fixed set that its rule chose."""
    for place, row in enumerate(found.measured):
        given = model, draws[place : place + 1], tuple(np.flatnonzero(row).tolist()), 3
        fixed = filter_checked_draws(*given, replace(settings, rule=None))
        assert fixed.mse[0] == found.mse[place]


@pytest.mark.parametrize(
    ("rule", "lag"),
    [(RULES[0], 0), (RULES[1], 12), (RULES[2], 0)]
    + [pytest.param(RULES[k], lag, marks=SLOW) for k in range(3) for lag in (3, 12 * (k != 1))],
)
def test_both_engines_decide_alike_and_as_filters_with_the_sets_that_they_choose(
    ungm: StateSpaceModel, rule: Thresholds, lag: Lag
) -> None:
    draws, candidates = simulate(ungm, 12, range(5, 9), 17), INSTANTS[1:]
    apart = tuple(t + 2 for t in INSTANTS) if rule.limit == 4 else ()
    settings = Estimation(70, "systematic", rule=Applied(rule, limits(apart=apart)), lag=lag)
    found = check_against_plain(ungm, draws, candidates, settings)
    assert not found.measured[:, 0].any()
    assert found.measured.any(axis=1).all()
    assert not rule.limit or found.measured.sum(axis=1).max() <= rule.limit
    gaps = [np.diff(np.flatnonzero(row)).min(initial=9) for row in found.measured]
    assert not apart or min(gaps) == 2
    check_against_fixed_sets(ungm, draws, found, settings)


EACH = Thresholds((ALWAYS, 3.0, NEVER, 2.0, 6.0, ALWAYS, 4.0, NEVER, 1.0, 5.0, ALWAYS, 3.0, 2.0))


@pytest.mark.parametrize("rule", [EACH, EACH._replace(exponent=0.5, limit=5)])
def test_thresholds_of_instants_decide_as_in_the_plain_filter(
    ungm: StateSpaceModel, rule: Thresholds
) -> None:
    draws, settings = simulate(ungm, 12, range(5, 9), 17), Estimation(70, rule=Applied(rule))
    found = check_against_plain(ungm, draws, INSTANTS, settings)
    check_against_fixed_sets(ungm, draws, found, settings)
    measured = found.measured.astype(np.bool_)
    assert measured[:, [0, 5]].all()
    assert not measured[:, [2, 7]].any()
    assert 0 < measured[:, [1, 3, 4, 6, 8, 9]].mean() < 1


def test_a_set_of_times_is_a_rule_even_where_all_particles_agree(ungm: StateSpaceModel) -> None:
    times, formulas = (0, 3, 4, 9), {
        "initial": lambda w, p: (2.0,), "transition": lambda x, t, w, p: (0.5 * x[0],)
    }  # fmt: skip
    collapsed = replace(ungm, process_noise=(), initial_noise=(), **formulas)
    rule = Thresholds(tuple(ALWAYS if t in times else NEVER for t in INSTANTS), 0.5, 4)
    for model in (ungm, collapsed):
        draws = simulate(model, 12, range(5, 9), 17)
        found = filter_checked_draws(model, draws, INSTANTS, 3, Estimation(70, rule=Applied(rule)))
        assert (found.measured == np.isin(INSTANTS, times)).all()
        fixed = filter_checked_draws(model, draws, times, 3, Estimation(70))
        assert (found.mse == fixed.mse).all()


@pytest.mark.parametrize("rule", [Thresholds((4.0,)), EACH._replace(exponent=0.2, limit=7)])
def test_a_flipped_point_is_decided_the_other_way_and_all_before_it_as_usual(
    ungm: StateSpaceModel, rule: Thresholds
) -> None:
    draws, point = simulate(ungm, 12, range(40), 17), 6
    given = ungm, draws, [INSTANTS], [12], 3
    usual = filter_checked_sets(*given, Estimation(70, rule=Applied(rule)))
    flipped = filter_checked_sets(*given, Estimation(70, rule=Applied(rule, flipped=point)))
    is_open = np.isfinite(flipped.deviation)
    assert is_open.all() or rule.limit
    assert (flipped.measured[:, :point] == usual.measured[:, :point]).all()
    changed = flipped.measured[:, point] != usual.measured[:, point]
    assert (changed == is_open).all()
    threshold = rule.thresholds_of(point)
    assert ((flipped.deviation > threshold) == usual.measured[:, point])[is_open].all()
    assert 0 < usual.measured[:, point].mean() < 1


@pytest.mark.plugins("guided")
@pytest.mark.parametrize("rule", [RULES[1], *(pytest.param(RULES[k], marks=SLOW) for k in (0, 2))])
def test_a_guided_filter_decides_as_filters_with_the_sets_that_it_chooses(
    ungm: StateSpaceModel, rule: Thresholds
) -> None:
    draws, settings = simulate(ungm, 12, range(5, 9), 17), Estimation(70, rule=Applied(rule))
    settings = replace(settings, proposal="guided")
    found = filter_checked_draws(ungm, draws, INSTANTS, 3, settings)
    check_against_fixed_sets(ungm, draws, found, settings)


@pytest.mark.parametrize(
    ("model", "level", "settings"),
    [
        pytest.param(THREE.as_model(), 1.2, Estimation(70, "stratified"), id="sums", marks=SLOW),
        pytest.param(batched(load_model("ungm")), 5.0, Estimation(70), id="batched", marks=SLOW),
        pytest.param(load_model("ungm"), 5.0, Estimation(70, threshold=0.5), id="carried weights"),
        pytest.param(load_model("robot"), 0.05, Estimation(70), id="angle", marks=SLOW),
    ],
)
def test_any_spread_and_any_weights_decide_as_in_the_plain_filter(
    model: StateSpaceModel, level: float, settings: Estimation
) -> None:
    settings = replace(settings, rule=Applied(Thresholds((level,))))
    found = check_against_plain(model, simulate(model, 12, range(4), 17), INSTANTS, settings)
    assert 0 < found.measured.sum() < found.measured.size


def test_without_a_spread_that_depends_on_y_a_rule_is_a_fixed_set() -> None:
    model, nothing = SCALAR.as_model(), np.zeros((13, 1))
    draws = simulate(model, 12, range(8), 1)
    chosen = dict[tuple[int, ...], float]()
    for level in (0.9, 1.25, 1.5):
        times, gap = (), np.inf
        for t in INSTANTS:  # the exact filter measures where its own deviation is too large
            deviation = np.sqrt(kalman_filter(SCALAR, nothing, times)[1][t, 0])
            times += (t,) * int(deviation > level)
            gap = min(gap, abs(deviation / level - 1))
        found = filter_checked_draws(
            model, draws, INSTANTS, 2, Estimation(4000, rule=Applied(Thresholds((level,))))
        )
        wrong = (found.measured != np.isin(INSTANTS, times)).any(axis=1).mean()
        assert gap > 0.06  # more than 5 standard errors of a deviation of 4,000 particles
        assert wrong == 0, level
        chosen[times] = riccati_cost(SCALAR, 12, times)
    assert len(chosen) == 3
    fewest = min(chosen, key=len)
    every = combinations(INSTANTS, len(fewest))
    assert chosen[fewest] >= min(riccati_cost(SCALAR, 12, each) for each in every) - 1e-12


@pytest.mark.parametrize(
    ("rule", "several"),
    [
        (Thresholds((0.45, 0.6, 0.8)), True),
        (Thresholds((0.4, 0.3, np.inf), 0.5, 3.0), False),
        pytest.param(Thresholds((0.45, 0.6, 0.8)), False, marks=SLOW),
        pytest.param(Thresholds((0.4, 0.3, np.inf), 0.5, 3.0), True, marks=SLOW),
    ],
)
def test_sensors_decide_alike_in_both_engines_and_as_filters_with_their_sets(
    rule: Thresholds, several: bool
) -> None:
    model, prices = SYSTEMS[0].as_model(), (1.0, 0.25, 2.0)
    draws, candidates = simulate(model, HORIZON, range(5, 9), 17), tuple(range(1, 3 * HORIZON))
    apart = () if several else tuple(range(1, HORIZON + 2))
    settings = Estimation(
        70, rule=Applied(rule, limits(apart=apart, prices=prices * (HORIZON + 1)))
    )
    found = check_against_plain(model, draws, candidates, settings)
    each = found.measured.reshape(4, HORIZON + 1, 3)
    assert each.any(axis=(0, 1)).tolist() == [True, True, rule.thresholds[2] < np.inf]
    assert (each.sum(axis=2).max() > 1) == several
    assert not rule.limit or 2.75 < (each @ prices).sum(axis=1).max() <= rule.limit
    check_against_fixed_sets(model, draws, found, settings)


ENDS = tuple(p for t in range(HORIZON + 1) for p in [3 * (t + 4)] * 3)
LIMITED = {
    "most, apart, required": limits(
        3 * (HORIZON + 1), required=(8, 22), most=(3, 99, 2),
        own_apart=((), *[tuple(t + 2 for t in range(HORIZON + 1))] * 2),
    ),
    "groups, delays": limits(delays=(0, 2, 1), numbers=(1, 2, 2)),
    "paid visits and installations": limits(
        3 * (HORIZON + 1), install=(1, 0, 1), visits=Setup(ends=ENDS, price=1, most=3),
        required=(22,),
    ),
    "visits": limits(visits=Setup(ends=ENDS, most=2), required=(10,)),
}  # fmt: skip


@pytest.mark.parametrize("limit", [0.0, 8.0])
@pytest.mark.parametrize("name", LIMITED)
def test_the_compiled_filter_asks_what_may_follow_as_the_plain_one(name: str, limit: float) -> None:
    model, follows = SYSTEMS[0].as_model(), LIMITED[name]
    delays, every = follows.delays or (0, 0, 0), range(3 * (HORIZON + 1))
    candidates = tuple(p for p in every if p // 3 >= delays[p % 3])
    draws, rule = (
        simulate(model, HORIZON, range(5, 9), 17),
        Thresholds((0.25, 0.3, 0.28), 0.5, limit),
    )
    settings = Estimation(70, rule=Applied(rule, follows))
    found = check_against_plain(model, draws, candidates, settings)
    free = check_against_plain(model, draws, candidates, replace(settings, rule=Applied(rule)))
    assert (found.measured != free.measured).any(axis=1).sum() > 2  # the constraints bind
    assert found.measured[:, list(follows.required)].all()
    check_against_fixed_sets(model, draws, found, settings)


def test_with_two_sensors_a_rule_is_the_fixed_set_of_its_thresholds() -> None:
    draws, sets = simulate(watched.WALK, watched.HORIZON, range(8), 1), {}
    apart = tuple(range(1, watched.HORIZON + 2))
    for thresholds in ((1.55, 1.85), (1.6, 1.3), (1.2, np.inf), (np.inf, 1.55)):
        error, price, points, near = watched.of_thresholds(thresholds)
        settings = Estimation(4000, rule=Applied(Thresholds(thresholds), limits(apart=apart)))
        every = tuple(range(2 * watched.HORIZON + 2))
        found = filter_checked_draws(watched.WALK, draws, every, 2, settings)
        assert near > 0.05, thresholds  # more than 4 standard errors of a deviation
        assert (found.measured == np.isin(every, points)).all()
        sets[points] = price, error
    assert len(sets) == 4
    price, error = min(sets.values())
    assert error >= watched.best_set(price) - 1e-12


def test_what_is_not_known_of_a_learned_parameter_counts_as_spread() -> None:
    model = learned(WALK, {"drift": {"normal": (0.0, 0.3)}})
    draws, t = simulate(model, 12, range(8), 1), np.arange(13.0)
    found = filter_checked_draws(
        model, draws, INSTANTS, 2, Estimation(4000, rule=Applied(Thresholds((2.0,))))
    )
    deviation = np.sqrt(1.0 + SD**2 * t + (1.0 + t**2) * 0.3**2)  # before a measurement
    first = int(np.argmax(deviation > 2.0))
    assert abs(deviation[[first - 1, first]] / 2.0 - 1.0).min() > 0.05
    assert deviation[-1] > 2.0 > np.sqrt(1.0 + SD**2 * t[first])
    assert (found.measured.argmax(axis=1) == first).all()


def test_on_a_chain_of_two_states_the_best_rule_is_worse_than_the_plan_and_than_any_bound() -> None:
    instants, rules = (
        range(beliefs.HORIZON + 1),
        [
            Thresholds((threshold,), exponent, beliefs.BUDGET)
            for threshold in np.linspace(0.05, 0.5, 4)
            for exponent in (0.0, 1.0, 2.0)
        ]
        + [Thresholds((0.18,), 1.0, beliefs.BUDGET)],
    )
    (best, number), rule = min((beliefs.of_rule(rule), rule) for rule in rules)
    plan = min(map(beliefs.of_set, combinations(instants, beliefs.BUDGET)))
    assert (round(plan, 5), round(best, 5)) == (0.12233, 0.12317)
    assert plan == beliefs.of_set((1, 3, 5))
    policy = beliefs.best_policy(beliefs.BUDGET)
    assert round(policy, 5) == 0.12118
    bound = beliefs.average_bound(beliefs.BUDGET, np.linspace(0.03, 0.07, 3))
    assert bound <= policy < plan < best
    for average in (Thresholds((0.458,)), Thresholds((0.43,))):
        error, number = beliefs.of_rule(average)
        assert error >= beliefs.average_bound(number, np.array([0.05, 0.1]))
    # The particle filter finds the same error: the best rule's decisions leave room for its noise.
    draws = simulate(beliefs.CHAIN, beliefs.HORIZON, range(2000), 1)
    found = filter_checked_draws(
        beliefs.CHAIN, draws, tuple(instants), 2, Estimation(500, rule=Applied(rule))
    )
    error = found.mse.std() / np.sqrt(found.mse.size)
    assert abs(found.mse.mean() - best) < 4 * error
    assert found.measured.sum(axis=1).max() == beliefs.BUDGET
