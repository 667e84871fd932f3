"""The answer of a backtest in words: a verdict for each reference, errors of sets, a report."""

import math
from collections.abc import Iterator

import pfdist
from pfdist.common.calendar import unit_of_spans
from pfdist.common.formatted_times import formatted_time, formatted_times
from pfdist.common.parts import Cell, Facts, Page, Section, Table, Text
from pfdist.common.rounding import rounded, with_interval
from pfdist.filters.filter_estimate import few_particles
from pfdist.questions.backtest import CENTRED, FROM_START, Backtest
from pfdist.questions.subject import change_of, number_of
from pfdist.results.promise import KEPT, NOT_DECIDED, NOT_KEPT, NOTHING_FORESEEN, Promise

_WORST_FIRST = (NOT_KEPT, NOT_DECIDED, NOTHING_FORESEEN, KEPT)
_MUCH = 1000.0  # the end of an interval that says nothing
_FAR_TOO_MANY = 100  # times as many replicates as there are
_DEPENDENT = 0.3  # lag-1 correlation of differences
_MEANING = (
    "Errors are squared errors of the filter's prediction, divided by the variance of what is "
    "judged. A promise is kept if at least half of the foreseen difference of the errors is found, "
    "with 95 % confidence, and not kept if clearly less is found."
)
_VERDICTS = ("against", "foreseen gain", "found gain", "found / foreseen", "promise")
_SETS = (
    "times", "error", "foreseen", "error / foreseen", "in 90 % interval", "error without noise",
    "foreseen without noise",
)  # fmt: skip


def answer_of(answer: Backtest) -> Page:
    """The answer of a terminal: a sentence for each reference, and two tables."""
    section = Section("", [Text(_headline(answer), prominent=True), _verdicts(answer),
                           _sets(answer), Facts(_facts(answer))])  # fmt: skip
    place = ""
    if answer.files:
        kind = "Report" if answer.files[-1].suffix == ".html" else "Figure"
        place = f"{kind}: {answer.files[-1]}"
    return Page("", "", [section], [*_warnings(answer)], place=place, alarms=_alarms(answer))


def report_of(answer: Backtest) -> Page:
    """The report: the verdict, the errors by replicate, and some replicates in full."""
    # Not above: answers without pictures wait for no Matplotlib.
    from pfdist.pages.backtested import by_replicate, in_full  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    errors = by_replicate(answer.table, answer.sets)
    full = in_full(answer.shown, answer.quantities[0], answer.time_unit)
    sections = [
        Section("The verdict", [Text(_headline(answer), prominent=True), _verdicts(answer),
                                Text(_MEANING)]),
        Section("By replicate", [picture(errors, "replicates", "Real error against the error that "
                                         "the model foresaw, for each replicate.")]),
        Section("Is the model right?", [_sets(answer), Facts(_facts(answer))]),
        Section("Some replicates in full", [picture(full, "full", "Measurements, and the filter's "
                                                    "prediction with the plan.")]),
        Section("All replicates", [_replicates(answer)]),
    ]  # fmt: skip
    replicates = number_of(_count(answer), "replicate")
    return Page(
        "Does the plan keep its promise?",
        f"A plan, judged by the measurements of {replicates}. {answer.data.name}, pfdist "
        f"{pfdist.__version__}",
        sections,
        [*_warnings(answer)],
        source=f"from the measurements {answer.data.name}",
        alarms=_alarms(answer),
    )


def _count(answer: Backtest) -> int:
    return len(answer.table) // len(answer.sets)


def _headline(answer: Backtest) -> str:
    """Say for both grids, the worse first, whether the foreseen gain was found."""
    grids = [(name, answer.promises[name]) for name in (FROM_START, CENTRED)]
    grids.sort(key=lambda grid: (_WORST_FIRST.index(grid[1].verdict), grid[1].ratio))
    said = [_sentence(answer.sets[name], each) for name, each in grids]
    return " ".join(said)


def _sentence(other: str, promised: Promise) -> str:
    change = change_of(promised.found, [each if math.isfinite(each) else None
                                        for each in promised.found_interval])  # fmt: skip
    found = f"the error is {change.replace('few draws', 'few replicates')}"
    foreseen = _foreseen(promised.foreseen, promised.foreseen_interval)
    verdict = promised.verdict
    if verdict == NOTHING_FORESEEN:
        return f"No gain was foreseen against {other} (foreseen: {foreseen}); {found}."
    said = f"{verdict.capitalize()} against {other}: {found}; the model foresaw {foreseen}"
    if verdict != NOT_DECIDED or not promised.deciding:
        return f"{said}."
    if promised.deciding > _FAR_TOO_MANY * promised.replicates:
        found_part = f"{100 * promised.ratio:.0f} % of the foreseen difference of the errors"
        return f"{said}. Found was {found_part}, so near half that more replicates hardly decide."
    return f"{said}. It takes about {promised.deciding:,} replicates to decide."


def _foreseen(gain: float, interval: tuple[float, float]) -> str:
    """A foreseen gain to the digits that are known."""
    value, *_ = with_interval(*(100 * each for each in (gain, *interval)))
    return f"{value} %"


