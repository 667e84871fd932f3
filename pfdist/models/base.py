"""What a model is: a handful of pure formulas (paper, equations 1 to 4)."""

import contextlib
import dataclasses
import inspect
import keyword
import math
from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.jitted import guard_what_it_calls
from pfdist.mistakes.endings import is_interrupt, kept_alive, told
from pfdist.mistakes.places import place_of, place_of_function
from pfdist.mistakes.remedies import remedy

NOISE_KINDS = ("normal", "uniform")
_ARGUMENTS = {
    "initial": ("w", "p"),
    "transition": ("x", "t", "w", "p"),
    "measurement": ("x", "t", "v", "p"),
    "log_likelihood": ("y", "x", "t", "p"),
    "quantity_of_interest": ("x", "t", "p"),
    "error": ("z", "estimate", "t", "p"),
}

_PROBED = 2  # particles
_ONE_NUMBER = {
    "log_likelihood": "one number a particle",
    "error": "one number for z and its estimate",
}


def squared_error(z: Any, estimate: Any, t: Any, p: Any) -> Any:
    """Squared Euclidean norm of z less its estimate: the error of the paper's equation 5."""
    total = 0.0
    for value, estimated in zip(z, estimate):  # noqa: B905  Numba knows no strict
        total += (value - estimated) ** 2
    return total


