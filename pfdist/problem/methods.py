"""The search methods that a job file can name; each is declared where it is defined.

The registry imports `pfdist.search`, which is on a higher floor, and installed entry points.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

from pydantic import Field, create_model
from pydantic.fields import FieldInfo

from pfdist.common.measurement_times import Lag, Times
from pfdist.common.registry import Registry
from pfdist.problem.feasible import Feasible
from pfdist.problem.search_section import (
    CommonNoiseSettings,
    EvaluationSettings,
    Name,
    SearchSection,
)

C = TypeVar("C", bound=type[Any])
Curve = Literal["generations", "trials", "best so far"]


@dataclass(frozen=True)
class Method:
    """A search method."""

    name: str  # in job files
    optimiser: Callable[..., Any]  # gives a `pfdist.search.Optimiser`
    section: type[SearchSection]  # the section [[search]], with the settings of the method
    curve: Curve  # in the figure ``searches``, which shows expected MSE by evaluation
    online: bool  # whether the method can plan the remaining measurements
    additive: bool  # whether the method adds errors of instants, so that an error must be a mean
    listed: bool  # whether the manual offers the method

    @property
    def description(self) -> str:
        """The method in one line."""
        return (self.optimiser.__doc__ or "").partition("\n")[0]

    @property
    def takes_lag(self) -> bool:
        """Whether the method adds errors of estimates that use later measurements, too."""
        return "lag" in self.optimiser.__annotations__

    def make(
        self,
        feasible: Feasible,
        draws: int,
        settings: dict[str, Any],
        start: Times | None = None,
        lag: Lag = 0,
    ) -> Any:
        """An optimiser with these settings: a `pfdist.search.Optimiser`.

        `draws` is the number of simulated systems on which a set is evaluated. Methods that search
        around a set begin at `start`, a good feasible set. The estimate of z(t) uses measurements
        until t + lag, in instants. Raises `JobError` if the method cannot search this problem.
        """
        if "draws" in self.optimiser.__annotations__:
            settings = {"draws": draws, **settings}
        if "start" in self.optimiser.__annotations__:
            settings = {"start": start, **settings}
        if self.takes_lag:
            settings = {"lag": lag, **settings}
        return self.optimiser(feasible, **settings)


METHODS: Registry[Method] = Registry("pfdist.search", "pfdist.searches")


def method(
    name: str,
    evaluation: EvaluationSettings = CommonNoiseSettings(),  # noqa: B008  it is frozen
    polish: bool = False,
    curve: Curve = "generations",
    online: bool = True,
    additive: bool = False,
    listed: bool = True,
) -> Callable[[C], C]:
    """A decorator that declares an optimiser as a search method.

    The optimiser is a frozen dataclass. Fields that are annotated with a type of
    `pfdist.problem.search_section`, such as ``Count``, are the settings of the method, with their
    defaults. The first field, ``feasible``, receives the feasible sets. An optional field ``draws``
    receives the number of draws of an evaluation. An optional field ``start`` receives a set to
    begin with, or None. The first line of the docstring is the description of the method, and the
    section Parameters describes the settings.

    Parameters
    ----------
    name : str
        The name in job files.
    evaluation : EvaluationSettings
        Defaults of ``[search.evaluation]``.
    polish : bool
        Default of ``polish``: whether an exchange search then improves the best set.
    curve : str
        The curve of the search in the figure ``searches``, which shows expected MSE by evaluation.
    online : bool
        Whether the method can plan the remaining measurements. A method that needs the error of
        each instant cannot, because it takes a whole number of blocks of 24 draws.
    additive : bool
        Whether the method adds errors of instants or prefixes, so that errors must be means.
    listed : bool
        Whether the manual offers the method; otherwise it is the base of a better one.
    """

    def declare(optimiser: C) -> C:
        hints = get_type_hints(optimiser, include_extras=True)
        definitions: dict[str, Any] = {
            "name": (Name, name),
            "evaluation": (type(evaluation), evaluation),
            "polish": (bool, polish),
            "method": (Literal[name], name),
        } | {
            field.name: (hints[field.name], field.default)
            for field in fields(optimiser)
            if any(
                isinstance(bound, FieldInfo)
                for bound in getattr(hints[field.name], "__metadata__", ())
            )
        }
        section = create_model(
            f"{optimiser.__name__}Section",
            __base__=SearchSection,
            __doc__=optimiser.__doc__,
            __module__=optimiser.__module__,
            **definitions,
        )
        # Workers get the sections of online draws pickled, so their module must have the class.
        setattr(sys.modules[optimiser.__module__], section.__name__, section)
        METHODS.declare(name, Method(name, optimiser, section, curve, online, additive, listed))
        return optimiser

    return declare


def any_section(*, online: bool = False) -> Any:
    """The type of the section [[search]]: the union of all methods' sections.

    With `online`, only methods that can plan the remaining measurements are included.
    """
    methods = [method for method in METHODS.values() if method.online or not online]
    sections = reduce(or_, (method.section for method in methods))
    return Annotated[sections, Field(discriminator="method")]
