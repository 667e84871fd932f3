"""What a person reads: the summary of a run, what its measurements are worth, a model's checks."""

import math
import sys
import textwrap
from statistics import mode
from typing import TYPE_CHECKING, Any

from pfdist.common.rounding import rounded, with_error, with_interval
from pfdist.errors import one_line

if TYPE_CHECKING:  # to look at a run wants none of what a check does
    from pfdist.checks.model import Check

_COLUMNS = 80
_EXACT = 1e-12  # of an exact value: less is the rounding of doubles


def print_check(check: "Check") -> None:
    """Print what was found about a model, a line."""
    print(one_line(f"{check.state:5} {check.name}: {check.text}"), flush=True)


def print_summary(summary: dict[str, Any], files: str) -> None:
    """Print the summary of a run on standard output.

    Parameters
    ----------
    summary : dict
        As `pfdist.analysis.Run.summary` gives it.
    files : str
        Where tables and figures lie, as a sentence.
    """
    print(_summary_text(summary, files), file=sys.stdout)


def _summary_text(summary: dict[str, Any], files: str) -> str:
    lines = [
        f"{one_line(summary['run'])}: {summary['state']}, {summary['evaluations']:,} evaluations, "
        f"{summary['draws_compared']:,} draws compared"
    ]
    if any("kind" in result for result in summary["results"].values()):
        return "\n".join([*lines, *_budget_lines(summary), *_ending(files)])
    reference = next(iter(summary["results"]), "")
    for name, result in summary["results"].items():
        times = ", ".join(map(str, result["measurement_times"]))
        lines += ["", f"{name}: measure at t = {times}"]
        if "expected_mse" not in result:  # the comparison has not begun
            lines += [] if result["search_cost"] is None else [_believed(result)]
            continue
        if name == reference:
            lines += _reference_lines(result)
        cost = with_error(_cost(result["expected_mse"]), result["standard_error"])
        lines.append(_line("expected MSE", f"{cost}  (standard error, on fresh draws)"))
        if result["degenerate_draws"]:
            lines.append(_line("degenerate draws", f"{result['degenerate_draws']:,} (left out)"))
        if result["search_cost"] is not None:
            lines.append(_believed(result))
        if result.get("search_distrust"):
            lines += _wrapped("searched again", result["search_distrust"])
        if "mean_relative_gain" in result:
            noise = summary["results"][reference].get("gain_over_itself")
            lines += _gain_lines(result, reference, noise)
        if "gain_over_itself" in result:
            interval = result["gain_over_itself_interval"]
            gain = _percent_of(result["gain_over_itself"], interval)
            lines.append(_line("gain over itself", f"{gain}, from filter noise alone"))
    return "\n".join([*lines, *_ending(files)])


def _ending(files: str) -> list[str]:
    return ["", files] if files else []


def _line(name: str, text: str) -> str:
    return f"  {name:<21} {text}"


def _wrapped(name: str, text: str) -> list[str]:
    return textwrap.wrap(_line(name, text), _COLUMNS, subsequent_indent=_line("", ""))


def _reference_lines(result: dict[str, Any]) -> list[str]:
    """Say what the reference is, and which constraints of the job it breaks."""
    facts = [("what it is", result["description"])]
    facts += [("breaks", constraint) for constraint in result["broken_constraints"]]
    return [line for name, text in facts for line in _wrapped(name, text)]


def _budget_lines(summary: dict[str, Any]) -> list[str]:
    """Tell what each number of measurements costs, and how many reach a target."""
    results = summary["results"].values()
    lines = [
        "",
        f"expected MSE on fresh draws (95 %)\n{'N':>5}  {'regular times':>31}  {'found times':>31}",
    ]
    for number in sorted({one["measurements"] for one in results}):
        its = {one["kind"]: one for one in results if one["measurements"] == number}
        cells = [_cost_cell(its[kind]) for kind in ("regular", "found") if kind in its]
        lines.append(f"{number:>5}  {'  '.join(f'{cell:>31}' for cell in cells)}".rstrip())
    for kind in ("regular", "found"):
        worse = [
            f"N = {one['measurements']} than with {one['worse_than']}"
            for one in results
            if one["kind"] == kind and one["worse_than"] is not None
        ]
        told = f"{kind} times are worse (95 %, for all together) with {'; '.join(worse)}"
        lines += [told] if worse else []
    lines += _believed_on_average([one for one in results if one["kind"] == "found"])
    for kind, its in summary.get("reached", {}).items():
        lines += ["", _reached(kind, its, summary["target"])]
        if its["measurement_times"] is not None and kind == "found":
            lines.append(f"  measure at t = {', '.join(map(str, its['measurement_times']))}")
    return lines


def _believed_on_average(found: list[dict[str, Any]]) -> list[str]:
    """Say how far what the search believed of its sets is from the truth (winner's curse)."""
    excesses = [one["search_excess"] for one in found if one["search_excess"] is not None]
    if not excesses or found[0]["search_standard_error"] == 0.0:  # they were known exactly
        return []
    excess = sum(excesses) / len(excesses)
    cause = mode(one["search_cause"] for one in found)
    off = _off(excess, {**found[0], "search_cause": cause})
    again = found[0].get("search_distrust")
    return [
        f"found times: the search believed on average {off}",
        *([f"searched again: {again}"] if again else []),
    ]


def _cost_cell(result: dict[str, Any]) -> str:
    mse = _cost(result["expected_mse"])
    cost, low, high = with_interval(mse, result["low"], result["high"])
    return f"{cost} ({low} to {high})"


