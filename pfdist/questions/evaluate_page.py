"""The expected MSE of sets of times (``pfdist evaluate``)."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.common.parts import Cell, Page, Section, Table
from pfdist.common.percent import heavy_tail_warning
from pfdist.common.rounding import rounded, with_error
from pfdist.filters.estimate import Evaluation
from pfdist.questions.robust import parameters_text
from pfdist.questions.subject import mse_cell

_HEAD = ("times", "number", "expected MSE ± standard error", "draws")


def evaluate_page(
    evaluations: Mapping[str, Evaluation],
    broken: Mapping[str, Sequence[str]],
    scenarios: Sequence[Mapping[str, Any]] = (),
) -> Page:
    """The expected MSE of each set, and the constraints of the job that it breaks.

    `scenarios` are the parameters of the job's scenarios.
    """
    line, rows = "", [_row(name, evaluation) for name, evaluation in evaluations.items()]
    if list(evaluations) == [""]:
        _, _, mse, draws = (cell.text for cell in rows.pop())
        line = f"expected MSE {mse}" + f", {draws} draws" * bool(draws)
    warnings = list[str]()
    for name, evaluation in evaluations.items():
        these = f"the times of {name} break" if name else "these times break"
        warnings += [f"{these} a constraint: {constraint}" for constraint in broken[name]]
        of_set = f"{name}: " * bool(name and evaluation.degenerate_draws)
        warnings += filter(None, [of_set + evaluation.degenerate_text])
        warnings += filter(None, [heavy_tail_warning({name: evaluation.top_percent_share})])
    tables = [Table("", _HEAD, rows)] if rows else []
    tables += _of_scenarios(evaluations, scenarios)
    return Page("", line, [Section("", tables)], warnings)


def _of_scenarios(
    evaluations: Mapping[str, Evaluation], parameters: Sequence[Mapping[str, Any]]
) -> list[Table]:
    """The expected MSE of each set in each scenario that has a draw."""
    if not all(evaluation.of_scenarios for evaluation in evaluations.values()):
        return []
    columns = {name or "expected MSE": each.of_scenarios for name, each in evaluations.items()}
    rows = [
        [
            Cell(parameters_text(parameters[number])),
            *(
                mse_cell(each[number].expected_mse, each[number].standard_error)
                for each in columns.values()
            ),
        ]
        for number in sorted(next(iter(columns.values())))
    ]
    return [Table("Expected MSE ± standard error in each scenario", ("scenario", *columns), rows)]


def _row(name: str, evaluation: Evaluation) -> list[Cell]:
    number = len(evaluation.measurement_times)
    cells = [Cell(name), Cell(str(number), number)]
    if evaluation.exact is not None:
        return [*cells, Cell(f"{rounded(evaluation.exact)} (exact)"), Cell("")]
    mse = with_error(evaluation.expected_mse, evaluation.standard_error)
    return [
        *cells,
        Cell(mse),
        Cell(f"{evaluation.draws:,}", evaluation.draws),
    ]
