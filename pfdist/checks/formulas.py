"""Checks that formulas are pure, elementwise and quick, and the likelihood right, on a few draws.

Each check gives a state, "ok", "note" or "wrong", and a text.
"""

import ast
import math
import types
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.rounding import with_error
from pfdist.filters.draws import Draws
from pfdist.filters.engines import ENGINES
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation
from pfdist.kernels.noise import TRUTH_INITIAL, TRUTH_MEASUREMENT, TRUTH_PROCESS, variates
from pfdist.models import StateSpaceModel
from pfdist.models.mistakes import place_of_function
from pfdist.models.seeing import names_in
from pfdist.models.syntax import node_of

Array = NDArray[np.float64]

MEASUREMENTS = 20_000  # simulated at one state, to compare with the log-likelihood
_PAIRS = 8  # of states, at each of a few instants
_RARE = 0.005  # smallest share of measurements that is evidence: 100 of 20,000
_LARGEST_Z = 5.0  # standard errors; 1 in 10^6 of right models is blamed for each comparison


# --- formulas as functions ----------------------------------------------------------------------


def _calls(model: StateSpaceModel, draws: Draws, t: int) -> dict[str, tuple[Any, ...]]:
    """Arguments for each formula: the states of all draws at t, and noise."""

    def noise(kinds: tuple[str, ...], role: SupportsIndex) -> tuple[Array, ...]:
        return tuple(
            variates(kind, len(draws.index), 1, 0, t, role, component)
            for component, kind in enumerate(kinds)
        )

    x, y, z = (tuple(values[:, t].T) for values in (draws.x, draws.y, draws.z))
    proposals: dict[str, tuple[Any, ...]] = {}
    if model.guided:
        measured_next = tuple(draws.y[:, t + 1].T)
        u = noise(model.proposal_variates, TRUTH_PROCESS)
        w = noise(model.process_noise, TRUTH_PROCESS)
        proposals["proposal"] = (x, measured_next, t, u, model.p)
        proposals["proposal_log_density"] = (w, x, measured_next, t, model.p)
    return proposals | {
        "initial": (noise(model.initial_noise, TRUTH_INITIAL), model.p),
        "transition": (x, t, noise(model.process_noise, TRUTH_PROCESS), model.p),
        "measurement": (x, t, noise(model.measurement_noise, TRUTH_MEASUREMENT), model.p),
        "log_likelihood": (y, x, t, model.p),
        "quantity_of_interest": (x, t, model.p),
        "error": (z, tuple(np.roll(component, 1) for component in z), t, model.p),
    }


