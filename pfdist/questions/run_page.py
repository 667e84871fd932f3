"""The answer of a run: when to measure, what it gains, and how good it is."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from pfdist.common.parts import (
    Block,
    Cell,
    Facts,
    Figures,
    Page,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.percent import (
    NO_LIMITS,
    gap_sentence,
    heavy_tail_warning,
    particle_loss_text,
    percent,
    percent_with_interval,
    range_of,
)
from pfdist.common.rounding import with_error, with_interval
from pfdist.errors import relative
from pfdist.questions.about_run import citation, computed, problem, tables
from pfdist.questions.bound_page import proof
from pfdist.questions.budget_page import budget
from pfdist.questions.compare_page import compared
from pfdist.questions.online_page import online, online_sentence
from pfdist.questions.robust import THE_WORST, scenarios, worst_effect
from pfdist.questions.subject import (
    ERROR_HEAD,
    Subject,
    effect,
    exact_effect,
    mse_cell,
    number_of,
    percent_cell,
    sets_table,
)
from pfdist.questions.why_page import worth
from pfdist.results import Run
from pfdist.results.stored_run import copies_of, found_sets, killed_of, problem_of
from pfdist.results.summary import SetResult

_LOOKS_BETTER = (
    "on the same draws. The best of several sets looks better than it is, the more so the more "
    "sets there are."
)
_BY_EXACT_ERRORS = "by their expected errors, which are known exactly."
_MEASURED = (
    "This gain is an average over simulated draws: the tables do not hold the exact error of the "
    "times compared with. `pfdist bound` computes it."
)
_GAINS_HEAD = (
    "times", ERROR_HEAD, "lower by, %", "draws with a lower error, %", "mean gain, %",
)  # fmt: skip
_GAINS = (
    "The expected error is the mean over all draws, with its standard error. The next column says "
    "how much lower it is than that of the first row. The mean gain is the mean of the relative "
    "gains of single draws, the paper's figure. Intervals in brackets hold with 95 %."
)
_WHY_GAINS_DISAGREE = (
    " A mean relative gain weighs all draws alike and has no lower limit, while the gain in the "
    'column "lower by" weighs each draw by its error.'
)
_PAPERS: tuple[Any, ...] = "ungm", {}, {"horizon": 60, "measurement_budget": 21}, "regular"
_PAPER_PRINTS = (
    " The paper prints 27.7 % and 87.5 % (500 particles, 1,000 draws, 25 generations of 50 sets)."
)
_SEARCHES_HEAD = (
    "search", "method", "sets evaluated", "error it believed ± standard error",
    "against fresh draws", "why",
)  # fmt: skip
_SEARCHES = (
    "A search chooses the set with the least of many estimated errors, so what it believes of this "
    "set is usually too good: below its error on fresh draws, which the table of gains has."
)
_EXACT_SEARCHES = (
    "The filter is exact, so each search knew the expected error of its set. The errors above are "
    "averages over simulated draws, and differ from it by chance."
)


Chapter = Callable[[Subject], Section | None]


def page_of(run: Run, seconds: int = 0, target: float | None = None) -> Page:
    """The report of a run, with its figures and how it was computed.

    Parameters
    ----------
    run : Run
        Finished or not.
    seconds : int
        After so many seconds the page reloads itself; 0 for never.
    target : float, optional
        An expected MSE: how many measurements reach it.
    """
    subject = Subject(run, target=target)
    chapters: Sequence[Chapter] = (
        answer, scenarios, compared, problem, gains, proof, worth, online,
    )  # fmt: skip
    if "budget" in run.job:
        chapters = (budget, problem)
    warnings = _warnings(subject)
    if run.state != "finished":
        draws = number_of(run.draws_compared, "draw")
        unfinished = f"This run is not finished. So far {draws} are compared, and all figures may "
        warnings.insert(0, f"{unfinished}change.")
    ending = (searches, computed, tables, citation)
    sections = _sections(subject, (*chapters, *ending))
    title = f"When to measure: {subject.model_name}"
    return Page(title, f"Run {run.path.name}", sections, warnings, seconds)


def answer_of(run: Run, target: float | None = None, *, details: bool = False) -> Page:
    """The answer of a run, without figures.

    Parameters
    ----------
    run : Run
        Finished or not.
    target : float, optional
        An expected MSE: how many measurements reach it.
    details : bool
        Whether the proof and the searches are described, too.
    """
    subject = Subject(run, target=target)
    chapters: Sequence[Chapter] = (answer, gains, scenarios, compared, online)
    if "budget" in run.job:
        chapters = (budget,)
    summary = subject.summary
    line = (
        f"{summary.run}: {summary.state}, {summary.evaluations:,} evaluations, "
        f"{summary.draws_compared:,} draws compared"
    )
    sections = _sections(subject, (*chapters, *([proof, searches] if details else [])))
    return Page("", line, sections, _warnings(subject))


def answer_in_a_line(run: Run) -> str:
    """The gain of the best times, and these times; empty if the run has none yet."""
    subject = Subject(run)
    section = budget(subject) if "budget" in run.job else answer(subject)
    texts = [block for block in section.blocks if isinstance(block, Text)] if section else []
    return " ".join(block.text for block in texts if block.prominent or "budget" not in run.job)


def _sections(subject: Subject, chapters: Sequence[Chapter]) -> list[Section]:
    return [section for make in chapters if (section := make(subject)) is not None]


def _warnings(subject: Subject) -> list[str]:
    warnings = [
        f"{times}: {warning}"
        for times, result in subject.results.items()
        for warning in result.warnings
    ]
    shares = {name: each.top_percent_share for name, each in subject.results.items()}
    heavy_tail = heavy_tail_warning(shares)
    unproved = subject.summary.unproved  # in a terminal the last sentence
    return [*warnings, *filter(None, [heavy_tail and f"{heavy_tail}.", unproved])]


# --- the answer -----------------------------------------------------------------------------------


def answer(subject: Subject) -> Section | None:
    """The gain of the best set in sentences, and its times."""
    if not subject.found_results:
        return None
    names = subject.summary.by_error[:1] if subject.is_compared else [*subject.found_results]
    blocks = [block for name in names for block in _answer(subject, name)]
    return Section("The answer", [*blocks, Figures(["times"])])


def _answer(subject: Subject, name: str) -> Iterator[Block]:
    result = subject.found_results[name]
    times = result.measurement_times
    if subject.is_compared:
        sentences = [_gain(subject, name), _proof(subject, result), online_sentence(subject)]
        yield Text(" ".join(filter(None, sentences)), prominent=True)
        others = len(subject.found_results) - 1
        if others:
            best = f"These are the times of the search {name}, the best of {others + 1} sets"
            yield Text(f"{best} {_BY_EXACT_ERRORS if subject.summary.is_exact else _LOOKS_BETTER}")
    at = f"{'t = ' if times else 'no time'}{subject.listed(times)}"
    if subject.is_compared:
        yield Text(f"Measure at {at}.")
    else:
        believed = with_error(result.search_cost, result.search_standard_error)
        yield Text(f"{name}: measure at {at}. The search believed an expected error of {believed}.")


def _gain(subject: Subject, name: str) -> str:
    result = subject.found_results[name]
    gain, positive = result.gain_of_means, result.positive_fraction
    times = result.measurement_times
    if times == subject.reference_times:
        return "The search found no better times than the reference's own."
    at = {0: "no time", 1: "this time"}.get(len(times), f"these {len(times):,} times")
    these = f"Measuring at {at} instead of {subject.reference}"
    if gain is None or positive is None:
        return f"{these}: the gain is not known, because errors are 0, infinite or unknown."
    share = f"{percent(positive, 0)} of {number_of(result.gain_draws or 0, 'draw')}"
    reference = next(iter(subject.results.values())).exact_mse
    if result.exact_mse is not None and reference:
        what = THE_WORST if subject.summary.is_worst else "the expected error"
        lowers = exact_effect(result.exact_mse, reference, what)
        return f"{these} {lowers}. In {share}, the error is lower."
    if (worst := worst_effect(subject, name)) is not None:
        mean, _ = effect(gain, result.gain_of_means_interval, "the mean over the scenarios")
        return f"{these} {worst} It {mean}."
    lowers, left_open = effect(gain, result.gain_of_means_interval)
    measured = _MEASURED if subject.summary.is_exact else ""
    sentences = (f"{these} {lowers}.", measured, f"In {share}, the error is lower.", left_open)
    return " ".join(filter(None, sentences))


def _proof(subject: Subject, result: SetResult) -> str:
    proof = result.lower_bound
    if proof is None or proof["reason"]:
        return ""
    constrained = subject.summary.is_constrained
    sentence = gap_sentence(
        proof,
        len(result.measurement_times),
        is_constrained=constrained,
        has_scenarios=bool(subject.summary.scenarios),
    )
    return f"{sentence} {NO_LIMITS}" if problem_of(subject.run).feasible.limits else sentence


# --- all sets -------------------------------------------------------------------------------------


def gains(subject: Subject) -> Section | None:
    """The expected error of each set and its gains, on the same draws."""
    if not subject.is_compared:
        return None
    rows = [_gains_row(name, result) for name, result in subject.results.items()]
    draws = number_of(subject.summary.draws_compared, "draw")
    fresh = " that took no part in the search" if found_sets(subject.run) else ""
    table = Table(
        f"Expected error on {draws}{fresh}", _GAINS_HEAD, rows,
        optional=[_GAINS_HEAD[-1], _GAINS_HEAD[-2]],
    )  # fmt: skip
    blocks: list[Block] = [
        table,
        *_relative_gains(subject),
        Text(_GAINS, detail=True),
        *_degenerate(subject),
        *_broken(subject),
        Figures(["gain", "draw"], subject.shown),
        *subject.about_others,
        sets_table(subject),
        *(_details(subject, name) for name in subject.results),
    ]
    return Section("What the times gain", blocks)


def _relative_gains(subject: Subject) -> Iterator[Text]:
    """The paper's figures of its search, and why they contradict the gain of means of any set."""
    job, noise = subject.run.job, next(iter(subject.results.values())).gain_over_itself
    model, papers = (
        job["model"],
        {e["name"] for e in job.get("search", ()) if e["method"] == "genetic"},
    )
    experiment = model["name"], model["parameters"], job["problem"], job["comparison"]["reference"]
    for name, result in subject.results.items():
        if name not in papers and not result.gains_disagree:
            continue
        gain = percent_with_interval(result.mean_relative_gain, result.mean_relative_gain_interval)
        share = percent(result.positive_fraction, 1)
        text = f"The mean relative gain of {name} is {gain}, and {share} of the draws gain."
        if name in papers and experiment == _PAPERS:
            text += _PAPER_PRINTS
        if result.gains_disagree:
            text += _WHY_GAINS_DISAGREE
            if noise:
                text += f" The noise of the filters alone gives a mean of {percent(noise)}."
        yield Text(text)


