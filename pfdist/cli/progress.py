"""How far a run is, on standard error: live in a terminal, else a plain line now and then."""

import time
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column

from pfdist.common.rounding import rounded, with_error
from pfdist.errors import one_line
from pfdist.runner.progress import Found
from pfdist.runner.progress import Progress as State

WIDE = 110  # columns, from which a bar has room
LINE_SECONDS = 5.0  # between two lines where there is no terminal


def _columns(with_bar: bool) -> list[ProgressColumn]:
    """What a line shows: what must be seen comes first, and only the description is cut."""
    return [
        TaskProgressColumn(table_column=Column(min_width=4, no_wrap=True)),
        TimeRemainingColumn(compact=True, table_column=Column(min_width=5, no_wrap=True)),
        TextColumn("left", table_column=Column(min_width=4, no_wrap=True)),
        *([BarColumn(bar_width=16)] if with_bar else []),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
        ),
    ]


class Display:
    """Progress on standard error: live in a terminal, else a plain line every few seconds.

    A context manager; `report` and `say` are what `pfdist.run` takes.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True, highlight=False)
        self._bar = Progress(
            *_columns(self._console.width >= WIDE),
            console=self._console,
            transient=True,
        )
        self._live = self._console.is_terminal
        self._task: Any = None
        self._phase = ""
        self._phase_start, self._last_line = (0.0, 0, 0.0), 0.0
        self._shown = -1.0  # how much was done at the last line

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._task is not None:
            self._bar.stop()

    def say(self, line: str) -> None:
        """Print one line."""
        self._console.print(one_line(line), soft_wrap=True, markup=False, emoji=False)

    def report(self, state: State) -> None:
        """Show how far a run is."""
        now = time.monotonic()
        if state.phase != self._phase:
            self._phase, self._phase_start = state.phase, (now, state.evaluations, state.done)
        line = self._line(state, now)
        if self._live:
            if self._task is None:
                self._task = self._bar.add_task(line, total=state.total, completed=int(state.done))
                self._bar.start()
            self._bar.update(self._task, completed=state.done, description=line)
        elif now - self._last_line >= LINE_SECONDS or (
            state.done == state.total and state.done != self._shown
        ):
            self._last_line, self._shown = now, state.done
            self.say(f"{100 * state.done / state.total:5.1f} %  {line}  {self._left(state, now)}")

    def _line(self, state: State, now: float) -> str:
        start, evaluations, _ = self._phase_start
        elapsed = now - start
        rate = (state.evaluations - evaluations) / elapsed if elapsed > 0.5 else 0.0
        unit = "evaluations" if state.generations else "draws"
        parts = [state.phase]
        if state.generations:
            parts.append(f"generation {state.generation}/{state.generations}")
        else:
            parts.append(f"{state.evaluations:,} draws")
        if state.best is not None and state.generations:
            parts.append(f"best {rounded(state.best, 4)}")
        if state.mean is not None and state.generations:
            parts.append(f"mean {rounded(state.mean, 4)}")
        parts += [_progress_of(found) for found in state.found[:1]]
        if rate:
            parts.append(f"{rate:,.{1 if rate < 100 else 0}f} {unit}/s")
        return "  ".join(parts)

    def _left(self, state: State, now: float) -> str:
        start, _, done = self._phase_start
        if state.done <= done:
            return ""
        seconds = (now - start) / (state.done - done) * (state.total - state.done)
        return (
            f"about {seconds:,.0f} s left"
            if seconds < 120
            else f"about {seconds / 60:,.0f} min left"
        )


def _progress_of(found: Found) -> str:
    """Say how much better a set is so far; ± is half of the 95 % interval."""
    (low, high), (least, most) = found.gain_of_means_interval, found.interval
    lower = with_error(100 * found.gain_of_means, 50 * (high - low))
    relative = with_error(100 * found.mean_relative_gain, 50 * (most - least))
    return f"{found.name}: MSE {lower} % lower, relative gain {relative} %"