def _gain(gain: float, interval: tuple[float, float]) -> Cell:
    if not all(map(math.isfinite, interval)):
        return Cell(f"{100 * gain:.2g} %", gain)
    value, low, high = with_interval(*(100 * each for each in (gain, *interval)))
    return Cell(f"{value} ({low} to {high}) %", gain)


def _verdicts(answer: Backtest) -> Table:
    rows = [
        [
            Cell(answer.sets[name]),
            Cell(_foreseen(each.foreseen, each.foreseen_interval), each.foreseen),
            _gain(each.found, each.found_interval),
            Cell(_ratio(each.ratio, each.interval), each.ratio),
            Cell(each.verdict),
        ]
        for name, each in answer.promises.items()
    ]
    return Table("Gain of the plan (95 % CI)", _VERDICTS, rows)


def _ratio(ratio: float, interval: tuple[float, float]) -> str:
    is_known = all(map(math.isfinite, (ratio, *interval))) and interval[1] < _MUCH
    if not is_known:
        return f"{rounded(ratio, 2)} (any)"
    value, low, high = with_interval(ratio, *interval)
    return f"{value} ({low} to {high})"


def _sets(answer: Backtest) -> Table:
    means, rows = answer.means, []
    for name, label in answer.sets.items():
        real, foreseen, covered = map(float, means.loc[name].to_numpy())
        cells = [Cell(label), Cell(rounded(real, 3), real), Cell(rounded(foreseen, 3), foreseen)]
        cells.append(Cell(_ratio(*answer.ratios[name]), answer.ratios[name][0]))
        cells.append(Cell(f"{100 * covered:.1f} %", covered))
        without = (each - answer.noise for each in (real, foreseen))
        rows.append([*cells, *(Cell(rounded(each, 3), each) for each in without)])
    return Table(
        "Errors of each set (intervals hold together, 95 %)", _SETS, rows, optional=_SETS[5:]
    )


def _facts(answer: Backtest) -> list[tuple[str, str]]:
    first = answer.promises[FROM_START], answer.promises[CENTRED]
    lags = " and ".join(rounded(each.correlation, 2) for each in first)
    plan = formatted_times(answer.plan, answer.time_unit) or "one for each replicate"
    within = f"{formatted_time(answer.within)} {unit_of_spans(answer.time_unit)}".rstrip()
    facts = [
        ("plan", f"t = {plan}" if answer.plan else plan),
        ("judged", f"{number_of(answer.judged, 'value')} of "
                   f"{number_of(_count(answer), 'replicate')}, which no set uses"),
        ("improbable", f"{100 * answer.improbable:.1f} % of the plan's measurements (p < 1 %; a "
                       "right model: 1 %)"),
        ("lag-1 correlation", f"{lags} of the differences"),
        ("distance", f"at most {within} from a wanted time to the measurement used"),
    ]  # fmt: skip
    if answer.left_out:
        facts.append(("left out", "; ".join(_reasons(answer))))
    if not answer.is_checked:
        facts.append(
            ("not checked", "whether the model was fitted to these replicates (a column train "
                            "marks those that it was)")
        )  # fmt: skip
    return facts


def _reasons(answer: Backtest) -> Iterator[str]:
    """Each reason with the names of the replicates."""
    names = dict[str, list[str]]()
    for name, why in answer.left_out.items():
        names.setdefault(why, []).append(name)
    for why, those in names.items():
        shown = ", ".join(those[:5]) + f" and {len(those) - 5} others" * (len(those) > 5)
        yield f"{shown}: {why}"


def _alarms(answer: Backtest) -> list[str]:
    sets = ", ".join(answer.sets[name] for name in answer.wrong)
    said = f"The model is wrong: the real error differs from the foreseen error with {sets}."
    where = f"in {answer.collapsed:,} of {len(answer.table):,} filters"
    few = few_particles(where, 'filter.proposal = "guided", ')
    return [few] * bool(answer.collapsed) + [said] * bool(answer.wrong)


def _warnings(answer: Backtest) -> Iterator[str]:
    if answer.impossible:
        count = number_of(answer.impossible, "filter")
        yield f"In {count} no particle explains a measurement, which is then left out."
    lags = [each.correlation for each in answer.promises.values()]
    if max(lags, default=0.0) > _DEPENDENT:
        yield (
            f"Differences of consecutive replicates correlate ({max(lags):.2f}), so intervals are "
            "too narrow: --block joins consecutive replicates."
        )


def _replicates(answer: Backtest) -> Table:
    names, rows = [*answer.sets], []
    for name, group in answer.table.groupby("replicate", sort=False):
        by_set = group.set_index("set")
        cells = [Cell(str(name)), Cell(str(by_set["judged"].iloc[0]))]
        for each in names:
            for column in ("real", "foreseen"):
                error = float(by_set[column][each])
                cells.append(Cell(rounded(error, 3), error))
        rows.append(cells)
    head = ["replicate", "judged", *(f"{which}, {answer.sets[each]}" for each in names
                                     for which in ("error", "foreseen"))]  # fmt: skip
    return Table("Errors of each replicate", head, rows, detail=True)
