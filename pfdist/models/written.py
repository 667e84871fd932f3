"""Models as text: the content of a run's model.json.

The text may have been edited. Reading it runs no code: every operation is checked to be known, to
take earlier results of the right kind, and to stay within the limits of tracing.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pfdist.common.parsing import MOST_BYTES_OF_MODELS, parse_json
from pfdist.errors import ModelError
from pfdist.models.base import Sensor, StateSpaceModel
from pfdist.models.checks import MEASURING, MOST_COMPONENTS, own_formulas
from pfdist.models.program import (
    GROUPS,
    MOST_STEPS,
    TAKES,
    Array,
    Operation,
    Program,
    excess_of_loops,
    kind_of,
)
from pfdist.models.programs import Declared, Programs
from pfdist.models.recorded import PLAIN
from pfdist.models.symbols import MOST_OPERATIONS
from pfdist.models.tracing import MODES, MOST_CONSTANTS, MOST_STRUCTURES, Traced
from pfdist.models.twin import formula_of, results_of

MOST_LISTS: Final = 4_000_000  # an operation has two, and an instant of a formula one
MOST_INSTANTS: Final = 100_000
_WORDS = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


# --- writing --------------------------------------------------------------------------------------


def _data_of(model: StateSpaceModel) -> dict[str, Any]:
    data = {name: _plain(getattr(model, name)) for name in PLAIN}
    return data | {
        "proposal_noise": [],  # which versions before had, so that keys of models are as they were
        "parameters": _plain(model.parameters),
        "formulas": {name: _formula(model, name) for name in own_formulas(model)},
        "sensors": {
            way.name: {
                "measurement_noise": [*way.model.measurement_noise],
                **{key: _formula(way.model, key) for key in MEASURING},
                **_works(way.model),
            }
            for way in model.ways
            if model.sensors
        },
        **_works(model),
    }


def _works(model: StateSpaceModel) -> dict[str, Any]:
    """The key of measurements that may give no value because of x; most models have none."""
    return {"works": True} if model.works else {}


def text_of_models(truth: StateSpaceModel, believed: StateSpaceModel) -> str:
    """The text of two recorded models: the truth and the filter's model."""
    data = {"truth": _data_of(truth), "filter": None if believed == truth else _data_of(believed)}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False) + "\n"
    lists = text.count("[")
    if lists > MOST_LISTS or len(text) > MOST_BYTES_OF_MODELS:
        raise ModelError(
            f"model {truth.name}: the text of its programs must have at most {MOST_LISTS:,} lists "
            f"and {MOST_BYTES_OF_MODELS:,} bytes, got {lists:,} and {len(text):,}: a smaller "
            "horizon helps"
        )
    return text


def key_of_model(model: StateSpaceModel) -> str:
    """A hash of everything that a recorded model computes."""

    def make() -> str:
        text = text_of_models(model, model)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    key: str = model.kept("key", make)
    return key


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return str(float(value)) if isinstance(value, float) and not math.isfinite(value) else value


def _formula(model: StateSpaceModel, name: str) -> Any:
    formula = getattr(model, name)
    if isinstance(formula, Declared):
        return {"declared": formula.identity, "results": results_of(model, name)}
    return [*map(_traced, formula.variants)] if isinstance(formula, Programs) else None


def _traced(traced: Traced) -> dict[str, Any]:
    programs = [
        {
            "operations": [[name, [*taken], which] for name, taken, which in each.operations],
            "outputs": [*each.outputs],
            "constants": _plain(each.constants.tolist()),
            "tables": [_plain(table.tolist()) for table in each.tables],
        }
        for each in traced.programs
    ]
    if traced.mode == MODES[0]:
        return {"programs": programs}
    return {
        "programs": programs,
        "first": traced.instants[0],
        "which": traced.which.tolist(),
        "read": _plain(traced.read),
    }


# --- reading --------------------------------------------------------------------------------------


