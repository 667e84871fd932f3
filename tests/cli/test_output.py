"""Outputs in any terminal, and the libraries that a command imports."""

import io
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from rich.console import Console

from oracles.in_turn import in_turn
from pfdist.cli.main import main
from pfdist.common.estimate import Estimate
from pfdist.questions.display import Display
from pfdist.runner.progress import Detail, Progress, SetGain

HEAVY = ("pandas", "scipy", "matplotlib", "numba", "llvmlite", "pyarrow", "ray", "pydantic")
ASSET = Path(__file__).parents[1] / "assets" / "kept"
SAYS = """
import os, sys
from pfdist.cli.streams import make_harmless
make_harmless()
first = os.open(os.devnull, os.O_RDONLY)
print("display" * 10_000, file=sys.stderr)
sys.stderr.flush()
try:
    print("answer")
    sys.stdout.flush()
    code = 0
except Exception as error:
    code = 3 + (str(error) == "cannot write the answer: no space left")
sys.exit(code if first > 2 else 9)
"""
_FOUND = SetGain("genetic", Estimate(0.26, 0.002))


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        (["plna"], {*HEAVY, "numpy"}),  # a misspelt command
        (["--help"], {*HEAVY, "numpy"}),
        (["run", "--help"], {"pandas", "matplotlib", "ray"}),  # it lists the pools, Ray's too
        (["status", str(ASSET)], {"matplotlib", "numba", "llvmlite", "ray"}),
    ],
    ids=lambda value: " ".join(value)[:10] if isinstance(value, list) else "",
)
def test_nothing_is_imported_that_a_command_does_not_need(
    words: list[str], unwanted: set[str]
) -> None:
    script = (
        "import sys\nfrom pfdist.cli.main import main\n"
        f"try: main({words!r})\nexcept SystemExit: pass\nprint(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    loaded = {*done.stderr.split()}
    assert not loaded & unwanted
    assert "pfdist.pools.kinds" in loaded or words[0] != "run"


def test_a_reader_that_ends_is_no_error() -> None:
    line = f"{sys.executable} -m pfdist --help | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert (done.returncode in (0, 1), done.stderr) == (True, "")


@pytest.mark.parametrize("encoding", ["ascii", "cp437", "utf-8"])
def test_a_summary_is_written_in_any_encoding(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, error = io.BytesIO(), io.BytesIO()
    for name, stream in (("stdout", out), ("stderr", error)):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(stream, encoding, errors="strict"))
    assert main(["status", str(ASSET), "--verbose"]) == 0
    sys.stdout.flush()
    plus_minus = b"+-" if encoding == "ascii" else "±".encode(encoding)
    assert re.search(rb"regular +[\d.]+ " + re.escape(plus_minus) + rb" [\d.]+", out.getvalue())


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_name_that_is_not_utf8_is_written_as_it_is(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(error, encoding, errors="strict"))
    assert main(["status", "a\udcffb"]) == 1
    sys.stderr.flush()
    assert b"a\xffb holds no run" in error.getvalue()


@pytest.mark.parametrize(("gain", "says"), [(0.26, "lower"), (-0.26, "higher")])
def test_progress_shows_the_gain_of_means_alone_with_its_standard_error(
    gain: float, says: str
) -> None:
    out = io.StringIO()
    found = (SetGain("genetic", Estimate(gain, 0.002)),)
    Display(Console(file=out, width=99)).show(Progress("comparison", 1.0, 2.0, 9, found=found))
    assert f"9 draws  genetic: error 26.00 ± 0.20 % {says}  " in out.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 140])
def test_percentage_and_time_left_are_seen_at_any_width(width: int) -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=width, color_system=None)
    with Display(console) as display:
        for step in range(3):
            display.show(
                Progress("a_search_with_a_name_that_is_long", 300.0 + 100 * step, 1000.0,
                         evaluations=300, generation=3, generations=25, best=23.45, mean=25.6,
                         found=(_FOUND,))
            )  # fmt: skip
        display._bar.refresh()
    rows = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", out.getvalue()).replace("\r", "\n").split("\n")
    shown = [row for row in rows if row.strip()]
    assert shown
    assert all(re.match(r" *\d+% ", row) for row in shown), shown
    assert re.match(r" *50% about 0 s left ", shown[-1])
    assert all(len(row) <= width for row in shown)


def test_the_time_left_does_not_count_the_time_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    now, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    display = Display(Console(file=out, width=80))
    for now[0], done in ((10.0, 0), (70.0, 1), (80.0, 2), (90.0, 3)):  # a minute to compile
        display.show(Progress("genetic", done, 9, evaluations=done, generation=1, generations=1))
    *before, last = out.getvalue().splitlines()
    assert re.search(r"0\.1 evaluations/s +about 60 s left$", last)
    assert not [line for line in before[:2] if "left" in line]


