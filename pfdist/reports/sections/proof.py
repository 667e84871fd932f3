"""How much lower the error of other times can be: the lower bound and the parts of the gap."""

from typing import Any

from pfdist.common.gap_sentence import rounded_up
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded, with_error
from pfdist.reports.parts import Cell, Section, Table, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject

_MEANING = (
    "No allowed times of the same number, or of the same cost, have a lower expected error than "
    "the lower bound, with any filter of the same model. It follows from a problem that is easier "
    "to solve: now and then the filter gets more measurements than it has paid for. The gap is how "
    "much lower the error can be at most: the parts of the gap come from the easier problem and "
    "from chance, from the filter's number of particles, and from a wrong model of the filter. "
    "Both errors in this table were computed on draws of their own, so they differ a little from "
    "the errors above."
)
_HEAD = (
    "times", "expected error", "lower bound", "gap", "limit of the gap", "part: relaxation",
    "part: particles", "part: model",
)  # fmt: skip


def proof(subject: Subject) -> Section | None:
    """Give the lower bound of each set but the reference, or why there is none."""
    proofs = {
        name: each["lower_bound"] for name, each in subject.others.items() if "lower_bound" in each
    }
    if not proofs:
        return None
    rows = [_row(name, each) for name, each in proofs.items() if not each["reason"]]
    tables = [Table("Lower bounds and gaps", _HEAD, rows)] if rows else []
    reasons = [
        Text(f"There is no lower bound for {name}: {each['reason']}.")
        for name, each in proofs.items()
        if each["reason"]
    ]
    return Section(
        "How much better can other times be?",
        [Text(_MEANING), *tables, *reasons, *pictures(subject.tables, ["bound"])],
    )


def _row(name: str, proved: dict[str, Any]) -> list[Cell]:
    scale = proved["expected_mse"] or 1.0
    parts = [proved[key] / scale for key in ("relaxation", "estimate", "filter_model")]
    mse, limit = proved["expected_mse"], proved["gap_at_most"]
    return [
        Cell(name),
        Cell(with_error(mse, proved["expected_mse_error"]), mse),
        Cell(with_error(proved["bound"], proved["bound_error"]), proved["bound"]),
        Cell(percent(proved["gap"]), proved["gap"]),
        Cell(_limit(limit), limit),
        *(Cell(percent(part), part) for part in parts),
    ]


def _limit(fraction: float | None) -> str:
    return "unknown" if fraction is None else f"{rounded(100 * rounded_up(fraction), 2)} %"