def models_of(content: bytes) -> tuple[StateSpaceModel, StateSpaceModel]:
    """The truth and the filter's model from a text; they may be the same object.

    Raises
    ------
    ValueError
        `text_of_models` does not write such a text, or the text is too large.
    """
    lists = content.count(b"[")
    _need(lists <= MOST_LISTS, f"at most {MOST_LISTS:,} lists are read, got {lists:,}")
    data = parse_json(content)
    _need(isinstance(data, dict) and {*data} == {"truth", "filter"}, "it must have two models")
    try:
        truth = _model(data["truth"])
        return truth, truth if data["filter"] is None else _model(data["filter"])
    except ModelError as error:
        raise ValueError(str(error)) from error
    except (KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise ValueError(f"a part is missing, or of a wrong kind ({error})") from error


def _need(is_right: bool, what: str) -> None:
    if not is_right:
        raise ValueError(what)


def _model(data: Mapping[str, Any]) -> StateSpaceModel:
    _need(
        {*data} - {"works"} == {*PLAIN, "proposal_noise", "parameters", "formulas", "sensors"},
        "unexpected or missing keys of a model",
    )
    _need(data["proposal_noise"] == [], "a model has a proposal, which versions before had")
    fields: dict[str, Any] = {name: data[name] for name in PLAIN}
    name = fields["name"]
    fields["parameter_ranges"] = {
        key: tuple(_read_number(each) for each in limits)
        for key, limits in data["parameter_ranges"].items()
    }
    fields["parameters"] = {key: _read_parameter(each) for key, each in data["parameters"].items()}
    for key, formula in data["formulas"].items():
        if formula is not None:
            fields[key] = _read_formula(key, name, formula)
    fields["sensors"] = {
        key: Sensor(
            _read_formula("measurement", name, sensor["measurement"]),
            _read_formula("log_likelihood", name, sensor["log_likelihood"]),
            measurement_noise=tuple(sensor["measurement_noise"]),
            works=_read_works(sensor),
        )
        for key, sensor in data["sensors"].items()
    }
    model = StateSpaceModel(**fields, works=_read_works(data))
    _need({*data["formulas"]} == {*own_formulas(model)}, "a model has other formulas")
    for way in model.ways:
        for key in own_formulas(way.model):
            formula = getattr(way.model, key)
            if isinstance(formula, Programs):
                counts = formula_of(way.model, key).arguments
                results = results_of(way.model, key)
                for traced in formula.variants:
                    for program in traced.programs:
                        _check_leaves(program, counts, model)
                        _need(len(program.outputs) == results, f"{key} has other results")
                    _need(traced.read.keys() <= model.parameters.keys(), f"{key} reads a number")
    return model


def _read_works(data: Mapping[str, Any]) -> bool:
    _need(data.get("works", True) is True, "works is true, or left out")
    return "works" in data


def _read_number(value: Any) -> float:
    if isinstance(value, str):
        return _WORDS[value]
    _need(type(value) in (int, float), f"a number is expected, got {str(value)[:40]!r}")
    return float(value)


def _read_parameter(value: Any) -> Any:
    return tuple(map(_read_number, value)) if isinstance(value, list) else _read_number(value)


def _read_array(rows: Any, columns: int | None = None) -> Array:
    """An array of numbers; with a number of columns, of rows of so many."""
    if columns is None:
        return np.array([_read_number(each) for each in rows], np.float64)
    _need(all(len(row) == columns for row in rows), "rows of constants must have equal lengths")
    numbers = [[_read_number(each) for each in row] for row in rows]
    return np.array(numbers, np.float64).reshape(len(rows), columns)


def _read_formula(name: str, model: str, data: Any) -> Programs | Declared:
    if isinstance(data, dict):
        _need("declared" in data, f"{name} has no program, which versions before allowed")
        results = data["results"]
        _need(
            type(results) is int and 0 < results <= MOST_COMPONENTS, "a number of results is wrong"
        )
        return Declared(name, model, _read_identity(data["declared"]), results=results)
    variants = tuple(map(_read_traced, data))
    _need(bool(variants), f"{name} has no program")
    return Programs(name, model, variants[0], variants)


def _read_identity(data: Any) -> dict[str, Any]:
    keys = {"version", "files", "libraries", "coupled", "together"}
    _need({*data} == keys, "an identity has other keys")
    _need(type(data["together"]) is int and data["together"] > 0, "together must be at least 1")
    texts = [data["version"], *data["files"].items(), *data["libraries"].items()]
    parts = [text for each in texts for text in (each if isinstance(each, tuple) else (each,))]
    _need(all(isinstance(text, str) for text in parts), "an identity must consist of texts")
    _need(isinstance(data["coupled"], bool), "coupled must be true or false")
    return dict(data)


def _read_traced(data: Mapping[str, Any]) -> Traced:
    programs = tuple(map(_read_program, data["programs"]))
    _need(0 < len(programs) <= MOST_STRUCTURES, "a formula has too many programs, or none")
    size = sum(each.constants.size for each in programs)
    _need(size <= MOST_CONSTANTS, f"a formula has {size:,} constants")
    if "first" not in data:
        _need(len(programs) == 1 and len(programs[0].constants) == 1, "a program has rows")
        return Traced.symbolic(programs[0], range(1))
    which, first = np.array(data["which"], np.int64), data["first"]
    count = which.size
    _need(which.shape == (count,) and count > 0, "which must have an entry for each instant")
    _need(type(first) is int and first >= 0 and count <= MOST_INSTANTS, "instants are wrong")
    _need(bool(((which >= 0) & (which < len(programs))).all()), "a program is missing")
    rows = [len(each.constants) for each in programs]
    counts = np.bincount(which, minlength=len(programs)).tolist()
    _need(rows == counts, "a program must have a row of constants for each of its instants")
    read = {key: _read_parameter(each) for key, each in data["read"].items()}
    mode = MODES[2] if read else MODES[1]
    return Traced(range(first, first + count), programs, which, mode, read)


def _read_program(data: Mapping[str, Any]) -> Program:
    operations = data["operations"]
    _need(len(operations) <= MOST_OPERATIONS, f"a formula has {len(operations):,} operations")
    tables = tuple(_read_array(each) for each in data["tables"])
    size = sum(each.size for each in tables)
    _need(size <= MOST_CONSTANTS, f"tables have {size:,} numbers")
    rows = data["constants"]
    constants = _read_array(rows, len(rows[0]) if rows else 0)
    _need(len(constants) > 0, "a program has no row of constants")
    _need(all(isinstance(taken, list) for _, taken, _ in operations), "arguments must be lists")
    read = [Operation(name, tuple(taken), which) for name, taken, which in operations]
    loops, excess = _loops_of(read), excess_of_loops(read)
    _need(not excess, excess)
    for number, operation in enumerate(read):
        _check_operation(read, number, operation)
        _check_loops(read, number, loops)
        if operation.name == "constant":
            _need(operation.which < constants.shape[1], "a constant is missing")
        elif operation.name == "take":
            _need(operation.which < len(tables), "a table is missing")
            _need(tables[operation.which].size > 0, "a table is empty")
    outputs = tuple(data["outputs"])
    _need(0 < len(outputs) <= MOST_COMPONENTS, f"a formula has {len(outputs):,} results")
    for each in outputs:
        _need(type(each) is int and 0 <= each < len(read), "a result is missing")
        _need(kind_of(read[each].name) in "fm" and not loops[each], "a result is of a step")
    return Program(tuple(read), outputs, constants, tables)


def _check_operation(operations: Sequence[Operation], number: int, operation: Operation) -> None:
    name, taken, which = operation
    kinds = TAKES.get(name) if isinstance(name, str) else None
    if kinds is None:
        raise ValueError(f"unknown operation {str(name)[:40]!r}")
    if kinds[-1:] == "*":
        kinds = kinds[:-1] + kinds[-2] * (len(taken) - len(kinds) + 1)
    _need(len(taken) == len(kinds), f"{name} has {len(taken)} arguments")
    for each, kind in zip(taken, kinds, strict=True):
        _need(type(each) is int and 0 <= each < number, f"an argument of {name} comes later")
        _need(kind_of(operations[each].name) == kind, f"an argument of {name} is of a wrong kind")
    if name in ("constant", "take", "state", "final", "repeat") or name in GROUPS:
        _need(type(which) is int and which >= 0, f"{name} of a wrong entry")
    elif name in ("parameter", "covariate"):
        _need(isinstance(which, str), f"{name} of a wrong name")
    else:
        _need(which is None, f"{name} of something")
    if name == "covariate":
        index = operations[taken[0]].name
        _need(index in ("t", "constant"), "an entry of a parameter at a computed instant")


def _loops_of(operations: Sequence[Operation]) -> list[int]:
    """The number of the loop of each operation, from 1 on; 0 outside of loops."""
    loops, loop, inside = list[int](), 0, False
    for operation in operations:
        is_begin = operation.name == "repeat"
        _need(not (is_begin and inside), "a loop begins in another")
        loop, inside = loop + is_begin, inside or is_begin
        inside = inside and operation.name != "again"
        loops.append(loop * inside)
    _need(not inside, "a loop does not end")
    return loops


def _check_loops(operations: Sequence[Operation], number: int, loops: Sequence[int]) -> None:
    """Check that an operation takes nothing of another loop, and as many values as there are."""
    name, taken, which = operations[number]
    loop = loops[number - 1] if name == "again" else loops[number]
    for place, each in enumerate(taken):
        before = name == "repeat" or (name == "nth" and place > 0)
        _need(loops[each] in ((0,) if before else (0, loop)), f"{name} takes a value of a step")
    if name == "repeat":
        _need(0 < which <= MOST_STEPS and len(taken) > 1, "a loop has wrong sizes")
    elif name in ("state", "nth", "again"):
        _, (_, *values), most = operations[taken[0]]
        sizes = {"state": which is None or which < len(values), "nth": len(taken) - 1 == most}
        _need(sizes.get(name, len(taken) - 1 == len(values)), f"{name} of a loop of another size")
    elif name == "final":
        _need(which < len(operations[taken[0]].arguments) - 1, "a value of a loop is missing")


def _check_leaves(program: Program, counts: Mapping[str, int], model: StateSpaceModel) -> None:
    """Check that components and parameters exist, and entries of parameters within the horizon."""
    for name, taken, which in program.operations:
        if name in GROUPS:
            _need(which < counts.get(name, 0), f"{name} has no component {which}")
        elif name == "t":
            _need("t" in counts, "t is no argument")
        elif name in ("parameter", "covariate"):
            value = model.parameters.get(which)
            _need(value is not None, f"there is no parameter {which[:40]!r}")
            is_covariate = isinstance(value, tuple)
            _need(
                is_covariate == (name == "covariate"), f"the parameter {which} is of a wrong kind"
            )
            if isinstance(value, tuple) and program.operations[taken[0]].name == "constant":
                column = program.constants[:, program.operations[taken[0]].which]
                inside = (column >= 0) & (column < len(value)) & (column == np.floor(column))
                _need(bool(inside.all()), f"the parameter {which} has no such entry")
