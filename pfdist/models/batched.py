"""Models whose functions compute on arrays of particles: NumPy, JAX, a solver, a black box.

pfdist does not trace these functions. So the model declares its identity, and a run needs its code.
"""

import dataclasses
import hashlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from pfdist.common.section import Arguments, Listed, Whole
from pfdist.errors import ModelError, shown
from pfdist.models.base import StateSpaceModel, squared_error
from pfdist.models.checks import ARGUMENTS, MEASURING, ONE_NUMBER, formula_of_each_sensor
from pfdist.models.mistakes import code_of
from pfdist.models.programs import Declared, Programs
from pfdist.models.symbols import Symbol

MOST_TOGETHER = 10_000_000  # particles in an array


class _Declaration(Arguments):
    """The parts of a declared identity, and what they may be."""

    error: ClassVar = ModelError

    version: Annotated[str, Field(min_length=1)]
    files: Listed[str]
    libraries: Listed[str]
    coupled: bool
    together: Annotated[Whole, Field(ge=1, le=MOST_TOGETHER)]


@dataclass(frozen=True, repr=False)
class BatchedModel(StateSpaceModel):
    """A model whose functions take and give arrays of particles.

    The functions are those of `StateSpaceModel`. x, w, v, y and z are arrays (components, S) of
    float64 for S particles of several draws, t is one integer, and p has numbers. They give arrays
    (components, S) of float64 or tuples of rows; `log_likelihood` gives (S,). They may call any
    library, and must change nothing, their arguments included.

    pfdist cannot inspect what they compute. So the model declares its identity, runs need its code,
    and identical bytes are guaranteed only for one machine and one set of versions.

    Parameters
    ----------
    version : str
        A text that changes whenever the functions compute something else.
    files : tuple of str
        Files on which the functions depend, relative to the file of `transition`. The identity
        contains hashes of their contents.
    libraries : tuple of str
        Names of installed packages, whose versions are in the identity.
    coupled : bool
        Whether the values of a particle depend on the other particles of an array, as with a solver
        that chooses one step for all. An array then has the particles of one draw.
    together : int
        Approximate number of particles in an array, which has whole draws. Arrays always have the
        same size, because rounding in libraries may depend on it. A slow simulator is faster with
        few particles, such as those of one draw; an accelerator is faster with many.

    Raises
    ------
    ModelError
        A file or a package is missing, or as for `StateSpaceModel`.

    Notes
    -----
    All other parameters are those of `StateSpaceModel`.
    """

    version: str = field(kw_only=True)
    files: tuple[str, ...] = field(default=(), kw_only=True)
    libraries: tuple[str, ...] = field(default=(), kw_only=True)
    coupled: bool = field(default=False, kw_only=True)
    together: int = field(default=8192, kw_only=True)

    def __post_init__(self) -> None:
        try:
            declared = _Declaration(
                **{key: getattr(self, key) for key in _Declaration.model_fields}
            )
        except ModelError as error:
            raise ModelError(f"model {self.name}: {error}") from error
        for key, value in declared:
            object.__setattr__(self, key, value)
        identity = self._identity()
        for name in ARGUMENTS:
            object.__setattr__(self, name, _declared(name, self, getattr(self, name), identity))
        sensors = {
            sensor: dataclasses.replace(
                each,
                **{key: _declared(key, self, getattr(each, key), identity) for key in MEASURING},
            )
            for sensor, each in self.sensors.items()
        }
        object.__setattr__(self, "sensors", sensors)
        super().__post_init__()

    def as_formulas(self) -> StateSpaceModel:
        """The model whose functions are called with arrays (components,), to be traced.

        The traced model is far faster. Functions can be traced if they use NumPy's functions and
        operators, and no second axis. `pfdist check-model` checks this.

        Returns
        -------
        StateSpaceModel
        """
        own = {each.name: getattr(self, each.name) for each in dataclasses.fields(StateSpaceModel)}
        sensors = {
            sensor: dataclasses.replace(
                each, **{key: _as_formula(getattr(each, key)) for key in MEASURING}
            )
            for sensor, each in self.sensors.items()
        }
        formulas = {name: _as_formula(own[name]) for name in ARGUMENTS}
        return StateSpaceModel(**(own | formulas | {"sensors": sensors}))

    def _identity(self) -> Mapping[str, Any]:
        """The identity that the model declares, as plain data."""
        function: Any = self.transition
        if isinstance(function, Declared):
            known = function.identity
            named = {key: tuple(known[key]) for key in ("files", "libraries")}
            if all(getattr(self, key) == value for key, value in {**known, **named}.items()):
                return known  # the files may be on another machine
            function = function.function
        code = code_of(function)
        folder = Path(code.co_filename).parent if code else Path()
        return {
            "version": self.version,
            "files": {name: self._hash_of(folder / name) for name in self.files},
            "libraries": {name: self._version_of(name) for name in self.libraries},
            "coupled": self.coupled,
            "together": self.together,
        }

    def _hash_of(self, file: Path) -> str:
        try:
            return hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest()
        except OSError as error:
            raise ModelError(
                f"model {self.name}: files must be readable, got {file} ({error.strerror})"
            ) from error

    def _version_of(self, library: str) -> str:
        try:
            return version(library)
        except (PackageNotFoundError, ValueError) as error:  # ValueError: an empty name
            raise ModelError(
                f"model {self.name}: libraries must be installed, got {shown(library)}"
            ) from error


def _declared(name: str, model: BatchedModel, function: Any, identity: Mapping[str, Any]) -> Any:
    """A function of a batched model; defaults and what is declared so remain as they are."""
    if function in (None, squared_error, formula_of_each_sensor):
        return function
    if isinstance(function, Declared) and function.identity != identity:
        function = function.function
    if isinstance(function, Declared | Programs):
        return function
    return Declared(name, model.name, identity, function)


def _as_formula(formula: Any) -> Any:
    """A function of arrays as a formula of tuples; defaults remain as they are."""
    if not isinstance(formula, Declared):
        return formula
    function: Any = formula.function

    def call(*arguments: Any) -> Any:
        value = function(*map(_vector, arguments))
        return value[0] if np.ndim(value) and formula.name in ONE_NUMBER else value

    call.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
    call.__wrapped__ = function  # type: ignore[attr-defined]
    return call


def _vector(argument: Any) -> Any:
    if type(argument) is not tuple:
        return argument
    vector = np.empty(len(argument), object)
    vector[:] = argument
    return vector if vector.size == 0 or isinstance(vector[0], Symbol) else np.array(argument)
