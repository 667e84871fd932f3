"""Write the tables of the manual that are made from declarations: ``python docs/tables.py``.

A page marks the place of a table by two comments, ``<!-- table: NAME -->`` and ``<!-- end -->``.
The command replaces the lines between them. A test fails if a page has an old table.
"""

import argparse
import inspect
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, get_args

import pandas as pd
from pydantic.fields import FieldInfo

from pfdist import plots
from pfdist.cli.command import COMMANDS, Command
from pfdist.densities import DENSITIES
from pfdist.filters.engines import AUTO, ENGINES
from pfdist.kernels.estimators import ESTIMATORS, Estimator
from pfdist.kernels.schemes import SCHEMES
from pfdist.plots.figure import FIGURES
from pfdist.pools.kinds import POOLS
from pfdist.search.methods import DEFAULT_METHOD, METHODS, Method

FOLDER = Path(__file__).parent
_COMMON = {"name", "method", "evaluation", "polish"}  # keys that every search has
_BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
_UNBOUNDED = 2**63  # whole numbers of a job have 64 bits
_MARKED = re.compile(r"(?s)(<!-- table: (\w+) -->\n).*?(<!-- end -->)")


def methods() -> str:
    """Give the table of search methods."""
    rows = []
    for name, method in METHODS.items():
        section = method.section()
        noise = section.evaluation.noise or "as the job"
        rows.append(
            [
                f"`{name}`" + (" (default)" if name == DEFAULT_METHOD else ""),
                _sentence(method.description),
                noise,
                "yes" if section.polish else "no",
            ]
        )
    return _table(["method", "how it searches", "noise", "polish"], rows)


def settings() -> str:
    """Give the table of the settings of all search methods, with defaults and bounds."""
    rows = [
        [f"`{name}`", f"`{key}`", _value(field.default), _bounds(field), described[key]]
        for name, method in METHODS.items()
        for described in (_described(method),)
        for key, field in method.section.model_fields.items()
        if key not in _COMMON
    ]
    return _table(["method", "setting", "default", "bounds", "meaning"], rows)


def engines() -> str:
    """Give the table of engines."""
    rows = [[f"`{engine.name}`", _sentence(engine.description)] for engine in ENGINES.values()]
    choice = "The engine `compiled`, or `numpy` if Numba cannot compile the model"
    return _table(["engine", "what computes"], [[f"`{AUTO}` (default)", choice], *rows])


def estimators() -> str:
    """Give the table of estimators."""
    rows = [
        [
            f"`{estimator.name}`",
            _sentence(estimator.description),
            str(estimator.filters),
            _valid_for(estimator),
        ]
        for estimator in ESTIMATORS.values()
    ]
    return _table(["estimator", "what it computes at each instant", "filters", "valid for"], rows)


def _valid_for(estimator: Estimator) -> str:
    if estimator.for_any_filter:
        return "any filter and any error"
    if estimator.needs_truth:
        return "filters that know the truth, with the squared norm as error"
    return "the guide of a search, for any filter, with the squared norm as error"


def schemes() -> str:
    """Give the table of resampling schemes."""
    rows = [[f"`{scheme.name}`", _sentence(scheme.description)] for scheme in SCHEMES.values()]
    return _table(["scheme", "how particles are resampled"], rows)


def commands() -> str:
    """Give the table of commands, each with the arguments that must be given."""
    rows = [
        [f"`{_usage(command)}`", _sentence(command.description)] for command in COMMANDS.values()
    ]
    return _table(["command", "what it does"], rows)


def figures() -> str:
    """Give the table of a run's figures."""
    rows = [
        [f"`{name}-SET`" if figure.each_set else f"`{name}`", _sentence(figure.description)]
        for name, figure in FIGURES.items()
    ]
    return _table(["file", "what it shows"], rows)


def panels() -> str:
    """Give the table of the functions that draw one panel."""
    rows = []
    for name in plots.__all__:
        function = getattr(plots, name)
        if "ax" in inspect.signature(function).parameters:
            first = (function.__doc__ or "").partition("\n")[0]
            drawn = _sentence(first).removeprefix("Draw ")
            rows.append([f"`{name}`", drawn[0].upper() + drawn[1:]])
    return _table(["function", "what it draws"], rows)


def pools() -> str:
    """Give the table of pools."""
    rows = [
        [f"`{name}`", kind.description, "any number" if "workers" in kind.takes else "1"]
        for name, kind in POOLS.items()
    ]
    return _table(["pool", "where tasks are computed", "workers"], rows)


def densities() -> str:
    """Give the table of densities, with the times of the benchmark."""
    times = pd.read_csv(FOLDER.parent / "benchmarks" / "results" / "densities.csv", comment="#")
    measured = times.set_index("name")
    rows = []
    for name, density in DENSITIES.items():
        nanoseconds = measured.loc[name, ["ns_log_density", "ns_draw"]]
        rows.append(
            [
                f"`{name}`",
                ", ".join(density.parameters),
                density.support,
                " and ".join(density.noise),
                *(f"{value:.1f}" if value < 10 else f"{value:.0f}" for value in nanoseconds),
            ]
        )
    head = [
        "density",
        "parameters",
        "support",
        "draw from",
        "ns of the log density",
        "ns of the draw",
    ]
    return _table(head, rows)


TABLES: dict[str, Callable[[], str]] = {
    table.__name__: table
    for table in (
        methods, settings, engines, estimators, schemes, commands, figures, panels, pools,
        densities,
    )
}  # fmt: skip


def with_tables(page: str) -> str:
    """Give the text of a page with all its tables made anew."""
    return _MARKED.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", page)


def _usage(command: Command) -> str:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    words = ["pfdist", command.name]
    for argument in parser._actions:
        if argument.required:
            words += [*argument.option_strings[:1], str(argument.metavar)]
    return " ".join(words)


def _described(method: Method) -> dict[str, str]:
    """Give the meaning of each setting, from the section Parameters of the docstring."""
    text = inspect.getdoc(method.optimiser) or ""
    parameters = text.partition("Parameters\n----------\n")[2].partition("\n\n")[0]
    found = re.findall(r"(?m)^(\w+) : .*\n((?:    .*\n?)+)", parameters + "\n")
    return {name: _sentence(" ".join(lines.split())) for name, lines in found}


def _bounds(field: FieldInfo) -> str:
    """Give the bounds of a setting in words."""
    if field.annotation is bool:
        return "true or false"
    parts = []
    for bound in field.metadata:
        for key, words in _BOUNDS.items():
            limit = getattr(bound, key, None)
            if limit is not None and limit != _UNBOUNDED:
                parts.append(f"{words} {_value(limit)}")
        if multiple := getattr(bound, "multiple_of", None):
            parts.append("even" if multiple == 2 else f"a multiple of {multiple}")
    return ", ".join(parts) or ", ".join(map(str, get_args(field.annotation)))


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


def _sentence(text: str) -> str:
    return text.strip().removesuffix(".")


def _table(header: list[str], rows: Iterable[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    for path in sorted(FOLDER.glob("*.md")):
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