def _lines_of(
    monkeypatch: pytest.MonkeyPatch, states: Iterable[tuple[float, Progress]], after: float = 0.0
) -> list[str]:
    """The lines that a display without a terminal prints of states at some seconds."""
    now, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    display = Display(Console(file=out, width=120), after)
    for now[0], state in states:
        display.show(state)
    return out.getvalue().splitlines()


def test_a_time_left_that_only_grows_is_no_forecast_and_the_share_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each step takes three times as long as the one before; then the pace is even."""
    seconds = [0.0, 10.0]
    for _ in range(5):
        seconds.append(3 * seconds[-1])
    seconds += [seconds[-1] * (1 + k) for k in range(1, 30)]
    states = [
        (10 + second, Progress("search", done, 100.0, evaluations=int(done)))
        for done, second in enumerate(seconds)
    ]
    told = [line.rpartition("  ")[2] for line in _lines_of(monkeypatch, states)]
    left = [line.endswith("left") for line in told]
    assert left[:2] == [False, False]  # nothing is known yet
    first = left.index(True)
    assert left[first : first + 3] == [True, True, True]  # it may grow twice
    assert not any(left[first + 3 : 7])
    assert left[-1]  # it falls again


def test_the_time_left_is_of_the_steps_of_the_share_and_a_limit_if_some_may_be_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    states = [
        (6.0 * (done + 1), Progress("a", done, 20.0, evaluations=done, optional=18.0))
        for done in range(6)
    ]
    *_, last = _lines_of(monkeypatch, states)
    assert last.startswith(" 25.0 %")
    assert last.endswith("  at most 90 s left")


def test_progress_that_nobody_asked_for_begins_after_some_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a terminal; a file gets none."""
    states = [(second, Progress("a", second, 100.0)) for second in (0.0, 4.9, 5.1, 10.0)]
    assert _lines_of(monkeypatch, states, after=5.0) == []
    now, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Display(Console(file=out, force_terminal=True, width=80), after=5.0) as display:
        for second, state in states[:2]:
            now[0] = second
            display.show(state)
        assert out.getvalue() == ""
        now[0] = 5.1
        display.show(states[2][1])
        display._bar.refresh()
        assert "5%" in out.getvalue()


def test_a_rate_is_that_of_the_present_count_and_never_negative(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A phase may go through its draws several times, as `why` does: the count starts again."""
    now, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    display = Display(Console(file=out, width=80))
    counts = (0, 600, 1200, 1800, 500, 1000, 1500)  # 600 in each 10 s, then 500
    for step, draws in enumerate(counts):
        now[0] = 10.0 * step
        display.show(Progress("why genetic", float(step), 7.0, evaluations=draws))
    rates = [re.findall(r"(-?[\d.]+) draws/s", each) for each in out.getvalue().splitlines()]
    assert rates == [[], ["60.0"], ["60.0"], [], [], ["50.0"]]


def test_details_are_said_if_they_are_asked_for() -> None:
    for verbose in (False, True):
        out = io.StringIO()
        display = Display(Console(file=out, width=80), verbose=verbose)
        display.say(Detail("Serial pool is ready"))
        display.say("a warning")
        assert out.getvalue() == "Serial pool is ready\n" * verbose + "a warning\n"


def test_what_is_said_is_no_markup() -> None:
    out = io.StringIO()
    Display(Console(file=out, width=80)).say("runs/[bold]x[/y]:smile:\n\x1b[2J is ready")
    assert out.getvalue() == "runs/[bold]x[/y]:smile: ?[2J is ready\n"


@in_turn(("flags", "unbuffered"), [("", ""), ("", "1"), ("--json", ""), ("--json", "1")])
def test_on_a_full_device_one_line_says_that_the_answer_is_lost(
    flags: str, unbuffered: str
) -> None:
    command = f"'{sys.executable}' -m pfdist models {flags} > /dev/full"
    given = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, env=given, check=False
    )
    assert done.stderr == "pfdist: cannot write the answer: no space left\n"
    assert done.returncode == 1


@pytest.mark.parametrize(
    ("redirections", "code"),
    [
        pytest.param("2>&-", 0, id="stderr-closed"),
        pytest.param("2>/dev/full", 0, id="stderr-full"),
        pytest.param(">&-", 0, id="stdout-closed"),
        pytest.param(">&- 2>&-", 0, id="both-closed"),
        pytest.param("<&- >&- 2>&-", 0, id="all-closed"),
        pytest.param(">/dev/full", 4, id="stdout-full"),
        pytest.param(">/dev/full 2>/dev/full", 4, id="both-full"),
    ],
)
def test_only_an_answer_that_cannot_be_written_is_an_error(redirections: str, code: int) -> None:
    command = ["sh", "-c", f'"$0" -c "$1" {redirections}', sys.executable, SAYS]
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(command, capture_output=True, text=True, env=buffered, check=False)
    assert done.returncode == code
    assert "Exception" not in done.stderr + done.stdout
    assert "display" not in done.stdout  # what is meant for standard error goes nowhere else
