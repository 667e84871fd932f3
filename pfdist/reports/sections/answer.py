"""The answer: what the found times gain, how good they are, and when to measure."""

from typing import Any

from pfdist.common.gap_sentence import gap_sentence
from pfdist.common.percent import percent
from pfdist.reports.parts import Block, Section, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject, effect, exact_effect, number_of

_LOOKS_BETTER = (
    "on the same draws. The best of several sets looks better than it is, the more so the more "
    "sets there are."
)
_MEASURED = (
    "This gain is an average over simulated draws: the tables do not hold the exact error of the "
    "times compared with. `pfdist bound` computes it."
)
_KNOWN = "by their expected errors, which are known exactly."


def answer(subject: Subject) -> Section | None:
    """Give the answer of a run in sentences, and the times on an axis."""
    if not subject.found:
        return None
    blocks: list[Block] = []
    for name in [subject.best] if subject.is_compared else subject.found:
        blocks += _blocks(subject, name)
    return Section("The answer", [*blocks, *pictures(subject.tables, ["times"])])


def _blocks(subject: Subject, name: str) -> list[Block]:
    result = subject.found[name]
    times = result["measurement_times"]
    blocks: list[Block] = []
    if subject.is_compared:
        sentences = [_gain(subject, result), _proof(subject, result), _online(subject)]
        blocks.append(Text(" ".join(filter(None, sentences)), prominent=True))
        others = len(subject.found) - 1
        if others:
            best = f"These are the times of the search {name}, the best of {others + 1} sets"
            known = _KNOWN if subject.is_exact else _LOOKS_BETTER
            blocks.append(Text(f"{best} {known}"))
    blocks.append(Text(f"Measure at {'t = ' if times else 'no time'}{subject.listed(times)}."))
    return blocks


def _gain(subject: Subject, result: dict[str, Any]) -> str:
    gain, positive = result.get("gain_of_means"), result.get("positive_fraction")
    times = result["measurement_times"]
    if times == subject.reference_times:
        return "The search found no better times than the reference's own."
    at = {0: "no time", 1: "this time"}.get(len(times), f"these {len(times):,} times")
    these = f"Measuring at {at} instead of {subject.reference}"
    if gain is None or positive is None:
        return f"{these}: the gain is not known, because errors are 0, infinite or unknown."
    share = f"{percent(positive, 0)} of {number_of(result['gain_draws'], 'draw')}"
    if result.get("exact_gain") is not None:
        reference = next(iter(subject.results.values()))["exact_mse"]
        told = exact_effect(result["exact_mse"], reference)
        return f"{these} {told}. In {share}, the error is lower."
    told, left_open = effect(gain, result["gain_of_means_interval"])
    measured = _MEASURED if subject.is_exact else ""
    sentences = (f"{these} {told}.", measured, f"In {share}, the error is lower.", left_open)
    return " ".join(filter(None, sentences))


def _proof(subject: Subject, result: dict[str, Any]) -> str:
    proof = result.get("lower_bound")
    if proof is None or proof["reason"]:
        return ""
    constrained = subject.summary["is_constrained"]
    return gap_sentence(proof, len(result["measurement_times"]), is_constrained=constrained)


def _online(subject: Subject) -> str:
    plan = subject.summary.get("online", {}).get("plan", {})
    gain = plan.get("gain_of_means")
    if gain is None:
        return ""
    told, left_open = effect(gain, plan["gain_of_means_interval"])
    return (
        f"Choosing each time only when the last measurement is known {told}, compared with the "
        f"times of {plan['name']}. {left_open}"
    ).rstrip()
