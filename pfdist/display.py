"""What a person sees: the progress of a run, and summaries."""

import math
import sys
import time
from statistics import mode
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Column

from pfdist.runner.check_model import Check
from pfdist.runner.progress import Progress as State

LINE_SECONDS = 5.0  # between two lines where there is no terminal


class Display:
    """Progress on standard error: live in a terminal, else a plain line every few seconds.

    A context manager; `report` and `say` are what `pfdist.run` takes.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True, highlight=False)
        self._bar = Progress(
            BarColumn(bar_width=16),
            TaskProgressColumn(),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
            TextColumn("{task.description}", table_column=Column(no_wrap=True)),
            console=self._console,
            transient=True,
        )
        self._live = self._console.is_terminal
        self._task: Any = None
        self._phase = ""
        self._phase_start, self._last_line = (0.0, 0, 0.0), 0.0
        self._shown = -1.0  # how much was done at the last line

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._task is not None:
            self._bar.stop()

    def say(self, line: str) -> None:
        """Print one line."""
        self._console.print(line, soft_wrap=True)

    def report(self, state: State) -> None:
        """Show how far a run is."""
        now = time.monotonic()
        if state.phase != self._phase:
            self._phase, self._phase_start = state.phase, (now, state.evaluations, state.done)
        line = self._line(state, now)
        if self._live:
            if self._task is None:
                self._task = self._bar.add_task(line, total=state.total, completed=int(state.done))
                self._bar.start()
            self._bar.update(self._task, completed=state.done, description=line)
        elif now - self._last_line >= LINE_SECONDS or (
            state.done == state.total and state.done != self._shown
        ):
            self._last_line, self._shown = now, state.done
            self.say(f"{100 * state.done / state.total:5.1f} %  {line}  {self._left(state, now)}")

    def _line(self, state: State, now: float) -> str:
        start, evaluations, _ = self._phase_start
        elapsed = now - start
        rate = (state.evaluations - evaluations) / elapsed if elapsed > 0.5 else 0.0
        unit = "evaluations" if state.generations else "draws"
        parts = [state.phase]
        if state.generations:
            parts.append(f"generation {state.generation}/{state.generations}")
        else:
            parts.append(f"{state.evaluations:,} draws")
        if state.best is not None and state.generations:
            parts.append(f"best {state.best:.2f}")
        if state.mean is not None and state.generations:
            parts.append(f"mean {state.mean:.2f}")
        for found in state.found[:1]:
            mean, half = found.mean_relative_gain, (found.interval[1] - found.interval[0]) / 2
            parts.append(
                f"{found.name} gains {100 * mean:.2f} ± {100 * half:.2f} %, "
                f"positive {100 * found.positive_fraction:.1f} %"
            )
        if rate:
            parts.append(f"{rate:,.{1 if rate < 100 else 0}f} {unit}/s")
        return "  ".join(parts)

    def _left(self, state: State, now: float) -> str:
        start, _, done = self._phase_start
        if state.done <= done:
            return ""
        seconds = (now - start) / (state.done - done) * (state.total - state.done)
        return (
            f"about {seconds:,.0f} s left"
            if seconds < 120
            else f"about {seconds / 60:,.0f} min left"
        )


def print_check(check: Check) -> None:
    """Print what was found about a model, a line."""
    print(f"{check.state:5} {check.name}: {check.text}", flush=True)  # noqa: T201  its output


def print_summary(summary: dict[str, Any], files: str) -> None:
    """Print the summary of a run on standard output.

    Parameters
    ----------
    summary : dict
        As `pfdist.analysis.Run.summary` gives it.
    files : str
        Where tables and figures lie, as a sentence.
    """
    print(_summary_text(summary, files), file=sys.stdout)  # noqa: T201  this is its output


def _summary_text(summary: dict[str, Any], files: str) -> str:
    lines = [
        f"{summary['run']}: {summary['state']}, {summary['evaluations']:,} evaluations, "
        f"{summary['draws_compared']:,} draws compared"
    ]
    if any("kind" in result for result in summary["results"].values()):
        return "\n".join([*lines, *_budget_lines(summary), "", files])
    for name, result in summary["results"].items():
        times = ", ".join(map(str, result["measurement_times"]))
        lines += ["", f"{name}: measure at t = {times}"]
        lines.append(
            f"  expected MSE          {_number(result['expected_mse'])} "
            f"± {_number(result['standard_error'])}  (standard error, on fresh draws)"
        )
        if result["degenerate_draws"]:
            lines.append(f"  degenerate draws      {result['degenerate_draws']:,} (left out)")
        if result["search_cost"] is not None:
            lines.append(_believed(result))
        if result.get("search_distrust"):
            lines.append(f"  searched again        {result['search_distrust']}")
        if "mean_relative_gain" in result:
            lines += _gain_lines(result)
        if "gain_over_itself" in result:
            lines.append(
                f"  gain over itself      {_percent(result['gain_over_itself'])}  "
                f"(95 %: {_interval(result['gain_over_itself_interval'])}): what the filters' "
                "noise alone does to a mean relative gain"
            )
    return "\n".join([*lines, "", files])


def _budget_lines(summary: dict[str, Any]) -> list[str]:
    """Tell what each number of measurements costs, and how many reach a target."""
    results = summary["results"].values()
    lines = [
        "",
        f"expected MSE on fresh draws (95 %)\n{'N':>5}  {'regular times':>31}  found times",
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
    cost, low, high = (_number(result[key]) for key in ("expected_mse", "low", "high"))
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
        As `pfdist.runner.why.Why.as_json` gives it.
    """
    drawn = f"on {found['draws']:,} draws that chose nothing; ± standard error"
    draws = drawn if found["draws"] else "exact"
    lines = []
    for name, its in found["sets"].items():
        mse, error = its["expected_mse"], its["standard_error"]
        margin = f" ± {_number(error)}" if found["draws"] else ""
        decimals = min(12, max(0, 5 - math.ceil(math.log10(abs(mse))))) if mse else 3
        lines += [
            f"{name}: expected MSE {_number(mse)}{margin} ({draws})",
            "  by how much it rises if a measurement is",
            f"  {'t':>5}  {'removed':>17}  {'one earlier':>17}  {'one later':>17}",
        ]
        for row in its["measurements"]:
            rises = [
                _rise(row[change], row[f"{change}_error"], decimals)
                for change in ("removed", "earlier", "later")
            ]
            lines.append(f"  {row['t']:>5}  {'  '.join(f'{rise:>17}' for rise in rises)}".rstrip())
        lines.append("")
    print("\n".join(lines + found["figures"]))  # noqa: T201  its output


