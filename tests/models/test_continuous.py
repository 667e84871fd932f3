"""Transitions in continuous time: exact solutions, orders of convergence, uneven clocks, loops."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

import pfdist
from oracles.moments import assert_covariance
from pfdist import StateSpaceModel, ode, sde
from pfdist.errors import ArgumentError, JobError, ModelError, PfdistError
from pfdist.filters import plain
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.simulation import simulate
from pfdist.models import continuous
from pfdist.models.continuous import doubled, with_events
from pfdist.models.recorded import recorded
from pfdist.models.written import models_of, text_of_models
from pfdist.runner.build import models_of_job

A = np.array([[-0.3, 0.5], [-0.4, -0.1]])
B = np.array([[0.3, 0.1], [0.0, 0.2]])
START = (1.0, 2.0)
CLOCK = (0.0, 1.0, 1.5, 3.0, 3.25, 5.0)


def linear(x, t, p):
    return A @ x


def made(transition, **fields):
    """A model that is measured by its first component, with a known start."""
    given = {
        "initial": lambda w, p: START,
        "measurement": lambda x, t, v, p: (x[0] + v[0],),
        "log_likelihood": lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        "quantity_of_interest": lambda x, t, p: x,
        "initial_noise": (),
        "process_noise": getattr(transition, "process_noise", ()),
        "measurement_noise": ("normal",),
    }
    return StateSpaceModel("continuous", transition=transition, **(given | fields))


def solved(transition, clock=CLOCK):
    """The states at all instants of the clock, (T+1, n), by compiled code."""
    model = made(transition).on_clock(clock)
    return simulate(model, len(clock) - 1, range(1), 0).x[0]


# --- ordinary differential equations --------------------------------------------------------------


@pytest.mark.parametrize(("method", "order"), [("heun", 2), ("rk4", 4)])
def test_the_error_falls_with_the_order_of_the_method(method, order):
    """Against the exponential of the matrix, on an uneven clock; the ratio has an error O(h)."""
    exact = np.array([expm(A * t) @ START for t in CLOCK])
    models = [made(ode(linear, method=method, substeps=n)).on_clock(CLOCK) for n in (4, 8, 16)]
    errors = [np.abs(plain.simulate(each, 5, range(1), 0).x[0] - exact).max() for each in models]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.25)


def test_a_largest_step_cuts_each_interval_into_as_few_steps_as_it_can():
    """Intervals of 1, 1/2, 3/2, 1/4 and 7/4 have 4, 2, 6, 1 and 7 steps of 1/4."""
    expected = [START]
    for dt, count in zip(np.diff(CLOCK), (4, 2, 6, 1, 7), strict=True):
        expected.append(ode(linear, substeps=count, dt=dt)(expected[-1], 0, (), None))
    np.testing.assert_allclose(solved(ode(linear, largest_step=0.25)), expected, rtol=1e-14)


def test_the_right_hand_side_reads_the_time_on_the_clock():
    """dx/dt = t^3 is a cubic, which Runge and Kutta's method integrates exactly."""
    transition = ode(lambda x, t, p: (t**3 + 0 * x[0], 0 * x[1]), substeps=1)
    expected = START[0] + np.array(CLOCK) ** 4 / 4
    np.testing.assert_allclose(solved(transition)[:, 0], expected, rtol=1e-14)


def test_without_a_clock_instants_are_dt_apart():
    expected = np.array([expm(A * 0.5 * t) @ START for t in range(3)])
    for transition, parameters in (
        (ode(linear, dt=0.5), {}),
        (ode(linear, dt="interval"), {"interval": 0.5}),
    ):
        model = made(transition, parameters=parameters)
        states = simulate(model, 2, range(1), 0).x[0]
        np.testing.assert_allclose(states, expected, rtol=1e-7)


def test_an_equation_that_the_transition_makes_reads_a_covariate():
    def transition(x, t, w, p):
        return ode(lambda x, s, p: (p.rain[t], s))(x, t, (), p)

    rain = (1.0, 2.0, 4.0, 8.0, 16.0, 0.0)
    model = made(transition, parameters={"rain": rain}).on_clock(CLOCK)
    states = simulate(model, len(CLOCK) - 1, range(1), 0).x[0]
    total = np.concatenate([[0.0], np.cumsum(np.diff(CLOCK) * rain[:-1])])
    np.testing.assert_allclose(states[:, 0], START[0] + total, rtol=1e-14)
    np.testing.assert_allclose(states[:, 1], START[1] + np.array(CLOCK) ** 2 / 2, rtol=1e-14)