def instants_of(draws: Draws) -> list[int]:
    """A few instants before the last one."""
    last = draws.x.shape[1] - 2
    return sorted({0, last // 3, last})


def _calls_of(model: StateSpaceModel, draws: Draws) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Each formula's name and arguments, at a few instants."""
    for t in instants_of(draws):
        yield from _calls(model, draws, t).items()


def values_of(model: StateSpaceModel, name: str, arguments: tuple[Any, ...], size: int) -> Array:
    """The values of a formula, (components, size)."""
    with np.errstate(all="ignore"):
        value = getattr(model, name)(*arguments)
    components = value if isinstance(value, tuple) else (value,)
    return np.stack([np.broadcast_to(np.asarray(part, float), (size,)) for part in components])


def pure(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: each formula, called twice, must give the same, and change nothing."""
    for name, arguments in _calls_of(model, draws):
        before = [np.array(part) for group in arguments[:-1] for part in np.atleast_1d(group)]
        first = values_of(model, name, arguments, len(draws.index))
        again = values_of(model, name, arguments, len(draws.index))
        after = [np.array(part) for group in arguments[:-1] for part in np.atleast_1d(group)]
        if not np.array_equal(first, again, equal_nan=True):
            reason = "; take randomness from the noise it is given"
            if not all(map(np.array_equal, before, after)):
                reason = ", because it changes its arguments: a = a + b in the place of a += b"
            return "wrong", (
                f"{name} must be a pure function, got other values when called twice with the "
                f"same arguments{reason}{place_of_function(getattr(model, name))}"
            )
        if not all(map(np.array_equal, before, after)):
            return "wrong", (
                f"{name} must not change its arguments, got one that does: a = a + b in the place "
                f"of a += b{place_of_function(getattr(model, name))}"
            )
    return "ok", "a formula called twice gives the same, and leaves its arguments as they are"


def elementwise(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: each formula must do to an array what it does to its entries."""
    some = np.linspace(0, len(draws.index) - 1, 10).astype(int)
    for name, arguments in _calls_of(model, draws):
        together = values_of(model, name, arguments, len(draws.index))[:, some]
        separately = [
            values_of(model, name, tuple(_entry(part, i) for part in arguments), 1)[:, 0]
            for i in some
        ]
        if not np.allclose(together, np.array(separately).T, rtol=1e-9, atol=1e-12, equal_nan=True):
            return "wrong", (
                f"{name} must treat each particle alone, got other values for an array of "
                "particles than for its entries one by one (a mean, sum or norm over an array? "
                "write a + b in the place of np.sum, np.hypot(a, b) of np.linalg.norm)"
                f"{place_of_function(getattr(model, name))}"
            )
    return "ok", "an array of particles gives what its entries give one by one"


def _entry(argument: Any, i: int) -> Any:
    """One particle's part of an argument; t and p belong to all particles."""
    if type(argument) is tuple:
        return tuple(component[i] for component in argument)  # of NumPy: x / 0 is infinite
    return argument


def compiled_as_in_numpy(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: x, y and z of two instants, simulated both ways, must agree.

    Later instants of a chaotic model differ by the last digit.
    """
    del draws  # they have too many instants
    few = range(100)
    compiled, plain = (
        ENGINES[engine].simulate(model, 1, few, 0) for engine in ("compiled", "numpy")
    )
    for name in "xyz":
        values, expected = getattr(compiled, name), getattr(plain, name)
        if not np.allclose(values, expected, rtol=1e-7, atol=1e-9):
            worst = float(np.abs(values - expected).max())
            return "wrong", (
                f"{name} must be the same compiled and in NumPy, got a difference of {worst:.3g}: "
                "does a formula use what Numba treats otherwise?"
            )
    return "ok", "x, y and z of the first two instants agree"


# --- the log-likelihood against the measurement ---------------------------------------------------


def likelihood(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: the log-likelihood must fit what `measurement` gives.

    For y drawn at a state a, and any other state b at which y is possible, the mean of p(y | b) /
    p(y | a) is 1: the integral of p(y | b). A factor of the likelihood that depends on y alone
    cancels. b lies so near to a that the ratio has a small variance.

    If the likelihood jumps, as that of a sign does, there is no such b. Then the ratio counts only
    for y that are less likely at b. Its mean over y drawn at a is the share of such y among those
    drawn at b.
    """
    rng, compared, apart = np.random.default_rng(0), 0, 0
    for t in instants_of(draws):
        for pair in range(_PAIRS):
            i, other = rng.choice(len(draws.index), size=2, replace=False)
            a = draws.x[i, t]
            y = measured(model, a, t, pair)
            log_likelihood = partial(_log_likelihood, model, y, t)
            impossible = 1 - np.mean(np.isfinite(log_likelihood(a)))
            if impossible:
                return "wrong", (
                    f"log_likelihood must be finite for y measured at x, got NaN or infinity for "
                    f"{impossible:.2%} of y measured at x = {formatted_state(a)}, t = {t}"
                )
            unlike = _most_unlike(model, draws, t, i, y)  # beyond a jump, even if few draws are
            b, jumps = _near(log_likelihood, a, draws.x[other, t], unlike)
            if b is None:
                continue
            difference, share = log_likelihood(b) - log_likelihood(a), 1.0
            ratio = np.exp(difference)
            error, is_possible = float(np.std(ratio, ddof=1)), ratio.all()
            if jumps:  # the few large ratios would decide, and few draws have them
                at_b = partial(_log_likelihood, model, measured(model, b, t, _PAIRS + pair), t)
                share = float(np.mean(at_b(b) < at_b(a)))
                ratio *= difference < 0
                error = math.sqrt(np.mean(ratio) + share)
            if not is_possible or share < _RARE:  # what is possible at a is not at b
                apart += 1
                continue
            compared += 1
            mean, error = float(np.mean(ratio)), error / math.sqrt(MEASUREMENTS)
            if not abs(mean - share) < _LARGEST_Z * error:
                states = f"x = {formatted_state(a)} and x = {formatted_state(b)} at t = {t}"
                ratio_text = with_error(mean / share, error / share)
                return "wrong", (
                    "log_likelihood must be the log-density of measurement, up to a term that does "
                    f"not depend on x; but over y measured at the first of {states}, their "
                    f"likelihoods' ratio has the mean {ratio_text}, not 1 "
                    "(a wrong deviation, or a term left out that depends on x?)"
                )
    if apart and not compared:
        return "note", "it cannot be checked: which y are possible depends on x"
    if not compared:
        return "note", f"it does not depend on x: it is the same in all {len(draws.index)} draws"
    return "ok", f"it agrees with measurement at {compared} pairs of states"


def measured(model: StateSpaceModel, x: Array, t: int, draw: int) -> tuple[Array, ...]:
    """Simulated measurements at one state; another draw has other noise."""
    v = tuple(
        variates(kind, MEASUREMENTS, 2, draw, t, TRUTH_MEASUREMENT, component)
        for component, kind in enumerate(model.measurement_noise)
    )
    y = values_of(model, "measurement", (tuple(x.tolist()), t, v, model.p), MEASUREMENTS)
    return tuple(y)


def _log_likelihood(model: StateSpaceModel, y: tuple[Array, ...], t: int, x: Array) -> Array:
    values = values_of(model, "log_likelihood", (y, tuple(x.tolist()), t, model.p), MEASUREMENTS)
    log_likelihood: Array = values[0]
    return log_likelihood


def _most_unlike(
    model: StateSpaceModel, draws: Draws, t: int, i: int, y: tuple[Array, ...]
) -> Array:
    """The state of a draw whose log-likelihood of the first y differs most from draw i.

    A state at which this y is impossible is the last choice.
    """
    states, first = draws.x[:, t], tuple(component[0] for component in y)
    arguments = first, tuple(states.T), t, model.p
    (values,) = values_of(model, "log_likelihood", arguments, len(states))
    unlike = np.nan_to_num(np.abs(values - values[i]), posinf=np.finfo(float).tiny)
    return np.array(states[unlike.argmax()])


def _near(
    log_likelihood: Callable[[Array], Array], a: Array, *others: Array
) -> tuple[Array | None, bool]:
    """A state towards another whose log-likelihoods differ by about 1/2; None if none differ.

    If the log-likelihood jumps, the nearest state that was found beyond the jump, and True.
    """
    at_a, beyond = log_likelihood(a), None
    for other, step in product(others, 2.0 ** (-np.arange(60) / 2)):
        b: Array = a + step * (other - a)
        difference = log_likelihood(b) - at_a
        impossible = np.isneginf(difference)
        spread = np.inf if np.mean(impossible) > 0.5 else np.std(difference[~impossible])
        if spread >= 0.6:
            beyond = b
        elif spread > 1e-6 or impossible.any():
            return b, False
        elif beyond is not None:
            break
    return beyond, True


def formatted_state(x: Array) -> str:
    """A state as messages show it."""
    return f"({', '.join(f'{value:.4g}' for value in x)})"


# --- formulas that make arrays for each particle --------------------------------------------------

_OUT = "write each component out, for instance A[0, 0] * x[0] + A[0, 1] * x[1]"
_SLOW = {
    **dict.fromkeys(
        ("array", "asarray", "zeros", "ones", "full", "empty", "stack", "hstack", "concatenate",
         "dot", "matmul", "inner", "outer", "cross", "sum", "prod", "mean", "norm"), _OUT,
    ),
    **dict.fromkeys(("solve", "inv", "det", "cholesky"), "compute it above, once"),
    "select": "give np.select tuples in the place of lists, or write pfdist.where",
    "interp": "compute its tables above, once",
}  # fmt: skip


def speed(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: which formulas make or index arrays for each particle, and on which lines."""
    indexed = [
        f"{array} in {name} ({place})"
        for name, function in model.formulas.items()
        for array, place in _indexed(function)
    ]
    if not Evaluator(model, draws.instants[-1], estimations=(Estimation(1),)).makes_arrays:
        if not indexed:
            return "ok", "no formula makes or indexes an array for a particle"
        return "note", (
            f"{', '.join(dict.fromkeys(indexed))}: each index is checked for each particle, which "
            "may take 8 times the time; a parameter p.NAME[t] needs no check"
        )
    places = [
        f"{what} in {name} ({place}): {cure}"
        for name, function in model.formulas.items()
        for what, place, cure in _slow_places(function)
    ]
    return "note", (
        "formulas that make arrays for each particle take 30 to 500 ns where others take 1: "
        + ("; ".join(dict.fromkeys(places)) or f"which is not known; {_OUT}")
    )


def _slow_places(function: Callable[..., Any]) -> Iterator[tuple[str, str, str]]:
    """Yield calls that make an array, in a function and those it calls, with place and remedy."""
    for place, _, node in _nodes(function):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield "@", place, _OUT
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if name in _SLOW:
                yield name, place, _SLOW[name]


def _indexed(function: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """Yield the global arrays that a function and those it calls index, and the places."""
    for place, scope, node in _nodes(function):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            name = node.value.id
            if isinstance(scope.get(name), np.ndarray):
                yield name, place


def _nodes(function: Any) -> Iterator[tuple[str, dict[str, Any], ast.AST]]:
    """The syntax of a function and of the module's functions that it calls, node by node.

    Each node has its place and the global variables of its function.
    """
    waiting, seen = [function], set[int]()
    while waiting:
        called = waiting.pop()
        if not isinstance(called, types.FunctionType) or id(called) in seen:
            continue
        seen.add(id(called))
        scope, code, node = called.__globals__, called.__code__, node_of(called)
        for each in ast.walk(node) if node else ():
            yield f"{code.co_filename}:{getattr(each, 'lineno', 0)}", scope, each
        waiting += [scope.get(name) for name in names_in(code)]
