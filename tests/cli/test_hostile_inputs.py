"""Whatever a job file or an option holds: one line that says what, got, allowed; exit 1 or 2."""

import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.times.measurement_times import validated

JOB = (Path(__file__).parents[1] / "small.toml").read_text()
_NINES = "9" * 5000
_LONG = "x" * 3_000_000


def _changed(old: str, new: str) -> bytes:
    assert old in JOB
    return JOB.replace(old, new, 1).encode()


def _refused(words: list[str], capsys: pytest.CaptureFixture[str], code: int = 1) -> str:
    """Run a command that must refuse with a short line, which is given."""
    if code == 2:
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 2
    else:
        assert main(words) == 1
    captured = capsys.readouterr()
    line = captured.err.splitlines()[-1]
    assert captured.out == ""
    assert "Traceback" not in captured.err
    assert code == 2 or captured.err.count("\n") == 1
    assert line.startswith("pfdist")
    assert len(line) < 1300
    return line


@pytest.mark.parametrize(
    ("content", "words"),
    [
        pytest.param(_changed("seed = 1", f"seed = {_NINES}"), "19 digits", id="5,000 digits"),
        pytest.param(_changed("seed = 1", "seed = 0x" + "f" * 5000), "64 bits", id="hexadecimal"),
        pytest.param(_changed("seed = 1", "seed = " + "[" * 9999), "16 deep", id="deep lists"),
        pytest.param(_changed("seed = 1", ".".join("a" * 999) + " = 1"), "16 deep", id="dots"),
        pytest.param(_changed("seed = 1", f"seed = '{_LONG}'"), "seed must be", id="3 MB of text"),
        pytest.param(_changed("seed = 1", f"{_LONG} = 1"), "unknown key 'xx", id="a key of 3 MB"),
        pytest.param(_changed("seed = 1", ""), "seed must be given", id="nothing required"),
        pytest.param(_changed("seed = 1", "seed = nan"), "seed must be .* got nan", id="NaN"),
        pytest.param(_changed("seed = 1", "seed = 1979-05-27"), "seed must be", id="a date"),
        pytest.param(_changed("[problem]", "[[problem]]"), "problem must be", id="a list"),
        pytest.param(_changed("[filter]", "[[filter]]"), "filter must be", id="a list of filters"),
        pytest.param(_changed("horizon = 12", "horizon = 1e300"), "horizon .* 1e", id="1e300"),
        pytest.param(
            _changed('method = "random"', 'method = "random"\nname = "a\\u0000b"'),
            "name must", id="NUL in a search's name",
        ),
        pytest.param(
            _changed("[problem]", '[model]\nname = "a\\u0000.py:m"\n[problem]'),
            "none that is NUL", id="NUL in a model's name",
        ),
        pytest.param(
            _changed("[problem]", f'[model]\nname = "{"a/" * 3000}b.py:m"\n[problem]'),
            "4,096 characters", id="a model's name of 6,000 characters",
        ),
        pytest.param(
            _changed("population = 6", f"population = {10**18}"),
            r"1e18|1000000000000000000 on 30 draws each takes about .* GB", id="population 10^18",
        ),
        pytest.param(
            _changed("population = 6", f"population = {2**63}"), "64 bits", id="population 2^63"
        ),
        pytest.param(
            _changed("[comparison]", '[[search]]\nmethod = "random"\nname = "a"\n' * 99
                     + "[comparison]"),
            "search must", id="101 searches",
        ),
        pytest.param(JOB.encode() + b"# \xff", "UTF-8, got byte 0xff", id="not UTF-8"),
        pytest.param(JOB.encode("utf-16"), "UTF-8", id="UTF-16"),
        pytest.param(b"\0" * 100, "must be TOML", id="NUL alone"),
        pytest.param(b"", "must be given", id="nothing"),
        pytest.param(b"#" * 16_000_001, "16,000,000 bytes", id="16 MB of comment"),
    ],
)  # fmt: skip
def test_a_hostile_job_file_is_refused_in_one_line(
    content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "job.toml"
    path.write_bytes(content)
    line = _refused(["run", str(path), "--results", str(tmp_path / "run")], capsys)
    assert re.search(words, line), line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(f"seed={_NINES}", "19 digits", id="5,000 digits"),
        pytest.param("seed=" + "[" * 99_999, "16 deep", id="deep lists"),
        pytest.param(".".join("a" * 99_999) + "=1", "16 parts", id="a key of 99,999 parts"),
        pytest.param(f"seed={_LONG}", "seed must be", id="3 MB"),
        pytest.param(_LONG, "key=value", id="3 MB without a value"),
        pytest.param(f"search.{_LONG}.population=2", "has no search", id="a search of 3 MB"),
        pytest.param("seed=a\udcffb", "UTF-8", id="not UTF-8"),
        pytest.param("seed=1\nseed=2", "key=value", id="a new line"),
        pytest.param("", "key=value", id="nothing"),
    ],
)
def test_a_hostile_change_is_refused_in_one_line(
    change: str, words: str, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    words_given = ["evaluate", str(small_job.path), "--times", "0,3", "--set", change]
    assert re.search(words, _refused(words_given, capsys))


@pytest.mark.parametrize(
    ("option", "code", "words"),
    [
        pytest.param("--times=1_0", 2, "got '1_0'", id="times with an underscore"),
        pytest.param("--times=\u0663,4", 2, "numbers and ranges", id="times in Arabic digits"),
        pytest.param(f"--times={_NINES}", 2, "numbers and ranges", id="a time of 5,000 digits"),
        pytest.param("--times=" + "1," * 100_000, 1, "got 1 twice", id="100,000 times"),
        pytest.param("--times=", 2, "numbers and ranges", id="no times"),
        pytest.param("--times=1e", 2, "numbers and ranges", id="a time as 1e"),
        pytest.param("--times=1e3", 1, "must name times", id="a time as 1e3"),
        pytest.param(
            "--times=0:" + "9" * 30, 1, "at most 1,000,000", id="a range of times to 1e30"
        ),
        pytest.param("--times=0:9:0", 2, "steps above 0, got '0:9:0'", id="a step of 0"),
        pytest.param("--times=1:2:3:4", 2, "numbers and ranges", id="a range of four numbers"),
        pytest.param("--times=1,,2", 2, "got '' in '1,,2'", id="an empty time"),
        pytest.param("--draws=1_0", 2, "digits 0-9", id="draws with an underscore"),
        pytest.param("--draws=\u0663", 2, "digits 0-9", id="draws in Arabic digits"),
        pytest.param(f"--draws={_NINES}", 2, "digits 0-9", id="5,000 digits of draws"),
        pytest.param(
            f"--draws={10**30}",
            1,
            r"evaluation\.draws must be .* 10000000, got 10{30} ",
            id="10^30 draws",
        ),
        pytest.param("--draws=10**30", 2, "digits 0-9", id="10**30 draws"),
        pytest.param(f"--draws={10**18}", 1, "evaluation.draws must", id="10^18 draws"),
        pytest.param(f"--particles={10**18}", 1, "filter.particles must", id="10^18 particles"),
        pytest.param("--seed=-1", 1, "seed must", id="a negative seed"),
        pytest.param(f"--{_LONG}", 2, "unknown option --xxx", id="an option of 3 MB"),
    ],
)
def test_a_hostile_option_is_refused_in_one_line(
    option: str, code: int, words: str, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    times = [] if option.startswith("--times") else ["--times", "0,3"]
    line = _refused(["evaluate", str(small_job.path), *times, option], capsys, code)
    assert re.search(words, line), line


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        pytest.param(["budget", "{job}", "--measurements", "\u0662:5"], 2, "ranges", id="Arabic"),
        pytest.param(["budget", "{job}", "--measurements", f"2:{_NINES}"], 2, "numbers", id="9s"),
        pytest.param(
            ["budget", "{job}", "--measurements", "2:3", "--target", "1_0"], 2, "finite",
            id="a target with an underscore",
        ),
        pytest.param(["why", "{job}", "--draws", str(10**30)], 1, "at most 100,000,000", id="why"),
        pytest.param(["check-model", "ungm", "--horizon", _NINES], 2, "digits 0-9", id="horizon"),
        pytest.param(["status", "x" * 300], 1, "cannot read|holds no run", id="a long folder"),
        pytest.param(["status", "x/" * 5000], 1, "cannot read|holds no run", id="a deep folder"),
        pytest.param([_LONG], 2, "COMMAND must be one of", id="a command of 3 MB"),
    ],
)  # fmt: skip
def test_every_other_command_refuses_in_one_line(
    words: list[str], code: int, told: str, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    filled = [word.format(job=small_job.path) if "{job}" in word else word for word in words]
    assert re.search(told, _refused(filled, capsys, code))


def test_the_time_to_check_times_grows_as_their_number() -> None:
    def seconds(count: int) -> float:
        start = time.perf_counter()
        validated(range(count), count)
        return time.perf_counter() - start

    seconds(1000)  # a hundred times as many would take ten thousand times as long
    assert min(seconds(100_000) for _ in range(3)) < 1000 * min(seconds(1000) for _ in range(5))


@pytest.mark.parametrize(
    "call",
    [
        lambda job: pfdist.evaluate(job, (0, 99)),
        lambda job: pfdist.evaluate(job, (0, 3), draws=1),
        lambda job: pfdist.evaluate(job, (0, 3), draws=10**5000),
        lambda job: pfdist.budget(job, (2, 3), draws=1),
        lambda job: pfdist.budget(job, (2, 3), changes=["comparison.draws=9"]),
        lambda job: pfdist.load_job(job.path, ["seed"]),
        lambda job: pfdist.run(job, job.path),
    ],
)
def test_errors_in_python_name_arguments_and_no_options(
    call: Callable[[Job], object], small_job: Job
) -> None:
    with pytest.raises((JobError, MeasurementTimesError, pfdist.PfdistError)) as refused:
        call(small_job)
    assert "--" not in str(refused.value)


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"seed": -1, "problem": {"horizon": 5, "measurement_budget": 2}}, "seed must .* got -1"),
        ({"seed": 1}, "problem must be given"),
        ({"sed": 1}, "unknown key 'sed', allowed: seed"),
    ],
)
def test_a_job_that_is_made_in_python_is_refused_as_that_of_a_file(
    sections: dict[str, object], words: str, tmp_path: Path
) -> None:
    with pytest.raises(JobError, match=words):
        Job(**sections)
    assert Job(seed=1, problem={"horizon": 5, "measurement_budget": 2}).seed == 1


@pytest.mark.usefixtures("no_figures")
def test_run_takes_changes_as_plan_and_budget_do(small_job: Job, tmp_path: Path) -> None:
    changes = ["seed=7", "search.genetic.generations=1", "comparison.draws=20"]
    done = pfdist.run(small_job, tmp_path / "run", changes=changes, figures=False)
    assert (done.job["seed"], done.job["comparison"]["draws"]) == (7, 20)