@pytest.mark.parametrize("dt", [0.5, "interval"])
def test_a_clock_goes_before_dt(dt):
    model = made(ode(linear, dt=dt), parameters={"interval": 0.5}).on_clock(CLOCK)
    states = simulate(model, len(CLOCK) - 1, range(1), 0).x[0]
    np.testing.assert_array_equal(states, solved(ode(linear)))


def test_the_kalman_filter_takes_a_linear_equation():
    """The exact error of a linear system is that with the matrix exponential in its place."""

    def exact(x, t, w, p):
        return tuple(after @ x)

    def model_with(transition):
        return made(
            transition,
            initial=lambda w, p: (w[0], 2.0 * w[1]),
            initial_noise=("normal", "normal"),
            linear_gaussian=True,
        )

    after, sets = expm(A), [(), (0, 3), (1, 2, 4)]
    errors = [
        exact_mse(Evaluator(model_with(transition), 5, engine="kalman"), sets)
        for transition in (ode(linear), exact)
    ]
    np.testing.assert_allclose(*errors, rtol=1e-6)


# --- doses and other events -----------------------------------------------------------------------

RATES = np.array([[-0.3, 0.0, 0.0], [0.3, -0.25, 0.2], [0.0, 0.17, -0.2]])
DOSES = [(36.5, 100.0, 0), (7.0, "loading", 0), (7.0, 20.0, 1), (64.5, "dose", 0)]
VISITS = (
    (0.0, 1.0, 7.0, 8.0, 21.0, 36.5, 40.0, 64.5, 70.0, 84.0),
    (0.0, 6.0, 30.0, 38.0, 60.0, 84.0),
    (0.0, 84.0),
)


def dosed(events, **steps):
    """Three compartments: a depot, the blood and the tissue."""
    return made(
        ode(lambda x, t, p: RATES @ x, events=events, **steps),
        initial=lambda w, p: (0.0, 30.0, 0.0),
        parameters={"loading": 250.0, "dose": 100.0},
    )


def after_doses(time, parameters):
    """The exact state: a dose at this very time comes after it."""
    x, now = np.array([0.0, 30.0, 0.0]), 0.0
    for at, amount, component in sorted(DOSES, key=lambda event: event[0]):
        if at < time:
            x = expm(RATES * (at - now)) @ x
            x[component] += parameters.get(amount, amount)
            now = at
    return expm(RATES * (time - now)) @ x


