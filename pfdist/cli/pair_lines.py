"""The lines of a summary about how named sets compare."""

from typing import Any

from pfdist.cli.layout import paragraph, wrapped_lines
from pfdist.common.percent import cost, range_of
from pfdist.common.rounding import with_error, with_interval

_MOST_PAIRS = 28  # of 8 sets


def comparison_lines(summary: dict[str, Any]) -> list[str]:
    """Give the ranks of all sets, and a line for each pair.

    Parameters
    ----------
    summary : dict
        As of `pfdist.analysis.Run.summary`; without ranks, no lines.
    """
    if not summary.get("ranks"):
        return []
    # Not above: commands that print no run need no pandas.
    from pfdist.analysis.pairs import told_ranks  # noqa: PLC0415

    ranks, pairs = summary["ranks"], summary["pairs"]
    lines = ["", "ranks, the lowest expected MSE first"]
    for row in ranks:
        mse = with_error(cost(row["expected_mse"]), row["standard_error"])
        rank = told_ranks(row["best_rank"], row["worst_rank"])
        lines += wrapped_lines(f"{row['name']}", f"rank {rank}, expected MSE {mse}")
    lines += ["", f"pairs on the same draws (95 % for each; clear: 95 % for all {len(pairs)})"]
    if len(pairs) > _MOST_PAIRS:
        lines += paragraph(f"{len(pairs)} pairs: --json and the report show them.")
        return lines
    for pair in pairs:
        difference, share = _told(pair)
        lines += paragraph(f"{pair['first']} against {pair['second']}: {difference}")
        lines += [f"  {line}" for line in paragraph(share)]
    return lines


def _told(pair: dict[str, Any]) -> tuple[str, str]:
    """Say how much lower or higher the first expected MSE of a pair is, and in how many draws."""
    wins = _with_ends(pair, "first_wins", 100.0, " %")
    won = f"lower in {wins} of {pair['draws']:,} draws"
    if pair["difference"] is None:
        return "the difference is not known", won
    if not pair["difference"]:
        return "the expected MSEs are equal", won
    sign, side = (-1.0, "lower") if pair["difference"] < 0 else (1.0, "higher")
    clear = "clear" if pair["clear"] else "not clear"
    difference = f"{_with_ends(pair, 'difference', sign)} {side}, {clear}"
    return difference, f"{_with_ends(pair, 'gain_of_means', -100 * sign, ' %')} {side}; {won}"


def _with_ends(pair: dict[str, Any], key: str, scale: float, unit: str = "") -> str:
    """Give a value with its interval in brackets; an exact value alone."""
    limits = ("low", "high") if key == "difference" else (f"{key}_low", f"{key}_high")
    ends = [None if pair[limit] is None else scale * pair[limit] for limit in limits]
    known = None if pair[key] is None else scale * pair[key]
    value, low, high = with_interval(known, *(ends if scale > 0 else reversed(ends)))
    is_exact = ends[0] is not None and ends[0] == ends[1]
    return f"{value}{unit}" if is_exact else f"{value}{unit} ({range_of(low, high)})"
