"""The simulation of draws by one compiled function, fused from the formulas of a model."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from pfdist.filters import plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws, begun, check_finite
from pfdist.kernels.components import in_turn, naming, reader, writer
from pfdist.kernels.disk_cache import cached_on_disk
from pfdist.kernels.formulas import compiled_formulas, formula
from pfdist.kernels.melting import melted
from pfdist.kernels.noise import TRUTH_INITIAL, TRUTH_MEASUREMENT, TRUTH_PROCESS, filler
from pfdist.kernels.scratch import WithScratch
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import flat_parameters, parameter_names

_FORMULAS = ("initial", "transition", "quantity_of_interest")
_TOGETHER = 64  # draws that are simulated side by side: their noise fits into a few vectors


def simulate(
    model: StateSpaceModel, horizon: int, index: range, stream: int, prior: Cloud | None = None
) -> Draws:
    """Simulate consecutive draws of a stream, up to t = horizon.

    A draw does not depend on the other draws.

    Parameters
    ----------
    model : StateSpaceModel
    horizon : int
        T, the last instant of the draws.
    index : range
        Indices of the draws in their stream, with step 1.
    stream : int
        Key of the draws' noise, 64 bits.
    prior : Cloud, optional
        Particles of x(s). Then each draw starts at t = s from one of them, and `initial` is not
        called. By default s = 0, and `initial` gives x(0).

    Returns
    -------
    Draws
        x, y and z at the instants s..T.

    Raises
    ------
    ModelError
        A formula cannot be compiled, failed, or gave a value that is not finite.
    PriorError
        The prior does not fit the model or the horizon.
    """
    draws = begun(model, horizon, index, stream, prior)
    flat, at = flat_parameters(model.parameters, horizon + 1), np.zeros(1, np.int64)

    def again() -> str:
        """Simulate the failed draws in NumPy, where the error has a traceback; say which."""
        first = index[at[0] : at[0] + _TOGETHER]
        plain.simulate(model, horizon, first, stream, prior)
        return f"the simulation of draws {first.start} to {first.stop - 1}"

    with compiled_formulas(model.name, again):
        given = np.uint64(stream), index.start, draws.start, prior is not None, flat
        compiled_simulation(model)(*given, (draws.x, draws.y, draws.z), at)
    check_finite(model, draws, stream)
    return draws


def compiled_simulation(model: StateSpaceModel) -> WithScratch:
    """The compiled function that simulates draws of a model into given arrays."""
    sensors = [part.model for part in model.parts]
    formulas = model.initial, model.transition, model.quantity_of_interest
    noise, (states, _, quantities) = (model.initial_noise, model.process_noise), model.components
    return _compile(
        (*formulas, *(sensor.measurement for sensor in sensors)),
        (*noise, *(sensor.measurement_noise for sensor in sensors)),
        (states, tuple(sensor.components[1] for sensor in sensors), quantities),
        parameter_names(model.parameters),
    )


def _measured(
    measurement: Callable[..., Any], read_v: Callable[..., Any], write_y: Callable[..., Any]
) -> Callable[..., None]:
    """Compile the simulation of the measurement of a draw by one sensor."""

    @melted
    def measure(place, noise, given):  # type: ignore[no-untyped-def]
        (y, d, k), (v, i), (state, t, p) = place, noise, given
        write_y(y, d, k, measurement(state, t, read_v(v, i), p))

    return measure


@lru_cache(maxsize=32)
def _compile(
    functions: tuple[Callable[..., Any], ...],
    noise: tuple[tuple[str, ...], ...],
    components: tuple[int, tuple[int, ...], int],
    parameters: tuple[str, ...],
) -> WithScratch:
    """Compile the simulation; models with the same formulas and parameter names share the code.

    `functions` ends with measurement of each sensor, and `noise` with its noise. `components` are
    the numbers of components of x, of the y of each sensor, and of z.
    """
    initial, transition, quantity = map(formula, functions, _FORMULAS)
    noise_of_measurements: tuple[str, ...] = sum(noise[2:], ())
    kinds = (*noise[:2], noise_of_measurements)
    fill_w0, fill_w, fill_v = (filler(each, of_draws=True) for each in kinds)
    read_w0, read_w = (reader(len(each), "c, i") for each in kinds[:2])
    states, measurements, quantities = components
    read_x = reader(states, "d, t, c")
    write_x, write_z = (writer(count, "d, t, c") for count in (states, quantities))
    measure = in_turn(
        [
            _measured(
                formula(measurement, "measurement"),
                reader(len(noise[2 + number]), "c, i", sum(map(len, noise[2 : 2 + number]))),
                writer(measurements[number], "d, t, c", sum(measurements[:number])),
            )
            for number, measurement in enumerate(functions[3:])
        ]
    )
    rows = max(map(len, kinds))
    named = naming(parameters)

    @njit(nogil=True, error_model="numpy", _nrt=False, no_cfunc_wrapper=True)
    def simulate_draws(stream, first, start, begun, parameters, noise, drawn, at):  # type: ignore[no-untyped-def]
        p, (x, y, z) = named(parameters), drawn
        for begin in range(0, x.shape[0], _TOGETHER):
            at[0] = begin
            draw, count = first + begin, min(_TOGETHER, x.shape[0] - begin)
            if not begun:
                fill_w0(noise, count, stream, draw, np.int64(0), TRUTH_INITIAL)
                for i in range(count):
                    write_x(x, begin + i, 0, initial(read_w0(noise, i), p))
            for k in range(x.shape[1]):
                t = start + k
                fill_v(noise, count, stream, draw, t, TRUTH_MEASUREMENT)
                for i in range(count):
                    state = read_x(x, begin + i, k)
                    measure((y, begin + i, k), (noise, i), (state, t, p))
                    write_z(z, begin + i, k, quantity(state, t, p))
                if k + 1 == x.shape[1]:
                    break
                fill_w(noise, count, stream, draw, t, TRUTH_PROCESS)
                for i in range(count):
                    following = transition(read_x(x, begin + i, k), t, read_w(noise, i), p)
                    write_x(x, begin + i, k + 1, following)

    compiled = cached_on_disk(simulate_draws, functions, noise, components, parameters)

    def with_scratch(*arguments: Any) -> None:
        *given, drawn, at = arguments
        compiled(*given, np.empty((rows, _TOGETHER), np.float32), drawn, at)

    return WithScratch(compiled, with_scratch)
