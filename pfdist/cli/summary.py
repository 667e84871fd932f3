"""The summary of a run, as a person reads it."""

import sys
from typing import Any

from pfdist.cli.belief import belief_line
from pfdist.cli.bound_lines import proof_lines
from pfdist.cli.budget_summary import budget_lines
from pfdist.cli.gain_lines import (
    gain_of_means_line,
    mean_relative_gain_line,
    positive_gains_line,
    why_gains_disagree,
)
from pfdist.cli.layout import line, paragraph, wrapped_lines
from pfdist.cli.online_lines import online_lines
from pfdist.cli.pair_lines import comparison_lines
from pfdist.common.percent import (
    cost,
    heavy_tail_warning,
    particle_loss_text,
    percent,
    percent_with_interval,
    range_of,
)
from pfdist.common.rounding import with_error, with_interval
from pfdist.common.told_times import told_times
from pfdist.errors import one_line


def print_summary(summary: dict[str, Any], files: str) -> None:
    """Print the summary of a run on standard output.

    Parameters
    ----------
    summary : dict
        As `pfdist.analysis.Run.summary` gives it.
    files : str
        Where tables and figures are; the last line.
    """
    is_curve = summary["has_budget"] and summary["draws_compared"]
    lines = [
        f"{one_line(summary['run'])}: {summary['state']}, {summary['evaluations']:,} evaluations, "
        f"{summary['draws_compared']:,} draws compared",
        *(budget_lines(summary) if is_curve else _lines_of_sets(summary)),
        *comparison_lines(summary),
        *_lines_of_online(summary),
        *(["", files] if files else []),
    ]
    print("\n".join(lines), file=sys.stdout)


def _lines_of_sets(summary: dict[str, Any]) -> list[str]:
    """Give the lines of each set of measurement times, the reference first."""
    lines, results = [], summary["results"]
    for name, result in results.items():
        times = told_times(result["measurement_times"], summary.get("time_unit", ""))
        lines += ["", f"{name}: measure at " + (f"t = {times}" if times else "no time")]
        if "expected_mse" in result:
            lines += _compared_lines(name, summary)
        elif result["search_cost"] is not None:  # the comparison has not begun
            lines.append(belief_line(result))
    return lines


def _lines_of_online(summary: dict[str, Any]) -> list[str]:
    """Give the lines about times that are chosen one after another, if the run has some."""
    if "online" not in summary:
        return []
    online, results = summary["online"], summary["results"]
    return ["", *online_lines(online, results[online["reference"]["name"]].get("gain_over_itself"))]


def _compared_lines(name: str, summary: dict[str, Any]) -> list[str]:
    """Give what the comparison says of a set."""
    results = summary["results"]
    reference, result = next(iter(results)), results[name]
    mse = with_error(cost(result["expected_mse"]), result["standard_error"])
    lines = _given_lines(result) if "description" in result else []
    lines.append(line("expected MSE", f"{mse}  (standard error, on fresh draws)"))
    if result["degenerate_draws"]:
        lines.append(line("degenerate draws", f"{result['degenerate_draws']:,} (left out)"))
    if result.get("particle_loss_limit") is not None:
        loss = particle_loss_text(result["particle_loss"], result["particle_loss_limit"])
        lines.append(line("particles lose", loss))
    if warning := heavy_tail_warning({name: result["top_percent_share"]}):
        lines += wrapped_lines("heavy tail", warning)
    if result["search_cost"] is not None:
        lines.append(belief_line(result))
    if result.get("search_distrust"):
        lines += wrapped_lines("searched again", result["search_distrust"])
    is_only_compared = all(each["search_cost"] is None for each in results.values())
    if "mean_relative_gain" in result and not is_only_compared:
        noise = results[reference].get("gain_over_itself")
        lines += _gain_lines(result, reference, noise)
    if "mean_relative_gain" in result and "lower_bound" in result:
        measurements, constrained = len(result["measurement_times"]), summary["is_constrained"]
        proof = result["lower_bound"]
        lines += proof_lines(proof, measurements, is_constrained=constrained)
    if "gain_over_itself" in result:
        interval = result["gain_over_itself_interval"]
        gain = percent_with_interval(result["gain_over_itself"], interval)
        lines.append(line("gain over itself", f"{gain}, from filter noise alone"))
    for warning in result.get("warnings", []):
        lines += paragraph(warning)
    return lines


def _given_lines(result: dict[str, Any]) -> list[str]:
    """Describe a set that no search found, and name the constraints of the job that it breaks."""
    facts = [("what it is", result["description"])]
    facts += [("breaks", constraint) for constraint in result["broken_constraints"]]
    return [wrapped for name, text in facts for wrapped in wrapped_lines(name, text)]


def _gain_lines(result: dict[str, Any], reference: str, noise: float | None) -> list[str]:
    """Give the gain of means, which a search of small costs raises, then the paper's figures."""
    quartiles = [result["quantiles"].get(share) for share in ("0.25", "0.5", "0.75")]
    log10, *ends = with_interval(result["mean_log10_ratio"], *result["mean_log10_ratio_interval"])
    lines = [
        gain_of_means_line(result, reference),
        mean_relative_gain_line(result),
        positive_gains_line(result),
        line("quartiles", ", ".join(percent(quartile, 1) for quartile in quartiles)),
        line("mean log10 of ratio", f"{log10}  (95 %: {range_of(*ends)})"),
    ]
    return lines + (why_gains_disagree(noise) if result["gains_disagree"] else [])