def _rise(mean: float | None, error: float | None, decimals: int) -> str:
    """Say nothing where there is no such instant, or another measurement is there."""
    if mean is None or error is None:
        return ""
    return f"{mean:+.{decimals}f}" + (f" ± {error:.{decimals}f}" if error else "")


def _believed(result: dict[str, Any]) -> str:
    """Say what the search believed, and how far that is from the truth (winner's curse)."""
    if result["search_standard_error"] == 0.0:
        return f"  exactly               {_number(result['search_cost'])}, as the search knew"
    line = f"  the search believed   {_number(result['search_cost'])} "
    line += f"± {_number(result['search_standard_error'])}"
    excess = result["search_excess"]
    return line if excess is None else f"{line}, {_off(excess, result)}"


def _off(excess: float, result: dict[str, Any]) -> str:
    """Say by how much a search's cost is off, and why."""
    side = "below" if excess < 0 else "above"
    own = ", ".join(f"{key} = {its}" for key, its in result["search_estimation"].items())
    reasons = "; ".join(filter(None, [result["search_cause"], own]))
    return f"{_percent(abs(excess))} {side} the fresh cost ({reasons})"


def _gain_lines(result: dict[str, Any]) -> list[str]:
    quartiles = [result["quantiles"].get(share) for share in ("0.25", "0.5", "0.75")]
    low, high = result["mean_log10_ratio_interval"]
    return [
        f"  mean relative gain    {_percent(result['mean_relative_gain'])}  "
        f"(95 %: {_interval(result['mean_relative_gain_interval'])})",
        f"  positive gains        {_percent(result['positive_fraction'])} of draws  "
        f"(95 %: {_interval(result['positive_fraction_interval'])})",
        f"  quartiles             {', '.join(map(_percent, quartiles))}",
        f"  gain of means         {_percent(result['gain_of_means'])}  "
        f"(95 %: {_interval(result['gain_of_means_interval'])})",
        f"  mean log10 of ratio   {_log10(result['mean_log10_ratio'])}  "
        f"(95 %: {_log10(low)} to {_log10(high)})",
    ]


def _number(value: float | None) -> str:
    return "infinite" if value is None else f"{value:.4g}" if abs(value) < 0.1 else f"{value:.3f}"


def _percent(fraction: float | None) -> str:
    return "unknown" if fraction is None else f"{100 * fraction:.2f} %"


def _log10(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4f}"


def _interval(interval: list[float | None]) -> str:
    low, high = interval
    return f"{_percent(low)} to {_percent(high)}"