@dataclass(frozen=True)
class StateSpaceModel:
    """A system that can be simulated and measured.

    x, w, v, y and z are tuples of components, also when there is only one. A component is one
    number in the compiled filter and an array in the plain one, so the formulas use operators,
    NumPy's elementwise functions, `pfdist.where` and `pfdist.clip`. t is an integer. p holds the
    parameters, read as ``p.sigma``.

    Parameters
    ----------
    name : str
    initial : callable
        ``(w, p) -> x(0)``, with w one variate for each entry of `initial_noise`.
    transition : callable
        ``(x, t, w, p) -> x(t+1)``, the paper's f_t; t is the time of x.
    measurement : callable
        ``(x, t, v, p) -> y(t)``, the paper's g_t.
    log_likelihood : callable
        ``(y, x, t, p) -> log p(y | x)``, one number a particle, up to a constant that does not
        depend on x.
    quantity_of_interest : callable
        ``(x, t, p) -> z(t)``, the paper's h_t.
    initial_noise, process_noise, measurement_noise : tuple of {"normal", "uniform"}
        What w and v are made of: standard normal or uniform on (0, 1). Any other distribution is
        a transform of these, written in the formula.
    parameters : mapping of str to float
        The values of p; a job may override them.
    parameter_ranges : mapping of str to (float, float)
        Lowest and highest value allowed; without an entry any finite value is.
    error : callable
        ``(z, estimate, t, p) -> number``, what it costs to believe `estimate` where z is true;
        an MSE is its mean over t. The squared Euclidean norm, unless it is given.
    linear_gaussian : bool
        Whether every formula is linear in x and noise, and every noise normal: then
        ``filter.engine = "kalman"`` computes exactly. What is declared is checked.
    data_files : tuple of str
        Files that the model's file reads while it is imported, relative to its folder and in it:
        ``("rates.csv",)`` for ``np.loadtxt(Path(__file__).with_name("rates.csv"))``. They travel to
        the workers, and a run is known by their content.

    Raises
    ------
    ModelError
        A formula does not take its arguments or does not give a tuple of components, a noise is
        of no known kind, a parameter lies outside its range, or a data file outside the folder.
    """

    name: str
    initial: Callable[..., Any]
    transition: Callable[..., Any]
    measurement: Callable[..., Any]
    log_likelihood: Callable[..., Any]
    quantity_of_interest: Callable[..., Any]
    initial_noise: tuple[str, ...]
    process_noise: tuple[str, ...]
    measurement_noise: tuple[str, ...]
    parameters: Mapping[str, float] = field(default_factory=dict)
    parameter_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    error: Callable[..., Any] = squared_error
    linear_gaussian: bool = False
    data_files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, arguments in _ARGUMENTS.items():
            self._check_signature(name, arguments)
        for name in ("initial_noise", "process_noise", "measurement_noise"):
            self._check_noise(name)
        self._check_data_files()
        for name in self.parameter_ranges:
            if name not in self.parameters:
                raise ModelError(
                    f"model {self.name}: parameter_ranges must name parameters, got {name!r}; "
                    f"parameters: {', '.join(self.parameters) or 'none'}"
                )
        for name, value in self.parameters.items():
            self._check_parameter(name, value)
        for function in self.formulas.values():
            guard_what_it_calls(function)
        self.components  # noqa: B018  evaluated here so that a wrong formula is found here

    @cached_property
    def p(self) -> Any:
        """The parameters as the formulas read them, a named tuple of floats."""
        kind = namedtuple("Parameters", self.parameters)  # type: ignore[misc]
        return kind(**{name: float(value) for name, value in self.parameters.items()})

    @cached_property
    def components(self) -> tuple[int, int, int]:
        """Numbers of components of x, y and z, found by calling the formulas once on arrays."""
        with np.errstate(all="ignore"):
            x = self._call("initial", self._probe(self.initial_noise), self.p)
            following = self._call("transition", x, 0, self._probe(self.process_noise), self.p)
            if len(following) != len(x):
                raise ModelError(
                    f"model {self.name}: transition must give as many components as initial, "
                    f"{len(x)}, got {len(following)}"
                )
            y = self._call("measurement", x, 0, self._probe(self.measurement_noise), self.p)
            z = self._call("quantity_of_interest", x, 0, self.p)
            self._call("log_likelihood", y, x, 0, self.p)
            self._call("error", z, z, 0, self.p)
        return len(x), len(y), len(z)

    @cached_property
    def formulas(self) -> dict[str, Callable[..., Any]]:
        """The formulas by their names."""
        return {name: getattr(self, name) for name in _ARGUMENTS}

    def with_parameters(self, overrides: Mapping[str, float]) -> "StateSpaceModel":
        """Give the model with some parameters changed.

        Raises
        ------
        ModelError
            A parameter is unknown, or its value lies outside its range.
        """
        for name in overrides:
            if name not in self.parameters:
                allowed = ", ".join(sorted(self.parameters)) or "none"
                raise ModelError(
                    f"model.parameters: unknown parameter {name!r} of model {self.name}, "
                    f"allowed: {allowed}"
                )
        return dataclasses.replace(self, parameters={**self.parameters, **overrides})

    def _check_signature(self, name: str, arguments: tuple[str, ...]) -> None:
        function = getattr(self, name)
        expected = f"model {self.name}: {name} must be a function of ({', '.join(arguments)})"
        if not inspect.isfunction(function):
            raise ModelError(f"{expected}, got {function!r}")
        signature = inspect.signature(function)
        try:
            signature.bind(*arguments)
        except TypeError as error:
            place = place_of_function(function)
            raise ModelError(f"{expected}, got {signature}{place}") from error

    def _check_noise(self, name: str) -> None:
        kinds = getattr(self, name)
        if not isinstance(kinds, tuple) or any(kind not in NOISE_KINDS for kind in kinds):
            allowed = " or ".join(map(repr, NOISE_KINDS))
            raise ModelError(
                f"model {self.name}: {name} must be a tuple of {allowed}, one for each "
                f"component, got {kinds!r}"
            )

    def _check_data_files(self) -> None:
        files = self.data_files
        if not isinstance(files, tuple) or not all(map(is_in_folder, files)):
            raise ModelError(
                f"model {self.name}: data_files must be a tuple of names relative to the folder of "
                f"the model's file, and in it, got {files!r}"
            )

    def _check_parameter(self, name: str, value: float) -> None:
        if not name.isidentifier() or name.startswith("_") or keyword.iskeyword(name):
            raise ModelError(
                f"model {self.name}: a parameter's name must be that of a variable, got {name!r}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ModelError(f"model.parameters.{name} must be a number, got {value!r}")
        low, high = self.parameter_ranges.get(name, (-math.inf, math.inf))
        if not (math.isfinite(value) and low <= value <= high):
            raise ModelError(
                f"model.parameters.{name} must be a finite number in {low:g}..{high:g}, "
                f"got {value!r} (model {self.name})"
            )

    def _probe(self, kinds: tuple[str, ...]) -> tuple[Any, ...]:
        return tuple(np.full(_PROBED, 0.5) for _ in kinds)

    def _call(self, name: str, *arguments: Any) -> Any:
        try:
            with kept_alive():
                value = getattr(self, name)(*arguments)
        except BaseException as error:  # a formula may raise whatever it likes
            if is_interrupt(error):
                raise
            raise ModelError(
                f"model {self.name}: {name} failed on arrays: {told(error)}"
                f"{self._advice(name, arguments, error)}{place_of(error)}"
            ) from error
        place = place_of_function(getattr(self, name))
        if name in _ONE_NUMBER:
            if not _is_number(value):
                raise ModelError(
                    f"model {self.name}: {name} must give {_ONE_NUMBER[name]}, "
                    f"got {_told(value)}{place}"
                )
        elif not (isinstance(value, tuple) and value and all(map(_is_number, value))):
            raise ModelError(
                f"model {self.name}: {name} must give a tuple of components, also of one: (a,), "
                f"got {_told(value)}{place}"
            )
        for number in value if isinstance(value, tuple) else (value,):
            if np.shape(number) not in ((), (_PROBED,)):
                raise ModelError(
                    f"model {self.name}: {name} must give a number or an array of {_PROBED} for "
                    f"{_PROBED} particles, got an array of shape {np.shape(number)}: is a tuple "
                    f"taken for a component, w for w[0]?{place}"
                )
        return value

    def _advice(self, name: str, arguments: tuple[Any, ...], error: BaseException) -> str:
        """What to write instead, with the sizes that only the model knows."""
        if "tuple index out of range" in str(error):
            sizes = [
                f"{argument} has {len(value)}"
                for argument, value in zip(_ARGUMENTS[name], arguments, strict=True)
                if argument != "p" and isinstance(value, tuple)
            ]
            return f"; of components {', '.join(sizes)}, and the first is [0]"
        if "'Parameters' object" in str(error):
            return f"; parameters: {', '.join(self.parameters) or 'none'}"
        return remedy(error)


def is_in_folder(name: Any) -> bool:
    """Whether a file's name is relative to a folder, and leads to a file in it."""
    if not isinstance(name, str):
        return False
    path = PurePosixPath(name)
    return (
        bool(path.parts) and "\0" not in name and not path.is_absolute() and ".." not in path.parts
    )


def _is_number(value: Any) -> bool:
    """Whether it is a number or an array of them."""
    return not isinstance(value, tuple | list) and np.asarray(value).dtype.kind in "fiub"


def _told(value: Any) -> str:
    """Say what a formula gave that it must not give, and what it lacks."""
    if value is None:
        return "None: is there no `return`?"
    if isinstance(value, list):
        return "a list: write (a, b) in the place of [a, b]"
    if isinstance(value, tuple):
        wrong = next((entry for entry in value if not _is_number(entry)), None)
        if wrong is None:
            return f"{'an empty' if not value else 'a'} tuple"
        return f"a tuple with {_kind(wrong)} in it"
    return _kind(value)


def _kind(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"a {type(value).__name__}"
    with contextlib.suppress(TypeError, ValueError):
        kind = np.asarray(value).dtype.kind
        if kind == "c":
            return "complex numbers"
        if kind in "fiub":
            return "an array" if np.ndim(value) else "a number"
    return type(value).__name__
