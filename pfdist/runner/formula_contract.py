"""What every formula must be for a run to start: what `check-model` calls wrong, no run accepts."""

from collections.abc import Callable, Iterator

import numpy as np

from pfdist.draws import Draws
from pfdist.errors import ModelError
from pfdist.kernels.formulas import formulas_of
from pfdist.models import StateSpaceModel
from pfdist.monte_carlo import ENGINES
from pfdist.runner.check_formulas import compiled_as_in_numpy, elementwise, on_arrays, pure

Look = Callable[[StateSpaceModel, Draws], tuple[str, str]]
_LOOKS: dict[str, Look] = {"on arrays": on_arrays, "pure": pure, "elementwise": elementwise}
_DRAWS = 10  # simulated: a formula must do the same to a particle whatever the others are


def few_draws(model: StateSpaceModel, horizon: int) -> Draws:
    """Simulate what `check_formulas` looks at.

    Raises
    ------
    ModelError
        A formula failed, or the simulation does not stay finite.
    """
    return ENGINES["numpy"].simulate(model, horizon, range(_DRAWS), 0)


def look_at_formulas(model: StateSpaceModel, draws: Draws) -> Iterator[tuple[str, str, str]]:
    """Look at a model's formulas in NumPy, on a few draws: give each look's name, state and text.

    It ends with the first that is wrong: the others would say the same again.
    """
    for name, look in _LOOKS.items():
        state, text = looked(look, model, draws)
        yield name, state, text
        if state == "wrong":
            return


def looked(look: Look, model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """Give the state and the text of one look; what a formula raises is wrong."""
    try:
        with formulas_of(model.name, model.formulas), np.errstate(all="ignore"):
            return look(model, draws)
    except ModelError as error:
        return "wrong", str(error)


def check_formulas(model: StateSpaceModel, draws: Draws) -> None:
    """Refuse a model whose formulas are wrong, before any is compiled or any worker has a task.

    Raises
    ------
    ModelError
        A formula fails at some instant, is not pure, or mixes particles.
    """
    for _, state, text in look_at_formulas(model, draws):
        _refuse(model, state, text)


def check_compiled(model: StateSpaceModel, draws: Draws) -> None:
    """Refuse a model, compiled, whose formulas give other values than in NumPy.

    Raises
    ------
    ModelError
    """
    _refuse(model, *looked(compiled_as_in_numpy, model, draws))


def _refuse(model: StateSpaceModel, state: str, text: str) -> None:
    prefix = f"model {model.name}: "
    if state == "wrong":
        raise ModelError(text if text.startswith(prefix) else prefix + text)