@pytest.mark.parametrize("clock", VISITS)
@pytest.mark.parametrize("steps", [{"substeps": 200}, {"largest_step": 0.25}])
def test_doses_at_instants_and_between_them_are_exact(clock, steps):
    model = dosed(DOSES, **steps).on_clock(clock)
    expected = [after_doses(time, model.parameters) for time in clock]
    states = simulate(model, len(clock) - 1, range(1), 0).x[0]
    np.testing.assert_allclose(states, expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(
        plain.simulate(model, len(clock) - 1, range(1), 0).x[0], states, rtol=1e-10, atol=1e-10
    )


def test_a_recorded_model_takes_other_doses_and_another_clock():
    """Its program has the events, and reads the amounts and the times."""
    first, second = VISITS[1:]
    model = recorded(dosed(DOSES, largest_step=0.25).on_clock(first), range(len(first)))
    other, _ = models_of(text_of_models(model, model).encode())
    other = other.with_parameters({"loading": 80.0, "time": second, "dt": (84.0, 84.0)})
    (x,) = simulate(other, 1, range(1), 0).x[:, 1]
    np.testing.assert_allclose(x, after_doses(84.0, {"loading": 80.0, "dose": 100.0}), rtol=1e-5)


@pytest.mark.parametrize("start", [0.0, 1.7e9], ids=["from zero", "seconds of an epoch"])
@pytest.mark.parametrize(
    "times",
    [np.arange(31) * 0.1, np.cumsum([0.0] + 30 * [0.1]), np.round(np.arange(31) * 0.1, 1)],
    ids=["products", "sums", "decimals"],
)
def test_a_dose_at_an_instant_is_given_once_however_its_time_is_rounded(times, start):
    events = [(start + 0.1 * k, 1.0, 0) for k in range(1, 30)]
    events += [(start + round(0.1 * k, 1), 1.0, 1) for k in range(1, 30)]
    still = made(ode(lambda x, t, p: (0.0, 0.0), events=events), initial=lambda w, p: (0.0, 0.0))
    states = simulate(still.on_clock(start + times), 30, range(1), 0).x[0]
    expected = np.maximum(np.arange(-1.0, 30.0), 0.0)
    np.testing.assert_array_equal(states, np.stack([expected, expected], axis=1))


def test_events_may_be_an_array_and_begin_an_infusion():
    """A rate of 2 from .25 to 1.5; what is kept within limits is kept after an event, too."""
    events = np.array([[0.25, 2.0, 1.0], [1.5, -2.0, 1.0], [1.75, 9.0, 0.0]])
    keep = lambda x, p: (np.minimum(x[0], 5.0), x[1])  # noqa: E731
    flow = ode(lambda x, t, p: (x[1], 0.0), events=events, substeps=1, keep=keep)
    model = made(flow, initial=lambda w, p: (0.0, 0.0))
    states = simulate(model, 2, range(1), 0).x[0]
    np.testing.assert_allclose(states, [(0.0, 0.0), (1.5, 2.0), (5.0, 0.0)], rtol=1e-14)
    finer = doubled(made(flow, initial=lambda w, p: (0.0, 0.0)))
    np.testing.assert_allclose(simulate(finer, 2, range(1), 0).x[0], states, rtol=1e-14)


def test_a_job_names_the_events_of_an_equation(tmp_path):
    """The table of a file, and its rows in the job, give the states of the events in the model."""
    rows = [[at, 250.0 if amount == "loading" else amount, to] for at, amount, to in DOSES]
    rows[-1][1] = 100.0
    lines = ["amount,time,who,state", *(f"{amount},{at},a,{to}" for at, amount, to in rows)]
    (tmp_path / "doses.csv").write_text("\n".join(lines))
    model, clock = dosed("taken", substeps=2), VISITS[0]
    (tmp_path / "job.toml").write_text(
        "seed = 1\n[model.events]\ntaken = { file = 'doses.csv' }\n"
        "[problem]\nhorizon = 3\nmeasurement_budget = 1\n[[search]]\nmethod = 'exhaustive'\n"
    )
    read = pfdist.load_job(tmp_path / "job.toml").model.events
    assert read == {"taken": tuple(map(tuple, rows))}
    assert not simulate(model.on_clock(clock), 9, range(1), 0).x[0, 1:, 0].any()  # without a job
    given = with_events(read, model)[0].on_clock(clock)
    own = dosed(DOSES, substeps=2).on_clock(clock)
    states = simulate(given, 9, range(1), 0).x
    np.testing.assert_array_equal(states, simulate(own, 9, range(1), 0).x)
    problem = pfdist.Problem(model, times=clock, time_unit="d", measurement_budget=1)
    for events, said in (
        ({"took": rows}, r"model\.events: .* events='taken' must name a table, got took"),
        ({"taken": rows, "other": rows}, "no equation of the model has events='other'; they name"),
        ({}, r"model\.events: .* must name a table, got none"),
        ({"taken": [[1, 2]]}, r"rows of model\.events must be \[time, amount, state\], got"),
    ):
        with pytest.raises(PfdistError, match=said):
            models_of_job(problem.job().with_changes(settings={"model": {"events": events}}))
    job = problem.job().with_changes(settings={"model": {"events": {"taken": rows}}})
    truth, _ = models_of_job(job)
    np.testing.assert_array_equal(simulate(truth.on_clock(clock), 9, range(1), 0).x, states)
    for pair in ((model, own), (own, model)):  # one of the two has no events of the job
        named, _ = sorted(with_events(read, *pair), key=lambda each: each is own)
        np.testing.assert_array_equal(simulate(named.on_clock(clock), 9, range(1), 0).x, states)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("time,amount\n1,2", "the table has no column 'state'"),
        ("time,amount,state\n1,2,0.5", "state must be the number of a component of x, got 0.5"),
        ("time,amount,state\n1,,0", "column 'amount' must hold finite numbers, got nan in row 1"),
    ],
)
def test_a_wrong_table_of_events_is_one_line(tmp_path, table, said):
    (tmp_path / "doses.csv").write_text(table)
    (tmp_path / "job.toml").write_text("seed = 1\n[model.events]\na = { file = 'doses.csv' }\n")
    with pytest.raises(JobError, match=said):
        pfdist.load_job(tmp_path / "job.toml")


