"""The answer of a run: when to measure, what it gains, and how good it is."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pkgutil import resolve_name
from typing import Any

from pfdist.common.changes import change_of, effect, is_clear
from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.parts import (
    Block,
    Cell,
    Figures,
    Page,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.percent import (
    percent,
    percent_with_interval,
    relaxed_sentence,
)
from pfdist.common.plugins import added
from pfdist.common.rounding import with_error
from pfdist.errors import one_line, relative
from pfdist.filters.aspects import ErrorBeside
from pfdist.problem.added_sections import has_amounts, sections_of
from pfdist.problem.even_sets import has_even_sets
from pfdist.problem.set_key import phrase_of
from pfdist.questions.about_run import computed, made_by, problem, question, using
from pfdist.questions.bound_page import proof
from pfdist.questions.compared_page import (
    beside_given_sets,
    compared,
    criterion_effect,
    scenarios,
)
from pfdist.questions.methods_page import methods_section
from pfdist.questions.subject import (
    Subject,
    all_sets,
    as_good_text,
    number_of,
)
from pfdist.results import Run
from pfdist.results.columns import COLUMNS, CRITERIA_SHOWN, ERRORS_SHOWN, Row, sets_table
from pfdist.results.particle_loss import TOO_FEW
from pfdist.results.run import SHOWN
from pfdist.results.stored_run import (
    copies_of,
    evaluations_of,
    found_sets,
    killed_of,
    last_bounds,
    named_sets,
    problem_of,
    provenance_of,
    unproved,
)

_LOOKS_BETTER = (
    "on the same draws. Picking the best of several makes it look slightly better than it is."
)
_BY_EXACT_ERRORS = "by their expected MSEs, which are exact."
_CLEAR = 2.0  # standard errors of a difference, for a sentence without an interval
_GAINS_SHOWN = "label", ERRORS_SHOWN[0], "gain_of_means", *ERRORS_SHOWN[1:], *CRITERIA_SHOWN
_GAINS = (
    "The expected MSE is the mean over all draws, with its standard error. The next column is how "
    "much lower it is than that of the first row. Intervals in brackets are 95 % CIs."
)
_PAPERS: tuple[Any, ...] = "ungm", {}, {"horizon": 60, "measurement_budget": 21}, "regular"
_PAPER_PRINTS = (
    "The paper prints 27.7 % and 87.5 % (500 particles, 1,000 draws, 25 generations of 50 sets)."
)
_SEARCHES_HEAD = (
    "search", "method", "sets evaluated", COLUMNS["search_mse"].head, "against fresh draws", "why",
)  # fmt: skip
_SEARCHES = (
    "A search chooses the set with the lowest of many estimates, so its estimate of this set is "
    "usually too low."
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
    title, alone = "When to measure", _alone(run)
    of_plugins = *added("answers"), scenarios, proof, *added("chapters")
    chapters = alone or (answer, *of_plugins)
    if titles := [each.title for each in sections_of(run.job)]:
        (title, *_) = titles
    elif not run.job["search"]:
        title, chapters = "Which times are best", (compared, *chapters)
    warnings = _warnings(subject)
    if run.state != "finished":
        draws = number_of(run.draws_compared, "draw")
        unfinished = f"This run is not finished: {draws} are compared so far, and all results may "
        warnings.insert(0, f"{unfinished}change.")
    others = () if alone else (compared, gains)
    folded = [problem, *others, searches_section, computed, methods, using]
    last = _sections(subject, [make for make in folded if make not in chapters])
    sections = [*_sections(subject, chapters), *(replace(each, folded=True) for each in last)]
    title = f"{title}: {one_line(provenance_of(run)['name_of_model'])}"
    about = f"{question(subject)} {made_by(subject)}"
    return Page(title, about, sections, warnings, seconds, alarms=subject.alarms)


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
    usual = answer, compared, gains, scenarios, *added("answers")
    chapters = _alone(run) or usual
    place = (
        f"{run.path}: {run.state}, {evaluations_of(run):,} evaluations, "
        f"{run.draws_compared:,} draws compared"
    )
    more = [proof, searches_section, methods] if details else []
    sections = _sections(subject, (*chapters, *more))
    return Page("", "", sections, _warnings(subject), place=place, alarms=subject.alarms)


SHOWN.declare("answer", answer_of)


def _alone(run: Run) -> tuple[Chapter, ...]:
    """The one section of the answer that a plugin gives to its runs; none to others."""
    return tuple(resolve_name(each.chapter) for each in sections_of(run.job) if each.chapter)


def _sections(subject: Subject, chapters: Sequence[Chapter]) -> list[Section]:
    return [section for make in chapters if (section := make(subject)) is not None]


def _warnings(subject: Subject) -> list[str]:
    said = subject.by_error[0] if subject.lost else ""  # its loss comes first
    warnings = [
        f"{row.label}: {text}" for row in subject.rows.values() for text in row.warnings
        if not (row.name == said and TOO_FEW in text)
    ]  # fmt: skip
    # The last line in a terminal is the warning that nothing is proved.
    few_lines = provenance_of(subject.run).get("few_lines", "")
    last = [few_lines, unproved(subject.run)]
    return [*warnings, *(text for text in last if text and text not in subject.alarms)]


# --- the answer -----------------------------------------------------------------------------------


def answer(subject: Subject) -> Section | None:
    """The gain of the best set in sentences, and its times."""
    if not subject.found_rows:
        return None
    names = subject.by_error[:1] if subject.is_compared else [*subject.found_rows]
    blocks = [block for name in names for block in _answer(subject, subject.rows[name])]
    return Section("The answer", [*blocks, Figures(["system"])])


def _answer(subject: Subject, row: Row) -> Iterator[Block]:
    times = row.measurement_times
    problem = problem_of(subject.run)
    at = problem.by_parts(times) or f"{problem.when(times)}."
    most = problem.measurement_budget or 0
    if problem.feasible.has_fewer and len(times) < most:
        at += f" This uses {len(times)} of {most} measurements."
    if not subject.is_compared:
        estimate = with_error(row.search_mse, row.search_standard_error)
        yield Text(f"{row.label}: measure {at} The search estimated an error of {estimate}.")
        return
    yield Text(f"Measure {at}", prominent=True)
    sentences = [
        (_beating if row.beats_search else _gain)(subject, row),
        _as_good(subject, row), _proof(subject, row),
        # Plugins say nothing of another set.
        *([] if row.beats_search else [say(subject) for say in added("sentences")]),
        provenance_of(subject.run).get("on_the_way", ""),
    ]  # fmt: skip
    yield Text(" ".join(filter(None, sentences)), prominent=True)
    if subject.job_reference == REGULAR and not has_even_sets(problem.feasible):
        yield Text("No evenly spaced times include all required ones.")
    yield from (Text(each, prominent=True) for each in beside_given_sets(subject, row))
    yield from subject.notes
    for error in subject.beside:
        yield from _beside(subject, row, error)
    if (others := len(subject.found_rows) - 1) and not row.beats_search:
        best = f"This is {phrase_of(row.label)}, the best of {others + 1} plans"
        # The errors of worst scenarios are those of draws, whatever the engine.
        by_chance = row.standard_error or not subject.criterion.is_mean
        yield Text(f"{best} {_LOOKS_BETTER if by_chance else _BY_EXACT_ERRORS}")


def methods(subject: Subject) -> Section | None:
    """A paragraph about what was done and found, for a proposal or a paper."""
    if not subject.is_compared or has_amounts(subject.run.job):
        return None
    row, problem = subject.rows[subject.by_error[0]], problem_of(subject.run)
    times = row.measurement_times
    at = problem.by_parts(times) or f"{problem.when(times)}."
    proved = _proof(subject, row) or "Nothing was proved about other times."
    found = [(_beating if row.beats_search else _gain)(subject, row), proved]
    return methods_section(subject, row, at, found)


def _gain(subject: Subject, row: Row) -> str:
    reference = subject.reference_row
    if row.measurement_times == reference.measurement_times:
        are = "These are" if reference.name in (EVEN, REGULAR) else "This is"
        return f"{are} {phrase_of(reference.label)}, so planning gains nothing here."
    if row.gain_of_means is None or math.isinf(row.gain_of_means) or not row.gain_draws:
        return "The gain is not known, because errors are 0, infinite or unknown."
    interval = row.gain_of_means_low, row.gain_of_means_high
    if (said := criterion_effect(subject, row)) is not None:
        what = "mean over the scenarios" if subject.scenarios else "expected MSE"
        return f"{said} The {what} is {change_of(row.gain_of_means, interval)}."
    typical, change = subject.typical_errors(row, reference), change_of(row.gain_of_means, interval)
    if not typical:
        return f"{effect(row.gain_of_means, interval, subject.reference, subject.error)}."
    typical, said = f"the typical error is {typical}", f"{subject.error} is {change}."
    if is_clear(interval):
        return f"T{typical[1:]} with {subject.reference}: {said}"
    return f"No clear difference from {subject.reference}: {typical}, and {said}"


def _beating(subject: Subject, row: Row) -> str:
    """That a set is clearly better than those of the searches: it was chosen, so it has no gain."""
    found = min(subject.found_rows.values(), key=lambda each: float(each.expected_mse))
    label, mse = subject.criterion.label, COLUMNS["expected_mse"]
    listed = problem_of(subject.run).clock.listed(found.measurement_times)
    are, who = "This is", phrase_of(row.label)
    if row.name in (EVEN, REGULAR):
        are, who = "These are", subject.reference.partition(" (t = ")[0]
    several = len(subject.found_rows) > 1
    searches, own = ("searches", "their best set") if several else ("search", "its set")
    return (
        f"{are} {who}: the {searches} found nothing better. The {label} is "
        f"{mse.cell(row).text}; with {own} (t = {listed}) it is {mse.cell(found).text}."
    )


def _beside(subject: Subject, row: Row, error: ErrorBeside) -> Iterator[Text]:
    """An error beside that of the job, with a set and, if it is another one, the reference."""
    mse, reference = COLUMNS[error.mse], subject.reference_row
    own, of_reference = (getattr(each, mse.name) for each in (row, reference))
    if not all(each is not None and math.isfinite(each) for each in (own, of_reference)):
        return
    limit, label = "at most " * subject.is_limit(error), subject.criterion.mse_criterion.label
    differs = row.measurement_times != reference.measurement_times
    # The reference is the best of its kind for the job's own estimate, not for this one.
    beside = f" ({reference.label}, as above: {mse.cell(reference).text})" * differs
    said = f"the {label} is {limit}{mse.cell(row).text}{beside}."
    if not error.planned or subject.criterion.aspects:
        yield Text(f"{error.when}, {said}")
        return
    both = [getattr(each, mse.error) for each in (row, reference)]
    is_gain = None not in both and of_reference - own > _CLEAR * math.hypot(*both)
    nothing = f"these times gain nothing clear over {phrase_of(reference.label)}: "
    yield Text(f"{error.alone}, {nothing * (differs and not is_gain)}{said} {error.planned}")


def _as_good(subject: Subject, row: Row) -> str:
    """How many evenly spaced measurements do as well, by a quick estimate."""
    if not row.evenly_spaced or row.evenly_spaced == row.measurements:
        return ""
    if row.measurement_times == subject.reference_row.measurement_times:  # they say it already
        return ""
    judged = subject.run.table("evenly_spaced").set_index("measurements")["draws"]
    draws = int(judged[row.evenly_spaced])
    estimated = f" (quick estimate on {draws:,} of these draws)" * bool(draws)
    return f"{as_good_text(row)}{estimated}."


def _proof(subject: Subject, row: Row) -> str:
    proof = last_bounds(subject.run).get(row.name)
    if proof is None or proof["reason"]:
        return ""
    problem = problem_of(subject.run)
    sentence = subject.criterion.proof_sentence(
        proof,
        row.measurements,
        has_fewer=problem.feasible.has_fewer,
        is_constrained=problem.is_constrained,
        has_scenarios=bool(subject.scenarios),
    )
    relaxed = problem.feasible.relaxed if "further" in sentence else ()
    return f"{sentence} {relaxed_sentence(relaxed)}".rstrip()


# --- all sets -------------------------------------------------------------------------------------


def gains(subject: Subject) -> Section | None:
    """The expected error of each set and its gains, on the same draws."""
    if not subject.is_compared:
        return None
    draws = number_of(subject.run.draws_compared, "draw")
    fresh = " that took no part in the search" if found_sets(subject.run) else ""
    caption = f"Expected MSE{subject.of_the_estimate} on {draws}{fresh}"
    sets = subject.distinct.values()
    is_said = len(sets) <= 2 and len(subject.found_rows) == 1  # the answer says the table
    table = sets_table(caption, sets, _GAINS_SHOWN, heads=subject.heads, detail=is_said)
    said: list[Block] = [table, *_papers_gains(subject), Text(_GAINS, detail=True)]
    blocks: list[Block] = [
        *([] if named_sets(subject.run) else said),  # else the comparison of the sets says it
        *_degenerate(subject),
        *_broken(subject),
        Figures(["gain"], subject.shown[:1], detail=True),
        all_sets(subject),
    ]
    return Section("All sets", blocks)


def _papers_gains(subject: Subject) -> Iterator[Text]:
    """The gain that the paper prints, where a run repeats the paper's experiment."""
    job = subject.run.job
    model = job["model"]
    experiment = model["name"], model["parameters"], job["problem"], job["comparison"]["reference"]
    if experiment != _PAPERS:
        return
    for search in job["search"]:
        if search["method"] == "genetic" and (row := subject.rows.get(search["name"])):
            ends = [row.mean_relative_gain_low, row.mean_relative_gain_high]
            gain = percent_with_interval(row.mean_relative_gain, ends)
            yield Text(
                f"The mean relative gain of {phrase_of(row.label)} is {gain}; "
                f"{percent(row.positive_fraction, 1)} of the draws gain. {_PAPER_PRINTS}"
            )


