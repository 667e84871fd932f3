"""The progress of a run: a bar in a terminal, a line in a notebook, else plain lines."""

import math
import sys
import time
from collections.abc import Callable
from html import escape
from typing import Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TextColumn,
)
from rich.table import Column

from pfdist.common.rounding import rounded, with_error
from pfdist.errors import one_line
from pfdist.runner.progress import Detail, SetGain
from pfdist.runner.progress import Progress as State


class _Line:
    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text

    def _repr_html_(self) -> str:
        return f"<code>{escape(self._text)}</code>" if self._text else ""


def notebook_line() -> Callable[[str], Any] | None:
    """A function that replaces a line below the running cell; None outside a notebook."""
    ipython = sys.modules.get("IPython")  # a notebook has loaded it
    shell = None if ipython is None else ipython.get_ipython()
    if shell is None or not hasattr(shell, "kernel"):
        return None
    from IPython.display import display  # noqa: PLC0415

    handle: Any = display(_Line(""), display_id=True)
    return lambda line: handle.update(_Line(line))


# --- the display ----------------------------------------------------------------------------------

WIDE = 110  # columns that a terminal needs for a bar
LINE_SECONDS = 5.0  # between two lines without a terminal
_RATE_SECONDS = 0.5  # after which the rate of a phase is shown
_LONGEST_IN_SECONDS = 120  # longer times are given in minutes
_GROWN = 3  # times in a row that the time left may grow before it is no longer shown


def _columns(with_bar: bool) -> list[ProgressColumn]:
    """The columns of a line; a narrow terminal cuts only the last, the description."""
    return [
        TextColumn("{task.fields[at]}", table_column=Column(min_width=26, no_wrap=True)),
        *([BarColumn(bar_width=16)] if with_bar else []),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
        ),
    ]


class Display:
    """The progress of a run: live in a terminal or notebook, else a line every few seconds.

    It is a context manager, and writes to standard error. `pfdist.run` takes its methods `show` and
    `say` as arguments.

    Parameters
    ----------
    console : Console, optional
        By default, the console of standard error.
    after : float
        Seconds before the progress is shown. If they are not 0, there are no plain lines.
    verbose : bool
        Whether lines that are a `pfdist.runner.progress.Detail` are printed.
    """

    def __init__(
        self, console: Console | None = None, after: float = 0.0, *, verbose: bool = False
    ) -> None:
        self._console = console or Console(stderr=True, highlight=False)
        self._bar = Progress(
            *_columns(self._console.width >= WIDE), console=self._console, transient=True
        )
        self._live, self._verbose = self._console.is_terminal, verbose
        self._cell: Callable[[str], Any] | None = None
        self._may_be_cell = console is None
        self._begins, self._has_lines = time.monotonic() + after, not after
        self._task: Any = None
        # Rates count from the first answer of a phase: before it, workers start and compile. They
        # start again if the evaluations do: a phase may filter its draws several times.
        self._start, self._start_time, self._last = State("", 0.0, 1.0), 0.0, 0
        self._answered = False
        self._last_done, self._last_time = -1.0, 0.0  # of the last plain line
        self._left, self._left_time, self._grown = math.inf, 0.0, 0  # seconds left, and when

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._task is not None:
            self._bar.stop()
        if self._cell is not None:
            self._cell("")

    def say(self, line: str) -> None:
        """Print one line."""
        if self._verbose or not isinstance(line, Detail):
            self._console.print(one_line(line), soft_wrap=not self._live, markup=False, emoji=False)

    def show(self, state: State) -> None:
        """Show the progress of a run."""
        now = time.monotonic()
        begins = state.phase != self._start.phase or state.evaluations < self._last
        if begins or (not self._answered and state.done > self._start.done):
            self._start, self._start_time, self._answered = state, now, not begins
        self._last = state.evaluations
        line = one_line("  ".join([*_position(state), *self._rate(state, now)]))
        share = state.done / state.total if state.total else 1.0  # exact errors take no particles
        percent, left = math.floor(1000 * share) / 10, self._time_left(state, now)
        if now < self._begins:
            return
        if self._cell is None and self._may_be_cell:
            self._cell = notebook_line()
        if self._cell is not None:
            self._cell(f"{percent:.1f} %  {line}  {left}")
            return
        if self._live:
            at, done, total = f"{math.floor(percent):3}% {left}", state.done, state.total
            if self._task is None:
                self._task = self._bar.add_task(line, at=at)
                self._bar.start()
            self._bar.update(self._task, completed=done, total=total, description=line, at=at)
            return
        finished = state.done == state.total and state.done != self._last_done
        if self._has_lines and (finished or now - self._last_time >= LINE_SECONDS):
            self._last_done, self._last_time = state.done, now
            self.say(f"{percent:5.1f} %  {line}  {left}")

    def _rate(self, state: State, now: float) -> list[str]:
        """The evaluations or draws per second, if they are known."""
        elapsed = now - self._start_time
        if elapsed <= _RATE_SECONDS or state.evaluations == self._start.evaluations:
            return []
        rate = (state.evaluations - self._start.evaluations) / elapsed
        unit = "evaluations" if state.generations else "draws"
        return [f"{rate:,.{1 if rate < 100 else 0}f} {unit}/s"]

    def _time_left(self, state: State, now: float) -> str:
        """The time left at the pace of this phase; a limit if some work may be left out."""
        if not self._answered or state.done <= self._start.done:
            return ""
        seconds_each = (now - self._start_time) / (state.done - self._start.done)
        seconds = seconds_each * max(0.0, state.total - state.done)
        if now - self._left_time >= LINE_SECONDS:
            self._grown = self._grown + 1 if seconds > self._left else 0
            self._left, self._left_time = seconds, now
        minutes, about = f"{seconds / 60:,.0f} min", "at most" if state.optional else "about"
        amount = f"{seconds:,.0f} s" if seconds < _LONGEST_IN_SECONDS else minutes
        return f"{about} {amount} left" if self._grown < _GROWN else ""


def _position(state: State) -> list[str]:
    """The phase, the position in the phase, and what the phase has found so far."""
    if state.doing:
        return [state.doing]
    if not state.generations:
        gains = [_gain(gain) for gain in state.found[:1]]
        return [state.phase, f"{state.evaluations:,} draws", *gains]
    expected = f"/{state.generations}" if state.generation <= state.generations else ""
    parts = [state.phase, f"generation {state.generation}{expected}"]
    if state.best is not None:
        parts.append(f"best {rounded(state.best, 4)}")
    if state.mean is not None:
        parts.append(f"mean {rounded(state.mean, 4)}")
    return parts


def _gain(gain: SetGain) -> str:
    """How far the error of a set is below that of the reference so far; ± is one standard error."""
    of_means = gain.gain_of_means
    change = with_error(100 * abs(of_means.value), 100 * of_means.standard_error)
    return f"{gain.label}: error {change} % {'higher' if of_means.value < 0 else 'lower'}"
