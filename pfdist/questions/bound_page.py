"""How much lower the error of other times can be: the lower bound and the parts of the gap."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.common.parts import Block, Cell, Facts, Figures, Page, Section, Table, Text
from pfdist.common.percent import NO_LIMITS, gap_sentence, particle_loss_text, percent, rounded_up
from pfdist.common.rounding import rounded, with_error
from pfdist.questions.subject import ERROR_HEAD, Subject
from pfdist.results.stored_run import last_bounds

_MEANING = (
    "No allowed times of the same number, or of the same price, have a lower expected error than "
    "the lower bound, with any filter of the same model. It follows from a problem that is easier "
    "to solve: now and then the filter gets more measurements than it has paid for. The gap is how "
    "much lower the error can be at most: the parts of the gap come from the easier problem and "
    "from chance, from the filter's number of particles, and from a wrong model of the filter. "
    "Both errors in this table were computed on draws of their own, so they differ a little from "
    "the errors above."
)
_TESTED = (
    "The bound needs the log-likelihood of the sensor's noise. It was tested as check-model tests "
    "it, and by the place of the truth among the particles. 480 draws find a sensor's standard "
    "deviation that is 20 % too large or too small in more than 9 of 10 cases; smaller faults may "
    "remain."
)
_TOLD = (
    "The lower bound is that of a filter that is told the scenario of its draw. It knows more than "
    "any real filter, so the bound holds for all."
)
_WORST = (
    "The expected error is that of the worst scenario. The lower bound is one of a mean of the "
    "scenarios: the worst error of any times is at least this mean. Even the best times may lie "
    "above it (a duality gap). The shares of the scenarios in the mean, for which the bound is "
    "largest: "
)
_HEAD = (
    "times", ERROR_HEAD, "lower bound ± standard error", "gap, estimated", "gap, at most",
    "part: relaxation", "part: particles", "part: model",
)  # fmt: skip


def proof(subject: Subject) -> Section | None:
    """The lower bound of each set but the reference, or why there is none."""
    last = last_bounds(subject.run)
    proofs = {name: last[name] for name in subject.others if name in last}
    if not proofs:
        return None
    shares = next(iter(proofs.values())).get("shares") or ()
    texts = _scenarios(shares) if subject.scenarios else []
    blocks = [*_meaning(proofs), *_table(proofs), *texts]
    title = "How much better can other times be?"
    return Section(title, [*blocks, Figures(["bound"])])


def bound_page(answer: Mapping[str, Any], within: float | None = None) -> Page:
    """The answer of `pfdist.bound`.

    Parameters
    ----------
    answer : mapping
        As of `pfdist.questions.bound.Bound.as_json`.
    within : float, optional
        The gap that was demanded.
    """
    proofs, common = answer["sets"], {"confidence": answer["confidence"]}
    constrained = answer["is_constrained"]
    blocks, warnings = list[Block](), list[str]()
    for name, each in proofs.items():
        number = len(each["measurement_times"])
        if not each["reason"]:
            sentence = gap_sentence(
                each | common,
                number,
                is_constrained=constrained,
                has_scenarios=answer["has_scenarios"],
            )
            blocks.append(Text(f"{name}: {sentence}", prominent=True))
        if each.get("particle_loss_limit") is not None:
            loss = particle_loss_text(each["particle_loss"], each["particle_loss_limit"])
            blocks.append(Facts([("particles lose", loss)], name, detail=True))
        if each.get("warning"):
            warnings.append(f"{name}: {each['warning']}")
    blocks += [Text(NO_LIMITS)] if answer["leaves_out_limits"] else []
    texts = _scenarios(answer["shares"]) if answer["has_scenarios"] else []
    blocks += [*_table(proofs), *texts, *_meaning(proofs)]
    if answer["within_reached"] is False:
        blocks.append(
            Text(
                f"The limit of a found set is above {100 * (within or 0.0):g} % with "
                f"{answer['draws']:,} draws."
            )
        )
    drawn = f"on {answer['draws']:,} draws" if answer["particles"] else "exact"
    line = f"lower bound of {answer['run']}, {drawn}"
    return Page("", line, [Section("", blocks)], [*warnings, *_reasons(proofs)])


def _meaning(proofs: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    """Say what the bound is, and how far its likelihood was tested if it is not exact."""
    is_tested = any(each["bound_error"] for each in proofs.values())
    return [Text(f"{_MEANING} {_TESTED}" if is_tested else _MEANING, detail=True)]


def _table(proofs: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    rows = [_row(name, each) for name, each in proofs.items() if not each["reason"]]
    optional = _HEAD[:-4:-1]  # the parts
    return [Table("Lower bounds and gaps", _HEAD, rows, optional=optional)] if rows else []


def _scenarios(shares: Sequence[float]) -> list[Block]:
    """Say which filter the bound is of, and which mean of the scenarios."""
    listed = ", ".join(percent(share, 1) for share in shares)
    return [Text(_TOLD), *([Text(f"{_WORST}{listed}.")] if shares else [])]


def _reasons(proofs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    reasons = [(name, each["reason"]) for name, each in proofs.items()]
    return [f"Not proved for {name}: {reason}." for name, reason in reasons if reason]


def _row(name: str, proved: Mapping[str, Any]) -> list[Cell]:
    scale = proved["expected_mse"] or 1.0
    parts = [proved[key] / scale for key in ("relaxation", "estimate", "filter_model")]
    mse, limit = proved["expected_mse"], proved["gap_at_most"]
    return [
        Cell(name),
        Cell(with_error(mse, proved["expected_mse_error"]), mse),
        Cell(with_error(proved["bound"], proved["bound_error"]), proved["bound"]),
        Cell(percent(proved["gap"]), proved["gap"]),
        Cell("unknown" if limit is None else f"{rounded(100 * rounded_up(limit), 2)} %", limit),
        *(Cell(percent(part), part) for part in parts),
    ]