def _reached(kind: str, its: dict[str, Any], target: float) -> str:
    if its["measurements"] is None:
        return f"{kind} times reach {target:g} with no number of measurements that was tried"
    low, high = ("more" if bound is None else str(bound) for bound in its["interval"])
    line = f"{kind} times reach {target:g} with N = {its['measurements']} (95 %: {low} to {high})"
    others = ", ".join(map(str, its["larger_that_do_not"]))
    return line + (f", but not with N = {others}" if others else "")


def print_why(found: dict[str, Any]) -> None:
    """Print what each measurement is worth on standard output.

    Parameters
    ----------
    found : dict
        As `pfdist.api.why.Why.as_json` gives it.
    """
    drawn = f"on {found['draws']:,} draws that chose nothing; ± standard error"
    draws = drawn if found["draws"] else "exact"
    lines = []
    for name, its in found["sets"].items():
        mse, error = its["expected_mse"], its["standard_error"]
        rows = [_rises(row, mse or 0.0) for row in its["measurements"]]
        width = max([17, *(len(rise) for row in rows for rise in row[1:])])
        lines += [
            f"{name}: expected MSE {with_error(_cost(mse), error)} ({draws})",
            "  by how much it rises if a measurement is",
        ]
        for row in [["t", "removed", "one earlier", "one later"], *rows]:
            cells = "  ".join(f"{rise:>{width}}" for rise in row[1:])
            lines.append(f"  {row[0]:>5}  {cells}".rstrip())
        lines.append("")
    print("\n".join(lines + [one_line(file) for file in found["figures"]]))


def _rises(row: dict[str, Any], mse: float) -> list[str]:
    """Give a measurement and its rises as text: of a shift that is impossible, nothing."""
    cells = [str(row["t"])]
    changes = [key for key in row if f"{key}_error" in row]
    for change in changes:
        mean, error = row[change], row[f"{change}_error"]
        rounded_off = error == 0.0 and mean is not None and abs(mean) < _EXACT * abs(mse)
        mean = 0.0 if rounded_off else mean
        cells.append("" if mean is None else with_error(mean, error, sign=True))
    return cells


def _believed(result: dict[str, Any]) -> str:
    """Say what the search believed, and how far that is from the truth (winner's curse)."""
    if result["search_standard_error"] == 0.0:
        return _line("exactly", f"{rounded(result['search_cost'])}, as the search knew")
    believed = with_error(result["search_cost"], result["search_standard_error"])
    line = _line("the search believed", believed)
    excess = result.get("search_excess")
    return line if excess is None else f"{line}, {_off(excess, result)}"


def _off(excess: float, result: dict[str, Any]) -> str:
    """Say by how much a search's cost is off, and why."""
    side = "below" if excess < 0 else "above"
    own = ", ".join(f"{key} = {its}" for key, its in result["search_estimation"].items())
    reasons = "; ".join(filter(None, [result["search_cause"], own]))
    return f"{_percent(abs(excess))} {side} the fresh cost ({reasons})"


def _gain_lines(result: dict[str, Any], reference: str, noise: float | None) -> list[str]:
    """Give what was minimised first, then the paper's figures, and why the two disagree."""
    gain, interval = result["gain_of_means"], result["gain_of_means_interval"]
    side = "lower"
    if gain is not None and gain < 0:
        side, gain = "higher", -gain
        interval = [None if end is None else -end for end in reversed(interval)]
    value, low, high = with_interval(*(_times_100(part) for part in (gain, *interval)))
    quartiles = [result["quantiles"].get(share) for share in ("0.25", "0.5", "0.75")]
    positive = _percent_of(
        result["positive_fraction"], result["positive_fraction_interval"], " of draws"
    )
    relative = _percent_of(result["mean_relative_gain"], result["mean_relative_gain_interval"])
    log10, *ends = with_interval(result["mean_log10_ratio"], *result["mean_log10_ratio_interval"])
    lines = [
        _line(f"against {reference}", f"{value} % {side}  (95 %: {_to(low, high)}; gain of means)"),
        _line("mean relative gain", relative),
        _line("positive gains", positive),
        _line("quartiles", ", ".join(_percent(quartile, 1) for quartile in quartiles)),
        _line("mean log10 of ratio", f"{log10}  (95 %: {_to(*ends)})"),
    ]
    return lines + (_why_gains_disagree(noise) if result["gains_disagree"] else [])


def _why_gains_disagree(noise: float | None) -> list[str]:
    """Say why the mean relative gain is not the gain of means.

    Parameters
    ----------
    noise : float or None
        The reference's gain over itself, if it is known.
    """
    why = "a relative gain weighs a draw with a small error as much as a draw with a large error"
    if noise is None:
        why += ", and the noise of the filters biases its mean low"
    elif noise:
        why += f", and the noise of the filters alone gives it a mean of {_percent(noise)}"
    told = f"The two gains differ: {why}."
    return textwrap.wrap(told, _COLUMNS, initial_indent="  ", subsequent_indent="  ")


def _cost(value: float | None) -> float:
    """An expected MSE of a summary, where what is infinite is None."""
    return math.inf if value is None else value


def _times_100(fraction: float | None) -> float | None:
    return None if fraction is None else 100 * fraction


def _percent(fraction: float | None, decimals: int = 2) -> str:
    if fraction is None:
        return "unknown"
    per_cent = 100 * fraction
    return f"{per_cent:.{decimals}f} %" if abs(per_cent) < 1e6 else f"{rounded(per_cent, 3)} %"


def _percent_of(fraction: float | None, interval: list[float | None], what: str = "") -> str:
    value, low, high = with_interval(*(_times_100(part) for part in (fraction, *interval)))
    return f"{value} %{what}  (95 %: {_to(low, high)})"


def _to(low: str, high: str) -> str:
    return low if low == high == rounded(None) else f"{low} to {high}"