def _gains_row(name: str, result: SetResult) -> list[Cell]:
    cells = [Cell(name), mse_cell(result.expected_mse, result.standard_error)]
    for gain in ("gain_of_means", "positive_fraction", "mean_relative_gain"):
        is_reference, interval = result.gain_draws is None, getattr(result, f"{gain}_interval")
        cells.append(Cell("") if is_reference else percent_cell(getattr(result, gain), interval))
    return cells


def _degenerate(subject: Subject) -> list[Text]:
    counts = [
        f"{number_of(result.degenerate_draws, 'draw')} of {name}"
        for name, result in subject.results.items()
        if result.degenerate_draws
    ]
    text = "there the filter leaves out measurements that no particle explains"
    return [Text(f"Degenerate: {', '.join(counts)}; {text}.")] if counts else []


def _broken(subject: Subject) -> Iterator[Text]:
    for name, result in subject.results.items():
        times = f"The times of {name} break" if name in subject.others else "The reference breaks"
        for constraint in result.broken_constraints:
            yield Text(f"{times} a constraint of the job. {constraint}.")


def _details(subject: Subject, name: str) -> Facts:
    """Everything else that the comparison says of a set."""
    result = subject.results[name]
    facts = list[tuple[str, str]]()
    if result.description:
        facts.append(("what it is", result.description))
    if result.particle_loss is not None and result.particle_loss_limit is not None:
        loss = particle_loss_text(result.particle_loss, result.particle_loss_limit)
        facts.append(("particles lose", loss))
    if result.gain_draws is not None:
        interval = result.mean_relative_gain_interval
        gain = percent_with_interval(result.mean_relative_gain, interval)
        facts.append(("mean relative gain", gain))
        shares = [result.quantiles.get(share) for share in ("0.25", "0.5", "0.75")]
        facts.append(("quartiles of gains", ", ".join(percent(share, 1) for share in shares)))
        log10, *ends = with_interval(result.mean_log10_ratio, *result.mean_log10_ratio_interval)
        facts.append(("mean log10 of ratio", f"{log10}  (95 %: {range_of(*ends)})"))
    if result.gain_over_itself_draws is not None:
        interval = result.gain_over_itself_interval
        itself = percent_with_interval(result.gain_over_itself, interval)
        facts.append(("gain over itself", f"{itself}, from filter noise alone"))
    return Facts(facts, f"More about {name}", detail=True)


