"""A job whose clock has a start: dates in tables, answers, figures, reports and exports.

The oracle is the same job with a clock without a start: all numbers must be equal.
"""

import csv
import json
import math
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pandas as pd
import pyarrow.parquet as pq
import pytest
from matplotlib import pyplot as plt

import pfdist
from oracles.in_turn import in_turn
from oracles.three_sensors import SYSTEMS
from pfdist.errors import ArgumentError, MeasurementsError, PfdistWarning, StoreError
from pfdist.pages.terminal import lines_of
from pfdist.questions.run_page import answer_of, page_of
from pfdist.results.export import _folded

pytestmark = pytest.mark.plugins("backtest", "budget", "filter", "online", "simulate", "why")

Call = Callable[..., Any]
ZONE = "Europe/Brussels"
JOB = """
seed = 1
[model]
name = "random_walk"
[problem]
horizon = {horizon}
measurement_budget = 3
forbidden = {forbidden}
{clock}
[filter]
engine = "kalman"
[[search]]
method = "exhaustive"
[comparison]
draws = 60
[comparison.sets]
mine = {mine}
[execution]
pool = "serial"
"""
DATED = JOB.format(
    horizon="2026-03-31T09:00:00",
    forbidden='["22:00..07:00"]',
    mine='[2026-03-28T08:00:00, "sun 12:00..16:00", "2026-03-30 15:00"]',
    clock=f'[problem.clock]\nstart = 2026-03-28T08:00:00\nstep = "6 h"\ntimezone = "{ZONE}"',
)
"""Summer time begins in the night to 29 March, so 8 and 14 h become 9 and 15 h."""
PLAIN = JOB.format(
    horizon=72, forbidden="[18, 42, 66]", mine="[0, 30, 54]", clock='time_step = 6\ntime_unit = "h"'
)
ON_SUNDAY = "2026-03-29T15:00"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of the job with dates, and that without."""
    made = tmp_path_factory.mktemp("dates")
    for name, text in (("dated", DATED), ("plain", PLAIN)):
        (made / f"{name}.toml").write_text(text)
        pfdist.run(made / f"{name}.toml", made / name, figures=False)
        pfdist.why(made / name, figures=False)
    return made


@pytest.fixture
def run(folder: Path) -> pfdist.Run:
    return pfdist.open_run(folder / "dated")


def local(hours: float) -> str:
    moment = datetime.fromtimestamp(
        datetime(2026, 3, 28, 7, tzinfo=UTC).timestamp() + 3600 * hours, ZoneInfo(ZONE)
    )
    return f"{moment:%Y-%m-%dT%H:%M}"


def test_a_start_changes_no_number_and_makes_dates_of_all_times(folder: Path) -> None:
    dated, plain = (pfdist.open_run(folder / name) for name in ("dated", "plain"))
    assert dated.sets == {name: tuple(map(local, at)) for name, at in plain.sets.items()}
    assert dated.sets["mine"] == ("2026-03-28T08:00", ON_SUNDAY, "2026-03-30T15:00")
    assert (
        dated.table("sets")["expected_mse"].tolist() == plain.table("sets")["expected_mse"].tolist()
    )
    for name in ("trajectories", "profile", "worth", "sampling_windows"):
        own, other = dated.table(name), plain.table(name)
        assert own["date"].tolist() == [*map(local, own["t"])]
        assert own.attrs["time_unit"] == f"h since 2026-03-28T08:00 {ZONE}"
        pd.testing.assert_frame_equal(own.drop(columns="date"), other)


def test_a_reader_of_parquet_finds_the_dates_without_pfdist(folder: Path) -> None:
    for file in folder.glob("dated/tables/*/*.parquet"):
        columns = pq.read_schema(file)
        assert ("date" in columns.names) is ("t" in columns.names)
    compared = pd.read_parquet(folder / "dated" / "tables" / "compared")
    assert ON_SUNDAY in compared["measurement_times"].iloc[1]


def test_a_run_with_dates_is_resumed(folder: Path, tmp_path: Path) -> None:
    for draws in (20, 60):
        pfdist.run(
            folder / "dated.toml", tmp_path, figures=False, changes=[f"comparison.draws={draws}"]
        )
    for name in ("comparison", "trajectories", "compared", "evaluations"):
        pd.testing.assert_frame_equal(
            pfdist.open_run(tmp_path).table(name), pfdist.open_run(folder / "dated").table(name)
        )


def test_answers_and_reports_have_dates(folder: Path, run: pfdist.Run) -> None:
    times = run.best.measurement_times
    said = "\n".join(lines_of(answer_of(run), verbose=True))
    assert "Measure on Sat 2026-03-28 08:00, Sun 2026-03-29 09:00" in said
    assert times[:2] == ["2026-03-28T08:00", "2026-03-29T09:00"]
    assert max(len(line) for line in said.splitlines() if str(folder) not in line) <= 80
    assert run.as_json()["sets"][0]["measurement_times"] == [*run.sets[run.names[0]]]
    page = str(page_of(run)).replace("\N{NO-BREAK SPACE}", " ")
    for text in (*times, "between t = 2026-03-28T08:00", "evenly spaced", "22:00..07:00", ZONE):
        assert text in page
    answer = pfdist.why(folder / "dated", figures=False).as_json()
    assert answer["sets"]["mine"]["sampling_windows"][0]["date"] == "2026-03-28T08:00"


@pytest.mark.parametrize("panel", ["times", "system"])
def test_axes_of_figures_have_local_dates(run: pfdist.Run, panel: str) -> None:
    axes = getattr(pfdist.plots, panel)(run)
    axes = axes if panel == "times" else axes[-1]
    axes.figure.canvas.draw()
    assert axes.get_xlabel() == f"date ({ZONE})"
    labels = [label.get_text().removeprefix("Mar-") for label in axes.get_xticklabels()]
    assert {"29", "30", "31"} <= {*labels}
    at = dict(zip(labels, axes.get_xticks(), strict=True))
    assert at["29"] == pytest.approx(16.0)  # midnight in Brussels, hours after the start
    assert at["30"] == pytest.approx(16.0 + 23.0)  # the day has 23 hours
    assert axes.xaxis.get_offset_text().get_text().startswith("2026-Mar")
    plt.close(axes.figure)


def test_measurements_have_dates_or_numbers(folder: Path, tmp_path: Path) -> None:
    for t in (
        pd.to_datetime(["2026-03-28T08:00", ON_SUNDAY]),
        pd.to_datetime(["2026-03-28T07:00Z", "2026-03-29T13:00Z"]),
        [0, 30],
        [0, "30"],
        ["2026-03-28T08:00", "2026-03-29 15:00"],
    ):
        table = pd.DataFrame({"t": t, "y0": [0.1, 0.2]})
        found = pfdist.filter_measurements(folder / "dated", table)
        assert found.measured == ("2026-03-28T08:00", ON_SUNDAY)
    pfdist.filter_measurements(folder / "dated", table, out=tmp_path, report=False)
    written = pd.read_csv(tmp_path / "measurements.filtered.csv")
    assert written["date"].tolist() == [*map(local, written["t"])]


@in_turn(
    ("now", "shown"),
    [
        (datetime(2026, 3, 29, 15), ON_SUNDAY),
        (30.0, ON_SUNDAY),
        ("2026-03-29T13:00Z", ON_SUNDAY),
        ("2026-03-31T09:00", "2026-03-31T09:00"),
        ("29.03.2026 15:00", ON_SUNDAY),
        ("3/29/2026 15:00", ON_SUNDAY),
        ("30", ON_SUNDAY),
    ],
)
def test_now_may_be_a_date(folder: Path, now: Any, shown: str) -> None:
    table = pd.DataFrame({"t": ["2026-03-28T14:00"], "y0": [0.1]})
    found = pfdist.next_time(folder / "dated", table, now=now)
    assert found.now == shown
    assert all(str(at) > shown for at in found.plan)
    text = " ".join(lines_of(found._page()))
    assert f"from t = {shown} on" in text
    if shown == ON_SUNDAY:
        when = "on Sun 2026-03-29 21:00; then on about Mon 2026-03-30 15:00."
        assert text.strip().startswith(f"Measure next {when}")


def test_how_now_is_read_is_said_and_what_is_no_time_is_an_error() -> None:
    clock, lines = {"start": "2026-04-01", "step": "1 d"}, list[str]()
    problem = pfdist.Problem(
        "random_walk", horizon=60, measurement_budget=2, engine="kalman", clock=clock
    )
    table = pd.DataFrame({"t": [0], "y0": [0.5]})
    for now in (20260501, "20260501"):
        lines.clear()
        assert pfdist.next_time(problem, table, now=now, say=lines.append).now == "2026-05-01"
        assert lines == ["now is read as year month day: '20260501' is 2026-05-01"]
    between = pd.DataFrame({"t": [0.5], "y0": [0.5]})
    lines.clear()
    pfdist.next_time(problem, between, now=20260501, say=lines.append)
    assert "now is read as year month day: '20260501' is 2026-05-01" in lines
    for wrong, words in (
        (True, "now must be times, got True"),
        (math.nan, "now must lie in 2026-04-01..2026-05-31, got nan"),
    ):
        with pytest.raises(MeasurementsError, match=re.escape(words)):
            pfdist.next_time(problem, table, now=wrong)


def test_all_times_of_a_long_plan_are_there_if_details_are(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text(DATED.replace("budget = 3", "budget = 7"))
    found = pfdist.next_time(tmp_path / "long.toml", pd.DataFrame({"t": [], "y0": []}))
    assert len(found.plan) == 7
    short, long = (" ".join(lines_of(found._page(), verbose=each)) for each in (False, True))
    listed = ", ".join(found.clock.in_words(found.plan))
    first, *then = listed.split(", ")
    assert short.startswith(f" Measure next on {first}; then on about")
    assert ", and 2 more." in short
    assert then[-1] not in short
    assert listed in " ".join(long.split())


def test_the_command_line_reads_dates(folder: Path, call: Call, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("t,y0\n2026-03-28 14:00,0.1\n")
    job, rows = str(folder / "dated"), str(tmp_path / "p.csv")
    code, text, _ = call("next", job, rows, "--now", ON_SUNDAY, "--json")
    assert (code, json.loads(text)["now"]) == (0, ON_SUNDAY)
    code, text, _ = call("evaluate", job, "--times", "sun 12:00..16:00,2026-03-30T15:00", "--json")
    asked = pfdist.evaluate(job, [ON_SUNDAY, datetime(2026, 3, 30, 15)])
    assert asked.measurement_times == (ON_SUNDAY, "2026-03-30T15:00")
    assert (code, json.loads(text)["expected_mse"]) == (0, asked.expected_mse)
    for option, text, message in (
        ("--now", "2026-03-28", "must name one instant, got 2026-03-28 with 3: 2026-03-28T08:00"),
        ("--now", "hello", "--now must be a date, as 2026-04-01 or 2026-04-01T08:00, got 'hello'"),
        ("--now", "2026-03-28T08:00", "must lie in 2026-03-28T14:00..2026-03-31T09:00, got 2026-0"),
    ):
        code, _, error = call("next", job, rows, option, text)
        assert code != 0
        assert message in error.splitlines()[-1]


def test_replicates_have_dates_also_between_the_instants(folder: Path) -> None:
    """A table with dates is judged as one with elapsed times."""
    hours = [0, 5, 13, 24, 30, 45, 48, 60, 72]
    rows = [(f"p{k}", t, 0.1 * t * k) for k in range(4) for t in hours]
    table = pd.DataFrame(rows, columns=["patient", "t", "y0"])
    dated = table.assign(t=table["t"].map(local))
    with pytest.warns(PfdistWarning, match="at the nearest instants, at most 3 h away"):
        answers = [
            pfdist.backtest(folder / "dated", each, within=6, pool="serial")
            for each in (table, dated)
        ]
    first, second = (json.dumps(each.as_json()) for each in answers)
    assert first == second
    assert all(str(at).startswith("2026-03-") for at in answers[1].plan)


def test_the_error_at_each_instant_has_dates(folder: Path, call: Call) -> None:
    found = pfdist.evaluate(folder / "dated", [ON_SUNDAY], profile=True).profile
    assert found is not None
    assert found["date"].tolist() == [*map(local, found["t"])]
    _, text, _ = call("evaluate", str(folder / "dated"), "--times", ON_SUNDAY, "--profile")
    assert "date" in text
    assert all(each in text for each in found["date"])
    simulated = pfdist.simulate(folder / "dated.toml", draws=2)
    assert simulated["date"].tolist() == [*map(local, simulated["t"])]


def test_a_wrong_date_in_a_table_is_named_with_its_row(folder: Path) -> None:
    table = pd.DataFrame({"t": ["2026-03-28T08:00", "2026-03-29T02:30"], "y0": [0.1, 0.2]})
    with pytest.raises(MeasurementsError, match=r"must exist in Europe/Brussels.*\(row 2\)"):
        pfdist.filter_measurements(folder / "dated", table)
    with pytest.raises(MeasurementsError, match="column 't' in row 1 must be a number"):
        pfdist.filter_measurements(folder / "plain", table)


# --- exports --------------------------------------------------------------------------------------


def events(file: Path) -> list[dict[str, str]]:
    """The properties of each event of an iCalendar file, whose form is checked (RFC 5545, 3.1)."""
    content = file.read_bytes()
    assert content.endswith(b"\r\n")
    lines = content.removesuffix(b"\r\n").split(b"\r\n")
    assert all(len(line) <= 75 and b"\n" not in line and b"\r" not in line for line in lines)
    unfolded = content.decode().replace("\r\n ", "").split("\r\n")[:-1]
    assert (unfolded[0], unfolded[-1]) == ("BEGIN:VCALENDAR", "END:VCALENDAR")
    assert "VERSION:2.0" in unfolded
    found = list[dict[str, str]]()
    for line in unfolded[1:-1]:
        name, value = re.split("[:;]", line, maxsplit=1)
        if line == "BEGIN:VEVENT":
            found.append({})
        elif found and name != "END":
            found[-1][name] = value
    assert all({"UID", "DTSTAMP", "DTSTART", "SUMMARY"} <= {*event} for event in found)
    assert len({event["UID"] for event in found}) == len(found)
    return found


def test_an_export_for_a_diary_has_the_moments_of_the_plan(run: pfdist.Run, tmp_path: Path) -> None:
    found = events(run.export(tmp_path / "plan.ics"))
    starts = [
        datetime.strptime(each["DTSTART"], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC) for each in found
    ]
    own = [each.astimezone(ZoneInfo(ZONE)).isoformat()[:16] for each in starts]
    assert own == run.best.measurement_times
    before = (tmp_path / "plan.ics").read_bytes()
    run.export(tmp_path / "plan.ics")
    assert (tmp_path / "plan.ics").read_bytes() == before


def test_an_export_has_how_far_each_measurement_may_move(run: pfdist.Run, tmp_path: Path) -> None:
    with run.export(tmp_path / "plan.csv").open(newline="") as file:
        rows = [*csv.DictReader(file)]
    assert [row["date"] for row in rows] == run.best.measurement_times
    moved = run.table("sampling_windows")
    moved = moved[moved["name"] == run.best.name]
    said = [each["DESCRIPTION"] for each in events(run.export(tmp_path / "plan.ics"))]
    for row, text in zip(rows, said, strict=True):
        of_row = moved[moved["date"] == row["date"]]
        for percent in (1, 5):
            first, last = (row[f"{end}_{percent}"] for end in ("earliest", "latest"))
            inside = of_row[of_row[f"within_{percent}"] == "inside"]["moved_to"].map(local).tolist()
            assert {first, last, row["date"]} <= {*inside, row["date"]}
            assert first <= row["date"] <= last
            assert (f"from {first} to {last} at a loss of at most {percent} %" in text) is (
                first != last
            )


def test_exports_of_other_clocks(folder: Path, small_run: pfdist.Run, tmp_path: Path) -> None:
    text = small_run.export(tmp_path / "counted.csv").read_text().splitlines()
    assert text[0].startswith("measurement,t")
    assert [line.split(",")[1] for line in text[1:]] == [
        str(t) for t in small_run.best.measurement_times
    ]
    with pytest.raises(ArgumentError, match=r"must end in \.csv, or .* problem\.clock\.start"):
        small_run.export(tmp_path / "counted.ics")
    with pytest.raises(ArgumentError, match=r"export must end in \.csv, or in \.ics if"):
        small_run.export(tmp_path / "plan.txt")
    (tmp_path / "own.csv").write_text("a,b\n")
    with pytest.raises(StoreError, match="is not an earlier result"):
        small_run.export(tmp_path / "own.csv")
    assert (tmp_path / "own.csv").read_text() == "a,b\n"


def test_days_and_local_times_in_a_diary_have_no_time_zone(tmp_path: Path) -> None:
    for start, step, pattern in (
        ("2026-04-01", "1 d", r"VALUE=DATE:202604\d\d"),
        ("2026-04-01T08:00", "1 d", r"202604\d\dT080000"),
    ):
        problem = pfdist.Problem(
            SYSTEMS[0].as_model(),
            horizon=4,
            measurement_budget=2,
            engine="kalman",
            clock={"start": start, "step": step},
        )
        file = tmp_path / f"{step}{len(start)}.ics"
        planned = pfdist.plan(
            problem, tmp_path / f"{len(start)}", figures=False, export=file, bound_draws=0,
            changes=["comparison.draws=30"],
        )  # fmt: skip
        found = events(file)
        assert all(re.fullmatch(pattern, each["DTSTART"]) for each in found)
        assert [each["SUMMARY"].partition(": ")[2] for each in found] == [
            str(each).partition(" ")[2] for each in planned.best.measurement_times
        ]
        with planned.export(tmp_path / "sensors.csv").open(newline="") as table:
            rows = [f"{row['date']} {row['sensor']}" for row in csv.DictReader(table)]
        assert rows == planned.best.measurement_times


@pytest.mark.usefixtures("no_figures")
def test_the_command_line_exports(folder: Path, call: Call, tmp_path: Path) -> None:
    file = tmp_path / "plan.ics"
    assert call("status", str(folder / "dated"), "--export", str(file))[0] == 0
    assert len(events(file)) == 3
    code, _, error = call("why", str(folder / "plain"), "--export", str(file))
    assert code == 1
    assert error.startswith("pfdist: --export must end in .csv, or in .ics if the job has")


def test_long_lines_are_folded_between_letters() -> None:
    text = "DESCRIPTION:" + "é€𝄞" * 60
    pieces = _folded(text).split("\r\n")
    assert max(len(piece.encode()) for piece in pieces) <= 75
    assert pieces[0] + "".join(piece.removeprefix(" ") for piece in pieces[1:]) == text
