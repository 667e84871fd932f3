"""The worth of each measurement, and how exactly it must be kept (``pfdist why``)."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from pfdist.common.parts import Block, Cell, Figures, Page, Section, Table, Text
from pfdist.common.rounding import with_error
from pfdist.problem.set_key import phrase_of
from pfdist.questions.subject import Subject, number_of
from pfdist.results.sampling_windows import STRICT, WIDE, windows_of

if TYPE_CHECKING:
    import pandas as pd

_MEANING = (
    "A measurement without which the {0} hardly {1} may be left out; a value below 0 means that "
    "the {0} is {2} without it. A measurement alone may move to the instants of its sampling "
    "window: there the {0} {1} by at most so many per cent (one-sided 95 % upper limit, for each "
    "instant alone). Undecided instants need more draws."
)
_ROUNDING = 1e-10  # per cent: rounding errors of doubles are smaller
Frames = Mapping[str, "pd.DataFrame"]


def worth_section(subject: Subject) -> Section | None:
    """The worth of each measurement of a run's sets, where ``pfdist why`` has run."""
    run = subject.run
    if not {"worth", "sampling_windows"} <= {*run.tables}:
        return None
    frames = {name: run.table(name) for name in ("profile", "worth", "sampling_windows")}
    figures = Figures(["why"], subject.by_error[:1])
    said = Text(_extremes(subject, frames), prominent=True)
    blocks = [said, *_tables(subject, frames), figures, _meaning(subject)]
    return Section("What each measurement is worth", blocks)


def why_page(subject: Subject, frames: Frames) -> Page:
    """The answer of `pfdist.why`.

    Parameters
    ----------
    subject : Subject
    frames : mapping of str to DataFrame
        profile, worth and sampling_windows, as `pfdist.plugins.why.question.Why` has them.
    """
    tables = [*_tables(subject, frames), *subject.notes]
    section = Section("", [*tables, _meaning(subject)])
    said, place = _extremes(subject, frames), str(subject.run.path)
    return Page("", said, [section], place=place, alarms=subject.alarms)


def _extremes(subject: Subject, frames: Frames) -> str:
    """The most and the least important measurement of the plan, in sentences."""
    plan = subject.by_error[0]
    rises, clock = _rises(subject, plan, frames), subject.clock
    if not rises or not all(math.isfinite(rise) for _, rise, _ in rises):
        return "Which measurement is the most important is unknown."
    order = sorted(rises, key=lambda each: each[1])
    (most, most_rise), (least, least_rise) = (
        (f"t = {clock.listed([clock.of_row(row)])}", rise) for row, _, rise in (order[-1], order[0])
    )
    return (
        f"Most important measurement of {phrase_of(subject.rows[plan].label)}: {most} (without it, "
        f"{subject.error} {subject.criterion.worsens} by {most_rise} %)."
    ) + f" Least important: {least} ({least_rise} %)." * (len(order) > 1)


def _tables(subject: Subject, frames: Frames) -> Iterator[Block]:
    """A table of the measurements of each set, the plan's first: their worth and their windows."""
    plan, clock = subject.by_error[0], subject.clock
    for name in sorted(frames["worth"]["name"].unique(), key=lambda name: name != plan):
        moved = frames["sampling_windows"]
        rows = moved[moved["name"] == name].to_dict("records")
        windows = (windows_of(rows, percent, clock) for percent in (STRICT, WIDE))
        texts = [{each.measurement: each.text for each in level} for level in windows]
        cells = [
            [
                Cell(clock.text(clock.of_row(row)), row["t"]),
                Cell(text, rise),
                *(Cell(each.get(clock.of_row(row), "")) for each in texts),
            ]
            for row, rise, text in _rises(subject, name, frames)
        ]
        without = f"{_judged(subject)} {subject.criterion.worsens} without it by"
        head = (
            subject.head_of_times, f"{without}, % ± standard error",
            f"may move within {STRICT} %", f"within {WIDE} %",
        )  # fmt: skip
        draws = int(frames["worth"]["draws"].max())
        how = f"on {number_of(draws, 'fresh draw')}" if draws else "exact"
        caption = f"Measurements of {phrase_of(subject.rows[name].label)}, {how}"
        yield Table(caption, head, cells, detail=name != plan)


def _judged(subject: Subject) -> str:
    """The number that a measurement changes, as heads call it."""
    return "error" if subject.criterion.is_mean else subject.criterion.label


def _meaning(subject: Subject) -> Text:
    lower = "lower" if subject.criterion.sign > 0 else "higher"
    words = _judged(subject), subject.criterion.worsens, lower
    return Text(_MEANING.format(*words), detail=True)


def _rises(
    subject: Subject, name: str, frames: Frames
) -> list[tuple[Mapping[Any, Any], float, str]]:
    """The row of each measurement, and by how many per cent the number worsens without it."""
    profile, worth = (frames[part][frames[part]["name"] == name] for part in ("profile", "worth"))
    unit = (profile["error"] * profile["weight"]).sum() / len(profile) / 100  # 1 % of the MSE
    if not subject.criterion.is_mean:
        unit = abs(subject.rows[name].criterion_value) / 100
    rises = list[tuple[Mapping[Any, Any], float, str]]()
    for row in worth.to_dict("records"):
        rise, error = row["removed"] / unit, row["removed_error"] / unit
        rise = 0.0 if error == 0.0 and abs(rise) < _ROUNDING else rise
        rises.append((row, rise, with_error(rise, error)))
    return rises