# --- the searches ---------------------------------------------------------------------------------


def searches(subject: Subject) -> Section | None:
    """The method of each search, how many sets it evaluated, and what it believed of its set."""
    job, copies = subject.run.job["search"], copies_of(subject.run)
    if not copies:
        return None
    rows = [_search_row(subject, search, sum(copies.get(search["name"], ()))) for search in job]
    meaning = Text(_EXACT_SEARCHES if subject.summary.is_exact else _SEARCHES, detail=True)
    table = Table(
        "Searches", _SEARCHES_HEAD, rows, detail=True,
        optional=[_SEARCHES_HEAD[1], _SEARCHES_HEAD[5]],
    )  # fmt: skip
    killed = [
        Text(f"Degenerate draws killed {n:,} evaluated sets of {name}.")
        for name, n in killed_of(subject.run).items()
    ]
    blocks: list[Block] = [without_empty_columns(table), *killed, meaning, Figures(["cost"])]
    return Section("How the times were found", blocks)


def _search_row(subject: Subject, search: Mapping[str, Any], count: int) -> list[Cell]:
    name, method = str(search["name"]), str(search["method"])
    # Not above: the methods load Numba, and the answer alone has no section of searches.
    from pfdist.problem.methods import METHODS  # noqa: PLC0415

    about = METHODS[method].description if method in METHODS else method
    cells = [Cell(name), Cell(about.rstrip(".")), Cell(f"{count:,}", count)]
    result = subject.results.get(name)
    if result is None or not result.is_found:
        return [*cells, Cell(""), Cell(""), Cell("")]
    believed = with_error(result.search_cost, result.search_standard_error)
    cells.append(Cell(believed, result.search_cost))
    if subject.summary.is_exact:
        return [*cells, Cell(""), Cell("exact")]
    excess = result.search_excess
    settings = ", ".join(f"{key} = {value}" for key, value in result.search_estimation.items())
    reasons = [result.search_distrust, result.search_cause, settings]
    why = "; ".join(filter(None, reasons)) if excess is not None else ""
    path = subject.run.path
    why = why.replace(relative(str(path)), path.name)  # the report may be sent
    side = "below" if (excess or 0.0) < 0 else "above"
    against = "" if excess is None else f"{percent(abs(excess), 1)} {side}"
    return [*cells, Cell(against, excess), Cell(why)]
