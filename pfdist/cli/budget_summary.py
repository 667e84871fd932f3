"""The summary of a run for several numbers of measurements."""

from statistics import mode
from typing import Any

from pfdist.cli.belief import distance
from pfdist.cli.numbers import cost
from pfdist.common.rounding import with_interval

_KINDS = ("regular", "found")


def is_for_several_numbers(summary: dict[str, Any]) -> bool:
    """Whether a run has times for several numbers of measurements."""
    return any("kind" in result for result in summary["results"].values())


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
    for kind, reached in summary.get("reached", {}).items():
        lines += ["", _reached_line(kind, reached, summary["target"])]
        if reached["measurement_times"] is not None and kind == "found":
            times = ", ".join(map(str, reached["measurement_times"]))
            lines.append(f"  measure at t = {times}")
    return lines


def _table(results: list[dict[str, Any]]) -> list[str]:
    """Give a row for each number of measurements."""
    lines = [
        "",
        "expected MSE on fresh draws (95 %)",
        f"{'N':>5}  {'regular times':>31}  {'found times':>31}",
    ]
    for number in sorted({result["measurements"] for result in results}):
        cells = {
            result["kind"]: _cell(result) for result in results if result["measurements"] == number
        }
        row = "  ".join(f"{cells[kind]:>31}" for kind in _KINDS if kind in cells)
        lines.append(f"{number:>5}  {row}".rstrip())
    return lines


def _cell(result: dict[str, Any]) -> str:
    mse, low, high = with_interval(cost(result["expected_mse"]), result["low"], result["high"])
    return f"{mse} ({low} to {high})"


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


def _reached_line(kind: str, reached: dict[str, Any], target: float) -> str:
    number = reached["measurements"]
    if number is None:
        return f"{kind} times reach {target:g} with none of these numbers of measurements"
    low, high = ("more" if bound is None else str(bound) for bound in reached["interval"])
    told = f"{kind} times reach {target:g} with N = {number} (95 %: {low} to {high})"
    others = ", ".join(map(str, reached["larger_that_do_not"]))
    return told + (f", but not with N = {others}" if others else "")