def _degenerate(subject: Subject) -> list[Text]:
    counts = [
        f"{number_of(row.degenerate_draws, 'draw')} of {row.label}"
        for row in subject.rows.values()
        if row.degenerate_draws
    ]
    text = "There the filter leaves out measurements that no particle explains."
    return [Text(f"Degenerate: {', '.join(counts)}. {text}")] if counts else []


def _broken(subject: Subject) -> Iterator[Text]:
    problem = problem_of(subject.run)
    is_exact = problem.feasible.counted and not has_amounts(subject.run.job)
    budget = (problem.measurement_budget or 0) * is_exact
    for name, row in subject.rows.items():
        times = f"The set {row.label}" if name in subject.others else "The reference"
        if row.measurements < budget:
            number = row.measurements
            yield Text(
                f"{times} has {number} of {budget} measurements. `pfdist plan JOB --against "
                f"{row.name}=TIMES` finds the best {number}, and the best evenly spaced ones."
            )
        for constraint in row.broken_constraints:
            yield Text(f"{times} breaks a constraint, and is compared all the same: {constraint}.")


# --- the searches ---------------------------------------------------------------------------------


def searches_section(subject: Subject) -> Section | None:
    """The method of each search, how many sets it evaluated, and how it estimated its set."""
    job, copies = subject.run.job["search"], copies_of(subject.run)
    if not copies:
        return None
    rows = [_search_row(subject, search, sum(copies.get(search["name"], ()))) for search in job]
    table = Table(
        "Searches", _SEARCHES_HEAD, rows, detail=True,
        optional=[_SEARCHES_HEAD[1], _SEARCHES_HEAD[5]],
    )  # fmt: skip
    killed = [
        Text(f"{name}: {n:,} evaluated sets had an infinite error, by degenerate draws.")
        for name, n in killed_of(subject.run).items()
    ]
    blocks: list[Block] = [
        without_empty_columns(table),
        *killed,
        Text(_SEARCHES, detail=True),
        Figures(["searches"]),
    ]
    return Section("How the times were found", blocks)


def _search_row(subject: Subject, search: Mapping[str, Any], count: int) -> list[Cell]:
    name, method = str(search["name"]), str(search["method"])
    # Not above: the methods load Numba, and the answer alone has no section of searches.
    from pfdist.problem.methods import METHODS  # noqa: PLC0415

    about = METHODS[method].description if method in METHODS else method
    cells = [Cell(name), Cell(about.rstrip(".")), Cell(f"{count:,}", count)]
    row = subject.found_rows.get(name)
    if row is None:
        return [*cells, Cell(""), Cell(""), Cell("")]
    cells.append(COLUMNS["search_mse"].cell(row))
    reasons = filter(None, [row.search_cause, row.search_settings])
    path, excess = subject.run.path, row.search_excess
    if excess is None:
        return [*cells, Cell(""), Cell("")]
    why = "; ".join(reasons).replace(relative(str(path)), path.name)  # the report may be sent
    side = "below" if excess < 0 else "above"
    return [*cells, Cell(f"{percent(abs(excess), 1)} {side}", excess), Cell(why)]
