"""The simulation of draws by the traced formulas of a model (paper, equations 1 to 4)."""

import numpy as np

from pfdist.filters import plain
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws, begun, check_finite
from pfdist.filters.formulas import simulation_blocks
from pfdist.kernels import callbacks, simulation
from pfdist.kernels.variates import codes_of, fill_of_draws
from pfdist.kernels.vectors import LANES
from pfdist.models import StateSpaceModel


def simulate(
    model: StateSpaceModel, horizon: int, index: range, stream: int, prior: Cloud | None = None
) -> Draws:
    """Simulated consecutive draws of a stream, up to t = horizon.

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
        A formula cannot be traced, or gave a value that is not finite.
    PriorError
        The prior does not fit the model or the horizon.
    """
    draws = begun(model, horizon, index, stream, prior)
    compiled = simulation_blocks(model, draws.instants)
    if compiled.together == 1:  # an array must have one draw alone
        for k in range(len(index)):
            alone = plain.simulate(model, horizon, index[k : k + 1], stream, prior)
            draws.x[k], draws.y[k], draws.z[k] = alone.x[0], alone.y[0], alone.z[0]
        return draws
    kinds = codes_of(model.initial_noise, model.process_noise, model.noise_of_measurements)
    request = simulation.SimulationRequest(
        len(index),
        len(draws.instants),
        *model.components,
        len(model.ways),
        np.uint64(stream),
        index.start,
        draws.start,
        prior is not None,
        np.array([*(way.y.start for way in model.ways), model.components[1]]),
        np.array([way.v.start for way in model.ways]),
        kinds.shape[1],
        kinds,
    )
    work = simulation.SimulationCall(
        compiled.blocks,
        request,
        draws.x,
        draws.y,
        draws.z,
        np.zeros(2 * model.components[0] * simulation.TOGETHER),
        np.zeros(max(model.components) * simulation.TOGETHER),
        np.zeros((kinds.shape[1] + 1) * simulation.TOGETHER, np.float32),
        np.zeros(4 * LANES, np.uint32),
        fill_of_draws.address,
    )
    simulation.simulate_draws(work)
    callbacks.raise_callback_error()
    check_finite(model, draws, stream)
    return draws
