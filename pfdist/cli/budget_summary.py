"""The summary of a run for several numbers of measurements."""

from collections import defaultdict
from decimal import ROUND_FLOOR, Decimal
from statistics import mode
from typing import Any

from pfdist.cli.belief import distance
from pfdist.cli.layout import COLUMNS, paragraph
from pfdist.common.percent import cost, heavy_tail_warning
from pfdist.common.rounding import rounded, with_interval
from pfdist.common.told_times import told_times

_KINDS = ("regular", "found")
_BOUND = "lower bound"


def budget_lines(summary: dict[str, Any]) -> list[str]:
    """Give the expected MSE for each number of measurements, and how many reach a target.

    Parameters
    ----------
    summary : dict
        As of `pfdist.analysis.Run.summary`. The keys ``target`` and ``reached`` may be added: an
        expected MSE, and what `pfdist.analysis.Run.reaching` gives for it.
    """
    results = list(summary["results"].values())
    found = [result for result in results if result["kind"] == "found"]
    lines = [*_table(results), *_worse_lines(results), *_belief_lines(found)]
    lines += _unproved_lines(found)
    shares = {name: result["top_percent_share"] for name, result in summary["results"].items()}
    lines += paragraph(heavy_tail_warning(shares))
    for kind, reached in summary.get("reached", {}).items():
        lines += ["", _reached_line(kind, reached, summary["target"])]
        if reached["measurement_times"] is not None and kind == "found":
            times = told_times(reached["measurement_times"], summary.get("time_unit", ""))
            lines.append(f"  measure at t = {times}")
    return lines


def _table(results: list[dict[str, Any]]) -> list[str]:
    """Give a row for each number of measurements; a bound if there is one and it has room."""
    cells = defaultdict[int, dict[str, str]](dict)
    for result in results:
        row = cells[result["measurements"]]
        row[f"{result['kind']} times"] = _cell(result)
        if result["bound"] is not None:
            row[_BOUND] = _bound_cell(result)
    columns = [f"{kind} times" for kind in _KINDS]
    if any(_BOUND in row for row in cells.values()):
        columns.append(_BOUND)
    lines = _aligned(cells, columns)
    if max(map(len, lines)) > COLUMNS and columns[-1] == _BOUND:
        lines = _aligned(cells, columns[:-1])
    return ["", "expected MSE on fresh draws (95 %)", *lines]


def _aligned(cells: dict[int, dict[str, str]], columns: list[str]) -> list[str]:
    rows = [dict(zip(columns, columns, strict=True)), *(cells[number] for number in sorted(cells))]
    widths = {column: max(len(row.get(column, "")) for row in rows) for column in columns}
    heads = ["N", *map(str, sorted(cells))]
    return [
        "  ".join(
            [f"{head:>5}", *(f"{row.get(name, ''):>{widths[name]}}" for name in columns)]
        ).rstrip()
        for head, row in zip(heads, rows, strict=True)
    ]


def _cell(result: dict[str, Any]) -> str:
    mse, low, high = with_interval(cost(result["expected_mse"]), result["low"], result["high"])
    return f"{mse} ({low} to {high})"


def _bound_cell(result: dict[str, Any]) -> str:
    """Give the bound and its lower limit, which is rounded down: it must hold as it is printed."""
    bound, limit = result["bound"], result["bound_low"]
    if not result["bound_error"]:  # exact
        return rounded(bound)
    text, low, _ = with_interval(bound, limit, 2 * bound - limit)
    floor = Decimal(limit).quantize(Decimal(low), ROUND_FLOOR)
    return f"{text} (from {floor})".lower()  # Decimal writes E for e


def _worse_lines(results: list[dict[str, Any]]) -> list[str]:
    """Name the numbers of measurements that are worse than a smaller number."""
    lines = []
    for kind in _KINDS:
        worse = [
            f"{result['measurements']} than {result['worse_than']}"
            for result in results
            if result["kind"] == kind and result["worse_than"] is not None
        ]
        if worse:
            lines.append(
                f"{kind} times: more measurements are worse (95 % for all pairs together), "
                f"N = {', '.join(worse)}"
            )
    return lines


def _belief_lines(found: list[dict[str, Any]]) -> list[str]:
    """Give the mean distance of what the search believed from the fresh costs (winner's curse)."""
    excesses = [result["search_excess"] for result in found if result["search_excess"] is not None]
    if not excesses or found[0]["search_standard_error"] == 0.0:  # the search knew exact costs
        return []
    cause = mode(result["search_cause"] for result in found)
    mean = distance(sum(excesses) / len(excesses), {**found[0], "search_cause": cause})
    distrust = found[0].get("search_distrust")
    return [
        f"found times: the search believed on average {mean}",
        *([f"searched again: {distrust}"] if distrust else []),
    ]


def _unproved_lines(found: list[dict[str, Any]]) -> list[str]:
    """Say why there is no lower bound, if a proof has failed."""
    numbers = defaultdict[str, list[str]](list)
    for result in found:
        reason = result.get("lower_bound", {}).get("reason")
        if reason:
            numbers[reason].append(str(result["measurements"]))
    return [f"no lower bound for N = {', '.join(every)}: {why}" for why, every in numbers.items()]


def _reached_line(kind: str, reached: dict[str, Any], target: float) -> str:
    number = reached["measurements"]
    low, high = ("more" if bound is None else str(bound) for bound in reached["interval"])
    told = f"target {target:g}: "
    if number is None:
        told += f"none of these numbers of {kind} times reaches it"
    else:
        reach = "time reaches" if number == 1 else "times reach"
        told += f"{number} {kind} {reach} it (95 %: {low} to {high})"
    others = reached["larger_that_do_not"]
    if others:
        told += f", but not {', '.join(map(str, others))}"
    impossible = reached.get("impossible")
    times = "time" if impossible == 1 else "times"
    return told if impossible is None else f"{told}; no {impossible} {times} can (95 %)"
