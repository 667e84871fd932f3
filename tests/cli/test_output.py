"""Check what is written, whatever the terminal takes, and what is imported for it."""

import io
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from pfdist.api.display import Display
from pfdist.cli.main import main
from pfdist.runner.progress import Found, Progress

HEAVY = ("pandas", "scipy", "matplotlib", "numba", "llvmlite", "pyarrow", "ray", "pydantic", "rich")
ASSET = Path(__file__).parents[1] / "assets" / "schema-3"
_FOUND = Found("genetic", 0.238, (0.236, 0.24), 0.8, 0.26, (0.259, 0.263))


def _loaded_by(statement: str) -> set[str]:
    script = f"import sys\n{statement}\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    return set(done.stderr.split())


def test_the_version_and_the_help_import_no_library() -> None:
    calls = "".join(
        f"\ntry: main(['{option}'])\nexcept SystemExit: pass" for option in ("--version", "--help")
    )
    assert not _loaded_by(f"from pfdist.cli.main import main{calls}") & {*HEAVY, "numpy"}


def test_the_help_of_run_lists_the_pools_and_imports_neither_ray_nor_any_other_library() -> None:
    statement = """
from pfdist.cli.main import main
try: main(["run", "--help"])
except SystemExit: pass
"""
    loaded = _loaded_by(statement)
    assert "pfdist.pools.kinds.ray" in loaded
    assert not loaded & {*HEAVY, "numpy"}


def test_to_look_at_a_run_imports_neither_numba_nor_matplotlib_nor_ray() -> None:
    loaded = _loaded_by(f"from pfdist.cli.main import main\nmain(['status', {str(ASSET)!r}])")
    assert not loaded & {"matplotlib", "numba", "llvmlite", "ray"}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437", "utf-8"])
def test_a_summary_is_written_in_any_encoding(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, error = io.BytesIO(), io.BytesIO()
    for name, stream in (("stdout", out), ("stderr", error)):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(stream, encoding, errors="strict"))
    assert main(["status", str(ASSET)]) == 0
    sys.stdout.flush()
    plus_minus = b"+-" if encoding == "ascii" else "±".encode(encoding)
    assert re.search(
        rb"expected MSE +[\d.]+ " + re.escape(plus_minus) + rb" [\d.]+", out.getvalue()
    )


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_name_that_is_not_utf8_is_written_as_it_is(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(error, encoding, errors="strict"))
    assert main(["status", "a\udcffb"]) == 1
    sys.stderr.flush()
    assert b"a\xffb holds no run" in error.getvalue()


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
    assert all(re.match(r" *\d+% +(-|\d)[-\d]*:[-\d]+ left ", row) for row in shown), shown
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


def test_what_is_said_is_no_markup() -> None:
    out = io.StringIO()
    Display(Console(file=out, width=80)).say("runs/[bold]x[/y]:smile:\n\x1b[2J is ready")
    assert out.getvalue() == "runs/[bold]x[/y]:smile: ?[2J is ready\n"