# --- stochastic differential equations ------------------------------------------------------------


def test_a_linear_equation_with_noise_has_the_exact_covariance_over_an_uneven_clock():
    """Heun's method has an error of the covariance of order h^2, below a standard error here."""
    transition = sde(linear, lambda x, t, p: B, noises=2, method="heun", substeps=40)
    model = made(transition).on_clock(CLOCK)
    x = simulate(model, 5, range(40_000), 3).x
    for k, t in enumerate(CLOCK[1:], 1):
        covariance = quad_vec(lambda s: expm(A * s) @ B @ B.T @ expm(A * s).T, 0, t)[0]
        factor = np.linalg.cholesky(covariance)
        scaled = np.linalg.solve(factor, (x[:, k] - expm(A * t) @ START).T).T
        assert_covariance(scaled, np.eye(2))


@pytest.mark.parametrize(("method", "drift"), [("euler", 0.2), ("heun", 0.2 + 0.3**2 / 2)])
def test_euler_reads_an_equation_as_ito_and_heun_as_stratonovich(method, drift):
    """dx = .2 x dt + .3 x dW: E[log x(t)] = (drift - .3^2 / 2) t, by either calculus."""
    transition = sde(
        lambda x, t, p: (0.2 * x[0], 0.0),
        lambda x, t, p: ((0.3 * x[0],), (0.0,)),
        noises=1, method=method, substeps=200,
    )  # fmt: skip
    x = simulate(made(transition), 1, range(40_000), 3).x[:, 1, 0]
    mean, error = np.log(x).mean(), np.log(x).std() / np.sqrt(x.size)
    assert abs(mean - (drift - 0.3**2 / 2)) < 4 * error + 1e-3  # and the bias of a step of 1/200


