"""How much lower the error of other times can be: the lower bound and the parts of the gap."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.common.measurement_times import REGULAR
from pfdist.common.parts import Block, Cell, Facts, Figures, Page, Section, Table, Text
from pfdist.common.percent import (
    particle_loss_text,
    percent,
    relaxed_sentence,
    rounded_up,
)
from pfdist.common.rounding import rounded, with_error
from pfdist.filters.criterion import MEAN, Criterion
from pfdist.problem.sections import EVENLY_SPACED
from pfdist.problem.set_key import PLAN, phrase_of
from pfdist.questions.subject import ERROR_HEAD, Subject
from pfdist.results.stored_run import last_bounds

_HOLDS = (
    "No allowed times of the same number, or of the same total price, have a lower expected MSE "
    "than the lower bound, with any filter, if the model is right. The bound is that of an easier "
    "problem: the filter gets some measurements in addition to those of the budget."
)
_MEANING = (
    "The gap is how much lower the expected MSE can be at most. It is the sum of its parts: the "
    "slack of the proof and chance, too few particles, and a wrong model of the filter. It is "
    "computed draw by draw, so it is more precise than the difference of the two columns."
)
_TESTED = (
    "The bound needs the right log-likelihood. Two tests found no fault in it: that of "
    "check-model, and the rank of the truth among the particles. With 480 draws they find a "
    "sensor's standard deviation that is 20 % wrong in more than 9 of 10 cases."
)
_TOLD = (
    "The lower bound is that of a filter with the parameters of each draw's scenario. It has more "
    "information than any real filter, so the bound holds for all filters."
)
_WORST = (
    "The error is that of the worst {0}. The lower bound is one of a mean of the {0}s: the worst "
    "error of any times is at least this mean, whose shares make the bound largest. Even the best "
    "times may lie above it (a duality gap)."
)
_HEAD = (
    "times", ERROR_HEAD, "lower bound ± standard error", "gap, estimated", "gap, at most",
    "slack of the proof", "too few particles", "wrong filter model",
)  # fmt: skip


def proof(subject: Subject) -> Section | None:
    """The lower bound of each set but the reference, or why there is none."""
    last = last_bounds(subject.run)
    proofs = {name: last[name] for name in subject.others if name in last}
    if not proofs:
        return None
    title = "How much better can other times be?"
    if subject.criterion.proof:
        return Section(title, [Text(subject.criterion.proof, detail=True)])
    shares = next(iter(proofs.values())).get("shares") or ()
    texts = _weights(shares, subject.criterion, has_scenarios=bool(subject.scenarios))
    table = _table(proofs, subject.run.labels, detail=True)
    blocks = [Text(_HOLDS), Figures(["bound"]), *table, *texts, *_meaning(proofs)]
    return Section(title, blocks)


def bound_page(
    answer: Mapping[str, Any],
    labels: Mapping[str, str],
    within: float | None = None,
    criterion: Criterion = MEAN,
) -> Page:
    """The answer of `pfdist.bound`.

    Parameters
    ----------
    answer : mapping
        The result of `pfdist.questions.bound.Bound.as_json`.
    labels : mapping of str to str
        The label of each set, by its name.
    within : float, optional
        The demanded limit of the gaps.
    criterion : Criterion, optional
        That of the bound.
    """
    proofs, common = answer["sets"], {"confidence": answer["confidence"]}
    constrained = answer["is_constrained"]
    blocks, warnings = list[Block](), list[str]()
    # The recommended set comes first, and other sets before the reference.
    in_turn = [*reversed(proofs)]
    in_turn.sort(key=lambda name: name != answer["plan"])
    for name in in_turn:
        each, label, is_first = proofs[name], labels[name], name == answer["plan"]
        number = len(each["measurement_times"])
        if not each["reason"] and (is_first or label not in (EVENLY_SPACED, REGULAR)):
            sentence = criterion.proof_sentence(
                each | common,
                number,
                has_fewer=answer["has_fewer"],
                is_constrained=constrained,
                has_scenarios=answer["has_scenarios"],
            )
            who = "the set of the search" if label == PLAN else phrase_of(label)
            start = "" if is_first and label == PLAN else f"For {who}: "
            is_detail = not is_first and PLAN in labels.values()
            blocks.append(Text(f"{start}{sentence}", prominent=not is_detail, detail=is_detail))
        if each.get("particle_loss_limit") is not None:
            loss = particle_loss_text(each["particle_loss"], each["particle_loss_limit"])
            blocks.append(Facts([("particles lose", loss)], label, detail=True))
        if each.get("warning"):
            warnings.append(f"{label}: {each['warning']}")
    blocks += [Text(said)] if (said := relaxed_sentence(answer["relaxed"])) else []
    texts = _weights(answer["shares"], criterion, has_scenarios=answer["has_scenarios"])
    if criterion.proof:
        blocks.append(Text(criterion.proof, detail=True))
    else:
        blocks += [*_table(proofs, labels), *texts, Text(_HOLDS, detail=True), *_meaning(proofs)]
    if answer["within_reached"] is False:
        limit = f"{100 * (within or 0.0):g} %"
        blocks.append(Text(f"Not all limits are at most {limit} with {answer['draws']:,} draws."))
    reasons = [
        f"Not proved for {phrase_of(labels[name])}: {each['reason']}."
        for name, each in proofs.items()
        if each["reason"]
    ]
    drawn = f"on {answer['draws']:,} draws" if answer["particles"] else "exact"
    line = f"{answer['run']}: {'upper' if criterion.sign < 0 else 'lower'} bound, {drawn}"
    return Page("", "", [Section("", blocks)], [*warnings, *reasons], place=line)


def _meaning(proofs: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    """The meaning of the bound, and the tests of its likelihood if it is not exact."""
    is_tested = any(each["bound_error"] for each in proofs.values())
    return [Text(f"{_MEANING} {_TESTED}" if is_tested else _MEANING, detail=True)]


def _table(
    proofs: Mapping[str, Mapping[str, Any]], labels: Mapping[str, str], *, detail: bool = False
) -> list[Block]:
    rows = [_row(labels[name], each) for name, each in proofs.items() if not each["reason"]]
    optional = _HEAD[:-4:-1]  # the parts
    return [Table("Lower bounds and gaps", _HEAD, rows, detail, optional)] if rows else []


def _weights(shares: Sequence[float], criterion: Criterion, *, has_scenarios: bool) -> list[Block]:
    """The filter whose bound it is, and the shares of scenarios or instants in its mean."""
    texts = [_TOLD] * has_scenarios
    if shares:
        texts.append(_WORST.format("instant" if criterion.by_instant else "scenario"))
    if shares and not criterion.by_instant:
        texts.append(f"Their shares: {', '.join(percent(share, 1) for share in shares)}.")
    return [Text(" ".join(texts))] if texts else []


def _row(label: str, proved: Mapping[str, Any]) -> list[Cell]:
    scale = proved["expected_mse"] or 1.0
    parts = [proved[key] / scale for key in ("relaxation", "estimate", "filter_model")]
    mse, limit = proved["expected_mse"], proved["gap_at_most"]
    return [
        Cell(label),
        Cell(with_error(mse, proved["expected_mse_error"]), mse),
        Cell(with_error(proved["bound"], proved["bound_error"]), proved["bound"]),
        Cell(percent(proved["gap"]), proved["gap"]),
        Cell("unknown" if limit is None else f"{rounded(100 * rounded_up(limit), 2)} %", limit),
        *(Cell(percent(part), part) for part in parts),
    ]