def test_paths_converge_strongly_with_the_order_one_half():
    """Euler and Maruyama on the same Brownian path, against the solution of dx = x dW (Ito)."""
    rng, errors = np.random.default_rng(4), list[float]()
    finest = rng.normal(size=(256, 2000))
    exact = np.exp(finest.sum(axis=0) / 16 - 0.5)
    for count in (4, 16, 64):
        w = finest.reshape(count, 256 // count, -1).sum(axis=1) / np.sqrt(256 // count)
        transition = sde(
            lambda x, t, p: (0.0 * x[0],), lambda x, t, p: (x[0],), noises=1, substeps=count
        )
        (x,) = transition((np.ones(2000),), 0, tuple(w), None)
        errors.append(float(np.abs(x - exact).mean()))
    orders = np.log2(np.array(errors[:-1]) / errors[1:]) / 2  # each has four times as many steps
    np.testing.assert_allclose(orders, 0.5, atol=0.1)


@pytest.mark.parametrize(
    "diffusion",
    [
        lambda x, t, p: ((0.3, 0.1 * x[0]), (0.0, 0.2)),
        lambda x, t, p: np.array([[0.3, 0.1 * x[0]], [0.0, 0.2]]),
    ],
)
def test_rows_of_the_diffusion_may_be_tuples_lists_or_arrays(diffusion):
    model = made(sde(linear, diffusion, noises=2, substeps=1))
    x = simulate(model, 1, range(2), 3).x[:, 1]
    expected = made(
        lambda x, t, w, p: (
            x[0] - 0.3 * x[0] + 0.5 * x[1] + 0.3 * w[0] + 0.1 * x[0] * w[1],
            x[1] - 0.4 * x[0] - 0.1 * x[1] + 0.2 * w[1],
        ),
        process_noise=("normal", "normal"),
    )
    np.testing.assert_allclose(x, simulate(expected, 1, range(2), 3).x[:, 1], rtol=1e-12)


def test_each_step_has_its_own_noise_and_is_kept_within_limits():
    def keep(x, p):
        return (np.maximum(x[0], p.least), x[1])

    transition = sde(
        lambda x, t, p: (0.0, 1.0), lambda x, t, p: (1.0, 2.0), noises=2, substeps=3, dt=3.0,
        keep=keep,
    )  # fmt: skip
    model = made(transition, parameters={"least": 0.5})
    w = (-0.4, 1.0, -0.3, 2.0, 0.7, 3.0)
    # 1 - .4 = .6; .6 - .3 = .3, kept at .5; .5 + .7. And 2 + 3 of drift + 2 (1 + 2 + 3).
    expected = (1.2, 17.0)
    assert transition(START, 0, w, model.p) == pytest.approx(expected)
    twin = recorded(model, range(2)).transition(START, 0, w, model.p)
    assert twin == pytest.approx(expected)


# --- loops in programs ----------------------------------------------------------------------------


def tank(substeps):
    """A tank with an unknown inflow: a model with many short steps."""
    return sde(
        lambda x, t, p: (x[1] - p.outflow * np.sqrt(np.maximum(x[0], 0.0)), -0.1 * x[1]),
        lambda x, t, p: (0.0, p.spread),
        noises=2,
        substeps=substeps,
    )


def test_a_program_does_not_grow_with_the_number_of_steps():
    sizes = []
    for substeps in (2, 100):
        model = made(tank(substeps), parameters={"outflow": 0.3, "spread": 0.2})
        (program,) = recorded(model, range(4)).transition.traced.programs
        sizes.append(sum(bool(arguments) for _, arguments, _ in program.operations))
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize("substeps", [1, 7])
def test_a_loop_has_the_bits_of_steps_that_are_written_out(substeps):
    flow = tank(substeps)

    def written_out(x, t, w, p):
        h, root = 1.0 / substeps, np.sqrt(1.0 / substeps)
        for k in range(substeps):
            dw = tuple(root * each for each in w[2 * k : 2 * k + 2])
            x = flow.step(x, t + k * h, h, dw, p)
        return x

    states = []
    for transition in (flow, written_out):
        model = made(
            flow, parameters={"outflow": 0.3, "spread": 0.2}, process_noise=flow.process_noise
        )
        model = dataclasses.replace(model, transition=transition)
        states.append(simulate(model, 6, range(100), 1).x)
    np.testing.assert_array_equal(*states)


def test_a_model_with_loops_travels_as_text_with_all_bits():
    model = recorded(made(tank(5), parameters={"outflow": 0.3, "spread": 0.2}), range(7))
    read, _ = models_of(text_of_models(model, model).encode())
    assert read.transition == model.transition
    states = [simulate(each, 6, range(100), 1).x for each in (model, read)]
    np.testing.assert_array_equal(*states)


# --- twice as many steps --------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["euler", "heun"])
def test_twice_as_many_steps_follow_the_same_brownian_motions(method):
    """Halves (a + b) / sqrt 2 and (a - b) / sqrt 2 of a step: a rotation of normal variates."""

    def flow(substeps):
        return sde(linear, lambda x, t, p: B, noises=2, method=method, substeps=substeps)

    model, noise = made(flow(3)), np.random.default_rng(0).standard_normal((2, 3, 2))
    halves = np.stack([noise[0] + noise[1], noise[0] - noise[1]], axis=1) / np.sqrt(2)
    finer = doubled(model)
    assert finer.process_noise == ("normal",) * 12
    x = finer.transition(START, 0, tuple(noise.ravel()), None)
    assert x == pytest.approx(flow(6)(START, 0, tuple(halves.ravel()), None), rel=1e-13)
    still = made(sde(lambda x, t, p: (0.0, 0.0), lambda x, t, p: B, noises=2, substeps=3))
    few, many = (simulate(each, 5, range(50), 1).x for each in (still, doubled(still)))
    np.testing.assert_allclose(few, many, rtol=1e-12, atol=1e-12)  # without drift, it is the end


@pytest.mark.parametrize(("given", "twice"), [
    ({"substeps": 3}, {"substeps": 6}), ({"largest_step": 0.25}, {"largest_step": 0.125})
])  # fmt: skip
def test_twice_as_many_steps_of_an_equation_in_a_transition(given, twice):
    def model(**steps):
        rest = ode(linear, **steps)
        step = lambda x, t, w, p: tuple(a + 0.2 * w[0] for a in rest(x, t, (), p))  # noqa: E731
        return made(step, process_noise=("normal",)).on_clock(CLOCK)

    finer = doubled(model(**given))
    assert len(finer.process_noise) == 1
    states = [simulate(each, len(CLOCK) - 1, range(50), 1).x for each in (finer, model(**twice))]
    np.testing.assert_array_equal(*states)


def test_what_has_no_equation_is_not_changed():
    walk = made(lambda x, t, w, p: x)
    for model in (walk, recorded(made(ode(linear)), range(3))):
        assert doubled(model) is model


# --- mistakes -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"substeps": 0}, "substeps must be at least 1, got 0"),
        ({"largest_step": 0.0}, "largest_step must be greater than 0, got 0.0"),
        ({"method": "rk5"}, "method: got 'rk5'; did you mean 'rk4'? Allowed: 'rk4' or 'heun'"),
        ({"substeps": 3, "largest_step": 0.1}, "ode takes substeps or largest_step, got both"),
        ({"events": [(1.0, 2.0)]}, "events must be rows (time, amount, component of x), got [(1.0"),
        ({"events": [(np.inf, 2.0, 0)]}, "events must be a finite number, got inf"),
        ({"events": [(1.0, 2.0, 0.5)]}, "events must be an integer, got 0.5"),
    ],
)
def test_a_wrong_argument_is_one_line(arguments, message):
    with pytest.raises(ArgumentError) as refused:
        ode(linear, **arguments)
    assert str(refused.value).startswith(message)


def test_a_wrong_equation_is_one_line_that_names_it():
    with pytest.raises(ModelError, match=r"rhs must give 2 components, one for each of x, got 1"):
        made(ode(lambda x, t, p: (x[0],)))
    with pytest.raises(ModelError, match=r"diffusion must give a row of noises = 1 numbers"):
        made(sde(linear, lambda x, t, p: (1.0, 1.0), noises=1))
    with pytest.raises(ModelError, match=r"events must name components of x below 2, got 2"):
        made(ode(linear, events=[(0.5, 1.0, 2)]))
    flow = sde(linear, lambda x, t, p: (1.0, 1.0), noises=2)
    with pytest.raises(ModelError, match=r"process_noise must have 20 entries.*got 3"):
        made(flow, process_noise=("normal",) * 3)


def test_instants_of_uneven_distances_need_a_clock():
    """The time of an instant would be unknown."""
    model = made(ode(linear, dt="interval"), parameters={"interval": (0.5, 0.5, 9.0)})
    with pytest.raises(ModelError, match="'interval', which varies with t: uneven instants need a"):
        simulate(model, 2, range(1), 0)


@pytest.mark.parametrize("events", [[], [(0.505, 0.0, 0)]], ids=["no event", "an event"])
def test_too_many_steps_are_not_fewer_steps(events, monkeypatch):
    """A step that is too small for the largest number of steps gives no number."""
    monkeypatch.setattr(continuous, "MOST_STEPS", 100)
    solved(ode(linear, largest_step=1 / (100 - len(events)), events=events), (0.0, 1.0))
    with pytest.raises(ModelError, match=r"must stay finite, got x\[0\] = nan at t = 1"):
        solved(ode(linear, largest_step=1 / (101 - len(events)), events=events), (0.0, 1.0))
    with pytest.raises(ArgumentError, match="at most 100 substeps and events together, got 91"):
        ode(linear, events=[(0.5, 0.0, 0)] * 91)


def test_a_value_of_a_step_is_not_kept():
    kept = []

    def leaking(x, t, p):
        kept.append(x[0])
        return (-x[0], kept[0])

    with pytest.raises(ModelError):
        recorded(made(ode(leaking)), range(3))
